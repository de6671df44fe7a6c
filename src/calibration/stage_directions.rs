//! How a stage stands, from the directions of several of its lights: least squares over
//! its orientation and the zero of its elevation.

use glam::{DQuat, DVec3};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix4, Vector4};

use super::mirror_sphere::light::{FoundLight, tangents};
use crate::units::StageAngles;

/// Why measured directions tell nothing about a stage.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StageFitError {
    /// Three lights at least have as many angles as there are unknowns, and more.
    #[error("{found} lights do not determine how the stage stands; at least {needed} do")]
    TooFew {
        /// How many were measured.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Another stage, mirrored axes, a wrong image order.
    #[error(
        "light {light} at {angles} is {off_deg:.1} degrees away from where the rig file has it, and no common turn of the stage explains more than {explained_deg:.1} of it"
    )]
    OtherStage {
        /// Which light, from 0.
        light: usize,
        /// Its angles by the stage.
        angles: StageAngles,
        /// From the rig file.
        off_deg: f64,
        /// Less what remains.
        explained_deg: f64,
    },
}

/// How a stage stands.
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
    let mut stage = StageFit {
        sample_from_stage: configured,
        elevation_offset_rad: 0.0,
        covariance: Matrix4::zeros(),
        scatter_rad: 0.0,
        residual_rad: 0.0,
    };
    for _ in 0..60 {
        let system = System::of(&stage, configured, angles, found, with_offset);
        let step = system.step();
        stage.sample_from_stage = (DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2]))
            * stage.sample_from_stage)
            .normalize();
        stage.elevation_offset_rad += step[3];
        stage.covariance = system.covariance();
        stage.residual_rad = (system.residual.norm_squared() / (2 * lights) as f64).sqrt();
        let scatter_rad = system.scatter();
        let still = (scatter_rad - stage.scatter_rad).abs() < 1e-8;
        stage.scatter_rad = scatter_rad;
        if step.norm() < 1e-12 && still {
            break;
        }
    }
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
    /// Where the light is when the stage reports these angles, sample frame.
    pub fn to_light(&self, angles: StageAngles) -> DVec3 {
        self.sample_from_stage * offset(angles, self.elevation_offset_rad).to_light()
    }
}

/// Angles with an elevation that counts from elsewhere.
pub fn offset(angles: StageAngles, elevation_offset_rad: f64) -> StageAngles {
    StageAngles {
        azimuth_deg: angles.azimuth_deg,
        elevation_deg: angles.elevation_deg + elevation_offset_rad.to_degrees(),
    }
}

/// The linearised problem: orientation and offset, and the spheres' numbers as unit normals.
struct System {
    jacobian: DMatrix<f64>,
    residual: DVector<f64>,
    /// Covariance of each light's own measurement, rad².
    own: Vec<Matrix2<f64>>,
    /// Precision of the unknowns before any light, and what it pulls towards.
    prior: DVector<f64>,
    pull: DVector<f64>,
    scatter_rad: f64,
}

impl System {
    fn of(
        stage: &StageFit,
        configured: DQuat,
        angles: &[StageAngles],
        found: &[FoundLight],
        with_offset: bool,
    ) -> Self {
        let lights = angles.len().min(found.len());
        let shared = found.iter().map(|f| f.shared.ncols()).max().unwrap_or(0);
        let mut jacobian = DMatrix::zeros(2 * lights, 4 + shared);
        let mut residual = DVector::zeros(2 * lights);
        for (light, (angles, found)) in angles.iter().zip(found).enumerate() {
            let expected = stage.to_light(*angles);
            const STEP: f64 = 1e-6;
            let raised = StageFit {
                elevation_offset_rad: stage.elevation_offset_rad + STEP,
                ..stage.clone()
            };
            let by_offset = (raised.to_light(*angles) - expected) / STEP;
            for (a, across) in tangents(found.to_light).into_iter().enumerate() {
                let row = 2 * light + a;
                residual[row] = across.dot(found.to_light - expected);
                for (axis, unit) in DVec3::AXES.into_iter().enumerate() {
                    jacobian[(row, axis)] = across.dot(unit.cross(expected));
                }
                if with_offset {
                    jacobian[(row, 3)] = across.dot(by_offset);
                }
                for column in 0..found.shared.ncols() {
                    jacobian[(row, 4 + column)] = found.shared[(a, column)];
                }
            }
        }
        let turned = (stage.sample_from_stage * configured.conjugate()).to_scaled_axis();
        let mut prior = DVector::from_element(4 + shared, 1.0);
        let mut pull = DVector::zeros(4 + shared);
        let now = [turned.x, turned.y, turned.z, stage.elevation_offset_rad];
        for (unknown, now) in now.into_iter().enumerate() {
            prior[unknown] = 1.0 / (PRIOR_RAD * PRIOR_RAD);
            pull[unknown] = -now * prior[unknown];
        }
        if !with_offset {
            prior[3] = 1e18;
        }
        Self {
            jacobian,
            residual,
            own: found.iter().map(|f| f.own).collect(),
            prior,
            pull,
            scatter_rad: stage.scatter_rad,
        }
    }

    /// Jᵀ W for weights of the measurements and the scatter.
    fn weighted(&self, scatter_rad: f64) -> DMatrix<f64> {
        let mut weighted = self.jacobian.transpose();
        for (light, own) in self.own.iter().enumerate() {
            let covariance = own + Matrix2::identity() * (scatter_rad * scatter_rad + 1e-16);
            let weight = covariance.try_inverse().unwrap_or(Matrix2::zeros());
            let columns = weighted.columns(2 * light, 2) * weight;
            weighted.columns_mut(2 * light, 2).copy_from(&columns);
        }
        weighted
    }

    fn normal(&self, weighted: &DMatrix<f64>) -> DMatrix<f64> {
        weighted * &self.jacobian + DMatrix::from_diagonal(&self.prior)
    }

    fn solve(&self, weighted: &DMatrix<f64>) -> DVector<f64> {
        let right = weighted * &self.residual + &self.pull;
        let solver = self.normal(weighted).cholesky();
        solver.map_or_else(|| right.map(|_| 0.0), |c| c.solve(&right))
    }

    fn step(&self) -> Vector4<f64> {
        let solution = self.solve(&self.weighted(self.scatter_rad));
        Vector4::from_iterator(solution.iter().copied())
    }

    fn covariance(&self) -> Matrix4<f64> {
        let normal = self.normal(&self.weighted(self.scatter_rad));
        let inverse = normal.try_inverse();
        inverse.map_or_else(Matrix4::zeros, |i| i.fixed_view::<4, 4>(0, 0).into())
    }

    /// The scatter for which the residuals after the fit have a χ² of their number
    /// (Mandel and Paule): by bisection, from 0.
    fn scatter(&self) -> f64 {
        let sought =
            self.jacobian.ncols().min(4) as f64 - f64::from(u8::from(self.prior[3] > 1e17));
        let freedom = (self.residual.len() as f64 - sought).max(1.0);
        let excess = |scatter_rad: f64| {
            let weighted = self.weighted(scatter_rad);
            let solution = self.solve(&weighted);
            let left = &self.residual - &self.jacobian * &solution;
            let mut chi2 = 0.0;
            for (light, own) in self.own.iter().enumerate() {
                let covariance = own + Matrix2::identity() * (scatter_rad * scatter_rad + 1e-16);
                let left = left.fixed_rows::<2>(2 * light);
                let solved = covariance
                    .try_inverse()
                    .map_or(0.0, |w| (left.transpose() * w * left)[(0, 0)]);
                chi2 += solved;
            }
            chi2 - freedom
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

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    /// Lights of a stage that stands at `truth` with an elevation offset, measured with
    /// noise of their own, a place of the sphere that they share, and a scatter.
    pub(crate) fn measured(
        seed: u64,
        truth: DQuat,
        offset_rad: f64,
        scatter_rad: f64,
    ) -> (Vec<StageAngles>, Vec<FoundLight>) {
        let mut random = stream(seed, Purpose::Experiment, 3, 0, 0);
        let place: [f64; 3] = std::array::from_fn(|_| random.normal());
        let mut angles = Vec::new();
        let mut found = Vec::new();
        for k in 0..16 {
            let here = StageAngles {
                azimuth_deg: 137.5 * f64::from(k),
                elevation_deg: 35.0 + 3.4 * f64::from(k),
            };
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
                let common: f64 = (0..3).map(|i| shared[(a, i)] * place[i]).sum();
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
