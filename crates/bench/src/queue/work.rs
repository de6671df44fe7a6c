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
    /// All is done: whether the last sample is to be repeated, or what was left out captured
    /// after all, of which this is the first.
    Done {
        last: Option<&'a str>,
        left_out: Option<&'a str>,
    },
}

/// What the operator answers.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Answer {
    Go,
    Repeat,
    /// With a reason.
    LeaveOut(Option<String>),
    /// All that was left out is to be captured.
    TakeBack,
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
                    Answer::LeaveOut(_) => queue.abandon(&name)?,
                    Answer::Go | Answer::Repeat | Answer::TakeBack => {
                        capture(queue, worker, worker.resume(&session)?, &name)?;
                    }
                }
                true
            }
            Step::Fit { session } => fit(queue, worker, &session).map(|()| true)?,
            Step::Capture { sample, run, of } => next(queue, worker, &sample, run, of)?,
            Step::End => end(queue, worker)?,
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
        Answer::LeaveOut(reason) => queue.leave_out(&sample.name, reason.as_deref())?,
        Answer::Repeat => drop(queue.again()?),
        Answer::Go | Answer::TakeBack => {
            queue.next(&sample.name)?;
            let job = worker.begin(sample)?;
            let session = name_of(job.root());
            queue.begun(&sample.name, &session)?;
            capture(queue, worker, job, &session)?;
        }
    }
    Ok(true)
}

/// When all is done, the last sample can still be repeated, and what was left out be captured;
/// whether the queue goes on.
fn end<W: Worker>(queue: &mut Queue, worker: &W) -> Result<bool, W::Error> {
    let is_left_out = |of: &&Sample| queue.left_out(of).is_some();
    let left_out = queue.samples().iter().filter(is_left_out);
    let left_out: Vec<_> = left_out.map(|sample| sample.name.clone()).collect();
    let question = Question::Done {
        last: queue.last(),
        left_out: left_out.first().map(String::as_str),
    };
    if matches!(
        question,
        Question::Done {
            last: None,
            left_out: None
        }
    ) {
        return Ok(false);
    }
    match worker.ask(question)? {
        Answer::Repeat => Ok(queue.again()?.is_some()),
        Answer::TakeBack => {
            // The last one taken back comes first.
            for name in left_out.iter().rev() {
                queue.take_back(name)?;
            }
            Ok(!left_out.is_empty())
        }
        _ => Ok(false),
    }
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
    let (verdict, error) = match worker.fit(root)? {
        Fitted::Verdict(verdict) => (verdict, None),
        Fitted::Failed(fact) => (None, Some(fact)),
    };
    Ok(queue.done(&session, verdict, error)?)
}

fn name_of(root: &Path) -> String {
    let name = root.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;
    use crate::session::example::session;

    /// Answers in this order, and keeps the questions.
    struct Scripted(RefCell<Vec<Answer>>, RefCell<Vec<String>>);

    impl Worker for Scripted {
        type Error = QueueError;

        fn ask(&self, question: Question<'_>) -> Result<Answer, QueueError> {
            self.1.borrow_mut().push(match question {
                Question::Put {
                    sample, run, of, ..
                } => format!("{} {run}/{of}", sample.name),
                Question::Resume { sample } => format!("resume {sample}"),
                Question::Done { last, left_out } => format!("done {last:?} {left_out:?}"),
            });
            Ok(self.0.borrow_mut().remove(0))
        }

        fn begin(&self, _: &Sample) -> Result<Job, QueueError> {
            unreachable!("no sample is put on the bench")
        }

        fn resume(&self, _: &Path) -> Result<Job, QueueError> {
            unreachable!("no session is resumed")
        }

        fn capture(&self, _: Job) -> Result<(), QueueError> {
            unreachable!("nothing is captured")
        }

        fn fit(&self, root: &Path) -> Result<Fitted, QueueError> {
            self.1.borrow_mut().push(format!("fit {}", root.is_dir()));
            Ok(Fitted::Failed("dark".to_owned()))
        }
    }

    #[test]
    fn what_is_interrupted_and_not_fitted_comes_before_the_next_sample() {
        let home = tempfile::tempdir().unwrap();
        let list = home.path().join("list.toml");
        std::fs::write(&list, "[[sample]]\nname = \"cup\"\nrepeats = 2\n").unwrap();
        let sessions = home.path().join("sessions");
        std::fs::create_dir(&sessions).unwrap();
        let mut queue = Queue::open(&list, &sessions).unwrap();
        let names = ["2026-11-21T02:34:00Z", "2026-11-21T03:34:00Z"];
        let names = names.map(|began| session(&sessions, "cup", began));
        for name in &names {
            queue.begun("cup", name).unwrap();
        }
        queue.captured(&names[1]).unwrap();
        let worker = |answers: &[Answer]| Scripted(answers.to_vec().into(), RefCell::default());
        // An interrupted session is left, the other one's fit holds nothing up, one more is
        // wanted and left out, taken back and left out again.
        let answers = [
            Answer::LeaveOut(None),
            Answer::Repeat,
            Answer::LeaveOut(Some("broken".to_owned())),
            Answer::TakeBack,
            Answer::LeaveOut(None),
            Answer::Go,
        ];
        let went = worker(&answers);
        carry_out(&mut queue, &went).unwrap();
        let asked = [
            "resume cup",
            "fit true",
            "done Some(\"cup\") None",
            "cup 3/3",
            "done Some(\"cup\") Some(\"cup\")",
            "cup 3/3",
            "done Some(\"cup\") Some(\"cup\")",
        ];
        assert_eq!(*went.1.borrow(), asked);
        assert_eq!(queue.left(), 0);
    }
}
