//! Photon transfer and flat field of a simulated sensor before an even light.

use super::{EvaluateError, Recovered, failed};
use crate::calibration::flat::FlatFit;
use crate::calibration::noise::noise_without_maps;
use crate::calibration::procedure::{LitCamera, ProcedureError, ProcedureOptions};
use crate::calibration::record::Measured;
use crate::calibration::sensor::SensorFit;
use crate::device::even_light::{EvenLight, SensorConfig};

const SIZE: [u32; 2] = [64, 64];
/// W/(m² sr).
const RADIANCE: f64 = 0.4;
/// Relative standard uncertainty of the light's certificate.
const CERTIFICATE: f64 = 0.005;

/// A sensor that is linear.
pub(super) fn sensor(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    photon_transfer(seed, 0.0)
}

/// One that loses 1.5% at the full well.
pub(super) fn bent(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    photon_transfer(seed, -0.015)
}

fn config(seed: u64, nonlinearity: f64) -> SensorConfig {
    SensorConfig {
        nonlinearity,
        hot_fraction: 1e-3,
        ..SensorConfig::typical(SIZE, seed)
    }
}

fn calibrate(camera: &mut EvenLight) -> Result<SensorFit, EvaluateError> {
    let bit_depth = camera.sensor().config().bit_depth;
    let mut ignore = || {};
    let transfer = LitCamera::new(
        camera,
        ProcedureOptions::default(),
        &mut covered,
        &mut ignore,
    )
    .photon_transfer()
    .map_err(failed)?;
    transfer.solve(SIZE[0] as usize, bit_depth).map_err(failed)
}

/// The simulated camera has a shutter.
fn covered(_: bool) -> bool {
    false
}

fn photon_transfer(seed: u64, nonlinearity: f64) -> Result<Vec<Recovered>, EvaluateError> {
    let config = config(seed, nonlinearity);
    let mut camera = EvenLight::new(config.clone(), RADIANCE, seed);
    let fit = calibrate(&mut camera)?;
    let v = &fit.values;
    let sensor = camera.sensor();
    let good: Vec<usize> = (0..fit.hot.len()).filter(|&p| !fit.hot[p]).collect();
    let mean =
        |map: &[f32]| good.iter().map(|&p| f64::from(map[p])).sum::<f64>() / good.len() as f64;
    let spread = |map: &[f32]| {
        let middle = mean(map);
        let squares = good.iter().map(|&p| (f64::from(map[p]) - middle).powi(2));
        (squares.sum::<f64>() / (good.len() - 1) as f64).sqrt()
    };
    let gain = config.gain_dn_per_e;
    let one = |quantity, unit, truth, found| Recovered {
        quantity,
        unit,
        truth,
        found,
    };
    let mut all = vec![
        one("system gain K", "DN/e⁻", gain, v.gain_dn_per_e),
        one("read noise", "e⁻", config.read_noise_e, v.read_noise_e),
        one(
            "black level",
            "DN",
            config.black_level_dn + gain * mean(sensor.offset_e()),
            v.black_level_dn,
        ),
        one(
            "spread of black level",
            "DN",
            gain * spread(sensor.offset_e()),
            v.black_level_spread_dn,
        ),
        one(
            "dark current",
            "e⁻/s",
            mean(sensor.dark_current_e_s()),
            v.dark_current_e_s,
        ),
        one(
            "spread of dark current",
            "e⁻/s",
            spread(sensor.dark_current_e_s()),
            v.dark_current_spread_e_s,
        ),
        one("full well", "e⁻", config.full_well_e, v.full_well_e),
    ];
    if let Some(linearity) = v.linearity {
        // What 90% of the full well reads as, and what the correction makes of it.
        let electrons = 0.9 * config.full_well_e;
        let read_dn = gain * electrons * (1.0 + nonlinearity * 0.9);
        let per_coefficient = linearity.per_coefficient(read_dn);
        all.push(one(
            "correction at 90% of full well",
            "",
            gain * electrons / read_dn,
            Measured {
                value: linearity.proportional_dn(read_dn) / read_dn,
                std: linearity.variance(per_coefficient).sqrt() / read_dn,
            },
        ));
    }
    let [[offset_dn2, _], [_, dark_e2_s2]] = fit.dark.covariance;
    for &p in &good {
        all.push(one(
            "offset of a pixel (DSNU)",
            "DN",
            config.black_level_dn + gain * f64::from(sensor.offset_e()[p]),
            Measured {
                value: v.black_level_dn.value + fit.dark.offset_dn[p],
                std: offset_dn2.sqrt(),
            },
        ));
        all.push(one(
            "dark current of a pixel (DSNU)",
            "e⁻/s",
            f64::from(sensor.dark_current_e_s()[p]),
            Measured {
                value: v.dark_current_e_s.value + fit.dark.dark_current_e_s[p],
                std: dark_e2_s2.sqrt(),
            },
        ));
    }
    Ok(all)
}

/// The flat field, and the scale by a light whose certificate is off by chance.
pub(super) fn flat(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    use crate::random::{Purpose, stream};
    let config = config(seed, 0.0);
    let off = CERTIFICATE * stream(seed, Purpose::Experiment, 1, 0, 0).normal();
    let mut camera = EvenLight::new(config.clone(), RADIANCE * (1.0 + off), seed);
    let fit = calibrate(&mut camera)?;
    let noise = noise_without_maps(&fit.values, None, SIZE);
    let options = ProcedureOptions {
        frames: 64,
        ..ProcedureOptions::default()
    };
    let mut ignore = || {};
    let FlatFit { flat, rate_e_s, .. } =
        LitCamera::new(&mut camera, options, &mut covered, &mut ignore)
            .flat_field(&noise)
            .map_err(|error: ProcedureError| failed(error))?;
    let response = camera.sensor().relative_response();
    let good: Vec<usize> = (0..fit.hot.len()).filter(|&p| !fit.hot[p]).collect();
    let mean = good.iter().map(|&p| f64::from(response[p])).sum::<f64>() / good.len() as f64;
    let gain = fit.values.gain_dn_per_e;
    let mut all = vec![Recovered {
        quantity: "responsivity",
        unit: "e⁻/s per W/(m² sr)",
        truth: config.responsivity * mean,
        found: Measured {
            value: rate_e_s / RADIANCE,
            std: rate_e_s / RADIANCE * CERTIFICATE.hypot(gain.std / gain.value),
        },
    }];
    all.extend(good.iter().map(|&p| Recovered {
        quantity: "response of a pixel (PRNU)",
        unit: "",
        truth: f64::from(response[p]) / mean,
        found: Measured {
            value: f64::from(flat.response[p]),
            std: f64::from(flat.std_dev[p]),
        },
    }));
    Ok(all)
}
