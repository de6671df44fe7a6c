//! Whether the lamp stands where it did before the stage was homed anew, from two frames
//! of one scene at one exposure.
//!
//! A light's frames from before and after an interruption are merged into one image. The
//! stage finds its switches again within its repeatability, which turns the light a little:
//! the bright places of the images shift. By how much a pixel changes with the light's
//! direction is read from the image itself. On a curved surface a turn of δ shifts the
//! shading by δ·R (diffuse) or δ·R/2 (a highlight), R the surface's radius, for which half
//! the width of what is lit stands, and a shift changes a pixel by its gradient.

use super::exposure_check::{
    Exposed, MAX_SIGNAL, MIN_SIGNAL, SignalRatio, signal_dn, signal_ratio, variance_dn2,
};
use crate::radiometry::sensor::SensorNoise;

/// The gradient is taken over as many pixels to each side: those have the same colour
/// filter.
const REACH_PX: usize = 2;
/// Fewer pixels say nothing.
const MIN_PIXELS: f64 = 30.0;
/// Standard deviations of noise that a change must be beyond what is allowed.
const TO_REFUSE: f64 = 4.0;
/// Between the shifts of diffuse shading and of a highlight, as parts of δ·R.
const USUAL_SHIFT: f64 = 0.7;
/// Largest turn of the light in terms of the stage's tolerance: each of two homings may be
/// off by it.
const TURNS: f64 = 2.0;

/// How a later frame differs from an earlier one of the same exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// Of all the signal: the lamp's power, and what a turn does to the sum.
    pub ratio: SignalRatio,
    /// Mean square of the pixels' relative changes apart from that, beyond noise; below 0
    /// where noise happens to be small.
    mean_square: f64,
    /// Its standard uncertainty.
    mean_square_std: f64,
    /// Root mean square relative change of a pixel that is shifted by δ·R, per radian of δ.
    per_rad: f64,
}

/// Compares two frames, `width` pixels wide, over the pixels that are well exposed.
/// `None` where they show too little to tell.
pub fn change(
    noise: &SensorNoise,
    width: usize,
    earlier: Exposed<'_>,
    later: Exposed<'_>,
) -> Option<Change> {
    // Pixels that are well exposed in both.
    let ratio = signal_ratio(noise, earlier, later)?;
    let range_dn = noise.usable_range_dn();
    let height = earlier.counts.len().min(later.counts.len()) / width.max(1);
    let is_good = |pixel: usize| {
        let is_hot = noise.hot_pixels.as_ref();
        let is_hot = is_hot.is_some_and(|hot| hot.get(pixel) == Some(&true));
        let within = |frame| {
            let part = signal_dn(noise, frame, pixel) / range_dn;
            (MIN_SIGNAL..=MAX_SIGNAL).contains(&part)
        };
        !is_hot && within(earlier) && within(later)
    };
    // Their squared relative change beyond noise, and the squared slopes of the earlier image.
    let scale = ratio.ratio * later.exposure_s / earlier.exposure_s;
    let (mut pixels, mut excess, mut excess_variance) = (0.0, 0.0, 0.0);
    let (mut slopes, mut gradient) = (0.0, 0.0);
    let mut lit = [[usize::MAX, 0]; 2];
    for y in 0..height {
        for x in 0..width {
            let pixel = y * width + x;
            if !is_good(pixel) {
                continue;
            }
            let [before_dn, after_dn] = [
                signal_dn(noise, earlier, pixel),
                signal_dn(noise, later, pixel) / scale,
            ];
            let relative_variance = variance_dn2(noise, earlier, before_dn) / before_dn.powi(2)
                + variance_dn2(noise, later, after_dn * scale) / (after_dn * scale).powi(2);
            pixels += 1.0;
            excess += (after_dn / before_dn - 1.0).powi(2) - relative_variance;
            excess_variance += 2.0 * relative_variance.powi(2);
            for ([low, high], at) in lit.iter_mut().zip([x, y]) {
                (*low, *high) = ((*low).min(at), (*high).max(at));
            }
            let inside = (REACH_PX..width.saturating_sub(REACH_PX)).contains(&x)
                && (REACH_PX..height.saturating_sub(REACH_PX)).contains(&y);
            let pairs = [REACH_PX, REACH_PX * width].map(|step| (pixel, step));
            if !inside
                || pairs
                    .iter()
                    .any(|&(p, step)| !is_good(p - step) || !is_good(p + step))
            {
                continue;
            }
            slopes += 1.0;
            for (pixel, step) in pairs {
                let [low_dn, high_dn] =
                    [pixel - step, pixel + step].map(|p| signal_dn(noise, earlier, p));
                let noise_dn2 =
                    variance_dn2(noise, earlier, low_dn) + variance_dn2(noise, earlier, high_dn);
                let step_px = 2.0 * REACH_PX as f64;
                gradient +=
                    ((high_dn - low_dn).powi(2) - noise_dn2) / (step_px * before_dn).powi(2);
            }
        }
    }
    // Means, and what a turn of the light would change.
    if pixels < MIN_PIXELS || slopes < MIN_PIXELS {
        return None;
    }
    let width_px = lit.map(|[low, high]| (high - low + 1) as f64);
    let radius_px = 0.5 * width_px[0].max(width_px[1]);
    Some(Change {
        ratio,
        mean_square: excess / pixels,
        mean_square_std: excess_variance.sqrt() / pixels,
        per_rad: radius_px * (gradient / slopes).max(0.0).sqrt(),
    })
}

impl Change {
    /// Root mean square relative change of the pixels, beyond noise and apart from the
    /// lamp's power.
    pub fn pattern(&self) -> f64 {
        self.mean_square.max(0.0).sqrt()
    }

    /// Roughly how far the light has turned, degrees; infinite where the image is even.
    pub fn turned_deg(&self) -> f64 {
        (self.pattern() / (USUAL_SHIFT * self.per_rad)).to_degrees()
    }

    /// The most that a stage within this tolerance makes of [`Self::pattern`].
    pub fn explained(&self, tolerance_deg: f64) -> f64 {
        TURNS * self.per_rad * tolerance_deg.to_radians()
    }

    /// Whether the light has certainly turned further than the tolerance allows.
    pub fn is_beyond(&self, tolerance_deg: f64) -> bool {
        self.mean_square - TO_REFUSE * self.mean_square_std > self.explained(tolerance_deg).powi(2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};
    use glam::DVec3;

    const SIZE: usize = 64;

    /// A sphere under a light of this elevation, diffuse with a glossy lobe of this strength.
    fn frame(noise: &SensorNoise, elevation_deg: f64, gloss: f64, power: f64) -> Vec<u16> {
        let elevation = elevation_deg.to_radians();
        let to_light = DVec3::new(elevation.cos(), 0.0, elevation.sin());
        let half = (to_light + DVec3::Z).normalize();
        let seed = (elevation_deg * 1e4 + power * 1e6) as u64;
        let count = |pixel: usize| {
            let centred = |i: usize| (i as f64 + 0.5) / SIZE as f64 * 2.2 - 1.1;
            let (x, y) = (centred(pixel % SIZE), centred(pixel / SIZE));
            let z_sq: f64 = 1.0 - x * x - y * y;
            let signal_e = if z_sq <= 0.0 {
                0.0
            } else {
                let normal = DVec3::new(x, y, z_sq.sqrt());
                let tan_sq = normal.dot(half).powi(-2) - 1.0;
                let lobe = gloss * (1.0 + tan_sq / 0.01).powi(-2);
                3000.0 * power * (normal.dot(to_light).max(0.0) + lobe)
            };
            let noisy_e = signal_e
                + (signal_e + noise.read_noise_e.powi(2)).sqrt()
                    * stream(seed, Purpose::Experiment, 0, pixel as u64, 0).normal();
            let dn = noise.black_level_dn + noise.gain_dn_per_e * noisy_e;
            dn.round().clamp(0.0, 4095.0) as u16
        };
        (0..SIZE * SIZE).map(count).collect()
    }

    fn turned(by_deg: f64, gloss: f64, power: f64) -> Change {
        let noise = SensorNoise::ideal(0.4, 2.5, 64.0, 12);
        let before = frame(&noise, 60.0, gloss, 1.0);
        let after = frame(&noise, 60.0 + by_deg, gloss, power);
        let [before, after] = [&before, &after].map(|counts| Exposed {
            counts,
            exposure_s: 0.1,
        });
        change(&noise, SIZE, before, after).unwrap()
    }

    /// What is within the tolerance passes, what is well beyond is found and measured,
    /// and a lamp that has become dimmer is no turn.
    #[test]
    fn a_turn_of_the_light_is_no_dimmer_lamp() {
        for gloss in [0.0, 0.5] {
            for (by_deg, power) in [(1e-4, 1.0), (0.05, 1.0), (-0.1, 1.0), (1e-4, 0.9)] {
                let found = turned(by_deg, gloss, power);
                assert!(!found.is_beyond(0.05), "{by_deg}°: {found:?}");
                assert!((found.ratio.ratio - power).abs() < 0.01, "{found:?}");
            }
            for by_deg in [2.0, -4.0] {
                let found = turned(by_deg, gloss, 1.0);
                assert!(found.is_beyond(0.05), "{by_deg}°: {found:?}");
                let is = found.turned_deg() / f64::abs(by_deg);
                assert!(
                    (0.4..2.0).contains(&is),
                    "{by_deg}°: {}",
                    found.turned_deg()
                );
                // The same turn is fine where the stage claims no more.
                assert!(!found.is_beyond(2.0 * f64::abs(by_deg)));
            }
        }
    }

    #[test]
    fn an_even_or_dark_image_tells_nothing() {
        let noise = SensorNoise::ideal(0.4, 2.5, 64.0, 12);
        for dn in [64, 2000] {
            let counts = [dn; SIZE * SIZE];
            let exposed = Exposed {
                counts: &counts,
                exposure_s: 0.1,
            };
            let found = change(&noise, SIZE, exposed, exposed);
            assert!(found.is_none_or(|found| !found.is_beyond(0.0)), "{found:?}");
        }
    }
}
