//! Many samples at one bench: which comes next, what became of each, kept on disk so that an
//! interrupted queue goes on where it was.
//!
//! - [`SampleList`]: the file that names the samples;
//! - [`list_of_table`]: such a file from a table of samples;
//! - [`Queue`]: the next [`Step`], and what was done, in a journal next to the sessions;
//! - [`QueueError`]: what can be wrong with either.
//!
//! The queue captures nothing itself and asks nobody: whoever uses it carries out its steps and
//! tells it what came of them.
//!
//! ```
//! use rig_bench::queue::{Queue, Step};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let folder = tempfile::tempdir()?;
//! let samples = folder.path().join("samples.toml");
//! std::fs::write(&samples, "[[sample]]\nname = \"cup\"\nrepeats = 2\n")?;
//! let mut queue = Queue::open(&samples, &folder.path().join("sessions"))?;
//! let Step::Capture { sample, run, of } = queue.step() else { panic!() };
//! assert_eq!((sample.name.as_str(), run, of), ("cup", 1, 2));
//! queue.leave_out("cup", None)?;
//! assert_eq!(queue.step(), Step::End);
//! # Ok(())
//! # }
//! ```

mod error;
mod journal;
mod list;
pub mod overview;
mod state;
mod table;
mod work;

pub use error::QueueError;
pub use journal::JOURNAL_ENDING;
pub use list::{Sample, SampleList};
pub use state::{Entry, Omission, Queue, RunState, Step, Unreadable};
pub use table::{TableError, list_of_table};
pub use work::{Answer, Fitted, Question, Worker, carry_out};
