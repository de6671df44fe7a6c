//! `driver = "genicam"`: libaravis against a simulated GigE Vision device that looks at the
//! simulated bench, over loopback, and against Aravis' own fake camera.
#![allow(clippy::print_stdout, reason = "figures, next to the tests' names")]

#[path = "../support/camera.rs"]
mod camera_support;
#[path = "../support/small_bench/mod.rs"]
mod small_bench;
#[path = "../support/command.rs"]
mod support;

mod captures;
mod driver;
mod listing;
mod program;
mod stand;
