//! The scale of a map's colours.

use crate::plot::Axis;

/// Ticks stand at least so far apart, as a part of the scale.
const LEAST_APART: f64 = 0.06;

/// From values to places on the colours: halfway between the place of the logarithm in its range
/// and the part of the map that is below, so that neither a narrow peak nor an even ground takes
/// all colours.
pub(super) struct MapScale {
    /// log10 of the values that are shown, ascending.
    shown: Vec<f64>,
}

impl MapScale {
    /// Of log10 of a map's values.
    pub fn new(log_values: impl Iterator<Item = f64>) -> Self {
        let mut shown: Vec<f64> = log_values.collect();
        shown.sort_by(f64::total_cmp);
        Self { shown }
    }

    /// The place of log10 of a value, 0..=1.
    pub fn place(&self, log_value: f64) -> f64 {
        let (Some(low), Some(high)) = (self.shown.first(), self.shown.last()) else {
            return 0.0;
        };
        let part = (log_value - low) / (high - low).max(1e-6);
        let below = self.shown.partition_point(|shown| *shown < log_value);
        0.5 * (part.clamp(0.0, 1.0) + below as f64 / self.shown.len() as f64)
    }

    /// The scale, with values of 1, 2 and 5 times powers of ten, and others where there is room.
    pub fn axis(&self, label: &str) -> Axis {
        let ends = self.shown.first().zip(self.shown.last());
        let (low, high) = ends.map_or((0.0, 0.0), |(low, high)| (*low, *high));
        let mut ticks: Vec<(f64, String)> = Vec::new();
        for digits in [[1.0, 2.0, 5.0], [3.0, 4.0, 7.0]] {
            for power in low.floor() as i32..=high.ceil() as i32 {
                for digit in digits {
                    let log_value = f64::log10(digit) + f64::from(power);
                    let place = self.place(log_value);
                    let has_room =
                        |(other, _): &(f64, String)| (place - other).abs() >= LEAST_APART;
                    if (low..=high).contains(&log_value) && ticks.iter().all(has_room) {
                        ticks.push((place, number(digit, power)));
                    }
                }
            }
        }
        Axis::with_ticks(0.0..1.0, ticks, label)
    }
}

fn number(digit: f64, power: i32) -> String {
    match power {
        -3..=3 => format!(
            "{:.*}",
            power.min(0).unsigned_abs() as usize,
            digit * 10f64.powi(power)
        ),
        _ => format!("{digit}e{power}").replace('-', "−"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A peak of a hundredth of the map, 10⁴ times its ground, leaves the ground half the colours.
    #[test]
    fn ground_and_peak_both_have_colours() {
        let ground = (0..990).map(|n| -1.5 + f64::from(n) / 9900.0);
        let scale = MapScale::new(ground.chain((0..10).map(|n| f64::from(n) / 4.0)));
        let places = [-1.5, -1.4, 0.0, 2.25].map(|log_value| scale.place(log_value));
        assert!(places[0] < 1e-9 && places[1] > 0.5, "{places:?}");
        assert!(places.is_sorted() && places[3] > 0.99, "{places:?}");
        assert_eq!(number(2.0, -2), "0.02");
        assert_eq!(number(5.0, 2), "500");
        assert_eq!(MapScale::new(std::iter::empty()).place(0.0), 0.0);
    }
}
