//! What was done of a queue, and what is next.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::QueueError;
use super::journal::{Event, Journal};
use super::list::{Sample, SampleList};
use crate::session::fit_record::{self, Verdict};
use crate::session::layout::sample_of;
use crate::session::{Session, SessionError, SessionState};

/// A queue of samples whose sessions go to one folder.
#[derive(Debug)]
pub struct Queue {
    list: SampleList,
    folder: PathBuf,
    journal: Journal,
    known: Known,
    unreadable: Vec<Unreadable>,
}

/// A session of the queue that is there, but is none any more: it counts as never made.
#[derive(Debug)]
#[allow(missing_docs)]
pub struct Unreadable {
    pub sample: String,
    /// Name of the session.
    pub session: String,
    pub error: SessionError,
}

/// What is to be done next.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum Step {
    /// The capture of this session was interrupted: it goes on first.
    Resume { sample: String, session: PathBuf },
    /// This session is captured; its fit is missing.
    Fit { session: PathBuf },
    /// A new session of this sample.
    Capture {
        sample: Sample,
        /// Which of its sessions, from 1; those that were left out count.
        run: usize,
        /// How many are planned.
        of: usize,
    },
    /// Nothing is left to do.
    End,
}

/// How far a session of the queue is.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub enum RunState {
    /// Its capture has begun.
    Begun,
    /// Its capture is complete, its fit is missing.
    Captured,
    /// Nothing more is to be done with it.
    Done {
        /// Its fit's verdict, where it was fitted.
        verdict: Option<Verdict>,
        /// Why it could not be fitted.
        #[serde(skip_serializing_if = "Option::is_none")]
        error: Option<String>,
    },
    /// Its interrupted capture was left as it is.
    Abandoned,
}

impl RunState {
    /// Whether its capture is complete and no fit of it is known.
    fn lacks_fit(&self) -> bool {
        matches!(self, Self::Captured | Self::Done { verdict: None, .. })
    }
}

/// A session of the queue.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Entry {
    /// The sample's name.
    pub sample: String,
    /// Name of the session.
    pub session: String,
    /// How far it is.
    #[serde(flatten)]
    pub state: RunState,
}

/// What the journal's events come to.
#[derive(Debug, Default)]
struct Known {
    runs: Vec<Entry>,
    /// The sample of a session that was about to be made, and its sessions before that.
    next: Option<(String, Vec<String>)>,
    /// The sample that is next whatever the list's order.
    first: Option<String>,
    again: HashMap<String, usize>,
    left_out: HashMap<String, Omission>,
}

/// What was left out of a sample.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Omission {
    /// How many sessions.
    pub sessions: usize,
    /// Why, in the operator's words.
    pub reason: Option<String>,
}

impl Known {
    fn add(&mut self, event: Event) {
        let state = |runs: &mut Vec<Entry>, session: &str, state| {
            if let Some(run) = runs.iter_mut().find(|run| run.session == session) {
                run.state = state;
            }
        };
        match event {
            Event::Start { .. } => {}
            Event::Next { sample, before } => self.next = Some((sample, before)),
            Event::Begun { sample, session } => {
                (self.next, self.first) = (None, None);
                self.runs.push(Entry {
                    sample,
                    session,
                    state: RunState::Begun,
                });
            }
            Event::Captured { session } => state(&mut self.runs, &session, RunState::Captured),
            Event::Done {
                session,
                verdict,
                error,
            } => state(&mut self.runs, &session, RunState::Done { verdict, error }),
            Event::Abandoned { session } => state(&mut self.runs, &session, RunState::Abandoned),
            Event::Again { sample } => {
                self.first = Some(sample.clone());
                *self.again.entry(sample).or_default() += 1;
            }
            Event::LeftOut {
                sample,
                sessions,
                reason,
            } => {
                self.first = None;
                let left_out = self.left_out.entry(sample).or_default();
                left_out.sessions += sessions;
                left_out.reason = reason.or(left_out.reason.take());
            }
            Event::TakenBack { sample } => {
                self.left_out.remove(&sample);
                self.first = Some(sample);
            }
        }
    }

    fn has_sample(&self, name: &str) -> bool {
        self.runs.iter().any(|run| run.sample == name)
            || self.left_out.contains_key(name)
            || self.next.as_ref().is_some_and(|(next, _)| next == name)
    }
}

impl Queue {
    /// Opens the queue of a file of samples, whose sessions go to `folder`; what was done of it
    /// before is known again. The list may have been changed since. Sessions that were removed or
    /// cannot be read count as never made.
    ///
    /// # Errors
    /// The list or the journal cannot be used, or another process works on the queue.
    pub fn open(samples: &Path, folder: &Path) -> Result<Self, QueueError> {
        // The list first: without it nothing is made.
        let (mut known, there) = (Known::default(), sessions_in(folder)?);
        SampleList::read(samples, |_| None)?;
        let (journal, events) = Journal::open(samples, folder)?;
        events.into_iter().for_each(|event| known.add(event));
        known.runs.retain(|run| there.contains(&run.session));
        let list = SampleList::read(samples, |name| {
            let is_of = |session: &&String| sample_of(session) == Some(name);
            let taken = there.iter().find(is_of);
            taken.filter(|_| !known.has_sample(name)).cloned()
        })?;
        let mut unreadable = Vec::new();
        known.runs.retain(
            |Entry {
                 sample, session, ..
             }| {
                let opened = Session::open(&folder.join(session));
                let failed = opened.map_err(|error| Unreadable {
                    sample: sample.clone(),
                    session: session.clone(),
                    error,
                });
                let failed = failed.err();
                let is_readable = failed.is_none();
                unreadable.extend(failed);
                is_readable
            },
        );
        let mut queue = Self {
            list,
            folder: folder.to_owned(),
            journal,
            known,
            unreadable,
        };
        queue.catch_up(&there)?;
        Ok(queue)
    }

    /// Takes over what the process could not write any more before it died: a session that it had
    /// just made, a capture that was complete. Takes over fits that were made since, by other
    /// commands.
    fn catch_up(&mut self, there: &[String]) -> Result<(), QueueError> {
        if let Some((sample, before)) = self.known.next.clone() {
            let is_new =
                |name: &&String| sample_of(name) == Some(&sample) && !before.contains(name);
            if let Some(session) = there.iter().find(is_new) {
                self.begun(&sample, session)?;
            }
        }
        let is_complete = |run: &&Entry| {
            let session = Session::open(&self.folder.join(&run.session));
            run.state == RunState::Begun
                && session.is_ok_and(|session| session.state() == SessionState::Complete)
        };
        let complete = self.known.runs.iter().filter(is_complete);
        let complete: Vec<_> = complete.map(|run| run.session.clone()).collect();
        complete
            .iter()
            .try_for_each(|session| self.captured(session))?;

        let unfitted = self.known.runs.iter().filter(|run| run.state.lacks_fit());
        let fitted = unfitted.filter_map(|run| {
            let fit = fit_record::find(&self.folder.join(&run.session)).ok()?;
            Some((run.session.clone(), fit.verdict()))
        });
        let fitted: Vec<_> = fitted.collect();
        fitted
            .iter()
            .try_for_each(|(session, verdict)| self.done(session, Some(*verdict), None))
    }

    /// Samples in the file's order.
    pub fn samples(&self) -> &[Sample] {
        &self.list.samples
    }

    /// The sessions of the queue, in the order in which they were begun.
    pub fn entries(&self) -> &[Entry] {
        &self.known.runs
    }

    /// The sessions of the queue that cannot be read, in the same order.
    pub fn unreadable(&self) -> &[Unreadable] {
        &self.unreadable
    }

    /// How many sessions are still to be captured.
    pub fn left(&self) -> usize {
        self.samples()
            .iter()
            .map(|sample| self.left_of(sample))
            .sum()
    }

    /// How many sessions of a sample are still to be captured.
    pub fn left_of(&self, sample: &Sample) -> usize {
        let over = self.runs_of(&sample.name) + self.left_out_of(sample);
        self.planned(sample).saturating_sub(over)
    }

    fn runs_of(&self, name: &str) -> usize {
        let runs = self.known.runs.iter();
        runs.filter(|run| run.sample == name).count()
    }

    /// How many sessions of a sample were left out.
    pub fn left_out_of(&self, sample: &Sample) -> usize {
        self.left_out(sample).map_or(0, |out| out.sessions)
    }

    /// What was left out of a sample, and why.
    pub fn left_out(&self, sample: &Sample) -> Option<&Omission> {
        let out = self.known.left_out.get(&sample.name);
        out.filter(|out| out.sessions > 0)
    }

    /// How many sessions are planned for a sample, those that were left out among them.
    pub fn planned(&self, sample: &Sample) -> usize {
        sample.repeats + self.known.again.get(&sample.name).copied().unwrap_or(0)
    }

    /// The sample that was captured last, unless the list has it no more.
    pub fn last(&self) -> Option<&str> {
        let last = &self.known.runs.last()?.sample;
        let is_listed = self.samples().iter().any(|sample| sample.name == *last);
        is_listed.then_some(last)
    }

    /// What is next: an interrupted session, one without its fit, the next sample, in this order.
    pub fn step(&self) -> Step {
        for run in &self.known.runs {
            let session = self.folder.join(&run.session);
            let sample = run.sample.clone();
            match run.state {
                RunState::Begun => return Step::Resume { sample, session },
                RunState::Captured => return Step::Fit { session },
                RunState::Done { .. } | RunState::Abandoned => {}
            }
        }
        let is_open = |sample: &&Sample| self.left_of(sample) > 0;
        let first = self.known.first.as_ref();
        let first = first.and_then(|first| self.samples().iter().find(|s| s.name == *first));
        let open = first
            .filter(is_open)
            .or_else(|| self.samples().iter().find(is_open));
        open.map_or(Step::End, |sample| Step::Capture {
            run: self.runs_of(&sample.name) + self.left_out_of(sample) + 1,
            of: self.planned(sample),
            sample: sample.clone(),
        })
    }

    /// A session of this sample is about to be made.
    ///
    /// # Errors
    /// As of all that follow: the journal cannot be written.
    pub fn next(&mut self, sample: &str) -> Result<(), QueueError> {
        let is_of = |session: &String| sample_of(session) == Some(sample);
        let before = sessions_in(&self.folder)?.into_iter().filter(is_of);
        let (sample, before) = (sample.to_owned(), before.collect());
        self.record(Event::Next { sample, before })
    }

    /// It was made under this name.
    pub fn begun(&mut self, sample: &str, session: &str) -> Result<(), QueueError> {
        self.record(Event::Begun {
            sample: sample.to_owned(),
            session: session.to_owned(),
        })
    }

    /// Its capture is complete.
    pub fn captured(&mut self, session: &str) -> Result<(), QueueError> {
        let session = session.to_owned();
        self.record(Event::Captured { session })
    }

    /// Nothing more is to be done with it: it was fitted, could not be, or needs no fit.
    pub fn done(
        &mut self,
        session: &str,
        verdict: Option<Verdict>,
        error: Option<String>,
    ) -> Result<(), QueueError> {
        let session = session.to_owned();
        self.record(Event::Done {
            session,
            verdict,
            error,
        })
    }

    /// Its interrupted capture is left as it is.
    pub fn abandon(&mut self, session: &str) -> Result<(), QueueError> {
        let session = session.to_owned();
        self.record(Event::Abandoned { session })
    }

    /// The sample that was captured last gets one more session, which is next. Returns its name;
    /// `None` where nothing was captured, or the list has it no more.
    pub fn again(&mut self) -> Result<Option<String>, QueueError> {
        let Some(sample) = self.last().map(str::to_owned) else {
            return Ok(None);
        };
        self.record(Event::Again {
            sample: sample.clone(),
        })?;
        Ok(Some(sample))
    }

    /// No more sessions of this sample are wanted, for this reason.
    pub fn leave_out(&mut self, name: &str, reason: Option<&str>) -> Result<(), QueueError> {
        let sample = self.samples().iter().find(|sample| sample.name == name);
        let sessions = sample.map_or(0, |sample| self.left_of(sample));
        let sample = name.to_owned();
        let reason = reason.map(str::to_owned);
        self.record(Event::LeftOut {
            sample,
            sessions,
            reason,
        })
    }

    /// What was left out of this sample is wanted after all, and next.
    pub fn take_back(&mut self, name: &str) -> Result<(), QueueError> {
        let sample = name.to_owned();
        self.record(Event::TakenBack { sample })
    }

    fn record(&mut self, event: Event) -> Result<(), QueueError> {
        self.journal.append(&event)?;
        self.known.add(event);
        Ok(())
    }
}

/// Names of the folders in this folder, which need not exist.
fn sessions_in(folder: &Path) -> Result<Vec<String>, QueueError> {
    let io = |source| QueueError::Io {
        path: folder.to_owned(),
        source,
    };
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(io(error)),
    };
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry.map_err(io)?;
        if entry.path().is_dir() {
            names.extend(entry.file_name().into_string());
        }
    }
    names.sort();
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::example::{add_fit, session};

    const LIST: &str = "
[[sample]]
name = \"cup\"
[[sample]]
name = \"bowl\"
repeats = 2
[[sample]]
name = \"jar\"
";

    struct Bench {
        folder: tempfile::TempDir,
    }

    impl Bench {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            std::fs::write(folder.path().join("samples.toml"), LIST).unwrap();
            Self { folder }
        }

        fn sessions(&self) -> PathBuf {
            self.folder.path().join("sessions")
        }

        fn open(&self) -> Result<Queue, QueueError> {
            Queue::open(&self.folder.path().join("samples.toml"), &self.sessions())
        }

        /// An interrupted session of the sample, made at this minute.
        fn make(&self, sample: &str, minute: u32) -> String {
            session(
                &self.sessions(),
                sample,
                &format!("2026-11-21T02:{minute:02}:00Z"),
            )
        }
    }

    fn next(queue: &Queue) -> (String, usize, usize) {
        match queue.step() {
            Step::Capture { sample, run, of } => (sample.name, run, of),
            step => panic!("{step:?}"),
        }
    }

    fn capture(bench: &Bench, queue: &mut Queue, sample: &str, minute: u32) -> String {
        queue.next(sample).unwrap();
        let session = bench.make(sample, minute);
        queue.begun(sample, &session).unwrap();
        queue.captured(&session).unwrap();
        queue.done(&session, Some(Verdict::Explains), None).unwrap();
        session
    }

    #[test]
    fn a_queue_goes_through_its_samples_and_knows_it_when_opened_again() {
        let bench = Bench::new();
        let mut queue = bench.open().unwrap();
        assert_eq!(next(&queue), ("cup".to_owned(), 1, 1));
        assert_eq!((queue.left(), queue.again().unwrap()), (4, None));
        capture(&bench, &mut queue, "cup", 1);
        assert_eq!(next(&queue), ("bowl".to_owned(), 1, 2));
        // The cup once more, then on with the bowl.
        assert_eq!(queue.again().unwrap().as_deref(), Some("cup"));
        assert_eq!(next(&queue), ("cup".to_owned(), 2, 2));
        drop(queue);
        let mut queue = bench.open().unwrap();
        assert_eq!(next(&queue), ("cup".to_owned(), 2, 2));
        capture(&bench, &mut queue, "cup", 2);
        capture(&bench, &mut queue, "bowl", 3);
        assert_eq!(next(&queue), ("bowl".to_owned(), 2, 2));
        queue.leave_out("bowl", None).unwrap();
        assert_eq!(next(&queue), ("jar".to_owned(), 1, 1));
        queue.leave_out("jar", None).unwrap();
        assert_eq!(queue.step(), Step::End);
        drop(queue);
        let queue = bench.open().unwrap();
        assert_eq!((queue.step(), queue.left()), (Step::End, 0));
        let samples: Vec<_> = queue
            .entries()
            .iter()
            .map(|run| run.sample.as_str())
            .collect();
        assert_eq!(samples, ["cup", "cup", "bowl"]);
        let left_out = queue.samples().iter().map(|of| queue.left_out_of(of));
        assert_eq!(left_out.collect::<Vec<_>>(), [0, 1, 1]);
        drop(queue);
        // What was left out is known with its reason, and can be brought back.
        let mut queue = bench.open().unwrap();
        queue.take_back("jar").unwrap();
        assert_eq!(next(&queue), ("jar".to_owned(), 1, 1));
        queue.leave_out("jar", Some("broken")).unwrap();
        drop(queue);
        let queue = bench.open().unwrap();
        let out = queue.left_out(&queue.samples()[2]).unwrap();
        assert_eq!((out.sessions, out.reason.as_deref()), (1, Some("broken")));
        drop(queue);
        // A higher number asks for what was left out.
        let list = LIST.replace("repeats = 2", "repeats = 3");
        std::fs::write(bench.folder.path().join("samples.toml"), list).unwrap();
        assert_eq!(next(&bench.open().unwrap()), ("bowl".to_owned(), 3, 3));
    }

    /// Killed after each of its writes, it does nothing twice and forgets nothing.
    #[test]
    fn a_killed_queue_goes_on_with_what_it_had_begun() {
        let bench = Bench::new();
        let mut queue = bench.open().unwrap();
        queue.next("cup").unwrap();
        drop(queue);
        // Before the session was made.
        let mut queue = bench.open().unwrap();
        assert_eq!(next(&queue), ("cup".to_owned(), 1, 1));
        queue.next("cup").unwrap();
        drop(queue);
        // After it was made, before the journal had its name.
        let made = bench.make("cup", 5);
        let queue = bench.open().unwrap();
        let session = bench.sessions().join(&made);
        let resumed = Step::Resume {
            sample: "cup".to_owned(),
            session: session.clone(),
        };
        assert_eq!(queue.step(), resumed);
        drop(queue);
        let queue = bench.open().unwrap();
        assert_eq!(queue.step(), resumed, "known without its search");
        assert_eq!(queue.entries().len(), 1);
        drop(queue);
        // After the capture was complete, before the journal said so.
        let disk = std::sync::Arc::new(crate::session::commit::SystemDisk);
        let mut writer = crate::session::SessionWriter::open(disk, &session).unwrap();
        writer.finish().unwrap();
        let mut queue = bench.open().unwrap();
        assert_eq!(queue.step(), Step::Fit { session });
        queue
            .done(&made, None, Some("no light".to_owned()))
            .unwrap();
        assert_eq!(next(&queue).0, "bowl");
        // A session that was removed is captured anew.
        drop(queue);
        std::fs::remove_dir_all(bench.sessions().join(&made)).unwrap();
        assert_eq!(next(&bench.open().unwrap()), ("cup".to_owned(), 1, 1));
    }

    /// Emptied, or with a named pipe in the place of its journal.
    #[test]
    fn a_session_that_is_none_any_more_is_named_and_captured_anew() {
        let bench = Bench::new();
        let mut queue = bench.open().unwrap();
        let names: Vec<_> = ["cup", "bowl", "bowl"]
            .into_iter()
            .zip(1..)
            .map(|(sample, minute)| capture(&bench, &mut queue, sample, minute))
            .collect();
        drop(queue);
        for (name, has_pipe) in [(&names[0], false), (&names[1], true)] {
            let session = bench.sessions().join(name);
            std::fs::remove_dir_all(&session).unwrap();
            std::fs::create_dir(&session).unwrap();
            if has_pipe {
                let (pipe, mode) = (session.join("journal.jsonl"), rustix::fs::Mode::RUSR);
                rustix::fs::mkfifoat(rustix::fs::CWD, pipe, mode).unwrap();
            }
        }
        let queue = bench.open().unwrap();
        let named: Vec<_> = queue.unreadable().iter().map(|one| &one.session).collect();
        assert_eq!(named, [&names[0], &names[1]]);
        assert_eq!(next(&queue), ("cup".to_owned(), 1, 1));
        assert_eq!((queue.entries().len(), queue.left()), (1, 3));
    }

    #[test]
    fn an_interrupted_capture_can_be_left_as_it_is() {
        let bench = Bench::new();
        let mut queue = bench.open().unwrap();
        queue.next("cup").unwrap();
        let made = bench.make("cup", 7);
        queue.begun("cup", &made).unwrap();
        queue.abandon(&made).unwrap();
        assert_eq!(next(&queue).0, "bowl");
    }

    #[test]
    fn torn_lines_are_dropped_and_foreign_ones_refused() {
        let bench = Bench::new();
        let mut queue = bench.open().unwrap();
        queue.leave_out("cup", None).unwrap();
        let locked = bench.open();
        assert!(
            matches!(locked, Err(QueueError::Locked { .. })),
            "{locked:?}"
        );
        drop(queue);
        let path = bench.sessions().join("samples.queue.jsonl");
        let whole = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, format!("{whole}{{\"utc\":\"20")).unwrap();
        assert_eq!(next(&bench.open().unwrap()).0, "bowl");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), whole);
        for (text, line) in [("{}\n", 1), (&*whole.replace("left_out", "cast_out"), 2)] {
            std::fs::write(&path, text).unwrap();
            let error = bench.open().unwrap_err().to_string();
            assert!(error.contains(&format!("line {line}:")), "{error}");
        }
    }

    #[test]
    fn names_of_other_sessions_are_taken() {
        let bench = Bench::new();
        let taken = bench.make("bowl", 1);
        let error = bench.open().unwrap_err();
        assert!(matches!(error, QueueError::Taken(_)), "{error}");
        assert!(error.to_string().contains(&taken), "{error}");
        // But not those of a repeat, whose earlier session is nobody's.
        let again = LIST.replace("repeats = 2", "again = true");
        std::fs::write(bench.folder.path().join("samples.toml"), again).unwrap();
        let mut queue = bench.open().unwrap();
        queue.leave_out("cup", None).unwrap();
        queue.next("bowl").unwrap();
        drop(queue);
        assert_eq!(next(&bench.open().unwrap()), ("bowl".to_owned(), 1, 1));
    }

    #[test]
    fn fits_that_others_made_are_taken_over() {
        let bench = Bench::new();
        let mut queue = bench.open().unwrap();
        let failed = Some("the disk is full".to_owned());
        let made: Vec<String> = [(0, "cup"), (1, "bowl"), (2, "bowl")]
            .map(|(minute, sample)| {
                queue.next(sample).unwrap();
                let session = bench.make(sample, minute);
                queue.begun(sample, &session).unwrap();
                queue.captured(&session).unwrap();
                session
            })
            .into();
        queue.done(&made[0], None, failed.clone()).unwrap();
        queue.done(&made[1], None, None).unwrap();
        drop(queue);
        let states = |queue: &Queue| -> Vec<RunState> {
            let entries = queue.entries().iter();
            entries.map(|entry| entry.state.clone()).collect()
        };
        let done = |verdict, error| RunState::Done { verdict, error };
        let before = vec![done(None, failed), done(None, None), RunState::Captured];
        assert_eq!(states(&bench.open().unwrap()), before);

        let fit = crate::session::example::fit();
        for session in &made {
            add_fit(&bench.sessions(), session, &fit);
        }
        let queue = bench.open().unwrap();
        assert_eq!(states(&queue), vec![done(Some(fit.verdict()), None); 3]);
        assert_eq!(next(&queue), ("jar".into(), 1, 1));
    }
}
