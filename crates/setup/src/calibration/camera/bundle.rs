//! Camera and board poses together, by Levenberg–Marquardt on the corners.

use glam::{DMat3, DQuat, DVec2, DVec3};
use nalgebra::{DMatrix, DVector, Matrix2};

use super::model::{Model, Number, Terms};
use super::start::{BoardFrame, focal_px, homography, pose};
use super::views::{View, find};
use super::{Board, CameraError, CameraFit};
use crate::calibration::mirror_sphere::Grey;
use crate::frames::{self, Rigid};
use crate::least_squares::{self, Equations, Options, Problem};
use crate::statistics::{CHI2_2_MEDIAN, median};
use crate::transport::{Camera, Projection};

const STEPS: Options = Options {
    rounds: 60,
    damping: 1e-3,
    least_relative_gain: 1e-10,
    least_gain: 0.0,
};
/// Corners beyond this many deviations lose weight, and beyond that many count no more.
const ROBUST: [f64; 2] = [3.0, 5.0];

/// How a camera is calibrated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraOptions {
    /// Distortion.
    pub terms: Terms,
    /// Views that must show the board; `None`: 3, of a telecentric camera 1.
    pub least_views: Option<usize>,
    /// The image whose board lies at the sample's datum, from 0.
    pub datum: Option<usize>,
}

/// Finds the camera from images of a board; `described` is its kind, its start, and where
/// it roughly stands. Also returns why images show no board.
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
    let needed = options.least_views.unwrap_or(match described.projection {
        Projection::Orthographic { .. } => 1,
        Projection::Perspective { .. } => 3,
    });
    if views.len() < needed {
        return Err(CameraError::TooFewViews {
            found: views.len(),
            needed,
        });
    }
    for (index, view) in &views {
        if options.datum == Some(*index) && !view.whole {
            return Err(CameraError::NotWhole { index: *index });
        }
    }
    let mut bundle = Bundle::start(described, board, options, &views)?;
    bundle.solve(true);
    let cut = ROBUST[1] * bundle.spread(&bundle.at);
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
pub(super) struct Point {
    pub view: usize,
    pub image: usize,
    pub board_mm: DVec2,
    pub at_px: DVec2,
    /// Takes an offset to units of its deviation.
    whiten: Matrix2<f64>,
    pub used: bool,
}

/// The camera, and where each view's board is.
#[derive(Clone)]
pub(super) struct Poses {
    pub model: Model,
    pub boards: Vec<Rigid<frames::Camera, BoardFrame>>,
}

pub(super) struct Bundle {
    pub at: Poses,
    pub sought: Vec<Number>,
    /// Numbers of a pose that are sought, of rotation and translation.
    pub free: &'static [usize],
    pub points: Vec<Point>,
    square_mm: f64,
    pub images: Vec<usize>,
    /// Bound of the squares while weights are robust, in deviations: beyond it the cost is
    /// linear.
    bound: Option<f64>,
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
                .map(|s| (board.corner_mm(s.node), s.corner.at_px))
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
        // Scale: of a telecentric camera the homographies' mean, else the focal length.
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
            at: Poses {
                model,
                boards: homographies.iter().map(|h| pose(&model, *h)).collect(),
            },
            sought: model.sought(options.terms),
            // Of a board that lies flat a telecentric camera determines the turn about its
            // axis and two shifts.
            free: match model.is_telecentric() {
                true => &[2, 3, 4],
                false => &[0, 1, 2, 3, 4, 5],
            },
            points,
            square_mm: board.square_mm,
            images: views.iter().map(|(image, _)| *image).collect(),
            bound: None,
        })
    }

    /// How many numbers are sought.
    pub fn count(&self) -> usize {
        self.sought.len() + self.free.len() * self.at.boards.len()
    }

    /// Measured less modelled, in deviations; large where the point is behind the camera.
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

    /// [`Self::off`] of every corner.
    pub fn offs(&self, at: &Poses) -> Vec<DVec2> {
        let off = |p: &Point| self.off(&at.model, &at.boards[p.view], p);
        self.points.iter().map(off).collect()
    }

    /// Deviations of the typical corner: its own uncertainty may be too small.
    fn spread(&self, at: &Poses) -> f64 {
        let squares = self.offs(at).into_iter().map(DVec2::length_squared);
        let median = median(squares).unwrap_or(1.0);
        (median / CHI2_2_MEDIAN).sqrt().max(1e-3)
    }

    fn reject(&mut self, beyond: f64) {
        let offs = self.offs(&self.at);
        for (point, off) in self.points.iter_mut().zip(offs) {
            point.used = off.length() <= beyond;
        }
    }

    /// Fits camera and poses to the corners in use; `robust`: corners far off count less.
    fn solve(&mut self, robust: bool) {
        self.bound = robust.then_some(f64::INFINITY);
        let start = self.at.clone();
        self.at = least_squares::minimise(self, start, &STEPS).point;
        self.bound = None;
    }

    /// Weight of a corner that is `deviations` off, and its cost: a square up to the bound,
    /// beyond it linear (Huber).
    fn counted(&self, point: &Point, deviations: f64) -> [f64; 2] {
        match self.bound {
            _ if !point.used => [0.0, 0.0],
            Some(bound) if deviations > bound => {
                [bound / deviations, 2.0 * bound * deviations - bound * bound]
            }
            _ => [1.0, deviations * deviations],
        }
    }

    /// A board's pose after a turn and a shift.
    fn turned(
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
}

impl Problem for Bundle {
    type Point = Poses;

    /// Derivatives are central differences.
    fn linearise(&mut self, at: &Poses) -> Equations {
        if self.bound.is_some() {
            self.bound = Some(ROBUST[0] * self.spread(at));
        }
        let n = self.count();
        let own = self.sought.len();
        let mut normal = DMatrix::zeros(n, n);
        let mut right = DVector::zeros(n);
        let mut cost = 0.0;
        for point in self.points.iter().filter(|point| point.used) {
            let pose = &at.boards[point.view];
            let off = self.off(&at.model, pose, point);
            let [weight, own_cost] = self.counted(point, off.length());
            cost += own_cost;
            // Columns of the camera's numbers, then of the view's pose.
            let mut columns = Vec::with_capacity(own + self.free.len());
            for (k, number) in self.sought.iter().enumerate() {
                let step = at.model.step(*number);
                let shifted = |sign: f64| {
                    let value = at.model.get(*number) + sign * step;
                    self.off(&at.model.with(*number, value), pose, point)
                };
                columns.push((k, (shifted(-1.0) - shifted(1.0)) / (2.0 * step)));
            }
            for (k, &i) in self.free.iter().enumerate() {
                let step = if i < 3 { 1e-5 } else { 1e-3 * self.square_mm };
                let shifted = |sign: f64| {
                    let mut by = [0.0; 6];
                    by[i] = sign * step;
                    self.off(&at.model, &self.turned(pose, by), point)
                };
                let column = own + point.view * self.free.len() + k;
                columns.push((column, (shifted(-1.0) - shifted(1.0)) / (2.0 * step)));
            }
            for (a, by_a) in &columns {
                right[*a] += weight * by_a.dot(off);
                for (b, by_b) in &columns {
                    normal[(*a, *b)] += weight * by_a.dot(*by_b);
                }
            }
        }
        Equations {
            normal,
            right,
            cost,
        }
    }

    fn cost(&self, at: &Poses) -> f64 {
        let offs = self.points.iter().zip(self.offs(at));
        offs.map(|(point, off)| self.counted(point, off.length())[1])
            .sum()
    }

    fn moved(&self, from: &Poses, step: &DVector<f64>) -> Poses {
        let mut next = from.clone();
        for (k, number) in self.sought.iter().enumerate() {
            next.model = next.model.with(*number, next.model.get(*number) + step[k]);
        }
        for (view, board) in next.boards.iter_mut().enumerate() {
            let mut by = [0.0; 6];
            for (k, &i) in self.free.iter().enumerate() {
                by[i] = step[self.sought.len() + view * self.free.len() + k];
            }
            *board = self.turned(board, by);
        }
        next
    }
}
