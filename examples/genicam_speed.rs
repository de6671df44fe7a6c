//! How much longer a capture takes than its exposures, motion and settling, with a camera that
//! is triggered (a simulated GigE Vision device through libaravis) and with one that runs
//! freely (the simulated camera in memory), on the same simulated bench in real time:
//! `cargo run --release --features genicam --example genicam_speed [LIGHTS]`.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use std::net::Ipv4Addr;
use std::path::Path;

use mock_devices::gige::{Exposer, GigeCamera};
use mock_devices::sensor::SensorModel;
use rig::capture::open::Devices;
use rig::capture::prepare::{CaptureRequest, Lights, prepare};
use rig::capture::{Observer, Progress, Spent};
use rig::config::{BUILT_IN, ResolvedRig, RigConfig, Surroundings, resolve_rig};
use rig::device::described::Description;
use rig::device::simulated::SimulatedBench;
use rig::device::{CameraInfo, Mosaic, genicam};
use rig::interrupt::Interrupt;
use rig::units::Seconds;

/// Keeps where the time went.
#[derive(Default)]
struct Time(Option<Spent>);

impl Observer for Time {
    fn observe(&mut self, progress: Progress<'_>) {
        if let Progress::Ended(spent) = progress {
            self.0 = Some(spent);
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
        let spent = capture(&quick_bench(is_triggered)?, lights, is_triggered)?;
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

/// The simulated bench with a truth that is rendered in less than a frame takes. A frame that
/// is triggered has no older settings.
fn quick_bench(is_triggered: bool) -> Result<ResolvedRig, Any> {
    let (name, text) = BUILT_IN[0];
    let rig = resolve_rig(Some(name), &Surroundings::of_process(), Vec::new)?;
    let (real, simulation) = text.split_once("[simulation]").ok_or("no simulation")?;
    let quick = simulation.lines().map(|line| match line.split_once(" = ") {
        Some(("samples_per_pixel", _)) => "samples_per_pixel = 2\n".to_owned(),
        Some(("max_reflections", _)) => "max_reflections = 2\n".to_owned(),
        Some(("segments", _)) => "segments = 32\n".to_owned(),
        _ => format!("{line}\n"),
    });
    let quick: String = quick.collect();
    let text = format!("{real}[simulation]{quick}");
    let mut config = RigConfig::parse(name, Path::new(""), &text)?;
    if is_triggered {
        config.camera.settings_latency_frames = 0;
    }
    Ok(ResolvedRig { config, ..rig })
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
