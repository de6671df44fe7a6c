//! The pixels of an image that a prediction is compared in, with their angles.

use glam::DVec2;
use rayon::prelude::*;

use crate::brdf::HalfDifference;
use crate::radiance_image::RadianceImage;
use crate::session::validation::LeftOut;
use crate::transport::Scene;

/// Half angle up to which a pixel counts to the highlight, radians.
pub(super) const HIGHLIGHT_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;
/// Least cosine between normal and light: below, a pixel is nearly grazed and its error is that
/// of the sample's shape.
const LEAST_COSINE: f32 = 0.05;

/// A pixel that is compared.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pixel {
    /// Its index, row by row.
    pub index: usize,
    /// Half angle at its middle, radians.
    pub theta_h_rad: f64,
    /// Difference angle at its middle, radians.
    pub theta_d_rad: f64,
    /// Irradiance of the surface at its middle by the lamp alone, R, G, B, in the scene's unit.
    pub irradiance: [f64; 3],
}

impl Pixel {
    /// Whether it lies in the highlight.
    pub fn is_highlight(&self) -> bool {
        self.theta_h_rad <= HIGHLIGHT_RAD
    }
}

/// The pixels whose middle and corners all show the sample; the same for all lights.
pub(super) fn of_sample(scene: &Scene) -> Vec<usize> {
    /// Middle and corners, pixels from the top left corner.
    const PLACES: [[f64; 2]; 5] = [
        [0.5, 0.5],
        [0.02, 0.02],
        [0.98, 0.02],
        [0.02, 0.98],
        [0.98, 0.98],
    ];
    let pixels = (0..scene.camera.pixels()).into_par_iter();
    let is_whole = |&index: &usize| {
        PLACES.iter().all(|&place| {
            let ray = scene
                .camera
                .ray(position_px(scene, index, place), DVec2::ZERO);
            let found = scene.first(&ray);
            found.is_some_and(|(surface, _)| surface.is_sample())
        })
    };
    pixels.filter(is_whole).collect()
}

/// A place in a pixel as a position on the sensor, pixels.
fn position_px(scene: &Scene, index: usize, place: [f64; 2]) -> DVec2 {
    let width = scene.camera.resolution_px[0];
    DVec2::new((index % width) as f64, (index / width) as f64) + DVec2::from(place)
}

/// Those that are compared under a light, and what is left out.
pub(super) fn compared(
    scene: &Scene,
    light: usize,
    sample: &[usize],
    image: &RadianceImage,
    mask: Option<&[bool]>,
) -> (Vec<Pixel>, LeftOut) {
    let strength = scene.lights[light].strength();
    let pixel = |index: usize| -> Result<Pixel, LeftOut> {
        let mut left_out = LeftOut::default();
        if mask.is_some_and(|mask| !mask[index]) {
            left_out.masked = 1;
            return Err(left_out);
        }
        if !image.valid[index] || image.mean[index].iter().any(|value| !value.is_finite()) {
            left_out.invalid = 1;
            return Err(left_out);
        }
        let ray = scene
            .camera
            .ray(position_px(scene, index, [0.5; 2]), DVec2::ZERO);
        let lit = scene.first(&ray).and_then(|(surface, to_viewer)| {
            let lit = scene.connect(&surface, light, [0.5; 2])?;
            (lit.to_light.z > LEAST_COSINE).then_some((lit, to_viewer))
        });
        let Some((lit, to_viewer)) = lit else {
            left_out.unlit = 1;
            return Err(left_out);
        };
        let angles = HalfDifference::from_directions(lit.to_light.as_dvec3(), to_viewer.as_dvec3());
        Ok(Pixel {
            index,
            theta_h_rad: angles.theta_h_rad,
            theta_d_rad: angles.theta_d_rad,
            irradiance: strength.map(|strength| strength * f64::from(lit.irradiance)),
        })
    };
    let found: Vec<_> = sample.par_iter().map(|&index| pixel(index)).collect();
    let (mut pixels, mut left_out) = (Vec::with_capacity(found.len()), LeftOut::default());
    for found in found {
        match found {
            Ok(pixel) => pixels.push(pixel),
            Err(one) => left_out += one,
        }
    }
    (pixels, left_out)
}
