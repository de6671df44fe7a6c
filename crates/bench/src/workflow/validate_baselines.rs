//! What predicts the same pixels without a fit: a Lambertian of the same lights, and the
//! measured values of nearby angles.

use std::collections::HashMap;

use super::validate_pixels::Pixel;
use crate::radiance_image::RadianceImage;
use crate::statistics::quantile;

/// Pixels under a light that was fitted, with its image.
pub(super) type Fitted<'a> = (&'a [Pixel], &'a RadianceImage);

/// Albedo over π of the Lambertian whose direct light is closest to the images, by least squares,
/// R, G, B, 1/sr.
pub(super) fn lambertian(fitted: &[Fitted<'_>]) -> [f64; 3] {
    let mut sums = [[0.0; 2]; 3];
    for (pixels, image) in fitted {
        for pixel in *pixels {
            for (c, [product, square]) in sums.iter_mut().enumerate() {
                let irradiance = pixel.irradiance[c];
                *product += f64::from(image.mean[pixel.index][c]) * irradiance;
                *square += irradiance * irradiance;
            }
        }
    }
    sums.map(|[product, square]| if square > 0.0 { product / square } else { 0.0 })
}

/// Fewest fitted lights for which neighbours are stated: with fewer there are none near enough.
pub(super) const LEAST_LIGHTS: usize = 6;
/// Values whose median is a prediction.
const NEIGHBOURS: usize = 32;
/// Rings of boxes around an angle that are searched, at most.
const LARGEST_RING: i32 = 8;
/// Most values that are kept.
const LARGEST: usize = 400_000;

/// Radiance over irradiance of the fitted pixels by (θh, θd), in boxes of about equal effect: the
/// root of θh, which resolves the highlight, and a third of θd.
pub(super) struct Neighbours {
    boxes: HashMap<[i32; 2], Vec<[f64; 3]>>,
    found: HashMap<[i32; 2], Option<[f64; 3]>>,
}

/// The box of a pixel.
fn box_of(pixel: &Pixel) -> [i32; 2] {
    let root = 4.0 * pixel.theta_h_rad.to_degrees().sqrt();
    [root, pixel.theta_d_rad.to_degrees() * 0.35].map(|place| (2.0 * place).round() as i32)
}

impl Neighbours {
    /// Of these lights; `None` if they are too few.
    pub fn of(fitted: &[Fitted<'_>]) -> Option<Self> {
        if fitted.len() < LEAST_LIGHTS {
            return None;
        }
        let count: usize = fitted.iter().map(|(pixels, _)| pixels.len()).sum();
        let step = count.div_ceil(LARGEST).max(1);
        let mut boxes: HashMap<_, Vec<_>> = HashMap::new();
        let all = fitted.iter().flat_map(|(pixels, image)| {
            let with_image = move |pixel| (pixel, *image);
            pixels.iter().map(with_image)
        });
        for (pixel, image) in all.step_by(step) {
            let mean = image.mean[pixel.index];
            let over = |c: usize| f64::from(mean[c]) / pixel.irradiance[c].max(f64::MIN_POSITIVE);
            boxes
                .entry(box_of(pixel))
                .or_default()
                .push([0, 1, 2].map(over));
        }
        let found = HashMap::new();
        Some(Self { boxes, found })
    }

    /// Median of the nearest values, R, G, B, 1/sr; `None` where none is near.
    pub fn at(&mut self, pixel: &Pixel) -> Option<[f64; 3]> {
        let place = box_of(pixel);
        if let Some(found) = self.found.get(&place) {
            return *found;
        }
        let mut values: Vec<[f64; 3]> = Vec::new();
        for ring in 0..=LARGEST_RING {
            for h in -ring..=ring {
                for d in -ring..=ring {
                    if h.abs().max(d.abs()) == ring {
                        let near = self.boxes.get(&[place[0] + h, place[1] + d]);
                        values.extend(near.into_iter().flatten());
                    }
                }
            }
            if values.len() >= NEIGHBOURS {
                break;
            }
        }
        let median = |c: usize| {
            let channel: Vec<f64> = values.iter().map(|value| value[c]).collect();
            quantile(&channel, 0.5)
        };
        let found = (!values.is_empty()).then(|| [0, 1, 2].map(median));
        self.found.insert(place, found);
        found
    }
}
