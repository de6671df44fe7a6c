//! `rig capture --queue`: sample after sample, asked for at the terminal or by a pipe.

use std::io::{BufRead, IsTerminal};
use std::path::Path;

use serde_json::json;

use super::capture_notices::Terminal;
use super::capture_run;
use super::context::Context;
use super::error::CliError;
use super::output::{write_json, write_stderr};
use super::progress::duration;
use super::table::{Table, size};
use super::{fit, interrupt, open};
use crate::capture::Outcome;
use crate::capture::open::open_devices;
use crate::capture::prepare::{CaptureRequest, Job, Lights, prepare};
use crate::config::ResolvedRig;
use crate::interrupt::{Interrupt, Signal};
use crate::queue::{
    Answer, Entry, Fitted, Question, Queue, RunState, Sample, Unreadable, Worker, carry_out,
    overview,
};
use crate::session::Until;
use crate::shown::{escaped, with_causes};

/// Advice on everything that ends a queue before its end.
const GO_ON: &str = "the same command goes on with the queue";
/// Where a capture was interrupted.
const GO_ON_WITH_IT: &str = "the same command goes on with this capture";

/// What `rig capture --queue` was asked for.
pub(super) struct QueueRequest<'a> {
    pub(super) rig: &'a ResolvedRig,
    /// The list of samples.
    pub(super) file: &'a Path,
    pub(super) folder: &'a Path,
    /// Lights of samples that name none.
    pub(super) lights: Option<Lights>,
    /// When a capture has enough, where more lights follow.
    pub(super) until: Option<Until>,
    /// Whether to stop after the check.
    pub(super) only_plan: bool,
    /// Whether captures are fitted.
    pub(super) fits: bool,
    /// Whether the table at the end is JSON.
    pub(super) json: bool,
}

/// Carries out the queue.
pub(super) fn run(request: &QueueRequest<'_>, context: &Context) -> Result<(), CliError> {
    let mut queue = Queue::open(request.file, request.folder)?;
    for Unreadable { session, error, .. } in queue.unreadable() {
        let session = request.folder.join(session);
        context.warn(format!(
            "{} counts as not captured, because it cannot be read: {}",
            session.display(),
            with_causes(error)
        ));
    }
    let plans = check(request, &queue, context)?;
    if request.only_plan {
        return print(request, &queue);
    }
    let interrupt = interrupt::listen()?;
    let work = Work {
        request,
        plans,
        interrupt,
        context,
    };
    carry_out(&mut queue, &work)?;
    print(request, &queue)?;
    match queue.left() {
        0 => {}
        1 => context.note(format!("1 capture is left; {GO_ON}")),
        left => context.note(format!("{left} captures are left; {GO_ON}")),
    }
    let is_left_out = |sample: &Sample| queue.left_out(sample).is_some();
    if queue.left() == 0 && queue.samples().iter().any(is_left_out) {
        context.note(
            "to capture what was left out after all, give the same command and answer b at its end",
        );
    }
    let failed = |run: &&Entry| matches!(&run.state, RunState::Done { error: Some(_), .. });
    match queue.entries().iter().find(failed) {
        None => Ok(()),
        Some(first) => {
            let count = queue.entries().iter().filter(failed).count();
            let session = request.folder.join(&first.session);
            let fact = format!("{count} of the captures could not be fitted");
            let hint = format!("`rig fit {}` says why", session.display());
            Err(CliError::new(fact).hint(hint))
        }
    }
}

/// What was planned for a choice of lights.
struct Plan {
    chosen: Lights,
    /// The directions that it came to.
    listed: Lights,
    seconds: f64,
    bytes: u64,
}

/// Plans what is to be captured, before anybody carries samples: each different choice of
/// lights once.
fn check(
    request: &QueueRequest<'_>,
    queue: &Queue,
    context: &Context,
) -> Result<Vec<Plan>, CliError> {
    let mut plans: Vec<Plan> = Vec::new();
    let (mut captures, mut seconds, mut bytes) = (0, 0.0, 0);
    for (number, sample) in queue.samples().iter().enumerate() {
        let of_sample = format!("{}: `sample[{number}].lights`", request.file.display());
        let Some(chosen) = lights_of(sample, request) else {
            let fact = format!("{of_sample} is missing, and the command names no lights");
            return Err(CliError::new(fact)
                .hint("add `lights = 8` to the sample, or --lights 8 to the command for all samples without"));
        };
        if !plans.iter().any(|plan| plan.chosen == chosen) {
            let planned = plan(request, chosen.clone(), context).map_err(|error| {
                let hint = error.advice().map(str::to_owned);
                let error = CliError::new(format!("{of_sample}: {}", error.fact()));
                hint.into_iter().fold(error, CliError::hint)
            });
            plans.push(planned?);
        }
        let left = queue.left_of(sample);
        captures += left;
        for plan in plans.iter().filter(|plan| plan.chosen == chosen) {
            seconds += left as f64 * plan.seconds;
            bytes += left as u64 * plan.bytes;
        }
    }
    if captures > 0 {
        let (samples, time, bytes) = (queue.samples().len(), duration(seconds), size(bytes));
        context.note(format!(
            "{samples} samples, {captures} captures to do: about {time} on the bench and {bytes}, without the fits"
        ));
    }
    Ok(plans)
}

/// The lights that are wanted for a sample.
fn lights_of(sample: &Sample, request: &QueueRequest<'_>) -> Option<Lights> {
    sample.lights.clone().or_else(|| request.lights.clone())
}

fn plan(request: &QueueRequest<'_>, chosen: Lights, context: &Context) -> Result<Plan, CliError> {
    let asked = CaptureRequest {
        only_plan: request.only_plan,
        until: request.until,
        ..CaptureRequest::new(chosen.clone(), request.folder)
    };
    let mut terminal = Terminal::new(context, None);
    let prepared = prepare(request.rig, &asked, &mut |notice| terminal.show(notice));
    terminal.finish();
    let prepared = prepared?;
    prepared.check_space()?;
    let planned = prepared.plan();
    Ok(Plan {
        chosen,
        listed: Lights::Listed(planned.lights.clone()),
        seconds: planned.estimated_s.0,
        bytes: planned.estimated_bytes,
    })
}

/// What every step needs.
struct Work<'a> {
    request: &'a QueueRequest<'a>,
    plans: Vec<Plan>,
    interrupt: Interrupt,
    context: &'a Context,
}

/// A question in words, and whether it can be answered by repeating the last sample.
fn words(question: Question<'_>) -> (String, bool) {
    let (sample, run, of, can_repeat) = match question {
        Question::Resume { sample } => {
            let text = format!(
                "The capture of {sample} was interrupted. Put the sample on the bench as it was, then Enter; s leaves the session as it is, q ends"
            );
            return (text, false);
        }
        Question::Done { last, left_out } => {
            let mut text = "All samples are done; Enter ends".to_owned();
            if let Some(last) = last {
                text += &format!(", r repeats the last one ({last})");
            }
            if let Some(first) = left_out {
                text += &format!(", b brings back what was left out ({first})");
            }
            return (text, last.is_some());
        }
        Question::Put {
            sample,
            run,
            of,
            can_repeat,
        } => (sample, run, of, can_repeat),
    };
    let name = &sample.name;
    let mut put = format!("Put the sample {name} on the bench");
    if run > 1 {
        put = format!("Take the sample {name} off the bench and put it back");
    }
    if of > 1 {
        put += &format!(" ({run} of {of})");
    }
    let notes = [&sample.material, &sample.comment];
    let notes: Vec<_> = notes.into_iter().flatten().map(String::as_str).collect();
    if !notes.is_empty() {
        put += &format!(" [{}]", notes.join("; "));
    }
    let repeats = match can_repeat {
        true => " r repeats the last one,",
        false => "",
    };
    let text = format!("{put}, then Enter;{repeats} s leaves this one out, q ends");
    (text, can_repeat)
}

impl Worker for Work<'_> {
    type Error = CliError;

    fn begin(&self, sample: &Sample) -> Result<Job, CliError> {
        let config = &self.request.rig.config;
        let chosen = lights_of(sample, self.request);
        let plan = (self.plans.iter()).find(|plan| Some(&plan.chosen) == chosen.as_ref());
        let lights = plan.map_or(Lights::Listed(Vec::new()), |plan| plan.listed.clone());
        let asked = CaptureRequest {
            sample: Some(sample.name.clone()),
            material: sample.material.clone(),
            comment: sample.comment.clone(),
            until: self.request.until,
            ..CaptureRequest::new(lights, self.request.folder)
        };
        // What is to be noticed was shown when the queue was checked.
        let prepared = prepare(self.request.rig, &asked, &mut |_| ());
        let prepared = prepared?;
        prepared.check_space()?;
        let devices = open_devices(config, &open::options(config)?)?;
        Ok(prepared.begin(devices, &mut |_| ())?)
    }

    fn resume(&self, root: &Path) -> Result<Job, CliError> {
        capture_run::resume(root, self.context, None)
    }

    fn capture(&self, job: Job) -> Result<(), CliError> {
        let ran = capture_run::run(job, self.interrupt.clone(), self.context, None);
        match ran.ended {
            Ok(Outcome::Complete) => Ok(()),
            Ok(Outcome::Interrupted) => {
                let signal = self.interrupt.signal().unwrap_or(Signal::Interrupt);
                let fact = "the queue was interrupted during a capture; the lamp is off";
                Err(CliError::interrupted(signal, fact).hint(GO_ON_WITH_IT))
            }
            Err(error) => Err(capture_run::suspended(error, GO_ON_WITH_IT)),
        }
    }

    fn fit(&self, root: &Path) -> Result<Fitted, CliError> {
        if !self.request.fits {
            return Ok(Fitted::Verdict(None));
        }
        let interrupted = |signal| {
            CliError::interrupted(signal, "the fit was interrupted; the capture is complete")
                .hint("the same command fits it and goes on with the queue")
        };
        let ending = interrupt::ending_on_signal(self.context, &self.interrupt, interrupted)?;
        let fitted = fit::fit_and_report(root, self.context, None);
        drop(ending);
        Ok(match fitted {
            Ok(verdict) => Fitted::Verdict(Some(verdict)),
            Err(error) => {
                let fact = error.fact().to_owned();
                let session = root.file_name().unwrap_or_default().to_string_lossy();
                self.context
                    .warn(format!("{session} was not fitted: {fact}"));
                Fitted::Failed(fact)
            }
        })
    }

    /// Asks until there is an answer; the end of the input is `q`.
    fn ask(&self, question: Question<'_>) -> Result<Answer, CliError> {
        let is_end = matches!(
            question,
            Question::Done {
                left_out: Some(_),
                ..
            }
        );
        let (question, repeats) = words(question);
        let interrupted =
            |signal| CliError::interrupted(signal, "the queue was interrupted").hint(GO_ON);
        let _ending = interrupt::ending_on_signal(self.context, &self.interrupt, interrupted)?;
        loop {
            write_stderr(&format!("\n{} ", escaped(&question)));
            let mut line = Vec::new();
            let read = std::io::stdin().lock().read_until(b'\n', &mut line);
            if !read.is_ok_and(|bytes| bytes > 0) {
                write_stderr("\n");
                return Ok(Answer::Quit);
            }
            // A terminal has shown the line's end itself.
            if !std::io::stdin().is_terminal() {
                write_stderr("\n");
            }
            let line = String::from_utf8_lossy(&line);
            let (word, rest) = line.trim().split_once(' ').unwrap_or((line.trim(), ""));
            let reason = Some(rest.trim().to_owned()).filter(|reason| !reason.is_empty());
            match word.to_lowercase().as_str() {
                "s" => return Ok(Answer::LeaveOut(reason)),
                _ if reason.is_some() => write_stderr("that is none of the answers\n"),
                "" => return Ok(Answer::Go),
                "r" if repeats => return Ok(Answer::Repeat),
                "b" if is_end => return Ok(Answer::TakeBack),
                "q" => return Ok(Answer::Quit),
                _ => write_stderr("that is none of the answers\n"),
            }
        }
    }
}

/// What became of every sample, on stdout.
fn print(request: &QueueRequest<'_>, queue: &Queue) -> Result<(), CliError> {
    if request.json {
        return write_json(&json!({
            "folder": request.folder.to_string_lossy(),
            "samples": overview::samples(queue),
            "left": queue.left(),
        }));
    }
    let mut table = Table::new(&["sample", " run", "state", "session"]);
    for line in overview::lines(queue) {
        let run = line.run.map_or_else(String::new, |run| run.to_string());
        table.row([line.sample, run, line.state, line.session]);
    }
    table.print()
}
