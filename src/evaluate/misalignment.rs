//! What an inexactly known bench costs, and what refining it gives back.
//!
//! A sample is captured on a bench that differs from its description; the images are
//! fitted three times: on the true bench (*known*), on the described one
//! (*unrefined*), and with the bench refined. The truth has a finer mesh, other paths
//! and the noise of a bracketed 12-bit capture.

use std::sync::Arc;

use nalgebra::DVector;

use crate::brdf::environment::EnvironmentMap;
use crate::brdf::score::environment_error;
use crate::brdf::{Brdf, Dictionary, Mixture};
use crate::inverse::bench::{Bench, BenchEstimate, Parameter};
use crate::inverse::{BenchPriors, FitError, FitOptions, RefineOptions, fit, refine_bench};
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, Stream, stream};
use crate::transport::render::quietest_proposal;
use crate::transport::{Proposal, RenderOptions, Scene, render};

/// How far a bench is from its description: exact lengths in random directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misalignment {
    /// Every light's direction, degrees.
    pub light_deg: f64,
    /// Standard deviation of every light's intensity, relative.
    pub intensity: f64,
    /// Rotation of the sample, degrees.
    pub rotation_deg: f64,
    /// Displacement of the sample, millimetres.
    pub translation_mm: f64,
}

impl Misalignment {
    /// The prior that states it: the same mean square along each axis.
    pub fn priors(&self) -> BenchPriors {
        BenchPriors {
            light_rad: self.light_deg.to_radians() / 2f64.sqrt(),
            stage_rad: 0.0,
            intensity: self.intensity,
            common_intensity: 0.0,
            rotation_rad: self.rotation_deg.to_radians() / 3f64.sqrt(),
            translation_mm: self.translation_mm / 3f64.sqrt(),
            stray_light: 0.0,
        }
    }

    /// A bench with these errors.
    fn draw(&self, bench: &Bench, numbers: &mut Stream) -> DVector<f64> {
        let mut values = DVector::from_fn(bench.parameters().len(), |_, _| numbers.normal());
        let groups: [(f64, fn(&Parameter) -> bool); 2] = [
            (self.rotation_deg.to_radians(), |p| {
                matches!(p, Parameter::Rotation(_))
            }),
            (self.translation_mm, |p| {
                matches!(p, Parameter::Translation(_))
            }),
        ];
        let mut set_length = |length: f64, member: &dyn Fn(&Parameter) -> bool| {
            let members: Vec<usize> = (0..values.len())
                .filter(|&k| member(&bench.parameters()[k]))
                .collect();
            let norm = members.iter().map(|&k| values[k] * values[k]).sum::<f64>();
            for k in members {
                values[k] *= length / norm.sqrt().max(1e-30);
            }
        };
        for (length, member) in groups {
            set_length(length, &member);
        }
        for light in 0..bench.scene(&DVector::zeros(0)).lights.len() {
            set_length(self.light_deg.to_radians(), &|p| {
                *p == Parameter::LightAzimuth(light) || *p == Parameter::LightElevation(light)
            });
        }
        for (value, parameter) in values.iter_mut().zip(bench.parameters()) {
            if matches!(parameter, Parameter::Intensity(_)) {
                *value *= self.intensity;
            }
        }
        values
    }
}

/// One capture to be judged.
pub struct Case<'a> {
    /// The bench as described, with the mesh that the fit uses.
    pub described: &'a Scene,
    /// The same with the mesh of the truth.
    pub fine: &'a Scene,
    /// The true material.
    pub material: &'a dyn Brdf,
    /// How wrong the description is.
    pub misalignment: Misalignment,
    /// What the refinement is told about that.
    pub priors: BenchPriors,
    /// Key of bench, noise and true paths.
    pub seed: u64,
}

/// How cases are captured and fitted.
#[derive(Clone)]
pub struct Settings {
    /// What is fitted.
    pub dictionary: Arc<Dictionary>,
    /// How.
    pub fit: FitOptions,
    /// How the bench is refined.
    pub refine: RefineOptions,
    /// Paths per pixel of the true images.
    pub true_samples: u32,
    /// Pixels per side of the scored spheres.
    pub sphere_px: usize,
}

/// Environment errors of one case and what became of its bench.
pub struct Outcome {
    /// On the true bench.
    pub known: f64,
    /// On the described bench.
    pub unrefined: f64,
    /// On the refined bench.
    pub refined: f64,
    /// The bench as refined.
    pub estimate: BenchEstimate,
    /// True values of its parameters, in their order.
    pub truth: Vec<f64>,
    /// Wall seconds that the refinement added.
    pub refine_s: f64,
}

/// Captures and fits one case.
///
/// # Errors
/// Those of the fit.
pub fn judge(case: &Case<'_>, settings: &Settings) -> Result<Outcome, FitError> {
    let priors = &case.priors;
    let bench = Bench::new(case.described, priors);
    let mut numbers = stream(case.seed, Purpose::BenchPerturbation, 0, 0, 0);
    let truth = case.misalignment.draw(&bench, &mut numbers);
    let captured = capture(
        &Bench::new(case.fine, priors).scene(&truth),
        case.described,
        case,
        settings.true_samples,
    );
    let error = |weights: &[Vec<f64>; 3]| -> f64 {
        Mixture::new(settings.dictionary.clone(), weights.clone()).map_or(f64::NAN, |estimate| {
            let maps = EnvironmentMap::all();
            environment_error(&estimate, case.material, &maps, settings.sphere_px)
                .mean
                .all
        })
    };
    let plain = |scene: &Scene| -> Result<f64, FitError> {
        let fit = fit(
            scene,
            &captured,
            &settings.dictionary,
            &settings.fit,
            &mut |_| {},
        )?;
        Ok(error(&fit.weights))
    };
    let refined = refine_bench(
        case.described,
        &captured,
        &settings.dictionary,
        &settings.fit,
        priors,
        &settings.refine,
        &mut |_| {},
    )?;
    Ok(Outcome {
        known: plain(&bench.scene(&truth))?,
        unrefined: plain(case.described)?,
        refined: error(&refined.fit.weights),
        estimate: refined.estimate,
        truth: truth.iter().copied().collect(),
        refine_s: refined.fit.timings.first().map_or(0.0, |(_, s)| *s),
    })
}

/// Images of the true bench with the noise of a bracketed 12-bit capture, in units that
/// the described lamps' strengths explain.
fn capture(truth: &Scene, described: &Scene, case: &Case<'_>, samples: u32) -> Vec<RadianceImage> {
    let mut options = RenderOptions {
        samples_per_pixel: samples,
        max_reflections: 24,
        seed: stream(case.seed, Purpose::BenchPerturbation, 0, 0, 1).bits(),
        proposal: Proposal::default(),
    };
    let mix = |cosine, lobes: &[(f32, f32)]| Proposal {
        cosine,
        lobes: lobes.to_vec(),
        table: None,
    };
    let candidates = vec![
        Proposal::default(),
        mix(0.9, &[(0.3, 0.1)]),
        mix(0.6, &[(0.1, 0.2), (0.3, 0.2)]),
        mix(0.5, &[(0.05, 0.25), (0.15, 0.25)]),
        mix(0.3, &[(0.2, 0.5), (0.4, 0.2)]),
        mix(0.3, &[(0.1, 0.5), (0.25, 0.2)]),
    ];
    options.proposal = quietest_proposal(truth, case.material, &options, candidates);
    let mut images = render(truth, case.material, &options, &|_| {});
    debug_assert_eq!(images.len(), described.lights.len());
    let mut numbers = stream(case.seed, Purpose::BenchPerturbation, 0, 0, 2);
    for image in &mut images {
        spread_variance(image);
        let brightest = image.mean.iter().flatten().fold(0.0f32, |m, &v| m.max(v));
        for (mean, variance) in image.mean.iter_mut().zip(&mut image.variance) {
            for (mean, variance) in mean.iter_mut().zip(variance) {
                let sigma = f64::from(*mean) * relative_noise(f64::from(*mean / brightest));
                // The render's own noise is there, and so stated.
                *variance += (sigma * sigma) as f32;
                *mean += (sigma * numbers.normal()) as f32;
            }
        }
    }
    images
}

/// Replaces each pixel's variance by the mean over 5 × 5 pixels: where few paths of a pixel
/// were bright, both its value and its own variance are low, and a weight that follows
/// it would pull a fit low.
fn spread_variance(image: &mut RadianceImage) {
    let (width, height) = (image.width, image.height);
    let own = image.variance.clone();
    for (pixel, variance) in image.variance.iter_mut().enumerate() {
        let (x, y) = (pixel % width, pixel / width);
        let (mut sum, mut count) = ([0.0; 3], 0.0f32);
        for j in y.saturating_sub(2)..=(y + 2).min(height - 1) {
            for i in x.saturating_sub(2)..=(x + 2).min(width - 1) {
                let near = own[j * width + i];
                sum = [0, 1, 2].map(|c| sum[c] + near[c]);
                count += 1.0;
            }
        }
        *variance = sum.map(|s| s / count);
    }
}

/// Relative noise of a value after the merge of a bracket: 6000 electrons at best, fewer
/// below 1/256 of the brightest; 2.4 electrons of read noise, steps of 2.6 electrons.
fn relative_noise(value: f64) -> f64 {
    let electrons = 6000.0 * (256.0 * value).clamp(1e-3, 1.0);
    (electrons + 2.4f64.powi(2) + 2.6f64.powi(2) / 12.0).sqrt() / electrons
}
