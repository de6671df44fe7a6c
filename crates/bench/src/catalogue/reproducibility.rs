//! What repeated measurements of one sample say about their uncertainty: the spread between
//! sessions (Type A of the GUM, JCGM 100:2008, 4.2) next to the uncertainty that each fit states.
//!
//! At every pair of angles of the error budget, with the values x of n sessions, each with a
//! stated relative standard deviation u:
//!
//! ```text
//! s² = Σ (x − x̄)² / (n − 1) / x̄²            between the sessions
//! v² = mean of the parts of u² that are drawn anew in each session
//! b² = max(0, s² − v²)                        what varies beyond that
//! c² = mean of u² + b²                        combined, of one session
//! ```
//!
//! s² contains v² already, which is therefore subtracted before b² is added to what the fits
//! state. What is common to all sessions, such as the mesh, shifts every x alike: no number of
//! repeats shows it, and it stays in c² as stated.

use serde::Serialize;

use crate::inverse::budget::Source;
use crate::session::fit_record::{BudgetRecord, BudgetRow};
use crate::statistics::chi2_tail;

/// Sources that are drawn anew in each session, where the sample was taken out and put back
/// and the stage was homed in between. The others are common to all sessions, wholly or in part:
/// fits of equal seed follow the same light paths, and one lamp is calibrated once.
pub const DRAWN_ANEW: [Source; 3] = [Source::CaptureNoise, Source::Pose, Source::LightDirections];

/// A session's fit, as far as it is compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Repeat {
    /// Name of the session.
    pub session: String,
    /// Its fit's values with their stated uncertainties.
    pub budget: BudgetRecord,
}

/// The reproducibility of one sample's measurement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reproducibility {
    /// Name of the sample.
    pub sample: String,
    /// Names of the sessions, in the order of the fits.
    pub sessions: Vec<String>,
    /// How well so few sessions determine a standard deviation: its own relative standard
    /// deviation, for normally distributed values.
    pub relative_std_of_std: f64,
    /// Sources that repeats show.
    pub drawn_anew: Vec<String>,
    /// Sources that no repeat shows.
    pub common: Vec<String>,
    /// One row per pair of angles that all fits have.
    pub row: Vec<ReproducibilityRow>,
}

/// The reproducibility at one pair of angles. All standard deviations are relative to the mean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct ReproducibilityRow {
    pub theta_h_deg: f64,
    pub theta_d_deg: f64,
    /// Mean of f over the sessions, 1/sr.
    pub mean: f64,
    /// s: standard deviation between the sessions.
    pub relative_std: f64,
    /// u: standard deviation as stated by the fits, root mean square.
    pub stated_relative_std: f64,
    /// v: the part of it that is drawn anew in each session.
    pub drawn_anew_relative_std: f64,
    /// b: standard deviation between the sessions beyond v, 0 where s is not above it.
    pub between_relative_std: f64,
    /// c: standard deviation of one session, stated and between together.
    pub combined_relative_std: f64,
    /// Part of b² in c², 0..=1.
    pub share: f64,
    /// Probability of a spread of at least s if v were all that varies; `None` where v is 0.
    pub chance: Option<f64>,
}

/// Why there is no reproducibility; facts only.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ReproducibilityError {
    /// A standard deviation needs two values.
    #[error(
        "sample {sample:?} has {} with a trusted fit and an error budget; a spread needs 2 at least",
        crate::shown::count(*count, "session")
    )]
    TooFew { sample: String, count: usize },
    /// Nothing can be compared.
    #[error("sample {sample:?}: its fits have no angles in common at which f is above 0")]
    NoCommonAngles { sample: String },
}

impl Reproducibility {
    /// Of these fits of one sample's sessions, one each.
    ///
    /// # Errors
    /// Fewer than two, or nothing that all of them state.
    pub fn of(sample: &str, repeats: &[Repeat]) -> Result<Self, ReproducibilityError> {
        let sample = sample.to_owned();
        let (first, others) = match repeats {
            [first, others @ ..] if !others.is_empty() => (first, others),
            _ => {
                let count = repeats.len();
                return Err(ReproducibilityError::TooFew { sample, count });
            }
        };
        let row = |of_first: &BudgetRow| {
            let mut values = vec![Value::of(&first.budget, of_first)?];
            for repeat in others {
                let rows = &repeat.budget.row;
                let same = rows.iter().find(|row| angles(row) == angles(of_first))?;
                values.push(Value::of(&repeat.budget, same)?);
            }
            Some(compare(angles(of_first), &values))
        };
        let row: Vec<_> = first.budget.row.iter().filter_map(row).collect();
        if row.is_empty() {
            return Err(ReproducibilityError::NoCommonAngles { sample });
        }
        let names = |drawn_anew: bool| {
            let of = Source::ALL.into_iter();
            of.filter(|source| DRAWN_ANEW.contains(source) == drawn_anew)
                .map(|source| source.name().to_owned())
                .collect()
        };
        Ok(Self {
            sample,
            sessions: repeats.iter().map(|r| r.session.clone()).collect(),
            relative_std_of_std: relative_std_of_std(repeats.len()),
            drawn_anew: names(true),
            common: names(false),
            row,
        })
    }
}

fn angles(row: &BudgetRow) -> [f64; 2] {
    [row.theta_h_deg, row.theta_d_deg]
}

/// What one fit states at one pair of angles.
struct Value {
    value: f64,
    relative_variance: f64,
    drawn_anew: f64,
}

impl Value {
    /// `None` where f is not above 0.
    fn of(budget: &BudgetRecord, row: &BudgetRow) -> Option<Self> {
        let is_drawn_anew = |name: &String| DRAWN_ANEW.iter().any(|source| source.name() == name);
        let shares = budget.sources.iter().zip(&row.share);
        let share: f64 = shares
            .filter_map(|(name, share)| is_drawn_anew(name).then_some(share))
            .sum();
        let relative_variance = row.relative_std * row.relative_std;
        (row.value > 0.0 && row.value.is_finite()).then_some(Self {
            value: row.value,
            relative_variance,
            drawn_anew: share * relative_variance,
        })
    }
}

/// The equations of this module; at least two values.
fn compare([theta_h_deg, theta_d_deg]: [f64; 2], values: &[Value]) -> ReproducibilityRow {
    let count = values.len() as f64;
    let mean_of = |of: &dyn Fn(&Value) -> f64| values.iter().map(of).sum::<f64>() / count;
    let mean = mean_of(&|v| v.value);
    let squares: f64 = values.iter().map(|v| (v.value / mean - 1.0).powi(2)).sum();
    let variance = squares / (count - 1.0);
    let stated = mean_of(&|v| v.relative_variance);
    let drawn_anew = mean_of(&|v| v.drawn_anew);
    let between = (variance - drawn_anew).max(0.0);
    let combined = stated + between;
    ReproducibilityRow {
        theta_h_deg,
        theta_d_deg,
        mean,
        relative_std: variance.sqrt(),
        stated_relative_std: stated.sqrt(),
        drawn_anew_relative_std: drawn_anew.sqrt(),
        between_relative_std: between.sqrt(),
        combined_relative_std: combined.sqrt(),
        share: if combined > 0.0 {
            between / combined
        } else {
            0.0
        },
        chance: (drawn_anew > 0.0).then(|| chi2_tail(squares / drawn_anew, count - 1.0)),
    }
}

/// Relative standard deviation of the standard deviation of `count` ≥ 2 normally distributed
/// values, as in the GUM's table E.1: (1/c² − 1)^½ with
/// c = (2/(n − 1))^½ Γ(n/2) / Γ((n − 1)/2).
fn relative_std_of_std(count: usize) -> f64 {
    // Γ(n/2) / Γ((n − 1)/2), from n = 2 on.
    let mut ratio = std::f64::consts::PI.sqrt().recip();
    for n in 2..count {
        ratio = (n as f64 - 1.0) / 2.0 / ratio;
    }
    let c2 = 2.0 / (count as f64 - 1.0) * ratio * ratio;
    (1.0 / c2 - 1.0).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream, stream};

    /// Fits that state at one pair of angles these values, with this relative standard deviation
    /// and half of its variance from capture noise, half from the mesh.
    fn repeats(values: &[f64], relative_std: f64) -> Vec<Repeat> {
        let repeat = |(number, &value): (usize, &f64)| Repeat {
            session: format!("session-{number}"),
            budget: BudgetRecord {
                sources: vec!["capture noise".to_owned(), "mesh".to_owned()],
                row: vec![BudgetRow {
                    theta_h_deg: 5.0,
                    theta_d_deg: 10.0,
                    value,
                    relative_std,
                    share: vec![0.5, 0.5],
                }],
            },
        };
        values.iter().enumerate().map(repeat).collect()
    }

    #[test]
    fn components_are_those_computed_by_hand() {
        // Mean 2, deviations ±0.2 and 0: s = 0.2/2 = 10%. Of the 6% stated, half the variance is noise.
        let found = Reproducibility::of("cup", &repeats(&[1.8, 2.0, 2.2], 0.06)).unwrap();
        let [row] = found.row[..] else {
            panic!("{found:?}");
        };
        let near = |is: f64, should: f64| assert!((is - should).abs() < 1e-12, "{is} {should}");
        near(row.mean, 2.0);
        near(row.relative_std, 0.1);
        near(row.stated_relative_std, 0.06);
        near(row.drawn_anew_relative_std.powi(2), 0.0018);
        near(row.between_relative_std.powi(2), 0.0082);
        near(row.combined_relative_std.powi(2), 0.0118);
        near(row.share, 0.0082 / 0.0118);
        assert_eq!(found.sessions, ["session-0", "session-1", "session-2"]);
        assert!(found.common.contains(&"mesh".to_owned()));
        assert_eq!(
            found.drawn_anew,
            ["capture noise", "pose", "light directions"]
        );

        // Less spread than noise alone: nothing is between, and nothing is negative.
        let found = Reproducibility::of("cup", &repeats(&[1.99, 2.0, 2.01], 0.06)).unwrap();
        assert_eq!(
            (found.row[0].between_relative_std, found.row[0].share),
            (0.0, 0.0)
        );
        near(found.row[0].combined_relative_std, 0.06);
    }

    /// Table E.1 of JCGM 100:2008.
    #[test]
    fn a_standard_deviation_of_few_values_is_as_uncertain_as_the_gum_says() {
        for (count, percent) in [(2, 76.0), (3, 52.0), (4, 42.0), (5, 36.0), (10, 24.0)] {
            let found = 100.0 * relative_std_of_std(count);
            assert!((found - percent).abs() < 0.5, "{count}: {found}");
        }
        // Its limit for many values, E.4.3.
        assert!((relative_std_of_std(1000) * (2.0f64 * 999.0).sqrt() - 1.0).abs() < 1e-3);
    }

    /// `sets` sets of five simulated sessions: noise of 5% and this much between them.
    fn simulated(sets: u64, between: f64) -> impl Iterator<Item = ReproducibilityRow> {
        let noise = 0.05_f64;
        let stated = noise * 2.0_f64.sqrt();
        (0..sets).map(move |set| {
            let value = |session| {
                let mut numbers: Stream = stream(45, Purpose::Experiment, set, session, 0);
                3.0 * (1.0 + between * numbers.normal() + noise * numbers.normal())
            };
            let values: Vec<f64> = (0..5).map(value).collect();
            let found = Reproducibility::of("cup", &repeats(&values, stated)).unwrap();
            found.row[0]
        })
    }

    /// 4000 sets: s² of 4 degrees of freedom has a relative standard deviation of 0.7, their mean
    /// one of 0.011; the limit is four of those, and 1% for the mean that s is divided by.
    #[test]
    fn simulated_components_are_found_again() {
        let sets = 4000;
        let mean = |of: &dyn Fn(&ReproducibilityRow) -> f64, between| {
            simulated(sets, between).map(|row| of(&row)).sum::<f64>() / sets as f64
        };
        let s2 = mean(&|row| row.relative_std.powi(2), 0.1);
        let expected = 0.1_f64.powi(2) + 0.05_f64.powi(2);
        assert!((s2 / expected - 1.0).abs() < 0.055, "{s2} {expected}");
        // Far above the noise the floor at 0 is hardly met.
        let b2 = mean(&|row| row.between_relative_std.powi(2), 0.2);
        assert!((b2 / 0.04 - 1.0).abs() < 0.055, "{b2}");
    }

    /// Without any spread between the sessions, chance is below p in a part p of all sets: 4000
    /// sets, four binomial standard deviations and the approximation of χ².
    #[test]
    fn noise_alone_is_called_unlikely_as_often_as_it_is() {
        for p in [0.05, 0.5] {
            let rare = simulated(4000, 0.0).filter(|row| row.chance.unwrap() < p);
            let part = rare.count() as f64 / 4000.0;
            let spread = (p * (1.0 - p) / 4000.0).sqrt();
            assert!((part - p).abs() < 4.0 * spread + 0.005, "{p}: {part}");
        }
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let too_few = Reproducibility::of("cup", &repeats(&[1.0], 0.05));
        assert!(matches!(
            too_few,
            Err(ReproducibilityError::TooFew { count: 1, .. })
        ));
        let mut other = repeats(&[1.0, 1.1], 0.05);
        other[1].budget.row[0].theta_h_deg = 15.0;
        for repeats in [other, repeats(&[1.0, 0.0], 0.05)] {
            let nothing = Reproducibility::of("cup", &repeats);
            assert!(matches!(
                nothing,
                Err(ReproducibilityError::NoCommonAngles { .. })
            ));
        }
    }
}
