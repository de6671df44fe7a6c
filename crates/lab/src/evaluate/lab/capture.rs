//! Images of the truth, and the fit to them.
//!
//! Truth and fit never share what would make the problem too easy: the true images have
//! another seed, a finer mesh, another renderer and more paths.

use std::sync::Arc;

use super::{Lab, Material, Sample};
use crate::bench_priors::BenchPriors;
use crate::brdf::{Brdf, Dictionary, Mixture};
use crate::cells::{Captured, CellOptions};
use crate::evaluate::error::EvaluateError;
use crate::inverse::{Fit, FitError, FitOptions, fit};
use crate::radiance_image::RadianceImage;
use crate::simulation::photograph::Photographer;
use crate::transport::{
    CacheOptions, Light, RenderOptions, Scene, Steering, render, suited_proposal,
};

/// Seeds of the truth lie far from those of fits.
const TRUTH: u64 = 0x7275_7468;

impl Lab {
    /// Images of `brdf` on the true shape, one per light, with the render's variance.
    pub fn capture(
        &self,
        sample: Sample,
        lights: &[Light],
        brdf: &dyn Brdf,
    ) -> Result<Vec<RadianceImage>, EvaluateError> {
        let scene = sample.true_scene(self.settings.resolution_px, lights.to_vec())?;
        Ok(self.render_truth(&scene, brdf))
    }

    /// Images of a scene with the truth's seed and number of paths.
    pub fn render_truth(&self, scene: &Scene, brdf: &dyn Brdf) -> Vec<RadianceImage> {
        render(scene, brdf, &self.truth_options(scene, brdf))
    }

    /// Options of a render of the truth.
    pub fn truth_options(&self, scene: &Scene, brdf: &dyn Brdf) -> RenderOptions {
        let mut options = RenderOptions {
            samples_per_pixel: self.settings.truth_samples_per_pixel.max(2),
            max_reflections: self.settings.max_reflections,
            seed: self.settings.seed.wrapping_add(TRUTH),
            steering: Steering::default(),
            ..RenderOptions::default()
        };
        options.proposal = suited_proposal(scene, brdf, &options);
        options
    }

    /// Options of a fit: the settings' paths, seed and kernel.
    pub fn fit_options(&self) -> FitOptions {
        FitOptions {
            cache: CacheOptions {
                samples_per_cell: self.settings.samples_per_pixel,
                max_reflections: self.settings.max_reflections,
                seed: self.settings.seed,
                ..CacheOptions::default()
            },
            kernel: self.kernel,
            ..FitOptions::default()
        }
    }

    /// The same for images of `material`, which the fit's prior is not learned from.
    pub fn fit_options_for(&self, material: &Material) -> FitOptions {
        FitOptions {
            left_out: vec![material.name.clone()],
            ..self.fit_options()
        }
    }

    /// Fits the laboratory's dictionary to images of `material` on `sample` under `lights`.
    pub fn fit(
        &self,
        sample: Sample,
        lights: &[Light],
        captured: &[RadianceImage],
        material: &Material,
    ) -> Result<Estimate, EvaluateError> {
        let scene = sample.scene(self.settings.resolution_px, lights.to_vec())?;
        self.fit_scene(&scene, captured, material)
    }

    /// Fits the laboratory's dictionary to images of `material` in any scene.
    pub fn fit_scene(
        &self,
        scene: &Scene,
        captured: &[RadianceImage],
        material: &Material,
    ) -> Result<Estimate, EvaluateError> {
        let options = self.fit_options_for(material);
        self.fit_with(scene, captured, &self.dictionary, &options)
    }

    /// Fits any dictionary to images of any scene.
    pub fn fit_with(
        &self,
        scene: &Scene,
        captured: &[RadianceImage],
        dictionary: &Arc<Dictionary>,
        options: &FitOptions,
    ) -> Result<Estimate, EvaluateError> {
        let captured = average(scene, captured, dictionary)?;
        let fit = fit(scene, &captured, dictionary, options)?;
        Ok(Estimate {
            start: Mixture::new(dictionary.clone(), fit.start.clone())?,
            fit,
        })
    }

    /// Captures a material on a sample under its first `lights` and fits.
    pub fn measure(
        &self,
        sample: Sample,
        lights: usize,
        material: &Material,
    ) -> Result<Estimate, EvaluateError> {
        let lights = sample.lights(lights);
        let captured = self.capture(sample, &lights, &*material.brdf)?;
        self.fit(sample, &lights, &captured, material)
    }
}

/// A 12-bit sensor that takes a bracket of four exposures.
pub const SENSOR: Photographer = Photographer {
    bit_depth: 12,
    full_well_e: 10_000.0,
    read_noise_e: 2.4,
    exposures: 4,
    frames: 1,
    seed: 0,
};

/// Rendered images as a sensor sees them.
pub fn photograph(
    photographer: &Photographer,
    rendered: &[RadianceImage],
) -> Result<Vec<RadianceImage>, EvaluateError> {
    (0..)
        .zip(rendered)
        .map(|(light, image)| Ok(photographer.take(image, light)?))
        .collect()
}

/// Images averaged over the cells that a fit of this dictionary compares.
pub fn average(
    scene: &Scene,
    images: &[RadianceImage],
    dictionary: &Dictionary,
) -> Result<Captured, EvaluateError> {
    let options = CellOptions::new(dictionary, &BenchPriors::EXACT);
    Ok(Captured::new(scene, images, &options).map_err(FitError::from)?)
}

/// What a fit found.
pub struct Estimate {
    /// The single-bounce start.
    pub start: Mixture,
    /// The fit itself.
    pub fit: Fit,
}

impl Estimate {
    /// Mean squared residual in standard deviations, over lights and channels.
    pub fn mean_reduced_chi2(&self) -> f64 {
        let all = self.fit.comparison.reduced_chi2();
        let all = all.as_flattened();
        all.iter().sum::<f64>() / all.len().max(1) as f64
    }
}
