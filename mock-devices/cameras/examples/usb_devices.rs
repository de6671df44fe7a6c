//! A simulated USB camera and a simulated light stage on a USB serial port, for
//! the kernel's own drivers: obeys one command per line of its input, confirms
//! each on its output, and runs until its input ends. Needs root and `vhci-hcd`.
//!
//! `camera in|out|stall|obey|ignore|silent|send`, `camera damage|cut FRAMES`,
//! `stage in|ftdi|out|lamp|angles`: behind `cdc_acm`, or behind `ftdi_sio`.

use std::io::{self, BufRead, Write};
use std::sync::Arc;

use mock_cameras::usb::Plugged;
use mock_cameras::usb::camera::{CameraFaults, UsbCamera};
use mock_cameras::usb::ftdi::UsbFtdi;
use mock_cameras::usb::serial::UsbSerial;
use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::clock::Clock;
use mock_devices::grbl::{GrblConfig, GrblSimulator};
use mock_devices::sensor::{SensorConfig, SensorModel};
use mock_devices::{Illumination, RadianceSource};

const WIDTH: u32 = 128;
const HEIGHT: u32 = 96;

/// A matte plane with a ramp of reflectance from left to right, and some light
/// of the room.
struct Ramp;

impl RadianceSource for Ramp {
    fn resolution_px(&self) -> [u32; 2] {
        [WIDTH, HEIGHT]
    }

    fn radiance(&self, light: &Illumination) -> Arc<Vec<f32>> {
        let irradiance: f64 = light
            .channels
            .iter()
            .zip([2.0, 2.5, 1.5])
            .map(|(p, e)| p * e)
            .sum();
        let cosine = light.elevation_rad.sin().max(0.0);
        let pixel = |at: u32| {
            let reflectance = 0.1 + 0.8 * f64::from(at % WIDTH) / f64::from(WIDTH);
            (0.002 + reflectance * irradiance * cosine / std::f64::consts::PI) as f32
        };
        Arc::new((0..WIDTH * HEIGHT).map(pixel).collect())
    }
}

struct Devices {
    bench: Bench,
    firmware: GrblSimulator,
    camera: Option<(Plugged, CameraFaults)>,
    stage: Option<Plugged>,
}

impl Devices {
    fn new() -> io::Result<Self> {
        let bench = Bench::new(BenchConfig::default(), Clock::real_time());
        let firmware = GrblSimulator::spawn(GrblConfig::default(), bench.clone())?;
        Ok(Self {
            bench,
            firmware,
            camera: None,
            stage: None,
        })
    }

    fn obey(&mut self, command: &str) -> io::Result<String> {
        let words: Vec<&str> = command.split_whitespace().collect();
        match words[..] {
            ["camera", "in"] => {
                let sensor = SensorModel::new(SensorConfig::typical([WIDTH, HEIGHT], 1));
                let camera = UsbCamera::new("CAM0001", sensor, Arc::new(Ramp), self.bench.clone());
                let faults = camera.faults();
                self.camera = Some((Plugged::into_free_port(camera)?, faults));
            }
            ["camera", "out"] => self.camera = None,
            ["camera", ref fault @ ..] => {
                let (_, camera) = self.camera.as_ref().ok_or(io::ErrorKind::NotConnected)?;
                fail(camera, fault)?;
            }
            ["stage", "in"] => {
                let serial = UsbSerial::new("STAGE0001", self.firmware.path().to_owned());
                self.stage = Some(Plugged::into_free_port(serial)?);
            }
            ["stage", "ftdi"] => {
                let serial = UsbFtdi::new("STAGE0002", self.firmware.path().to_owned());
                self.stage = Some(Plugged::into_free_port(serial)?);
            }
            ["stage", "out"] => self.stage = None,
            ["stage", "lamp"] => return Ok(format!("{:?}", self.bench.lamp_drive())),
            ["stage", "angles"] => return Ok(format!("{:.3?}", self.bench.stage_angles_deg())),
            _ => return Err(io::ErrorKind::InvalidInput.into()),
        }
        Ok(String::new())
    }
}

fn fail(camera: &CameraFaults, words: &[&str]) -> io::Result<()> {
    let number = |text: &str| text.parse().map_err(|_| io::ErrorKind::InvalidInput);
    let mut faults = camera.now();
    match words {
        ["stall"] => faults.stalls_exposure = true,
        ["ignore"] => faults.ignores_exposure = true,
        ["obey"] => {
            faults.stalls_exposure = false;
            faults.ignores_exposure = false;
        }
        ["silent"] => faults.silent = true,
        ["send"] => faults.silent = false,
        ["damage", frames] => faults.damaged = number(frames)?,
        ["cut", frames] => faults.cut = number(frames)?,
        _ => return Err(io::ErrorKind::InvalidInput.into()),
    }
    Ok(())
}

fn main() -> io::Result<()> {
    let mut devices = Devices::new()?;
    let mut out = io::stdout();
    for line in io::stdin().lock().lines() {
        let line = line?;
        match devices.obey(&line) {
            Ok(answer) => writeln!(out, "done: {line} {answer}")?,
            Err(error) => writeln!(out, "failed: {line}: {error}")?,
        }
        out.flush()?;
    }
    Ok(())
}
