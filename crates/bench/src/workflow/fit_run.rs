//! Fitting by a plan.

use super::fit_course::Course;
use super::fit_plan::FitPlan;
use super::notice::{Notice, Observer};
use super::{WorkflowError, coarse_facets, fit_memory, summary, warnings};
use crate::brdf::Brdf;
use crate::cells::Captured;
use crate::inverse::{Fit, RefineOptions, fit_with_progress, refine_bench};
use crate::session::fit_record::{BenchRecord, FitRecord};
use crate::transport::{RenderOptions, Scene, truncation_remainder};

/// Paths per pixel that the estimate of the truncated light takes.
const TRUNCATION_SAMPLES: u32 = 32;

/// A fit, and its record.
pub(super) struct Run {
    pub record: FitRecord,
    pub fit: Fit,
    /// The scene on the bench as refined, where that was asked for.
    pub refined: Option<Scene>,
}

impl FitPlan {
    /// Fits and describes the result. `truth`: name and BRDF, where known.
    ///
    /// # Errors
    /// Too little memory, or equations without a solution.
    pub(super) fn run(
        &self,
        scene: &Scene,
        captured: &Captured,
        simulated: bool,
        truth: Option<(&str, &dyn Brdf)>,
        observer: &dyn Observer,
    ) -> Result<Run, WorkflowError> {
        let two_estimates = self.options.second_estimate(&self.dictionary).is_some();
        let course = Course::new(observer, two_estimates, self.priors.is_some());
        let observer: &dyn Observer = &course;
        let mut remarks: Vec<String> = scene.remarks().iter().map(ToString::to_string).collect();
        let mut remark = |text: String| {
            observer.notice(Notice::Remark(&text));
            remarks.push(text);
        };
        if let Some(coarse) = coarse_facets(scene, self.dictionary.atoms()) {
            remark(coarse);
        }
        let size = [captured.len(), captured.images.len()];
        observer.notice(Notice::Work(self.work(size[0], size[1])));

        // The fit, on a refined bench where that was asked for.
        let dictionary = &self.dictionary;
        let (atoms, refines_bench) = (dictionary.len(), self.priors.is_some());
        let options =
            &fit_memory::bounded(&self.options, size, atoms, refines_bench, self.memory_mib)?;
        let (fit, refined) = match &self.priors {
            None => (
                fit_with_progress(scene, captured, dictionary, options, observer)?,
                None,
            ),
            Some(priors) => {
                let how = RefineOptions::default();
                let refined =
                    refine_bench(scene, captured, dictionary, options, priors, &how, observer)?;
                let fit = refined.fit(dictionary, options, observer)?;
                (fit, Some((refined.estimate, refined.scene)))
            }
        };
        if fit.samples[0] < fit.samples[1] {
            remark(format!(
                "{} of {} paths per cell were traced: more do not fit into the memory given",
                fit.samples[0], fit.samples[1]
            ));
        }

        // What it comes to.
        observer.begin("scoring", None);
        let mut record = summary::of_fit(self, &fit, simulated, truth)?;
        observer.begin("longer paths", None);
        let paths = RenderOptions {
            max_reflections: self.options.cache.max_reflections,
            seed: self.options.cache.seed,
            ..RenderOptions::default()
        };
        let remainder = truncation_remainder(scene, &fit.material, &paths, TRUNCATION_SAMPLES);
        record.truncation_remainder = remainder.iter().map(|r| r.share).collect();
        let (bench, refined) = refined.unzip();
        record.bench = bench.as_ref().map(BenchRecord::from);
        record.warnings = warnings::of_fit(&fit, &record, self.allows_stray_light());
        record.remarks = remarks;
        if fit.discrepancy > 0.0 {
            observer.notice(Notice::Discrepancy {
                dictionary: &record.dictionary,
                amplitude: fit.discrepancy,
            });
        }
        course.end();
        Ok(Run {
            record,
            fit,
            refined,
        })
    }
}
