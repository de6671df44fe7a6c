//! What is measured against what is true: transport, merges, calibrations, coverage.
#![allow(clippy::print_stdout, reason = "figures, next to the tests' names")]

#[path = "../support/capture.rs"]
mod capture_support;
#[path = "../support/command.rs"]
mod command_support;
#[path = "../support/small_bench/mod.rs"]
mod small_bench;

mod bodies;
mod coverage;
mod emva1288;
mod lamp_drift;
mod merging;
mod radiometry;
mod rehearsal;
mod truth;
