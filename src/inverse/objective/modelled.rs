//! What a model says of a value, and what a residual's weight may know of it.

/// A value whose own paths scatter by more than this many times the variance of the
/// neighbours' holds a rare bright path and counts for less. Far above what a weight that
/// follows its own noise would need to pull the fit low.
const RARE: f64 = 64.0;

/// A modelled value, radiance over lamp strength.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Modelled {
    /// What was reflected once: a sum over the pixel, without render noise.
    pub once: f64,
    /// What was reflected more often: paths.
    pub again: f64,
    /// Variance that the paths leave.
    pub variance: f64,
}

impl Modelled {
    /// All reflections together.
    pub fn value(&self) -> f64 {
        self.once + self.again
    }

    /// Value and render's variance as expected without the paths of the pixel itself: those
    /// of the eight neighbours for which `beside` gives something, or its own where none does.
    /// The light that was reflected once is the pixel's own: beside a highlight the
    /// neighbours' would hide what a dark pixel tells. A rare bright path of its own is not
    /// taken for certain either: one such value could outweigh the whole image.
    pub(in crate::inverse) fn expected(
        &self,
        pixel: usize,
        resolution: [usize; 2],
        beside: impl Fn(usize) -> Option<Modelled>,
    ) -> [f64; 2] {
        let (mut again, mut variance, mut count) = (0.0, 0.0, 0.0);
        for other in around(pixel, resolution)
            .filter(|&q| q != pixel)
            .filter_map(beside)
        {
            again += other.again;
            variance += other.variance;
            count += 1.0;
        }
        if count > 0.0 {
            let variance = (variance / count).max(self.variance / RARE);
            [self.once + again / count, variance]
        } else {
            [self.value(), self.variance]
        }
    }
}

/// Indices of a pixel and its neighbours in an image of `[width, height]`, nine at most.
pub fn around(pixel: usize, [width, height]: [usize; 2]) -> impl Iterator<Item = usize> + Clone {
    let (x, y) = (pixel % width, pixel / width);
    (y.saturating_sub(1)..=(y + 1).min(height - 1)).flat_map(move |j| {
        (x.saturating_sub(1)..=(x + 1).min(width - 1)).map(move |i| j * width + i)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In the middle of 3 × 3 pixels the neighbours' paths count, the own ones don't; light
    /// reflected once is the own.
    #[test]
    fn own_paths_and_the_neighbours_highlight_are_left_out() {
        let image: Vec<Modelled> = (0..9)
            .map(|k| Modelled {
                once: f64::from(k),
                again: 10.0 * f64::from(k),
                variance: 100.0 * f64::from(k),
            })
            .collect();
        let expected = |pixel: usize, mask: fn(usize) -> bool| {
            image[pixel].expected(pixel, [3, 3], |q| mask(q).then_some(image[q]))
        };
        assert_eq!(expected(4, |_| true), [4.0 + 40.0, 400.0]);
        assert_eq!(expected(4, |q| q == 4), [44.0, 400.0]);
        // The corner has three neighbours: 1, 3 and 4, the last not compared.
        assert_eq!(expected(0, |q| q != 4), [20.0, 200.0]);
        assert_eq!(expected(8, |q| q == 5), [8.0 + 50.0, 500.0]);
    }

    #[test]
    fn a_rare_bright_path_does_not_count_as_certain() {
        let mut image = vec![Modelled::default(); 9];
        for (k, of_its_own) in [(1.0, 1.0), (RARE, 1.0), (4.0 * RARE, 4.0)] {
            image.fill(Modelled {
                variance: 1.0,
                ..Modelled::default()
            });
            image[4].variance = k;
            let [_, variance] = image[4].expected(4, [3, 3], |q| Some(image[q]));
            assert_eq!(variance, of_its_own, "{k}");
        }
    }
}
