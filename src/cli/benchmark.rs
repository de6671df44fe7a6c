//! `rig bench`: the inner loops on this machine.

#[cfg(feature = "experiments")]
use std::path::{Path, PathBuf};

use serde_json::json;

use super::{CliError, Context, output};
use crate::benchmark::{BenchmarkError, BenchmarkRequest, benchmark};
#[cfg(feature = "experiments")]
use crate::evaluate::growth;
use crate::out;

/// Measures ray queries, tracing, evaluating and a whole fit.
#[derive(clap::Args, Debug)]
pub struct BenchArgs {
    /// The results as JSON
    #[arg(long)]
    json: bool,
    /// Threads, 1 to 256; several numbers take turns and show how the work scales
    #[arg(long, value_name = "N,…", default_value = "1", value_delimiter = ',', value_parser = clap::value_parser!(u64).range(1..=256))]
    threads: Vec<u64>,
    /// Repetitions of each case, 1 to 1000 (short cases take ten times as many)
    #[arg(long, value_name = "N", default_value_t = BenchmarkRequest::REPEAT, value_parser = clap::value_parser!(u64).range(1..=1000))]
    repeat: u64,
    /// Only cases whose name contains this
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Instead: what `rig fit` costs by the size of its images (64 × 48 to 20 MP), cells, paths,
    /// lights and threads; a table and a plot go into this folder
    #[cfg(feature = "experiments")]
    #[arg(long, value_name = "DIR", conflicts_with_all = ["only", "repeat", "threads"])]
    growth: Option<PathBuf>,
}

/// `rig bench`.
pub fn run(args: &BenchArgs, context: &Context) -> Result<(), CliError> {
    #[cfg(feature = "experiments")]
    if let Some(folder) = &args.growth {
        return run_growth(folder, args.json, context);
    }
    let request = BenchmarkRequest {
        threads: args
            .threads
            .iter()
            .map(|&threads| threads as usize)
            .collect(),
        repeat: args.repeat,
        only: args.only.clone(),
    };
    let rows = benchmark(&request, &|case| context.note(case)).map_err(|error| {
        let is_none = matches!(error, BenchmarkError::NoCase { .. });
        let error = CliError::from(error);
        match is_none {
            true => error.hint("`rig bench` without --only runs and names them all"),
            false => error,
        }
    })?;
    if args.json {
        return output::write_json(&json!({ "cases": rows }));
    }
    out!(
        "{:16} {:>7} {:>10} {:>10} {:>10} {:>10} {:>8}",
        "case",
        "threads",
        "CPU ms",
        "least",
        "wall ms",
        "least",
        "speed-up"
    )?;
    for row in rows {
        out!(
            "{:16} {:7} {:10.2} {:10.2} {:10.2} {:10.2} {:8.2}",
            row.name,
            row.threads,
            row.cpu_ms_median,
            row.cpu_ms_min,
            row.wall_ms_median,
            row.wall_ms_min,
            row.speedup
        )?;
    }
    Ok(())
}

#[cfg(feature = "experiments")]
fn run_growth(folder: &Path, json: bool, context: &Context) -> Result<(), CliError> {
    let found = growth::run(folder, &|case| context.note(case))?;
    if json {
        return output::write_json(&json!({ "fits": found.costs }));
    }
    out!(
        "{:8} {:>12} {:>6} {:>6} {:>6} {:>7} {:>8} {:>8} {:>8}",
        "varied",
        "pixels",
        "lights",
        "cells",
        "paths",
        "threads",
        "CPU s",
        "wall s",
        "MB"
    )?;
    for cost in &found.costs {
        let case = &cost.case;
        let [width, height] = case.resolution_px;
        out!(
            "{:8} {:>12} {:6} {:6} {:6} {:7} {:8.1} {:8.1} {:8.0}",
            case.varied,
            format!("{width} × {height}"),
            case.lights,
            case.cells,
            case.paths,
            case.threads,
            cost.cpu_s,
            cost.wall_s,
            cost.memory_mb
        )?;
    }
    out!("{}", found.figure.display())
}
