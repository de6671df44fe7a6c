//! What to do with a new rig file: the calibrations, in the order in which each finds what it
//! needs.

use std::path::Path;

use serde::Serialize;

use super::answer::Answers;
use super::table::WITH_AXES;
use crate::config::RIG_FILE;
use crate::shell_words::quoted;

/// A step, as a command line. What stands in capitals is to be filled in.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Step {
    /// The command.
    pub command: String,
    /// What it is for, and what it needs.
    pub purpose: &'static str,
}

/// The steps for the bench of these answers, whose rig file this is.
pub fn next(answers: &Answers, file: &Path) -> Vec<Step> {
    let has = |key, value: &str| answers.text(key) == Some(value);
    let moves = WITH_AXES.iter().any(|stage| has("stage", stage));
    let is_telecentric = has("lens", "telecentric");
    let rig = match file == Path::new(RIG_FILE) {
        true => String::new(),
        false => format!(" --rig {}", quoted(&file.display().to_string())),
    };
    let mut steps = Vec::new();
    let mut step = |command: &str, purpose| {
        steps.push(Step {
            command: command.replace("@", &rig),
            purpose,
        });
    };
    step(
        "rig doctor@",
        "checks the file, the devices, permissions and the view; the sensor's record is still missing",
    );
    step(
        "rig camera preview@",
        "live picture: put the sample in the middle, focus, close the aperture",
    );
    if moves {
        step(
            "rig stage home@",
            "finds the axes' zero; keep the emergency stop at hand",
        );
    }
    step(
        "rig calibrate sensor@",
        "before an even, steady light: noise, full well, linearity; a capture needs it",
    );
    step(
        "rig calibrate flat@",
        "before the same light: response of each pixel",
    );
    step(
        "rig calibrate lamp@",
        "lamp cold, on a white card: warm-up, drift, flicker",
    );
    step(
        "rig capture --lights 1 --sample board --no-fit@",
        match is_telecentric {
            true => "a checkerboard that faces the camera squarely",
            false => "a checkerboard, tilted; six views or more, each by this command",
        },
    );
    step(
        match is_telecentric {
            true => "rig calibrate camera SESSION --squares N,M --square MM@",
            false => "rig calibrate camera SESSIONS… --squares N,M --square MM@",
        },
        match is_telecentric {
            true => "magnification and distortion, from that session",
            false => "focal length and distortion, from those sessions",
        },
    );
    step(
        "rig capture --lights 1 --sample edge --no-fit@",
        "a slanted edge, at three heights, each by this command",
    );
    step(
        "rig calibrate focus LOW MIDDLE HIGH --heights=MM,MM,MM@",
        "sharpness over the sample's depth, from those three sessions",
    );
    step(
        "rig calibrate glare --trap X,Y,WIDTH,HEIGHT@",
        "light that the lens scatters, from a hole into a black box in a white card",
    );
    step(
        "rig capture --lights 12 --sample sphere --no-fit@",
        "a glossy sphere in the sample's position",
    );
    step(
        "rig calibrate lights SESSION --radius MM@",
        "where the lights are, from that session",
    );
    step(
        "rig capture --lights 8 --sample white --no-fit@",
        "a white standard in the sample's position",
    );
    step(
        "rig calibrate white SESSION --reflectance R --reflectance-std U@",
        "irradiance of each light, from that session",
    );
    step(
        "rig capture --lights 4 --sample NAME --dry-run@",
        "the plan, its time and its disk space",
    );
    step(
        "rig capture --lights 4 --sample NAME@",
        "the first sample, fitted and reported",
    );
    step(
        "rig calibrate pose SESSION@",
        "where the sample lay; then `rig fit SESSION --pose RECORD --refine-bench`",
    );
    steps
}
