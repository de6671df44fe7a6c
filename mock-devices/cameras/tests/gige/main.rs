//! The simulated GigE Vision device and Aravis' own tool, where that is installed
//! (Debian: `aravis-tools-cli`).

use std::net::Ipv4Addr;
use std::process::{Command, Output};
use std::sync::Arc;

use mock_cameras::gige::{Exposer, GigeCamera};
use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::camera::CameraConfig;
use mock_devices::clock::Clock;
use mock_devices::sensor::{SensorConfig, SensorModel};
use mock_devices::{Illumination, RadianceSource};

struct Grey;

impl RadianceSource for Grey {
    fn resolution_px(&self) -> [u32; 2] {
        [32, 24]
    }

    fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
        Arc::new(vec![0.2; 32 * 24])
    }
}

fn device(address: [u8; 4]) -> GigeCamera {
    let sensor = SensorModel::new(SensorConfig::typical([32, 24], 1));
    let bench = Bench::new(BenchConfig::default(), Clock::real_time());
    let exposer = Exposer::new(CameraConfig::default(), sensor, Arc::new(Grey), bench);
    GigeCamera::start(Ipv4Addr::from(address), "MOCK01", exposer).unwrap()
}

/// What the tool prints; `None` where it is not installed.
fn tool(address: &str, arguments: &[&str]) -> Option<String> {
    let run = Command::new("arv-tool-0.8")
        .args(["-a", address])
        .args(arguments)
        .output();
    let Output { stdout, stderr, .. } = run.ok()?;
    let texts = [stdout, stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    Some(texts.concat())
}

#[test]
fn aravis_reads_and_writes_features() {
    let address = "127.0.0.71";
    let _device = device([127, 0, 0, 71]);
    let Some(listed) = tool(address, &["features"]) else {
        eprintln!("arv-tool-0.8 is not installed: not tested");
        return;
    };
    for name in [
        "ExposureTime",
        "TriggerSoftware",
        "GevSCPSPacketSize",
        "Mono12Packed",
    ] {
        assert!(listed.contains(name), "{name}: {listed}");
    }
    let names = ["control", "DeviceSerialNumber", "DeviceModelName"];
    let read = tool(address, &names).unwrap();
    assert!(
        read.contains("MOCK01") && read.contains("Simulated GigE camera"),
        "{read}"
    );
    // Rounded to its step, once automatic exposure is off.
    let set = [
        "control",
        "ExposureAuto=Off",
        "ExposureTime=12344",
        "ExposureTime",
    ];
    let read = tool(address, &set).unwrap();
    assert!(read.contains("12340"), "{read}");
    let packed = ["control", "PixelFormat=Mono12Packed", "PayloadSize"];
    let read = tool(address, &packed).unwrap();
    assert!(read.contains("1152"), "{read}");
}

#[test]
fn a_device_that_another_controller_holds_takes_no_value() {
    let address = "127.0.0.72";
    let device = device([127, 0, 0, 72]);
    device.faults().now().is_held = true;
    let held = ["control", "BlackLevel=100", "BlackLevel"];
    let Some(read) = tool(address, &held) else {
        return;
    };
    assert!(!read.contains("100"), "{read}");
    device.faults().now().is_held = false;
    let read = tool(address, &held).unwrap();
    assert!(read.contains("100"), "{read}");
}
