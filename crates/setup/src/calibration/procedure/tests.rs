use super::*;
use crate::calibration::flat::{FlatFit, from_map, to_map};
use crate::calibration::noise::noise_without_maps;
use crate::calibration::pixel_map::PixelMap;
use crate::calibration::sensor::SensorFit;
use crate::device::even_light::EvenLight;
use crate::radiometry::linearity::Linearity;
use crate::radiometry::merge::{BracketMerge, FrameRole};
use crate::radiometry::mosaic::Mosaic;
use crate::radiometry::sensor::{DarkPattern, FlatField};
use mock_devices::sensor::{FrameKey as MockFrameKey, NoiseKey, SensorConfig};

fn truth(seed: u64) -> SensorConfig {
    SensorConfig {
        hot_fraction: 1e-3,
        ..SensorConfig::typical([64, 64], seed)
    }
}

fn camera(config: SensorConfig, seed: u64) -> EvenLight {
    EvenLight::new(config, 0.4, seed)
}

fn calibrate(camera: &mut EvenLight) -> Result<SensorFit, ProcedureError> {
    let bit_depth = camera.info().bit_depth;
    let width = camera.info().resolution_px[0] as usize;
    let transfer = LitCamera::new(
        camera,
        ProcedureOptions::default(),
        &mut |_| false,
        &mut || {},
    )
    .photon_transfer()?;
    Ok(transfer.solve(width, bit_depth)?)
}

/// Truth recovered on 12 sensors: K within 1%, read noise within 5%, black
/// level within 0.2 DN; and each error in units of its stated uncertainty is a
/// standard normal: χ² over 12 between the 1e-5 tails of χ²(12).
#[test]
fn photon_transfer_recovers_the_truth_within_its_uncertainty() {
    let names = ["gain", "read noise", "dark current", "black level"];
    let mut pulls = names.map(|name| (name, 0.0));
    for seed in 0..12 {
        let config = truth(100 + seed);
        let mut camera = camera(config.clone(), seed);
        let fit = calibrate(&mut camera).unwrap();
        let v = &fit.values;
        let case = format!("seed {seed}: {v:?}, chi2 {}", fit.reduced_chi2);
        assert!(
            (v.gain_dn_per_e.value / config.gain_dn_per_e - 1.0).abs() < 0.01,
            "{case}"
        );
        assert!(
            (v.read_noise_e.value / config.read_noise_e - 1.0).abs() < 0.05,
            "{case}"
        );
        assert!(
            (v.black_level_dn.value - config.black_level_dn).abs() < 0.2,
            "{case}"
        );
        assert!(
            (v.full_well_e.value / config.full_well_e - 1.0).abs() < 0.01,
            "{case}"
        );
        let spread_dn = config.offset_dsnu_e * config.gain_dn_per_e;
        assert!(
            (v.black_level_spread_dn.value / spread_dn - 1.0).abs() < 0.15,
            "{case}"
        );
        assert!(
            (v.dark_current_spread_e_s.value / config.dsnu_e_s - 1.0).abs() < 0.2,
            "{case}"
        );
        assert!(
            v.saturation_dn > 4030.0 && v.saturation_dn < 4054.0,
            "{case}"
        );
        assert_eq!(v.linear_max_dn, v.saturation_dn, "{case}");
        assert!(v.linearity_error < 0.01, "{case}");
        let hot: Vec<u32> = v.hot_pixels.iter().map(|&[x, y]| y * 64 + x).collect();
        assert_eq!(hot, camera.sensor().hot_pixels(), "{case}");
        let dark = camera.sensor().dark_current_e_s();
        let cold = (0..dark.len()).filter(|&p| !fit.hot[p]);
        let cold: Vec<f64> = cold.map(|p| f64::from(dark[p])).collect();
        let dark_e_s = cold.iter().sum::<f64>() / cold.len() as f64;
        let pull = |m: crate::calibration::record::Measured, truth: f64| {
            ((m.value - truth) / m.std).powi(2)
        };
        pulls[0].1 += pull(v.gain_dn_per_e, config.gain_dn_per_e);
        pulls[1].1 += pull(v.read_noise_e, config.read_noise_e);
        pulls[2].1 += pull(v.dark_current_e_s, dark_e_s);
        let offset = camera.sensor().offset_e();
        let cold = (0..offset.len()).filter(|&p| !fit.hot[p]);
        let cold: Vec<f64> = cold.map(|p| f64::from(offset[p])).collect();
        let offset_e = cold.iter().sum::<f64>() / cold.len() as f64;
        let black_dn = config.black_level_dn + config.gain_dn_per_e * offset_e;
        pulls[3].1 += pull(v.black_level_dn, black_dn);
    }
    for (name, chi2) in &pulls {
        assert!((1.1..46.0).contains(chi2), "{name}: {chi2}");
    }
}

#[test]
fn a_drifting_lamp_does_not_look_like_noise() {
    let mut camera = camera(truth(5), 1);
    camera.drift_per_frame = 5e-5;
    let fit = calibrate(&mut camera).unwrap();
    assert!(
        (fit.values.gain_dn_per_e.value / 0.38 - 1.0).abs() < 0.01,
        "{:?}",
        fit.values
    );
}

#[test]
fn flat_field_recovers_the_response_within_its_uncertainty() {
    let mut camera = camera(truth(7), 3);
    let fit = calibrate(&mut camera).unwrap();
    let mut noise = SensorNoise::ideal(
        fit.values.gain_dn_per_e.value,
        fit.values.read_noise_e.value,
        fit.values.black_level_dn.value,
        12,
    );
    noise.hot_pixels = Some(fit.hot.clone());
    let options = ProcedureOptions {
        frames: 64,
        ..ProcedureOptions::default()
    };
    let FlatFit { flat, rate_e_s, .. } =
        LitCamera::new(&mut camera, options, &mut |_| false, &mut || {})
            .flat_field(&noise)
            .unwrap();
    let true_rate = 0.4 * camera.sensor().config().responsivity;
    assert!((rate_e_s / true_rate - 1.0).abs() < 0.01, "{rate_e_s}");
    let truth = camera.sensor().relative_response();
    let good: Vec<usize> = (0..truth.len()).filter(|&p| !fit.hot[p]).collect();
    let mean = good.iter().map(|&p| f64::from(truth[p])).sum::<f64>() / good.len() as f64;
    let chi2: f64 = good
        .iter()
        .map(|&p| {
            let error = f64::from(flat.response[p]) - f64::from(truth[p]) / mean;
            (error / f64::from(flat.std_dev[p])).powi(2)
        })
        .sum();
    let n = good.len() as f64;
    assert!(
        (chi2 / n - 1.0).abs() < 5.0 * (2.0 / n).sqrt(),
        "chi2/n {}",
        chi2 / n
    );

    let (values, png) = to_map(&flat, 64, "flat.png").unwrap();
    let back = from_map(&values, &png, [64, 64]).unwrap();
    for (a, b) in back.response.iter().zip(&flat.response) {
        assert!((a - b).abs() < 2e-5);
    }
    assert!(from_map(&values, &png, [64, 32]).is_err());
    assert!(from_map(&values, &png[..png.len() / 2], [64, 64]).is_err());
}

#[test]
fn unsuitable_light_is_named() {
    let mut dim = camera(truth(1), 1);
    dim.radiance = 1e-4;
    assert!(matches!(
        calibrate(&mut dim),
        Err(ProcedureError::TooDim { .. })
    ));
    let mut bright = camera(truth(1), 1);
    bright.radiance = 1e4;
    assert!(matches!(
        calibrate(&mut bright),
        Err(ProcedureError::TooBright { .. })
    ));
}

#[test]
fn frames_that_do_not_suffice_are_refused() {
    let mut transfer = PhotonTransfer::default();
    transfer.add(Exposed::Dark, 0.1, &[64, 65]).unwrap();
    let error = transfer.add(Exposed::Dark, 0.1, &[64]).unwrap_err();
    assert!(error.to_string().contains("1 pixels"), "{error}");
    let error = transfer.solve(2, 12).unwrap_err();
    assert!(error.to_string().contains("dark frames: 1"), "{error}");
}

/// Sensors that bend downwards and upwards: the gain stays within 1%, and what is
/// merged of a bracket between 2% and 95% of saturation is right to 0.1% or a
/// twentieth of its standard deviation where, uncorrected, it is not.
#[test]
fn a_sensor_that_bends_is_corrected_within_its_uncertainty() {
    let mut pulls = Vec::new();
    for (seed, nonlinearity) in [(1, -0.015), (2, -0.015), (3, -0.03), (4, 0.02)] {
        let config = SensorConfig {
            nonlinearity,
            // The well is full before the converter is.
            gain_dn_per_e: 0.36,
            hot_fraction: 0.0,
            ..truth(300 + seed)
        };
        let mut camera = camera(config.clone(), seed);
        let fit = calibrate(&mut camera).unwrap();
        let v = &fit.values;
        let linearity = v.linearity.unwrap();
        let case = format!("{nonlinearity}: {v:?}");
        assert!(
            (v.gain_dn_per_e.value / config.gain_dn_per_e - 1.0).abs() < 0.01,
            "{case}"
        );
        assert!(
            (v.full_well_e.value / config.full_well_e - 1.0).abs() < 0.01,
            "{case}"
        );
        assert!(v.linearity_residual.unwrap() < 1e-3, "{case}");
        assert_eq!(v.linear_max_dn, v.saturation_dn, "{case}");
        // The truth at three levels: electrons that read as n (1 + q n / N).
        for part in [0.2, 0.5, 0.9] {
            let electrons = part * config.full_well_e;
            let read_dn = config.gain_dn_per_e * electrons * (1.0 + nonlinearity * part);
            let corrected = linearity.proportional_dn(read_dn);
            let std = linearity
                .variance(linearity.per_coefficient(read_dn))
                .sqrt();
            pulls.push((corrected - config.gain_dn_per_e * electrons) / std);
        }

        let mut noise = noise_without_maps(v, None, [64, 64]);
        noise.flat_field = Some(FlatField {
            response: camera.sensor().relative_response().to_vec(),
            std_dev: vec![0.0; 64 * 64],
        });
        // The scale is measured with the same gain, whose error cancels.
        noise.responsivity_e_s = config.responsivity * config.gain_dn_per_e / v.gain_dn_per_e.value;
        let uncorrected = SensorNoise {
            linearity: Linearity::NONE,
            ..noise.clone()
        };
        for part in [0.02, 0.6, 0.9] {
            let radiance = part * config.full_well_e / 0.016 / config.responsivity;
            let corrected = merged_error(&camera, &noise, radiance, seed);
            let (error, std) = corrected;
            assert!(
                error.abs() < f64::max(0.001 * radiance, 0.05 * std),
                "{part} of saturation: {error} of {radiance}, {case}"
            );
            let (error, std) = merged_error(&camera, &uncorrected, radiance, seed);
            if part > 0.5 {
                assert!(
                    error.abs() > f64::max(0.001 * radiance, 0.05 * std),
                    "{part} of saturation without correction: {error}, {case}"
                );
            }
        }
    }
    // Those of one sensor are correlated, so the tails are wide: 4 sensors count.
    let chi2 = pulls.iter().map(|p| p * p).sum::<f64>() / pulls.len() as f64;
    assert!((0.05..4.2).contains(&chi2), "{pulls:?}");
}

/// Mean error and mean standard deviation of an even radiance merged from three
/// exposures, the longest of 16 ms.
fn merged_error(camera: &EvenLight, noise: &SensorNoise, radiance: f64, seed: u64) -> (f64, f64) {
    let mut merge = BracketMerge::new(noise, Mosaic::None, 64, 64).unwrap();
    for (exposure, exposure_s) in (0..).zip([0.001, 0.004, 0.016]) {
        for (kind, role) in [(0, FrameRole::Light), (2, FrameRole::Dark)] {
            for repeat in 0..4 {
                let frame = MockFrameKey {
                    light: (radiance * 1e6) as u32,
                    exposure,
                    repeat,
                    kind,
                };
                let lit = if kind == 0 { radiance } else { 0.0 };
                let key = NoiseKey { seed, frame };
                let counts =
                    camera
                        .sensor()
                        .expose(&vec![lit as f32; 64 * 64], exposure_s, 1.0, key);
                merge.add(role, exposure_s, &counts).unwrap();
            }
        }
    }
    let merged = merge.finish().unwrap();
    let n = merged.mean.len() as f64;
    let error = merged.mean.iter().map(|&m| f64::from(m) - radiance);
    let std = merged.variance.iter().map(|&v| f64::from(v).sqrt());
    (error.sum::<f64>() / n, std.sum::<f64>() / n)
}

#[test]
fn a_sensor_that_bends_too_far_is_refused() {
    let config = SensorConfig {
        nonlinearity: -0.15,
        ..truth(4)
    };
    let error = calibrate(&mut camera(config, 1)).unwrap_err();
    let fact = error.to_string();
    assert!(
        matches!(
            error,
            ProcedureError::Sensor(SensorFitError::NotLinear { .. })
        ),
        "{fact}"
    );
    assert!(fact.contains("at most 3%"), "{fact}");
}

/// Offset and dark current of every pixel of four sensors with a strong pattern:
/// errors over stated uncertainties have variance 1; with the maps, faint light
/// merged without any dark frame has a fraction of the error, and unit pulls too.
#[test]
fn the_dark_pattern_is_recovered_within_its_uncertainty() {
    let mut chi2 = [0.0; 3];
    let mut n = 0.0;
    for seed in 0..4 {
        let config = SensorConfig {
            offset_dsnu_e: 3.0,
            dsnu_e_s: 8.0,
            dark_current_e_s: 40.0,
            ..truth(400 + seed)
        };
        let mut camera = camera(config.clone(), seed);
        let fit = calibrate(&mut camera).unwrap();
        let v = &fit.values;
        let (dark_values, maps) = fit.dark.to_values(64, "one").unwrap();
        let read = |map: &PixelMap, at: usize| map.read(&maps[at].1, [64, 64]).unwrap();
        let (offset_dn, dark_e_s) = (
            read(&dark_values.offset_dn, 0),
            read(&dark_values.dark_current_e_s, 1),
        );
        let [[offset_dn2, covariance], [_, dark_e2_s2]] = dark_values.covariance;
        let good: Vec<usize> = (0..64 * 64).filter(|&p| !fit.hot[p]).collect();
        let sensor = camera.sensor();
        for &p in &good {
            let true_dn =
                config.black_level_dn + config.gain_dn_per_e * f64::from(sensor.offset_e()[p]);
            let error_dn = v.black_level_dn.value + f64::from(offset_dn[p]) - true_dn;
            let error_e_s = v.dark_current_e_s.value + f64::from(dark_e_s[p])
                - f64::from(sensor.dark_current_e_s()[p]);
            chi2[0] += error_dn.powi(2) / offset_dn2;
            chi2[1] += error_e_s.powi(2) / dark_e2_s2;
        }
        // What is left of the pattern is far less than the pattern.
        assert!(offset_dn2.sqrt() < 0.25 * v.black_level_spread_dn.value);
        assert!(dark_e2_s2.sqrt() < 0.25 * v.dark_current_spread_e_s.value);

        let without = noise_without_maps(v, None, [64, 64]);
        let with = SensorNoise {
            dark_pattern: Some(DarkPattern {
                offset_dn,
                dark_current_e_s: dark_e_s,
                remaining_covariance: covariance,
            }),
            black_level_spread_dn: offset_dn2.sqrt(),
            dark_current_spread_e_s: dark_e2_s2.sqrt(),
            ..without.clone()
        };
        let rate_e_s = 60.0;
        let merged = |noise: &SensorNoise| {
            let mut merge = BracketMerge::new(noise, Mosaic::None, 64, 64).unwrap();
            for repeat in 0..16 {
                let frame = MockFrameKey {
                    light: 7,
                    exposure: 0,
                    repeat,
                    kind: 0,
                };
                let lit = vec![(rate_e_s / config.responsivity) as f32; 64 * 64];
                let counts = sensor.expose(&lit, 0.25, 1.0, NoiseKey { seed, frame });
                merge.add(FrameRole::Light, 0.25, &counts).unwrap();
            }
            merge.finish().unwrap()
        };
        let error = |p: usize, mean: f32| {
            f64::from(mean) - rate_e_s * f64::from(sensor.relative_response()[p])
        };
        let (plain, better) = (merged(&without), merged(&with));
        let sum = |plane: &crate::radiometry::plane::MergedPlane| -> f64 {
            good.iter().map(|&p| error(p, plane.mean[p]).powi(2)).sum()
        };
        assert!(sum(&better) < 0.3 * sum(&plain), "seed {seed}");
        for &p in &good {
            chi2[2] += error(p, better.mean[p]).powi(2) / f64::from(better.variance[p]);
        }
        n += good.len() as f64;
    }
    // The variances rest on spreads that each sensor's pixels tell to 1 or 2%.
    for (name, chi2) in ["offset", "dark current", "merged"].iter().zip(chi2) {
        assert!((chi2 / n - 1.0).abs() < 0.06, "{name}: {}", chi2 / n);
    }
}

/// A room that lights one side of the sensor by a tenth of the light: in dark
/// frames it is not, so the response tilts; ambient frames take it out.
#[test]
fn light_of_the_room_is_taken_out_of_a_flat_field() {
    let config = SensorConfig {
        hot_fraction: 0.0,
        ..truth(9)
    };
    let noise = SensorNoise {
        dark_current_e_s: config.dark_current_e_s,
        ..SensorNoise::ideal(config.gain_dn_per_e, config.read_noise_e, 64.0, 12)
    };
    let options = ProcedureOptions {
        frames: 64,
        ..ProcedureOptions::default()
    };
    let measure = |can_switch: bool| {
        let mut camera = camera(config.clone(), 6);
        camera.ambient = 0.04;
        let is_on = camera.is_on.clone();
        let response = camera.sensor().relative_response().to_vec();
        let mut switch = |on: bool| {
            is_on.store(on, std::sync::atomic::Ordering::Relaxed);
            true
        };
        let (mut cover, mut progress) = (|_| false, || {});
        let bench = LitCamera::new(&mut camera, options, &mut cover, &mut progress);
        let mut bench = match can_switch {
            true => bench.with_switch(&mut switch),
            false => bench,
        };
        let fit = bench.flat_field(&noise).unwrap();
        let mean = response.iter().map(|&r| f64::from(r)).sum::<f64>() / response.len() as f64;
        let chi2 = response.iter().enumerate().map(|(p, &r)| {
            let error = f64::from(fit.flat.response[p]) - f64::from(r) / mean;
            (error / f64::from(fit.flat.std_dev[p])).powi(2)
        });
        (chi2.sum::<f64>() / response.len() as f64, fit.ambient)
    };
    let (with, ambient) = measure(true);
    assert!(
        (with - 1.0).abs() < 5.0 * (2.0f64 / 4096.0).sqrt(),
        "{with}"
    );
    let ambient = ambient.unwrap();
    let truth = 0.1 * 63.0 / 128.0;
    assert!(
        (ambient.value - truth).abs() < 4.0 * ambient.std,
        "{ambient:?}"
    );
    let (without, none) = measure(false);
    assert!(without > 100.0 && none.is_none(), "{without}");
}

#[test]
fn a_light_that_stays_on_is_an_error() {
    let mut camera = camera(truth(9), 6);
    let noise = SensorNoise::ideal(0.38, 2.4, 64.0, 12);
    let (mut cover, mut progress, mut switch) = (|_| false, || {}, |_| false);
    let options = ProcedureOptions::default();
    let error = LitCamera::new(&mut camera, options, &mut cover, &mut progress)
        .with_switch(&mut switch)
        .flat_field(&noise)
        .unwrap_err();
    assert!(matches!(error, ProcedureError::NotOff), "{error}");
}
