//! Coverage of the intervals on samples that deviate from their mesh, where the fit's model
//! includes a form error, and where it does not.

use super::defects::Defect;
use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table, quantile};
use super::intervals::{capture, material, of_class, options, theta_d_deg, theta_h_deg, values};
use super::lab::capture::average;
use super::lab::materials::Class;
use super::lab::{Lab, Sample};
use crate::brdf::Brdf;
use crate::geometry::FormError;
use crate::inverse::budget::Source;
use crate::inverse::intervals::Interval;
use crate::inverse::variance_shares;
use crate::inverse::{FitOptions, fit, intervals};
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};

/// Coverage against the slope error of the sample.
pub static FORM: Experiment = Experiment {
    name: "form",
    shows: "Coverage of the 95% intervals where the sample deviates from its mesh by a form and a slope error (correlated over 0.4 mm of 2 mm), which the fit's model does not include (not stated) or includes (stated), and the mesh's share of the variance",
    full: Scale {
        resolution_px: 16,
        samples_per_pixel: 256,
        truth_samples_per_pixel: 1024,
        lights: 2,
        materials: &["in-span"],
        ..Scale::NONE
    },
    quick: Scale {
        resolution_px: 16,
        samples_per_pixel: 64,
        truth_samples_per_pixel: 256,
        lights: 2,
        materials: &["in-span"],
        ..Scale::NONE
    },
    cases,
    figures,
};

/// Captures per slope error, and in the small version.
const CAPTURES: [u64; 2] = [40, 6];
/// Rms slope errors, degrees.
const SLOPES_DEG: [f64; 4] = [0.0, 0.5, 1.0, 2.0];
/// The one of the small version.
const QUICK_DEG: f64 = 2.0;
/// Correlation length of the deviation, mm.
const CORRELATION_MM: f64 = 0.4;
/// Half and difference angle at which the mesh's share is given, degrees.
const SHARE_AT_DEG: [f64; 2] = [5.0, 10.0];

/// Whether the fit's model includes the form error, as in tables.
const STATED: [&str; 2] = ["not stated", "stated"];

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    of_class(lab, Class::InSpan)?;
    let slopes = SLOPES_DEG.into_iter();
    Ok(slopes
        .filter(|&slope| !lab.settings.quick || slope == QUICK_DEG)
        .map(|slope_deg| {
            Case::new(format!("{slope_deg} deg"), move |lab: &Lab| {
                coverage(lab, slope_deg)
            })
        })
        .collect())
}

/// One capture with one fit.
struct Trial {
    truth: Vec<[f64; 3]>,
    cells: Vec<Interval>,
    share: f64,
}

impl Trial {
    /// Truth, bounds and whether the cell is constrained, of all cells and channels.
    fn each(&self) -> impl Iterator<Item = (f64, [f64; 2], bool)> {
        self.truth
            .iter()
            .zip(&self.cells)
            .flat_map(|(truth, cell)| {
                (0..3).map(|c| (truth[c], [cell.lower[c], cell.upper[c]], cell.constrained))
            })
    }
}

/// A row for the fits whose model has no form error, and one for those that have it.
fn coverage(lab: &Lab, slope_deg: f64) -> Result<Vec<Row>, EvaluateError> {
    use rayon::prelude::*;
    let height_mm = slope_deg.to_radians() * CORRELATION_MM / std::f64::consts::SQRT_2;
    let error = FormError::new(height_mm, slope_deg.to_radians());
    let captures = CAPTURES[usize::from(lab.settings.quick)];
    let trials = (0..captures)
        .into_par_iter()
        .map(|index| trials(lab, error, index))
        .collect::<Result<Vec<_>, EvaluateError>>()?;
    Ok((0..2)
        .map(|stated| {
            let all = || trials.iter().flat_map(|t| t[stated].each());
            let covers = |(truth, [lower, upper], _): &(f64, [f64; 2], bool)| {
                (*lower..=*upper).contains(truth)
            };
            let widths: Vec<f64> = all()
                .filter(|(truth, _, constrained)| *constrained && *truth > 0.0)
                .map(|(truth, [lower, upper], _)| (upper - lower) / truth)
                .collect();
            let (count, constrained) = (all().count() as f64, all().filter(|t| t.2).count());
            let covered_there = all().filter(|t| t.2).filter(covers).count() as f64;
            let share: f64 = trials.iter().map(|t| t[stated].share).sum();
            Row::new()
                .with("slope_error_deg", slope_deg)
                .with("form_error_mm", height_mm)
                .with("fit", STATED[stated])
                .with("captures", captures as f64)
                .with("coverage", all().filter(covers).count() as f64 / count)
                .with("constrained", constrained as f64 / count)
                .with(
                    "coverage_where_constrained",
                    (constrained > 0).then(|| covered_there / constrained as f64),
                )
                .with(
                    "median_relative_width",
                    (!widths.is_empty()).then(|| quantile(&widths, 0.5)),
                )
                .with("mesh_share", share / captures as f64)
        })
        .collect())
}

/// One capture, fitted without and with the error stated.
fn trials(lab: &Lab, error: Option<FormError>, index: u64) -> Result<[Trial; 2], EvaluateError> {
    let sample = Sample::Bowl;
    let brdf = material(lab, Class::InSpan, index)?;
    let seed = lab.settings.seed.wrapping_add(index);
    let defect = error.map(|error| Defect::Form(error, seed));
    let lights = sample.lights(lab.settings.lights);
    let sound = sample.true_scene(lab.settings.resolution_px, lights.clone())?;
    let images = capture(lab, &sound, &*brdf, defect.as_ref(), index)?;
    let scene = sample.scene(lab.settings.resolution_px, lights)?;
    let captured = average(&scene, &images, &lab.dictionary)?;
    let one = |form_error| -> Result<Trial, EvaluateError> {
        let options = FitOptions {
            form_error,
            ..options(lab, Class::InSpan, index)?
        };
        let fit = fit(&scene, &captured, &lab.dictionary, &options)?;
        let (theta_h, theta_d) = (theta_h_deg(), theta_d_deg());
        let (material, samples) = (&fit.material, &fit.posterior_samples);
        let cells = intervals::table(material, samples, &theta_h, &theta_d, 90.0);
        let [theta_h, theta_d] = SHARE_AT_DEG;
        let budget = variance_shares::at(material, samples, theta_h, theta_d);
        let share = budget.map_or(0.0, |cell| {
            let total: f64 = cell.relative_variance.iter().sum();
            cell.relative_variance[Source::Mesh as usize] / total.max(f64::MIN_POSITIVE)
        });
        Ok(Trial {
            truth: values(&*brdf as &dyn Brdf),
            cells,
            share,
        })
    };
    Ok([one(None)?, one(error)?])
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let series = STATED.iter().enumerate().map(|(color, stated)| {
        let points = SLOPES_DEG.into_iter().filter_map(|slope| {
            let here = table.figures("coverage", |row| {
                row.text("fit") == *stated && row.number("slope_error_deg") == Some(slope)
            });
            Some([slope, *here.first()?])
        });
        Series::new(stated, color, Mark::Points, points.collect())
    });
    let chart = Chart {
        title: "bowl".to_owned(),
        x: Axis::linear(-0.1..2.1, "slope error of the sample, degrees"),
        y: Axis::linear(0.0..1.0, "cells whose 95% interval covers the truth"),
        series: series.collect(),
    };
    Ok(vec![charts("form", 1, &[chart])])
}
