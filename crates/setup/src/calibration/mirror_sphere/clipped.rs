//! The core of a highlight that saturates even the shortest exposure, as a polished ball's
//! does: it mirrors the lamp itself, which is thousands of times as bright as a lit card.
//!
//! The merge masks clipped pixels. All of them were brighter than any of their neighbours
//! that were measured, so with the brightest neighbour's value in their place the image is
//! the highlight cut off at that level. A highlight that is symmetric stays so, and its
//! middle with it; what is lost is how precisely the edge of the cut is known.

use std::collections::BTreeSet;
use std::f64::consts::PI;

use glam::DVec2;

use super::{Circle, Grey};

/// Largest radius of a core over the sphere's. A larger one is a lamp that is no point, or an
/// image of little else than glare.
const LARGEST: f64 = 0.1;
/// A core reaches at most so many times as far from its middle as a disc of its area.
const ROUND: f64 = 1.8;
/// Standard deviation of where a pixel's edge lies within the pixel, pixels: 1/√12.
const EDGE_PX: f64 = 0.289;

/// Clipped pixels of one highlight.
pub(super) struct Core {
    pixels: Vec<usize>,
    /// The brightest measured pixel next to them.
    brightest: usize,
}

/// Why clipped pixels are no core.
pub(super) struct NoCore {
    pub pixels: usize,
}

impl Core {
    /// The clipped pixels at a peak; `None` where all are measured.
    ///
    /// # Errors
    /// They are too many, not round, or reach out of the sphere.
    pub fn at(
        image: &Grey,
        circle: &Circle,
        peak: DVec2,
        reach_px: f64,
    ) -> Result<Option<Self>, NoCore> {
        let near = |&p: &usize| !image.valid[p] && image.position(p).distance(peak) <= reach_px;
        let seeds = around(image, peak, reach_px).filter(near);
        let mut open: Vec<usize> = seeds.collect();
        let mut pixels: BTreeSet<usize> = open.iter().copied().collect();
        let mut brightest: Option<usize> = None;
        let largest = LARGEST * circle.radius_px;
        let most = (PI * largest * largest).max(1.0);
        while let Some(pixel) = open.pop() {
            for next in around(image, image.position(pixel), 1.5) {
                if image.valid[next] {
                    let is_more = |&b: &usize| image.value[next] > image.value[b];
                    if brightest.is_none() || brightest.as_ref().is_some_and(is_more) {
                        brightest = Some(next);
                    }
                } else if pixels.insert(next) {
                    open.push(next);
                }
            }
            if pixels.len() as f64 > most {
                return Err(NoCore {
                    pixels: pixels.len(),
                });
            }
        }
        let Some(brightest) = brightest else {
            return Ok(None);
        };
        let core = Self {
            pixels: pixels.into_iter().collect(),
            brightest,
        };
        match core.is_round(image) && core.is_within(image, circle) {
            true => Ok(Some(core)),
            false => Err(NoCore {
                pixels: core.pixels.len(),
            }),
        }
    }

    /// Radius of a disc of its area, pixels.
    fn radius_px(&self) -> f64 {
        (self.pixels.len() as f64 / PI).sqrt()
    }

    fn is_round(&self, image: &Grey) -> bool {
        let places = || self.pixels.iter().map(|&p| image.position(p));
        let middle = places().sum::<DVec2>() / self.pixels.len() as f64;
        places().all(|place| place.distance(middle) <= ROUND * self.radius_px() + 0.5)
    }

    fn is_within(&self, image: &Grey, circle: &Circle) -> bool {
        let inside = |&p: &usize| image.position(p).distance(circle.centre_px) < circle.radius_px;
        self.pixels.iter().all(inside)
    }

    /// The image with the highlight cut off at the brightest measured pixel.
    pub fn filled(&self, image: &Grey) -> Grey {
        let mut filled = image.clone();
        for &pixel in &self.pixels {
            filled.value[pixel] = image.value[self.brightest];
            filled.variance[pixel] = image.variance[self.brightest];
            filled.valid[pixel] = true;
        }
        filled
    }

    /// Standard uncertainty that the cut adds to the middle along each axis, pixels: the
    /// pixels along the edge of a disc, each with its own error of [`EDGE_PX`].
    pub fn std_px(&self) -> f64 {
        EDGE_PX / (PI * self.radius_px()).sqrt()
    }
}

/// Pixels whose middles are within a distance of a place.
fn around(image: &Grey, place: DVec2, reach_px: f64) -> impl Iterator<Item = usize> {
    let range = |at: f64, n: usize| {
        let low = (at - reach_px).floor().max(0.0) as usize;
        low..((at + reach_px).ceil().max(0.0) as usize).min(n)
    };
    let (columns, rows) = (range(place.x, image.width), range(place.y, image.height));
    let width = image.width;
    let pixels = rows.flat_map(move |y| columns.clone().map(move |x| (x, y)));
    let within = move |&(x, y): &(usize, usize)| {
        let middle = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        middle.distance(place) <= reach_px
    };
    pixels.filter(within).map(move |(x, y)| y * width + x)
}
