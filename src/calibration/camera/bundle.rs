//! Camera and board poses together, by Levenberg–Marquardt on the corners.

use glam::{DMat3, DQuat, DVec2, DVec3};
use nalgebra::{DMatrix, DVector, Matrix2};

use super::model::{Model, Number, Terms};
use super::start::{BoardFrame, focal_px, homography, pose};
use super::views::{View, find};
use super::{Board, CameraError, CameraFit, Residual};
use crate::calibration::mirror_sphere::Grey;
use crate::frames::{self, Rigid, Sample};
use crate::transport::Camera;

const ROUNDS: usize = 60;
/// Corners beyond this many deviations lose weight, and beyond that many count no more.
const ROBUST: [f64; 2] = [3.0, 5.0];
/// Side of the grid of cells by which the image's cover is counted.
const CELLS: usize = 4;
const LEAST_COVER: f64 = 0.6;
const LEAST_TILT_DEG: f64 = 10.0;
/// A camera that leaves more than this explains nothing, pixels.
const LARGEST_RMS_PX: f64 = 0.5;
/// Part of the corners that may be wrong.
const MOST_REJECTED: f64 = 0.2;
/// Median of χ² with two degrees of freedom.
const MEDIAN_CHI2: f64 = 1.386;

/// What is sought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraOptions {
    /// Distortion.
    pub terms: Terms,
    /// Views that must show the board; a perspective camera needs 3, a telecentric one 1.
    pub least_views: usize,
    /// The image whose board lies at the sample's datum, from 0.
    pub datum: Option<usize>,
}

/// Finds the camera from images of a board; `described` is its kind, its start, and where
/// it roughly stands. Also tells which images show no board.
///
/// # Errors
/// See [`CameraError`].
pub fn calibrate(
    images: &[Grey],
    described: &Camera,
    board: &Board,
    options: &CameraOptions,
) -> Result<(CameraFit, Vec<CameraError>), CameraError> {
    check(images, described, board, options)?;
    let mut missed = Vec::new();
    let mut views = Vec::new();
    for (index, image) in images.iter().enumerate() {
        match find(image, board, index) {
            Ok(view) => views.push((index, view)),
            Err(error @ CameraError::NotFound { .. }) if options.datum != Some(index) => {
                missed.push(error);
            }
            Err(error) => return Err(error),
        }
    }
    if views.len() < options.least_views {
        return Err(CameraError::TooFewViews {
            found: views.len(),
            needed: options.least_views,
        });
    }
    for (index, view) in &views {
        if options.datum == Some(*index) && !view.whole {
            return Err(CameraError::NotWhole { index: *index });
        }
    }
    let mut bundle = Bundle::start(described, board, options, &views)?;
    bundle.solve(true);
    let cut = ROBUST[1] * bundle.spread();
    bundle.reject(cut);
    bundle.solve(false);
    let fit = bundle.finish(described, board, options)?;
    Ok((fit, missed))
}

fn check(
    images: &[Grey],
    described: &Camera,
    board: &Board,
    options: &CameraOptions,
) -> Result<(), CameraError> {
    let impossible = |what, value: String, allowed| {
        Err(CameraError::Impossible {
            what,
            value,
            allowed,
        })
    };
    if board.squares.iter().any(|n| !(4..=200).contains(n)) {
        let allowed = "from 4 to 200 along each side";
        return impossible(
            "the number of squares",
            format!("{:?}", board.squares),
            allowed,
        );
    }
    if !(1e-4..=1e4).contains(&board.square_mm) {
        let allowed = "from 0.0001 to 10000 mm";
        return impossible("the side of a square", board.square_mm.to_string(), allowed);
    }
    if !(0.0..=0.1 * board.square_mm).contains(&board.square_std_mm) {
        let allowed = "from 0 to a tenth of it";
        let value = board.square_std_mm.to_string();
        return impossible("the uncertainty of a square's side", value, allowed);
    }
    if !(0.0..=10.0).contains(&board.tilt_std_deg) {
        let allowed = "from 0 to 10 degrees";
        return impossible("the board's tilt", board.tilt_std_deg.to_string(), allowed);
    }
    if let Some(datum) = options.datum.filter(|datum| *datum >= images.len()) {
        let allowed = "that of one of the images";
        return impossible("the view at the datum", (datum + 1).to_string(), allowed);
    }
    for image in images {
        if [image.width, image.height] != described.resolution_px {
            let [w, h] = described.resolution_px;
            let value = format!(
                "{} × {} where the camera has {w} × {h}",
                image.width, image.height
            );
            return impossible("the size of an image", value, "that of the camera");
        }
    }
    Ok(())
}

/// One corner of one view.
struct Point {
    view: usize,
    image: usize,
    board_mm: DVec2,
    at_px: DVec2,
    /// Takes an offset to units of its deviation.
    whiten: Matrix2<f64>,
    used: bool,
}

struct Bundle {
    model: Model,
    sought: Vec<Number>,
    poses: Vec<Rigid<frames::Camera, BoardFrame>>,
    /// Numbers of a pose that are sought, of rotation and translation.
    free: &'static [usize],
    points: Vec<Point>,
    square_mm: f64,
    images: Vec<usize>,
}

impl Bundle {
    fn start(
        described: &Camera,
        board: &Board,
        options: &CameraOptions,
        views: &[(usize, View)],
    ) -> Result<Self, CameraError> {
        let described_model = Model::of(described);
        let mut points = Vec::new();
        let mut homographies = Vec::new();
        for (number, (image, view)) in views.iter().enumerate() {
            let pairs: Vec<_> = view
                .seen
                .iter()
                .map(|s| (board.place_mm(s.place), s.corner.at_px))
                .collect();
            let degenerate = CameraError::NotFound {
                index: *image,
                found: view.seen.len(),
            };
            homographies.push(homography(&pairs).ok_or(degenerate)?);
            for (seen, (board_mm, at_px)) in view.seen.iter().zip(pairs) {
                let Some(factor) = seen.corner.covariance.cholesky() else {
                    continue;
                };
                points.push(Point {
                    view: number,
                    image: *image,
                    board_mm,
                    at_px,
                    whiten: factor.l().try_inverse().unwrap_or_default(),
                    used: true,
                });
            }
        }
        let middle = 0.5 * DVec2::from_array(described.resolution_px.map(|n| n as f64));
        let scale = match described_model.is_telecentric() {
            true => {
                let scale = |h: &DMat3| (h.x_axis / h.z_axis.z).truncate().length();
                DVec2::splat(
                    homographies.iter().map(scale).sum::<f64>() / homographies.len() as f64,
                )
            }
            false => match focal_px(&homographies, middle) {
                Some(focal_px) => DVec2::splat(focal_px),
                None => described_model.scale(),
            },
        };
        let model = described_model.plain(scale);
        Ok(Self {
            model,
            sought: model.sought(options.terms),
            poses: homographies.iter().map(|h| pose(&model, *h)).collect(),
            // Seen flat, a telecentric camera tells a turn about its axis and two shifts.
            free: match model.is_telecentric() {
                true => &[2, 3, 4],
                false => &[0, 1, 2, 3, 4, 5],
            },
            points,
            square_mm: board.square_mm,
            images: views.iter().map(|(image, _)| *image).collect(),
        })
    }

    fn count(&self) -> usize {
        self.sought.len() + self.free.len() * self.poses.len()
    }

    /// Seen against explained, in deviations; large where the point is behind the camera.
    fn off(&self, model: &Model, pose: &Rigid<frames::Camera, BoardFrame>, p: &Point) -> DVec2 {
        match model.position_px(pose.point(p.board_mm.extend(0.0))) {
            Some(at) => {
                let off = p.at_px - at;
                let white = p.whiten * nalgebra::Vector2::new(off.x, off.y);
                DVec2::new(white.x, white.y)
            }
            None => DVec2::splat(1e6),
        }
    }

    fn offs(&self) -> Vec<DVec2> {
        let off = |p: &Point| self.off(&self.model, &self.poses[p.view], p);
        self.points.iter().map(off).collect()
    }

    /// Deviations of the typical corner: its own uncertainty may be too small.
    fn spread(&self) -> f64 {
        let mut squares: Vec<f64> = self.offs().iter().map(|o| o.length_squared()).collect();
        squares.sort_by(f64::total_cmp);
        let median = squares.get(squares.len() / 2).copied().unwrap_or(1.0);
        (median / MEDIAN_CHI2).sqrt().max(1e-3)
    }

    fn reject(&mut self, beyond: f64) {
        let offs = self.offs();
        for (point, off) in self.points.iter_mut().zip(offs) {
            point.used = off.length() <= beyond;
        }
    }

    /// Cost and weights: squares up to a bound, beyond linear.
    fn cost(&self, bound: f64) -> (f64, Vec<f64>) {
        let mut cost = 0.0;
        let weights = self.points.iter().zip(self.offs()).map(|(point, off)| {
            let d = off.length();
            if !point.used {
                return 0.0;
            }
            let weight = if d > bound { bound / d } else { 1.0 };
            cost += if d > bound {
                2.0 * bound * d - bound * bound
            } else {
                d * d
            };
            weight
        });
        let weights = weights.collect();
        (cost, weights)
    }

    fn solve(&mut self, robust: bool) {
        let mut damping = 1e-3;
        for _ in 0..ROUNDS {
            let bound = match robust {
                true => ROBUST[0] * self.spread(),
                false => f64::INFINITY,
            };
            let (cost, weights) = self.cost(bound);
            let (normal, right) = self.system(&weights);
            let mut accepted = false;
            while damping < 1e12 {
                let mut damped = normal.clone();
                for i in 0..damped.nrows() {
                    damped[(i, i)] *= 1.0 + damping;
                }
                let Some(factor) = damped.cholesky() else {
                    damping *= 10.0;
                    continue;
                };
                let step = factor.solve(&right);
                let before = (self.model, self.poses.clone());
                self.take(&step);
                let (next, _) = self.cost(bound);
                if next < cost {
                    damping = (0.1 * damping).max(1e-9);
                    accepted = cost - next > 1e-10 * cost;
                    break;
                }
                (self.model, self.poses) = before;
                damping *= 10.0;
            }
            if !accepted {
                return;
            }
        }
    }

    fn moved(
        &self,
        pose: &Rigid<frames::Camera, BoardFrame>,
        by: [f64; 6],
    ) -> Rigid<frames::Camera, BoardFrame> {
        let turn = DQuat::from_scaled_axis(DVec3::new(by[0], by[1], by[2]));
        Rigid::new(
            (turn * pose.rotation).normalize(),
            pose.translation_mm + DVec3::new(by[3], by[4], by[5]),
        )
    }

    fn take(&mut self, step: &DVector<f64>) {
        for (k, number) in self.sought.iter().enumerate() {
            self.model = self.model.with(*number, self.model.get(*number) + step[k]);
        }
        for view in 0..self.poses.len() {
            let mut by = [0.0; 6];
            for (k, &i) in self.free.iter().enumerate() {
                by[i] = step[self.sought.len() + view * self.free.len() + k];
            }
            self.poses[view] = self.moved(&self.poses[view], by);
        }
    }

    /// Normal matrix and right side; derivatives by central differences.
    fn system(&self, weights: &[f64]) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.count();
        let own = self.sought.len();
        let mut normal = DMatrix::zeros(n, n);
        let mut right = DVector::zeros(n);
        for (point, weight) in self.points.iter().zip(weights) {
            if *weight == 0.0 {
                continue;
            }
            let pose = &self.poses[point.view];
            let off = self.off(&self.model, pose, point);
            let mut columns = Vec::with_capacity(own + self.free.len());
            for (k, number) in self.sought.iter().enumerate() {
                let step = self.model.step(*number);
                let at = |sign: f64| {
                    let value = self.model.get(*number) + sign * step;
                    self.off(&self.model.with(*number, value), pose, point)
                };
                columns.push((k, (at(-1.0) - at(1.0)) / (2.0 * step)));
            }
            for (k, &i) in self.free.iter().enumerate() {
                let step = if i < 3 { 1e-5 } else { 1e-3 * self.square_mm };
                let at = |sign: f64| {
                    let mut by = [0.0; 6];
                    by[i] = sign * step;
                    self.off(&self.model, &self.moved(pose, by), point)
                };
                let column = own + point.view * self.free.len() + k;
                columns.push((column, (at(-1.0) - at(1.0)) / (2.0 * step)));
            }
            for (a, by_a) in &columns {
                right[*a] += weight * by_a.dot(off);
                for (b, by_b) in &columns {
                    normal[(*a, *b)] += weight * by_a.dot(*by_b);
                }
            }
        }
        (normal, right)
    }

    fn finish(
        &self,
        described: &Camera,
        board: &Board,
        options: &CameraOptions,
    ) -> Result<CameraFit, CameraError> {
        let offs = self.offs();
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
                let pose = &self.poses[p.view];
                let model = self.model.position_px(pose.point(p.board_mm.extend(0.0)));
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
        if !self.model.is_telecentric() {
            let found_deg = self.tilt_rad().to_degrees();
            if found_deg < LEAST_TILT_DEG {
                return Err(CameraError::SameTilt {
                    found_deg,
                    needed_deg: LEAST_TILT_DEG,
                });
            }
        }
        let weights: Vec<f64> = self.points.iter().map(|p| f64::from(p.used)).collect();
        let (normal, _) = self.system(&weights);
        let reduced_chi2 = chi2 / freedom;
        let inverse = normal.cholesky().ok_or(unexplained)?.inverse();
        let all = inverse * reduced_chi2.max(1.0);
        let own = self.sought.len();
        let mut covariance = all.view((0, 0), (own, own)).into_owned();
        let numbers: Vec<f64> = self.sought.iter().map(|n| self.model.get(*n)).collect();
        if self.model.is_telecentric() {
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
        let pose = options.datum.and_then(|datum| {
            let view = self.images.iter().position(|image| *image == datum)?;
            Some(self.datum(view, described, board, &all))
        });
        let (projection, lens) = self.model.stated();
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
            views: self.poses.len(),
        })
    }

    /// Largest angle between the board's normals.
    fn tilt_rad(&self) -> f64 {
        let normals: Vec<DVec3> = self.poses.iter().map(|p| p.direction(DVec3::Z)).collect();
        let pairs = normals
            .iter()
            .flat_map(|a| normals.iter().map(|b| a.angle_between(*b)));
        pairs.fold(0.0, f64::max)
    }

    /// The camera's pose where the board of one view lies at the sample's datum, turned by
    /// the number of quarters that comes closest to where the camera is said to stand.
    fn datum(
        &self,
        view: usize,
        described: &Camera,
        board: &Board,
        all: &DMatrix<f64>,
    ) -> (Rigid<Sample, frames::Camera>, DMatrix<f64>) {
        let camera_from_board = self.poses[view];
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
        if self.model.is_telecentric() {
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
        if self.model.is_telecentric() {
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
