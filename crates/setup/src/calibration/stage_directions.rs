//! A stage's orientation and the zero of its elevation, from the directions of several of
//! its lights, by least squares.

use glam::{DQuat, DVec3};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix4};

use super::mirror_sphere::light::{FoundLight, tangents};
use crate::least_squares::{self, Equations, Options, Problem};
use crate::shown::nth;
use crate::units::StageAngles;

/// Why measured directions do not determine a stage.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum StageFitError {
    /// Three lights at least have as many angles as there are unknowns, and more.
    #[error("{found} lights do not determine how the stage stands; at least {needed} do")]
    TooFew { found: usize, needed: usize },
    /// Another stage, mirrored axes, a wrong image order.
    #[error(
        "{light} at {angles} is {off_deg:.1} degrees away from where the rig file has it, and no common turn of the stage explains more than {explained_deg:.1} of it", light = nth("light", *light)
    )]
    OtherStage {
        /// Which light, from 0.
        light: usize,
        angles: StageAngles,
        off_deg: f64,
        /// By how much a common turn reduces that.
        explained_deg: f64,
    },
}

/// A stage's orientation and its uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct StageFit {
    /// Rotation from stage to sample.
    pub sample_from_stage: DQuat,
    /// To be added to the stage's elevations, radians; 0 where it isn't sought.
    pub elevation_offset_rad: f64,
    /// Covariance of a further rotation about the sample's x, y, z and of the offset, rad².
    pub covariance: Matrix4<f64>,
    /// Standard deviation of a light's true direction about the fit, each of its two
    /// angles, beyond what its measurement explains, radians.
    pub scatter_rad: f64,
    /// Root mean square of the residuals, each of two angles, radians.
    pub residual_rad: f64,
}

/// Before any light is seen a stage stands within this of the rig file, each angle, radians.
const PRIOR_RAD: f64 = 0.35;
/// Residuals above this are no stage's positioning errors, radians.
const MOST_RESIDUAL_RAD: f64 = 0.05;
const LEAST_LIGHTS: usize = 4;
/// The last step moves no unknown by more than some 1e-10 of its uncertainty.
const STEPS: Options = Options {
    rounds: 60,
    damping: 0.0,
    least_relative_gain: 0.0,
    least_gain: 1e-20,
};

/// Fits a stage to its lights: `angles` as the stage reported them, in the order of
/// `found`. `with_offset`: whether its elevation may have an unknown zero.
///
/// # Errors
/// Fewer than four lights, or directions that no stage near the configured one has.
pub fn fit(
    configured: DQuat,
    angles: &[StageAngles],
    found: &[FoundLight],
    with_offset: bool,
) -> Result<StageFit, StageFitError> {
    let lights = angles.len().min(found.len());
    if lights < LEAST_LIGHTS {
        return Err(StageFitError::TooFew {
            found: lights,
            needed: LEAST_LIGHTS,
        });
    }
    let shared = found.iter().map(|f| f.shared.ncols()).max().unwrap_or(0);
    let mut problem = Directions {
        configured,
        angles,
        found,
        with_offset,
        scatter_rad: 0.0,
    };
    let start = Orientation {
        sample_from_stage: configured,
        elevation_offset_rad: 0.0,
        shared: DVector::zeros(shared),
    };
    let at = least_squares::minimise(&mut problem, start, &STEPS).point;
    let covariance = problem.linearise(&at).covariance();
    let squares = found.iter().zip(angles).flat_map(|(found, angles)| {
        let off = found.to_light - at.to_light(*angles);
        tangents(found.to_light).map(|across| across.dot(off).powi(2))
    });
    let stage = StageFit {
        sample_from_stage: at.sample_from_stage,
        elevation_offset_rad: at.elevation_offset_rad,
        covariance: covariance.map_or_else(Matrix4::zeros, |c| c.fixed_view::<4, 4>(0, 0).into()),
        scatter_rad: problem.scatter_rad,
        residual_rad: (squares.sum::<f64>() / (2 * lights) as f64).sqrt(),
    };
    for (light, (angles, found)) in angles.iter().zip(found).enumerate() {
        let remaining = stage.to_light(*angles).angle_between(found.to_light);
        if remaining > MOST_RESIDUAL_RAD {
            let off = (configured * angles.to_light()).angle_between(found.to_light);
            return Err(StageFitError::OtherStage {
                light,
                angles: *angles,
                off_deg: off.to_degrees(),
                explained_deg: (off - remaining).to_degrees(),
            });
        }
    }
    Ok(stage)
}

impl StageFit {
    /// Direction to the light when the stage reports these angles, sample frame.
    pub fn to_light(&self, angles: StageAngles) -> DVec3 {
        self.sample_from_stage * offset(angles, self.elevation_offset_rad).to_light()
    }
}

/// The unknowns.
#[derive(Clone)]
struct Orientation {
    sample_from_stage: DQuat,
    elevation_offset_rad: f64,
    /// The unit normal variables of the spheres that all lights share.
    shared: DVector<f64>,
}

impl Orientation {
    fn to_light(&self, angles: StageAngles) -> DVec3 {
        self.sample_from_stage * offset(angles, self.elevation_offset_rad).to_light()
    }
}

/// Angles with an elevation that counts from elsewhere.
pub fn offset(angles: StageAngles, elevation_offset_rad: f64) -> StageAngles {
    StageAngles::new(
        angles.azimuth_deg,
        angles.elevation_deg + elevation_offset_rad.to_degrees(),
    )
}

/// The lights of a stage.
struct Directions<'a> {
    configured: DQuat,
    angles: &'a [StageAngles],
    found: &'a [FoundLight],
    with_offset: bool,
    /// Standard deviation of a light about the stage's model, found along with it.
    scatter_rad: f64,
}

impl Directions<'_> {
    fn lights(&self) -> impl Iterator<Item = (&StageAngles, &FoundLight)> {
        self.angles.iter().zip(self.found)
    }

    /// Measured less expected direction along both tangents, a pair of rows per light.
    fn residual(&self, at: &Orientation) -> DVector<f64> {
        let rows = self.lights().flat_map(|(angles, found)| {
            let off = found.to_light - at.to_light(*angles);
            let columns = found.shared.ncols();
            let shared = &found.shared * at.shared.rows(0, columns);
            let across = tangents(found.to_light);
            [0, 1].map(|a| across[a].dot(off) - shared[a])
        });
        DVector::from_vec(rows.collect())
    }

    fn jacobian(&self, at: &Orientation) -> DMatrix<f64> {
        const STEP: f64 = 1e-6;
        let raised = Orientation {
            elevation_offset_rad: at.elevation_offset_rad + STEP,
            ..at.clone()
        };
        let mut jacobian = DMatrix::zeros(2 * self.lights().count(), 4 + at.shared.len());
        for (light, (angles, found)) in self.lights().enumerate() {
            let expected = at.to_light(*angles);
            let by_offset = (raised.to_light(*angles) - expected) / STEP;
            for (a, across) in tangents(found.to_light).into_iter().enumerate() {
                let row = 2 * light + a;
                for (axis, unit) in DVec3::AXES.into_iter().enumerate() {
                    jacobian[(row, axis)] = across.dot(unit.cross(expected));
                }
                if self.with_offset {
                    jacobian[(row, 3)] = across.dot(by_offset);
                }
                for column in 0..found.shared.ncols() {
                    jacobian[(row, 4 + column)] = found.shared[(a, column)];
                }
            }
        }
        jacobian
    }

    /// Precision of the unknowns before any light, and by how much they are off its mean.
    fn prior(&self, at: &Orientation) -> [DVector<f64>; 2] {
        let turned = (at.sample_from_stage * self.configured.conjugate()).to_scaled_axis();
        let mut off = DVector::zeros(4 + at.shared.len());
        off.rows_mut(0, 3).copy_from_slice(&turned.to_array());
        off[3] = at.elevation_offset_rad;
        off.rows_mut(4, at.shared.len()).copy_from(&at.shared);
        let mut precision = DVector::from_element(off.len(), 1.0);
        precision.rows_mut(0, 4).fill(PRIOR_RAD.powi(-2));
        if !self.with_offset {
            precision[3] = 1e18;
        }
        [precision, off]
    }

    /// Inverse covariance of each light's direction, with a scatter.
    fn weights(&self, scatter_rad: f64) -> Vec<Matrix2<f64>> {
        let weight = |(_, found): (_, &FoundLight)| {
            let covariance = found.own + Matrix2::identity() * (scatter_rad * scatter_rad + 1e-16);
            covariance.try_inverse().unwrap_or(Matrix2::zeros())
        };
        self.lights().map(weight).collect()
    }

    /// The scatter for which the residuals after a step have a χ² of their number (Mandel
    /// and Paule, 1970): by bisection, from 0.
    fn scatter(&self, at: &Orientation) -> f64 {
        let residual = self.residual(at);
        let jacobian = self.jacobian(at);
        let prior = self.prior(at);
        let sought = 3.0 + f64::from(u8::from(self.with_offset));
        let freedom = (residual.len() as f64 - sought).max(1.0);
        let excess = |scatter_rad: f64| {
            let weights = self.weights(scatter_rad);
            let equations = equations(&jacobian, &residual, &weights, &prior);
            let step = equations
                .normal
                .cholesky()
                .map(|c| c.solve(&equations.right));
            let left = match step {
                Some(step) => &residual - &jacobian * step,
                None => residual.clone(),
            };
            chi2(&left, &weights) - freedom
        };
        if excess(0.0) <= 0.0 {
            return 0.0;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            match excess(middle) > 0.0 {
                true => low = middle,
                false => high = middle,
            }
        }
        0.5 * (low + high)
    }
}

fn chi2(residual: &DVector<f64>, weights: &[Matrix2<f64>]) -> f64 {
    let of_light = |(light, weight): (usize, &Matrix2<f64>)| {
        let own = residual.fixed_rows::<2>(2 * light);
        (own.transpose() * weight * own)[(0, 0)]
    };
    weights.iter().enumerate().map(of_light).sum()
}

fn equations(
    jacobian: &DMatrix<f64>,
    residual: &DVector<f64>,
    weights: &[Matrix2<f64>],
    [precision, off]: &[DVector<f64>; 2],
) -> Equations {
    let mut weighted = jacobian.transpose();
    for (light, weight) in weights.iter().enumerate() {
        let columns = weighted.columns(2 * light, 2) * weight;
        weighted.columns_mut(2 * light, 2).copy_from(&columns);
    }
    Equations {
        normal: &weighted * jacobian + DMatrix::from_diagonal(precision),
        right: &weighted * residual - precision.component_mul(off),
        cost: chi2(residual, weights) + precision.component_mul(off).dot(off),
    }
}

impl Problem for Directions<'_> {
    type Point = Orientation;

    fn linearise(&mut self, at: &Orientation) -> Equations {
        self.scatter_rad = self.scatter(at);
        let weights = self.weights(self.scatter_rad);
        equations(
            &self.jacobian(at),
            &self.residual(at),
            &weights,
            &self.prior(at),
        )
    }

    fn cost(&self, at: &Orientation) -> f64 {
        let [precision, off] = self.prior(at);
        let weights = self.weights(self.scatter_rad);
        chi2(&self.residual(at), &weights) + precision.component_mul(&off).dot(&off)
    }

    fn moved(&self, from: &Orientation, step: &DVector<f64>) -> Orientation {
        let turn = DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2]));
        Orientation {
            sample_from_stage: (turn * from.sample_from_stage).normalize(),
            elevation_offset_rad: from.elevation_offset_rad + step[3],
            shared: &from.shared + step.rows(4, from.shared.len()),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use nalgebra::Vector4;

    use super::*;
    use crate::random::{Purpose, stream};

    /// Lights of a stage that stands at `truth` with an elevation offset, measured with
    /// noise of their own, a position of the sphere that they share, and a scatter.
    pub(crate) fn measured(
        seed: u64,
        truth: DQuat,
        offset_rad: f64,
        scatter_rad: f64,
    ) -> (Vec<StageAngles>, Vec<FoundLight>) {
        let mut random = stream(seed, Purpose::Experiment, 3, 0, 0);
        let shift: [f64; 3] = std::array::from_fn(|_| random.normal());
        let mut angles = Vec::new();
        let mut found = Vec::new();
        for k in 0..16 {
            let here = StageAngles::new(137.5 * f64::from(k), 35.0 + 3.4 * f64::from(k));
            let true_light = truth * offset(here, offset_rad).to_light();
            let across = tangents(true_light);
            let own_rad = 3e-4;
            // A shifted or larger sphere mirrors into other directions.
            let shared = DMatrix::from_fn(2, 3, |a, column| {
                let by = match column {
                    2 => true_light.cross(across[0]).cross(true_light),
                    axis => DVec3::AXES[axis],
                };
                8e-4 * across[a].dot(by)
            });
            let mut light = true_light;
            for (a, across) in across.into_iter().enumerate() {
                let common: f64 = (0..3).map(|i| shared[(a, i)] * shift[i]).sum();
                let noise = own_rad * random.normal() + scatter_rad * random.normal();
                light += across * (common + noise);
            }
            angles.push(here);
            found.push(FoundLight {
                to_light: light.normalize(),
                inverse_distance: [0.0; 2],
                own: Matrix2::identity() * own_rad * own_rad,
                shared,
                miss: 0.0,
            });
        }
        (angles, found)
    }

    /// Errors of orientation and offset, whitened by the stated covariance, over 128
    /// stages: the mean square of 512 numbers within 5 standard deviations of 1.
    #[test]
    fn a_stage_is_recovered_within_its_uncertainty() {
        let mut sum = 0.0;
        let mut scatter = 0.0;
        for seed in 0..128 {
            let mut random = stream(seed, Purpose::Experiment, 4, 0, 0);
            let mut vector =
                |size: f64| DVec3::from_array(std::array::from_fn(|_| size * random.normal()));
            let configured = DQuat::from_scaled_axis(vector(1.0));
            let turn = vector(0.03);
            let truth = DQuat::from_scaled_axis(turn) * configured;
            let (angles, found) = measured(seed, truth, 0.02, 6e-4);
            let fitted = fit(configured, &angles, &found, true).unwrap();
            let left = (truth * fitted.sample_from_stage.conjugate()).to_scaled_axis();
            let error = Vector4::new(left.x, left.y, left.z, 0.02 - fitted.elevation_offset_rad);
            let root = fitted.covariance.cholesky().unwrap().l();
            sum += root.solve_lower_triangular(&error).unwrap().norm_squared();
            scatter += fitted.scatter_rad / 128.0;
        }
        let mean = sum / 512.0;
        let std = (2.0f64 / 512.0).sqrt();
        assert!(
            (mean - 1.0).abs() < 5.0 * std,
            "mean square pull {mean} ± {std}"
        );
        assert!((scatter / 6e-4 - 1.0).abs() < 0.1, "scatter {scatter}");
    }

    #[test]
    fn too_few_lights_and_another_stage_are_refused() {
        let (angles, found) = measured(1, DQuat::IDENTITY, 0.0, 0.0);
        let few = fit(DQuat::IDENTITY, &angles[..3], &found[..3], true);
        assert!(matches!(few, Err(StageFitError::TooFew { found: 3, .. })));
        // The azimuth runs the other way.
        let mirrored: Vec<_> = angles
            .iter()
            .map(|a| StageAngles {
                azimuth_deg: -a.azimuth_deg,
                ..*a
            })
            .collect();
        let other = fit(DQuat::IDENTITY, &mirrored, &found, true);
        assert!(
            matches!(other, Err(StageFitError::OtherStage { .. })),
            "{other:?}"
        );
    }
}
