//! `driver = "genicam"`: libaravis against the simulated GigE Vision device, over loopback.

#[path = "capture_support/mod.rs"]
mod support;

use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use mock_devices::bench::{Bench as MockBench, BenchConfig};
use mock_devices::camera::{CameraConfig, SimulatedCamera as MockCamera};
use mock_devices::clock::Clock;
use mock_devices::gige::{Exposer, GigeCamera};
use mock_devices::sensor::{SensorConfig, SensorModel};
use mock_devices::{Illumination, RadianceSource};
use rig::capture::Outcome;
use rig::device::described::Description;
use rig::device::genicam::GenicamCamera;
use rig::device::retake::{FrameFault, Retakes, grab_right};
use rig::device::simulated_camera::SimulatedCamera;
use rig::device::{
    Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, FrameKind, LampChannel, LampState,
    Mosaic,
};
use rig::session::Session;
use rig::session::faults::UnsyncedDisk;
use rig::units::Seconds;
use support::*;

/// A grey wedge under the lamp of the bench in memory.
struct Wedge {
    bench: Bench,
    side: u32,
}

impl RadianceSource for Wedge {
    fn resolution_px(&self) -> [u32; 2] {
        [self.side; 2]
    }

    fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
        let power = match self.bench.world().lamp {
            LampState::Off => 0.0,
            LampState::On(LampChannel(channel)) => [0.4, 0.12][usize::from(channel)],
        };
        let pixels = self.side * self.side;
        let radiance = |pixel: u32| 2e-5 + power * (pixel + 1) as f32 / pixels as f32;
        Arc::new((0..pixels).map(radiance).collect())
    }
}

fn sensor(side: u32) -> SensorModel {
    SensorModel::new(SensorConfig {
        dark_current_e_s: 1.0,
        dsnu_e_s: 0.0,
        offset_dsnu_e: 0.0,
        prnu: 0.0,
        read_noise_e: 2.5,
        gain_dn_per_e: 0.4,
        hot_fraction: 0.0,
        ..SensorConfig::typical([side, side], 1)
    })
}

fn device(last: u8, bench: &Bench, side: u32, clock: Clock, readout_s: f64) -> GigeCamera {
    let scene = Arc::new(Wedge {
        bench: bench.clone(),
        side,
    });
    let stand = MockBench::new(BenchConfig::default(), clock);
    let config = CameraConfig {
        readout_s,
        ..CameraConfig::default()
    };
    let exposer = Exposer::new(config, sensor(side), scene, stand);
    GigeCamera::start(Ipv4Addr::new(127, 0, 0, last), "GV-0042", exposer).unwrap()
}

fn open(last: u8, side: u32) -> Result<GenicamCamera, DeviceError> {
    let description = Description {
        info: CameraInfo {
            driver: "genicam".into(),
            serial: "GV-0042".into(),
            ..camera_of(side)
        },
        timeout: Seconds(1.0),
        keeper: None,
    };
    GenicamCamera::open(&format!("127.0.0.{last}"), &description)
}

const KEY: FrameKey = FrameKey {
    light: 0,
    exposure: 0,
    repeat: 0,
    kind: FrameKind::Light,
};

fn exposure(seconds: f64) -> CameraSettings {
    CameraSettings {
        exposure: Seconds(seconds),
        gain: 1.0,
    }
}

#[test]
fn settings_are_read_back_as_the_camera_rounds_them() {
    let bench = Bench::new();
    let _device = device(81, &bench, SIZE, Clock::instant(), 0.0);
    let mut camera = open(81, SIZE).unwrap();
    assert_eq!(camera.info().model, "Simulated GigE camera");
    assert_eq!(camera.info().serial, "GV-0042");
    let asked = CameraSettings {
        gain: 2.0,
        ..exposure(0.012_344)
    };
    let applied = camera.configure(asked).unwrap();
    assert!((applied.exposure.0 - 0.012_34).abs() < 1e-9, "{applied:?}");
    // 6.02 dB in steps of 0.1 dB.
    assert!(
        (applied.gain - 10_f64.powf(0.3)).abs() < 1e-9,
        "{applied:?}"
    );
    let first = camera.grab(KEY).unwrap();
    let second = camera.grab(KEY).unwrap();
    assert_eq!(first.counts.len(), (SIZE * SIZE) as usize);
    assert_eq!(second.sequence, first.sequence.map(|number| number + 1));
    assert!(second.timestamp.unwrap().0 > first.timestamp.unwrap().0);
    let celsius = camera.temperature_c().unwrap();
    assert!((24.0..37.0).contains(&celsius), "{celsius}");
}

/// One device; each fault of it in turn.
#[test]
fn each_fault_is_seen_and_passes() {
    let bench = Bench::new();
    let device = device(82, &bench, 160, Clock::instant(), 0.0);
    let faults = device.faults();
    faults.hold(true);
    let held = open(82, 160).map(drop);
    assert!(
        matches!(held, Err(DeviceError::Controlled { .. })),
        "{held:?}"
    );
    faults.hold(false);
    let mut camera = open(82, 160).unwrap();
    camera.configure(exposure(0.01)).unwrap();
    camera.grab(KEY).unwrap();
    // Half the height, an old frame, no frame.
    faults.halve_frames(1);
    let halved = camera.grab(KEY);
    let fault = matches!(&halved, Err(DeviceError::BadFrame { fault, .. })
        if matches!(fault, FrameFault::Size { found: [160, 80], .. } | FrameFault::Damaged));
    assert!(fault, "{halved:?}");
    faults.repeat_frames(1);
    let late = camera.grab(KEY);
    let is_late = matches!(
        &late,
        Err(DeviceError::BadFrame {
            fault: FrameFault::Late,
            ..
        })
    );
    assert!(is_late, "{late:?}");
    faults.swallow_frames(1);
    let missing = camera.grab(KEY);
    assert!(
        matches!(missing, Err(DeviceError::NoReply { .. })),
        "{missing:?}"
    );
    // Lost packets are requested again, or the frame is.
    faults.lose_packets(60);
    for _ in 0..12 {
        let mut retakes = Retakes::default();
        let frame = grab_right(&mut camera, KEY, &mut retakes).unwrap();
        assert_eq!(frame.counts.len(), 160 * 160);
        assert!(frame.counts.iter().all(|&count| (40..90).contains(&count)));
    }
    faults.lose_packets(0);
    // An exposure that stays is read back as it is.
    faults.ignore_exposure(true);
    let applied = camera.configure(exposure(0.03)).unwrap();
    assert!((applied.exposure.0 - 0.01).abs() < 1e-9, "{applied:?}");
    faults.ignore_exposure(false);
    // Unplugged, and back as when it was switched on.
    faults.unplug(true);
    let gone = camera.grab(KEY);
    assert!(
        matches!(gone, Err(DeviceError::Disconnected { .. })),
        "{gone:?}"
    );
    assert!(camera.reconnect().is_err());
    faults.unplug(false);
    camera.reconnect().unwrap();
    camera.configure(exposure(0.02)).unwrap();
    camera.grab(KEY).unwrap();
}

/// Mean signal per second of exposure of each kind of frame.
fn signals(root: &Path) -> BTreeMap<(u32, bool, u32), Vec<f64>> {
    let session = Session::open(root).unwrap();
    let mut all: BTreeMap<_, Vec<f64>> = BTreeMap::new();
    for entry in session.frames() {
        let (frame, sidecar) = session.read_frame(&entry).unwrap();
        let mean = frame
            .counts
            .iter()
            .map(|&count| f64::from(count))
            .sum::<f64>()
            / frame.counts.len() as f64;
        let saturated = frame.counts.iter().any(|&count| count > 4000);
        let exposure = sidecar.applied.exposure.0;
        // Exposures that differ between two captures by a step are near each other.
        let is_light = entry.key.kind == FrameKind::Light;
        if !saturated && mean > 264.0 {
            let key = (entry.key.light, is_light, entry.key.exposure);
            all.entry(key).or_default().push((mean - 64.0) / exposure);
        }
    }
    all
}

#[test]
fn a_capture_of_two_lights_equals_that_of_the_camera_in_memory() {
    let capture = |camera: Box<dyn Camera>, bench: &Bench| {
        let parent = tempfile::tempdir().unwrap();
        let mut record = record();
        record.plan.settings_latency_frames = 0;
        let session = create_from(Arc::new(UnsyncedDisk), parent.path(), &record).unwrap();
        let root = session.root().to_owned();
        let (result, heard) = capture_with_camera(bench, camera, session);
        assert_eq!(result.unwrap(), Outcome::Complete);
        assert_eq!(heard.warnings, [""; 0]);
        assert_eq!(bench.world().lamp, LampState::Off);
        signals(&root)
    };
    let bench = Bench::new();
    let _device = device(83, &bench, SIZE, Clock::instant(), 0.0);
    let found = capture(Box::new(open(83, SIZE).unwrap()), &bench);
    let bench = Bench::new();
    let wedge = Arc::new(Wedge {
        bench: bench.clone(),
        side: SIZE,
    });
    let config = CameraConfig {
        exposure_range_s: [1e-4, 1.0],
        exposure_step_s: 1e-4,
        settings_latency_frames: 0,
        ..CameraConfig::default()
    };
    let stand = MockBench::new(BenchConfig::default(), Clock::instant());
    let mock = MockCamera::new(config, stand, sensor(SIZE), wedge);
    let expected = capture(
        Box::new(SimulatedCamera::new(mock, "M-1".into(), Mosaic::None)),
        &bench,
    );
    assert!(found.keys().eq(expected.keys()), "{found:?} {expected:?}");
    assert!(found.len() >= 4, "{found:?}");
    for (key, signal) in &found {
        let mean = |all: &[f64]| all.iter().sum::<f64>() / all.len() as f64;
        let ratio = mean(signal) / mean(&expected[key]);
        // Shot noise of 64 pixels of some 500 electrons is 0.6%; 5 of it.
        assert!((ratio - 1.0).abs() < 0.03, "{key:?}: {ratio}");
    }
}

/// A frame begins after its request: no time for one under way, none thrown away.
#[test]
fn a_triggered_frame_takes_its_exposure_and_read_out() {
    let bench = Bench::new();
    let readout_s = 0.002;
    let _device = device(84, &bench, 64, Clock::real_time(), readout_s);
    let mut camera = open(84, 64).unwrap();
    camera.configure(exposure(0.05)).unwrap();
    let begun = Instant::now();
    const FRAMES: u32 = 20;
    for _ in 0..FRAMES {
        camera.grab(KEY).unwrap();
    }
    let exposed = Duration::from_secs_f64(0.05 * f64::from(FRAMES));
    let ratio = begun.elapsed().as_secs_f64() / exposed.as_secs_f64();
    println!("{FRAMES} triggered frames of 50 ms took {ratio:.3} times their exposures");
    assert!((1.0..1.35).contains(&ratio), "{ratio}");
}
