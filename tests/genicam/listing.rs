//! What is listed, and Aravis' own fake camera as a second device.

use aravis::GvFakeCamera;
use rig::device::described::Description;
use rig::device::{CameraSettings, DeviceError, genicam};
use rig::units::Seconds;

use crate::stand::{KEY, Stand};
use crate::support::{json, run, text};

#[test]
fn cameras_are_listed_and_opened_as_they_are_called() {
    let stand = Stand::before_a_card(61, "GV-LISTED", 16);
    let find = || {
        let found = (genicam::DRIVER.find)().unwrap();
        let ours = found
            .into_iter()
            .find(|camera| camera.serial == "GV-LISTED");
        ours.expect("it is listed")
    };
    let camera = find();
    assert_eq!(camera.model, "Simulated GigE camera");
    assert!(camera.problem.is_none(), "{:?}", camera.problem);
    // By its name and by its serial number.
    for name in [camera.address.as_str(), "GV-LISTED"] {
        let opened = (genicam::DRIVER.open)(name.as_ref(), stand.description()).unwrap();
        assert_eq!(opened.info().serial, "GV-LISTED");
        drop(opened);
    }
    stand.device.faults().now().is_held = true;
    let problem = find().problem;
    assert!(
        matches!(problem, Some(DeviceError::Controlled { .. })),
        "{problem:?}"
    );
    // As the program lists it.
    let listed = json(run(stand.folder.path(), &["devices", "--json"]));
    let listed = listed.as_array().unwrap();
    let ours = listed.iter().find(|camera| camera["serial"] == "GV-LISTED");
    let ours = ours.expect("it is listed");
    assert_eq!(ours["driver"], "genicam");
    assert_eq!(ours["accessible"], false);
    let remedy = ours["remedy"].as_str().unwrap();
    assert!(
        remedy.contains("end the other program that has the camera"),
        "{remedy}"
    );
    let output = run(stand.folder.path(), &["devices"]);
    let line = format!("driver = \"genicam\", device = \"{}\"", camera.address);
    assert!(
        text(&output.stdout).contains(&line),
        "{}",
        text(&output.stdout)
    );
}

/// Aravis' fake camera has the names of SFNC 1, stops at 8 or 16 bits and is as bright as the
/// logarithm of its exposure: enough to set, trigger and read frames.
#[test]
fn aravis_own_fake_camera_is_set_and_gives_frames() {
    let fake = GvFakeCamera::new(Some("127.0.0.1"), Some("GV77"));
    assert!(fake.is_running());
    let stand = Stand::before_a_card(62, "GV-OTHER", 128);
    for (device, bits) in [
        ("127.0.0.1; Width = 128; Height = 128", 8),
        ("Aravis-Fake-GV77; Width = 128; Height = 128", 16),
    ] {
        let description = stand.description();
        let description = Description {
            info: rig::device::CameraInfo {
                bit_depth: bits,
                serial: "GV77".to_owned(),
                ..description.info
            },
            ..description
        };
        let mut camera = (genicam::DRIVER.open)(device.as_ref(), description).unwrap();
        assert_eq!(camera.info().model, "Fake");
        for exposure_s in [0.01, 0.02] {
            let exposure = Seconds(exposure_s);
            let applied = camera
                .configure(CameraSettings::new(exposure, 1.0))
                .unwrap();
            assert!((applied.exposure.0 - exposure_s).abs() < 1e-6);
            let frame = camera.grab(KEY).unwrap();
            assert_eq!((frame.width, frame.height), (128, 128));
            assert!(frame.counts.iter().any(|&count| count > 0));
        }
    }
}
