//! Captures a material on the simulated bench and fits it, as `rig capture --rig simulated
//! --lights 2` does: `cargo run --release --example simulate_capture -- FOLDER`. The stage is
//! GRBL firmware on a pseudo-terminal, the frames come from a sensor model; the drivers are
//! those of a real bench. Takes about a minute.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program that prints its result"
)]

use std::path::PathBuf;

use rig::capture::open::{OpenOptions, open_devices};
use rig::capture::prepare::{CaptureRequest, Lights, prepare};
use rig::config::{Surroundings, resolve_rig};
use rig::interrupt::Interrupt;
use rig::workflow::{FitRequest, fit_session};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args_os()
        .nth(1)
        .map_or("sessions".into(), PathBuf::from);
    std::fs::create_dir_all(&folder)?;

    // The plan: nothing moves yet.
    let rig = resolve_rig(Some("simulated"), &Surroundings::of_process(), Vec::new)?;
    let request = CaptureRequest::new(Lights::Count(2), &folder);
    let prepared = prepare(&rig, &request, &mut |notice| eprintln!("{notice:?}"))?;
    for light in &prepared.plan().lights {
        println!("light at {light}");
    }

    // The capture: frames, radiance images, journal.
    let devices = open_devices(&rig.config, &OpenOptions::default())?;
    let job = prepared.begin(devices, &mut |_| ())?;
    let session = job.root().to_owned();
    job.run(&mut (), Interrupt::new())?;

    // The fit, with the rig file's options.
    let fitted = fit_session(&session, &FitRequest::default(), &())?;
    println!(
        "{}: {}",
        fitted.folder.display(),
        fitted.record.verdict().sentence()
    );
    if let Some(score) = &fitted.record.score {
        let error = score.environment_error.estimate.overall;
        println!("error against the true {}: {error:.3}", score.truth);
    }
    Ok(())
}
