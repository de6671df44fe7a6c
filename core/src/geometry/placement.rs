//! How a mesh file's coordinates become the sample's: unit, position, and which side is
//! the front.

use glam::{DQuat, DVec3};

use crate::frames::{MeshFile, Rigid, Sample};

/// What is done to a file's mesh, in this order: scaled, its facets turned, rotated, moved.
///
/// ```
/// use glam::DVec3;
/// use rig_core::frames::Rigid;
/// use rig_core::geometry::Placement;
/// use rig_core::geometry::placement::{angles_xyz_deg, rotation_xyz};
///
/// // A file in inches, turned by 90° about x, then raised by 5 mm.
/// let rotation = rotation_xyz([90.0, 0.0, 0.0]);
/// let placement = Placement {
///     mm_per_unit: 25.4,
///     sample_from_mesh: Rigid::new(rotation, DVec3::new(0.0, 0.0, 5.0)),
///     ..Placement::default()
/// };
/// let moved = placement.sample_from_mesh.point(DVec3::Y);
/// assert!(moved.distance(DVec3::new(0.0, 0.0, 6.0)) < 1e-12);
/// assert!((angles_xyz_deg(rotation)[0] - 90.0).abs() < 1e-9);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Millimetres of one unit of the file's coordinates.
    pub mm_per_unit: f64,
    /// Whether the other side of every facet is its front.
    pub flip_facets: bool,
    /// From the file's axes, millimetres, to the sample's.
    pub sample_from_mesh: Rigid<Sample, MeshFile>,
}

impl Default for Placement {
    fn default() -> Self {
        Self {
            mm_per_unit: 1.0,
            flip_facets: false,
            sample_from_mesh: Rigid::identity(),
        }
    }
}

impl Placement {
    /// A file in another unit, else as it is.
    pub fn scaled(mm_per_unit: f64) -> Self {
        Self {
            mm_per_unit,
            ..Self::default()
        }
    }

    /// A point of the file, millimetres, sample frame. Without rotation or translation a
    /// coordinate is its product with the unit, to the last bit.
    pub(super) fn point(&self, position: DVec3) -> DVec3 {
        let position_mm = position * self.mm_per_unit;
        match self.sample_from_mesh == Rigid::identity() {
            true => position_mm,
            false => self.sample_from_mesh.point(position_mm),
        }
    }
}

/// The rotation about the fixed axis x, then y, then z, by angles in degrees, each
/// counter-clockwise as seen from the axis' end.
pub fn rotation_xyz(rotate_deg: [f64; 3]) -> DQuat {
    let [x, y, z] = rotate_deg.map(f64::to_radians);
    DQuat::from_rotation_z(z) * DQuat::from_rotation_y(y) * DQuat::from_rotation_x(x)
}

/// The angles of [`rotation_xyz`], degrees.
pub fn angles_xyz_deg(rotation: DQuat) -> [f64; 3] {
    let (z, y, x) = rotation.to_euler(glam::EulerRot::ZYX);
    // No negative zero.
    [x, y, z].map(|angle| angle.to_degrees() + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_about_fixed_axes_in_their_order() {
        let turned = rotation_xyz([90.0, 0.0, 90.0]) * DVec3::Y;
        // About x, y becomes z; about z that stays.
        assert!((turned - DVec3::Z).length() < 1e-12, "{turned}");
        for angles in [[10.0, -20.0, 130.0], [180.0, 0.0, 0.0], [-170.0, 60.0, 5.0]] {
            let rotation = rotation_xyz(angles);
            let back = rotation_xyz(angles_xyz_deg(rotation));
            assert!(rotation.angle_between(back) < 1e-6, "{angles:?}");
        }
    }
}
