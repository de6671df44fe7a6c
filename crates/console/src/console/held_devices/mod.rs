//! The bench while nothing is captured: camera and stage held open by a thread of the
//! console, with a live picture, moves and lamps.
//!
//! - [`HeldDevices`]: what pages may do; never waits for a device.
//! - [`state`]: the topic `bench`.
//! - [`lamp_timer`]: when a lamp that was lit from a page goes out by itself.
//! - `held`: the devices, from opening to closing; `stage` and `camera`: the loops of the two
//!   threads that use them.
//!
//! Nothing here lights a lamp for longer than a page watches over it: see [`lamp_timer`], and
//! [`crate::device::guardian`] for what happens when this process doesn't go on.

mod camera;
mod handle;
mod held;
pub mod lamp_timer;
mod ports;
mod routes;
mod shared;
mod stage;
pub mod state;
mod stop;
#[cfg(test)]
mod tests;

pub use handle::{HeldDevices, Loan, StopBorrower};
pub use ports::{BenchPorts, Opened};
pub use routes::routes;
pub use stage::LampDisobeyed;
pub use stop::{NotStopped, Stopping, Unstopped};
