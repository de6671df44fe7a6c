//! What became of every sample of a queue: a line for each run, or all of a sample at once.

use serde::Serialize;

use super::{Entry, Queue, RunState, Sample};

/// All that is known of a sample, as JSON states it.
#[derive(Serialize)]
pub struct SampleOverview<'a> {
    /// Its name.
    pub sample: &'a str,
    /// Its runs, in their order.
    pub sessions: Vec<&'a Entry>,
    /// How many of its sessions were left out.
    pub left_out: usize,
    /// Why.
    pub reason: Option<&'a str>,
    /// Its sessions that cannot be read.
    pub unreadable: Vec<&'a str>,
    /// How many are still to be captured.
    pub left: usize,
}

/// A line of a table.
pub struct Line {
    /// The sample's name.
    pub sample: String,
    /// The run's number, from 1.
    pub run: Option<usize>,
    /// How it ended, or what is still to be done, in a few words.
    pub state: String,
    /// The run's session; empty where there is none.
    pub session: String,
}

/// Every sample of the queue, in its order.
pub fn samples(queue: &Queue) -> Vec<SampleOverview<'_>> {
    let all = queue.samples().iter();
    all.map(|sample| SampleOverview {
        sample: &sample.name,
        sessions: runs(queue, sample).collect(),
        left_out: queue.left_out_of(sample),
        reason: queue.left_out(sample).and_then(|out| out.reason.as_deref()),
        unreadable: unreadable(queue, sample).collect(),
        left: queue.left_of(sample),
    })
    .collect()
}

/// A line for each run of each sample, and for what was left out or is to be done.
pub fn lines(queue: &Queue) -> Vec<Line> {
    let mut lines = Vec::new();
    for sample in queue.samples() {
        let mut add = |run, state: String, session: &str| {
            lines.push(Line {
                sample: sample.name.clone(),
                run,
                state,
                session: session.to_owned(),
            });
        };
        for (number, run) in (1..).zip(runs(queue, sample)) {
            add(Some(number), words(&run.state).to_owned(), &run.session);
        }
        for session in unreadable(queue, sample) {
            add(None, "cannot be read".to_owned(), session);
        }
        let counted = |count: usize, what: &str| match count {
            1 => what.to_owned(),
            count => format!("{count} {what}"),
        };
        if let Some(out) = queue.left_out(sample) {
            let reason = out.reason.iter().map(|reason| format!(": {reason}"));
            let state = counted(out.sessions, "left out") + &reason.collect::<String>();
            add(None, state, "");
        }
        if queue.left_of(sample) > 0 {
            add(None, counted(queue.left_of(sample), "to do"), "");
        }
    }
    lines
}

fn runs<'a>(queue: &'a Queue, sample: &'a Sample) -> impl Iterator<Item = &'a Entry> {
    let all = queue.entries().iter();
    all.filter(|run| run.sample == sample.name)
}

/// The sessions of a sample that are none any more.
fn unreadable<'a>(queue: &'a Queue, sample: &'a Sample) -> impl Iterator<Item = &'a str> {
    let all = queue.unreadable().iter();
    let own = all.filter(|one| one.sample == sample.name);
    own.map(|one| one.session.as_str())
}

fn words(state: &RunState) -> &'static str {
    match state {
        RunState::Begun | RunState::Abandoned => "interrupted",
        RunState::Captured => "captured",
        RunState::Done { error: Some(_), .. } => "fit failed",
        RunState::Done { verdict: None, .. } => "captured, not fitted",
        RunState::Done {
            verdict: Some(verdict),
            ..
        } => verdict.word(),
    }
}
