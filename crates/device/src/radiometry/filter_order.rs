//! Whether the counts of frames agree with the order of colour filters that is stated for their
//! sensor. Of the two diagonals of a cell of 2 × 2 pixels one is green, and its pixels agree.

use super::mosaic::Mosaic;

/// What the counts say against the order of the filters.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum FilterDoubt {
    /// The pixels that are both said to be green differ, and the others of each cell agree.
    OtherDiagonal {
        /// Root mean square difference of the stated greens over their mean signal.
        difference: f64,
        /// The orders whose greens agree: red and blue look alike to this comparison.
        orders: [Mosaic; 2],
    },
    /// Neighbours differ more than next neighbours do, along rows and columns: a mosaic that
    /// is merged as if it were monochrome.
    Mosaic {
        /// Root mean square difference of neighbours over the mean signal.
        difference: f64,
        /// The orders whose greens agree.
        orders: [Mosaic; 2],
    },
}

/// Squared differences of pairs of pixels.
#[derive(Clone, Copy, Debug, Default)]
struct Pairs {
    squares: f64,
    signal: f64,
    count: f64,
}

impl Pairs {
    fn add(&mut self, a: f64, b: f64) {
        self.squares += (a - b) * (a - b);
        self.signal += 0.5 * (a + b);
        self.count += 1.0;
    }

    fn mean_square(&self) -> f64 {
        self.squares / self.count.max(1.0)
    }

    /// Root mean square difference over the mean signal.
    fn relative(&self) -> f64 {
        let signal = self.signal / self.count.max(1.0);
        match signal > 0.0 {
            true => self.mean_square().sqrt() / signal,
            false => 0.0,
        }
    }
}

/// Sums over the cells of frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct FilterOrder {
    /// From upper left to lower right of a cell, and from upper right to lower left.
    diagonals: [Pairs; 2],
    /// Neighbours in a row and in a column, and the next but one.
    neighbours: [Pairs; 2],
    next_but_one: [Pairs; 2],
}

/// Pairs that it takes to say anything.
const LEAST_PAIRS: f64 = 32.0;
/// Pixels of one colour that differ by less are only unequally sensitive.
const LEAST_DIFFERENCE: f64 = 0.1;
/// The other diagonal's mean square difference is smaller by this factor ...
const DIAGONAL_FACTOR: f64 = 4.0;
/// ... and that of next neighbours by this one.
const NEIGHBOUR_FACTOR: f64 = 2.0;

impl FilterOrder {
    /// Adds a frame of counts, row by row, `width` in a row; counts of `ceiling` and more are
    /// clipped.
    pub fn add(&mut self, counts: &[u16], width: usize, black_dn: f64, ceiling: f64) {
        let height = counts.len().checked_div(width).unwrap_or(0);
        let signal = |x: usize, y: usize| {
            let count = f64::from(counts[y * width + x]);
            (count < ceiling).then_some(count - black_dn)
        };
        let pair = |pairs: &mut Pairs, a: Option<f64>, b: Option<f64>| {
            if let (Some(a), Some(b)) = (a, b) {
                pairs.add(a, b);
            }
        };
        for y in (0..height.saturating_sub(2)).step_by(2) {
            for x in (0..width.saturating_sub(2)).step_by(2) {
                let here = signal(x, y);
                let [right, below] = [signal(x + 1, y), signal(x, y + 1)];
                pair(&mut self.diagonals[0], here, signal(x + 1, y + 1));
                pair(&mut self.diagonals[1], right, below);
                pair(&mut self.neighbours[0], here, right);
                pair(&mut self.neighbours[1], here, below);
                pair(&mut self.next_but_one[0], here, signal(x + 2, y));
                pair(&mut self.next_but_one[1], here, signal(x, y + 2));
            }
        }
    }

    /// What speaks against this order.
    pub fn doubt(&self, stated: Mosaic) -> Option<FilterDoubt> {
        let [falling, rising] = &self.diagonals;
        let (greens, others, orders) = match stated {
            Mosaic::Grbg | Mosaic::Gbrg => (falling, rising, RISING),
            Mosaic::Rggb | Mosaic::Bggr => (rising, falling, FALLING),
            Mosaic::None => return self.unstated(),
        };
        let enough = greens.count >= LEAST_PAIRS && others.count >= LEAST_PAIRS;
        let difference = greens.relative();
        let contradicts = greens.mean_square() > DIAGONAL_FACTOR * others.mean_square();
        (enough && difference > LEAST_DIFFERENCE && contradicts)
            .then_some(FilterDoubt::OtherDiagonal { difference, orders })
    }

    fn unstated(&self) -> Option<FilterDoubt> {
        let directions = || self.neighbours.iter().zip(&self.next_but_one);
        let is_checked = directions().all(|(near, far)| {
            far.count >= LEAST_PAIRS
                && near.mean_square() > NEIGHBOUR_FACTOR * far.mean_square()
                && near.relative() > LEAST_DIFFERENCE
        });
        let [falling, rising] = &self.diagonals;
        let orders = match falling.mean_square() < rising.mean_square() {
            true => FALLING,
            false => RISING,
        };
        let difference = self.neighbours[0].relative();
        is_checked.then_some(FilterDoubt::Mosaic { difference, orders })
    }
}

/// The orders whose greens are at the upper left and lower right.
const FALLING: [Mosaic; 2] = [Mosaic::Grbg, Mosaic::Gbrg];
/// The orders whose greens are at the upper right and lower left.
const RISING: [Mosaic; 2] = [Mosaic::Rggb, Mosaic::Bggr];

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 24;
    const ALL: [Mosaic; 4] = [Mosaic::Rggb, Mosaic::Grbg, Mosaic::Gbrg, Mosaic::Bggr];

    /// Counts of a sensor over a scene with a gradient and some noise.
    fn doubt(sensor: Mosaic, colours: [f64; 3], stated: Mosaic) -> Option<FilterDoubt> {
        let counts: Vec<u16> = (0..WIDTH * WIDTH)
            .map(|p| {
                let (x, y) = (p % WIDTH, p / WIDTH);
                let colour = sensor.channel(x, y).map_or(colours[1], |c| colours[c]);
                let noise = (p * 7919 % 13) as f64 - 6.0;
                (64.0 + colour * (1.0 + 0.02 * (x + y) as f64) + noise) as u16
            })
            .collect();
        let mut order = FilterOrder::default();
        order.add(&counts, WIDTH, 64.0, 4095.0);
        order.doubt(stated)
    }

    #[test]
    fn the_diagonal_that_agrees_is_green() {
        for (sensor, colours) in ALL
            .iter()
            .flat_map(|&m| [(m, [150.0, 600.0, 900.0]), (m, [90.0, 500.0, 40.0])])
        {
            for stated in ALL {
                let found = doubt(sensor, colours, stated);
                let green_at_start = |m: Mosaic| m.channel(0, 0) == Some(1);
                match green_at_start(sensor) == green_at_start(stated) {
                    true => assert_eq!(found, None, "{sensor:?} as {stated:?}"),
                    false => assert!(
                        matches!(&found, Some(FilterDoubt::OtherDiagonal { orders, .. })
                            if orders.contains(&sensor)),
                        "{sensor:?} as {stated:?}: {found:?}"
                    ),
                }
            }
            let found = doubt(sensor, colours, Mosaic::None);
            assert!(
                matches!(&found, Some(FilterDoubt::Mosaic { orders, .. }) if orders.contains(&sensor)),
                "{sensor:?}: {found:?}"
            );
        }
    }

    #[test]
    fn grey_scenes_and_monochrome_sensors_say_nothing() {
        for stated in [Mosaic::None, Mosaic::Rggb, Mosaic::Grbg] {
            assert_eq!(doubt(Mosaic::None, [500.0; 3], stated), None, "{stated:?}");
            // Greens that are unequally sensitive by a few percent are greens.
            assert_eq!(doubt(Mosaic::Rggb, [500.0, 515.0, 500.0], stated), None);
        }
    }
}
