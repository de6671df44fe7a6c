//! A first guess: the board's homography in each view, and by Zhang's constraints the focal
//! length.

use glam::{DMat3, DQuat, DVec2, DVec3};
use nalgebra::DMatrix;

use super::model::Model;
use crate::frames::{self, Rigid};

/// The board's own frame: origin in its middle, x along its columns, y along its rows, z out
/// of its front.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardFrame;

/// A point of the board (millimetres) and where it was seen (pixels).
pub type Pair = (DVec2, DVec2);

/// The homography from board to image by the direct linear transform; `None` where the
/// points do not determine it.
pub fn homography(pairs: &[Pair]) -> Option<DMat3> {
    let (from, from_normal) = normalised(pairs.iter().map(|p| p.0));
    let (to, to_normal) = normalised(pairs.iter().map(|p| p.1));
    let mut rows = DMatrix::zeros(2 * pairs.len(), 9);
    for (k, (a, b)) in from.iter().zip(&to).enumerate() {
        for (i, (row, other)) in [(0, b.x), (1, b.y)].into_iter().enumerate() {
            for (j, value) in [a.x, a.y, 1.0].into_iter().enumerate() {
                rows[(2 * k + i, 3 * row + j)] = value;
                rows[(2 * k + i, 6 + j)] = -other * value;
            }
        }
    }
    let normal = rows.transpose() * rows;
    let eigen = normal.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let h = eigen.eigenvectors.column(least);
    let matrix = DMat3::from_cols(
        DVec3::new(h[0], h[3], h[6]),
        DVec3::new(h[1], h[4], h[7]),
        DVec3::new(h[2], h[5], h[8]),
    );
    let matrix = to_normal.inverse() * matrix * from_normal;
    (matrix.is_finite() && matrix.determinant() != 0.0).then_some(matrix)
}

/// Points moved to the origin and scaled to unit size, and the matrix that does it.
fn normalised(points: impl Iterator<Item = DVec2> + Clone) -> (Vec<DVec2>, DMat3) {
    let count = points.clone().count().max(1) as f64;
    let mean = points.clone().sum::<DVec2>() / count;
    let spread = points.clone().map(|p| (p - mean).length()).sum::<f64>() / count;
    let scale = 1.0 / spread.max(1e-12);
    let matrix = DMat3::from_cols(
        DVec3::new(scale, 0.0, 0.0),
        DVec3::new(0.0, scale, 0.0),
        DVec3::new(-scale * mean.x, -scale * mean.y, 1.0),
    );
    (points.map(|p| (p - mean) * scale).collect(), matrix)
}

/// Focal length in pixels, for square pixels and the principal point in the image's middle:
/// the board's axes are at right angles and of one length in every view. `None` where the
/// views do not determine it.
pub fn focal_px(homographies: &[DMat3], middle_px: DVec2) -> Option<f64> {
    let to_middle = DMat3::from_cols(DVec3::X, DVec3::Y, (-middle_px).extend(1.0));
    let (mut squares, mut products) = (0.0, 0.0);
    for h in homographies {
        let h = to_middle * *h;
        let (a, b) = (h.x_axis, h.y_axis);
        let size = a.length() * b.length();
        for (without, with) in [
            (a.z * b.z, a.x * b.x + a.y * b.y),
            (
                a.z * a.z - b.z * b.z,
                a.truncate().length_squared() - b.truncate().length_squared(),
            ),
        ] {
            let (without, with) = (without / size, with / size);
            squares += with * with;
            products -= with * without;
        }
    }
    let inverse_square = products / squares;
    (inverse_square.is_finite() && inverse_square > 0.0).then(|| inverse_square.recip().sqrt())
}

/// Where the board is, by its homography.
pub fn pose(model: &Model, homography: DMat3) -> Rigid<frames::Camera, BoardFrame> {
    let h = model.matrix().inverse() * homography;
    if model.is_telecentric() {
        // Flat before the camera: the front looks against the view.
        let across = homography.x_axis.truncate() / homography.z_axis.z / model.scale();
        let middle = homography.z_axis / homography.z_axis.z;
        let middle = model.matrix().inverse() * middle;
        let turn = DQuat::from_rotation_z(across.to_angle())
            * DQuat::from_rotation_x(std::f64::consts::PI);
        return Rigid::new(turn, middle.truncate().extend(100.0));
    }
    let mut scale = 2.0 / (h.x_axis.length() + h.y_axis.length());
    if h.z_axis.z < 0.0 {
        scale = -scale;
    }
    let (x, y) = (h.x_axis * scale, h.y_axis * scale);
    let x = x.normalize();
    let z = x.cross(y).normalize();
    let rotation = DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z));
    Rigid::new(rotation, h.z_axis * scale)
}
