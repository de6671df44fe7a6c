//! `rig calibrate`: one file per kind of calibration.

mod camera;
mod flat;
mod focus;
mod glare;
mod lamp;
mod light;
mod lights;
mod pose;
mod response;
mod rotation;
mod sensor;
mod status;
mod target;
mod white;

use super::{CliError, Context};
use clap::Subcommand;

/// Measures the bench and keeps what it finds as records
#[derive(clap::Args, Debug)]
pub struct CalibrateArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand, Debug)]
enum What {
    /// Measures gain, read noise, black level, dark current, full well and hot pixels, by
    /// photon transfer
    ///
    /// The camera looks at a steady, uniform light (an integrating sphere, or a lit
    /// diffuser in front of the lens).
    Sensor(sensor::SensorArgs),
    /// Measures the relative response of each pixel; with a light of known radiance also the scale
    ///
    /// Needs a sensor record. The camera looks at a steady, uniform light.
    Flat(flat::FlatArgs),
    /// Finds the response of a camera that is not linear (8-bit JPEG, PNG or TIFF), from a bracket
    ///
    /// Photograph a still scene with at least three exposures, with everything manual.
    Response(response::ResponseArgs),
    /// Measures how the lamp warms up, drifts and flickers, and how long to wait for it
    ///
    /// The camera looks at a white card that the lamp lights, without other light. The lamp must
    /// be cold.
    Lamp(lamp::LampArgs),
    /// Finds the direction of each light, and how the stage stands, from highlights on one or
    /// two mirror spheres
    ///
    /// Put a glossy sphere of known radius where the sample will be, before a background that
    /// is clearly darker or brighter than its rim, and capture it as a sample.
    Lights(lights::LightsArgs),
    /// Finds the lamp's irradiance, and with it the absolute scale, from a diffuse standard of
    /// certified reflectance
    White(white::WhiteArgs),
    /// Finds the lens' focal length or magnification, principal point and distortion from views
    /// of a checkerboard
    ///
    /// Show the board at several positions and, unless the lens is telecentric, tilted by 20 to 40
    /// degrees in several directions.
    Camera(camera::CameraArgs),
    /// Finds where the sample truly lies, by aligning its mesh to the images of a session
    ///
    /// Nothing is assumed of its material. `rig fit --pose` uses the pose.
    Pose(pose::PoseArgs),
    /// Finds the camera's point spread, focus and aperture, from images of a straight, slightly
    /// tilted edge at known heights
    ///
    /// Put a target with a sharp edge (a printed or cut one, dark next to bright) across the
    /// camera's axis, at three heights or more over the depth of the sample. Fits of later
    /// captures use what is found.
    Focus(focus::FocusArgs),
    /// Measures how much light the lens scatters over the image, from black traps on a white card
    ///
    /// A white card that fills the image, evenly lit, with one or two holes into deep boxes that
    /// are black inside, a wide and a narrow one. Fits of later captures take the glare off.
    Glare(glare::GlareArgs),
    /// Shows every record in force, with its age, reasons to doubt it and what to run
    Status(status::StatusArgs),
}

/// `rig calibrate`.
pub fn run(args: &CalibrateArgs, context: &Context) -> Result<(), CliError> {
    match &args.what {
        What::Sensor(args) => sensor::run(args, context),
        What::Flat(args) => flat::run(args, context),
        What::Response(args) => response::run(args, context),
        What::Lamp(args) => lamp::run(args, context),
        What::Lights(args) => lights::run(args, context),
        What::White(args) => white::run(args, context),
        What::Camera(args) => camera::run(args, context),
        What::Pose(args) => pose::run(args, context),
        What::Focus(args) => focus::run(args, context),
        What::Glare(args) => glare::run(args, context),
        What::Status(args) => status::run(args, context),
    }
}
