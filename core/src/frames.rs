//! Coordinate frames and the rigid transforms between them.
//!
//! A transform is named and typed `dst_from_src`: `camera_from_sample *
//! sample_from_stage` is `camera_from_stage`, and any other order does not
//! compile. Lengths are millimetres.

use std::marker::PhantomData;
use std::ops::Mul;

use glam::{DMat3, DQuat, DVec3};

/// Origin on the sample's datum, +z towards the camera side; right-handed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample;
/// +z towards the scene, x right, y down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera;
/// The light stage's own axes: azimuth about +z, elevation from the xy plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stage;
/// The axes in which a mesh file's coordinates are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshFile;

/// A rotation and a translation that take coordinates in `Src` to `Dst`.
///
/// ```
/// use glam::DVec3;
/// use rig_core::frames::{Camera, Rigid, Sample, Stage};
///
/// let sample_from_stage: Rigid<Sample, Stage> =
///     Rigid::from_rotation_vector(DVec3::Z * 90f64.to_radians(), DVec3::new(0.0, 0.0, -2.0));
/// let camera_from_sample: Rigid<Camera, Sample> =
///     Rigid::new(glam::DQuat::IDENTITY, DVec3::new(0.0, 0.0, 300.0));
/// // The types allow this order only.
/// let camera_from_stage: Rigid<Camera, Stage> = camera_from_sample * sample_from_stage;
///
/// let point = camera_from_stage.point(DVec3::X);
/// assert!(point.distance(DVec3::new(0.0, 1.0, 298.0)) < 1e-12);
/// assert!(camera_from_stage.inverse().point(point).distance(DVec3::X) < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid<Dst, Src> {
    /// Rotation, applied first.
    pub rotation: DQuat,
    /// Translation in `Dst`, millimetres, applied second.
    pub translation_mm: DVec3,
    frames: PhantomData<(Dst, Src)>,
}

impl<Dst, Src> Rigid<Dst, Src> {
    /// From a unit quaternion and a translation in `Dst`, millimetres.
    pub fn new(rotation: DQuat, translation_mm: DVec3) -> Self {
        Self {
            rotation,
            translation_mm,
            frames: PhantomData,
        }
    }

    /// The frames coincide.
    pub fn identity() -> Self {
        Self::new(DQuat::IDENTITY, DVec3::ZERO)
    }

    /// From a rotation vector (axis times angle, radians) and a translation, millimetres.
    pub fn from_rotation_vector(rotation_rad: DVec3, translation_mm: DVec3) -> Self {
        Self::new(DQuat::from_scaled_axis(rotation_rad), translation_mm)
    }

    /// A point's coordinates in `Dst`, millimetres.
    pub fn point(&self, point_mm: DVec3) -> DVec3 {
        self.rotation * point_mm + self.translation_mm
    }

    /// A direction's coordinates in `Dst`.
    pub fn direction(&self, direction: DVec3) -> DVec3 {
        self.rotation * direction
    }

    /// `src_from_dst`.
    pub fn inverse(&self) -> Rigid<Src, Dst> {
        let rotation = self.rotation.conjugate();
        Rigid::new(rotation, -(rotation * self.translation_mm))
    }
}

impl<A, B, C> Mul<Rigid<B, C>> for Rigid<A, B> {
    type Output = Rigid<A, C>;
    fn mul(self, rhs: Rigid<B, C>) -> Rigid<A, C> {
        Rigid::new(
            self.rotation * rhs.rotation,
            self.rotation * rhs.translation_mm + self.translation_mm,
        )
    }
}

/// `sample_from_camera` of a camera at `position_mm` that looks at `target_mm`;
/// `up` is the direction that points up in the image. `None` if the three are
/// degenerate (target at the camera, or `up` along the view).
///
/// ```
/// use glam::DVec3;
/// use rig_core::frames::look_at;
///
/// let sample_from_camera = look_at(DVec3::new(0.0, 0.0, 100.0), DVec3::ZERO, DVec3::Y);
/// let view = sample_from_camera.expect("`up` is not along the view").direction(DVec3::Z);
/// assert!(view.distance(DVec3::NEG_Z) < 1e-12);
/// ```
pub fn look_at(position_mm: DVec3, target_mm: DVec3, up: DVec3) -> Option<Rigid<Sample, Camera>> {
    let forward = (target_mm - position_mm).try_normalize()?;
    let across = forward.cross(up);
    if across.length() < 1e-9 {
        return None;
    }
    let right = across.try_normalize()?;
    let down = forward.cross(right);
    Some(Rigid::new(
        DQuat::from_mat3(&DMat3::from_cols(right, down, forward)),
        position_mm,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_and_product() {
        let a: Rigid<Camera, Sample> =
            Rigid::from_rotation_vector(DVec3::new(0.3, -0.2, 0.9), DVec3::new(1.0, 2.0, 3.0));
        let p = DVec3::new(-4.0, 0.5, 7.0);
        assert!((a.inverse().point(a.point(p)) - p).length() < 1e-12);
        let unit: Rigid<Camera, Camera> = a * a.inverse();
        assert!((unit.point(p) - p).length() < 1e-12);
    }

    #[test]
    fn camera_above_looks_down_with_x_right_and_y_down() {
        let sample_from_camera = look_at(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, DVec3::Y).unwrap();
        assert!((sample_from_camera.direction(DVec3::Z) + DVec3::Z).length() < 1e-12);
        assert!((sample_from_camera.direction(DVec3::X) - DVec3::X).length() < 1e-12);
        assert!((sample_from_camera.direction(DVec3::Y) + DVec3::Y).length() < 1e-12);
    }

    #[test]
    fn degenerate_views_are_refused() {
        assert!(look_at(DVec3::Z, DVec3::Z, DVec3::Y).is_none());
        assert!(look_at(DVec3::Z, DVec3::ZERO, DVec3::Z).is_none());
    }
}
