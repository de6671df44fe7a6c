//! One table and one page of all jobs, from their records.

use std::path::PathBuf;

use super::record::{JobRecord, replace};
use super::row::{Found, Status, row};
use super::{Batch, BatchError, Job, page};
use crate::result_table::{Row, Table};
use crate::session::fit_record::Verdict;
use crate::shown::count;

/// What the records of a batch come to.
#[derive(Debug)]
pub struct Collected {
    /// One row per job, in their order.
    pub table: Table,
    /// The table's JSON, as written.
    pub json: serde_json::Value,
    /// Fits by their verdict, the best first; verdicts that no fit has are left out.
    pub verdicts: Vec<(Verdict, usize)>,
    /// Jobs that failed.
    pub failed: usize,
    /// Jobs that are yet to be done.
    pub open: usize,
    /// Files written, the table first, the page last.
    pub files: Vec<PathBuf>,
}

impl Collected {
    /// How many jobs came to what, a line each.
    pub fn lines(&self) -> Vec<String> {
        let of_fits = self.verdicts.iter().map(|&(verdict, fits)| {
            let (explain, is) = match fits {
                1 => ("explains", "is"),
                _ => ("explain", "are"),
            };
            let come_to = match verdict {
                Verdict::Explains => format!("{explain} the images"),
                Verdict::Reservations => {
                    format!("{explain} the images with reservations: look at the reasons")
                }
                Verdict::NotToBeTrusted => format!("{is} not to be trusted"),
            };
            format!("{} {come_to}", count(fits, "fit"))
        });
        let others = [(self.failed, "failed"), (self.open, "to be done")];
        let others = others.into_iter().filter(|(jobs, _)| *jobs > 0);
        let others = others.map(|(jobs, what)| format!("{} {what}", count(jobs, "job")));
        of_fits.chain(others).collect()
    }
}

impl Batch {
    /// Writes `table.csv`, `table.json`, `times.csv` and `index.html` of the jobs as they
    /// stand. The tables depend on the jobs alone: not on who did them, when, in which order and
    /// how often.
    ///
    /// # Errors
    /// A record that is damaged or was made with other options, or a file that cannot be written.
    pub fn collect(&self) -> Result<Collected, BatchError> {
        let mut rows = Vec::new();
        let mut times = Vec::new();
        let (mut failed, mut open) = (0, 0);
        for job in &self.jobs {
            let record = self.record(job, &self.key(job)?)?;
            match &record {
                Some(record) if record.failure.is_none() => {}
                Some(_) => failed += 1,
                None => open += 1,
            }
            rows.push(match &record {
                Some(record) => record.row.clone(),
                // Without a fit, nothing of the row can fail.
                None => row(job, Status::Open, &Found::default()).unwrap_or_default(),
            });
            times.extend(record.map(|record| times_row(job, &record)));
        }
        let verdicts = count_verdicts(&rows);
        let table = Table { rows };
        let json = serde_json::json!({
            "rig": env!("CARGO_PKG_VERSION"),
            "kernel": self.kernel.to_string(),
            "jobs": self.jobs.len(),
            "failed": failed,
            "open": open,
            "columns": table.columns(),
            "rows": table.rows,
        });
        let times = Table { rows: times };
        let page = page::render(self, &table)?;
        let mut files = Vec::new();
        for (name, text) in [
            ("table.csv", table.to_csv()),
            ("table.json", format!("{json:#}\n")),
            ("times.csv", times.to_csv()),
            ("index.html", page),
        ] {
            let path = self.folder.join(name);
            replace(&path, text.as_bytes())?;
            files.push(path);
        }
        Ok(Collected {
            table,
            json,
            verdicts,
            failed,
            open,
            files,
        })
    }
}

fn count_verdicts(rows: &[Row]) -> Vec<(Verdict, usize)> {
    let count = |verdict: Verdict| {
        let with = rows
            .iter()
            .filter(|row| row.text("verdict") == verdict.name());
        (verdict, with.count())
    };
    let all = [
        Verdict::Explains,
        Verdict::Reservations,
        Verdict::NotToBeTrusted,
    ];
    all.map(count)
        .into_iter()
        .filter(|(_, fits)| *fits > 0)
        .collect()
}

/// When and where a job was done.
fn times_row(job: &Job, record: &JobRecord) -> Row {
    Row::new()
        .with("job", job.number)
        .with("session", job.session_name())
        .with("fit", record.fit.as_deref().unwrap_or_default())
        .with("seconds", (record.seconds * 1e3).round() / 1e3)
        .with("expected_cpu_s", job.expected_cpu_s)
        .with("threads", record.threads)
        .with("host", record.host.as_str())
        .with("began_utc", record.began_utc.as_str())
}
