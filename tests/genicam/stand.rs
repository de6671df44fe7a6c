//! A simulated bench with a GigE Vision camera in front of it.

use std::net::Ipv4Addr;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

use mock_cameras::gige::{Exposer, GigeCamera};
use mock_devices::camera::CameraConfig;
use mock_devices::sensor::SensorModel;
use mock_devices::{Illumination, RadianceSource};
use rig::capture::open::Devices;
use rig::config::{ResolvedRig, Surroundings, resolve_rig};
use rig::device::described::Description;
use rig::device::simulated::SimulatedBench;
use rig::device::{Camera, CameraInfo, DeviceError, FrameKey, FrameKind, Mosaic, genicam};
use rig::units::Seconds;
use tempfile::TempDir;

use crate::support::workplace;

/// The serial number that the records of the small bench's sensor have.
pub const SERIAL: &str = "SIM-0001";
pub const KEY: FrameKey = FrameKey::new(0, 0, 0, FrameKind::Light);

type Action = Box<dyn FnOnce() + Send>;

/// A scene; at one of the frames that show it something happens.
pub struct Watched {
    scene: Arc<dyn RadianceSource>,
    frames: AtomicU32,
    action: Mutex<Option<(u32, Action)>>,
}

impl Watched {
    /// Acts when this many frames from now on have been exposed.
    pub fn after(&self, frames: u32, action: impl FnOnce() + Send + 'static) {
        let at = self.frames.load(Ordering::SeqCst) + frames;
        *self.action.lock().unwrap() = Some((at, Box::new(action)));
    }

    /// Whether what was to happen has happened.
    pub fn has_acted(&self) -> bool {
        self.action.lock().unwrap().is_none()
    }
}

impl RadianceSource for Watched {
    fn resolution_px(&self) -> [u32; 2] {
        self.scene.resolution_px()
    }

    fn radiance(&self, light: &Illumination) -> Arc<Vec<f32>> {
        let frame = self.frames.fetch_add(1, Ordering::SeqCst);
        let mut planned = self.action.lock().unwrap();
        if let Some((at, action)) = planned.take() {
            match frame < at {
                true => *planned = Some((at, action)),
                false => action(),
            }
        }
        self.scene.radiance(light)
    }
}

/// Lit evenly whatever the lamp does.
struct Card([u32; 2]);

impl RadianceSource for Card {
    fn resolution_px(&self) -> [u32; 2] {
        self.0
    }

    fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
        Arc::new(vec![0.05; (self.0[0] * self.0[1]) as usize])
    }
}

/// A bench, and a camera at an address of its own.
pub struct Stand {
    pub rig: ResolvedRig,
    pub bench: SimulatedBench,
    pub device: GigeCamera,
    pub scene: Arc<Watched>,
    pub folder: TempDir,
    pub address: Ipv4Addr,
}

impl Stand {
    /// Before the bench's own sample; `last` is the last part of the camera's address.
    pub fn new(last: u8) -> Self {
        Self::with(last, SERIAL, |text| text, None)
    }

    /// Before an evenly lit card of this many pixels a side.
    pub fn before_a_card(last: u8, serial: &str, side: u32) -> Self {
        Self::with(last, serial, |text| text, Some(side))
    }

    pub fn with(
        last: u8,
        serial: &str,
        change: impl FnOnce(String) -> String,
        card: Option<u32>,
    ) -> Self {
        let folder = workplace(|text| {
            // A frame that is triggered has no older settings.
            let latency = "\nsettings_latency_frames = 2";
            assert!(text.contains(latency));
            change(text.replacen(latency, "\nsettings_latency_frames = 0", 1))
        });
        let file = folder.path().join("rig.toml");
        let name = file.to_str().unwrap();
        let rig = resolve_rig(Some(name), &Surroundings::of_process(), Vec::new).unwrap();
        let bench = SimulatedBench::start(rig.config.simulated_bench().unwrap()).unwrap();
        let sensor = &bench.config().sensor;
        let (sensor, source): (_, Arc<dyn RadianceSource>) = match card {
            None => (sensor.clone(), rig.config.truth().unwrap().unwrap()),
            Some(side) => {
                let mut sensor = sensor.clone();
                sensor.resolution_px = [side; 2];
                (sensor, Arc::new(Card([side; 2])))
            }
        };
        let scene = Arc::new(Watched {
            scene: source,
            frames: AtomicU32::new(0),
            action: Mutex::default(),
        });
        let config = CameraConfig {
            noise_seed: bench.config().camera.noise_seed + 1,
            ..bench.config().camera.clone()
        };
        let address = Ipv4Addr::new(127, 0, 0, last);
        let exposer = Exposer::new(
            config,
            SensorModel::new(sensor),
            scene.clone(),
            bench.bench().clone(),
        );
        Self {
            device: GigeCamera::start(address, serial, exposer).unwrap(),
            rig,
            bench,
            scene,
            folder,
            address,
        }
    }

    pub fn description(&self) -> Description {
        let camera = &self.rig.config.camera;
        Description {
            info: CameraInfo {
                driver: "genicam".to_owned(),
                model: String::new(),
                serial: String::new(),
                resolution_px: self.scene.resolution_px(),
                bit_depth: camera.bit_depth,
                mosaic: Mosaic::None,
                exposure_range: camera.exposure_range,
                exposure_step: camera.exposure_step,
            },
            timeout: Seconds(4.0),
            keeper: None,
        }
    }

    /// The camera with features, such as `; BlackLevel = 80`.
    pub fn open_with(&self, features: &str) -> Result<Box<dyn Camera>, DeviceError> {
        let device = format!("{}{features}", self.address);
        (genicam::DRIVER.open)(device.as_ref(), self.description())
    }

    pub fn open(&self) -> Box<dyn Camera> {
        self.open_with("").unwrap()
    }

    pub fn devices(&self) -> Devices {
        let stage = Box::new(self.bench.open_stage().unwrap());
        Devices::new(stage, self.open())
    }

    pub fn is_lit(&self) -> bool {
        self.bench.bench().lamp_drive() != [0.0; 3]
    }

    /// A rig file for the program: this bench's stage on its port and this camera, as real
    /// devices.
    pub fn real_rig_file(&self, frame_timeout_s: f64) -> PathBuf {
        let file = self.folder.path().join("rig.toml");
        let text = std::fs::read_to_string(&file).unwrap();
        let (real, _) = text.split_once("[simulation]").unwrap();
        let camera = format!(
            "driver = \"genicam\"\ndevice = \"{}\"\nframe_timeout_s = {frame_timeout_s}",
            self.address
        );
        let port = self.bench.stage_config().port;
        let stage = format!("driver = \"grbl\"\nport = \"{port}\"");
        let real = real.replace("\nframe_timeout_s = 5.0", "");
        let mut parts = real.splitn(3, "driver = \"simulated\"");
        let mut part = || parts.next().unwrap();
        let text = format!("{}{camera}{}{stage}{}", part(), part(), part());
        std::fs::write(&file, text).unwrap();
        file
    }
}
