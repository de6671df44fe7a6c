//! The table at any pair of angles.

use super::{AngleTable, FitRecord, Interval};
use crate::brdf::{BrdfError, HalfDifference};

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
        let around = self.around([theta_h_deg, theta_d_deg])?;
        Some(relative(&around, channel))
    }

    /// The four cells around a pair of angles, degrees, with their shares, which sum to 1.
    fn around(&self, [theta_h_deg, theta_d_deg]: [f64; 2]) -> Option<[(&Interval, f64); 4]> {
        let (i, u) = between(&self.theta_h_deg, theta_h_deg)?;
        let (j, v) = between(&self.theta_d_deg, theta_d_deg)?;
        Some([
            (self.cell(i, j)?, (1.0 - u) * (1.0 - v)),
            (self.cell(i, j + 1)?, (1.0 - u) * v),
            (self.cell(i + 1, j)?, u * (1.0 - v)),
            (self.cell(i + 1, j + 1)?, u * v),
        ])
    }
}

impl FitRecord {
    /// The BRDF and its 95% interval at half and difference angles (degrees, 0 to 90) and azimuths
    /// φd (degrees), as [`Fit::intervals_at`](crate::inverse::Fit::intervals_at) has them while all
    /// posterior samples are there. The BRDF is the material's; relative to it the interval is
    /// that of the table, which is at φd = 90°: in its cells the same, between them interpolated.
    /// The images constrain it where they constrain every cell around.
    ///
    /// # Errors
    /// As of [`FitRecord::mixture`].
    pub fn intervals(&self, angles_deg: &[[f64; 3]]) -> Result<Vec<Interval>, BrdfError> {
        let material = self.fitted()?;
        let at = |&[theta_h_deg, theta_d_deg, phi_d_deg]: &[f64; 3]| {
            let dictionary = material.mixture.dictionary();
            let atoms = dictionary.values_of(HalfDifference {
                theta_h_rad: theta_h_deg.to_radians(),
                theta_d_rad: theta_d_deg.to_radians(),
                phi_d_rad: phi_d_deg.to_radians(),
            });
            let value = material.at(&atoms, theta_h_deg, theta_d_deg, phi_d_deg);
            let Some(around) = self.table.around([theta_h_deg, theta_d_deg]) else {
                return Interval {
                    value,
                    lower: value,
                    upper: value,
                    constrained: false,
                };
            };
            let whole = around.iter().find(|(_, share)| *share == 1.0);
            if let Some((cell, _)) = whole.filter(|_| phi_d_deg == 90.0) {
                return **cell;
            }
            let end =
                |end: usize| [0, 1, 2].map(|c| value[c] * 10f64.powf(relative(&around, c)[end]));
            Interval {
                value,
                lower: end(0),
                upper: end(1),
                constrained: around
                    .iter()
                    .all(|(cell, share)| cell.constrained || *share == 0.0),
            }
        };
        Ok(angles_deg.iter().map(at).collect())
    }
}

/// log10 of lower/f and upper/f of one channel, between cells with these shares.
fn relative(around: &[(&Interval, f64); 4], channel: usize) -> [f64; 2] {
    let log = |value: f64| value.max(SMALLEST).log10();
    let mut sum = [0.0; 2];
    for (cell, share) in around {
        let value = log(cell.value[channel]);
        sum[0] += share * (log(cell.lower[channel]) - value);
        sum[1] += share * (log(cell.upper[channel]) - value);
    }
    sum
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
