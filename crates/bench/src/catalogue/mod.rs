//! The sessions of one folder: which there are and what became of them, for the command line
//! and for the console alike.
//!
//! - [`Catalogue`]: the list, newest first; a session is read anew only when it has changed;
//! - [`row`]: one line of it;
//! - [`repeats`]: the sessions of one sample that can be compared;
//! - [`reproducibility`]: what their spread says about the uncertainty.
//!
//! ```
//! use rig_bench::catalogue::Catalogue;
//! use rig_bench::fault::Advisor;
//!
//! let catalogue = Catalogue::new("sessions", Advisor::silent());
//! for row in catalogue.list("red-plastic")? {
//!     println!("{} {} of {} lights", row.name, row.lights_finished, row.lights);
//! }
//! # Ok::<(), std::io::Error>(())
//! ```

mod list;
pub mod repeats;
pub mod reproducibility;
pub mod row;

pub use list::{Catalogue, Stamp, stamp};
pub use row::{FitRow, Row};
