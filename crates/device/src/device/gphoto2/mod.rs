//! Still cameras, tethered by the program `gphoto2`: their shutter speeds are those that the
//! body lists, and each raw file must state the exposure that was set.
//!
//! Programs instead of libraries, because libgphoto2 and every raw decoder are under the
//! LGPL: a program behind a pipe binds nobody to its licence.

mod body_choice;
mod camera;
mod finding;
mod frames;
mod opening;
pub mod output;
mod program;
mod raw_file;
mod serial;
mod speeds;

use self::body_choice::BodyChoice;
pub use self::camera::StillCamera;
use super::described::Driver;

/// `camera.driver = "gphoto2"`.
pub const DRIVER: Driver = Driver {
    name: "gphoto2",
    offer: "a gphoto2 camera that is not connected now",
    only_practice: false,
    key: "body",
    allowed: body_choice::ALLOWED,
    is_path: false,
    accepts: |text| BodyChoice::parse(&text.to_string_lossy()).is_some(),
    ready: |_| {
        finding::programs_are_there()?;
        Ok("frames come from gphoto2".to_owned())
    },
    open: |text, description| Ok(Box::new(StillCamera::open(text, description)?)),
    find: finding::detected,
};
