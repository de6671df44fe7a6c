//! `rig batch`: many sessions, on one machine or many.

use std::path::{Path, PathBuf};

use clap::error::ErrorKind;
use clap::{Args, Command, FromArgMatches};

use super::interrupt::{end_on_signal, listen};
use super::slurm_args::SlurmArgs;
use super::{CliError, Context, output, usage_fact};
use crate::batch::{
    ArrayRequest, Batch, Collected, JobEnd, NewBatch, RunSummary, Selection, passed_over,
};
use crate::cluster::Shard;
use crate::session::fit_record::Verdict;
use crate::shown::count;
use crate::workflow::FitRequest;

/// Fits and reports many sessions: one table, one page.
#[derive(Args, Debug)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct BatchArgs {
    #[command(subcommand)]
    part: Option<Part>,
    #[command(flatten)]
    new: Option<NewArgs>,
    #[command(flatten)]
    parallel: ParallelArgs,
    #[command(flatten)]
    shown: ShownArgs,
}

/// A part of a batch, for those who divide it among processes or machines.
#[derive(clap::Subcommand, Debug)]
enum Part {
    /// Checks the sessions and writes the jobs; nothing is fitted yet
    New(NewArgs),
    /// Does jobs that are open: all, one, or every n-th
    Run(RunArgs),
    /// Joins what is done into table and page
    Collect(CollectArgs),
    /// Prints a script that submits the batch as a job array of Slurm
    Slurm(BatchSlurmArgs),
}

#[derive(Args, Debug)]
struct NewArgs {
    /// Folders of sessions
    #[arg(value_name = "SESSIONS", required_unless_present = "list")]
    sessions: Vec<PathBuf>,
    /// TOML with further sessions: `[[job]]` with `session` and, where it differs from `fit` of all, `fit`
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    /// Folder for jobs, records, table and page; the same command completes what it holds
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Options of the fits, as of `rig fit`, such as "--dictionary rig26 --seed 3"
    #[arg(
        long,
        value_name = "OPTIONS",
        default_value = "",
        hide_default_value = true,
        allow_hyphen_values = true
    )]
    fit: String,
}

#[derive(Args, Debug)]
struct ParallelArgs {
    /// So many fits at a time, which share the processors; each needs its memory
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    parallel: u16,
}

#[derive(Args, Debug)]
struct ShownArgs {
    /// The table as JSON on stdout
    #[arg(long)]
    json: bool,
    /// End with exit code 1 if a fit has this verdict or a worse one, for scripts
    #[arg(long, value_name = "VERDICT", value_enum)]
    fail_on: Option<FailOn>,
}

/// Verdicts of fits that are not the best.
#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum FailOn {
    Reservations,
    #[value(alias = "untrusted")]
    NotToBeTrusted,
}

impl From<FailOn> for Verdict {
    fn from(fail_on: FailOn) -> Self {
        match fail_on {
            FailOn::Reservations => Self::Reservations,
            FailOn::NotToBeTrusted => Self::NotToBeTrusted,
        }
    }
}

#[derive(Args, Debug)]
struct RunArgs {
    /// The batch's folder, or its jobs.toml
    #[arg(value_name = "BATCH")]
    batch: PathBuf,
    /// Only this job, counted from 1
    #[arg(long, value_name = "I")]
    index: Option<usize>,
    /// Only every n-th job, such as 3/8: the third, the eleventh, …
    #[arg(long, value_name = "I/N", conflicts_with = "index")]
    shard: Option<Shard>,
    #[command(flatten)]
    parallel: ParallelArgs,
}

#[derive(Args, Debug)]
struct CollectArgs {
    /// The batch's folder, or its jobs.toml
    #[arg(value_name = "BATCH")]
    batch: PathBuf,
    #[command(flatten)]
    shown: ShownArgs,
}

#[derive(Args, Debug)]
struct BatchSlurmArgs {
    /// The batch's folder, or its jobs.toml
    #[arg(value_name = "BATCH")]
    batch: PathBuf,
    /// Number of tasks, 1 to 1000 (default: tasks of about ten minutes)
    #[arg(long, value_name = "N")]
    tasks: Option<usize>,
    #[command(flatten)]
    slurm: SlurmArgs,
}

/// `rig batch`.
pub fn run(args: &BatchArgs, context: &Context) -> Result<(), CliError> {
    match (&args.part, &args.new) {
        (Some(Part::New(new)), _) => {
            let batch = make(new, context)?;
            context.note(count(batch.jobs().len(), "job"));
            output::write_path(batch.folder())
        }
        (Some(Part::Run(args)), _) => {
            let batch = Batch::open(&args.batch, &parse_options)?;
            run_part(&batch, args, context)
        }
        (Some(Part::Collect(args)), _) => {
            let batch = Batch::open(&args.batch, &parse_options)?;
            show(&batch, &batch.collect()?, &args.shown, context)
        }
        (Some(Part::Slurm(args)), _) => {
            let batch = Batch::open(&args.batch, &parse_options)?;
            let request = ArrayRequest {
                tasks: args.tasks,
                cpus: args.slurm.cpus(),
                memory_mib: args.slurm.memory_mib(),
                minutes: args.slurm.minutes(),
            };
            let program = super::slurm_args::program()?;
            output::write_bytes(batch.job_array(&request, &program)?.as_bytes())
        }
        (None, Some(new)) => {
            let batch = make(new, context)?;
            do_jobs(&batch, Selection::All, args.parallel.parallel, context)?;
            show(&batch, &batch.collect()?, &args.shown, context)
        }
        (None, None) => Err(CliError::new(
            "neither sessions nor a part of a batch are named",
        )),
    }
}

fn make(args: &NewArgs, context: &Context) -> Result<Batch, CliError> {
    for path in &args.sessions {
        if let Some(what) = passed_over(path) {
            context.note(format!("{}: passed over ({what})", path.display()));
        }
    }
    let new = NewBatch {
        sessions: &args.sessions,
        options: &args.fit,
        list: args.list.as_deref(),
    };
    Ok(Batch::make(&args.out, &new, &parse_options)?)
}

/// The options of a fit by the very parser of `rig fit`.
fn parse_options(words: &[String]) -> Result<FitRequest, String> {
    let command = FitRequest::augment_args(Command::new("fit").no_binary_name(true))
        .disable_help_flag(true)
        .color(clap::ColorChoice::Never);
    let fact = |error: clap::Error| match error.kind() {
        ErrorKind::UnknownArgument => {
            let word = error.get(clap::error::ContextKind::InvalidArg);
            let word = word.map_or(String::new(), |word| format!(" '{word}'"));
            format!("`rig fit` has no option{word} that a batch could give")
        }
        _ => usage_fact(&error.render().to_string()),
    };
    let matches = command.try_get_matches_from(words).map_err(fact)?;
    FitRequest::from_arg_matches(&matches).map_err(fact)
}

/// Does what is open of a selection, with a line for each job.
fn do_jobs(
    batch: &Batch,
    selection: Selection,
    parallel: u16,
    context: &Context,
) -> Result<RunSummary, CliError> {
    let shown = batch.folder().display().to_string();
    end_on_signal(context, &listen()?, move |signal| {
        CliError::interrupted(signal, format!("stopped; {shown} keeps what is finished"))
            .hint("the same command completes it")
    })?;
    let bar = context.bar(0, "sessions");
    let summary = batch.run(selection, usize::from(parallel), &|job, end| {
        let text = match end {
            JobEnd::Before => return bar.inc(1),
            JobEnd::Done => "done".to_owned(),
            JobEnd::Failed(reason) => format!("failed: {reason}"),
            JobEnd::Busy => "another process is at work on its session".to_owned(),
        };
        bar.inc(1);
        bar.suspend(|| {
            context.note(format!(
                "job {}, {}: {text}",
                job.number,
                job.session_name()
            ));
        });
    });
    bar.finish_and_clear();
    let summary = summary?;
    if summary.before > 0 {
        context.note(format!("{} done before", count(summary.before, "job")));
    }
    Ok(summary)
}

/// Does some jobs; table and page are left to `collect`.
fn run_part(batch: &Batch, args: &RunArgs, context: &Context) -> Result<(), CliError> {
    let selection = match (args.index, args.shard) {
        (Some(index), _) => Selection::One(index),
        (None, Some(shard)) => Selection::Shard(shard),
        (None, None) => Selection::All,
    };
    let summary = do_jobs(batch, selection, args.parallel.parallel, context)?;
    match (&summary.failed[..], &summary.busy[..]) {
        ([], []) => output::write_path(batch.folder()),
        ([(number, reason)], []) if summary.wanted == 1 => {
            Err(CliError::new(format!("job {number} failed: {reason}")).hint(AFTER_FAILURE))
        }
        (failed, []) => {
            let fact = format!(
                "{} of {} failed",
                failed.len(),
                count(summary.wanted, "job")
            );
            Err(CliError::new(fact).hint(AFTER_FAILURE))
        }
        (_, busy) => Err(busy_error(busy)),
    }
}

const AFTER_FAILURE: &str =
    "`rig batch collect` puts the reasons into the table; the same command tries those jobs again";

fn busy_error(busy: &[usize]) -> CliError {
    let numbers: Vec<String> = busy.iter().map(usize::to_string).collect();
    let fact = format!(
        "another process is at work on the session of job {}",
        numbers.join(", ")
    );
    CliError::new(fact).hint(
        "this batch or another one is being run elsewhere: wait for it, then the same command completes this one",
    )
}

/// Shows what was collected; jobs without a result are an error.
fn show(
    batch: &Batch,
    collected: &Collected,
    args: &ShownArgs,
    context: &Context,
) -> Result<(), CliError> {
    for file in &collected.files {
        context.note(file.display());
    }
    context.note_lines(collected.lines());
    if args.json {
        output::write_json(&collected.json)?;
    } else {
        output::write_path(batch.folder())?;
    }
    let jobs = count(batch.jobs().len(), "job");
    let table = Path::new("table.csv").display();
    match (collected.failed, collected.open) {
        (0, 0) => check_verdicts(&collected.verdicts, args.fail_on),
        (0, open) => Err(
            CliError::new(format!("{open} of {jobs} {} open", is_are(open))).hint(
                "`rig batch run` does them, unless another process is at work on their sessions",
            ),
        ),
        (failed, 0) => Err(
            CliError::new(format!("{failed} of {jobs} failed")).hint(format!(
                "{table} has the reasons; the same command tries them again"
            )),
        ),
        (failed, open) => Err(CliError::new(format!(
            "of {jobs}, {failed} failed and {open} {} open",
            is_are(open)
        ))
        .hint(format!(
            "{table} has the reasons; `rig batch run` tries those and does the others"
        ))),
    }
}

/// An error where fits have the verdict that the operator does not accept, or a worse one.
fn check_verdicts(found: &[(Verdict, usize)], fail_on: Option<FailOn>) -> Result<(), CliError> {
    let Some(worst) = fail_on.map(Verdict::from) else {
        return Ok(());
    };
    let bad = found.iter().filter(|(verdict, _)| *verdict >= worst);
    let (bad, all): (usize, usize) = (
        bad.map(|(_, fits)| fits).sum(),
        found.iter().map(|(_, fits)| fits).sum(),
    );
    if bad == 0 {
        return Ok(());
    }
    let fact = format!(
        "--fail-on {}: {bad} of {} {} such a verdict or a worse one",
        worst.name(),
        count(all, "fit"),
        if bad == 1 { "has" } else { "have" }
    );
    Err(CliError::new(fact).hint("table.csv has each fit's verdict and reason"))
}

fn is_are(n: usize) -> &'static str {
    if n == 1 { "is" } else { "are" }
}
