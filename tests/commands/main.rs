//! Whole commands on files: what they print, write, refuse and advise.
#![allow(clippy::print_stdout, reason = "figures, next to the tests' names")]

#[path = "../support/command.rs"]
mod command_support;
#[path = "../support/fitted_session.rs"]
mod fitted_session;
#[path = "../support/signals.rs"]
mod signals;
#[path = "../support/small_bench/mod.rs"]
mod small_bench;

mod bad_calibration;
mod bad_input;
mod brdf;
mod calibrate;
mod camera;
mod camera_programs;
mod command_line;
mod design;
mod evaluate;
mod export;
mod fit;
mod focus;
mod glare;
mod init;
mod lights;
mod merge;
mod metrology;
mod nonsense;
mod outside;
mod outside_input;
mod plan;
mod pose;
mod recipes;
mod shape;
mod torch;
mod white;
