//! From fitted corners to a calibrated camera: whether it explains them, its uncertainty,
//! and its pose.

use glam::{DMat3, DQuat, DVec2, DVec3};
use nalgebra::DMatrix;

use super::bundle::{Bundle, CameraOptions};
use super::start::BoardFrame;
use super::{Board, CameraError, CameraFit, Residual};
use crate::frames::{self, Rigid, Sample};
use crate::least_squares::Problem;
use crate::transport::Camera;

/// Side of the grid of cells by which the image's cover is counted.
const CELLS: usize = 4;
const LEAST_COVER: f64 = 0.6;
const LEAST_TILT_DEG: f64 = 10.0;
/// A camera that leaves more than this explains nothing, pixels.
const LARGEST_RMS_PX: f64 = 0.5;
/// Part of the corners that may be wrong.
const MOST_REJECTED: f64 = 0.2;

impl Bundle {
    /// The camera with its uncertainty, once the corners are fitted.
    ///
    /// # Errors
    /// See [`CameraError`]: views that the model does not explain, or that do not determine it.
    pub(super) fn finish(
        &mut self,
        described: &Camera,
        board: &Board,
        options: &CameraOptions,
    ) -> Result<CameraFit, CameraError> {
        // Residuals, in deviations and in pixels.
        let offs = self.offs(&self.at);
        let used = self.points.iter().filter(|p| p.used).count();
        let chi2: f64 = self
            .points
            .iter()
            .zip(&offs)
            .filter(|(p, _)| p.used)
            .map(|(_, off)| off.length_squared())
            .sum();
        let residuals: Vec<Residual> = self
            .points
            .iter()
            .map(|p| {
                let pose = &self.at.boards[p.view];
                let model = self
                    .at
                    .model
                    .position_px(pose.point(p.board_mm.extend(0.0)));
                Residual {
                    view: p.image,
                    at_px: p.at_px,
                    off_px: p.at_px - model.unwrap_or(DVec2::NAN),
                    used: p.used,
                }
            })
            .collect();
        let counted = residuals.iter().filter(|r| r.used);
        let squares: f64 = counted.clone().map(|r| r.off_px.length_squared()).sum();
        let rms_px = (squares / used.max(1) as f64).sqrt();
        let freedom = 2.0 * used as f64 - self.count() as f64;
        // Whether the model explains the corners, and the views determine it.
        let rejected = self.points.len() - used;
        let unexplained = CameraError::Unexplained {
            rms_px,
            rejected,
            corners: self.points.len(),
        };
        let few = rejected as f64 > MOST_REJECTED * self.points.len() as f64;
        if rms_px.is_nan() || rms_px > LARGEST_RMS_PX || few || freedom <= 0.0 {
            return Err(unexplained);
        }
        let coverage = coverage(&residuals, described.resolution_px);
        if coverage < LEAST_COVER {
            return Err(CameraError::Uncovered {
                percent: 100.0 * coverage,
                needed: 100.0 * LEAST_COVER,
            });
        }
        if !self.at.model.is_telecentric() {
            let found_deg = self.tilt_rad().to_degrees();
            if found_deg < LEAST_TILT_DEG {
                return Err(CameraError::SameTilt {
                    found_deg,
                    needed_deg: LEAST_TILT_DEG,
                });
            }
        }
        // The covariance, scaled up where residuals exceed the corners' own uncertainty.
        let reduced_chi2 = chi2 / freedom;
        let at = self.at.clone();
        let own = self.linearise(&at).covariance().ok_or(unexplained)?;
        let all = own * reduced_chi2.max(1.0);
        let own = self.sought.len();
        let mut covariance = all.view((0, 0), (own, own)).into_owned();
        let numbers: Vec<f64> = self.sought.iter().map(|n| self.at.model.get(*n)).collect();
        if self.at.model.is_telecentric() {
            // Larger squares, or a board that is tilted, and so looks shorter, mean another
            // magnification.
            let relative = board.square_std_mm / board.square_mm;
            let shorter = 0.5 * board.tilt_std_deg.to_radians().powi(2);
            for i in 0..2 {
                for j in 0..2 {
                    covariance[(i, j)] += relative.powi(2) * numbers[i] * numbers[j];
                }
                covariance[(i, i)] += (shorter * numbers[i]).powi(2);
            }
        }
        // The pose, and a check that the lens does not fold the image.
        let pose = options.datum.and_then(|datum| {
            let view = self.images.iter().position(|image| *image == datum)?;
            Some(self.datum(view, described, board, &all))
        });
        let (projection, lens) = self.at.model.stated();
        Camera {
            projection,
            ..*described
        }
        .with_lens(lens)?;
        Ok(CameraFit {
            projection,
            lens,
            names: self.sought.iter().map(|n| n.name).collect(),
            numbers,
            covariance,
            pose,
            residuals,
            rms_px,
            reduced_chi2,
            coverage,
            views: self.at.boards.len(),
        })
    }

    /// Largest angle between the board's normals.
    fn tilt_rad(&self) -> f64 {
        let normals: Vec<DVec3> = self
            .at
            .boards
            .iter()
            .map(|p| p.direction(DVec3::Z))
            .collect();
        let pairs = normals
            .iter()
            .flat_map(|a| normals.iter().map(|b| a.angle_between(*b)));
        pairs.fold(0.0, f64::max)
    }

    /// The camera's pose where the board of one view lies at the sample's datum, turned by
    /// the number of quarters that comes closest to the camera's described pose.
    fn datum(
        &self,
        view: usize,
        described: &Camera,
        board: &Board,
        all: &DMatrix<f64>,
    ) -> (Rigid<Sample, frames::Camera>, DMatrix<f64>) {
        let camera_from_board = self.at.boards[view];
        let quarter = std::f64::consts::FRAC_PI_2;
        let quarters = (0..4).map(|k| DQuat::from_rotation_z(f64::from(k) * quarter));
        let candidates = quarters.map(|turn| {
            let sample_from_board: Rigid<Sample, BoardFrame> = Rigid::new(turn, DVec3::ZERO);
            sample_from_board * camera_from_board.inverse()
        });
        let far = |p: &Rigid<Sample, frames::Camera>| {
            p.rotation
                .angle_between(described.sample_from_camera.rotation)
        };
        let mut pose = candidates
            .min_by(|a, b| far(a).total_cmp(&far(b)))
            .unwrap_or(described.sample_from_camera);
        // Of the two quaternions the one of the shorter turn.
        pose.rotation = pose.rotation * pose.rotation.w.signum();
        if self.at.model.is_telecentric() {
            // Depth is not seen.
            pose.translation_mm.z = described.sample_from_camera.translation_mm.z;
        }
        let turn = DMat3::from_quat(pose.rotation);
        let at = camera_from_board.translation_mm;
        let free = self.free.len();
        // A turn δ and a shift s of the board are one of −Rδ and R(δ × t − s) of the camera.
        let to_sample = DMatrix::from_fn(6, free, |row, k| {
            let i = self.free[k];
            let axis = DVec3::AXES[i % 3];
            let (turned, shifted) = match i < 3 {
                true => (-(turn * axis), turn * axis.cross(at)),
                false => (DVec3::ZERO, -(turn * axis)),
            };
            if row < 3 {
                turned[row]
            } else {
                shifted[row - 3]
            }
        });
        let from = self.sought.len() + view * free;
        let own = all.view((from, from), (free, free)).into_owned();
        let mut covariance = &to_sample * own * to_sample.transpose();
        let relative = board.square_std_mm / board.square_mm;
        for i in 0..3 {
            for j in 0..3 {
                covariance[(3 + i, 3 + j)] +=
                    relative.powi(2) * pose.translation_mm[i] * pose.translation_mm[j];
            }
        }
        if self.at.model.is_telecentric() {
            for i in 0..2 {
                covariance[(i, i)] += board.tilt_std_deg.to_radians().powi(2);
            }
        }
        (pose, covariance)
    }
}

/// Part of the image's cells with corners.
fn coverage(residuals: &[Residual], resolution_px: [usize; 2]) -> f64 {
    let mut covered = [[false; CELLS]; CELLS];
    let cell = |at: f64, size: usize| ((at / size as f64 * CELLS as f64) as usize).min(CELLS - 1);
    for r in residuals.iter().filter(|r| r.used) {
        covered[cell(r.at_px.y, resolution_px[1])][cell(r.at_px.x, resolution_px[0])] = true;
    }
    let count = covered.iter().flatten().filter(|c| **c).count();
    count as f64 / (CELLS * CELLS) as f64
}
