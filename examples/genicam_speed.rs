//! How much longer a capture takes than its exposures, motion and settling, with a camera that
//! is triggered (a simulated GigE Vision device through libaravis) and with one that runs
//! freely (the simulated camera in memory), on the same simulated bench in real time:
//! `cargo run --release --features genicam --example genicam_speed [LIGHTS]`.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use std::net::Ipv4Addr;
use std::path::Path;

use mock_cameras::gige::{Exposer, GigeCamera};
use mock_devices::sensor::SensorModel;
use rig::capture::open::Devices;
use rig::capture::prepare::{CaptureRequest, Lights, prepare};
use rig::capture::{Observer, Progress, Spent};
use rig::config::{BUILT_IN, ResolvedRig, Surroundings, resolve_rig};
use rig::device::described::Description;
use rig::device::simulated::SimulatedBench;
use rig::device::{CameraInfo, Mosaic, genicam};
use rig::interrupt::Interrupt;
use rig::units::Seconds;

/// Keeps where the time went.
#[derive(Default)]
struct Time(Option<Spent>);

impl Observer for Time {
    fn observe(&mut self, progress: &Progress) {
        if let Progress::Ended {
            spent: Some(spent), ..
        } = progress
        {
            self.0 = Some(*spent);
        }
    }
}

type Any = Box<dyn std::error::Error>;

fn main() -> Result<(), Any> {
    let lights = match std::env::args().nth(1) {
        Some(lights) => lights.parse()?,
        None => 4,
    };
    for is_triggered in [true, false] {
        let folder = tempfile::tempdir()?;
        let rig = quick_bench(folder.path(), is_triggered)?;
        let spent = capture(&rig, lights, is_triggered)?;
        let camera = if is_triggered {
            "triggered"
        } else {
            "free-running"
        };
        println!(
            "{camera}: {lights} lights in {:.1} s, {spent}",
            spent.wall_s
        );
    }
    Ok(())
}

/// The simulated bench with a camera of 64 × 64 pixels, whose simulation and scene take less
/// time than a frame, in this folder with the records of its sensor. A frame that is triggered
/// has no older settings.
fn quick_bench(folder: &Path, is_triggered: bool) -> Result<ResolvedRig, Any> {
    // The rig file.
    let (real, simulation) = BUILT_IN[0]
        .1
        .split_once("[simulation]")
        .ok_or("simulation")?;
    let mut text = format!("{real}[simulation]");
    for line in simulation.lines() {
        let key = line.split_once(" = ").map(|(key, _)| key);
        text += match key {
            Some("samples_per_pixel") => "samples_per_pixel = 2",
            Some("max_reflections") => "max_reflections = 2",
            Some("segments") => "segments = 32",
            _ => line,
        };
        text += "\n";
    }
    for (key, small) in [
        ("\nresolution_px = [640, 480]", "\nresolution_px = [64, 64]"),
        ("\nextent_mm = [29.3, 22.0]", "\nextent_mm = [22.0, 22.0]"),
        ("\npoint_spread_px = 0.5", "\npoint_spread_px = 0.0"),
    ] {
        text = text.replacen(key, small, 1);
    }
    let file = folder.join("rig.toml");
    std::fs::write(&file, text)?;
    // The records.
    let records =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/small_bench/calibration");
    for kind in ["sensor", "flat", "scale"] {
        let to = folder.join("calibration/simulated").join(kind);
        std::fs::create_dir_all(&to)?;
        for entry in std::fs::read_dir(records.join(kind))? {
            let entry = entry?;
            std::fs::copy(entry.path(), to.join(entry.file_name()))?;
        }
    }
    let file = file.display().to_string();
    let mut rig = resolve_rig(Some(&file), &Surroundings::of_process(), Vec::new)?;
    if is_triggered {
        rig.config.camera.settings_latency_frames = 0;
    }
    Ok(rig)
}

fn capture(rig: &ResolvedRig, lights: usize, is_triggered: bool) -> Result<Spent, Any> {
    // The bench and its camera.
    let simulated = rig
        .config
        .simulated_bench()
        .ok_or("the rig is not simulated")?;
    let bench = SimulatedBench::start(simulated)?;
    let scene = rig.config.truth()?.ok_or("the rig has no true scene")?;
    let address = Ipv4Addr::new(127, 0, 0, 91);
    let exposer = Exposer::new(
        bench.config().camera.clone(),
        SensorModel::new(bench.config().sensor.clone()),
        scene.clone(),
        bench.bench().clone(),
    );
    let _device = GigeCamera::start(address, &bench.config().camera_serial, exposer)?;
    let camera = match is_triggered {
        true => (genicam::DRIVER.open)(address.to_string().as_ref(), description(rig))?,
        false => Box::new(bench.open_camera(scene)),
    };
    // The capture.
    let folder = tempfile::tempdir()?;
    let parent = folder.path().display().to_string();
    let request = CaptureRequest::new(Lights::Count(lights), &parent);
    let devices = Devices::new(Box::new(bench.open_stage()?), camera);
    let job = prepare(rig, &request, &mut |_| ())?.begin(devices, &mut |_| ())?;
    let mut time = Time::default();
    job.run(&mut time, Interrupt::new())?;
    Ok(time.0.ok_or("the capture did not end")?)
}

fn description(rig: &ResolvedRig) -> Description {
    let camera = &rig.config.camera;
    Description {
        info: CameraInfo {
            driver: genicam::DRIVER.name.to_owned(),
            model: String::new(),
            serial: camera.serial.clone().unwrap_or_default(),
            resolution_px: camera.resolution_px,
            bit_depth: camera.bit_depth,
            mosaic: Mosaic::None,
            exposure_range: camera.exposure_range,
            exposure_step: camera.exposure_step,
        },
        // The first frame of each light is rendered meanwhile.
        timeout: Seconds(60.0),
        keeper: None,
    }
}
