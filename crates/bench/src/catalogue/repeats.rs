//! The sessions of one sample whose fits can be compared with each other.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::sync::Arc;

use serde::Serialize;

use super::Catalogue;
use super::reproducibility::{Repeat, Reproducibility, ReproducibilityError};
use super::row::{self, EntryError, Row};
use crate::session::fit_record::{BudgetRecord, Verdict};

/// What a folder has of one sample's repeated measurements.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Repeats {
    /// Name of the sample.
    pub sample: String,
    /// The latest trusted fit of each session, oldest session first.
    pub repeats: Vec<Repeat>,
    /// Sessions without one.
    pub left_out: Vec<LeftOut>,
    /// In what the fits differ other than by chance, which is part of their spread.
    pub differences: Vec<String>,
}

/// A session that is not compared.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Its name.
    pub session: String,
    /// Why.
    pub why: String,
}

impl Repeats {
    /// How well the measurement is reproduced.
    ///
    /// # Errors
    /// As of [`Reproducibility::of`].
    pub fn reproducibility(&self) -> Result<Reproducibility, ReproducibilityError> {
        Reproducibility::of(&self.sample, &self.repeats)
    }
}

impl Catalogue {
    /// The repeats of this sample, or of each sample that has two sessions or more, by name.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn repeats(&self, sample: Option<&str>) -> io::Result<Vec<Repeats>> {
        let mut by_sample: BTreeMap<String, Vec<Arc<Row>>> = BTreeMap::new();
        for row in self.list("")?.into_iter().rev() {
            let is_wanted = |of: &&String| sample.is_none_or(|sample| sample == *of);
            if let Some(name) = row.sample.clone().as_ref().filter(is_wanted) {
                by_sample.entry(name.clone()).or_default().push(row);
            }
        }
        let repeated = by_sample.into_iter();
        Ok(repeated
            .filter(|(_, rows)| sample.is_some() || rows.len() > 1)
            .map(|(sample, rows)| self.repeats_of(sample, &rows))
            .collect())
    }

    fn repeats_of(&self, sample: String, rows: &[Arc<Row>]) -> Repeats {
        let mut found = Repeats {
            sample,
            ..Repeats::default()
        };
        let (mut dictionaries, mut lights) = (BTreeSet::new(), BTreeSet::new());
        for row in rows {
            match self.comparable(row) {
                Ok((dictionary, budget)) => {
                    found.repeats.push(Repeat {
                        session: row.name.clone(),
                        budget,
                    });
                    dictionaries.insert(dictionary);
                    lights.insert(row.lights_finished);
                }
                Err(why) => found.left_out.push(LeftOut {
                    session: row.name.clone(),
                    why,
                }),
            }
        }
        if dictionaries.len() > 1 {
            let names: Vec<_> = dictionaries.into_iter().collect();
            let names = names.join(", ");
            found.differences.push(format!("dictionaries: {names}"));
        }
        if lights.len() > 1 {
            let counts: Vec<_> = lights.iter().map(usize::to_string).collect();
            let counts = counts.join(", ");
            found
                .differences
                .push(format!("numbers of lights: {counts}"));
        }
        found
    }

    /// Dictionary and error budget of the latest fit that can be trusted, or why there is none.
    fn comparable(&self, row: &Row) -> Result<(String, BudgetRecord), String> {
        if row.suspect {
            return Err("the stage has lost steps".to_owned());
        }
        let is_trusted = |verdict| verdict != Verdict::NotToBeTrusted;
        let mut fits = row.fits.iter().rev();
        let Some(fit) = fits.find(|fit| fit.verdict.is_some_and(is_trusted)) else {
            let why = match row.fits.len() {
                0 => "it has no fit",
                _ => "none of its fits is to be trusted",
            };
            return Err(why.to_owned());
        };
        let read = || {
            let session = row::open(self.folder(), &row.name)?;
            row::read_fit(&session, fit.number)
        };
        let record = read().map_err(|error: EntryError| error.to_string())?;
        match record.budget {
            Some(budget) => Ok((record.dictionary, budget)),
            None => Err(format!("its fit {} has no error budget", fit.number)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::Advisor;
    use crate::session::example::fit as record;
    use crate::session::example::{add_fit, session};
    use crate::session::fit_record::{BudgetRow, FitRecord, Grade, Warning};

    /// A fit whose error budget has this value at one pair of angles.
    fn fit(value: f64, dictionary: &str) -> FitRecord {
        FitRecord {
            dictionary: dictionary.to_owned(),
            warnings: Vec::new(),
            budget: Some(BudgetRecord {
                sources: vec!["capture noise".to_owned()],
                row: vec![BudgetRow {
                    theta_h_deg: 0.0,
                    theta_d_deg: 10.0,
                    value,
                    relative_std: 0.01,
                    share: vec![1.0],
                }],
            }),
            ..record()
        }
    }

    #[test]
    fn the_latest_trusted_fit_of_each_session_is_compared() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let day = |day: u32| format!("2026-11-{day}T02:34:00Z");
        // Two fits of which the second is not to be trusted; one fit; none; one without budget.
        let first = session(folder, "cup", &day(21));
        add_fit(folder, &first, &fit(1.0, "rig65"));
        let mut bad = fit(9.0, "rig65");
        bad.warnings.push(Warning {
            what: "a second material".to_owned(),
            likely_cause: "dirt".to_owned(),
            grade: Grade::Distrust,
        });
        add_fit(folder, &first, &bad);
        let second = session(folder, "cup", &day(22));
        add_fit(folder, &second, &fit(1.2, "paper42"));
        let third = session(folder, "cup", &day(23));
        let fourth = session(folder, "cup", &day(24));
        let without = FitRecord {
            budget: None,
            ..fit(1.0, "rig65")
        };
        add_fit(folder, &fourth, &without);
        session(folder, "bowl", &day(25));

        let catalogue = Catalogue::new(folder, Advisor::silent());
        let found = catalogue.repeats(None).unwrap();
        let [cup] = found.as_slice() else {
            panic!("{found:?}");
        };
        let compared: Vec<_> = cup.repeats.iter().map(|r| r.session.clone()).collect();
        assert_eq!(compared, [first, second]);
        let left_out: Vec<_> = cup.left_out.iter().map(|one| one.session.clone()).collect();
        assert_eq!(left_out, [third, fourth]);
        assert_eq!(cup.differences, ["dictionaries: paper42, rig65"]);
        let found = cup.reproducibility().unwrap();
        assert!((found.row[0].mean - 1.1).abs() < 1e-9, "{found:?}");
        // A sample that is named has its answer even with one session.
        let bowl = &catalogue.repeats(Some("bowl")).unwrap()[0];
        assert_eq!(bowl.left_out[0].why, "it has no fit");
        assert!(bowl.reproducibility().is_err());
        assert!(catalogue.repeats(Some("pot")).unwrap().is_empty());
    }
}
