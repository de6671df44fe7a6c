//! A queue from its next step to its end: what is asked of the operator, captured, fitted and
//! noted, in which order.

use std::path::Path;

use super::{Queue, QueueError, Sample, Step};
use crate::capture::prepare::Job;
use crate::session::fit_record::Verdict;

/// What the operator is asked.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum Question<'a> {
    /// Whether this sample lies on the bench, for its run of so many planned.
    Put {
        sample: &'a Sample,
        run: usize,
        of: usize,
        /// The sample that was captured last can be repeated instead.
        can_repeat: bool,
    },
    /// Whether the sample of an interrupted capture lies there as it did.
    Resume { sample: &'a str },
    /// All is done: whether the last sample is to be repeated.
    Done { last: &'a str },
}

/// What the operator answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Answer {
    Go,
    Repeat,
    LeaveOut,
    Quit,
}

/// What came of a session's fit.
#[derive(Clone, Debug, PartialEq)]
pub enum Fitted {
    /// Its verdict; `None` where no fits are made.
    Verdict(Option<Verdict>),
    /// Why it could not be fitted, which holds up no queue.
    Failed(String),
}

/// Who carries out the steps of a queue.
pub trait Worker {
    /// Why a step ends the queue.
    type Error: From<QueueError>;

    /// Asks the operator.
    fn ask(&self, question: Question<'_>) -> Result<Answer, Self::Error>;

    /// A new session of a sample, with its devices.
    fn begin(&self, sample: &Sample) -> Result<Job, Self::Error>;

    /// An interrupted session with its devices.
    fn resume(&self, root: &Path) -> Result<Job, Self::Error>;

    /// Captures to the end.
    fn capture(&self, job: Job) -> Result<(), Self::Error>;

    /// Fits a session.
    fn fit(&self, root: &Path) -> Result<Fitted, Self::Error>;
}

/// Goes through the queue until it is at its end or the operator quits.
///
/// # Errors
/// What a step meets, or a journal that cannot be written.
pub fn carry_out<W: Worker>(queue: &mut Queue, worker: &W) -> Result<(), W::Error> {
    loop {
        let goes_on = match queue.step() {
            Step::Resume { sample, session } => {
                let name = name_of(&session);
                match worker.ask(Question::Resume { sample: &sample })? {
                    Answer::Quit => return Ok(()),
                    Answer::LeaveOut => queue.abandon(&name)?,
                    Answer::Go | Answer::Repeat => {
                        capture(queue, worker, worker.resume(&session)?, &name)?;
                    }
                }
                true
            }
            Step::Fit { session } => fit(queue, worker, &session).map(|()| true)?,
            Step::Capture { sample, run, of } => next(queue, worker, &sample, run, of)?,
            Step::End => match queue.last() {
                None => false,
                Some(last) => match worker.ask(Question::Done { last })? {
                    Answer::Repeat => queue.again()?.is_some(),
                    _ => false,
                },
            },
        };
        if !goes_on {
            return Ok(());
        }
    }
}

/// Asks for a sample and captures it; whether the queue goes on.
fn next<W: Worker>(
    queue: &mut Queue,
    worker: &W,
    sample: &Sample,
    run: usize,
    of: usize,
) -> Result<bool, W::Error> {
    let can_repeat = queue.last().is_some();
    let question = Question::Put {
        sample,
        run,
        of,
        can_repeat,
    };
    match worker.ask(question)? {
        Answer::Quit => return Ok(false),
        Answer::LeaveOut => queue.leave_out(&sample.name)?,
        Answer::Repeat => drop(queue.again()?),
        Answer::Go => {
            queue.next(&sample.name)?;
            let job = worker.begin(sample)?;
            let session = name_of(job.root());
            queue.begun(&sample.name, &session)?;
            capture(queue, worker, job, &session)?;
        }
    }
    Ok(true)
}

/// Captures, then fits.
fn capture<W: Worker>(
    queue: &mut Queue,
    worker: &W,
    job: Job,
    session: &str,
) -> Result<(), W::Error> {
    let root = job.root().to_owned();
    worker.capture(job)?;
    queue.captured(session)?;
    fit(queue, worker, &root)
}

fn fit<W: Worker>(queue: &mut Queue, worker: &W, root: &Path) -> Result<(), W::Error> {
    let session = name_of(root);
    Ok(match worker.fit(root)? {
        Fitted::Verdict(verdict) => queue.done(&session, verdict, None)?,
        Fitted::Failed(fact) => queue.done(&session, None, Some(fact))?,
    })
}

fn name_of(root: &Path) -> String {
    let name = root.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}
