//! Everything that a page shows of one session.

use std::collections::BTreeMap;
use std::io::Read;

use serde::Serialize;

use super::pages::SessionPages;
use super::pictures::{self, Named};
use crate::beneath;
use crate::catalogue::row::{self, EntryError, FitRow, Row, entry_fault, read_fit};
use crate::fault::{Advisor, Fault};
use crate::session::fit_record::{self, FitRecord, Warning};
use crate::session::layout::REPORT_FILE;
use crate::session::validation::{self, VALIDATION_FILE, Validation};
use crate::session::{Event, Session, SessionState};

/// What the number of the fit stands behind in a report.
const REPORT_FIT: &str = "<meta name=\"rig-fit\" content=\"";
/// It stands within so many bytes.
const REPORT_HEAD_BYTES: u64 = 1024;

/// A session in full.
#[derive(Debug, Serialize)]
pub struct Detail {
    /// As in the list.
    #[serde(flatten)]
    pub row: Row<FitDetail>,
    /// The number of the fit that its report shows; `None` where that is not stated.
    pub report_fit: Option<String>,
    /// Pictures of what was captured.
    pub pictures: Vec<Named>,
    /// What was decided last, of a capture that chose its lights.
    pub decision: Option<String>,
    /// What is to be known of the capture.
    pub warnings: Vec<String>,
    /// Its latest validation, if it has one.
    pub validation: Option<ValidationDetail>,
}

/// A validation in full.
#[derive(Debug, Default, Serialize)]
pub struct ValidationDetail {
    /// Its number.
    pub name: String,
    /// What was fitted and what predicted, and the fit's verdict, in words.
    pub about: String,
    /// Headings of the table.
    pub headings: Vec<&'static str>,
    /// Its rows: one for each predicted light, then one for all.
    pub rows: Vec<Vec<String>>,
    /// A picture of each predicted light.
    pub pictures: Vec<Named>,
    /// Why it cannot be read.
    pub error: Option<Fault>,
}

/// A fit in full.
#[derive(Debug, Serialize)]
pub struct FitDetail {
    /// As in the list.
    #[serde(flatten)]
    pub row: FitRow,
    /// Reasons not to trust it, the gravest first.
    pub warnings: Vec<Warning>,
    /// What to know of it that is neither for nor against it.
    pub remarks: Vec<String>,
    /// How it was run, in words.
    pub settings: BTreeMap<&'static str, String>,
    /// Its pictures.
    pub pictures: Vec<Named>,
}

impl SessionPages {
    /// A session in full; one that cannot be read has its error and little else.
    ///
    /// # Errors
    /// There is no such folder, or the name leaves the catalogue's.
    pub fn detail(&self, name: &str) -> Result<Detail, EntryError> {
        let (folder, advisor) = (self.catalogue().folder(), self.catalogue().advisor());
        let session = match row::open(folder, name) {
            Ok(session) => session,
            Err(error @ EntryError::File(_)) => return Err(error),
            Err(error) => {
                return Ok(Detail {
                    row: Row::failed(name, entry_fault(&error, advisor)),
                    report_fit: None,
                    pictures: Vec::new(),
                    decision: None,
                    warnings: Vec::new(),
                    validation: None,
                });
            }
        };
        let fits = fit_record::numbers_in(&session);
        let fit = |number| match read_fit(&session, number) {
            Ok(record) => fit_detail(&session, number, &record),
            Err(error) => FitDetail {
                row: FitRow::failed(number, entry_fault(&error, advisor)),
                warnings: Vec::new(),
                remarks: Vec::new(),
                settings: BTreeMap::new(),
                pictures: Vec::new(),
            },
        };
        Ok(Detail {
            row: Row::of(&session, name, fits.into_iter().map(fit).collect()),
            report_fit: report_fit(&session),
            pictures: pictures::of_session(&session),
            decision: session
                .journal()
                .decisions()
                .last()
                .map(|one| one.to_string()),
            warnings: warnings(&session),
            validation: validation_detail(&session, advisor),
        })
    }
}

fn fit_detail(session: &Session, number: u32, record: &FitRecord) -> FitDetail {
    FitDetail {
        row: FitRow::of(number, record),
        warnings: record.warnings.clone(),
        remarks: record.remarks.clone(),
        settings: settings(record),
        pictures: pictures::of_fit(session, number),
    }
}

/// What the head of a session's report states.
fn report_fit(session: &Session) -> Option<String> {
    let file = beneath::open(session.root(), REPORT_FILE).ok()?;
    let mut head = Vec::new();
    file.take(REPORT_HEAD_BYTES).read_to_end(&mut head).ok()?;
    let head = String::from_utf8_lossy(&head);
    let (_, rest) = head.split_once(REPORT_FIT)?;
    let (number, _) = rest.split_once('"')?;
    number.parse::<u32>().ok().map(|number| number.to_string())
}

fn validation_detail(session: &Session, advisor: &Advisor) -> Option<ValidationDetail> {
    let number = validation::latest_in(session)?;
    let file = validation::inside(number, VALIDATION_FILE);
    let read = || -> Result<Validation, EntryError> {
        beneath::open(session.root(), &file)?;
        Ok(validation::read_in(session, number)?)
    };
    let name = number.to_string();
    Some(match read() {
        Ok(record) => {
            let (headings, rows) = record.headed_table();
            ValidationDetail {
                name,
                about: format!("{}. {}.", record.division(), record.verdict.sentence()),
                headings,
                rows,
                pictures: pictures::of_validation(session, number, &record),
                error: None,
            }
        }
        Err(error) => ValidationDetail {
            name,
            error: Some(entry_fault(&error, advisor)),
            ..ValidationDetail::default()
        },
    })
}

fn settings(record: &FitRecord) -> BTreeMap<&'static str, String> {
    let of = &record.settings;
    let yes_no = |is: bool| if is { "yes" } else { "no" }.to_owned();
    let entries = [
        ("Dictionary", Some(record.dictionary.clone())),
        ("Optimiser", Some(of.optimizer.clone())),
        ("Paths per cell", Some(of.samples_per_pixel.to_string())),
        (
            "Longest path (reflections)",
            Some(of.max_reflections.to_string()),
        ),
        ("Seed", Some(of.seed.to_string())),
        (
            "Nuisance parameters refined",
            Some(yes_no(record.bench.is_some())),
        ),
        ("End of the optimisation", Some(record.termination.clone())),
    ];
    let known = entries.into_iter().chain(of.asked.shown());
    known
        .filter_map(|(key, value)| Some((key, value?)))
        .collect()
}

/// What the journal says against a capture.
fn warnings(session: &Session) -> Vec<String> {
    let journal = session.journal();
    let known = journal.suspicion().into_iter().chain(journal.clock_step());
    let mut warnings: Vec<String> = known.collect();
    if session.state() == SessionState::Interrupted {
        let events = session.journal().records.iter().rev();
        let mut reasons = events.filter_map(|record| match &record.event {
            Event::Interrupted { reason } => Some(reason.as_str()),
            _ => None,
        });
        warnings.push(match reasons.next() {
            Some(reason) => format!("the capture was interrupted: {reason}"),
            None => "the capture has not ended".to_owned(),
        });
    }
    warnings
}
