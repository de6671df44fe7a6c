//! Lights that stand still, each in its direction.

use crate::units::StageAngles;

/// Lights at fixed directions: a dome's, or the places of a stage that an
/// operator sets by hand.
#[derive(Clone, Debug, PartialEq)]
pub struct FixedLights {
    /// Direction of each light, in the order of their numbers.
    pub directions: Vec<StageAngles>,
    /// A target this near to a light is that light's, degrees.
    pub tolerance_deg: f64,
}

impl FixedLights {
    /// The light nearest to a target, if it is within the tolerance; the first
    /// of equally near ones. Angles that are no numbers have none.
    pub fn nearest(&self, target: StageAngles) -> Option<usize> {
        let direction = target.to_light();
        let off_deg = |light: &StageAngles| {
            // Well conditioned near 0, unlike the arc cosine.
            let chord = light.to_light().distance(direction);
            (2.0 * (0.5 * chord).min(1.0).asin()).to_degrees()
        };
        self.directions
            .iter()
            .map(off_deg)
            .enumerate()
            .filter(|(_, off_deg)| *off_deg <= self.tolerance_deg)
            .min_by(|(_, a), (_, b)| a.total_cmp(b))
            .map(|(index, _)| index)
    }

    /// What can be reached, as text.
    pub fn limits(&self) -> String {
        format!(
            "{} fixed lights, each within {}°",
            self.directions.len(),
            self.tolerance_deg
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn angles(azimuth_deg: f64, elevation_deg: f64) -> StageAngles {
        StageAngles::new(azimuth_deg, elevation_deg)
    }

    /// Rings at 20°, 50° and 80°: neighbours are at least 4° apart.
    fn dome() -> FixedLights {
        let ring = |elevation_deg| (0..15).map(move |i| angles(f64::from(i) * 24.0, elevation_deg));
        FixedLights {
            directions: [20.0, 50.0, 80.0].into_iter().flat_map(ring).collect(),
            tolerance_deg: 1.0,
        }
    }

    proptest! {
        #[test]
        fn every_light_is_found_from_near_it_only(
            light in 0..45usize,
            turn in -2..3i32,
            off_deg in 0.0..2.0f64,
        ) {
            let dome = dome();
            let exact = dome.directions[light];
            let near = angles(
                exact.azimuth_deg + 360.0 * f64::from(turn),
                exact.elevation_deg + off_deg,
            );
            prop_assume!((off_deg - 1.0).abs() > 1e-6);
            let expected = (off_deg < 1.0).then_some(light);
            prop_assert_eq!(dome.nearest(near), expected);
        }
    }

    #[test]
    fn what_is_no_direction_has_no_light() {
        for target in [
            angles(f64::NAN, 20.0),
            angles(0.0, f64::INFINITY),
            angles(0.0, -20.0),
        ] {
            assert_eq!(dome().nearest(target), None, "{target}");
        }
    }
}
