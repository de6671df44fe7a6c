//! The driver alone.

use std::time::{Duration, Instant};

use rig::device::retake::{FrameFault, Retakes, grab_right};
use rig::device::{Camera, CameraSettings, DeviceError, Mosaic, genicam};
use rig::units::Seconds;

use crate::stand::{KEY, SERIAL, Stand};

fn settings(exposure_s: f64, gain: f64) -> CameraSettings {
    let exposure = Seconds(exposure_s);
    CameraSettings { exposure, gain }
}

fn mean(counts: &[u16]) -> f64 {
    counts.iter().map(|&count| f64::from(count)).sum::<f64>() / counts.len() as f64
}

#[test]
fn settings_are_read_back_as_the_camera_rounds_them() {
    let stand = Stand::before_a_card(41, SERIAL, 16);
    let mut camera = stand.open();
    let info = camera.info().clone();
    assert_eq!(
        (info.model.as_str(), info.serial.as_str()),
        ("Simulated GigE camera", SERIAL)
    );
    // What the rig file allows of what the camera can.
    assert_eq!(info.exposure_range, [Seconds(5e-5), Seconds(2.0)]);
    let applied = camera.configure(settings(0.012_344, 2.0)).unwrap();
    assert!((applied.exposure.0 - 0.012_34).abs() < 1e-9, "{applied:?}");
    // 6.02 dB in steps of 0.1 dB.
    assert!(
        (applied.gain - 10_f64.powf(0.3)).abs() < 1e-9,
        "{applied:?}"
    );
    let first = camera.grab(KEY).unwrap();
    let second = camera.grab(KEY).unwrap();
    assert_eq!(first.counts.len(), 16 * 16);
    assert_eq!(second.sequence, first.sequence.map(|number| number + 1));
    assert!(second.timestamp.unwrap().0 > first.timestamp.unwrap().0);
    let celsius = camera.temperature_c().unwrap();
    assert!((20.0..45.0).contains(&celsius), "{celsius}");
    // Proportional to exposure and gain.
    let mut signal = |exposure_s, gain| {
        camera.configure(settings(exposure_s, gain)).unwrap();
        mean(&camera.grab(KEY).unwrap().counts) - 64.0
    };
    let [once, twice, gained] = [signal(0.02, 1.0), signal(0.04, 1.0), signal(0.02, 2.0)];
    assert!((twice / once - 2.0).abs() < 0.06, "{once} {twice}");
    assert!(
        (gained / once - 10_f64.powf(0.3)).abs() < 0.06,
        "{once} {gained}"
    );
    assert_eq!(camera.frames_lost(), 0);
}

#[test]
fn features_of_the_rig_file_are_set_and_read_back() {
    let stand = Stand::before_a_card(42, SERIAL, 16);
    let dark_at = |features: &str| {
        let mut camera = stand.open_with(features).unwrap();
        camera.configure(settings(1e-4, 1.0)).unwrap();
        mean(&camera.grab(KEY).unwrap().counts)
    };
    let raised = dark_at("; BlackLevel = 80") - dark_at("; BlackLevel = 64");
    assert!((raised - 16.0).abs() < 0.7, "{raised}");
    // Beyond what the camera has, no such feature, no number.
    for (features, fact) in [
        ("; BlackLevel = 60000", "BlackLevel"),
        ("; ReverseX = true", "no such feature"),
        ("; BlackLevel = low", "a number"),
    ] {
        let error = stand.open_with(features).err().unwrap().to_string();
        assert!(error.contains(fact), "{error}");
    }
    // The camera is free again after each of them.
    drop(stand.open());
}

#[test]
fn another_camera_size_or_format_is_refused() {
    let stand = Stand::before_a_card(43, SERIAL, 16);
    let open = |change: &dyn Fn(&mut rig::device::CameraInfo)| {
        let mut description = stand.description();
        change(&mut description.info);
        let device = stand.address.to_string();
        let opened = (genicam::DRIVER.open)(device.as_ref(), description);
        opened.err().unwrap()
    };
    let error = open(&|info| info.serial = "M-2".to_owned());
    assert!(
        matches!(&error, DeviceError::NotApplied { is, wanted, .. } if is == SERIAL && wanted == "M-2"),
        "{error}"
    );
    let error = open(&|info| info.resolution_px = [32, 16]).to_string();
    assert!(
        error.contains("16 × 16") && error.contains("32 × 16"),
        "{error}"
    );
    let error = open(&|info| info.mosaic = Mosaic::Gbrg).to_string();
    assert!(error.contains("it offers Mono8, Mono10"), "{error}");
    let error = open(&|info| info.exposure_range = [Seconds(20.0), Seconds(30.0)]).to_string();
    assert!(error.contains("its exposures are"), "{error}");
    let nobody = (genicam::DRIVER.open)("127.0.0.250".as_ref(), stand.description());
    assert!(matches!(
        nobody.err().unwrap(),
        DeviceError::NotFound { .. }
    ));
}

/// One device; each fault of it in turn.
#[test]
fn each_fault_is_seen_and_passes() {
    let stand = Stand::before_a_card(44, SERIAL, 160);
    let faults = stand.device.faults();
    faults.now().is_held = true;
    let held = stand.open_with("").err().unwrap();
    assert!(matches!(held, DeviceError::Controlled { .. }), "{held}");
    faults.now().is_held = false;
    let mut camera = stand.open();
    camera.configure(settings(0.01, 1.0)).unwrap();
    let usual = mean(&camera.grab(KEY).unwrap().counts);
    let fault_of = |camera: &mut Box<dyn Camera>| match camera.grab(KEY) {
        Err(DeviceError::BadFrame { fault, .. }) => fault,
        other => panic!("{other:?}"),
    };
    let good = |camera: &mut Box<dyn Camera>| {
        let frame = camera.grab(KEY).unwrap();
        assert!((mean(&frame.counts) / usual - 1.0).abs() < 0.02);
    };
    // Half the height, another format, an old frame.
    faults.now().halved = 1;
    let fault = fault_of(&mut camera);
    assert!(
        matches!(
            fault,
            FrameFault::Size {
                found: [160, 80],
                ..
            } | FrameFault::Damaged
                | FrameFault::LostPackets
        ),
        "{fault}"
    );
    good(&mut camera);
    faults.now().other_format = 1;
    let fault = fault_of(&mut camera);
    assert!(
        matches!(
            fault,
            FrameFault::Undecodable(_) | FrameFault::Damaged | FrameFault::LostPackets
        ),
        "{fault}"
    );
    good(&mut camera);
    faults.now().late = 1;
    assert_eq!(fault_of(&mut camera), FrameFault::Late);
    good(&mut camera);
    // No frame.
    faults.now().silent = 1;
    let missing = camera.grab(KEY);
    assert!(
        matches!(missing, Err(DeviceError::NoReply { .. })),
        "{missing:?}"
    );
    good(&mut camera);
    // Lost packets are requested again, or the frame is.
    faults.now().lost_per_thousand = 60;
    for _ in 0..12 {
        let mut retakes = Retakes::default();
        let frame = grab_right(camera.as_mut(), KEY, &mut retakes).unwrap();
        assert_eq!(frame.counts.len(), 160 * 160);
        assert!((mean(&frame.counts) / usual - 1.0).abs() < 0.02);
    }
    faults.now().lost_per_thousand = 0;
    // An exposure that stays is an error; one that can be set between acquisitions alone is set.
    faults.now().ignores_exposure = true;
    let ignored = camera.configure(settings(0.03, 1.0));
    assert!(
        matches!(&ignored, Err(DeviceError::NotApplied { what, .. }) if what == "ExposureTime"),
        "{ignored:?}"
    );
    faults.now().ignores_exposure = false;
    faults.now().locks_settings = true;
    let applied = camera.configure(settings(0.02, 1.0)).unwrap();
    assert!((applied.exposure.0 - 0.02).abs() < 1e-9);
    camera.grab(KEY).unwrap();
    faults.now().locks_settings = false;
    // Unplugged, and back as when it was switched on.
    faults.now().is_gone = true;
    let gone = camera.grab(KEY);
    assert!(
        matches!(gone, Err(DeviceError::Disconnected { .. })),
        "{gone:?}"
    );
    assert!(matches!(
        camera.reconnect(),
        Err(DeviceError::Disconnected { .. })
    ));
    faults.now().is_gone = false;
    camera.reconnect().unwrap();
    camera.configure(settings(0.01, 1.0)).unwrap();
    good(&mut camera);
}

/// A frame that arrives after its time-out, in the place of the next one, was exposed before
/// that one was requested.
#[test]
fn a_frame_that_comes_after_its_time_is_not_taken_for_the_next() {
    let stand = Stand::before_a_card(45, SERIAL, 16);
    let mut camera = stand.open();
    camera.configure(settings(0.01, 1.0)).unwrap();
    camera.grab(KEY).unwrap();
    stand.device.faults().now().delay = Some(Duration::from_millis(4300));
    let begun = Instant::now();
    let missing = camera.grab(KEY);
    assert!(
        matches!(missing, Err(DeviceError::NoReply { .. })),
        "{missing:?}"
    );
    let old = camera.grab(KEY);
    assert!(begun.elapsed() > Duration::from_millis(4300));
    let is_late = matches!(
        &old,
        Err(DeviceError::BadFrame {
            fault: FrameFault::Late,
            ..
        })
    );
    assert!(is_late, "{old:?}");
    let mut retakes = Retakes::default();
    grab_right(camera.as_mut(), KEY, &mut retakes).unwrap();
}

/// Silent for longer than the heartbeat time-out, as a process that is suspended: another
/// program may take control, and this one takes it again.
#[test]
fn control_that_was_lost_is_taken_again() {
    let stand = Stand::before_a_card(46, SERIAL, 16);
    let mut camera = stand.open();
    camera.configure(settings(0.01, 1.0)).unwrap();
    camera.grab(KEY).unwrap();
    stand.device.faults().now().forgets_controller = true;
    let lost = camera.grab(KEY);
    assert!(
        matches!(lost, Err(DeviceError::Disconnected { .. })),
        "{lost:?}"
    );
    camera.reconnect().unwrap();
    camera.configure(settings(0.01, 1.0)).unwrap();
    camera.grab(KEY).unwrap();
}
