//! Devices over their real protocols: answers, faults, silence, signals. Most of these wait.

#[path = "../support/camera.rs"]
mod camera_support;
#[path = "../support/capture.rs"]
mod capture_support;
#[path = "../support/command.rs"]
mod command_support;
#[path = "../support/signals.rs"]
mod signals;
#[path = "../support/small_bench/mod.rs"]
mod small_bench;

mod commands;
mod lamp_goes_off;
mod program_answers;
mod rough_handling;
mod rpicam;
mod stage_dialects;
mod stage_faults;
mod still_camera;
mod ways_out;
