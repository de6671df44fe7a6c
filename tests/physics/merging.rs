//! What a merge notices: things that move, lamps that drift, exposure times that
//! are wrong; and what it makes of a mosaic. Frames come from the simulated
//! sensor of `mock-devices`, which shares no code with the merge.

use mock_devices::sensor::{FrameKey, NoiseKey, SensorConfig, SensorModel};
use rig::radiometry::agreement::ExposureAgreement;
use rig::radiometry::merge::{BracketMerge, FrameRole};
use rig::radiometry::mosaic::Mosaic;
use rig::radiometry::plane::MergedPlane;
use rig::radiometry::sensor::{FlatField, SensorNoise};

const SIZE: [u32; 2] = [96, 64];

/// Radiance at a column and row.
type Field<'a> = &'a dyn Fn(usize, usize) -> f64;

struct Bench {
    sensor: SensorModel,
    noise: SensorNoise,
    seed: u64,
}

impl Bench {
    fn new(seed: u64) -> Self {
        let config = SensorConfig {
            hot_fraction: 0.0,
            ..SensorConfig::typical(SIZE, seed)
        };
        let sensor = SensorModel::new(config.clone());
        let noise = SensorNoise {
            black_level_spread_dn: config.offset_dsnu_e * config.gain_dn_per_e,
            dark_current_e_s: config.dark_current_e_s,
            dark_current_spread_e_s: config.dsnu_e_s,
            saturation_dn: 4030.0,
            linear_max_dn: 4030.0,
            responsivity_e_s: config.responsivity,
            flat_field: Some(FlatField {
                response: sensor.relative_response().to_vec(),
                std_dev: vec![0.0; sensor.relative_response().len()],
            }),
            ..SensorNoise::ideal(config.gain_dn_per_e, config.read_noise_e, 64.0, 12)
        };
        Self {
            sensor,
            noise,
            seed,
        }
    }

    /// Merges frames of (stated exposure, true exposure, radiance by pixel).
    fn merge(&self, frames: &[(f64, f64, Field<'_>)]) -> MergedPlane {
        let [width, height] = SIZE.map(|n| n as usize);
        let mut merge = BracketMerge::new(&self.noise, Mosaic::None, width, height).unwrap();
        for (repeat, (stated_s, true_s, radiance)) in (0u32..).zip(frames) {
            let field: Vec<f32> = (0..width * height)
                .map(|p| radiance(p % width, p / width) as f32)
                .collect();
            let key = NoiseKey {
                seed: self.seed,
                frame: FrameKey {
                    light: 0,
                    exposure: 0,
                    repeat,
                    kind: 0,
                },
            };
            let counts = self.sensor.expose(&field, *true_s, 1.0, key);
            merge.add(FrameRole::Light, *stated_s, &counts).unwrap();
        }
        merge.finish().unwrap()
    }
}

/// Three decades from left to right.
fn ramp(x: usize, _: usize) -> f64 {
    8.0 * 10f64.powf(-3.0 * x as f64 / f64::from(SIZE[0]))
}

fn total_moved(agreement: &[ExposureAgreement]) -> usize {
    agreement.iter().map(|step| step.moved_pixels).sum()
}

/// 8 sensors of 6144 pixels and 7 frames each: no pixel is called moving, ratios
/// and drifts are 1 and 0 within their stated uncertainty (χ² of 24 ratios and
/// 16 drifts below the 1e-6 tail), and the rest is as it was.
#[test]
fn a_still_scene_is_still() {
    let (mut ratios, mut drifts) = (0.0, 0.0);
    for seed in 0..8 {
        let bench = Bench::new(300 + seed);
        let t = [0.001, 0.004, 0.004, 0.016, 0.064, 0.064, 0.064];
        let frames: Vec<_> = t.iter().map(|&t| (t, t, &ramp as _)).collect();
        let plane = bench.merge(&frames);
        assert!(plane.valid.iter().all(|&valid| valid));
        assert_eq!(total_moved(&plane.agreement), 0, "seed {seed}");
        for step in &plane.agreement {
            let off = (step.signal_ratio - 1.0).abs();
            assert!(off < 0.01, "seed {seed}: {step:?}");
            if step.signal_ratio_std > 0.0 {
                ratios += (off / step.signal_ratio_std).powi(2);
            }
            if step.frames > 1 {
                drifts += (step.drift / step.drift_std).powi(2);
            }
        }
    }
    // The uncertainty leaves out what exposures share, so ratios may vary less.
    assert!(ratios < 75.0, "{ratios}");
    assert!((2.0..60.0).contains(&drifts), "{drifts}");
}

/// A bright disc that is elsewhere in the long exposure, or in one repeat.
#[test]
fn what_moves_is_found_and_masked_and_the_rest_is_not() {
    let disc = |cx: f64, cy: f64| {
        move |x: usize, y: usize| {
            let inside = (x as f64 - cx).hypot(y as f64 - cy) < 6.0;
            0.3 + if inside { 0.6 } else { 0.0 }
        }
    };
    let (here, there) = (disc(30.0, 30.0), disc(70.0, 30.0));
    for seed in 0..4 {
        let bench = Bench::new(500 + seed);
        for (name, frames) in [
            (
                "long exposure",
                vec![
                    (0.001, 0.001, &here as Field<'_>),
                    (0.004, 0.004, &here),
                    (0.008, 0.008, &there),
                ],
            ),
            (
                "one repeat",
                vec![
                    (0.004, 0.004, &here as Field<'_>),
                    (0.004, 0.004, &here),
                    (0.004, 0.004, &there),
                    (0.004, 0.004, &here),
                ],
            ),
        ] {
            let plane = bench.merge(&frames);
            let (mut found, mut truly, mut wrong) = (0, 0, 0);
            for p in 0..plane.valid.len() {
                let (x, y) = (p % 96, p / 96);
                let moved = here(x, y) != there(x, y);
                truly += usize::from(moved);
                found += usize::from(moved && !plane.valid[p]);
                wrong += usize::from(!moved && !plane.valid[p]);
            }
            assert!(
                found as f64 > 0.95 * truly as f64,
                "{name}: {found} of {truly}"
            );
            assert!(wrong <= 2, "{name}: {wrong} still pixels masked");
            assert!(total_moved(&plane.agreement) >= found, "{name}");
            // What moved must not pass for a wrong exposure.
            for step in &plane.agreement {
                assert!((step.signal_ratio - 1.0).abs() < 0.01, "{name}: {step:?}");
            }
        }
    }
}

#[test]
fn a_wrong_exposure_time_is_measured_and_masks_nothing() {
    for (seed, error) in [(1, 1.05), (2, 0.8), (3, 1.02)] {
        let bench = Bench::new(700 + seed);
        let frames: Vec<_> = [(0.001, 0.001), (0.004, 0.004), (0.016, 0.016 * error)]
            .iter()
            .map(|&(stated, truly)| (stated, truly, &ramp as _))
            .collect();
        let plane = bench.merge(&frames);
        let step = plane.agreement[2];
        let pull = (step.signal_ratio - error) / step.signal_ratio_std;
        assert!(pull.abs() < 5.0, "{error}: {step:?}");
        assert!(plane.valid.iter().all(|&valid| valid), "{error}");
        assert_eq!(step.moved_pixels, 0);
        assert!((plane.agreement[1].signal_ratio - 1.0).abs() < 0.01);
    }
}

#[test]
fn a_lamp_that_drifts_between_repeats_is_measured() {
    for (seed, per_frame) in [(1, 0.004), (2, -0.01), (3, 0.001)] {
        let bench = Bench::new(800 + seed);
        let fields: Vec<_> = (0..6)
            .map(|i| move |x, y| 0.2 * ramp(x, y) * (1.0 + per_frame * f64::from(i)))
            .collect();
        let frames: Vec<_> = fields.iter().map(|f| (0.004, 0.004, f as _)).collect();
        let plane = bench.merge(&frames);
        let step = plane.agreement[0];
        let pull = (step.drift - 5.0 * per_frame) / step.drift_std;
        assert!(pull.abs() < 5.0, "{per_frame}: {step:?}");
        assert!(plane.valid.iter().all(|&valid| valid), "{per_frame}");
    }
}

/// A colour sensor at full resolution: measured pixels stay, the others lie
/// within the range measured around them, and an even field stays even.
#[test]
fn demosaicing_invents_nothing() {
    let [width, height] = [24, 18];
    let noise = SensorNoise::ideal(0.4, 2.4, 64.0, 12);
    for mosaic in [Mosaic::Rggb, Mosaic::Grbg, Mosaic::Gbrg, Mosaic::Bggr] {
        let mut merge = BracketMerge::new(&noise, mosaic, width, height).unwrap();
        let value = |x: usize, y: usize| match mosaic.channel(x, y) {
            // Red has an edge, green a speck, blue is even.
            Some(0) => 100 + 900 * u16::from(x > 11),
            Some(1) => 200 + 2000 * u16::from((x, y) == (9, 8) || (x, y) == (10, 8)),
            _ => 300,
        };
        let counts: Vec<u16> = (0..width * height)
            .map(|p| 64 + value(p % width, p / width))
            .collect();
        merge.add(FrameRole::Light, 0.01, &counts).unwrap();
        let plane = merge.finish().unwrap();
        let image = plane.demosaiced(mosaic);
        assert_eq!((image.width, image.height), (width, height));
        let radiance = |dn: u16| f32::from(dn) / 0.4 / 0.01;
        for p in 0..width * height {
            let (x, y) = (p % width, p / width);
            let own = mosaic.channel(x, y).unwrap();
            assert_eq!(image.mean[p][own], plane.mean[p]);
            assert_eq!(image.variance[p][own], plane.variance[p]);
            let close = |a: f32, b: f32| (a / b - 1.0).abs() < 1e-5;
            assert!(close(image.mean[p][2], radiance(300)), "{mosaic:?}");
            if x < 10 {
                assert!(close(image.mean[p][0], radiance(100)), "{mosaic:?} at {x}");
            } else if x > 12 {
                assert!(close(image.mean[p][0], radiance(1000)), "{mosaic:?} at {x}");
            }
            let green = image.mean[p][1];
            let (low, high) = (radiance(200) * 0.9999, radiance(2200) * 1.0001);
            assert!((low..=high).contains(&green), "{mosaic:?}: {green}");
            // The mean of several has less variance than each.
            let other = (own + 1) % 3;
            if (1..width - 1).contains(&x) && (1..height - 1).contains(&y) && x < 10 {
                let single = plane.variance[p + 1].max(plane.variance[p + width]);
                assert!(image.variance[p][other] < 4.0 * single);
            }
            assert!(image.valid[p]);
        }
    }
}
