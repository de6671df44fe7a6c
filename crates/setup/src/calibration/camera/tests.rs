//! Boards seen by simulated lenses with a distortion that the start does not have.

use glam::DVec3;
use nalgebra::{DVector, Matrix3, Vector3};

use super::*;
use crate::calibration::mirror_sphere::Grey;
use crate::calibration::record::Values;
use crate::config::{BUILT_IN, RigConfig};
use crate::random::{Purpose, Stream, stream};
use crate::simulation::checkerboard::{
    Checkerboard, SIZE, described, displaced, perspective, poses, telecentric,
};

fn board() -> Board {
    Board {
        squares: Checkerboard::TYPICAL.squares,
        square_mm: Checkerboard::TYPICAL.square_mm,
        square_std_mm: 0.0,
        tilt_std_deg: 0.0,
    }
}

/// A photograph of the board, whose pose is camera from board.
fn photograph(
    camera: &Camera,
    pose: &Rigid<frames::Camera, frames::Sample>,
    numbers: &mut Stream,
) -> Grey {
    let board = Checkerboard::TYPICAL;
    Grey::of(&board.photograph(camera, pose, numbers))
}

fn options(least_views: usize) -> CameraOptions {
    CameraOptions {
        terms: Terms::Usual,
        least_views: Some(least_views),
        datum: Some(0),
    }
}

/// Chance is to exceed either bound once in 4,000 (Wilson and Hilferty's approximation).
fn chi2_bounds(freedom: f64) -> [f64; 2] {
    [-3.48, 3.48].map(|z: f64| {
        let v = 2.0 / (9.0 * freedom);
        freedom * (1.0 - v + z * v.sqrt()).powi(3)
    })
}

/// Squared length of an error in units of its covariance.
fn squared(error: &DVector<f64>, covariance: &DMatrix<f64>) -> f64 {
    error.dot(&covariance.clone().cholesky().unwrap().solve(error))
}

/// Root mean square error over the image, pixels, of where rays go, turned so that they fit
/// best: a turn of the camera is the pose's.
fn ray_error_px(found: &Camera, truth: &Camera) -> f64 {
    let places = (0..9).flat_map(|y| (0..9).map(move |x| (x, y)));
    let rays: Vec<_> = places
        .map(|(x, y)| {
            let at = DVec2::new(SIZE[0] as f64 * f64::from(x), SIZE[1] as f64 * f64::from(y)) / 8.0;
            (truth.chief_ray(at).1, found.chief_ray(at).1)
        })
        .collect();
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (a, b) in &rays {
        // A small turn w moves a by w × a.
        let cross = Matrix3::new(0.0, a.z, -a.y, -a.z, 0.0, a.x, a.y, -a.x, 0.0);
        let off = *b - *a;
        normal += cross.transpose() * cross;
        right += cross.transpose() * Vector3::new(off.x, off.y, off.z);
    }
    let w = normal.cholesky().unwrap().solve(&right);
    let turn = DVec3::new(w.x, w.y, w.z);
    let left = |(a, b): &(DVec3, DVec3)| (*b - *a - turn.cross(*a)).length_squared();
    let rms = (rays.iter().map(left).sum::<f64>() / rays.len() as f64).sqrt();
    rms * truth.scale_px().x
}

/// Lens and pose over seeds: errors against their covariance are χ² distributed, and rays
/// are right within a tenth of a pixel.
#[test]
fn a_perspective_lens_is_recovered_within_its_uncertainty() {
    const SEEDS: u64 = 3;
    let ideal = perspective();
    let start = described(Projection::Perspective { fov_rad: 0.5 });
    let (mut chi2, mut chi2_pose, mut worst_px) = (0.0, 0.0, 0.0f64);
    for seed in 0..SEEDS {
        let mut numbers = stream(seed, Purpose::Experiment, 20, 0, 0);
        let truth = displaced(ideal, &mut numbers);
        let images: Vec<Grey> = poses(&truth, &mut numbers, 8, true)
            .iter()
            .map(|pose| photograph(&truth, pose, &mut numbers))
            .collect();
        let (fit, missed) = calibrate(&images, &start, &board(), &options(3)).unwrap();
        assert!(missed.is_empty(), "{missed:?}");
        let expected = model::Model::of(&truth);
        let sought = expected.sought(Terms::Usual);
        let error = sought
            .iter()
            .zip(&fit.numbers)
            .map(|(n, v)| v - expected.get(*n));
        let error = DVector::from_iterator(sought.len(), error);
        let pulls: Vec<f64> = error
            .iter()
            .enumerate()
            .map(|(i, e)| e / fit.covariance[(i, i)].sqrt())
            .collect();
        let own = squared(&error, &fit.covariance);
        chi2 += own;
        let (pose, covariance) = fit.pose.as_ref().unwrap();
        let turned = pose.rotation * truth.sample_from_camera.rotation.conjugate();
        let moved = pose.translation_mm - truth.sample_from_camera.translation_mm;
        // One of two quaternions that are the same turn.
        let turned = turned * turned.w.signum();
        let error = [turned.to_scaled_axis().to_array(), moved.to_array()].concat();
        let own_pose = squared(&DVector::from_vec(error), covariance);
        chi2_pose += own_pose;
        let found = fit.camera(&start).unwrap();
        let off_px = ray_error_px(&found, &truth);
        worst_px = worst_px.max(off_px);
        eprintln!(
            "{seed}: χ² {own:.1}, pose {own_pose:.1}, reduced {:.2}, left {:.4} px, rays {off_px:.4} px, pulls {pulls:.1?}",
            fit.reduced_chi2, fit.rms_px
        );
    }
    assert!(worst_px < 0.1, "{worst_px} px");
    for (name, chi2, freedom) in [("lens", chi2, 8), ("pose", chi2_pose, 6)] {
        let [low, high] = chi2_bounds((freedom * SEEDS) as f64);
        assert!((low..high).contains(&chi2), "{name}: χ² {chi2}");
    }
}

/// Magnification and distortion of a telecentric lens from a flat board, and the sample's
/// datum across the view.
#[test]
fn a_telecentric_lens_is_recovered_within_its_uncertainty() {
    const SEEDS: u64 = 6;
    let ideal = telecentric();
    let extent_mm = DVec2::new(128.0, 96.0);
    let start = described(Projection::Orthographic { extent_mm });
    let mut chi2 = 0.0;
    for seed in 0..SEEDS {
        let mut numbers = stream(seed, Purpose::Experiment, 21, 0, 0);
        let truth = displaced(ideal, &mut numbers);
        let images: Vec<Grey> = poses(&truth, &mut numbers, 3, false)
            .iter()
            .map(|pose| photograph(&truth, pose, &mut numbers))
            .collect();
        let (fit, _) = calibrate(&images, &start, &board(), &options(1)).unwrap();
        let expected = model::Model::of(&truth);
        let sought = expected.sought(Terms::Usual);
        let error = sought
            .iter()
            .zip(&fit.numbers)
            .map(|(n, v)| v - expected.get(*n));
        let error = DVector::from_iterator(sought.len(), error);
        let own = squared(&error, &fit.covariance);
        chi2 += own;
        let found = fit.camera(&start).unwrap();
        let corners = [[0.0, 0.0], [60.0, 45.0], [-60.0, 40.0], [10.0, -48.0]];
        for [x, y] in corners {
            let at = DVec3::new(x, y, 0.0);
            let off = found.position_px(at).unwrap() - truth.position_px(at).unwrap();
            assert!(off.length() < 0.1, "seed {seed}: {off} px at ({x}, {y})");
        }
        eprintln!("{seed}: χ² {own:.1}, reduced {:.2}", fit.reduced_chi2);
    }
    let [low, high] = chi2_bounds((6 * SEEDS) as f64);
    assert!((low..high).contains(&chi2), "χ² {chi2}");
}

/// Each refusal names its reason; a spoilt corner is left out.
#[test]
fn unusable_views_are_refused_by_name() {
    let truth = perspective();
    let start = described(Projection::Perspective { fov_rad: 0.5 });
    let mut numbers = stream(1, Purpose::Experiment, 22, 0, 0);
    let places = poses(&truth, &mut numbers, 4, true);
    let mut images: Vec<Grey> = places
        .iter()
        .map(|pose| photograph(&truth, pose, &mut numbers))
        .collect();
    // A fleck of dust beside a corner.
    let middle = truth.position_px(DVec3::new(6.0, 6.0, 0.0));
    let on_corner = places[1].point(DVec3::new(12.0, 12.0, 0.0));
    assert!(middle.is_some() && on_corner.is_finite());
    let at = truth.position_of_px(on_corner).unwrap();
    for y in 0..3 {
        for x in 0..3 {
            let p = (at.y as usize + y) * SIZE[0] + at.x as usize + x;
            images[1].value[p] = 0.5;
        }
    }
    let (fit, _) = calibrate(&images, &start, &board(), &options(3)).unwrap();
    let off_px = ray_error_px(&fit.camera(&start).unwrap(), &truth);
    eprintln!("with dust: {off_px:.3} px, reduced {:.2}", fit.reduced_chi2);
    assert!(off_px < 0.1, "{off_px}");

    let refused = |images: &[Grey], board: &Board, options: &CameraOptions| {
        calibrate(images, &start, board, options).unwrap_err()
    };
    let mut blank = images[0].clone();
    blank.value.fill(0.3);
    let with_blank = [images[0].clone(), blank.clone(), blank.clone()];
    let error = refused(&with_blank, &board(), &options(3));
    assert_eq!(
        error,
        CameraError::TooFewViews {
            found: 1,
            needed: 3
        }
    );
    let error = refused(&[blank], &board(), &options(1));
    assert!(
        matches!(error, CameraError::NotFound { index: 0, .. }),
        "{error}"
    );
    let mut small = board();
    small.squares = [8, 8];
    let error = refused(&images, &small, &options(3));
    assert!(matches!(error, CameraError::OtherBoard { .. }), "{error}");
    let same = vec![images[0].clone(); 3];
    let error = refused(&same, &board(), &options(3));
    assert!(matches!(error, CameraError::SameTilt { .. }), "{error}");
    let mut large = board();
    large.squares = [12, 8];
    let error = refused(&images, &large, &options(3));
    assert_eq!(error, CameraError::NotWhole { index: 0 });
    let mut none = board();
    none.square_mm = f64::NAN;
    let error = refused(&images, &none, &options(3));
    assert!(matches!(error, CameraError::Impossible { .. }), "{error}");
}

/// A record gives a rig's camera the very lens that was found, under colour filters too.
#[test]
fn a_record_holds_the_lens_in_the_sensors_pixels() {
    let truth = perspective();
    let (projection, lens) = model::Model::of(&truth).stated();
    let fit = CameraFit {
        projection,
        lens,
        names: vec!["fx", "k1"],
        numbers: vec![1.0, 2.0],
        covariance: DMatrix::from_row_slice(2, 2, &[0.04, 0.01, 0.01, 0.09]),
        pose: Some((truth.sample_from_camera, DMatrix::identity(6, 6) * 1e-4)),
        residuals: Vec::new(),
        rms_px: 0.02,
        reduced_chi2: 1.1,
        coverage: 1.0,
        views: 5,
    };
    let rig = RigConfig::parse("rig", std::path::Path::new(""), BUILT_IN[0].1).unwrap();
    for cell_px in [1, 2] {
        let values = CameraValues::new(&fit, &truth, cell_px);
        values.check().unwrap();
        assert_eq!(values.std("fx"), Some(0.2 * cell_px as f64));
        assert_eq!(values.std("k1"), Some(0.3));
        let text = toml::to_string(&values).unwrap();
        let back: CameraValues = toml::from_str(&text).unwrap();
        assert_eq!(back, values);
        let mut geometry = rig.geometry.clone();
        geometry.cell_px = cell_px;
        geometry.camera.resolution_px = SIZE.map(|side| side * cell_px);
        back.apply(&mut geometry).unwrap();
        let seen = geometry.image_camera();
        let point = DVec3::new(20.0, -13.0, 4.0);
        let off = seen.position_px(point).unwrap() - truth.position_px(point).unwrap();
        assert!(off.length() < 1e-9, "{off}");
    }
    let mut broken = CameraValues::new(&fit, &truth, 1);
    broken.radial[0] = -1e3;
    assert_eq!(broken.check().unwrap_err().key, "values.radial");
    broken.covariance.pop();
    assert_eq!(broken.check().unwrap_err().key, "values.covariance");
}
