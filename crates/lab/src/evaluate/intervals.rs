//! Coverage of the 95% intervals, cell by cell, over many captures.

use std::sync::Arc;

use super::defects::Defect;
use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table, quantile};
use super::lab::capture::{SENSOR, average};
use super::lab::materials::{Class, Material};
use super::lab::{Lab, Sample, misaligned};
use crate::brdf::{Brdf, Dictionary, HalfDifference, Mixture};
use crate::inverse::intervals::{self, Interval};
use crate::inverse::{FitOptions, RefineOptions, fit, refine_bench};
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};
use crate::simulation::photograph::Photographer;
use crate::transport::{Cells, Scene};

/// Pointwise coverage of the 95% intervals.
pub static INTERVALS: Experiment = Experiment {
    name: "intervals",
    shows: "Coverage of the 95% intervals of f at every (θh, θd) and channel over captures with noise, paths, finer mesh and misaligned bench of their own, where the bench is known, taken as described, and refined; also the median relative width and the fraction of cells that count as constrained",
    full: Scale {
        resolution_px: 16,
        samples_per_pixel: 256,
        truth_samples_per_pixel: 1024,
        lights: 2,
        materials: &["in-span", "bundled"],
        dictionary: Dictionary::DEFAULT,
        ..Scale::NONE
    },
    quick: Scale {
        resolution_px: 16,
        samples_per_pixel: 128,
        truth_samples_per_pixel: 512,
        lights: 2,
        materials: &["in-span", "bundled"],
        dictionary: Dictionary::DEFAULT,
        ..Scale::NONE
    },
    cases,
    figures,
};

/// The fit's prior on the bench, which is misaligned in every capture as in `misalignment`.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Known {
    /// The true bench.
    Exactly,
    /// Its description, taken as exact.
    Described,
    /// Its description with its uncertainty.
    Refined,
}

impl Known {
    const ALL: [Self; 3] = [Self::Exactly, Self::Described, Self::Refined];

    /// As in tables.
    fn name(self) -> &'static str {
        match self {
            Self::Exactly => "known",
            Self::Described => "described",
            Self::Refined => "refined",
        }
    }

    /// Captures per class of materials; fewer refined ones, one of which costs ten others.
    fn captures(self, quick: bool) -> u64 {
        match (quick, self) {
            (false, Self::Refined) => 100,
            (false, _) => 200,
            (true, Self::Refined) => 1,
            (true, _) => 4,
        }
    }
}

/// A noisy capture of `brdf` in the true scene `sound`, with `defect`.
pub(super) fn capture(
    lab: &Lab,
    sound: &Scene,
    brdf: &dyn Brdf,
    defect: Option<&Defect>,
    index: u64,
) -> Result<Vec<RadianceImage>, EvaluateError> {
    let truth = match defect {
        Some(defect) => &defect.scene(sound)?,
        None => sound,
    };
    let mut options = lab.truth_options(truth, brdf);
    options.seed = options.seed.wrapping_add(index << 20);
    let mut images = crate::transport::render(truth, brdf, &options);
    let photographer = Photographer {
        exposures: 3,
        seed: lab.settings.seed.wrapping_add(index),
        ..SENSOR
    };
    (0..)
        .zip(&mut images)
        .map(|(light, image)| {
            if let Some(defect) = defect {
                defect.image(image);
            }
            let mut taken = photographer.take(image, light)?;
            let cells = Cells::of_pixels([image.width, image.height]);
            // The truth's own paths are part of the capture's noise.
            for (p, variance) in taken.variance.iter_mut().enumerate() {
                let around: Vec<usize> = cells.around(p).chain([p]).collect();
                for (c, v) in variance.iter_mut().enumerate() {
                    let sum: f32 = around.iter().map(|&q| image.variance[q][c]).sum();
                    *v += sum / around.len() as f32;
                }
            }
            Ok(taken)
        })
        .collect()
}

/// Options of the fit of one capture: other paths for each, the material left out of the prior.
pub(super) fn options(lab: &Lab, class: Class, index: u64) -> Result<FitOptions, EvaluateError> {
    let all = of_class(lab, class)?;
    let mut options = FitOptions {
        posterior_samples: FitOptions::default().posterior_samples,
        ..lab.fit_options_for(all[(index % all.len() as u64) as usize])
    };
    options.cache.seed = lab.settings.seed.wrapping_add(index);
    Ok(options)
}

/// The mixtures of the dictionary's atoms, or all other materials.
///
/// # Errors
/// No material of this class.
pub(super) fn of_class(lab: &Lab, class: Class) -> Result<Vec<&Arc<Material>>, EvaluateError> {
    let in_span = class == Class::InSpan;
    let materials = lab.materials.iter();
    let all: Vec<_> = materials
        .filter(|m| (m.class == Class::InSpan) == in_span)
        .collect();
    match all.is_empty() {
        true => Err(EvaluateError::NoMaterial {
            class: class.name(),
        }),
        false => Ok(all),
    }
}

/// The material of a capture: measured ones in turn; of mixtures, three different ones in
/// the three channels, another three each round.
pub(super) fn material(
    lab: &Lab,
    class: Class,
    index: u64,
) -> Result<Arc<dyn Brdf>, EvaluateError> {
    let all = of_class(lab, class)?;
    let n = all.len() as u64;
    let at = |k: u64| &all[(k % n) as usize];
    if class != Class::InSpan {
        return Ok(at(index).brdf.clone());
    }
    let round = index / n;
    let set = crate::brdf::in_span::set();
    let weights = [index, index + 7 + round, index + 13 + 2 * round].map(|k| {
        let name = &at(k).name;
        set.iter()
            .find(|m| name.ends_with(&m.name))
            .map(|m| m.mixture())
    });
    match weights {
        [Some(a), Some(b), Some(c)] => {
            let weights = [&a, &b, &c].map(|m| m.weights()[1].clone());
            Ok(Arc::new(Mixture::new(a.dictionary().clone(), weights)?))
        }
        _ => Ok(at(index).brdf.clone()),
    }
}

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let mut cases = Vec::new();
    for class in [Class::InSpan, Class::Measured] {
        if of_class(lab, class).is_err() {
            continue;
        }
        for known in Known::ALL {
            let key = format!("{}/{}", class.name(), known.name());
            cases.push(Case::new(key, move |lab: &Lab| coverage(lab, class, known)));
        }
    }
    Ok(cases)
}

pub(super) fn theta_h_deg() -> Vec<f64> {
    (0..12)
        .map(|i| 85.0 * (f64::from(i) / 11.0).powi(2))
        .collect()
}

pub(super) fn theta_d_deg() -> Vec<f64> {
    (0..9).map(|j| 10.0 * f64::from(j)).collect()
}

/// f of a BRDF at the cells of [`intervals::table`].
pub(super) fn values(brdf: &dyn Brdf) -> Vec<[f64; 3]> {
    let mut cells = Vec::new();
    for theta_h in theta_h_deg() {
        for theta_d in theta_d_deg() {
            let (i, o) = HalfDifference {
                theta_h_rad: theta_h.to_radians(),
                theta_d_rad: theta_d.to_radians(),
                phi_d_rad: std::f64::consts::FRAC_PI_2,
            }
            .to_directions();
            cells.push(brdf.eval(i.as_vec3(), o.as_vec3()).map(f64::from));
        }
    }
    cells
}

/// f in truth and its interval, by cell.
type Trial = (Vec<[f64; 3]>, Vec<Interval>);

/// One capture on a bench of its own, fitted.
fn trial(lab: &Lab, class: Class, known: Known, index: u64) -> Result<Trial, EvaluateError> {
    let sample = Sample::Bowl;
    let brdf = material(lab, class, index)?;
    let described = sample.scene(
        lab.settings.resolution_px,
        sample.lights(lab.settings.lights),
    )?;
    let bench = misaligned::bench(&described);
    let seed = lab.settings.seed;
    let mut numbers = stream(seed, Purpose::BenchPerturbation, index, 0, 0);
    let truth = misaligned::draw(&bench, &mut numbers);
    let scene = bench.scene(&truth);
    let sound = sample.true_scene(
        lab.settings.resolution_px,
        sample.lights(lab.settings.lights),
    )?;
    let images = capture(lab, &sound, &*brdf, Some(&Defect::Misaligned(truth)), index)?;
    let (dictionary, options) = (&lab.dictionary, options(lab, class, index)?);
    let images = average(&described, &images, dictionary)?;
    let quiet = &();
    let fit = match known {
        Known::Exactly => fit(&scene, &images, dictionary, &options)?,
        Known::Described => fit(&described, &images, dictionary, &options)?,
        Known::Refined => {
            let (priors, refine) = (misaligned::priors(), RefineOptions::default());
            refine_bench(
                &described, &images, dictionary, &options, &priors, &refine, quiet,
            )?
            .fit(dictionary, &options, quiet)?
        }
    };
    let (theta_h, theta_d) = (theta_h_deg(), theta_d_deg());
    let cells = intervals::table(
        &fit.material,
        &fit.posterior_samples,
        &theta_h,
        &theta_d,
        90.0,
    );
    Ok((values(&*brdf), cells))
}

/// One row per cell and channel.
fn coverage(lab: &Lab, class: Class, known: Known) -> Result<Vec<Row>, EvaluateError> {
    use rayon::prelude::*;
    let captures = known.captures(lab.settings.quick);
    let trials = (0..captures)
        .into_par_iter()
        .map(|index| trial(lab, class, known, index))
        .collect::<Result<Vec<_>, EvaluateError>>()?;
    let (theta_h, theta_d) = (theta_h_deg(), theta_d_deg());
    let mut rows = Vec::new();
    for (cell, (h, d)) in theta_h
        .iter()
        .flat_map(|h| theta_d.iter().map(move |d| (h, d)))
        .enumerate()
    {
        for (c, channel) in ["R", "G", "B"].into_iter().enumerate() {
            let inside = |(truth, cells): &&Trial| {
                (cells[cell].lower[c]..=cells[cell].upper[c]).contains(&truth[cell][c])
            };
            let constrained = || trials.iter().filter(|t| t.1[cell].constrained);
            let widths: Vec<f64> = constrained()
                .filter(|t| t.0[cell][c] > 0.0)
                .map(|t| (t.1[cell].upper[c] - t.1[cell].lower[c]) / t.0[cell][c])
                .collect();
            let n = constrained().count();
            let row = Row::new()
                .with("class", class.name())
                .with("bench", known.name())
                .with("theta_h_deg", *h)
                .with("theta_d_deg", *d)
                .with("channel", channel)
                .with("captures", captures as f64)
                .with(
                    "coverage",
                    trials.iter().filter(inside).count() as f64 / captures as f64,
                )
                .with("constrained", n as f64 / captures as f64)
                .with(
                    "coverage_where_constrained",
                    (n > 0).then(|| constrained().filter(inside).count() as f64 / n as f64),
                )
                .with(
                    "median_relative_width",
                    (!widths.is_empty()).then(|| quantile(&widths, 0.5)),
                );
            rows.push(row);
        }
    }
    Ok(rows)
}

/// A row of panels per class, one panel for each prior on the bench.
fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let panel = |(class, known): (Class, Known)| {
        let series = theta_d_deg()
            .into_iter()
            .step_by(2)
            .enumerate()
            .map(|(color, d)| {
                let points = theta_h_deg().into_iter().filter_map(|h| {
                    let here = table.figures("coverage", |row| {
                        row.text("class") == class.name()
                            && row.text("bench") == known.name()
                            && row.number("theta_h_deg") == Some(h)
                            && row.number("theta_d_deg") == Some(d)
                    });
                    (!here.is_empty()).then(|| [h, here.iter().sum::<f64>() / here.len() as f64])
                });
                Series::new(&format!("θd = {d}°"), color, Mark::Points, points.collect())
            });
        Chart {
            title: format!("{} materials, bench {}", class.name(), known.name()),
            x: Axis::linear(0.0..90.0, "θh, degrees"),
            y: Axis::linear(0.0..1.0, "captures whose 95% interval covers the truth"),
            series: series.collect(),
        }
    };
    let panels: Vec<Chart> = [Class::InSpan, Class::Measured]
        .into_iter()
        .flat_map(|class| Known::ALL.map(|known| panel((class, known))))
        .collect();
    Ok(vec![charts("coverage", 3, &panels)])
}
