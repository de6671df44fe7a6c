//! The topic `job`: the process that runs, or the last one.

use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use serde::Serialize;
use serde_json::{Value, json};

use super::Work;
use super::log::Log;
use crate::capture::{HandWork, Progress};

/// What a job is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// `rig capture`.
    Capture,
    /// `rig fit`.
    Fit,
    /// `rig export`.
    Export,
    /// `rig calibrate`.
    Calibration,
}

impl Kind {
    /// In a sentence.
    pub fn what(self) -> &'static str {
        match self {
            Kind::Capture => "a capture",
            Kind::Fit => "a fit",
            Kind::Export => "an export",
            Kind::Calibration => "a calibration",
        }
    }
}

/// How far it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// It works.
    Running,
    /// It stands, with the lamp off.
    Paused,
    /// It was asked to stop.
    Ending,
    /// It ended well.
    Done,
    /// It ended with an error.
    Failed,
    /// It was stopped.
    Interrupted,
}

/// An open question to the person at the bench.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Question {
    /// By which it is answered.
    pub number: u64,
    /// What to do.
    #[serde(flatten)]
    pub work: HandWork,
}

/// A job as the page shows it.
#[derive(Clone, Debug, Default)]
pub(super) struct JobState {
    pub kind: Option<Kind>,
    pub state: Option<State>,
    pub log: Log,
    /// What the person at the bench is asked to do now.
    pub asked: Option<Question>,
    pub result: Option<String>,
    command: Option<String>,
    pid: Option<u32>,
    began: Option<String>,
    exit: Option<i32>,
    session: Option<String>,
    downloads: Vec<String>,
    progress: Option<Value>,
    verdict: Option<Value>,
}

impl JobState {
    pub fn begun(work: &Work, command: String, pid: u32) -> Self {
        Self {
            kind: Some(work.kind),
            state: Some(State::Running),
            command: Some(command),
            pid: Some(pid),
            began: Some(format!("{:.3}", jiff::Timestamp::now())),
            session: work.session.clone(),
            downloads: work.downloads.clone(),
            ..Self::default()
        }
    }

    pub fn apply(&mut self, event: &Progress) {
        match event {
            Progress::Paused if self.state == Some(State::Running) => {
                self.state = Some(State::Paused);
            }
            Progress::Continued if self.state == Some(State::Paused) => {
                self.state = Some(State::Running);
            }
            Progress::Asked { number, work } => {
                let (number, work) = (*number, *work);
                self.asked = Some(Question { number, work });
            }
            Progress::Ended { .. } => self.asked = None,
            Progress::Calibrating { done } => self.progress = Some(json!({"done": done})),
            Progress::Fit { stage, done } => {
                self.progress = Some(json!({"stage": stage, "done": done}));
            }
            Progress::Fitted { verdict, .. } => self.verdict = Some(json!(verdict)),
            _ => {}
        }
    }

    /// Whether this is the open question; it is open no more.
    pub fn answered(&mut self, number: u64) -> bool {
        let asked = &mut self.asked;
        asked
            .take_if(|question| question.number == number)
            .is_some()
    }

    pub fn end(&mut self, status: Option<ExitStatus>) {
        self.log.finish();
        self.asked = None;
        // As a shell shows it.
        let code = status.and_then(|is| is.code().or_else(|| is.signal().map(|s| 128 + s)));
        self.exit = code;
        self.pid = None;
        self.progress = None;
        // Killed as asked for by STOP, or by the system, for want of memory for instance.
        let was_ending = self.state == Some(State::Ending);
        self.state = Some(match code {
            Some(0) => State::Done,
            Some(129 | 130 | 143) => State::Interrupted,
            Some(137) if was_ending => State::Interrupted,
            _ => State::Failed,
        });
        if self.state != Some(State::Done) {
            self.downloads.clear();
        }
    }

    pub fn json(&self) -> Value {
        json!({
            "kind": self.kind,
            "command": self.command,
            "pid": self.pid,
            "began": self.began,
            "state": self.state,
            "exit": self.exit,
            "session": self.session,
            "download": self.downloads.first(),
            "downloads": self.downloads,
            "verdict": self.verdict,
            "asked": self.asked,
            "log": self.log.lines().collect::<Vec<_>>(),
            "result": self.result,
            "progress": self.progress,
        })
    }
}
