//! Each light of a bench from a diffuse standard captured under all of them: its intensity
//! against the others', and how evenly it lights the sample's position.

use glam::{DVec2, DVec3};
use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

use super::record::Measured;
use super::white::{MOST_INCIDENCE_RAD, Region, WhiteError, WhiteStandard, irradiance};
use crate::radiance_image::RadianceImage;
use crate::transport::falloff::Falloff;
use crate::transport::{Camera, Light};
use crate::units::StageAngles;

/// One light, as the standard showed it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightIntensity {
    /// Azimuth and elevation as the stage or the rig file has them, degrees.
    pub stage_deg: [f64; 2],
    /// Irradiance for R, G and B over the mean of all lights'.
    pub relative: [Measured; 3],
    /// How it differs over the sample beyond what the light's position explains: factor
    /// 1 + s·(x, y) + c·(x², xy, y²), per millimetre and per square millimetre.
    pub slope_per_mm: [f64; 2],
    /// See `slope_per_mm`.
    pub curve_per_mm2: [f64; 3],
    /// Root mean square of what the standard shows beyond that factor, relative, noise
    /// taken out.
    pub uneven: f64,
}

impl LightIntensity {
    /// The factor over the sample.
    pub fn falloff(&self) -> Falloff {
        Falloff {
            slope_per_mm: self.slope_per_mm,
            curve_per_mm2: self.curve_per_mm2,
        }
    }

    /// Whether it is the light at these angles.
    pub fn is_at(&self, angles: StageAngles) -> bool {
        let own = StageAngles::new(self.stage_deg[0], self.stage_deg[1]);
        own.to_light().angle_between(angles.to_light()).to_degrees() < SAME_LIGHT_DEG
    }
}

/// How far from its earlier position a stage may return.
const SAME_LIGHT_DEG: f64 = 0.3;

/// A standard in place of the sample, under several lights.
pub struct WhiteLights<'a> {
    /// The camera of the images.
    pub camera: &'a Camera,
    /// The standard's own pixels.
    pub region: Region,
    /// Height of its surface above the sample's datum, millimetres; it lies level.
    pub height_mm: f64,
    /// Its certificate; the incidence is each light's own.
    pub standard: WhiteStandard,
    /// Standard deviation of its radiance factor between directions, relative.
    pub direction_std: f64,
    /// The lights as the rig has them, and the angles they are known by.
    pub lights: &'a [(Light, StageAngles)],
}

impl WhiteLights<'_> {
    /// Usual standard deviation of the radiance factor between directions, relative.
    pub const DIRECTION_STD: f64 = 0.01;
}

/// What was found.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundLights {
    /// Mean strength of the lights over what the rig has it, for R, G and B.
    pub strength: [Measured; 3],
    /// By light.
    pub lights: Vec<LightIntensity>,
}

impl WhiteLights<'_> {
    /// Intensities and falloffs from one image per light.
    ///
    /// # Errors
    /// See [`WhiteError`]: of the first light whose image does not show an evenly lit
    /// standard.
    pub fn measure(&self, images: &[RadianceImage]) -> Result<FoundLights, WhiteError> {
        let mut each = Vec::new();
        for ((light, _), image) in self.lights.iter().zip(images) {
            each.push(self.one(light, image)?);
        }
        let count = each.len() as f64;
        let mean: [f64; 3] =
            std::array::from_fn(|c| each.iter().map(|e| e.strength[c]).sum::<f64>() / count);
        // The certificate is common to all lights; noise, angles and directions are not.
        let certificate = self.standard.reflectance.std / self.standard.reflectance.value;
        let own = |e: &One, c: usize| e.relative_std[c].hypot(self.direction_std);
        let strength = std::array::from_fn(|c| {
            let apart: f64 = each.iter().map(|e| own(e, c).powi(2)).sum();
            let relative = certificate.hypot(apart.sqrt() / count);
            Measured::new(mean[c], mean[c] * relative)
        });
        let lights = each.iter().zip(self.lights).map(|(e, (_, angles))| {
            let relative = std::array::from_fn(|c| {
                let value = e.strength[c] / mean[c];
                // A light's own error is also in the mean that it is divided by.
                let others: f64 = each.iter().map(|e| own(e, c).powi(2)).sum::<f64>();
                let own2 = own(e, c).powi(2);
                let variance = own2 * (1.0 - 2.0 / count) + others / (count * count);
                Measured::new(value, value * variance.max(0.0).sqrt())
            });
            LightIntensity {
                stage_deg: [angles.azimuth_deg, angles.elevation_deg],
                relative,
                slope_per_mm: e.falloff.slope_per_mm,
                curve_per_mm2: e.falloff.curve_per_mm2,
                uneven: e.uneven,
            }
        });
        Ok(FoundLights {
            strength,
            lights: lights.collect(),
        })
    }

    /// Irradiance of a light of unit strength at a point of the standard: across the light,
    /// times the cosine there.
    fn expected(&self, light: &Light, place: DVec3) -> f64 {
        let sample = light.sample(place.as_vec3(), [0.5; 2]);
        f64::from(sample.relative_irradiance) * f64::from(sample.direction.z).max(0.0)
    }

    fn one(&self, light: &Light, image: &RadianceImage) -> Result<One, WhiteError> {
        // A standard that lies level is lit from above alone.
        let above = DVec3::new(0.0, 0.0, self.height_mm).as_vec3();
        let towards = light.sample(above, [0.5; 2]);
        let cosine = f64::from(towards.direction.z).clamp(-1.0, 1.0);
        let incidence_rad = cosine.acos();
        if incidence_rad > MOST_INCIDENCE_RAD {
            let degrees = incidence_rad.to_degrees();
            return Err(WhiteError::Incidence { degrees });
        }
        // As an evenly lit standard: the falloff that the light's position explains is taken
        // out first.
        let (left, top) = (self.region.x, self.region.y);
        let mut flat = RadianceImage::new(image.width, image.height);
        flat.valid.clone_from(&image.valid);
        let mut places = vec![None; image.width * image.height];
        let inside = left.saturating_add(self.region.width) <= image.width
            && top.saturating_add(self.region.height) <= image.height;
        let rows = if inside {
            top..top + self.region.height
        } else {
            0..0
        };
        let middle = self.expected(light, DVec3::new(0.0, 0.0, self.height_mm));
        for y in rows {
            for x in left..left + self.region.width {
                let pixel = y * image.width + x;
                let place = self.place(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
                let factor = place.map_or(0.0, |p| self.expected(light, p)) / middle;
                if !(factor > 1e-6 && factor.is_finite()) {
                    flat.valid[pixel] = false;
                    continue;
                }
                places[pixel] = place;
                flat.mean[pixel] = image.mean[pixel].map(|m| m / factor as f32);
                flat.variance[pixel] = image.variance[pixel].map(|v| v / (factor * factor) as f32);
            }
        }
        // What remains over the standard, as a polynomial.
        let (falloff, spread) = self.falloff(&flat, &places);
        if spread.is_infinite() {
            // Too few pixels for a polynomial are too few for a standard.
            return Err(self.outside(image));
        }
        let factors = self
            .inner(&flat, &places)
            .map(|(p, ..)| falloff.at(p.as_vec3()));
        let most = factors
            .map(|f| f64::from(f - 1.0).abs())
            .fold(0.0, f64::max);
        if most > MOST_FALLOFF {
            let percent = 100.0 * most;
            return Err(WhiteError::Uneven { percent });
        }
        // The evenness that counts is that beyond the falloff.
        for (pixel, place) in places.iter().enumerate() {
            if let Some(place) = place {
                let factor = falloff.at(place.as_vec3()).max(1e-3);
                flat.mean[pixel] = flat.mean[pixel].map(|m| m / factor);
                flat.variance[pixel] = flat.variance[pixel].map(|v| v / (factor * factor));
            }
        }
        let uneven = self.uneven(&flat, &places);
        // The intensity.
        let exact = WhiteStandard {
            reflectance: Measured {
                std: 0.0,
                ..self.standard.reflectance
            },
            incidence_rad,
            incidence_std_rad: 0.0,
        };
        let found = irradiance(&flat, self.region, &exact)?;
        let here = f64::from(towards.relative_irradiance);
        let stated = light.strength();
        let angle = (1.0 - cosine * cosine).sqrt() / cosine * self.standard.incidence_std_rad;
        Ok(One {
            strength: std::array::from_fn(|c| found[c].value / (here * stated[c])),
            relative_std: found.map(|m| (m.std / m.value * spread).hypot(angle)),
            falloff,
            uneven,
        })
    }

    /// The point of the standard that a sensor position sees.
    fn place(&self, at_px: DVec2) -> Option<DVec3> {
        let (origin, direction) = self.camera.chief_ray(at_px);
        let to_sample = &self.camera.sample_from_camera;
        let (from, along) = (to_sample.point(origin), to_sample.direction(direction));
        let t = (self.height_mm - from.z) / along.z;
        (t.is_finite() && t > 0.0).then(|| from + along * t)
    }

    /// Pixels well inside the standard: position, green radiance or the channels' mean, variance.
    fn inner<'p>(
        &self,
        image: &'p RadianceImage,
        places: &'p [Option<DVec3>],
    ) -> impl Iterator<Item = (DVec3, f64, f64)> + 'p {
        let margin = |n: usize| (MARGIN * n as f64).ceil() as usize;
        let Region {
            x,
            y,
            width,
            height,
        } = self.region;
        let columns = x + margin(width)..(x + width).saturating_sub(margin(width));
        let rows = y + margin(height)..(y + height).saturating_sub(margin(height));
        places.iter().enumerate().filter_map(move |(pixel, place)| {
            let (column, row) = (pixel % image.width, pixel / image.width);
            let wanted = columns.contains(&column) && rows.contains(&row) && image.valid[pixel];
            let place = (*place).filter(|_| wanted)?;
            let mean = image.mean[pixel].map(f64::from).iter().sum::<f64>() / 3.0;
            let variance = image.variance[pixel].map(f64::from).iter().sum::<f64>() / 9.0;
            Some((place, mean, variance))
        })
    }

    fn outside(&self, image: &RadianceImage) -> WhiteError {
        let Region {
            x,
            y,
            width,
            height,
        } = self.region;
        WhiteError::Region {
            x,
            y,
            width,
            height,
            image_width: image.width,
            image_height: image.height,
        }
    }

    /// The polynomial through what the standard shows, 1 at the datum's axis, and how many
    /// times its value there is less certain than the pixels' mean; infinite where they
    /// do not determine it.
    fn falloff(&self, flat: &RadianceImage, places: &[Option<DVec3>]) -> (Falloff, f64) {
        let mut matrix = Matrix6::zeros();
        let mut right = Vector6::zeros();
        for (place, value, _) in self.inner(flat, places) {
            let (x, y) = (place.x, place.y);
            let row = Vector6::new(1.0, x, y, x * x, x * y, y * y);
            matrix += row * row.transpose();
            right += row * value;
        }
        let pixels = matrix[(0, 0)];
        let Some(factor) = matrix.cholesky() else {
            return (Falloff::default(), f64::INFINITY);
        };
        let found = factor.solve(&right);
        let spread = (pixels * factor.inverse()[(0, 0)]).sqrt();
        let even = found[0];
        if even <= 0.0 || !even.is_finite() {
            // Dark: reported for the standard as a whole.
            return (Falloff::default(), spread);
        }
        let falloff = Falloff {
            slope_per_mm: [found[1] / even, found[2] / even],
            curve_per_mm2: [found[3] / even, found[4] / even, found[5] / even],
        };
        (falloff, spread)
    }

    /// Scatter of the pixels about their mean beyond noise, relative.
    fn uneven(&self, flat: &RadianceImage, places: &[Option<DVec3>]) -> f64 {
        let (mut n, mut sum, mut sum2, mut noise) = (0.0, 0.0, 0.0, 0.0);
        for (_, value, variance) in self.inner(flat, places) {
            n += 1.0;
            sum += value;
            sum2 += value * value;
            noise += variance;
        }
        if n < 2.0 || sum <= 0.0 {
            return 0.0;
        }
        let mean = sum / n;
        ((sum2 / n - mean * mean - noise / n).max(0.0)).sqrt() / mean
    }
}

/// Part of the region on each side that is ignored, as for one light.
const MARGIN: f64 = 0.15;

/// A light that falls off by more over the standard does not light it evenly.
const MOST_FALLOFF: f64 = 0.5;

/// One light by itself.
struct One {
    /// Over what the rig has it.
    strength: [f64; 3],
    relative_std: [f64; 3],
    falloff: Falloff,
    uneven: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};
    use crate::simulation::white_standard::{
        FACTORS, HEIGHT_MM, SIDE, at, camera, lights, photograph, shape,
    };

    const REGION: Region = Region {
        x: 6,
        y: 6,
        width: 48,
        height: 48,
    };

    fn white<'a>(
        camera: &'a Camera,
        lights: &'a [(Light, StageAngles)],
        std: f64,
        direction_std: f64,
    ) -> WhiteLights<'a> {
        WhiteLights {
            camera,
            region: REGION,
            height_mm: HEIGHT_MM,
            standard: WhiteStandard {
                reflectance: Measured { value: 0.99, std },
                incidence_rad: 0.0,
                incidence_std_rad: 0.0,
            },
            direction_std,
            lights,
        }
    }

    /// 32 standards that differ from their certificate, and between directions, as stated:
    /// errors over stated uncertainties are a unit normal, χ² between the 1e-5 tails of
    /// χ²(32) for the scale, χ²(64) for the intensities (three of which two are free).
    #[test]
    fn intensities_and_falloffs_are_recovered_within_their_uncertainty() {
        let (camera, lights) = (camera(), lights());
        let mean = FACTORS.iter().sum::<f64>() / 3.0;
        for direction_std in [0.0, 0.01] {
            let white = white(&camera, &lights, 0.005, direction_std);
            let (mut scale2, mut relative2) = (0.0, 0.0);
            for seed in 0..32 {
                let mut random = stream(5, Purpose::Experiment, seed, 0, 0);
                let reflectance = 0.99 + 0.005 * random.normal();
                let images: Vec<_> = (0..3)
                    .map(|light| {
                        let here = reflectance * (1.0 + direction_std * random.normal());
                        photograph(light, FACTORS[light], here, seed)
                    })
                    .collect();
                let found = white.measure(&images).unwrap();
                scale2 += ((found.strength[1].value - mean) / found.strength[1].std).powi(2);
                for (k, light) in found.lights.iter().enumerate() {
                    let relative = light.relative[1];
                    let truth = FACTORS[k] / mean;
                    // The three sum to a constant: two thirds of a degree of freedom each.
                    relative2 += ((relative.value - truth) / relative.std).powi(2) * 2.0 / 3.0;
                    let [slope, bend] = shape(k);
                    assert!((light.slope_per_mm[0] - slope).abs() < 4e-4, "{light:?}");
                    assert!((light.curve_per_mm2[1] - bend).abs() < 8e-5, "{light:?}");
                    assert!(light.slope_per_mm[1].abs() < 4e-4 && light.uneven < 0.01);
                    assert!(light.is_at(lights[k].1) && !light.is_at(at(0.0, 61.0)));
                }
            }
            assert!((9.0..77.0).contains(&scale2), "{direction_std}: {scale2}");
            assert!(
                (27.0..122.0).contains(&relative2),
                "{direction_std}: {relative2}"
            );
        }
    }

    /// A lamp below the horizon of a standard that lies level.
    #[test]
    fn a_light_that_does_not_reach_the_standard_is_named_by_its_incidence() {
        let (camera, mut lights) = (camera(), lights());
        lights[0].0 = Light::distant(DVec3::new(1.0, 0.0, -0.02), [1.0; 3]);
        let found = white(&camera, &lights, 0.005, 0.0).measure(&[photograph(0, 1.0, 0.99, 1)]);
        assert!(
            matches!(found, Err(WhiteError::Incidence { degrees }) if (91.0..92.0).contains(&degrees)),
            "{found:?}"
        );
    }

    #[test]
    fn what_is_no_evenly_lit_standard_is_refused() {
        let (camera, lights) = (camera(), lights());
        let good: Vec<_> = (0..3).map(|k| photograph(k, FACTORS[k], 0.99, 1)).collect();
        let mut outside = white(&camera, &lights, 0.005, 0.0);
        outside.region.x = 40;
        let error = outside.measure(&good).unwrap_err();
        assert!(matches!(error, WhiteError::Region { .. }), "{error}");
        let mut shadowed = good.clone();
        for (pixel, mean) in shadowed[2].mean.iter_mut().enumerate() {
            if pixel % SIDE > 38 {
                *mean = [0.0; 3];
            }
        }
        let white = white(&camera, &lights, 0.005, 0.0);
        let error = white.measure(&shadowed).unwrap_err();
        assert!(matches!(error, WhiteError::Uneven { .. }), "{error}");
        let mut dark = good;
        dark[0].mean.fill([0.0; 3]);
        let error = white.measure(&dark).unwrap_err();
        assert!(matches!(error, WhiteError::Dark { .. }), "{error}");
    }
}
