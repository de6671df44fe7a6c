//! The merge against a forward model of its own: Poisson electrons, normal read
//! noise, rounding and clipping, written here from EMVA 1288 and sharing no
//! code with the library's noise model. `--nocapture` prints the figures.

use crate::command_support::words;
use nalgebra::{DMatrix, DVector};
use rig::radiometry::merge::{BracketMerge, FrameRole};
use rig::radiometry::mosaic::Mosaic;
use rig::radiometry::plane::MergedPlane;
use rig::radiometry::sensor::{FlatField, SensorNoise};
use rig::random::{Purpose, Stream, stream};

/// What a simulated pixel truly is.
#[derive(Clone, Copy)]
struct TruePixel {
    black_dn: f64,
    dark_e_s: f64,
    response: f64,
}

struct Case {
    name: &'static str,
    gain_dn_per_e: f64,
    read_noise_e: f64,
    black_spread_dn: f64,
    dark_e_s: f64,
    flat_std: f64,
    ambient: f64,
    /// (role, exposure in seconds, frames)
    bracket: &'static [(FrameRole, f64, u32)],
}

use FrameRole::{Ambient, Dark, Light};

const CASES: &[Case] = &[
    Case {
        name: "four exposures, ambient and dark frames",
        gain_dn_per_e: 0.4,
        read_noise_e: 2.5,
        black_spread_dn: 0.0,
        dark_e_s: 3.0,
        flat_std: 0.0,
        ambient: 150.0,
        bracket: &[
            (Light, 0.002, 1),
            (Light, 0.008, 1),
            (Light, 0.032, 2),
            (Light, 0.128, 4),
            (Ambient, 0.032, 2),
            (Ambient, 0.128, 4),
            (Dark, 0.128, 4),
        ],
    },
    Case {
        name: "unknown black level of each pixel, dark frames at each exposure",
        gain_dn_per_e: 0.5,
        read_noise_e: 2.0,
        black_spread_dn: 1.2,
        dark_e_s: 20.0,
        flat_std: 0.0,
        ambient: 0.0,
        bracket: &[
            (Light, 0.004, 2),
            (Light, 0.02, 2),
            (Light, 0.1, 2),
            (Dark, 0.004, 2),
            (Dark, 0.02, 2),
            (Dark, 0.1, 2),
        ],
    },
    Case {
        name: "single frames a factor of 8 apart, noisy reading, no dark frames",
        gain_dn_per_e: 0.25,
        read_noise_e: 9.0,
        black_spread_dn: 0.0,
        dark_e_s: 0.0,
        flat_std: 0.0,
        ambient: 0.0,
        bracket: &[(Light, 0.001, 1), (Light, 0.008, 1), (Light, 0.064, 1)],
    },
    Case {
        name: "counts coarser than the noise, many frames",
        gain_dn_per_e: 0.05,
        read_noise_e: 2.5,
        black_spread_dn: 0.5,
        dark_e_s: 1.0,
        flat_std: 0.0,
        ambient: 0.0,
        bracket: &[
            (Light, 0.002, 4),
            (Light, 0.008, 8),
            (Light, 0.032, 16),
            (Dark, 0.032, 16),
        ],
    },
    Case {
        name: "a flat field known to 0.5 percent",
        gain_dn_per_e: 0.4,
        read_noise_e: 2.5,
        black_spread_dn: 0.3,
        dark_e_s: 3.0,
        flat_std: 0.005,
        ambient: 40.0,
        bracket: &[
            (Light, 0.002, 1),
            (Light, 0.004, 1),
            (Light, 0.008, 1),
            (Light, 0.016, 1),
            (Ambient, 0.016, 2),
        ],
    },
];

const BLACK_DN: f64 = 64.0;
const FULL_SCALE_DN: f64 = 4095.0;
const RESPONSIVITY_E_S: f64 = 1000.0;
const SIDE: usize = 128;

/// Poisson numbers: multiplication of uniforms below 30 (Knuth), above it
/// Hörmann's transformed rejection (PTRS, 1993).
fn poisson(mean: f64, random: &mut Stream) -> f64 {
    if mean <= 0.0 {
        return 0.0;
    }
    if mean < 30.0 {
        let limit = (-mean).exp();
        let (mut product, mut count) = (random.uniform(), 0.0);
        while product > limit {
            product *= random.uniform();
            count += 1.0;
        }
        return count;
    }
    let b = 0.931 + 2.53 * mean.sqrt();
    let a = -0.059 + 0.02483 * b;
    let inverse_alpha = 1.1239 + 1.1328 / (b - 3.4);
    let squeeze = 0.9277 - 3.6224 / (b - 2.0);
    loop {
        let u = random.uniform() - 0.5;
        let v = 1.0 - random.uniform();
        let us = 0.5 - u.abs();
        let k = ((2.0 * a / us + b) * u + mean + 0.43).floor();
        if us >= 0.07 && v <= squeeze {
            return k;
        }
        if k < 0.0 || (us < 0.013 && v > us) {
            continue;
        }
        let ln_accept = (v * inverse_alpha / (a / (us * us) + b)).ln();
        if ln_accept <= k * mean.ln() - mean - ln_factorial(k) {
            return k;
        }
    }
}

fn ln_factorial(k: f64) -> f64 {
    if k < 10.0 {
        return (1..=k as u32).map(|i| f64::from(i).ln()).sum();
    }
    let n = k + 1.0; // Stirling's series of ln Γ(n)
    (n - 0.5) * n.ln() - n + 0.5 * std::f64::consts::TAU.ln() + 1.0 / (12.0 * n)
        - 1.0 / (360.0 * n.powi(3))
}

impl Case {
    fn true_pixel(&self, random: &mut Stream) -> TruePixel {
        TruePixel {
            black_dn: BLACK_DN + self.black_spread_dn * random.normal(),
            dark_e_s: self.dark_e_s * (0.5 + random.uniform()),
            response: 1.0 + 0.01 * random.normal(),
        }
    }

    fn rate_e_s(&self, pixel: TruePixel, role: FrameRole, radiance: f64) -> f64 {
        let seen = match role {
            Light => radiance + self.ambient / RESPONSIVITY_E_S,
            Ambient => self.ambient / RESPONSIVITY_E_S,
            Dark => 0.0,
        };
        seen * RESPONSIVITY_E_S * pixel.response + pixel.dark_e_s
    }

    fn count(&self, pixel: TruePixel, electrons: f64, random: &mut Stream) -> u16 {
        let read_e = self.read_noise_e * random.normal();
        let dn = pixel.black_dn + self.gain_dn_per_e * (poisson(electrons, random) + read_e);
        dn.round().clamp(0.0, FULL_SCALE_DN) as u16
    }

    fn noise_model(&self, flat: FlatField) -> SensorNoise {
        SensorNoise {
            black_level_spread_dn: self.black_spread_dn,
            dark_current_e_s: self.dark_e_s,
            responsivity_e_s: RESPONSIVITY_E_S,
            flat_field: Some(flat),
            ..SensorNoise::ideal(self.gain_dn_per_e, self.read_noise_e, BLACK_DN, 12)
        }
    }

    /// Radiance at which the shortest exposure reaches `fraction` of full scale.
    fn radiance_at(&self, fraction: f64) -> f64 {
        let shortest_s = self.bracket[0].1;
        fraction * (FULL_SCALE_DN - BLACK_DN) / self.gain_dn_per_e / shortest_s / RESPONSIVITY_E_S
    }

    /// Merges a simulated image and returns it with the flat-field error applied
    /// as a metrologist would meet it: the map is wrong by its own uncertainty.
    fn simulate(&self, seed: u64, truth: &[f64]) -> (MergedPlane, Vec<TruePixel>) {
        let pixels: Vec<TruePixel> = (0..truth.len() as u64)
            .map(|p| self.true_pixel(&mut stream(seed, Purpose::Experiment, 1, p, 0)))
            .collect();
        let flat = FlatField {
            response: pixels
                .iter()
                .zip(0u64..)
                .map(|(pixel, p)| {
                    let error = stream(seed, Purpose::Experiment, 2, p, 0).normal();
                    (pixel.response + self.flat_std * error) as f32
                })
                .collect(),
            std_dev: vec![self.flat_std as f32; truth.len()],
        };
        let noise = self.noise_model(flat);
        let height = truth.len() / SIDE;
        let mut merge = BracketMerge::new(&noise, Mosaic::None, SIDE, height).unwrap();
        let mut frame = 0;
        for &(role, exposure_s, frames) in self.bracket {
            for _ in 0..frames {
                frame += 1;
                let counts: Vec<u16> = pixels
                    .iter()
                    .zip(truth)
                    .zip(0u64..)
                    .map(|((&pixel, &radiance), p)| {
                        let mut random = stream(seed, Purpose::Experiment, 3, p, frame);
                        let electrons = self.rate_e_s(pixel, role, radiance) * exposure_s;
                        self.count(pixel, electrons, &mut random)
                    })
                    .collect();
                merge.add(role, exposure_s, &counts).unwrap();
            }
        }
        (merge.finish().unwrap(), pixels)
    }

    /// Cramér–Rao bound of the radiance's variance for normal noise of known
    /// variance, over the exposures for which `usable` holds: unknown are the
    /// lit, ambient and dark rates and the pixel's black level, of which the
    /// spread is known beforehand.
    fn bound(&self, pixel: TruePixel, radiance: f64, usable: impl Fn(f64, f64) -> bool) -> f64 {
        let mut fisher = DMatrix::<f64>::zeros(4, 4);
        if self.black_spread_dn > 0.0 {
            fisher[(3, 3)] = self.black_spread_dn.powi(-2);
        } else {
            fisher[(3, 3)] = 1e12;
        }
        let has_ambient = self.bracket.iter().any(|b| b.0 == Ambient);
        let has_dark = self.bracket.iter().any(|b| b.0 == Dark);
        for &(role, exposure_s, frames) in self.bracket {
            let electrons = self.rate_e_s(pixel, role, radiance) * exposure_s;
            let variance =
                self.gain_dn_per_e.powi(2) * (electrons + self.read_noise_e.powi(2)) + 1.0 / 12.0;
            if !usable(self.gain_dn_per_e * electrons, variance) {
                continue;
            }
            let mut row = DVector::<f64>::zeros(4);
            let slope = self.gain_dn_per_e * exposure_s;
            row[match role {
                Light => 0,
                Ambient => 1,
                Dark => 2,
            }] = slope;
            row[3] = 1.0;
            fisher += &row * row.transpose() * (f64::from(frames) / variance);
        }
        for (column, there) in [(1, has_ambient), (2, has_dark)] {
            if !there {
                fisher[(column, column)] += 1e12;
            }
        }
        let mut contrast = DVector::<f64>::zeros(4);
        contrast[0] = 1.0;
        contrast[if has_ambient { 1 } else { 2 }] = -1.0;
        let covariance = fisher
            .try_inverse()
            .expect("a bracket that determines the rate");
        let rate_variance = contrast.dot(&(&covariance * &contrast));
        rate_variance / (RESPONSIVITY_E_S * pixel.response).powi(2)
            + (radiance * self.flat_std / pixel.response).powi(2)
    }
}

struct Score {
    valid: usize,
    bias_sigma: f64,
    bias_relative: f64,
    chi2: f64,
    efficiency: f64,
}

fn score(case: &Case, seed: u64, fraction: f64) -> Score {
    let radiance = case.radiance_at(fraction);
    let (merged, pixels) = case.simulate(seed, &vec![radiance; SIDE * SIDE]);
    let (mut error, mut square, mut stated, mut chi2, mut bound, mut valid) =
        (0.0, 0.0, 0.0, 0.0, 0.0, 0);
    for (p, &pixel) in pixels.iter().enumerate() {
        if !merged.valid[p] {
            continue;
        }
        let d = f64::from(merged.mean[p]) - radiance;
        valid += 1;
        error += d;
        square += d * d;
        stated += f64::from(merged.variance[p]);
        chi2 += d * d / f64::from(merged.variance[p]);
        bound += case.bound(pixel, radiance, |signal_dn, variance| {
            BLACK_DN + signal_dn + 3.0 * variance.sqrt() < FULL_SCALE_DN
        });
    }
    let n = valid.max(1) as f64;
    Score {
        valid,
        bias_sigma: error / n / (stated / n).sqrt(),
        bias_relative: error / n / radiance.max(1e-300),
        chi2: chi2 / n,
        efficiency: square / bound.max(1e-300),
    }
}

impl Case {
    fn light_exposures_s(&self) -> Vec<f64> {
        let light = self.bracket.iter().filter(|b| b.0 == Light);
        light.map(|b| b.1).collect()
    }

    /// Whether some exposure comes so near to clipping that the merge may leave
    /// it out although it just fits: 84 to 100 percent of full scale.
    fn near_clipping(&self, fraction: f64) -> bool {
        let exposures_s = self.light_exposures_s();
        exposures_s
            .iter()
            .any(|t| (0.84..1.0).contains(&(fraction * t / exposures_s[0])))
    }

    /// From black to 0.85 of full scale in the shortest exposure, and close to
    /// where each longer exposure clips.
    fn fractions(&self) -> Vec<f64> {
        let exposures_s = self.light_exposures_s();
        let ladder = (0..18).map(|i| 0.85 * 10f64.powf(-0.22 * f64::from(i)));
        let clipping = exposures_s[1..].iter().flat_map(|t| {
            [1.06, 1.0, 0.98, 0.955, 0.93, 0.9].map(|full| full * exposures_s[0] / t)
        });
        std::iter::once(0.0).chain(ladder).chain(clipping).collect()
    }

    /// Whether the noise in the shortest exposure spans less than half a count.
    /// Lit and unlit frames then share part of their rounding error, it cancels
    /// in the difference, and the stated variance is only an upper bound.
    fn rounding_repeats(&self, fraction: f64) -> bool {
        let electrons = fraction * (FULL_SCALE_DN - BLACK_DN) / self.gain_dn_per_e;
        self.gain_dn_per_e.powi(2) * (electrons + self.read_noise_e.powi(2)) < 0.25
    }

    /// Expected electrons of the lamp over all light frames.
    fn electrons(&self, fraction: f64) -> f64 {
        let light = self.bracket.iter().filter(|b| b.0 == Light);
        let collected_s: f64 = light.map(|b| b.1 * f64::from(b.2)).sum();
        self.radiance_at(fraction) * RESPONSIVITY_E_S * collected_s
    }
}

/// 16,384 pixels per level: a standard deviation of 1.1 percent for χ²/dof and
/// variance, 0.8 percent of σ for the bias; the margins to the bounds are at
/// least 3 of these.
#[test]
fn merge_is_unbiased_calibrated_and_efficient_from_black_to_saturation() {
    for (c, case) in CASES.iter().enumerate() {
        let (mut worst_bias, mut chi2_low, mut chi2_high, mut worst_variance) =
            (0.0f64, f64::MAX, 0.0f64, 0.0f64);
        for (i, &fraction) in case.fractions().iter().enumerate() {
            let s = score(case, (100 * c + i) as u64, fraction);
            let at = format!(
                "{}, {fraction:.6} of full scale in the shortest exposure: \
                 bias {:+.4} sigma, {:+.5} relative, chi2/dof {:.3}, variance/bound {:.3}",
                case.name, s.bias_sigma, s.bias_relative, s.chi2, s.efficiency
            );
            assert_eq!(s.valid, SIDE * SIDE, "{at}");
            assert!(
                s.bias_sigma.abs() < 0.05 || s.bias_relative.abs() < 0.001,
                "{at}"
            );
            // Rounding errors are independent and normal only where noise spans a count.
            let fine = case.gain_dn_per_e * case.read_noise_e > 0.4;
            assert!(s.chi2 < if fine { 1.05 } else { 1.10 }, "{at}");
            if !case.rounding_repeats(fraction) {
                assert!(s.chi2 > 0.95, "{at}");
                chi2_low = chi2_low.min(s.chi2);
            }
            worst_bias = worst_bias.max(s.bias_sigma.abs());
            chi2_high = chi2_high.max(s.chi2);
            if fine && case.electrons(fraction) > 20.0 {
                let bound = if case.near_clipping(fraction) {
                    1.5
                } else {
                    1.05
                };
                assert!(s.efficiency < bound, "{at}");
                if bound < 1.1 {
                    worst_variance = worst_variance.max(s.efficiency);
                }
            }
        }
        println!(
            "{}: bias < {worst_bias:.3} sigma, chi2/dof {chi2_low:.3} to {chi2_high:.3}, \
             variance < {worst_variance:.3} of the bound away from clipping",
            case.name
        );
    }
}

/// An image with ramps over three decades, ripples, edges and single bright
/// pixels, where neighbours differ: χ²/dof by brightness over 4 seeds. Each bin
/// holds at least 2,000 pixels; bounds as for uniform fields, and 4 standard
/// deviations more.
#[test]
fn pulls_are_unit_normal_in_a_structured_image() {
    for case in CASES {
        let mut bins = [(0.0f64, 0usize); 12];
        for seed in 0..4 {
            let truth: Vec<f64> = (0..SIDE * SIDE)
                .map(|p| {
                    let (x, y) = ((p % SIDE) as f64, (p / SIDE) as f64);
                    let decades = -3.0 * x / SIDE as f64;
                    let ripple = 1.0 + 0.3 * (0.9 * y).sin();
                    let edge = if (y as usize / 16).is_multiple_of(2) {
                        1.0
                    } else {
                        0.25
                    };
                    let sparkle = if p.is_multiple_of(97) { 2.0 } else { 1.0 };
                    case.radiance_at(0.3 * 10f64.powf(decades) * ripple * edge * sparkle)
                })
                .collect();
            let (merged, _) = case.simulate(900 + seed, &truth);
            for (p, &radiance) in truth.iter().enumerate() {
                assert!(merged.valid[p], "{}: pixel {p}", case.name);
                let decades = (case.radiance_at(0.8) / radiance).log10();
                let bin = &mut bins[(2.0 * decades) as usize];
                let error = f64::from(merged.mean[p]) - radiance;
                bin.0 += error * error / f64::from(merged.variance[p]);
                bin.1 += 1;
            }
        }
        for (i, (chi2, n)) in bins.iter().enumerate().filter(|(_, bin)| bin.1 >= 2000) {
            let reduced = chi2 / *n as f64;
            let slack = 0.05 + 4.0 * (2.0 / *n as f64).sqrt();
            println!("{}: bin {i}, {n} pixels, chi2/dof {reduced:.3}", case.name);
            assert!(
                (reduced - 1.0).abs() < slack,
                "{}: chi2/dof {reduced:.3} over {n} pixels in half decade {i}",
                case.name
            );
        }
    }
}

/// The simulated rig end to end: frames of its sensor, merged with the records
/// that `rig calibrate` made of it. 32 frames' worth of levels from black to
/// saturation; 307 200 pixels per level give χ²/dof a standard deviation of 0.3 percent.
#[test]
fn the_simulated_sensor_with_its_shipped_records_gives_unit_pulls() {
    use mock_devices::sensor::{FrameKey, NoiseKey, SensorModel};
    use rig::calibration::Library;
    use rig::calibration::noise::sensor_noise;
    use rig::calibration::record::{FlatValues, SensorValues};

    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let rig = rig::config::RigConfig::load(&root.join("rig-configs/simulated.toml")).unwrap();
    let truth = rig.simulation.as_ref().unwrap().sensor.clone();
    let sensor = SensorModel::new(truth.clone());
    let library = Library::Folder(root.join("calibration/simulated"));
    let record = library.load::<SensorValues>(None).unwrap().unwrap();
    let flat = library.load::<FlatValues>(None).unwrap().unwrap();
    let mut noise = sensor_noise(&record, Some(&flat), None, truth.resolution_px).unwrap();
    // The scale is measured with the same gain, so the gain's error cancels in radiance.
    noise.responsivity_e_s = truth.responsivity * truth.gain_dn_per_e / noise.gain_dn_per_e;

    let pixels = sensor.offset_e().len();
    let [width, height] = truth.resolution_px.map(|side| side as usize);
    let (ambient, bracket) = (0.002, [(0.001, 1), (0.004, 1), (0.016, 2), (0.064, 4)]);
    let hot = noise.hot_pixels.clone().unwrap();
    let (mut total, mut dof) = (0.0, 0.0);
    for level in [0.0, 1e-4, 1e-3, 0.004, 0.02, 0.1, 0.5, 2.0, 6.0] {
        let (mut chi2, mut error, mut stated, mut n) = (0.0, 0.0, 0.0, 0.0);
        let mut merge = BracketMerge::new(&noise, Mosaic::None, width, height).unwrap();
        for (role, radiance) in [(Light, level + ambient), (Ambient, ambient), (Dark, 0.0)] {
            for (exposure, &(exposure_s, frames)) in (0u32..).zip(&bracket) {
                for repeat in 0..frames {
                    let key = NoiseKey {
                        seed: 50,
                        frame: FrameKey {
                            light: (level * 1e6) as u32,
                            exposure,
                            repeat,
                            kind: role as u32,
                        },
                    };
                    let field = vec![radiance as f32; pixels];
                    let counts = sensor.expose(&field, exposure_s, 1.0, key);
                    merge.add(role, exposure_s, &counts).unwrap();
                }
            }
        }
        let merged = merge.finish().unwrap();
        for p in (0..pixels).filter(|&p| !hot[p]) {
            assert!(merged.valid[p], "radiance {level}, pixel {p}");
            let d = f64::from(merged.mean[p]) - level;
            chi2 += d * d / f64::from(merged.variance[p]);
            error += d;
            stated += f64::from(merged.variance[p]).sqrt();
            n += 1.0;
        }
        for p in (0..pixels).filter(|&p| hot[p]) {
            assert!(!merged.valid[p], "pixel {p} is hot");
        }
        println!(
            "radiance {level}: chi2/dof {:.3}, bias {:+.4} sigma",
            chi2 / n,
            error / stated
        );
        assert!(
            (0.95..1.05).contains(&(chi2 / n)),
            "radiance {level}: {}",
            chi2 / n
        );
        let relative = error / n / f64::max(level, 1e-12);
        assert!(
            (error / stated).abs() < 0.05 || relative.abs() < 0.001,
            "radiance {level}: bias {} sigma, {relative} relative",
            error / stated
        );
        total += chi2;
        dof += n;
    }
    println!("all levels: chi2/dof {:.4}", total / dof);
}

fn rig() -> assert_cmd::Command {
    assert_cmd::Command::cargo_bin("rig").unwrap()
}

/// The shipped records are what the calibration procedure finds, byte for byte.
#[test]
fn shipped_records_come_from_the_procedure() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    for arguments in [
        &["sensor", "--frames", "8"][..],
        &words("flat --frames 64 --radiance 0.4 --radiance-std 0.001"),
    ] {
        rig()
            .current_dir(root)
            .arg("calibrate")
            .args(arguments)
            .args(words(
                "--rig rig-configs/simulated.toml --date 2026-11-21T02:00:00Z",
            ))
            .arg("--out")
            .arg(folder.path())
            .assert()
            .success();
    }
    let mut compared = 0;
    for kind in ["sensor", "flat", "scale"] {
        for entry in std::fs::read_dir(folder.path().join(kind)).unwrap() {
            let entry = entry.unwrap();
            let shipped = root
                .join("calibration/simulated")
                .join(kind)
                .join(entry.file_name());
            assert_eq!(
                std::fs::read(entry.path()).unwrap(),
                std::fs::read(&shipped).unwrap(),
                "{}",
                shipped.display()
            );
            compared += 1;
        }
    }
    assert_eq!(compared, 6);
}

fn write_png(path: &std::path::Path, width: u32, counts: Vec<u16>) {
    let height = counts.len() as u32 / width;
    image::ImageBuffer::<image::Luma<u16>, _>::from_raw(width, height, counts)
        .unwrap()
        .save(path)
        .unwrap();
}

#[test]
fn the_merge_command_makes_radiance_of_png_frames() {
    let folder = tempfile::tempdir().unwrap();
    let case = &CASES[0];
    let table = "file,exposure_s\nshort.png,0.002\nlong.png,0.008\n";
    std::fs::write(folder.path().join("exposures.csv"), table).unwrap();
    let pixel = TruePixel {
        black_dn: BLACK_DN,
        dark_e_s: 0.0,
        response: 1.0,
    };
    let rate_e_s = 400_000.0;
    for (name, exposure_s, frame) in [("short.png", 0.002, 1), ("long.png", 0.008, 2)] {
        let counts = (0..400)
            .map(|p| {
                let mut random = stream(4, Purpose::Experiment, 9, p, frame);
                case.count(pixel, rate_e_s * exposure_s, &mut random)
            })
            .collect();
        write_png(&folder.path().join(name), 20, counts);
    }
    rig()
        .current_dir(&folder)
        .args(words("merge short.png long.png --exposures exposures.csv"))
        .args(words("--gain 0.4 --read-noise 2.5 --black-level 64"))
        .args(["--bit-depth", "12", "--out", "out.exr"])
        .assert()
        .success()
        .stdout("out.exr\n");
    let file = rig::radiance_image::exr::read(&folder.path().join("out.exr")).unwrap();
    assert_eq!((file.image.width, file.image.height), (20, 20));
    assert!(file.has_variance && file.image.valid.iter().all(|&valid| valid));
    let mean = file.image.mean.iter().map(|m| f64::from(m[1])).sum::<f64>() / 400.0;
    // 4000 electrons per pixel and frame pair: 1.6% per pixel, 0.08% of the mean.
    assert!((mean / rate_e_s - 1.0).abs() < 0.004, "{mean}");
}

#[test]
fn bad_brackets_are_one_clear_line_with_a_hint() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_png(&path("a.png"), 4, vec![100; 16]);
    write_png(&path("b.png"), 8, vec![100; 16]);
    write_png(&path("c.png"), 4, vec![100; 16]);
    write_png(&path("deep.png"), 4, vec![60_000; 16]);
    std::fs::write(path("text.png"), "not a picture").unwrap();
    let table = "a.png,0.1\nb.png,0.2\ntext.png,0.3\ndeep.png,0.4\n";
    std::fs::write(path("table.csv"), table).unwrap();
    std::fs::write(path("bad.csv"), "a.png,soon\n").unwrap();
    std::fs::write(path("dark.csv"), "a.png,1,dark\n").unwrap();
    let sensor = [
        "--gain",
        "0.4",
        "--read-noise",
        "2",
        "--black-level",
        "64",
        "--bit-depth",
        "12",
    ];
    for (frames, exposures, options, fact) in [
        (
            &["a.png", "b.png"][..],
            "table.csv",
            &sensor[..],
            "b.png is 8 x 2",
        ),
        (&["c.png"], "table.csv", &sensor, "no exposure for c.png"),
        (&["text.png"], "table.csv", &sensor, "text.png"),
        (&["gone.png"], "table.csv", &sensor, "gone.png"),
        (&["deep.png"], "table.csv", &sensor, "count of 60000"),
        (&["a.png"], "bad.csv", &sensor, "line 1"),
        (&["a.png"], "none.csv", &sensor, "none.csv"),
        (&["a.png"], "dark.csv", &sensor, "no light frame"),
        (&["a.png"], "table.csv", &[], "--gain is missing"),
        (
            &["a.png"],
            "table.csv",
            &["--gain", "0", "--read-noise", "2", "--black-level", "64"],
            "gain_dn_per_e",
        ),
        (
            &["a.png"],
            "table.csv",
            &["--rig", "simulated"],
            "4 x 4 pixels",
        ),
    ] {
        let output = rig()
            .current_dir(&folder)
            .arg("merge")
            .args(frames)
            .args(["--exposures", exposures, "--out", "never.exr"])
            .args(options)
            .output()
            .unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{frames:?}: {stderr}");
        assert!(
            stderr.starts_with("error: ") && stderr.contains(fact),
            "{fact}: {stderr}"
        );
        assert!(stderr.contains("\n\nhint: "), "{fact}: {stderr}");
        assert!(!path("never.exr").exists());
    }
}
