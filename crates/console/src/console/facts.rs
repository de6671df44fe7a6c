//! The topic `console`: what does not change while a console runs.

use std::path::Path;

use glam::DVec3;
use serde_json::{Value, json};

use crate::config::RigConfig;
use crate::config::stage::StageDriver;
use crate::device::kinematics::{Kinematics, Mechanism};
use crate::export::FORMATS;
use crate::units::StageAngles;

/// What a console is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// A whole bench.
    Bench,
    /// A camera alone, as `rig camera preview` has it.
    Camera,
}

impl Mode {
    /// As pages read it.
    pub fn name(self) -> &'static str {
        match self {
            Mode::Bench => "bench",
            Mode::Camera => "camera",
        }
    }
}

/// Of a console for this rig, whose file is called `file`, and this folder of sessions.
pub fn facts(rig: &RigConfig, file: &str, folder: &Path, mode: Mode) -> Value {
    let ranges = match rig.stage.kinematics() {
        Kinematics::TwoAxes(axes) if axes.mechanism == Mechanism::Rotary => {
            Some([axes.first, axes.second].map(|axis| [axis.min, axis.max]))
        }
        _ => None,
    };
    let to_camera = rig.geometry.coaxial();
    let direction = (to_camera != DVec3::ZERO).then(|| StageAngles::from_direction(to_camera));
    json!({
        // A page that comes back learns by it that this is another console, or another bench.
        "since": jiff::Timestamp::now().to_string(),
        "version": env!("CARGO_PKG_VERSION"),
        "mode": mode.name(),
        "folder": folder.to_string_lossy(),
        "formats": FORMATS.iter().map(|format| (format.name, format.about)).collect::<Vec<_>>(),
        "rig": {
            "name": rig.name,
            "file": file,
            "simulated": rig.is_simulated(),
            "channels": rig.stage.measures.iter().map(|of| of.colour()).collect::<Vec<_>>(),
            "azimuth_range_deg": ranges.map(|[azimuth, _]| azimuth),
            "elevation_range_deg": ranges.map(|[_, elevation]| elevation),
            "has_stage": !matches!(rig.stage.driver, StageDriver::Manual(_)),
            "camera_direction": direction,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_learns_what_the_rig_can_do() {
        let text = include_str!("../../../../rig-configs/simulated.toml");
        let rig = RigConfig::parse("simulated.toml", Path::new(""), text).unwrap();
        let facts = facts(&rig, "simulated.toml", Path::new("sessions"), Mode::Bench);
        let shown = &facts["rig"];
        assert_eq!(shown["simulated"], true);
        assert_eq!(
            shown["channels"].as_array().unwrap().len(),
            rig.stage.measures.len()
        );
        let range = shown["elevation_range_deg"].as_array().unwrap();
        assert!(range[0].as_f64() < range[1].as_f64());
        assert!(shown["camera_direction"]["elevation_deg"].as_f64().unwrap() > 0.0);
        assert_eq!(
            (&facts["mode"], &facts["folder"]),
            (&"bench".into(), &"sessions".into())
        );
    }
}
