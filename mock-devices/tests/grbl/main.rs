//! The simulated GRBL controller as a host on its pseudo-terminal sees it.

mod faults;
mod host;
mod motion;
mod protocol;
