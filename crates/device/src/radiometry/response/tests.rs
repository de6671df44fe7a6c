//! Against a camera whose curves are known and against OpenCV, on the bracket of
//! `tests/data/response` (its SOURCES.md says how both were made).

use super::*;
use crate::radiometry::frame_file::decode;
use rig_core::random::{Purpose, stream};

const EXPOSURES: [u32; 5] = [16, 8, 4, 2, 1];
/// Counts that occur in all three channels.
const SEEN: std::ops::RangeInclusive<usize> = 45..=230;
const WIDTH: usize = 48;

fn folder() -> std::path::PathBuf {
    std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join("tests/data/response")
}

/// One column per channel.
fn table(name: &str) -> [Vec<f64>; 3] {
    let text = std::fs::read_to_string(folder().join(name)).unwrap();
    [1, 2, 3].map(|column| {
        let value = |line: &str| line.split(',').nth(column).unwrap().parse().unwrap();
        text.lines().skip(1).map(value).collect()
    })
}

/// All pixels, or every second one of every second row from (1, 1) on.
fn samples(channel: usize, every_second: bool) -> BracketSamples {
    let frames: Vec<Vec<u16>> = EXPOSURES
        .iter()
        .map(|n| {
            let bytes = std::fs::read(folder().join(format!("bracket_{n:03}.png"))).unwrap();
            decode(&bytes).unwrap().planes.swap_remove(channel)
        })
        .collect();
    let chosen = (0..frames[0].len())
        .filter(|p| !every_second || (p % WIDTH % 2 == 1 && p / WIDTH % 2 == 1));
    BracketSamples {
        exposures_s: EXPOSURES.iter().map(|&n| 1.0 / f64::from(n)).collect(),
        counts: chosen
            .map(|p| frames.iter().map(|f| f[p] as u8).collect())
            .collect(),
    }
}

/// OpenCV solves the same equations by singular values, without elimination and
/// without demanding growth, in single precision, and with every count's own weight.
#[test]
fn debevec_agrees_with_opencv() {
    let reference = table("opencv_debevec.csv");
    for (channel, reference) in reference.iter().enumerate() {
        let curve = debevec(&samples(channel, true), 10.0).unwrap();
        let mut worst = 0.0f64;
        for z in SEEN {
            let expected = (reference[z] / reference[MIDDLE]).ln();
            worst = worst.max((curve.ln_exposure[z] - expected).abs());
        }
        assert!(worst < 5e-3, "channel {channel}: {worst}");
    }
}

/// OpenCV leaves Robertson's curve as it comes, rough by sampling noise: counts
/// are compared as means over 16 neighbours.
#[test]
fn robertson_agrees_with_opencv() {
    let reference = table("opencv_robertson.csv");
    for (channel, reference) in reference.iter().enumerate() {
        let curve = robertson(&samples(channel, false), 30.0).unwrap();
        // One count sets OpenCV's scale and is as rough as the others.
        let difference: Vec<f64> = SEEN
            .filter(|&z| reference[z] > 0.0) // not a number where nothing was seen
            .map(|z| curve.ln_exposure[z] - reference[z].ln())
            .collect();
        let mean = difference.iter().sum::<f64>() / difference.len() as f64;
        for block in difference.chunks(16) {
            let off = block.iter().sum::<f64>() / block.len() as f64 - mean;
            assert!(off.abs() < 0.02, "channel {channel}: {off}");
        }
    }
}

/// Both recover the camera over the counts that occur and grow throughout.
#[test]
fn both_recover_the_known_camera() {
    for (channel, truth) in table("truth.csv").iter().enumerate() {
        let samples = samples(channel, false);
        for (name, curve, bound) in [
            ("debevec", debevec(&samples, 10.0).unwrap(), 0.05),
            ("robertson", robertson(&samples, 30.0).unwrap(), 0.08),
        ] {
            assert_eq!(curve.ln_exposure[MIDDLE], 0.0);
            assert!(curve.ln_exposure.windows(2).all(|g| g[1] > g[0]), "{name}");
            assert!(curve.ln_std.iter().all(|s| s.is_finite() && *s >= 0.0));
            let error = |z: usize| curve.ln_exposure[z] - truth[z].ln();
            let worst = SEEN.map(|z| error(z).abs()).fold(0.0, f64::max);
            assert!(worst < bound, "{name}, channel {channel}: {worst}");
        }
    }
}

#[test]
fn a_count_and_its_exposure_are_each_others_inverse() {
    let curve = debevec(&samples(1, true), 10.0).unwrap();
    for z in [1, 17, 128, 200, 254] {
        assert!(
            (curve.count(curve.exposure(z)) - z as f64).abs() < 1e-6,
            "{z}"
        );
    }
    assert_eq!(curve.count(0.0), 0.0);
    assert_eq!(curve.count(1e9), 255.0);
    assert!((0..COUNTS).all(|z| curve.slope(z as f64) > 0.0));
}

/// The bracket merged with the curve found from it: radiances of three decades
/// against those that made it, through the true curve's scale.
#[test]
fn merging_gives_the_radiances_that_made_the_bracket() {
    // The camera of channel 0, a display gamma, with noise of its own here.
    let exposures_s: Vec<f64> = (0..9).map(|k| 0.5f64.powi(8 - k)).collect();
    let [width, height] = [64, 48];
    let radiance = |p: usize| 10f64.powf(-1.0 + 3.0 * (p % width) as f64 / width as f64);
    let frames: Vec<Vec<u16>> = (0u64..)
        .zip(&exposures_s)
        .map(|(frame, t)| {
            let count = |p: usize| {
                let mut random = stream(8, Purpose::Experiment, frame, p as u64, 0);
                let x = (radiance(p) * t).clamp(0.0, 1.0);
                (255.0 * x.powf(1.0 / 2.2) + 0.8 * random.normal())
                    .round()
                    .clamp(0.0, 255.0) as u16
            };
            (0..width * height).map(count).collect()
        })
        .collect();
    let views: Vec<&[u16]> = frames.iter().map(Vec::as_slice).collect();
    let samples = BracketSamples::on_grid(exposures_s.clone(), &views, 2000);
    let curve = debevec(&samples, 10.0).unwrap();
    let merge = ResponseMerge::new(
        &curve,
        width,
        exposures_s.iter().copied().zip(views).collect(),
    );
    let plane = merge.finish();
    // Exposure of count 128 by the true curve.
    let unit = (128.0f64 / 255.0).powf(2.2);
    let mut chi2 = 0.0;
    let mut by_column = vec![0.0; width];
    for p in 0..width * height {
        assert!(plane.valid[p]);
        let mean = f64::from(plane.mean[p]) * unit;
        by_column[p % width] += mean / radiance(p) / height as f64;
        let std = f64::from(plane.variance[p]).sqrt() * unit;
        chi2 += ((mean - radiance(p)) / std).powi(2);
    }
    for (x, ratio) in by_column.iter().enumerate() {
        assert!((ratio - 1.0).abs() < 0.03, "column {x}: {ratio}");
    }
    // The curve's own error is not in the pixels' variance.
    let reduced = chi2 / plane.mean.len() as f64;
    assert!((0.5..3.0).contains(&reduced), "{reduced}");
}

#[test]
fn samples_that_make_no_curve_are_refused() {
    let good = samples(0, false);
    let with = |change: &dyn Fn(&mut BracketSamples)| {
        let mut samples = good.clone();
        change(&mut samples);
        let error = debevec(&samples, 10.0).unwrap_err();
        assert_eq!(robertson(&samples, 30.0).unwrap_err(), error);
        error
    };
    let two = with(&|s| s.exposures_s = vec![0.1; 5]);
    assert_eq!(two, ResponseError::TooFewExposures { found: 1 });
    let few = with(&|s| s.counts.truncate(20));
    assert!(matches!(few, ResponseError::TooFewSamples { .. }), "{few}");
    let dark = with(&|s| s.counts.iter_mut().flatten().for_each(|z| *z /= 4));
    assert!(matches!(dark, ResponseError::NarrowRange { .. }), "{dark}");
    let reversed = with(&|s| s.exposures_s.reverse());
    assert!(
        matches!(reversed, ResponseError::NotBrighter { .. }),
        "{reversed}"
    );
}
