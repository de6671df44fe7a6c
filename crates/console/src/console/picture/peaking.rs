//! Focus peaking: where a frame has edges as sharp as the sensor can show them.
//!
//! An edge counts where neighbouring pixels of the same colour differ by far more than the
//! noise at that brightness, and where most of the step happens within these pixels: an edge
//! out of focus is as high, but wide. The noise is estimated from the frame itself, by
//! brightness, because photon noise grows with it.

use crate::device::RawFrame;
use crate::radiometry::mosaic::Mosaic;

/// What a step over two pixels has beyond the slope around it counts from so many standard
/// deviations of one pixel's noise on: nearly six of its own.
const STEP_SIGMAS: f32 = 8.5;
/// Part of the whole step that must lie within two pixels: that of an edge which a Gaussian
/// of 1.2 pixels blurs.
const SHARP_PART: f32 = 0.6;
/// The whole step is measured over so many times the distance.
const WIDE: usize = 4;
/// Noise below this cannot be seen in whole counts, DN.
const LEAST_NOISE_DN: f32 = 0.5;
/// Classes of brightness, equally wide in the square root of the counts.
const CLASSES: usize = 32;
/// Pixels that are looked at for the noise, about.
const NOISE_SAMPLES: usize = 200_000;
/// Fewer pixels than this in a class say nothing of its noise.
const LEAST_IN_CLASS: usize = 200;
/// The median of the absolute values of a Gaussian, in standard deviations.
const MEDIAN_OF_GAUSSIAN: f32 = 0.674_5;

/// Whether a block of `block` × `block` pixels has a sharp edge, block by block in rows.
pub fn sharp_blocks(frame: &RawFrame, mosaic: Mosaic, block: usize) -> Vec<bool> {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let step = if mosaic == Mosaic::None { 1 } else { 2 };
    let columns = width.div_ceil(block);
    let mut sharp = vec![false; columns * height.div_ceil(block)];
    let reach = WIDE * step;
    let noise = Noise::of(frame, step);
    // Along rows, then along columns: the distance of a neighbour in the counts.
    for (stride, x_margin, y_margin) in [(1, reach, 0), (width, 0, reach)] {
        for y in y_margin..height.saturating_sub(y_margin) {
            for x in x_margin..width.saturating_sub(x_margin) {
                let at = y * width + x;
                let difference = |distance: usize| {
                    let count = |index: usize| f32::from(frame.counts[index]);
                    count(at + distance * stride) - count(at - distance * stride)
                };
                let (near, far) = (difference(step), difference(reach));
                // What a slope as wide as the whole step has of it is no edge.
                let excess = (near - far / WIDE as f32).abs();
                if excess > STEP_SIGMAS * noise.at(frame.counts[at])
                    && near.abs() >= SHARP_PART * far.abs()
                {
                    sharp[y / block * columns + x / block] = true;
                }
            }
        }
    }
    sharp
}

/// The standard deviation of one pixel's noise by its brightness, DN.
struct Noise {
    by_class: [f32; CLASSES],
    largest_dn: u16,
}

impl Noise {
    /// From second differences along rows, which a slope doesn't enter: their median is that
    /// of pixels without an edge, as long as these are most. Where nearly all pixels of a
    /// brightness lie on edges they are not, and the noise of brighter ones is the limit,
    /// because noise grows with brightness.
    fn of(frame: &RawFrame, step: usize) -> Self {
        let (width, pixels) = (frame.width as usize, frame.counts.len());
        let largest_dn = frame.counts.iter().copied().max().unwrap_or(0);
        let mut found: [Vec<f32>; CLASSES] = Default::default();
        // Odd, so that pixels of all colour filters are among them.
        let stride = (pixels / NOISE_SAMPLES) | 1;
        for at in (step..pixels.saturating_sub(step)).step_by(stride) {
            let near = [at - step, at, at + step].map(|index| frame.counts[index]);
            // Saturated pixels have no noise.
            let is_inside = (step..width.saturating_sub(step)).contains(&(at % width));
            if !is_inside || near.contains(&largest_dn) {
                continue;
            }
            let [before, here, after] = near.map(f32::from);
            found[class(near[1], largest_dn)].push((before - 2.0 * here + after).abs());
        }
        let known = found.map(|mut values| {
            if values.len() < LEAST_IN_CLASS {
                return None;
            }
            let middle = values.len() / 2;
            let median = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
            // Of the variances 1, 4 and 1.
            let sigma = median / MEDIAN_OF_GAUSSIAN / 6f32.sqrt();
            Some(sigma.max(LEAST_NOISE_DN))
        });
        // Never more than that of brighter classes.
        let mut by_class = [None; CLASSES];
        let mut limit = None;
        for at in (0..CLASSES).rev() {
            limit = [limit, known[at]].into_iter().flatten().reduce(f32::min);
            by_class[at] = limit;
        }
        // Brighter ones than any that is known: photon noise grows with the square root, in
        // which the classes are equally wide.
        let brightest = (0..CLASSES).rev().find(|&at| by_class[at].is_some());
        let of_brightest = brightest.and_then(|at| by_class[at]);
        let by_class = std::array::from_fn(|at| {
            by_class[at].unwrap_or_else(|| {
                let grown = (at + 1) as f32 / (brightest.unwrap_or(at) + 1) as f32;
                of_brightest.unwrap_or(LEAST_NOISE_DN) * grown
            })
        });
        Self {
            by_class,
            largest_dn,
        }
    }

    fn at(&self, count: u16) -> f32 {
        self.by_class[class(count, self.largest_dn)]
    }
}

fn class(count: u16, largest_dn: u16) -> usize {
    let part = (f32::from(count) / (f32::from(largest_dn) + 1.0)).sqrt();
    ((part * CLASSES as f32) as usize).min(CLASSES - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_core::random::{Purpose, stream};

    const SIZE: usize = 128;

    /// An upright edge from 400 to 2400 DN in the middle, blurred by a Gaussian of this
    /// standard deviation, with photon and read noise: system gain 0.2 DN per electron, 3 DN
    /// of read noise; through a colour filter that dims every other pixel to a third, or not.
    fn edge(blur_px: f64, mosaic: Mosaic) -> RawFrame {
        let mut numbers = stream(1, Purpose::Experiment, 0, 0, 0);
        let counts = (0..SIZE * SIZE).map(|at| {
            let distance_px = (at % SIZE) as f64 + 0.5 - SIZE as f64 / 2.0;
            let part = 0.5 + 0.5 * libm::erf(distance_px / blur_px / std::f64::consts::SQRT_2);
            let is_dimmed = mosaic != Mosaic::None && (at / SIZE + at).is_multiple_of(2);
            let mean = (400.0 + 2000.0 * part) / if is_dimmed { 3.0 } else { 1.0 };
            let noise = (0.2 * mean + 9.0).sqrt() * numbers.normal();
            (mean + noise).round() as u16
        });
        RawFrame::new(SIZE as u32, SIZE as u32, counts.collect())
    }

    fn marked(frame: &RawFrame, mosaic: Mosaic) -> (usize, usize) {
        let sharp = sharp_blocks(frame, mosaic, 4);
        let columns = SIZE / 4;
        let near = |at: &usize| (at % columns).abs_diff(columns / 2) <= 2;
        let marked: Vec<usize> = (0..sharp.len()).filter(|&at| sharp[at]).collect();
        let on_edge = marked.iter().filter(|at| near(at)).count();
        (on_edge, marked.len() - on_edge)
    }

    #[test]
    fn a_sharp_edge_is_marked_and_a_blurred_one_is_not() {
        let rows = SIZE / 4;
        for (blur_px, least, most) in [(0.5, rows, 3 * rows), (4.0, 0, 0), (10.0, 0, 0)] {
            let (on_edge, elsewhere) = marked(&edge(blur_px, Mosaic::None), Mosaic::None);
            assert!((least..=most).contains(&on_edge), "{blur_px}: {on_edge}");
            assert_eq!(elsewhere, 0, "noise was marked at {blur_px}");
        }
    }

    /// Neighbours of another colour differ everywhere; those of the same colour on edges.
    #[test]
    fn the_pattern_of_colour_filters_is_no_edge() {
        for (blur_px, is_sharp) in [(0.5, true), (8.0, false)] {
            let (on_edge, elsewhere) = marked(&edge(blur_px, Mosaic::Rggb), Mosaic::Rggb);
            assert_eq!((on_edge >= SIZE / 4, elsewhere), (is_sharp, 0), "{on_edge}");
        }
    }

    #[test]
    fn frames_smaller_than_the_distances_have_no_edges() {
        for (width, height) in [(0, 0), (1, 1), (3, 2), (7, 9)] {
            let frame = RawFrame::new(
                width,
                height,
                (0..width * height).map(|at| (at * 500) as u16).collect(),
            );
            let sharp = sharp_blocks(&frame, Mosaic::None, 1);
            assert_eq!(sharp.len(), (width * height) as usize);
        }
    }
}
