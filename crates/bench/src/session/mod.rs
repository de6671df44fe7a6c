//! A capture on disk: the folder, its journal, and what makes both trustworthy.
//!
//! ```text
//! <UTC 20261121T023400Z>_<sample>_<short id>/
//!   session.toml      plan, configuration, versions, seed, calibration; written once
//!   journal.jsonl     append-only records, each with its CRC, fsynced
//!   raw/L003_E02_R00_light.png    16-bit counts, immutable; .toml next to it: how it was taken
//!   calibration/      copies of what was used
//!   derived/radiance_L003.exr     merged radiance; can be made again
//!   fits/<n>/         one folder per fit
//!   validations/<n>/  one folder per validation
//!   report.html
//!   manifest-sha256.txt           for `sha256sum -c`
//!   quarantine/<n>/   what a resume found without a journal record
//! ```
//!
//! *Finished* means journalled: a file counts from the moment when its record,
//! with its SHA-256, is in the journal. A journal without a stop record is an
//! interrupted session, which can be resumed. One process writes at a time
//! (the journal is locked).
//!
//! [`Session`] reads, [`SessionWriter`] adds, [`verify`](verify::verify)
//! checks every byte, [`archive`] makes one file of it. All writing goes through [`commit::Disk`], so that a test
//! can fail each operation ([`faults`]).

pub mod archive;
pub(crate) mod captured_rig;
pub mod commit;
mod decision;
pub mod drift;
mod error;
#[doc(hidden)]
pub mod example;
pub mod faults;
pub mod fit_record;
pub mod frame;
pub mod journal;
mod journalled;
pub mod layout;
pub mod record;
mod store;
pub mod validation;
pub mod verify;

pub use captured_rig::{SceneFileError, scene_files};
pub use decision::{Decision, Ranked, Stop, Until};
pub use drift::{LampDrift, REVISIT_ROUND};
pub use error::SessionError;
pub use frame::{FrameTimes, Sidecar};
pub use journal::{Event, FileDigest, Journal, Record};
pub use record::{CalibrationCopy, ExposureRules, PlanRecord, SessionRecord, Versions};
pub use store::LARGEST_RECORD_BYTES;
pub(crate) use store::utc_now;
pub use store::{FrameEntry, NewSession, Session, SessionState, SessionWriter, lock_for_job};
