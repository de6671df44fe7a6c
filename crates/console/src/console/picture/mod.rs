//! Raw frames as pictures to look at, and what a page draws on them.
//!
//! - [`jpeg()`]: a frame as a JPEG of at most [`LARGEST_PX`] pixels a side;
//! - [`peaking`]: where a frame is in focus;
//! - [`outline`]: where the sample appears;
//! - [`levels`]: black level and full well on the histogram's axis;
//! - [`last_frame`]: the newest frame of a running capture, from the session's folder;
//! - [`live`]: the newest frame of the bench, encoded when a page requests it.

mod jpeg;
pub mod last_frame;
pub mod levels;
pub mod live;
pub mod outline;
pub mod peaking;
mod routes;

pub use jpeg::{Counts, LARGEST_PX, Marks, PictureError, jpeg, quantised};
pub use routes::{frame_routes, outline_routes};
