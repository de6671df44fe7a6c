//! Expectation of a pixel from those around it, so that its own noise hardly
//! enters its weights.

use super::rate::Expectation;

/// Indices into the rates of [`PixelRates`].
pub(super) const LIT: usize = 0;
pub(super) const AMBIENT: usize = 1;
pub(super) const DARK: usize = 2;

/// First-pass rates of one pixel with their variances, e⁻/s.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PixelRates {
    pub rate_e_s: [f32; 3],
    pub variance: [f32; 3],
    /// Neither hot nor clipped in the shortest exposures.
    pub usable: bool,
}

/// The first pass's rates around a pixel.
pub(super) struct Neighbourhood<'a> {
    pub rates: &'a [PixelRates],
    pub width: usize,
    pub height: usize,
    /// Distance to the next pixel of the same colour.
    pub step: usize,
}

/// Neighbours this many pixels away on each side are pooled ...
pub(super) const POOL_RADIUS: isize = 2;
/// ... if they lie within this many standard deviations of the pixel.
const POOL_AGREEMENT: f32 = 4.0;

/// ... and replace it if at least this many do.
const POOL_QUORUM: f64 = 6.0;

impl Neighbourhood<'_> {
    /// Expectation of a pixel's rates from the neighbours that agree with it, so
    /// that its own noise hardly enters its weights.
    pub fn expectations(&self, x: usize, y: usize) -> [Expectation; 3] {
        let centre = &self.rates[y * self.width + x];
        let (mut rates, mut variances, mut counts) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        for dy in -POOL_RADIUS..=POOL_RADIUS {
            for dx in -POOL_RADIUS..=POOL_RADIUS {
                if dx == 0 && dy == 0 {
                    continue;
                }
                let (Some(x), Some(y)) = (
                    x.checked_add_signed(dx * self.step as isize),
                    y.checked_add_signed(dy * self.step as isize),
                ) else {
                    continue;
                };
                if x >= self.width || y >= self.height {
                    continue;
                }
                let neighbour = &self.rates[y * self.width + x];
                if !neighbour.usable {
                    continue;
                }
                for i in 0..3 {
                    let apart = neighbour.rate_e_s[i] - centre.rate_e_s[i];
                    let variance = neighbour.variance[i] + centre.variance[i];
                    if apart * apart <= POOL_AGREEMENT * POOL_AGREEMENT * variance {
                        rates[i] += f64::from(neighbour.rate_e_s[i]);
                        variances[i] += f64::from(neighbour.variance[i]);
                        counts[i] += 1.0;
                    }
                }
            }
        }
        std::array::from_fn(|i| Expectation {
            rate_e_s: (rates[i] + f64::from(centre.rate_e_s[i])) / (counts[i] + 1.0),
            around: (counts[i] >= POOL_QUORUM)
                .then(|| (rates[i] / counts[i], variances[i] / (counts[i] * counts[i]))),
        })
    }
}
