//! One lens for all edges: least squares over point spread, focus and aperture, together
//! with each edge's offset, turn, levels and shading.

use glam::DVec2;
use nalgebra::{DMatrix, DVector, Matrix3};

use super::EdgeError;
use super::locate::{Edge, EdgePixel};
use super::profile::{Blur, Profile};
use crate::least_squares::{self, Equations, Options, Problem};

/// What makes edges blurred.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Variance of the point spread in focus, square pixels.
    pub spread_px2: f64,
    /// Distance along the camera's axis at which the image is sharp, millimetres.
    pub focus_mm: f64,
    /// Squared tangent of the half angle of the lens's cone on the sample's side.
    pub tangent2: f64,
}

impl Lens {
    fn blur(&self, edge: &Edge) -> Blur {
        let off_mm = (edge.depth_mm - self.focus_mm).abs();
        Blur {
            spread_px2: self.spread_px2,
            disc_px: self.tangent2.max(0.0).sqrt() * off_mm * edge.px_per_mm,
            tilt_rad: edge.tilt_rad(),
        }
    }
}

/// An edge by itself, and in the common fit.
#[derive(Clone, Debug)]
pub struct EdgeFit {
    /// Standard deviation of a Gaussian that blurs as this edge is blurred, without the
    /// pixel, pixels, and its standard uncertainty.
    pub width_px: [f64; 2],
    /// Distance from the edge, and radiance scaled to 0 and 1, of its pixels.
    pub measured: Vec<[f64; 2]>,
    /// The same of the fitted profile.
    pub fitted: Vec<[f64; 2]>,
}

/// The lens that the edges show.
#[derive(Clone, Debug)]
#[allow(missing_docs)]
pub struct Fitted {
    pub lens: Lens,
    /// Covariance of spread (px²), focus (mm) and squared tangent; zero where fixed.
    pub covariance: Matrix3<f64>,
    /// Sum of squared residuals over their variance, per degree of freedom.
    pub reduced_chi2: f64,
    /// Whether focus and aperture were fitted, not fixed.
    pub defocus: bool,
    pub edges: Vec<EdgeFit>,
}

/// Different heights from which focus and aperture are fitted.
pub const HEIGHTS_FOR_DEFOCUS: usize = 3;
/// Least gain in χ² for which focus and aperture count as determined.
const SEEN: f64 = 16.0;
/// The last step gains less χ² than 1% of a parameter's uncertainty is worth: where the
/// profile is rough there may be no more.
const STEPS: Options = Options {
    rounds: 40,
    damping: 0.0,
    least_relative_gain: 0.0,
    least_gain: 1e-4,
};
const LENS: usize = 3;
const OWN: usize = 8;
const LEAST_SPREAD_PX2: f64 = 0.01;
/// A model this far from the images, in noise and in contrast, is not the bench's.
const MOST_DEVIATIONS: f64 = 5.0;
const MOST_OFF: f64 = 0.03;

/// Fits the lens. Focus and aperture are fitted from edges at three or more heights, else
/// fixed at `stated`. The covariance is scaled up, parameter by parameter, where residuals
/// exceed the noise.
///
/// # Errors
/// [`EdgeError::Unfitted`] where nothing settles, [`EdgeError::NotTheModel`] where edges
/// look otherwise.
pub fn fit_edges(edges: &[Edge], stated: Lens) -> Result<Fitted, EdgeError> {
    // Each edge by itself: a Gaussian's width and its uncertainty.
    let mut own = Vec::new();
    let mut shapes = Vec::new();
    for edge in edges {
        let lens = Lens {
            spread_px2: 0.5,
            focus_mm: edge.depth_mm,
            tangent2: 0.0,
        };
        let mut alone = EdgesFit::new(std::slice::from_ref(edge), lens);
        let [noise, observed] = alone.settle([true, false, false])?;
        let variance = noise[(0, 0)].max(observed[(0, 0)]);
        own.push([alone.at.lens.spread_px2, variance.max(0.0).sqrt()]);
        shapes.extend(alone.at.shapes);
    }
    // All edges with one lens, with and without defocus.
    let mut heights: Vec<f64> = edges.iter().map(|e| e.depth_mm).collect();
    heights.sort_by(f64::total_cmp);
    heights.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    let defocus = heights.len() >= HEIGHTS_FOR_DEFOCUS;
    let mut all = EdgesFit::new(edges, stated);
    all.at.shapes = shapes;
    if defocus {
        all.at.lens = parabola(edges, &own).unwrap_or(stated);
    } else {
        all.at.lens.spread_px2 = own.iter().map(|o| o[0]).fold(0.5, f64::min).max(0.05);
    }
    let [mut covariance, observed] = match defocus {
        false => all.settle([true, false, false])?,
        true => {
            let mut sharp = EdgesFit::new(edges, stated);
            sharp.at.shapes.clone_from(&all.at.shapes);
            sharp.at.lens.tangent2 = 0.0;
            sharp.at.lens.spread_px2 = own.iter().map(|o| o[0]).sum::<f64>() / own.len() as f64;
            sharp.settle([true, false, false])?;
            let flat = EdgeError::NoDefocus {
                nearest_mm: heights[0],
                farthest_mm: heights[heights.len() - 1],
            };
            let found = all.settle([true; LENS]).map_err(|_| flat.clone())?;
            if sharp.chi2() - all.chi2() < SEEN * (all.chi2() / all.values() as f64).max(1.0) {
                return Err(flat);
            }
            found
        }
    };
    // Goodness of the fit, and what it adds to the uncertainty.
    let freedom = all.values() - edges.len() * OWN - if defocus { LENS } else { 1 };
    let reduced_chi2 = all.chi2() / freedom.max(1) as f64;
    // Residuals beyond noise lie at the edge, which is what determines the lens.
    let wider = [0, 1, 2].map(|i| {
        let ratio = observed[(i, i)] / covariance[(i, i)].max(f64::MIN_POSITIVE);
        ratio.max(reduced_chi2).max(1.0).sqrt()
    });
    covariance = Matrix3::from_fn(|i, j| wider[i] * wider[j] * covariance[(i, j)]);
    let percent = 100.0 * all.relative_residual();
    if reduced_chi2.sqrt() > MOST_DEVIATIONS && percent > 100.0 * MOST_OFF {
        let deviations = reduced_chi2.sqrt();
        return Err(EdgeError::NotTheModel {
            deviations,
            percent,
        });
    }
    let described = edges.iter().zip(&all.at.shapes).zip(&own);
    Ok(Fitted {
        lens: all.at.lens,
        covariance,
        reduced_chi2,
        defocus,
        edges: described
            .map(|((edge, shape), own)| all.describe(edge, shape, *own))
            .collect(),
    })
}

/// The lens whose blur grows with the depths as the edges' own widths do.
fn parabola(edges: &[Edge], own: &[[f64; 2]]) -> Option<Lens> {
    let middle = edges.iter().map(|e| e.depth_mm).sum::<f64>() / edges.len() as f64;
    let scale = edges.iter().map(|e| e.px_per_mm).sum::<f64>() / edges.len() as f64;
    let rows = |i: usize| {
        let x = edges[i].depth_mm - middle;
        [1.0, x, x * x]
    };
    let weight = |i: usize| 1.0 / (own[i][1] + 0.02 * own[i][0] + 1e-3);
    let a = DMatrix::from_fn(edges.len(), 3, |i, j| weight(i) * rows(i)[j]);
    let b = DVector::from_fn(edges.len(), |i, _| weight(i) * own[i][0]);
    let c = a.svd(true, true).solve(&b, 1e-12).ok()?;
    // A disc of radius r has the variance r²/4 along an axis.
    let least = own.iter().map(|o| o[0]).fold(f64::INFINITY, f64::min);
    let bend = c[2].max(1e-9 * least.max(1e-3));
    let off = -0.5 * c[1] / bend;
    let depths = edges.iter().map(|e| e.depth_mm - middle);
    let reach = depths.fold(0.0f64, |m, d| m.max(d.abs()));
    let off = off.clamp(-2.0 * reach, 2.0 * reach);
    Some(Lens {
        spread_px2: (c[0] - bend * off * off).max(0.3 * least.max(0.05)),
        focus_mm: middle + off,
        tangent2: 4.0 * bend / (scale * scale),
    })
}

/// An edge's own parameters.
#[derive(Clone, Copy, Debug)]
struct Shape {
    /// Shift across and turn against where the edge was found.
    offset_px: f64,
    turn: f64,
    /// Plane of the darker side; plane of what the brighter adds: at the edge's point, per
    /// pixel along x and y.
    planes: [f64; 6],
}

/// All parameters: the lens', and each edge's own.
#[derive(Clone, Debug)]
struct Parameters {
    lens: Lens,
    shapes: Vec<Shape>,
}

/// The edges, the parameters found so far, and which of the lens' are free.
struct EdgesFit<'a> {
    edges: &'a [Edge],
    at: Parameters,
    free: [bool; LENS],
}

impl<'a> EdgesFit<'a> {
    fn new(edges: &'a [Edge], lens: Lens) -> Self {
        let shapes = edges.iter().map(|edge| {
            let [dark, bright] = edge.levels;
            Shape {
                offset_px: 0.0,
                turn: 0.0,
                planes: [dark, 0.0, 0.0, bright - dark, 0.0, 0.0],
            }
        });
        let shapes = shapes.collect();
        Self {
            edges,
            at: Parameters { lens, shapes },
            free: [true; LENS],
        }
    }

    fn values(&self) -> usize {
        self.edges.iter().map(|e| e.pixels.len()).sum()
    }

    fn profile(&self, edge: &Edge, lens: &Lens) -> Profile {
        Profile::new(&lens.blur(edge), edge.reach_px + 3.0)
    }

    fn chi2(&self) -> f64 {
        self.cost(&self.at)
    }

    /// Root mean square residual over the contrast.
    fn relative_residual(&self) -> f64 {
        let parts = self.edges.iter().zip(&self.at.shapes).map(|(edge, shape)| {
            let profile = self.profile(edge, &self.at.lens);
            let contrast = edge.levels[1] - edge.levels[0];
            let pixels = edge.pixels.iter();
            pixels
                .map(|p| (shape.residual(edge, &profile, p) / contrast).powi(2))
                .sum::<f64>()
        });
        (parts.sum::<f64>() / self.values().max(1) as f64).sqrt()
    }

    /// Fits all parameters, of the lens the `free` ones; returns the lens' covariance from
    /// the pixels' noise, and from the residuals as they are.
    fn settle(&mut self, free: [bool; LENS]) -> Result<[Matrix3<f64>; 2], EdgeError> {
        self.free = free;
        let start = self.at.clone();
        let found = least_squares::minimise(self, start, &STEPS);
        if !found.settled {
            return Err(EdgeError::Unfitted("the iteration does not settle"));
        }
        self.at = found.point;
        let (equations, scatter) = self.equations(&self.at);
        let covariances = [equations.covariance(), equations.sandwich(&scatter)];
        let [Some(noise), Some(observed)] = covariances else {
            return Err(EdgeError::Unfitted("the images do not determine the lens"));
        };
        let free = |i: usize, j: usize| f64::from(self.free[i] && self.free[j]);
        Ok([noise, observed].map(|full| Matrix3::from_fn(|i, j| free(i, j) * full[(i, j)])))
    }

    /// The normal equations, and the covariance of their right side by the residuals.
    fn equations(&self, at: &Parameters) -> (Equations, DMatrix<f64>) {
        let size = LENS + OWN * self.edges.len();
        let mut matrix = DMatrix::zeros(size, size);
        let mut scatter = DMatrix::zeros(size, size);
        let mut right = DVector::zeros(size);
        let mut cost = 0.0;
        let (lens, free) = (at.lens, self.free);
        // Derivatives by the lens are central differences of the profile.
        let steps = [
            0.02 * lens.spread_px2.max(0.05),
            1e-3 * depth_span(self.edges).max(0.1),
            (0.02 * lens.tangent2).max(1e-9),
        ];
        let moved = |k: usize, by: f64| {
            let mut other = lens;
            match k {
                0 => other.spread_px2 += by,
                1 => other.focus_mm += by,
                _ => other.tangent2 = (other.tangent2 + by).max(0.0),
            }
            other
        };
        for (k, (edge, own)) in self.edges.iter().zip(&at.shapes).enumerate() {
            let profile = self.profile(edge, &lens);
            let others: Vec<Option<[Profile; 2]>> = (0..LENS)
                .map(|i| {
                    free[i].then(|| [steps[i], -steps[i]].map(|h| self.profile(edge, &moved(i, h))))
                })
                .collect();
            let column = |i: usize| {
                if i < LENS {
                    i
                } else {
                    LENS + OWN * k + i - LENS
                }
            };
            for pixel in &edge.pixels {
                let at = own.position(edge, pixel);
                let [value, slope] = profile.at(at.across);
                let [_, bright] = own.levels(at.off);
                let mut row = [0.0; LENS + OWN];
                for (i, other) in others.iter().enumerate() {
                    if let Some([more, less]) = other {
                        let h = match i {
                            2 => moved(2, steps[2]).tangent2 - moved(2, -steps[2]).tangent2,
                            _ => 2.0 * steps[i],
                        };
                        let difference = more.at(at.across)[0] - less.at(at.across)[0];
                        row[i] = bright * difference / h;
                    }
                }
                row[LENS] = -bright * slope;
                row[LENS + 1] = bright * slope * at.along;
                let plane = [1.0, at.off.x, at.off.y];
                for i in 0..3 {
                    row[LENS + 2 + i] = plane[i];
                    row[LENS + 5 + i] = plane[i] * value;
                }
                let residual = own.residual(edge, &profile, pixel);
                let weight = 1.0 / pixel.variance;
                cost += weight * residual * residual;
                for i in 0..LENS + OWN {
                    right[column(i)] += weight * row[i] * residual;
                    for j in 0..=i {
                        let product = weight * row[i] * row[j];
                        matrix[(column(i), column(j))] += product;
                        scatter[(column(i), column(j))] += product * weight * residual * residual;
                    }
                }
            }
        }
        // A fixed parameter doesn't move.
        for (i, free) in free.into_iter().enumerate() {
            if !free {
                matrix[(i, i)] = 1.0;
            }
        }
        matrix.fill_upper_triangle_with_lower_triangle();
        scatter.fill_upper_triangle_with_lower_triangle();
        let equations = Equations {
            normal: matrix,
            right,
            cost,
        };
        (equations, scatter)
    }

    fn describe(&self, edge: &Edge, own: &Shape, width: [f64; 2]) -> EdgeFit {
        let profile = self.profile(edge, &self.at.lens);
        let measured = edge.pixels.iter().map(|pixel| {
            let at = own.position(edge, pixel);
            let [dark, bright] = own.levels(at.off);
            [at.across, (pixel.value - dark) / bright]
        });
        let steps = (2.0 * edge.reach_px * 4.0) as i32;
        let fitted = (0..=steps).map(|i| {
            let t = f64::from(i) / 4.0 - edge.reach_px;
            [t, profile.at(t)[0]]
        });
        let sigma_px = width[0].sqrt();
        EdgeFit {
            width_px: [sigma_px, width[1] / (2.0 * sigma_px)],
            measured: measured.collect(),
            fitted: fitted.collect(),
        }
    }
}

impl Problem for EdgesFit<'_> {
    type Point = Parameters;

    fn linearise(&mut self, at: &Parameters) -> Equations {
        self.equations(at).0
    }

    /// Sum of squared residuals over the pixels' variances.
    fn cost(&self, at: &Parameters) -> f64 {
        let parts = self.edges.iter().zip(&at.shapes).map(|(edge, shape)| {
            let profile = self.profile(edge, &at.lens);
            let pixels = edge.pixels.iter();
            pixels
                .map(|p| shape.residual(edge, &profile, p).powi(2) / p.variance)
                .sum::<f64>()
        });
        parts.sum()
    }

    fn moved(&self, from: &Parameters, step: &DVector<f64>) -> Parameters {
        let Lens {
            spread_px2,
            focus_mm,
            tangent2,
        } = from.lens;
        let lens = Lens {
            spread_px2: (spread_px2 + step[0])
                .clamp(0.2 * spread_px2, 5.0 * spread_px2)
                .max(LEAST_SPREAD_PX2),
            focus_mm: focus_mm + step[1],
            tangent2: (tangent2 + step[2]).max(0.1 * tangent2),
        };
        let shapes = from.shapes.iter().enumerate().map(|(k, shape)| {
            let step = step.rows(LENS + OWN * k, OWN);
            Shape {
                offset_px: shape.offset_px + step[0].clamp(-1.0, 1.0),
                turn: shape.turn + step[1].clamp(-0.05, 0.05),
                planes: std::array::from_fn(|i| shape.planes[i] + step[2 + i]),
            }
        });
        Parameters {
            lens,
            shapes: shapes.collect(),
        }
    }
}

fn depth_span(edges: &[Edge]) -> f64 {
    let depths = || edges.iter().map(|e| e.depth_mm);
    depths().fold(f64::MIN, f64::max) - depths().fold(f64::MAX, f64::min)
}

/// A pixel's position relative to the edge.
struct Position {
    across: f64,
    along: f64,
    /// From the edge's point, over the reach, so that all parameters are alike in size.
    off: DVec2,
}

impl Shape {
    fn position(&self, edge: &Edge, pixel: &EdgePixel) -> Position {
        let off = pixel.at_px - edge.point_px;
        let normal = DVec2::from_angle(self.turn).rotate(edge.normal);
        Position {
            across: off.dot(normal) - self.offset_px,
            along: off.dot(normal.perp()),
            off: off / edge.reach_px,
        }
    }

    /// Radiance of the darker side, and what the brighter adds.
    fn levels(&self, off: DVec2) -> [f64; 2] {
        let p = &self.planes;
        [
            p[0] + p[1] * off.x + p[2] * off.y,
            p[3] + p[4] * off.x + p[5] * off.y,
        ]
    }

    fn residual(&self, edge: &Edge, profile: &Profile, pixel: &EdgePixel) -> f64 {
        let at = self.position(edge, pixel);
        let [dark, bright] = self.levels(at.off);
        pixel.value - dark - bright * profile.at(at.across)[0]
    }
}
