//! A modelled value, and the part of it on which a residual's weight may depend.

/// A value whose own paths scatter by more than this many times the variance of the
/// neighbours' holds a rare bright path and counts for less. Far above what a weight that
/// follows its own noise would need to pull the fit low.
const RARE_PATH_RATIO: f64 = 64.0;

/// A modelled value, radiance over lamp strength.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Modelled {
    /// What was reflected once: a sum over the cell, without render noise.
    pub direct: f64,
    /// What was reflected more often: paths.
    pub indirect: f64,
    /// Variance that the paths leave.
    pub variance: f64,
}

impl Modelled {
    /// All reflections together.
    pub fn value(&self) -> f64 {
        self.direct + self.indirect
    }

    /// Value and render's variance as expected without the paths of the cell itself: those of
    /// its neighbours, or its own where there are none. The light that was reflected once is the
    /// cell's own: next to a highlight the neighbours' would hide the information of a dark cell. A rare
    /// bright path of its own is not taken for certain either: one such value could outweigh the
    /// whole image.
    pub(in crate::inverse) fn expected(&self, near: impl Iterator<Item = Self>) -> [f64; 2] {
        let (mut indirect, mut variance, mut count) = (0.0, 0.0, 0.0);
        for other in near {
            indirect += other.indirect;
            variance += other.variance;
            count += 1.0;
        }
        if count > 0.0 {
            let variance = (variance / count).max(self.variance / RARE_PATH_RATIO);
            [self.direct + indirect / count, variance]
        } else {
            [self.value(), self.variance]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn modelled(k: f64) -> Modelled {
        Modelled {
            direct: k,
            indirect: 10.0 * k,
            variance: 100.0 * k,
        }
    }

    /// The neighbours' paths count, the own ones don't; light reflected once is the own.
    #[test]
    fn own_paths_and_the_neighbours_highlight_are_left_out() {
        let near = |all: &[f64]| all.iter().map(|&k| modelled(k)).collect::<Vec<_>>();
        let expected = |own: f64, all: &[f64]| modelled(own).expected(near(all).into_iter());
        assert_eq!(expected(4.0, &[3.0, 5.0]), [4.0 + 40.0, 400.0]);
        assert_eq!(expected(4.0, &[]), [44.0, 400.0]);
        assert_eq!(expected(8.0, &[5.0]), [8.0 + 50.0, 500.0]);
    }

    #[test]
    fn a_rare_bright_path_does_not_count_as_certain() {
        let ordinary = Modelled {
            variance: 1.0,
            ..Modelled::default()
        };
        for (own, expected) in [
            (1.0, 1.0),
            (RARE_PATH_RATIO, 1.0),
            (4.0 * RARE_PATH_RATIO, 4.0),
        ] {
            let value = Modelled {
                variance: own,
                ..ordinary
            };
            let [_, variance] = value.expected(std::iter::repeat_n(ordinary, 8));
            assert_eq!(variance, expected, "{own}");
        }
    }
}
