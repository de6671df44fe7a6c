//! The middle of a lamp's highlight on a sphere: a centroid under a Gaussian window that
//! follows it, above the shading around it.

use glam::{DMat2, DVec2};

use super::clipped::Core;
use super::{Circle, Grey, Sphere, SphereError};
use crate::statistics::{STD_OVER_MAD, median};

/// Where a highlight is in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Highlight {
    /// Pixels from the top left corner.
    pub position_px: DVec2,
    /// Covariance, pixels².
    pub covariance_px2: DMat2,
    /// Its standard deviation across, pixels, blur and pixel included.
    pub spread_px: f64,
    /// Its light over the noise of it.
    pub deviations: f64,
}

/// Highlights further out than this part of the radius are not looked for: there a pixel
/// spans many degrees.
const OUTERMOST: f64 = 0.95;
/// Window over the highlight's own spread, and its least, pixels.
const WINDOW: (f64, f64) = (2.0, 1.5);
/// How far a highlight stands out at least: over its surroundings, and over the noise.
const LEAST: (f64, f64) = (1.5, 10.0);
/// A second highlight with more of the first's light than this is one too many.
const SECOND: f64 = 0.1;
const ROUNDS: usize = 100;

/// Finds the highlight on a sphere in image number `index`.
///
/// # Errors
/// There is none, too much of it is saturated, or there are two.
pub fn find(image: &Grey, sphere: &Sphere, index: usize) -> Result<Highlight, SphereError> {
    let circle = sphere.circle;
    let disc = disc(image, &circle);
    let missing = |contrast: f64, deviations: f64| SphereError::NoHighlight {
        image: index,
        x: circle.centre_px.x,
        y: circle.centre_px.y,
        contrast,
        deviations,
    };
    let Some(peak) = brightest(image, &disc, |_| true) else {
        return Err(missing(0.0, 0.0));
    };
    let saturated = |around: DVec2, pixels: usize| SphereError::Saturated {
        image: index,
        x: around.x,
        y: around.y,
        pixels,
    };
    // Clipped pixels are invalid: the brightest valid one then lies at their edge.
    let at_peak = image.position(peak);
    let core = Core::at(image, &circle, at_peak, 2.3)
        .map_err(|refused| saturated(at_peak, refused.pixels))?;
    let filled = core.as_ref().map(|core| core.filled(image));
    let image = filled.as_ref().unwrap_or(image);
    let clipped = |around: DVec2, radius: f64| {
        let near = |p: &&usize| image.position(**p).distance(around) <= radius;
        disc.iter()
            .filter(near)
            .filter(|&&p| !image.valid[p])
            .count()
    };
    let spot = Spot::follow(image, sphere, &disc, at_peak);
    if spot.contrast < LEAST.0 || spot.deviations() < LEAST.1 {
        return Err(missing(spot.contrast, spot.deviations()));
    }
    match clipped(spot.middle, spot.spread().max(1.0)) {
        0 => {}
        pixels => return Err(saturated(spot.middle, pixels)),
    }
    let apart = 3.5 * spot.window_px + 2.0;
    let far = |p: usize| image.position(p).distance(spot.middle) > apart;
    if let Some(second) = brightest(image, &disc, far) {
        let other = Spot::follow(image, sphere, &disc, image.position(second));
        let stays = other.middle.distance(spot.middle) > apart - 1.0;
        if stays
            && other.contrast > LEAST.0
            && other.deviations() > LEAST.1
            && other.light > SECOND * spot.light
        {
            return Err(SphereError::TwoHighlights {
                image: index,
                first: spot.middle.to_array(),
                second: other.middle.to_array(),
                percent: 100.0 * other.light / spot.light,
            });
        }
    }
    let mut found = spot.highlight(sphere);
    let cut_px = core.map_or(0.0, |core| core.std_px());
    found.covariance_px2 += DMat2::from_diagonal(DVec2::splat(cut_px * cut_px));
    Ok(found)
}

/// Roughly where a sphere is brightest.
pub(super) fn brightest_on(image: &Grey, circle: &Circle) -> Option<DVec2> {
    let brightest = brightest(image, &disc(image, circle), |_| true)?;
    Some(image.position(brightest))
}

fn disc(image: &Grey, circle: &Circle) -> Vec<usize> {
    let inside =
        |&p: &usize| image.position(p).distance(circle.centre_px) < OUTERMOST * circle.radius_px;
    (0..image.value.len()).filter(inside).collect()
}

/// The valid pixel with the brightest mean over itself and its valid neighbours.
fn brightest(image: &Grey, disc: &[usize], allowed: impl Fn(usize) -> bool) -> Option<usize> {
    let mean = |p: usize| {
        let (x, y) = (p % image.width, p / image.width);
        let (mut sum, mut n) = (0.0, 0.0);
        for row in y.saturating_sub(1)..=(y + 1).min(image.height - 1) {
            for column in x.saturating_sub(1)..=(x + 1).min(image.width - 1) {
                let q = row * image.width + column;
                if image.valid[q] {
                    sum += image.value[q];
                    n += 1.0;
                }
            }
        }
        sum / n
    };
    disc.iter()
        .copied()
        .filter(|&p| image.valid[p] && allowed(p))
        .map(|p| (p, mean(p)))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(p, _)| p)
}

/// Moments of what stands out in a window.
struct Spot {
    middle: DVec2,
    /// Error of the middle, estimated from this window.
    shift: DVec2,
    window_px: f64,
    /// Windowed second moments about the middle, of the light's sum.
    moments: DMat2,
    light: f64,
    light_variance: f64,
    /// Σ W² (x − middle)(x − middle)ᵀ var.
    noise: DMat2,
    /// Σ W I (1 − (x − middle)(x − middle)ᵀ / window²).
    gain: DMat2,
    contrast: f64,
}

fn outer(a: DVec2) -> DMat2 {
    DMat2::from_cols(a * a.x, a * a.y)
}

impl Spot {
    /// Follows the light from `start` until the window stands still.
    fn follow(image: &Grey, sphere: &Sphere, disc: &[usize], start: DVec2) -> Self {
        let mut window_px = 1.5f64.max(1.2 * sphere.blur_px);
        let widest = (0.2 * sphere.circle.radius_px).max(2.0);
        let mut spot = Self::measure(image, disc, start, window_px);
        for _ in 0..ROUNDS {
            let wanted = (WINDOW.0 * spot.spread()).clamp(WINDOW.1, widest);
            let shift = spot.shift;
            window_px += (wanted - window_px).clamp(-0.5, 0.5);
            let next = Self::measure(image, disc, spot.middle + shift, window_px);
            let still = shift.length() < 1e-6 && (wanted - window_px).abs() < 1e-3;
            spot = next;
            if still || spot.light <= 0.0 {
                break;
            }
        }
        spot
    }

    fn measure(image: &Grey, disc: &[usize], middle: DVec2, window_px: f64) -> Self {
        let background = Plane::around(image, disc, middle, window_px);
        let mut spot = Self {
            middle,
            shift: DVec2::ZERO,
            window_px,
            moments: DMat2::ZERO,
            light: 0.0,
            light_variance: 0.0,
            noise: DMat2::ZERO,
            gain: DMat2::ZERO,
            contrast: 0.0,
        };
        let mut first = DVec2::ZERO;
        let mut peak: f64 = 0.0;
        for &p in disc {
            let offset = image.position(p) - middle;
            let far2 = offset.length_squared() / (window_px * window_px);
            if far2 > 12.0 || !image.valid[p] {
                continue;
            }
            let weight = (-0.5 * far2).exp();
            let light = image.value[p] - background.at(offset);
            peak = peak.max(image.value[p]);
            let variance = image.variance[p] + background.variance;
            spot.light += weight * light;
            spot.light_variance += weight * weight * variance;
            first += offset * (weight * light);
            spot.moments += outer(offset) * (weight * light);
            spot.noise += outer(offset) * (weight * weight * variance);
            spot.gain += (DMat2::IDENTITY - outer(offset) * (1.0 / (window_px * window_px)))
                * (weight * light);
        }
        // Surroundings darker than the noise count as the noise.
        let level = background.level.max(background.variance.sqrt());
        spot.contrast = peak / level.max(f64::MIN_POSITIVE);
        let known = spot.gain.determinant() > 1e-6 * spot.light * spot.light;
        let shift = match known && spot.light > 0.0 {
            true => spot.gain.inverse() * first,
            false => first / spot.light.abs().max(f64::MIN_POSITIVE),
        };
        spot.shift = shift.clamp_length_max(0.5 * window_px);
        spot
    }

    fn deviations(&self) -> f64 {
        self.light / self.light_variance.sqrt().max(f64::MIN_POSITIVE)
    }

    /// Variance of the light along a unit vector, the window taken out, pixels².
    fn variance_along(&self, along: DVec2) -> f64 {
        let windowed = along.dot(self.moments * along) / self.light;
        let window2 = self.window_px * self.window_px;
        // Of Gaussians the inverse variances add.
        match windowed > 0.0 && windowed < 0.9 * window2 {
            true => 1.0 / (1.0 / windowed - 1.0 / window2),
            false => 9.0 * window2,
        }
    }

    fn spread(&self) -> f64 {
        let both = self.variance_along(DVec2::X) + self.variance_along(DVec2::Y);
        (0.5 * both).sqrt()
    }

    fn highlight(&self, sphere: &Sphere) -> Highlight {
        let circle = sphere.circle;
        let offset = self.middle - circle.centre_px;
        let out = offset.try_normalize().unwrap_or(DVec2::X);
        // The lobe is even over the sphere's normals, which the image foreshortens: its
        // mean lies nearer to the sphere's middle by its variance. Across the way outwards
        // nothing is foreshortened; what blur does not explain is the lobe.
        let lobe_px2 = (self.variance_along(out.perp()) - sphere.blur_px.powi(2)).max(0.0);
        let lobe2 = (lobe_px2 / circle.radius_px.powi(2)).min(0.1);
        let position_px = circle.centre_px + offset / (1.0 - lobe2);
        let mut covariance_px2 = DMat2::ZERO;
        if self.gain.determinant() > 0.0 {
            let inverse = self.gain.inverse();
            covariance_px2 = inverse * self.noise * inverse.transpose();
        }
        // The correction is half a model.
        covariance_px2 += outer(out * (0.5 * lobe2 * offset.length()));
        // A spot that is narrow against the pixels has a middle only modulo the pixel: the
        // first harmonic of the error, with the pixel's own 1/12 taken out of the spread.
        for axis in [DVec2::X, DVec2::Y] {
            let narrow2 = (self.variance_along(axis) - 1.0 / 12.0).max(0.0);
            let error_px = (-2.0 * std::f64::consts::PI.powi(2) * narrow2).exp()
                / (std::f64::consts::PI * std::f64::consts::SQRT_2);
            covariance_px2 += outer(axis * error_px);
        }
        Highlight {
            position_px,
            covariance_px2,
            spread_px: self.spread(),
            deviations: self.deviations(),
        }
    }
}

/// The shading around a highlight: a plane through the pixels of a ring.
struct Plane {
    level: f64,
    slope: DVec2,
    /// Of a value of the plane near the middle.
    variance: f64,
}

impl Plane {
    fn around(image: &Grey, disc: &[usize], middle: DVec2, window_px: f64) -> Self {
        let (near, far) = (3.2 * window_px, 4.2 * window_px + 1.5);
        let ring: Vec<(DVec2, f64)> = disc
            .iter()
            .filter(|&&p| image.valid[p])
            .map(|&p| (image.position(p) - middle, image.value[p]))
            .filter(|(offset, _)| (near..far).contains(&offset.length()))
            .collect();
        let mut kept = ring;
        let mut plane = Self {
            level: 0.0,
            slope: DVec2::ZERO,
            variance: 0.0,
        };
        // Twice without what stands out: another highlight, dust.
        for _ in 0..3 {
            if kept.len() < 8 {
                break;
            }
            plane = Self::through(&kept);
            let off = kept.iter().map(|(o, v)| (v - plane.at(*o)).abs());
            let scatter = STD_OVER_MAD * median(off).unwrap_or(0.0);
            plane.variance = scatter * scatter / kept.len() as f64;
            let before = kept.len();
            kept.retain(|(o, v)| (v - plane.at(*o)).abs() <= 4.0 * scatter + 1e-300);
            if kept.len() == before {
                break;
            }
        }
        plane
    }

    fn through(points: &[(DVec2, f64)]) -> Self {
        let mut normal = nalgebra::Matrix3::zeros();
        let mut right = nalgebra::Vector3::zeros();
        for (offset, value) in points {
            let row = nalgebra::Vector3::new(1.0, offset.x, offset.y);
            normal += row * row.transpose();
            right += row * *value;
        }
        let mean = right[0] / points.len() as f64;
        let solution = normal
            .cholesky()
            .map_or(nalgebra::Vector3::new(mean, 0.0, 0.0), |c| c.solve(&right));
        Self {
            level: solution[0],
            slope: DVec2::new(solution[1], solution[2]),
            variance: 0.0,
        }
    }

    fn at(&self, offset: DVec2) -> f64 {
        self.level + self.slope.dot(offset)
    }
}
