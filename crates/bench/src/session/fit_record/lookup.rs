//! The table at any pair of angles.

use super::{AngleTable, Interval};

/// Values below this count as this where logarithms are taken, 1/sr.
pub const SMALLEST: f64 = 1e-6;

impl AngleTable {
    /// The cell nearest to a pair of angles, degrees; `None` of an empty table.
    pub fn nearest(&self, theta_h_deg: f64, theta_d_deg: f64) -> Option<&Interval> {
        self.cell(
            nearest_index(&self.theta_h_deg, theta_h_deg)?,
            nearest_index(&self.theta_d_deg, theta_d_deg)?,
        )
    }

    /// Whether the images constrain the cell nearest to a pair of angles, degrees.
    pub fn is_constrained(&self, theta_h_deg: f64, theta_d_deg: f64) -> bool {
        self.nearest(theta_h_deg, theta_d_deg)
            .is_some_and(|cell| cell.constrained)
    }

    /// log10 of lower/f and upper/f of one channel, interpolated between the cells. Away
    /// from φd = 90° the interval is taken to be as wide, relatively, as there.
    pub fn relative_interval(
        &self,
        [theta_h_deg, theta_d_deg]: [f64; 2],
        channel: usize,
    ) -> Option<[f64; 2]> {
        let log = |value: f64| value.max(SMALLEST).log10();
        let (i, u) = between(&self.theta_h_deg, theta_h_deg)?;
        let (j, v) = between(&self.theta_d_deg, theta_d_deg)?;
        let mut sum = [0.0; 2];
        for (di, wi) in [(0, 1.0 - u), (1, u)] {
            for (dj, wj) in [(0, 1.0 - v), (1, v)] {
                let cell = self.cell(i + di, j + dj)?;
                let value = log(cell.value[channel]);
                sum[0] += wi * wj * (log(cell.lower[channel]) - value);
                sum[1] += wi * wj * (log(cell.upper[channel]) - value);
            }
        }
        Some(sum)
    }
}

/// Index of the angle that is nearest to `angle`; `angles` increase.
pub fn nearest_index(angles: &[f64], angle: f64) -> Option<usize> {
    let right = angles.partition_point(|x| *x < angle);
    let candidates = [
        right.checked_sub(1),
        (right < angles.len()).then_some(right),
    ];
    let distance = |index: &usize| (angles[*index] - angle).abs();
    candidates
        .into_iter()
        .flatten()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

/// Position of `angle` between two grid angles: index of the left one and the part of the way.
fn between(angles: &[f64], angle: f64) -> Option<(usize, f64)> {
    let last = angles.len().checked_sub(2)?;
    let left = angles
        .partition_point(|x| *x <= angle)
        .saturating_sub(1)
        .min(last);
    let part = (angle - angles[left]) / (angles[left + 1] - angles[left]);
    Some((left, part.clamp(0.0, 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_and_between() {
        let angles = [0.0, 10.0, 30.0];
        assert_eq!(
            [-1.0, 4.0, 21.0, 99.0].map(|x| nearest_index(&angles, x)),
            [0, 0, 2, 2].map(Some)
        );
        assert_eq!(between(&angles, 15.0), Some((1, 0.25)));
        assert_eq!(between(&angles, 99.0), Some((1, 1.0)));
        assert_eq!(between(&angles[..1], 0.0), None);
    }
}
