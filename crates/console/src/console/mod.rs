//! The bench in a browser: one server for the operator's page, for everything that the
//! page shows, and for the buttons on it.
//!
//! - [`hub`]: what is published to every page, newest state only.
//! - [`held_devices`]: camera and stage held open while nothing is captured.
//! - [`picture`]: frames as pictures.
//! - [`catalogue`]: the sessions of a folder, with their pictures and files.
//! - [`frames`]: the last captured frame.
//! - [`server`]: listening, who is let in, the stream of events, the page's files.
//! - [`jobs`]: captures, fits and exports as processes of this program, and short commands.
//! - [`facts`]: what a page learns about the rig.
//! - [`guides`]: calibrations from the placing of their target to their record.
//! - [`queue`]: many samples one after the other.
//! - [`rigs`]: the rig files of the folder, edited and chosen.
//! - [`control`]: which page controls the bench.
//! - [`whole`]: all of these put together, from start to end.
//!
//! Work that the command line can do is done by it: a capture or a fit that is started from
//! the page is `rig capture` or `rig fit` as a process of its own, so that nothing that
//! happens to the console can harm it.

mod blocking;
pub mod catalogue;
pub mod control;
pub mod facts;
pub mod frames;
pub mod guides;
pub mod held_devices;
pub mod hub;
pub mod jobs;
pub mod picture;
pub mod queue;
pub mod refusal;
pub mod request;
pub mod rigs;
pub mod server;
pub mod whole;
