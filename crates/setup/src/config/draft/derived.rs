//! What follows from several answers.

use serde::Serialize;

use super::answer::Answers;
use super::found::{Found, marked};
use super::table::directions;
use crate::config::camera::offered;

/// Full horizontal angle of view of a lens in perspective, degrees; `None` while answers are
/// not there.
///
/// A thin lens of focal length f that is sharp at distance d has its image f d / (d - f)
/// behind it; the field is the sensor's width times d over that.
pub fn field_of_view(answers: &Answers) -> Option<f64> {
    let distance_mm = answers.number("camera_distance_mm")?;
    let [width_mm, _] = field_mm(answers)?;
    Some(2.0 * (0.5 * width_mm / distance_mm).atan().to_degrees())
}

/// Width and height of the field of view at the sample, mm.
pub fn field_mm(answers: &Answers) -> Option<[f64; 2]> {
    let [width_px, height_px] = [answers.whole("width_px")?, answers.whole("height_px")?];
    let width_mm = match answers.text("lens")? {
        "focal-length" => {
            let distance_mm = answers.number("camera_distance_mm")?;
            let focal_mm = answers.number("focal_mm")?;
            let sensor_mm = f64::from(width_px) * answers.number("pixel_um")? * 1e-3;
            sensor_mm * (distance_mm - focal_mm) / focal_mm
        }
        _ => answers.number("field_width_mm")?,
    };
    Some([
        width_mm,
        width_mm * f64::from(height_px) / f64::from(width_px),
    ])
}

/// How many channels the lamp has: 3 (red, green, blue) or 1 (white).
pub fn channels(answers: &Answers) -> Option<u32> {
    let keys = ["lamp", "grbl_lamp", "zaber_lamp"];
    match keys.iter().find_map(|key| answers.text(key))? {
        "rgb" => Some(3),
        _ => Some(1),
    }
}

/// All of it, for the rig file's template; `None` where the answers do not say it.
#[derive(Serialize)]
pub(super) struct Derived<'a> {
    device: Option<Device<'a>>,
    field_mm: Option<[f64; 2]>,
    fov_deg: Option<f64>,
    object_na: Option<f64>,
    /// The lens' x and z.
    position_mm: Option<[f64; 2]>,
    /// Azimuth and elevation of each light, degrees.
    directions: Option<Vec<[f64; 2]>>,
    channels: Option<u32>,
}

/// The camera, as rig files name it.
#[derive(Serialize)]
struct Device<'a> {
    driver: &'static str,
    /// The remark on it, which says so where its frames are for practice alone.
    remark: String,
    /// The driver's key that says which camera.
    key: &'static str,
    /// What stands there.
    address: &'a str,
    /// Its serial number, where it shows one.
    serial: Option<&'a str>,
}

impl<'a> Derived<'a> {
    pub(super) fn of(answers: &'a Answers, found: &'a Found) -> Self {
        Self {
            device: device(answers, found),
            field_mm: field_mm(answers),
            fov_deg: field_of_view(answers),
            object_na: object_na(answers),
            position_mm: position_mm(answers),
            directions: answers.text("lights").and_then(directions),
            channels: channels(answers),
        }
    }
}

fn device<'a>(answers: &'a Answers, found: &'a Found) -> Option<Device<'a>> {
    let choice = answers.text("camera")?;
    let (name, address) = match choice.split_once(' ') {
        Some(of_connected) => of_connected,
        None => (choice, answers.text("camera_address")?),
    };
    let driver = offered().find(|driver| driver.name == name)?;
    Some(Device {
        driver: driver.name,
        remark: marked("What speaks to the camera", driver.only_practice),
        key: driver.key,
        address,
        serial: found.serial_of(choice),
    })
}

/// Numerical aperture on the sample's side: the sine of the angle under which the sample
/// sees the aperture's radius.
fn object_na(answers: &Answers) -> Option<f64> {
    let diameter_mm = answers.number("focal_mm")? / answers.number("f_number")?;
    let distance_mm = answers.number("camera_distance_mm")?;
    Some((0.5 * diameter_mm / distance_mm).atan().sin().min(0.95))
}

/// In hundredths of a millimetre where the camera is tilted: a tape does not reach them.
fn position_mm(answers: &Answers) -> Option<[f64; 2]> {
    let distance_mm = answers.number("camera_distance_mm")?;
    let tilt_deg = answers.number("camera_tilt_deg")?;
    let (sin, cos) = tilt_deg.to_radians().sin_cos();
    Some(match tilt_deg {
        0.0 => [0.0, distance_mm],
        _ => [-sin, cos].map(|part| (100.0 * part * distance_mm).round() / 100.0),
    })
}
