use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, mpsc};
use std::time::{Duration, Instant};

use super::port::{Frame, Webcam};
use super::worker::Worker;
use super::*;
use crate::device::controls::{ControlInfo, ControlKind, id};
use crate::device::described::tests::KEY;

/// A camera of 4 × 2 pixels in memory, at an address of its own.
#[derive(Clone)]
struct Fake(Arc<Mutex<State>>);

struct State {
    serial: Option<&'static str>,
    controls: BTreeMap<u32, ControlInfo>,
    /// Exposures become multiples of this.
    exposure_step: i64,
    set: Vec<(u32, i64)>,
    /// What comes before whole frames that began after they were requested.
    script: VecDeque<Next>,
    /// Its luma is its number.
    frames: u8,
    is_open: bool,
}

enum Next {
    /// A frame that ended so long ago, ms; `None`: without a time stamp.
    Ended(Option<u64>),
    Bytes(usize),
    Error(i32),
    /// Not before this channel is closed.
    Hang(mpsc::Receiver<()>),
    Panic,
}

static PLUGGED: LazyLock<Mutex<BTreeMap<String, Fake>>> = LazyLock::new(Mutex::default);

fn plugged() -> MutexGuard<'static, BTreeMap<String, Fake>> {
    PLUGGED
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner())
}

fn control(id: u32, kind: ControlKind, [minimum, maximum]: [i64; 2], value: i64) -> ControlInfo {
    ControlInfo {
        id,
        label: format!("{id:#x}"),
        kind,
        minimum,
        maximum,
        step: 1,
        default: value,
        value: Some(value),
        read_only: false,
        inactive: false,
    }
}

impl Fake {
    fn plug_in(address: &str, serial: Option<&'static str>) -> Self {
        let controls = [
            control(id::EXPOSURE_AUTO, ControlKind::Integer, [0, 3], 3),
            control(id::AUTO_WHITE_BALANCE, ControlKind::Boolean, [0, 1], 1),
            control(id::EXPOSURE_ABSOLUTE, ControlKind::Integer, [3, 2047], 250),
            control(id::GAIN, ControlKind::Integer, [0, 100], 0),
        ];
        let fake = Self(Arc::new(Mutex::new(State {
            serial,
            controls: controls.map(|control| (control.id, control)).into(),
            exposure_step: 1,
            set: Vec::new(),
            script: VecDeque::new(),
            frames: 0,
            is_open: false,
        })));
        plugged().insert(address.to_owned(), fake.clone());
        fake
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    fn will(&self, script: impl IntoIterator<Item = Next>) {
        self.state().script.extend(script);
    }
}

impl Drop for Opened {
    fn drop(&mut self) {
        self.0.state().is_open = false;
    }
}

/// What the worker has.
struct Opened(Fake);

impl Webcam for Opened {
    fn open(address: &str, _: [u32; 2], _: Seconds) -> Result<Self, DeviceError> {
        let fake = plugged().get(address).cloned();
        let fake = fake.ok_or_else(|| DeviceError::NotFound {
            device: address.to_owned(),
        })?;
        assert!(!std::mem::replace(&mut fake.state().is_open, true));
        Ok(Self(fake))
    }

    fn addresses(serial: &str) -> Vec<String> {
        plugged()
            .iter()
            .filter(|(_, fake)| fake.state().serial == Some(serial))
            .map(|(address, _)| address.clone())
            .collect()
    }

    fn model(&self) -> String {
        "Webcam 4x2".to_owned()
    }

    fn serial(&self) -> Option<String> {
        self.0.state().serial.map(str::to_owned)
    }

    fn control(&self, id: u32) -> io::Result<Option<ControlInfo>> {
        Ok(self.0.state().controls.get(&id).cloned())
    }

    fn set_control(&mut self, id: u32, value: i64) -> io::Result<()> {
        let mut state = self.0.state();
        state.set.push((id, value));
        let step = match id {
            id::EXPOSURE_ABSOLUTE => state.exposure_step,
            _ => 1,
        };
        if let Some(control) = state.controls.get_mut(&id) {
            control.value = Some(value / step * step);
        }
        Ok(())
    }

    fn next_frame(&mut self) -> io::Result<Frame> {
        let next = self.0.state().script.pop_front();
        let mut bytes = 16;
        let mut ended_ms = Some(0);
        match next {
            // Longer than the exposure, so that it began after the request.
            None => std::thread::sleep(Duration::from_millis(5)),
            Some(Next::Ended(ms)) => ended_ms = ms,
            Some(Next::Bytes(count)) => {
                std::thread::sleep(Duration::from_millis(5));
                bytes = count;
            }
            Some(Next::Error(number)) => return Err(io::Error::from_raw_os_error(number)),
            Some(Next::Hang(until)) => {
                let _ = until.recv();
                std::thread::sleep(Duration::from_millis(5));
            }
            Some(Next::Panic) => panic!("a defect of the library"),
        }
        let mut state = self.0.state();
        state.frames += 1;
        Ok(Frame {
            bytes: [state.frames, 128].repeat(bytes / 2 + 1)[..bytes].to_vec(),
            ended: ended_ms.map(|ms| Instant::now() - Duration::from_millis(ms)),
        })
    }
}

fn description(serial: &str) -> Description {
    Description {
        info: CameraInfo {
            driver: "webcam".to_owned(),
            model: String::new(),
            serial: serial.to_owned(),
            resolution_px: [4, 2],
            bit_depth: 8,
            mosaic: Mosaic::None,
            exposure_range: [Seconds(1e-4), Seconds(0.03)],
            exposure_step: Seconds(1e-4),
        },
        timeout: Seconds(20.0),
        keeper: None,
    }
}

const SETTINGS: CameraSettings = CameraSettings::new(Seconds(0.001), 1.0);

/// A plugged camera that was opened and configured, and whose first frame has come.
fn ready_camera(address: &str, serial: &'static str) -> (Fake, WebcamCamera<Opened>) {
    let fake = Fake::plug_in(address, Some(serial));
    let mut camera = WebcamCamera::open(address, &description(serial)).unwrap();
    camera.configure(SETTINGS).unwrap();
    camera.grab(KEY).unwrap();
    (fake, camera)
}

fn next_light(light: u32) -> FrameKey {
    FrameKey { light, ..KEY }
}

#[test]
fn settings_are_manual_and_read_back() {
    let fake = Fake::plug_in("settings", Some("S1"));
    fake.state().exposure_step = 8;
    let mut camera = WebcamCamera::<Opened>::open("settings", &description("S1")).unwrap();
    let info = camera.info().clone();
    assert_eq!(
        (info.model.as_str(), info.serial.as_str()),
        ("Webcam 4x2", "S1")
    );
    assert_eq!(
        info.exposure_range,
        [Seconds(3.0 * 1e-4), Seconds(2047.0 * 1e-4)]
    );
    assert!(matches!(camera.grab(KEY), Err(DeviceError::Refused { .. })));
    let wanted = |exposure_s, gain| CameraSettings {
        exposure: Seconds(exposure_s),
        gain,
    };
    // 10.04 ms are 100 steps, and this camera keeps 96 of them.
    let applied = camera.configure(wanted(0.01004, 1.0)).unwrap();
    assert_eq!(applied, wanted(96.0 * 1e-4, 1.0));
    let order = [
        (id::EXPOSURE_AUTO, 1),
        (id::AUTO_WHITE_BALANCE, 0),
        (id::GAIN, 0),
        (id::EXPOSURE_ABSOLUTE, 100),
    ];
    assert_eq!(fake.state().set, order);
    // A gain that begins at 0 has no unit.
    let error = camera.configure(wanted(0.01, 2.0)).unwrap_err();
    assert!(matches!(error, DeviceError::Refused { .. }), "{error}");
    assert!(matches!(camera.grab(KEY), Err(DeviceError::Refused { .. })));
}

#[test]
fn only_the_described_camera_in_this_mode_is_opened() {
    Fake::plug_in("which", Some("S1"));
    let open = |address: &str, description: &Description| {
        WebcamCamera::<Opened>::open(address, description)
            .map(|camera| camera.info().serial.clone())
            .map_err(|error| error.to_string())
    };
    assert_eq!(open("which", &description("S1")).unwrap(), "S1");
    let other = open("which", &description("S2")).unwrap_err();
    assert!(other.contains("serial number is S1"), "{other}");
    let unnamed = open("which", &description("")).unwrap_err();
    assert!(unnamed.contains("must be \"S1\""), "{unnamed}");
    let mut deep = description("S1");
    deep.info.bit_depth = 12;
    let deep = open("which", &deep).unwrap_err();
    assert!(
        deep.contains("12 bits") && deep.contains("luma of 8 bits"),
        "{deep}"
    );
    let mut bayer = description("S1");
    bayer.info.mosaic = Mosaic::Rggb;
    assert!(open("which", &bayer).unwrap_err().contains("rggb"));
    // Without a number its model is its name.
    Fake::plug_in("unnumbered", None);
    let named = open("unnumbered", &description("Webcam 4x2"));
    assert_eq!(named.unwrap(), "Webcam 4x2");
    assert!(open("nothing", &description("S1")).is_err());
}

#[test]
fn a_frame_that_began_before_its_request_is_no_reply_to_it() {
    let (fake, mut camera) = ready_camera("stale", "S3");
    // Three frames have the settings of before, and each reply is one frame more.
    assert_eq!(fake.state().frames, 4);
    let old = [900, 600, 300, 0].map(|ms| Next::Ended(Some(ms)));
    fake.will(old);
    let frame = camera.grab(next_light(1)).unwrap();
    assert_eq!(frame.counts, [9; 8]);
    // New settings: three frames pass, old or not.
    camera.configure(SETTINGS).unwrap();
    assert_eq!(camera.grab(next_light(1)).unwrap().counts, [13; 8]);
    // Equal frames in a row follow each other without a loss.
    let repeat = FrameKey {
        repeat: 1,
        ..next_light(1)
    };
    assert_eq!(camera.grab(repeat).unwrap().counts, [14; 8]);
}

#[test]
fn without_time_stamps_as_many_frames_pass_as_can_be_old() {
    let (fake, mut camera) = ready_camera("untimed", "S4");
    fake.will((0..20).map(|_| Next::Ended(None)));
    assert_eq!(camera.grab(next_light(1)).unwrap().counts, [10; 8]);
    assert!(camera.grab(next_light(2)).unwrap().timestamp.is_none());
}

#[test]
fn a_frame_of_another_length_is_named_with_both() {
    let (fake, mut camera) = ready_camera("lengths", "S5");
    fake.will([Next::Bytes(15), Next::Bytes(32)]);
    for found in ["15 bytes", "32 bytes"] {
        let error = camera.grab(next_light(1)).unwrap_err();
        assert!(matches!(error, DeviceError::BadFrame { .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains(found) && text.contains("are 16"), "{text}");
    }
    assert_eq!(camera.grab(next_light(1)).unwrap().counts.len(), 8);
}

#[test]
fn a_frame_that_never_comes_ends_at_the_time_out_and_may_come_later() {
    let (fake, mut camera) = ready_camera("silent", "S6");
    camera.timeout = Seconds(0.1);
    let (hold, held) = mpsc::channel();
    fake.will([Next::Hang(held)]);
    let began = Instant::now();
    for light in 1..3 {
        let error = camera.grab(next_light(light)).unwrap_err();
        assert!(matches!(error, DeviceError::NoReply { .. }), "{error}");
    }
    let error = camera.configure(SETTINGS).unwrap_err();
    assert!(matches!(error, DeviceError::NoReply { .. }), "{error}");
    assert!(began.elapsed() < Duration::from_secs(30));
    drop(hold);
    camera.timeout = Seconds(20.0);
    camera.configure(SETTINGS).unwrap();
    assert_eq!(camera.grab(next_light(3)).unwrap().counts, [9; 8]);
}

#[test]
fn a_library_that_hangs_holds_nobody_up() {
    let began = Instant::now();
    let (hold, held) = mpsc::channel::<()>();
    let open = move || {
        let _ = held.recv();
        Err::<Fake, _>(DeviceError::Disconnected {
            device: "x".to_owned(),
        })
    };
    let error = Worker::start("x", Seconds(0.05), open)
        .map(drop)
        .unwrap_err();
    assert!(matches!(error, DeviceError::NoReply { .. }), "{error}");
    drop(hold);
    // A camera that is dropped while a frame is awaited.
    let (fake, mut camera) = ready_camera("hanging", "S7");
    let (hold, held) = mpsc::channel();
    fake.will([Next::Hang(held)]);
    camera.timeout = Seconds(0.05);
    camera.grab(next_light(1)).unwrap_err();
    drop(camera);
    assert!(began.elapsed() < Duration::from_secs(30));
    assert!(fake.state().is_open);
    drop(hold);
}

#[test]
fn an_interrupted_wait_goes_on_and_a_panic_is_an_error() {
    let (fake, mut camera) = ready_camera("panics", "S8");
    fake.will([Next::Error(4), Next::Error(4)]);
    camera.grab(next_light(1)).unwrap();
    fake.will([Next::Panic]);
    let error = camera.grab(next_light(2)).unwrap_err();
    assert!(matches!(error, DeviceError::Io { .. }), "{error}");
    assert!(camera.configure(SETTINGS).is_err());
}

#[test]
fn an_unplugged_camera_is_found_again_by_its_serial_number() {
    let (fake, mut camera) = ready_camera("before", "S9");
    plugged().remove("before");
    fake.will([Next::Error(19)]);
    let gone = |error: &DeviceError| matches!(error, DeviceError::Disconnected { .. });
    assert!(gone(&camera.grab(next_light(1)).unwrap_err()));
    assert!(gone(&camera.reconnect().unwrap_err()));
    assert!(!fake.state().is_open);
    // Another one at its place is not taken for it.
    Fake::plug_in("before", Some("S10"));
    assert!(gone(&camera.reconnect().unwrap_err()));
    plugged().insert("after".to_owned(), fake.clone());
    camera.reconnect().unwrap();
    assert!(matches!(camera.grab(KEY), Err(DeviceError::Refused { .. })));
    camera.configure(SETTINGS).unwrap();
    camera.grab(KEY).unwrap();
    assert!(camera.may_return_within().0 > 0.0);
}

#[test]
fn without_a_control_the_exposure_is_unknown() {
    let fake = Fake::plug_in("fixed", Some("S11"));
    fake.state().controls.clear();
    let mut camera = WebcamCamera::<Opened>::open("fixed", &description("S11")).unwrap();
    assert!(camera.info().exposure_range[0].0.is_nan());
    assert!(camera.configure(SETTINGS).unwrap().exposure.0.is_nan());
    camera.grab(KEY).unwrap();
}
