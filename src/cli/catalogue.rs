//! `rig catalogue`: the sessions of a folder, and what repeats of one sample say.

use std::path::PathBuf;

use serde::Serialize;

use super::context::Context;
use super::error::{CliError, HintExt};
use super::hints;
use super::output::{write_bytes, write_json};
use super::table::{Table, percent, size};
use crate::catalogue::repeats::{LeftOut, Repeats};
use crate::catalogue::reproducibility::{Reproducibility, ReproducibilityError};
use crate::catalogue::{Catalogue, FitRow, Row};
use crate::fault::Advisor;
use crate::out;
use crate::result_table;
use crate::session::fit_record::Verdict;
use crate::session::layout::SESSIONS_FOLDER;
use crate::shown::{LINE, shortened};

/// Lists the sessions of a folder with their verdicts, or compares repeats of one sample
#[derive(clap::Args, Debug)]
pub struct CatalogueArgs {
    /// The folder of the sessions
    #[arg(value_name = "DIR", default_value = SESSIONS_FOLDER)]
    folder: PathBuf,
    /// Only sessions with all these words in their name, sample, material or comment
    #[arg(
        long,
        value_name = "WORDS",
        default_value = "",
        hide_default_value = true
    )]
    search: String,
    /// How well the measurement of a sample is reproduced: its spread between the sessions of
    /// that sample (all samples with two or more sessions, if none is named)
    #[arg(long, value_name = "SAMPLE", num_args = 0..=1, conflicts_with = "search")]
    repeats: Option<Option<String>>,
    /// The list as JSON
    #[arg(long)]
    json: bool,
    /// The list as CSV, for spreadsheets: a row for each session with its latest fit
    #[arg(long, conflicts_with_all = ["json", "repeats"])]
    csv: bool,
}

/// `rig catalogue`.
pub fn run(args: &CatalogueArgs, context: &Context) -> Result<(), CliError> {
    let folder = args.folder.display();
    std::fs::metadata(&args.folder)
        .map_err(|error| CliError::new(format!("{folder}: {error}")))
        .hint("name the folder that holds the sessions; captures go to ./sessions by default")?;
    let catalogue = Catalogue::new(&args.folder, Advisor::new(hints::for_error));
    match &args.repeats {
        Some(sample) => compare(args, &catalogue, sample.as_deref(), context),
        None => list(args, &catalogue, context),
    }
}

fn list(args: &CatalogueArgs, catalogue: &Catalogue, context: &Context) -> Result<(), CliError> {
    let rows = catalogue.list(&args.search)?;
    if args.json {
        let rows: Vec<_> = rows.iter().map(|row| &**row).collect();
        return write_json(&rows);
    }
    if args.csv {
        let rows = rows
            .iter()
            .map(|row| result_table::of_session(row))
            .collect();
        return write_bytes(result_table::Table { rows }.to_csv().as_bytes());
    }
    if rows.is_empty() {
        let found = match args.search.trim() {
            "" => "no sessions".to_owned(),
            words => format!("no session has {words:?} in name, sample, material or comment"),
        };
        context.note(format!("{}: {found}", args.folder.display()));
        return Ok(());
    }
    let headings = [
        "session", "sample", "material", "truth", "began", " lights", "verdict", " χ²", " error",
        " size", "marks",
    ];
    let mut table = Table::new(&headings);
    let (readable, unreadable): (Vec<_>, Vec<_>) = rows.iter().partition(|row| row.error.is_none());
    readable.iter().for_each(|row| table.row(cells(row)));
    if !readable.is_empty() {
        table.print()?;
    }
    for row in unreadable {
        let fault = row.error.as_ref().map_or("", |fault| fault.error.as_str());
        out!("{}  cannot be read: {}", row.name, shortened(fault, LINE))?;
    }
    Ok(())
}

/// A session's line; the figures are those of its latest fit.
fn cells(row: &Row) -> [String; 11] {
    let fit = row.latest();
    let mut marks = Vec::new();
    for (is, mark) in [
        (row.suspect, "suspect"),
        (row.simulated, "simulated"),
        (!row.complete, "interrupted"),
    ] {
        if is {
            marks.push(mark);
        }
    }
    let lights = match row.lights_finished == row.lights {
        true => row.lights.to_string(),
        false => format!("{}/{}", row.lights_finished, row.lights),
    };
    [
        row.name.clone(),
        row.sample.clone().unwrap_or_default(),
        row.material.clone().unwrap_or_default(),
        row.true_material.clone().unwrap_or_default(),
        row.began.as_deref().map(minute).unwrap_or_default(),
        lights,
        verdict(fit).to_owned(),
        fit.and_then(|fit| fit.chi2)
            .map_or_else(String::new, |chi2| format!("{chi2:.2}")),
        fit.and_then(|fit| fit.environment_error)
            .map_or_else(String::new, percent),
        size(row.bytes),
        marks.join(", "),
    ]
}

fn verdict(fit: Option<&FitRow>) -> &'static str {
    match fit {
        None => "no fit",
        Some(FitRow { error: Some(_), .. }) => "unreadable",
        Some(fit) => fit.verdict.map_or("", Verdict::word),
    }
}

/// `2026-11-21T02:34:00Z` as `2026-11-21 02:34`.
fn minute(time: &str) -> String {
    time.get(..16).unwrap_or(time).replace('T', " ")
}

/// What `--repeats --json` prints of a sample.
#[derive(Serialize)]
struct Compared<'a> {
    sample: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    reproducibility: Option<&'a Reproducibility>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
    left_out: &'a [LeftOut],
    differences: &'a [String],
}

fn compare(
    args: &CatalogueArgs,
    catalogue: &Catalogue,
    sample: Option<&str>,
    context: &Context,
) -> Result<(), CliError> {
    let found = catalogue.repeats(sample)?;
    if let (Some(sample), []) = (sample, found.as_slice()) {
        let folder = args.folder.display();
        return Err(
            CliError::new(format!("{folder} has no session of a sample {sample:?}"))
                .hint("`rig catalogue` lists the samples"),
        );
    }
    let results: Vec<_> = found.iter().map(Repeats::reproducibility).collect();
    let all = found.iter().zip(&results);
    if args.json {
        let compared = all.clone().map(|(repeats, result)| Compared {
            sample: &repeats.sample,
            reproducibility: result.as_ref().ok(),
            error: result.as_ref().err().map(ToString::to_string),
            left_out: &repeats.left_out,
            differences: &repeats.differences,
        });
        write_json(&compared.collect::<Vec<_>>())?;
    } else if found.is_empty() {
        let folder = args.folder.display();
        context.note(format!("{folder}: no sample has two sessions"));
    } else {
        for (number, (repeats, result)) in all.enumerate() {
            if number > 0 {
                out!("")?;
            }
            print(repeats, result)?;
        }
    }
    // Of a sample that was asked for, nothing is a failure.
    match (sample, results.into_iter().next()) {
        (Some(_), Some(Err(error))) => Err(error.into()),
        _ => Ok(()),
    }
}

fn print(
    repeats: &Repeats,
    result: &Result<Reproducibility, ReproducibilityError>,
) -> Result<(), CliError> {
    // The sample and its sessions.
    let sample = &repeats.sample;
    match result {
        Ok(found) => {
            let (count, uncertain) = (found.sessions.len(), percent(found.relative_std_of_std));
            out!(
                "{sample}: {count} sessions; a spread of so few is itself uncertain by {uncertain}"
            )?;
        }
        Err(error) => out!("{error}")?,
    }
    for LeftOut { session, why } in &repeats.left_out {
        out!("  without {session}: {why}")?;
    }
    for difference in &repeats.differences {
        out!("  the fits differ in their {difference}; that is part of the spread")?;
    }
    let Ok(found) = result else {
        return Ok(());
    };

    // The table.
    let headings = [
        " θh",
        " θd",
        " mean f",
        " spread",
        " stated",
        " independent",
        " between",
        " combined",
        " share",
        " chance",
    ];
    let mut table = Table::new(&headings);
    for row in &found.row {
        table.row([
            format!("{}°", row.theta_h_deg),
            format!("{}°", row.theta_d_deg),
            format!("{:.4}/sr", row.mean),
            percent(row.relative_std),
            percent(row.stated_relative_std),
            percent(row.drawn_anew_relative_std),
            percent(row.between_relative_std),
            percent(row.combined_relative_std),
            percent(row.share),
            row.chance.map_or_else(String::new, percent),
        ]);
    }
    table.print()?;

    // What it means.
    out!("spread: standard deviation between the sessions; stated: that of the fits")?;
    out!(
        "independent: the part of stated that differs from session to session ({}); the rest is common to all",
        found.drawn_anew.join(", ")
    )?;
    out!(
        "between: spread beyond it; combined: stated and between; share: of between in its variance"
    )?;
    out!("chance: of such a spread if nothing else varied")?;
    out!("no repeat shows: {}", found.common.join(", "))
}
