//! Benches that differ from their description, and the prior that states by how much.

use nalgebra::DVector;

use crate::bench_priors::BenchPriors;
use crate::inverse::nuisance::{Nuisance, Parameter};
use crate::random::Stream;
use crate::transport::Scene;

/// Every light is off by this much, in a random direction.
const LIGHT_DEG: f64 = 0.5;
/// Standard deviation of each light's intensity, relative.
const INTENSITY: f64 = 0.02;
/// The sample is turned by this much about a random axis.
const ROTATION_DEG: f64 = 0.3;
/// The sample is moved by this much in a random direction: 0.3 mm for one of 50 mm.
const TRANSLATION_MM: f64 = 0.012;

/// Deviations that state these errors: the same mean square along each axis.
pub fn priors() -> BenchPriors {
    BenchPriors {
        light_rad: LIGHT_DEG.to_radians() / 2f64.sqrt(),
        stage_rad: 0.0,
        intensity: INTENSITY,
        common_intensity: 0.0,
        rotation_rad: ROTATION_DEG.to_radians() / 3f64.sqrt(),
        translation_mm: TRANSLATION_MM / 3f64.sqrt(),
        stray_light: 0.0,
        pose_covariance: None,
    }
}

/// `scene` as the description of a bench with the uncertainties of [`priors`].
pub fn bench(scene: &Scene) -> Nuisance {
    Nuisance::new(scene, &priors())
}

/// The misalignment of one bench: values of its parameters drawn with these errors.
pub fn draw(bench: &Nuisance, numbers: &mut Stream) -> DVector<f64> {
    let parameters = bench.parameters();
    let mut values = DVector::from_fn(parameters.len(), |_, _| numbers.normal());
    // What is scaled together to an exact length.
    let group = |parameter: &Parameter| match *parameter {
        Parameter::LightAzimuth(light) | Parameter::LightElevation(light) => {
            Some((2 + light, LIGHT_DEG.to_radians()))
        }
        Parameter::Rotation(_) => Some((0, ROTATION_DEG.to_radians())),
        Parameter::Translation(_) => Some((1, TRANSLATION_MM)),
        Parameter::Intensity(_) | Parameter::StrayLight(_) => None,
    };
    let drawn = values.clone();
    for (value, parameter) in values.iter_mut().zip(parameters) {
        *value *= match group(parameter) {
            Some((number, length)) => {
                let members = parameters.iter().zip(drawn.iter());
                let square: f64 = members
                    .filter(|(p, _)| group(p).is_some_and(|(n, _)| n == number))
                    .map(|(_, v)| v * v)
                    .sum();
                length / square.sqrt()
            }
            None => INTENSITY,
        };
    }
    values
}
