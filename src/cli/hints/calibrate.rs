//! Advice on calibrations that made no record.

use super::for_device;
use crate::calibrating::CalibratingError;
use crate::calibration::camera::CameraError;
use crate::calibration::lamp_watch::WatchError;
use crate::calibration::procedure::ProcedureError;

pub(super) fn for_calibrating(error: &CalibratingError) -> Option<String> {
    use CalibratingError::*;
    let hint = match error {
        Folder { .. } => {
            "records are kept there; make the folder writable, or name another with --out"
        }
        Lamp(WatchError::Device(error)) | Procedure(ProcedureError::Device(error)) => {
            return Some(for_device(error));
        }
        Procedure(_) | Sensor(_) => {
            "point the camera at a steady, uniform light that saturates it within two seconds but not in its shortest exposure; nothing was kept"
        }
        NoSensor { .. } => "run `rig calibrate sensor` first",
        Lamp(_) => {
            "let the lamp cool, put a white card where it is lit evenly, cover other light, and touch nothing; nothing was kept"
        }
        NoChannel { channels, .. } => {
            let last = channels.saturating_sub(1);
            return Some(format!("its channels are 0 to {last}"));
        }
        Response(_) => {
            "photograph a still scene of many brightnesses with manual exposure, at least three exposures a factor of two to four apart, from nearly black to nearly white"
        }
        Bits { .. } => "cameras that give more bits are linear: `rig calibrate sensor`",
        NotInside { .. } => {
            "--region takes first column, first row, columns and rows; both count from 0"
        }
        Glare(_) => {
            "put a deep box, black inside, behind a hole in a white card that fills the image, and name with --trap a part of the image inside the hole, away from its edge; nothing was kept"
        }
        Camera(error) => return Some(format!("{}; nothing was kept", for_camera(error))),
        NoImages { .. } => "`rig session verify` says whether the session is whole",
        // The error inside says more.
        _ => return None,
    };
    Some(hint.to_owned())
}

fn for_camera(error: &CameraError) -> &'static str {
    match error {
        CameraError::Impossible { .. } => "correct the value",
        CameraError::NotFound { .. } | CameraError::TooFewViews { .. } => {
            "the whole board, evenly lit, in focus, with squares of 10 pixels or more; --squares counts squares, not corners"
        }
        CameraError::OtherBoard { .. } => "--squares counts squares along each side of the board",
        CameraError::NotWhole { .. } => {
            "name with --datum a view in which the whole board is visible, and check --squares"
        }
        CameraError::Uncovered { .. } => {
            "add views with the board in the corners of the image, or take a larger board"
        }
        CameraError::SameTilt { .. } => {
            "tilt the board by 20 to 40 degrees, in another direction in each view"
        }
        CameraError::Unexplained { .. } => {
            "the board must be flat and stand still, --squares and the lens' model in the rig file right, and a telecentric lens must see it flat; more terms with --distortion all"
        }
        CameraError::Folded(_) => "use fewer terms: --distortion radial, or none",
    }
}
