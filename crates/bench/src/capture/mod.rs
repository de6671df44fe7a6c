//! A capture: planned as data, then carried out on a camera and a stage.
//!
//! - [`prepare`]: a capture as a program does it, from a rig file to a session;
//! - [`open`]: the devices of a rig file;
//! - [`records`], [`light_choice`]: calibration records it uses; the lights that are most informative;
//! - [`lights`]: which light directions are wanted;
//! - [`reach`]: where light can come from: the stage's limits, the camera's shadow;
//! - [`directions`]: which light directions, from what is within reach;
//! - [`plan`]: the whole plan with its estimates and checks, before anything moves;
//! - [`duration`]: how long that takes, by plan; a clock follows it frame by frame;
//! - [`bracket`]: which exposures a light needs, decided from its pilot frames;
//! - [`exposure_check`]: whether an exposure was what it claims, from the images;
//! - [`return_check`]: whether the lamp is back where it was, from the images;
//! - [`run`]: the execution, interruptible and resumable;
//! - [`Progress`]: what it reports meanwhile, to this program and others;
//! - [`event_lines`]: the same as lines of JSON, for other programs.
//!
//! Every decision during a run is a pure function of the plan and of the frames
//! taken so far. A resumed run therefore decides what the uninterrupted one
//! would have: it goes through the same steps and only takes the frames that
//! the session does not hold yet.

pub mod bracket;
mod clock;
mod devices;
pub mod directions;
mod disk;
pub mod duration;
mod error;
pub mod event_lines;
pub mod exposure_check;
pub mod findings;
pub mod light_choice;
pub mod lights;
mod merge_sink;
pub mod open;
mod pace;
pub mod plan;
pub mod prepare;
mod progress;
pub mod reach;
pub mod records;
pub mod region_of_interest;
pub mod remote_operator;
pub mod return_check;
pub mod run;
mod spent;
mod wall_clock;
mod worker;

pub use disk::{BracketSink, SinkError, WRITE_QUEUE};
pub use error::CaptureError;
pub use merge_sink::RadianceSink;
pub use progress::{DriftSpan, Ending, FrameEvent, HandWork, Observer, Outcome, Progress, Stamped};
pub use run::{Capture, Chooser};
pub use spent::Spent;
