//! Lens and position of a camera by views of a checkerboard.

use glam::DVec2;

use super::{EvaluateError, Recovered, failed};
use crate::calibration::camera::model::{Model, Terms};
use crate::calibration::camera::{Board, CameraOptions, calibrate};
use crate::calibration::mirror_sphere::Grey;
use crate::calibration::record::Measured;
use crate::random::{Purpose, stream};
use crate::simulation::checkerboard::{
    Checkerboard, described, displaced, perspective, poses, telecentric,
};
use crate::transport::{Camera, Projection};

/// Eight tilted views in perspective.
pub(super) fn in_perspective(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    let start = described(Projection::Perspective { fov_rad: 0.5 });
    one(seed, perspective(), start, 8)
}

/// Three flat views through a telecentric lens.
pub(super) fn through_a_telecentric_lens(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    let extent_mm = DVec2::new(128.0, 96.0);
    let start = described(Projection::Orthographic { extent_mm });
    one(seed, telecentric(), start, 3)
}

fn one(
    seed: u64,
    ideal: Camera,
    start: Camera,
    views: usize,
) -> Result<Vec<Recovered>, EvaluateError> {
    let mut numbers = stream(seed, Purpose::Experiment, 20, 0, 0);
    let truth = displaced(ideal, &mut numbers);
    let photographed = Checkerboard::TYPICAL;
    let is_telecentric = matches!(truth.projection, Projection::Orthographic { .. });
    let images: Vec<Grey> = poses(&truth, &mut numbers, views, !is_telecentric)
        .iter()
        .map(|pose| Grey::of(&photographed.photograph(&truth, pose, &mut numbers)))
        .collect();
    let board = Board {
        squares: photographed.squares,
        square_mm: photographed.square_mm,
        square_std_mm: 0.0,
        tilt_std_deg: 0.0,
    };
    let options = CameraOptions {
        terms: Terms::Usual,
        least_views: Some(views),
        datum: Some(0),
    };
    let (fit, _) = calibrate(&images, &start, &board, &options).map_err(failed)?;
    let expected = Model::of(&truth);
    let lens = expected.sought(Terms::Usual);
    let mut all: Vec<Recovered> = lens
        .iter()
        .enumerate()
        .map(|(i, number)| Recovered {
            quantity: number.name,
            unit: match number.name {
                "fx" | "fy" | "cx" | "cy" => "px",
                "mx" | "my" => "px/mm",
                _ => "",
            },
            truth: expected.get(*number),
            found: Measured {
                value: fit.numbers[i],
                std: fit.covariance[(i, i)].sqrt(),
            },
        })
        .collect();
    let (pose, covariance) = fit.pose.ok_or_else(|| failed("no pose was found"))?;
    let turned = pose.rotation * truth.sample_from_camera.rotation.conjugate();
    // One of the two quaternions of a turn.
    let turned = (turned * turned.w.signum()).to_scaled_axis();
    let moved = pose.translation_mm - truth.sample_from_camera.translation_mm;
    let errors = [turned.to_array().map(f64::to_degrees), moved.to_array()].concat();
    for (i, error) in errors.into_iter().enumerate() {
        let std = covariance[(i, i)].sqrt();
        // What a telecentric lens cannot determine is fixed.
        if std > 1e-9 {
            all.push(Recovered {
                quantity: POSE[i],
                unit: if i < 3 { "°" } else { "mm" },
                truth: 0.0,
                found: Measured {
                    value: error,
                    std: if i < 3 { std.to_degrees() } else { std },
                },
            });
        }
    }
    Ok(all)
}

const POSE: [&str; 6] = [
    "camera turned about x",
    "camera turned about y",
    "camera turned about z",
    "camera moved along x",
    "camera moved along y",
    "camera moved along z",
];
