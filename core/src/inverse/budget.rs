//! Where the interval of the BRDF comes from: the posterior's variance by source.
//!
//! Around the fit the weights answer a score s by A s, A = (H + Λ)⁻¹ H F⁻¹, with F the
//! information, H the curvature of the likelihood as the scatter S of the scores has
//! adjusted it, and Λ the precision of a weight before any image. S is a sum over
//! sources, and so (H + Λ)⁻¹ = Σₖ A Sₖ Aᵀ + (H + Λ)⁻¹ Λ (H + Λ)⁻¹; the last term is
//! what the images leave open. The samples also respect the simplex: their variance of f
//! is divided in these proportions.

use nalgebra::{DMatrix, DVector};

use super::normal_equations::WEIGHT_PRIOR_DEVIATION;

/// What makes an estimate uncertain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Photons and read noise of the captured images.
    CaptureNoise,
    /// Light paths of the fit's own render.
    RenderNoise,
    /// Where the sample lies.
    Pose,
    /// Deviation of the as-made sample from its mesh.
    Mesh,
    /// Directions of the lights.
    LightDirections,
    /// Intensities of the lights with their common scale, stray light and glare.
    Intensities,
    /// Residuals beyond noise: what no mixture, mesh or cell of the model explains, and
    /// the least that is allowed for it.
    Model,
    /// What the images leave open.
    Prior,
}

impl Source {
    /// All of them.
    pub const ALL: [Source; 8] = [
        Source::CaptureNoise,
        Source::RenderNoise,
        Source::Pose,
        Source::Mesh,
        Source::LightDirections,
        Source::Intensities,
        Source::Model,
        Source::Prior,
    ];

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Source::CaptureNoise => "capture noise",
            Source::RenderNoise => "render noise",
            Source::Pose => "pose",
            Source::Mesh => "mesh",
            Source::LightDirections => "light directions",
            Source::Intensities => "intensities",
            Source::Model => "model",
            Source::Prior => "not constrained by the images",
        }
    }
}

/// Number of sources.
pub const SOURCES: usize = Source::ALL.len();

/// Covariance of one channel group by source, N × N each, in the order of [`Source::ALL`].
#[derive(Clone, Debug)]
pub struct Budget {
    parts: [DMatrix<f64>; SOURCES],
}

impl Budget {
    /// From the scatter of the scores where F is the identity: `root` is N × M with
    /// F = root rootᵀ; `scatter` is all of it, M × M, positive definite; `known` are parts
    /// of it whose source is known, the rest is the model's.
    pub(super) fn new(
        root: &DMatrix<f64>,
        scatter: &DMatrix<f64>,
        known: &[(Source, DMatrix<f64>)],
    ) -> Self {
        let n = root.nrows();
        let mut parts: [DMatrix<f64>; SOURCES] = std::array::from_fn(|_| DMatrix::zeros(n, n));
        let precision = WEIGHT_PRIOR_DEVIATION.powi(-2);
        let m = scatter.nrows();
        let weight = scatter.clone().cholesky();
        let weight = weight.map_or_else(|| DMatrix::identity(m, m), |c| c.inverse());
        let h = root * &weight * root.transpose();
        let both = (&h + DMatrix::identity(n, n) * precision).cholesky();
        let posterior = both.map_or_else(|| DMatrix::zeros(n, n), |c| c.inverse());
        let answer = &posterior * root * &weight;
        let mut rest = scatter.clone();
        for (source, part) in known {
            rest -= part;
            parts[*source as usize] += &answer * part * answer.transpose();
        }
        parts[Source::Model as usize] += &answer * rest * answer.transpose();
        parts[Source::Prior as usize] = precision * &posterior * &posterior;
        Self { parts }
    }

    /// Share of each source in the variance of g·x, 0..=1; they sum to 1.
    pub fn shares(&self, g: &DVector<f64>) -> [f64; SOURCES] {
        let variances = self
            .parts
            .each_ref()
            .map(|part| g.dot(&(part * g)).max(0.0));
        let total: f64 = variances.iter().sum();
        variances.map(|v| if total > 0.0 { v / total } else { 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> (DMatrix<f64>, DMatrix<f64>) {
        let root = DMatrix::from_row_slice(3, 2, &[40.0, 3.0, -8.0, 25.0, 5.0, 11.0]);
        let scatter = DMatrix::from_row_slice(2, 2, &[4.0, 0.3, 0.3, 3.5]);
        (root, scatter)
    }

    /// The parts add up to (H + Λ)⁻¹, which is computed here from the definition.
    #[test]
    fn parts_sum_to_the_whole() {
        let (root, scatter) = example();
        let noise = DMatrix::from_row_slice(2, 2, &[0.7, 0.1, 0.1, 0.5]);
        let pose = DMatrix::from_row_slice(2, 2, &[0.5, -0.2, -0.2, 0.4]);
        let known = [(Source::CaptureNoise, noise), (Source::Pose, pose)];
        let budget = Budget::new(&root, &scatter, &known);
        let sum = budget.parts.iter().fold(DMatrix::zeros(3, 3), |s, p| s + p);
        let h = &root * scatter.try_inverse().unwrap() * root.transpose();
        let whole = (h + DMatrix::identity(3, 3) / 0.0036)
            .try_inverse()
            .unwrap();
        assert!((sum - &whole).amax() < 1e-12 * whole.amax().max(1.0));
        let shares = budget.shares(&DVector::from_vec(vec![1.0, 2.0, -0.5]));
        assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(shares[Source::Pose as usize] > 0.0);
    }

    #[test]
    fn what_is_turned_off_contributes_nothing() {
        let (root, scatter) = example();
        let off = DMatrix::zeros(2, 2);
        let budget = Budget::new(&root, &scatter, &[(Source::RenderNoise, off)]);
        let shares = budget.shares(&DVector::from_vec(vec![1.0, 2.0, -0.5]));
        assert_eq!(shares[Source::RenderNoise as usize], 0.0);
        assert_eq!(shares[Source::LightDirections as usize], 0.0);
        assert!(shares[Source::Model as usize] > 0.0);
    }
}
