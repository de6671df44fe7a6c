//! One axis: from its coordinate to the controller's position.

use serde::{Deserialize, Serialize};

/// How an axis' coordinate (degrees on a rotary axis, mm on a linear one) maps
/// to the controller's position: position = (coordinate − `offset`) · `scale`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisMap {
    /// Controller units per degree or mm; not 0, negative where the axis runs
    /// the other way.
    pub scale: f64,
    /// The coordinate at controller position 0.
    pub offset: f64,
    /// Smallest coordinate (soft limit).
    pub min: f64,
    /// Largest coordinate (soft limit).
    pub max: f64,
}

/// Coordinates this close to a limit count as within it: less than any stage
/// resolves, more than the rounding of a full turn.
pub(super) const LIMIT_SLACK: f64 = 1e-6;

impl AxisMap {
    /// The controller's position for a coordinate.
    pub fn position(&self, coordinate: f64) -> f64 {
        (coordinate - self.offset) * self.scale
    }

    /// The coordinate of a controller's position.
    pub fn coordinate(&self, position: f64) -> f64 {
        position / self.scale + self.offset
    }

    /// Whether a coordinate is within the limits; never a non-finite one.
    pub fn reaches(&self, coordinate: f64) -> bool {
        coordinate >= self.min - LIMIT_SLACK && coordinate <= self.max + LIMIT_SLACK
    }

    /// The coordinate, or the limit that it exceeds by rounding.
    pub(super) fn clamped(&self, coordinate: f64) -> f64 {
        coordinate.max(self.min).min(self.max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn positions_and_coordinates_are_inverse(
            coordinate in -360.0..360.0f64,
            scale in prop_oneof![-100.0..-0.01f64, 0.01..100.0f64],
            offset in -360.0..360.0f64,
        ) {
            let map = AxisMap { scale, offset, min: -360.0, max: 360.0 };
            prop_assert!((map.coordinate(map.position(coordinate)) - coordinate).abs() < 1e-9);
        }
    }
}
