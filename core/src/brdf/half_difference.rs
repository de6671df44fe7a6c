//! Half and difference angles of a pair of directions (Rusinkiewicz 1998).
//!
//! h is the half vector, d the direction to the light in the frame whose pole is
//! h. An isotropic BRDF depends on (θh, θd, φd); swapping light and viewer adds π
//! to φd.

use glam::DVec3;

/// The three angles an isotropic BRDF depends on, radians.
///
/// ```
/// use glam::DVec3;
/// use rig_core::brdf::HalfDifference;
///
/// // A mirror reflection at 40°: the half vector is the normal.
/// let (sin, cos) = 40f64.to_radians().sin_cos();
/// let to_light = DVec3::new(sin, 0.0, cos);
/// let to_viewer = DVec3::new(-sin, 0.0, cos);
/// let angles = HalfDifference::from_directions(to_light, to_viewer);
/// assert!(angles.theta_h_rad < 1e-9);
/// assert!((angles.theta_d_rad.to_degrees() - 40.0).abs() < 1e-9);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfDifference {
    /// Between the normal and the half vector, [0, π/2].
    pub theta_h_rad: f64,
    /// Between the half vector and either direction, [0, π/2].
    pub theta_d_rad: f64,
    /// Azimuth of the light about the half vector, [0, 2π); 0 lies in the plane
    /// of normal and half vector, on the side away from the normal.
    pub phi_d_rad: f64,
}

impl HalfDifference {
    /// From unit vectors in the local frame. Where φd is undefined (θh = 0 or θd = 0)
    /// it is finite all the same.
    pub fn from_directions(to_light: DVec3, to_viewer: DVec3) -> Self {
        let sum = to_light + to_viewer;
        let horizontal = sum.x.hypot(sum.y);
        let theta_h_rad = horizontal.atan2(sum.z);
        let theta_d_rad = (to_light - to_viewer).length().atan2(sum.length());
        let (sin_h, cos_h) = theta_h_rad.sin_cos();
        let (cos_phi, sin_phi) = if horizontal > 0.0 {
            (sum.x / horizontal, sum.y / horizontal)
        } else {
            (1.0, 0.0)
        };
        // d = rotation about y by −θh after rotation about z by −φh.
        let along = cos_phi * to_light.x + sin_phi * to_light.y;
        let across = cos_phi * to_light.y - sin_phi * to_light.x;
        let d_x = cos_h * along - sin_h * to_light.z;
        let phi = across.atan2(d_x);
        Self {
            theta_h_rad,
            theta_d_rad,
            phi_d_rad: if phi < 0.0 {
                (phi + std::f64::consts::TAU).min(std::f64::consts::TAU.next_down())
            } else {
                phi
            },
        }
    }

    /// (to light, to viewer), unit, with the half vector in the xz plane. Either
    /// may lie below the horizon.
    pub fn to_directions(self) -> (DVec3, DVec3) {
        let (sin_h, cos_h) = self.theta_h_rad.sin_cos();
        let (sin_d, cos_d) = self.theta_d_rad.sin_cos();
        let (sin_phi, cos_phi) = self.phi_d_rad.sin_cos();
        // ±(sin θd cos φd, sin θd sin φd) about the pole h, cos θd along it.
        let place = |sign: f64| {
            let (x, y, z) = (sign * sin_d * cos_phi, sign * sin_d * sin_phi, cos_d);
            DVec3::new(cos_h * x + sin_h * z, y, cos_h * z - sin_h * x)
        };
        (place(1.0), place(-1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn angles_and_directions_are_inverse(
            theta_h_rad in 1e-3..1.5f64, theta_d_rad in 1e-3..1.5f64, phi_d_rad in 0.0..std::f64::consts::TAU
        ) {
            let there = HalfDifference { theta_h_rad, theta_d_rad, phi_d_rad };
            let (i, o) = there.to_directions();
            prop_assert!((i.length() - 1.0).abs() < 1e-12 && (o.length() - 1.0).abs() < 1e-12);
            let back = HalfDifference::from_directions(i, o);
            prop_assert!((back.theta_h_rad - theta_h_rad).abs() < 1e-9);
            prop_assert!((back.theta_d_rad - theta_d_rad).abs() < 1e-9);
            prop_assert!((back.phi_d_rad - phi_d_rad).sin().abs() < 1e-9);
            prop_assert!((back.phi_d_rad - phi_d_rad).cos() > 0.0);
            // Swapping the directions turns φd by π and nothing else.
            let swapped = HalfDifference::from_directions(o, i);
            prop_assert!((swapped.theta_h_rad - theta_h_rad).abs() < 1e-9);
            prop_assert!((swapped.theta_d_rad - theta_d_rad).abs() < 1e-9);
            prop_assert!((swapped.phi_d_rad - phi_d_rad).cos() < -1.0 + 1e-9);
        }
    }

    #[test]
    fn special_directions() {
        let coaxial = HalfDifference::from_directions(DVec3::Z, DVec3::Z);
        assert_eq!((coaxial.theta_h_rad, coaxial.theta_d_rad), (0.0, 0.0));
        let tilt = DVec3::new(0.6, 0.0, 0.8);
        let mirror = HalfDifference::from_directions(tilt, DVec3::new(-0.6, 0.0, 0.8));
        assert!(mirror.theta_h_rad < 1e-12 && (mirror.theta_d_rad.sin() - 0.6).abs() < 1e-12);
        // In the plane of incidence, the light further from the normal than h: φd = 0.
        let plane = HalfDifference::from_directions(tilt, DVec3::Z);
        assert!(plane.phi_d_rad.abs() < 1e-9);
    }
}
