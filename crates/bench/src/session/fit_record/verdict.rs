//! Whether a fit can be trusted: one verdict, the same at the terminal, in `fit.toml`, in
//! JSON and in the report.

use serde::{Deserialize, Serialize};

use super::FitRecord;

/// What a fit's reasons and residuals come to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The material explains the images within noise and model error.
    Explains,
    /// It does in the main; each reservation is named among the warnings.
    Reservations,
    /// Don't use the result; the reason is the first warning.
    NotToBeTrusted,
}

impl Verdict {
    /// In a word or two, for tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Explains => "explains",
            Self::Reservations => "reservations",
            Self::NotToBeTrusted => "not trusted",
        }
    }

    /// As records, tables and JSON name it.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::Explains => "explains",
            Verdict::Reservations => "reservations",
            Verdict::NotToBeTrusted => "not-to-be-trusted",
        }
    }

    /// As a sentence without its full stop.
    pub fn sentence(self) -> &'static str {
        match self {
            Verdict::Explains => "The fit explains the images",
            Verdict::Reservations => "The fit explains the images with reservations",
            Verdict::NotToBeTrusted => "The fit is not to be trusted",
        }
    }
}

/// How much a warning weighs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grade {
    /// The result is to be used with this in mind.
    #[default]
    Reservation,
    /// The result is not to be used.
    Distrust,
}

/// A reason not to trust a fit, or not in everything.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// The fact.
    pub what: String,
    /// Its most likely cause.
    pub likely_cause: String,
    /// What it means for the result. Fits of earlier versions state none: a reservation.
    #[serde(default)]
    pub grade: Grade,
}

/// Reduced χ² up to which a fit counts as explaining its images.
pub const EXPLAINED_CHI_SQUARE: f64 = crate::inverse::findings::EXPLAINED_MEAN_SQUARE;

/// Reduced χ² above which a fit is not to be trusted: residuals two and a half times what
/// noise and model error allow.
pub const UNEXPLAINED_CHI_SQUARE: f64 = 6.25;

impl FitRecord {
    /// Judges by the gravest warning and the worst reduced χ². A fit without χ² has
    /// reservations at least.
    pub fn verdict(&self) -> Verdict {
        let by_residuals = match self.worst_reduced_chi_square() {
            Some(worst) if worst <= EXPLAINED_CHI_SQUARE => Verdict::Explains,
            Some(worst) if worst > UNEXPLAINED_CHI_SQUARE => Verdict::NotToBeTrusted,
            _ => Verdict::Reservations,
        };
        let by_warnings = match self.warnings.iter().map(|warning| warning.grade).max() {
            None => Verdict::Explains,
            Some(Grade::Reservation) => Verdict::Reservations,
            Some(Grade::Distrust) => Verdict::NotToBeTrusted,
        };
        by_residuals.max(by_warnings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::example::fit as sample;

    #[test]
    fn the_gravest_reason_decides() {
        let cases = [
            (&[][..], Some(1.1), Verdict::Explains),
            (&[][..], Some(1.4), Verdict::Reservations),
            (&[][..], Some(6.3), Verdict::NotToBeTrusted),
            (&[][..], None, Verdict::Reservations),
            (&[Grade::Reservation], Some(0.1), Verdict::Reservations),
            (
                &[Grade::Reservation, Grade::Distrust],
                Some(0.1),
                Verdict::NotToBeTrusted,
            ),
        ];
        for (grades, chi2, verdict) in cases {
            assert_eq!(serde_json::to_value(verdict).unwrap(), verdict.name());
            let mut record = sample();
            record.reduced_chi_square = chi2.map(|chi2| [chi2, 0.5, 0.9]).into_iter().collect();
            let warning = |&grade: &Grade| Warning {
                what: "a fact".to_owned(),
                likely_cause: "a cause".to_owned(),
                grade,
            };
            record.warnings = grades.iter().map(warning).collect();
            assert_eq!(record.verdict(), verdict, "{grades:?}, {chi2:?}");
        }
    }
}
