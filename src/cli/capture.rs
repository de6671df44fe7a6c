//! `rig capture`: from a plan to a session, its fit and its report.

use std::path::{Path, PathBuf};

use clap::{Args, FromArgMatches};
use serde_json::json;

#[cfg(feature = "console")]
use super::capture_console::ConsoleOptions;
use super::capture_notices::Terminal;
use super::capture_queue::{self, QueueRequest};
use super::capture_run::{self, Ran};
use super::context::Context;
use super::error::CliError;
use super::number::within;
use super::output::{write_json, write_path};
use super::progress::duration;
use super::rig_choice::RigArg;
use super::table::percent;
use super::{fit, interrupt, open, operator};
use crate::capture::Outcome;
use crate::capture::event_lines::EventLines;
use crate::capture::lights::{MOST_CHOSEN, direction, lights_or_file, most_chosen, until};
use crate::capture::open::open_devices;
use crate::capture::prepare::{CaptureRequest, Job, Lights, Prepared, prepare};
use crate::interrupt::{Interrupt, Signal};
use crate::out;
use crate::session::layout::SESSIONS_FOLDER;
use crate::session::{Session, Until};
use crate::shown::nth;
use crate::units::{Seconds, StageAngles, size};
use crate::workflow::{FitWork, work_of};

/// Captures a sample under several lights, then fits and reports it
///
/// stdout's last line is the session's folder.
#[derive(Args, Debug)]
pub struct CaptureArgs {
    #[command(flatten)]
    rig: RigArg,
    /// How many light directions (around the sample at several heights, past the camera's body);
    /// `all` that keep 15° between them; `best:N`, those that are most informative about an unknown material;
    /// or a file with AZ,EL in each line
    #[arg(long, value_name = "N|all|best:N|FILE", value_parser = lights_or_file, required_unless_present_any = ["light", "until", "resume", "queue"], conflicts_with_all = ["light", "resume"])]
    lights: Option<Lights>,
    /// One light direction, azimuth and elevation in degrees; may be repeated
    #[arg(long, value_name = "AZ,EL", value_parser = direction, allow_hyphen_values = true, conflicts_with = "resume")]
    light: Vec<StageAngles>,
    /// Then adds the most telling light after each until the expected environment error is at
    /// most this, percent; without --lights it begins with one
    #[arg(long, value_name = "PERCENT", value_parser = until, conflicts_with = "resume")]
    until: Option<Until>,
    /// Lights at most, 1 to 60
    #[arg(long, value_name = "N", requires = "until", default_value_t = MOST_CHOSEN, value_parser = most_chosen)]
    max_lights: u32,
    /// Minutes on the bench at most, 0.1 to 10000
    #[arg(long, value_name = "MIN", requires = "until", value_parser = within(0.1, 1e4))]
    within: Option<f64>,
    /// Folder that receives the session's folder
    #[arg(
        long,
        value_name = "DIR",
        default_value = SESSIONS_FOLDER,
        conflicts_with = "resume"
    )]
    out: PathBuf,
    /// Name of the sample: letters, digits, dots, hyphens, underscores
    #[arg(long, value_name = "NAME", conflicts_with = "resume")]
    sample: Option<String>,
    /// What is known of its material, for the session
    #[arg(long, value_name = "TEXT", conflicts_with_all = ["resume", "queue"])]
    material: Option<String>,
    /// Anything else about the sample, for the session
    #[arg(long, value_name = "TEXT", conflicts_with_all = ["resume", "queue"])]
    comment: Option<String>,
    /// Prints the plan with its estimates; nothing is opened and nothing moves
    #[arg(long, conflicts_with = "resume")]
    #[cfg_attr(feature = "console", arg(conflicts_with = "console"))]
    dry_run: bool,
    /// Captures the samples of this file one after the other, asking for each; the same command
    /// goes on with an interrupted queue. Lights are those of a sample in the file, else the ones
    /// named here
    #[arg(long, value_name = "FILE", conflicts_with_all = ["sample", "resume", "events"])]
    #[cfg_attr(feature = "console", arg(conflicts_with = "console"))]
    queue: Option<PathBuf>,
    /// Go on with an interrupted session; plan and configuration are in it
    #[arg(long, value_name = "SESSION", conflicts_with = "rig")]
    resume: Option<PathBuf>,
    /// Capture and merge only
    #[arg(long)]
    no_fit: bool,
    /// The plan (with --dry-run) or the result as JSON
    #[arg(long)]
    #[cfg_attr(feature = "console", arg(conflicts_with = "console"))]
    json: bool,
    /// Each event as a JSON line on stdout, for other programs; a reader that is slow or gone
    /// holds nothing up
    #[arg(long, conflicts_with_all = ["json", "dry_run"])]
    events: bool,
    #[arg(skip)]
    names_next: bool,
    #[cfg(feature = "console")]
    #[command(flatten)]
    console: ConsoleOptions,
}

impl CaptureArgs {
    /// `--rig RIG --lights COUNT --out OUT`, with or without `--events`; the end names
    /// what a newcomer may try next.
    pub fn on_simulated_rig(rig: &str, count: usize, out: PathBuf, events: bool) -> Self {
        let none = Self::augment_args(clap::Command::new("capture"));
        let matches = none.get_matches_from(["capture", "--lights", &count.to_string()]);
        let named = Self::from_arg_matches(&matches).expect("lights are all that is needed");
        Self {
            rig: RigArg {
                rig: Some(rig.to_owned()),
            },
            out,
            events,
            names_next: true,
            ..named
        }
    }

    /// The lights that are named; one, where others follow it.
    fn named_lights(&self) -> Option<Lights> {
        let listed = || (!self.light.is_empty()).then(|| Lights::Listed(self.light.clone()));
        let first = || self.until.map(|_| Lights::Count(1));
        self.lights.clone().or_else(listed).or_else(first)
    }

    /// When a capture has enough.
    fn until(&self) -> Option<Until> {
        self.until.map(|until| Until {
            max_lights: self.max_lights,
            within_s: self.within.map(|minutes| Seconds(60.0 * minutes)),
            ..until
        })
    }
}

/// `rig capture`.
pub fn run(args: &CaptureArgs, context: &Context) -> Result<(), CliError> {
    #[cfg(feature = "console")]
    if args.console.is_wanted()? {
        return args.console.run(std::env::args_os().skip(1), context);
    }
    if let Some(file) = &args.queue {
        let request = QueueRequest {
            rig: &args.rig.resolve(context)?,
            file,
            folder: &args.out,
            lights: args.named_lights(),
            until: args.until(),
            only_plan: args.dry_run,
            fits: !args.no_fit,
            json: args.json,
        };
        return capture_queue::run(&request, context);
    }
    let lines = args.events.then(EventLines::start).transpose()?;
    let lines = lines.as_ref();
    let begun = match &args.resume {
        Some(root) => interrupt::listen().and_then(|interrupt| {
            Ok(Some((
                capture_run::resume(root, context, lines)?,
                interrupt,
            )))
        }),
        None => start(args, context, lines),
    };
    match begun {
        Ok(Some((job, interrupt))) => carry_out(args, job, interrupt, context, lines),
        Ok(None) => Ok(()),
        Err(error) => {
            if let Some(lines) = lines {
                lines.not_begun(error.fact().to_owned());
            }
            Err(error)
        }
    }
}

/// A new session with its devices; `None` after a dry run.
fn start(
    args: &CaptureArgs,
    context: &Context,
    lines: Option<&EventLines>,
) -> Result<Option<(Job, Interrupt)>, CliError> {
    // The plan, while nothing moves.
    let rig = args.rig.resolve(context)?;
    let lights = args.named_lights().unwrap_or(Lights::Count(1));
    let request = CaptureRequest {
        sample: args.sample.clone(),
        material: args.material.clone(),
        comment: args.comment.clone(),
        only_plan: args.dry_run,
        until: args.until(),
        ..CaptureRequest::new(lights, &args.out)
    };
    let mut terminal = Terminal::new(context, lines);
    let prepared = prepare(&rig, &request, &mut |notice| terminal.show(notice));
    terminal.finish();
    let prepared = prepared?;
    if let Some(ranking) = prepared.ranking() {
        context.note(ranking.to_string());
    }
    if args.dry_run {
        let fit = work_of(&rig.config, &prepared.plan().lights)?;
        print_plan(&prepared, &fit, args.json)?;
        prepared.check_space()?;
        return Ok(None);
    }
    prepared.check_space()?;

    // The devices.
    let interrupt = interrupt::listen()?;
    let devices = open::options_for(&rig.config, || operator::of_capture(lines))?;
    let devices = open_devices(&rig.config, &devices)?;
    let job = prepared.begin(devices, &mut |notice| terminal.show(notice))?;
    Ok(Some((job, interrupt)))
}

/// Captures, then fits and reports; prints the session's folder.
fn carry_out(
    args: &CaptureArgs,
    job: Job,
    interrupt: Interrupt,
    context: &Context,
    lines: Option<&EventLines>,
) -> Result<(), CliError> {
    // The capture.
    let root = job.root().to_owned();
    let ran = capture_run::run(job, interrupt.clone(), context, lines);
    let again = format!("`rig capture --resume {}` continues it", root.display());
    match ran.ended {
        Ok(Outcome::Complete) => {}
        Ok(Outcome::Interrupted) => {
            let signal = interrupt.signal().unwrap_or(Signal::Interrupt);
            // A stdout that is gone, as with a closed terminal, is not how it ended.
            drop(print_result(args, &root, &ran));
            let fact = "the capture was interrupted; the lamp is off";
            return Err(CliError::interrupted(signal, fact).hint(again));
        }
        Err(_) => {
            drop(print_result(args, &root, &ran));
            return ran
                .ended
                .map(drop)
                .map_err(|error| capture_run::suspended(error, &again));
        }
    }

    // The fit.
    if !args.no_fit {
        let unfitted = unfitted(args, &root, lines);
        interrupt::end_on_signal(context, &interrupt, unfitted)?;
        fit::fit_and_report(&root, context, lines)?;
        if args.names_next {
            context.note(format!(
                "next: `rig validate {}` fits a part of the lights and predicts the rest, within a minute or two",
                root.display()
            ));
        }
    }
    print_result(args, &root, &ran)
}

/// What marks a plan without a sensor record.
const NO_SENSOR_RECORD: &str =
    "estimated for a usual sensor, no sensor record: run `rig calibrate sensor`";

/// What `--dry-run --json` prints.
#[derive(serde::Serialize)]
struct PrintedPlan<'a> {
    #[serde(flatten)]
    plan: &'a crate::session::PlanRecord,
    /// What the fit will have to do.
    fit: FitWork,
    /// The record that time and size are estimated by.
    sensor_record: Option<&'a str>,
    /// How they are estimated without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    estimated: Option<&'static str>,
}

/// What a signal during the fit leads to: the capture itself is done.
fn unfitted(
    args: &CaptureArgs,
    root: &Path,
    lines: Option<&EventLines>,
) -> impl Fn(Signal) -> CliError + Clone + Send + 'static {
    let (root, prints_path) = (root.to_owned(), !args.json && !args.events);
    let lines = lines.cloned();
    move |signal| {
        if prints_path {
            // The reader of stdout may be gone; the signal is what counts.
            drop(write_path(&root));
        }
        let root = root.display();
        let error =
            CliError::interrupted(signal, "the fit was interrupted; the capture is complete").hint(
                format!("`rig fit {root}` and `rig report {root}` do the rest"),
            );
        if let Some(lines) = &lines {
            lines.fit_failed(error.fact().to_owned(), error.advice().map(str::to_owned));
            lines.flush();
        }
        error
    }
}

fn print_result(args: &CaptureArgs, root: &Path, ran: &Ran) -> Result<(), CliError> {
    if args.events {
        return Ok(());
    }
    if args.json {
        let session = Session::open(root)?;
        let spent = ran.spent;
        return write_json(&json!({
            "session": root.to_string_lossy(),
            "complete": matches!(ran.ended, Ok(Outcome::Complete)),
            "elapsed_s": ran.elapsed_s,
            "spent": spent,
            "wall_over_devices": spent.and_then(|spent| spent.over_devices()),
            "wall_over_plan": spent.and_then(|spent| spent.over_plan()),
            "decision": session.journal().decisions().last(),
            "summary": session.summary(),
        }));
    }
    write_path(root)
}

/// Without a sensor record exposures and time are estimated for a usual sensor, and marked.
fn print_plan(prepared: &Prepared<'_>, fit: &FitWork, as_json: bool) -> Result<(), CliError> {
    let (plan, sensor_id) = (prepared.plan(), prepared.sensor_id());
    if as_json {
        return write_json(&PrintedPlan {
            plan,
            fit: *fit,
            sensor_record: sensor_id,
            estimated: sensor_id.is_none().then_some(NO_SENSOR_RECORD),
        });
    }
    let mark = match sensor_id {
        Some(_) => String::new(),
        None => format!(" ({NO_SENSOR_RECORD})"),
    };
    let rules = &plan.exposure;
    let channels = plan.channels.len();
    out!("{} lights, {channels} lamp channels", plan.lights.len())?;
    for (light, angles) in plan.lights.iter().enumerate() {
        out!("  {light}: {angles}", light = nth("light", light))?;
    }
    if let Some(until) = plan.until {
        let (enough, most) = (percent(until.error), plan.most_lights());
        out!(
            "then the most telling ones until the expected error is {enough}, at most {most} lights in all"
        )?;
    }
    out!(
        "exposures from {} to {}, each at most {} times the one before, up to {} frames of each averaged",
        rules.shortest_s,
        rules.longest_s,
        rules.ratio,
        rules.max_frames
    )?;
    out!(
        "chosen from pilot frames so that no pixel of the sample is saturated and dark ones reach a signal-to-noise ratio of {}",
        rules.dark_snr
    )?;
    out!(
        "about {} on the bench, {} merged images and {} for a scene of usual contrast{mark}",
        duration(plan.estimated_s.0),
        plan.most_lights(),
        size(plan.estimated_bytes)
    )?;
    out!("then a fit: {fit}")
}
