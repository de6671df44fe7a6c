//! Captures and their sessions: plans, frames, events, faults, resumption, queues, batches.

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

mod batch;
mod camera_faults;
mod command;
mod events;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
mod file_systems;
mod nothing_lost;
mod queue;
mod resume;
mod run;
mod session_faults;
mod tilted;
mod until;
