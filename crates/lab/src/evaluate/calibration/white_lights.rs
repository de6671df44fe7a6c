//! The strength of each light by a white standard that differs from its certificate, and
//! between directions, by chance.

use super::{EvaluateError, Recovered, failed};
use crate::calibration::record::Measured;
use crate::calibration::white::{Region, WhiteStandard};
use crate::calibration::white_lights::WhiteLights;
use crate::random::{Purpose, stream};
use crate::simulation::white_standard::{FACTORS, HEIGHT_MM, camera, lights, photograph};

const REFLECTANCE: Measured = Measured {
    value: 0.99,
    std: 0.005,
};
/// Relative standard deviation of the reflectance between directions.
const DIRECTION_STD: f64 = 0.01;

/// Three lights, one far and two near.
pub(super) fn white_lights(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    let (camera, lights) = (camera(), lights());
    let mut random = stream(seed, Purpose::Experiment, 3, 0, 0);
    let reflectance = REFLECTANCE.value + REFLECTANCE.std * random.normal();
    let images: Vec<_> = FACTORS
        .into_iter()
        .enumerate()
        .map(|(light, factor)| {
            let here = reflectance * (1.0 + DIRECTION_STD * random.normal());
            photograph(light, factor, here, seed)
        })
        .collect();
    let white = WhiteLights {
        camera: &camera,
        region: Region {
            x: 6,
            y: 6,
            width: 48,
            height: 48,
        },
        height_mm: HEIGHT_MM,
        standard: WhiteStandard {
            reflectance: REFLECTANCE,
            incidence_rad: 0.0,
            incidence_std_rad: 0.0,
        },
        direction_std: DIRECTION_STD,
        lights: &lights,
    };
    let found = white.measure(&images).map_err(failed)?;
    let mean = FACTORS.iter().sum::<f64>() / FACTORS.len() as f64;
    // The channels share certificate and directions, so one of them speaks for all.
    let mut all = vec![Recovered {
        quantity: "strength of all lights",
        unit: "",
        truth: mean,
        found: found.strength[1],
    }];
    // Relative strengths have a mean of 1: the last one follows from the others.
    for (light, factor) in found.lights.iter().zip(FACTORS).take(FACTORS.len() - 1) {
        all.push(Recovered {
            quantity: "strength of a light over their mean",
            unit: "",
            truth: factor / mean,
            found: light.relative[1],
        });
    }
    Ok(all)
}
