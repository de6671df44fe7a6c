//! The irradiance from a white standard whose certificate and angle are off by
//! chance, as real ones are.

use std::f64::consts::PI;

use super::{EvaluateError, Recovered};
use crate::calibration::record::Measured;
use crate::calibration::white::{Region, WhiteStandard, irradiance};
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};

const SIDE: usize = 40;

/// The irradiance by one standard.
pub(super) fn white(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    let mut random = stream(seed, Purpose::Experiment, 2, 0, 0);
    let reflectance = Measured {
        value: 0.99,
        std: 0.005,
    };
    let (incidence_rad, incidence_std_rad) = (45f64.to_radians(), 0.2f64.to_radians());
    let true_reflectance = reflectance.value + reflectance.std * random.normal();
    let true_incidence_rad = incidence_rad + incidence_std_rad * random.normal();
    let truth = [3.0, 2.0, 1.0];
    let noise = 0.01;
    let mut image = RadianceImage::new(SIDE, SIDE);
    for pixel in 0..SIDE * SIDE {
        for (channel, irradiance) in truth.into_iter().enumerate() {
            let radiance = irradiance * true_reflectance * true_incidence_rad.cos() / PI;
            let std = noise * radiance;
            image.mean[pixel][channel] = (radiance + std * random.normal()) as f32;
            image.variance[pixel][channel] = (std * std) as f32;
        }
    }
    let region = Region {
        x: 0,
        y: 0,
        width: SIDE,
        height: SIDE,
    };
    let standard = WhiteStandard {
        reflectance,
        incidence_rad,
        incidence_std_rad,
    };
    let found = irradiance(&image, region, &standard)
        .map_err(|error| EvaluateError::Fact(error.to_string()))?;
    // The channels share certificate and angle, so one of them speaks for all.
    Ok(vec![Recovered {
        quantity: "irradiance",
        unit: "W/m²",
        truth: truth[1],
        found: found[1],
    }])
}
