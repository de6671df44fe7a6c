//! Lights chosen for the information they add, compared with evenly spread and random ones.

use std::sync::{Arc, OnceLock};

use glam::DVec3;

use super::experiment::{Case, EvaluateError, Experiment, Medians, Scale, Table};
use super::lab::{Lab, Sample};
use crate::inverse::FitOptions;
use crate::inverse::expected_error::{PredictionOptions, Prospects, Subject, USUAL};
use crate::inverse::intervals::{self, Interval};
use crate::plot::{Axis, Chart, Figure, Series, charts};
use crate::random::{Purpose, stream};
use crate::transport::Light;

/// Two shapes, three rules.
pub static NEXT_LIGHT: Experiment = Experiment {
    name: "next-light",
    shows: "error and width of the intervals against the number of lights, where the lights are chosen for the information they are expected to add, evenly spread, or random",
    full: Scale {
        resolution_px: 32,
        samples_per_pixel: 256,
        truth_samples_per_pixel: 1024,
        lights: 6,
        materials: &["in-span", "bundled"],
        ..Scale::SINGLE_IMAGE
    },
    // Smaller images of a corner are all edges.
    quick: Scale {
        resolution_px: 24,
        lights: 2,
        materials: &["in-span:03", "nbrdf:pvc"],
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

const SAMPLES: [Sample; 2] = [Sample::Bowl, Sample::ConcaveCorner];
/// Directions to choose from, as many as a capture compares.
const CANDIDATES: usize = 60;
/// Pixels per side at which they are compared.
const COARSE_PX: usize = 24;
/// Random sets per number of lights.
const RANDOM_SETS: usize = 3;
/// Posterior samples behind an interval.
const POSTERIOR_SAMPLES: usize = 100;

/// How lights are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rule {
    Best,
    Even,
    Random(usize),
}

impl Rule {
    fn name(self) -> &'static str {
        match self {
            Rule::Best => "best",
            Rule::Even => "evenly spread",
            Rule::Random(_) => "random",
        }
    }
}

/// The directions of a sample in evenly spread order, and the information each would add.
struct Choosing {
    sample: Sample,
    candidates: Vec<Light>,
    prospects: OnceLock<Result<Prospects, String>>,
}

impl Choosing {
    fn new(sample: Sample) -> Self {
        Self {
            sample,
            candidates: farthest_first(sample.lights(CANDIDATES)),
            prospects: OnceLock::new(),
        }
    }

    fn prospects(&self, lab: &Lab) -> Result<&Prospects, EvaluateError> {
        let compute = || {
            let scene = self.sample.scene(COARSE_PX, self.candidates.clone())?;
            let options = PredictionOptions {
                seed: lab.settings.seed,
                ..PredictionOptions::default()
            };
            let usual = USUAL.into_iter().filter_map(Subject::embedded);
            let usual: Vec<Arc<Subject>> = usual.map(Arc::new).collect();
            Ok(Prospects::new(scene, &usual, &options)?)
        };
        self.prospects
            .get_or_init(|| compute().map_err(|error: EvaluateError| error.to_string()))
            .as_ref()
            .map_err(|fact| EvaluateError::Fact(fact.clone()))
    }

    /// Candidates by a rule.
    fn choose(&self, lab: &Lab, rule: Rule, count: usize) -> Result<Vec<usize>, EvaluateError> {
        Ok(match rule {
            Rule::Best => {
                let best = self.prospects(lab)?.best(count);
                best.iter().map(|choice| choice.candidate).collect()
            }
            Rule::Even => (0..count).collect(),
            Rule::Random(set) => {
                let seed = lab.settings.seed;
                let mut numbers = stream(seed, Purpose::Experiment, set as u64, count as u64, 0);
                let mut all: Vec<usize> = (0..CANDIDATES).collect();
                for k in 0..count {
                    let left = (CANDIDATES - k) as f64;
                    all.swap(k, k + (numbers.uniform() * left) as usize);
                }
                all.truncate(count);
                all
            }
        })
    }
}

/// The first light, then always the one farthest from all before it.
fn farthest_first(lights: Vec<Light>) -> Vec<Light> {
    let direction = |light: &Light| match *light {
        Light::Directional { to_light, .. } => to_light,
        Light::Point { position_mm, .. } => position_mm.normalize_or(DVec3::Z),
    };
    let mut rest = lights;
    let mut ordered: Vec<Light> = Vec::with_capacity(rest.len());
    while !rest.is_empty() {
        let gap = |light: &Light| {
            ordered
                .iter()
                .map(|o| direction(o).distance(direction(light)))
                .fold(f64::INFINITY, f64::min)
        };
        let mut best = 0;
        for at in 1..rest.len() {
            if gap(&rest[at]) > gap(&rest[best]) {
                best = at;
            }
        }
        ordered.push(rest.remove(best));
    }
    ordered
}

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let mut rules = vec![Rule::Best, Rule::Even];
    rules.extend((0..RANDOM_SETS).map(Rule::Random));
    let choosing = SAMPLES.map(|sample| Arc::new(Choosing::new(sample)));
    let mut cases = Vec::new();
    for material in &lab.materials {
        for choosing in &choosing {
            for lights in 1..=lab.settings.lights {
                for &rule in &rules {
                    let (material, choosing) = (material.clone(), choosing.clone());
                    let sample = choosing.sample;
                    let key = format!("{}/{}/{lights}/{rule:?}", material.name, sample.name());
                    cases.push(Case::new(key, move |lab: &Lab| {
                        let chosen = choosing.choose(lab, rule, lights)?;
                        let expected = choosing.prospects(lab)?.error(&chosen);
                        let lights: Vec<Light> =
                            chosen.iter().map(|&c| choosing.candidates[c]).collect();
                        let captured = lab.capture(sample, &lights, &*material.brdf)?;
                        let scene = sample.scene(lab.settings.resolution_px, lights.clone())?;
                        let options = FitOptions {
                            posterior_samples: POSTERIOR_SAMPLES,
                            ..lab.fit_options_for(&material)
                        };
                        let estimate =
                            lab.fit_with(&scene, &captured, &lab.dictionary, &options)?;
                        let row = material
                            .row(sample)
                            .with("rule", rule.name())
                            .with("lights", lights.len())
                            .with("expected_error", expected);
                        let fit = &estimate.fit;
                        let (theta_h, theta_d) = table_angles();
                        let table = intervals::table(
                            &fit.material,
                            &fit.posterior_samples,
                            &theta_h,
                            &theta_d,
                            90.0,
                        );
                        let row = row.and(lab.score_row(&estimate.fit.material, &material)?);
                        Ok(vec![row.with("interval_width", width(&table))])
                    }));
                }
            }
        }
    }
    Ok(cases)
}

/// θh denser towards the mirror direction, θd to 80°; degrees.
fn table_angles() -> (Vec<f64>, Vec<f64>) {
    let theta_h = (0..16).map(|i| f64::from(i * i) * 80.0 / 225.0);
    (
        theta_h.collect(),
        (0..9).map(|j| f64::from(j) * 10.0).collect(),
    )
}

/// Mean over cells and channels of ∛upper − ∛lower, over the mean of ∛value: the width
/// of the 95% interval in the measure of the cube-root BRDF error.
fn width(table: &[Interval]) -> f64 {
    let (mut widths, mut values) = (0.0, 0.0);
    for cell in table {
        for c in 0..3 {
            widths += cell.upper[c].cbrt() - cell.lower[c].cbrt();
            values += cell.value[c].cbrt();
        }
    }
    widths / values
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let counts = table.numbers("lights");
    let last = counts.last().copied().unwrap_or(1.0);
    let ticks = counts.iter().map(|&n| (n, format!("{n}")));
    let x = Axis::with_ticks(0.8..last + 0.2, ticks.collect(), "number of lights");
    let panel = |sample: Sample, column: &str, label: &str| {
        let medians = Medians {
            table,
            column,
            x_column: "lights",
            x: &counts,
            position: |n| n,
        };
        let mut all = Vec::new();
        let series = ["best", "evenly spread", "random"].iter().enumerate();
        let series = series.map(|(color, rule)| {
            let series = medians.series(rule, color, |row| {
                row.text("shape") == sample.name() && row.text("rule") == *rule
            });
            all.extend(series.points.iter().map(|p| p[1]));
            series.within(Vec::new())
        });
        let series: Vec<Series> = series.collect();
        let low = all.iter().copied().fold(f64::INFINITY, f64::min);
        let high = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let range = if low <= high {
            low - 0.1..high + 0.1
        } else {
            -1.0..0.0
        };
        Chart {
            title: sample.name().to_owned(),
            x: x.clone(),
            y: Axis::decades(range, label),
            series,
        }
    };
    let panels: Vec<Chart> = [
        ("environment_error", "median environment error"),
        ("interval_width", "median interval width"),
    ]
    .into_iter()
    .flat_map(|(column, label)| SAMPLES.map(|sample| panel(sample, column, label)))
    .collect();
    Ok(vec![charts("next-light", SAMPLES.len(), &panels)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_distinct_candidates_and_even_ones_nested() {
        let choosing = Choosing::new(Sample::Bowl);
        let Light::Directional { to_light, .. } = choosing.candidates[0] else {
            panic!()
        };
        assert_eq!(to_light, DVec3::Z);
        // The second is as far from the zenith as there are.
        let z = |light: &Light| match light {
            Light::Directional { to_light, .. } => to_light.z,
            Light::Point { .. } => 1.0,
        };
        let lowest = choosing.candidates.iter().map(z).fold(1.0, f64::min);
        assert_eq!(z(&choosing.candidates[1]), lowest);
    }

    #[test]
    fn the_width_of_known_intervals() {
        let cell = Interval {
            value: [1.0; 3],
            lower: [0.125; 3],
            upper: [3.375; 3],
            constrained: true,
        };
        assert!((width(&[cell, cell]) - 1.0).abs() < 1e-12);
    }
}
