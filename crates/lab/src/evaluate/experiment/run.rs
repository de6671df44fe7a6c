//! Runs an experiment's cases and writes what comes out.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::journal::Journal;
use super::{EvaluateError, Experiment, Row, Table};
use crate::cluster::Shard;
use crate::evaluate::lab::Lab;
use crate::whole_file;

/// What to run, and where the results go.
pub struct Run<'a> {
    /// The experiment.
    pub experiment: &'static Experiment,
    /// Its settings and materials.
    pub lab: &'a Lab,
    /// Folder for journal, tables and figures; made if it is not there.
    pub folder: &'a Path,
    /// Forget the cases that the folder holds.
    pub restart: bool,
    /// Only cases whose key holds this; empty for all. The folder keeps the others of earlier runs.
    pub only: &'a str,
    /// Only every n-th of those, kept in a journal of its own; tables and figures are left to a
    /// run without, which finds what all shards have done.
    pub shard: Option<Shard>,
}

/// How far a run is.
#[derive(Clone, Debug)]
pub struct Done<'a> {
    /// Cases finished, in this run or before.
    pub finished: usize,
    /// All cases.
    pub total: usize,
    /// The one that has just finished; `None` at the start.
    pub case: Option<&'a str>,
}

/// What a run leaves.
#[derive(Debug)]
pub struct Outcome {
    /// All rows; none of a shard.
    pub table: Table,
    /// The table's JSON, as written; null of a shard.
    pub json: serde_json::Value,
    /// Files written, tables first.
    pub files: Vec<PathBuf>,
    /// Cases that earlier runs had finished, of those wanted.
    pub resumed: usize,
    /// Cases that the folder lacks because they were not wanted; figures are drawn when there
    /// are none.
    pub left: usize,
}

/// Does all cases that the folder does not hold yet, on as many threads as the pool
/// has, then writes `table.csv` and `table.json` of all that the folder holds, and the figures
/// where that is every case. `progress` is called for every finished case. However the process
/// ends, it leaves a folder that a further run completes.
///
/// # Errors
/// The first case that fails ends the run; those in progress are kept. No case's key holds
/// `only`.
pub fn run(run: &Run<'_>, progress: &(dyn Fn(&Done) + Sync)) -> Result<Outcome, EvaluateError> {
    let (experiment, lab) = (run.experiment, run.lab);
    // The wanted cases that the folder doesn't have yet.
    let cases = (experiment.cases)(lab)?;
    let mut keys = HashSet::new();
    if let Some(twice) = cases.iter().find(|case| !keys.insert(&case.key)) {
        return Err(EvaluateError::Fact(format!(
            "experiment {} has two cases \"{}\"",
            experiment.name, twice.key
        )));
    }
    let wanted: Vec<_> = cases.iter().filter(|c| c.key.contains(run.only)).collect();
    if let ([], Some(first)) = (&wanted[..], cases.first()) {
        return Err(EvaluateError::NoSuchCase {
            only: run.only.to_owned(),
            cases: cases.len(),
            first: first.key.clone(),
        });
    }
    let journal = Journal::open(run.folder, &lab.settings, run.restart, run.shard)?;
    let is_own = |number: usize| run.shard.is_none_or(|shard| shard.has(number));
    let numbered = (1..).zip(wanted);
    let wanted: Vec<_> = numbered
        .filter(|&(number, _)| is_own(number))
        .map(|(_, case)| case)
        .collect();
    let total = wanted.len();
    let open: Vec<_> = wanted
        .into_iter()
        .filter(|case| journal.rows(&case.key).is_none())
        .collect();
    let resumed = total - open.len();
    progress(&Done {
        finished: resumed,
        total,
        case: None,
    });

    // Their rows.
    let journal = Mutex::new(journal);
    let failure = Mutex::new(None);
    let (next, finished) = (AtomicUsize::new(0), AtomicUsize::new(resumed));
    let failed = AtomicBool::new(false);
    // Threads of their own take cases, so that never more are in progress than there
    // are cores; what is parallel inside a case runs on the common pool.
    let worker = || {
        while !failed.load(Ordering::Relaxed) {
            let Some(case) = open.get(next.fetch_add(1, Ordering::Relaxed)) else {
                break;
            };
            let kept = case.run(lab).and_then(|rows| {
                let mut journal = journal.lock().unwrap_or_else(|e| e.into_inner());
                journal.finish(&case.key, rows)
            });
            match kept {
                Ok(()) => progress(&Done {
                    finished: finished.fetch_add(1, Ordering::Relaxed) + 1,
                    total,
                    case: Some(&case.key),
                }),
                Err(error) => {
                    failed.store(true, Ordering::Relaxed);
                    let mut failure = failure.lock().unwrap_or_else(|e| e.into_inner());
                    failure.get_or_insert(EvaluateError::Case {
                        key: case.key.clone(),
                        source: Box::new(error),
                    });
                }
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..rayon::current_num_threads().min(open.len()) {
            scope.spawn(worker);
        }
    });
    if let Some(error) = failure.into_inner().unwrap_or_else(|e| e.into_inner()) {
        return Err(error);
    }

    // Table and figures of all that the folder has.
    let journal = journal.into_inner().unwrap_or_else(|e| e.into_inner());
    let kept: Vec<&Vec<Row>> = cases
        .iter()
        .filter_map(|case| journal.rows(&case.key))
        .collect();
    let left = cases.len() - kept.len();
    if run.shard.is_some() {
        return Ok(Outcome {
            table: Table::default(),
            json: serde_json::Value::Null,
            files: Vec::new(),
            resumed,
            left,
        });
    }
    let table = Table {
        rows: kept.into_iter().flatten().cloned().collect(),
    };
    let json = serde_json::json!({
        "experiment": experiment.name,
        "shows": experiment.shows,
        "settings": lab.settings,
        "open_cases": left,
        "columns": table.columns(),
        "rows": table.rows,
    });
    let mut files = Vec::new();
    let mut keep = |name: String, bytes: &[u8]| {
        let path = run.folder.join(name);
        whole_file::replace(&path, |out| out.write_all(bytes)).map_err(EvaluateError::io(&path))?;
        files.push(path);
        Ok::<_, EvaluateError>(())
    };
    keep("table.csv".into(), table.to_csv().as_bytes())?;
    keep("table.json".into(), format!("{json:#}\n").as_bytes())?;
    if left == 0 {
        for figure in (experiment.figures)(lab, &table)? {
            keep(format!("{}.svg", figure.name), figure.svg()?.as_bytes())?;
            keep(format!("{}.png", figure.name), &figure.png()?)?;
        }
    }
    Ok(Outcome {
        table,
        json,
        files,
        resumed,
        left,
    })
}
