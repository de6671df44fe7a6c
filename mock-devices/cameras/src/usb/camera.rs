//! A camera of the USB Video Class (UVC 1.1) that looks at the bench.
//!
//! Uncompressed frames over a bulk endpoint. Like many real ones it refuses an
//! exposure while exposure is automatic, and begins a frame when the one before
//! has been read out.

use std::sync::Arc;

use super::descriptors::Identity;
use super::{Descriptors, Setup, Stall, UsbDevice};
use mock_devices::RadianceSource;
use mock_devices::bench::Bench;
use mock_devices::failing::{Failing, due};
use mock_devices::sensor::{FrameKey, NoiseKey, SensorModel};

/// Most bytes of one payload, its header included.
const PAYLOAD: usize = 16_384;
const BULK_IN: u8 = 0x81;
/// Frame intervals on offer, units of 100 ns; the first is the default.
const INTERVALS: [u32; 3] = [333_333, 1_000_000, 5_000_000];
/// Steps of the exposure, seconds.
const EXPOSURE_STEP_S: f64 = 100e-6;
/// Gain of 1 in the control's unit.
const UNIT_GAIN: f64 = 16.0;

const SET_CUR: u8 = 0x01;
const GET_CUR: u8 = 0x81;
const GET_MIN: u8 = 0x82;
const GET_MAX: u8 = 0x83;
const GET_RES: u8 = 0x84;
const GET_LEN: u8 = 0x85;
const GET_INFO: u8 = 0x86;
const GET_DEF: u8 = 0x87;

/// Format of the stream, by its number in the descriptors.
const FORMATS: [([u8; 4], u8); 4] = [
    (*b"YUY2", 16),
    (*b"Y16 ", 16),
    (*b"RG16", 16),
    (*b"Y800", 8),
];

/// One of the camera's controls.
#[derive(Clone, Copy, Debug)]
struct Control {
    /// Terminal or unit, and its selector there.
    place: (u8, u8),
    bytes: usize,
    minimum: u32,
    maximum: u32,
    step: u32,
    default: u32,
    value: u32,
}

const fn control(place: (u8, u8), bytes: usize, range: [u32; 3], default: u32) -> Control {
    let [minimum, maximum, step] = range;
    Control {
        place,
        bytes,
        minimum,
        maximum,
        step,
        default,
        value: default,
    }
}

const CAMERA: u8 = 1;
const PROCESSING: u8 = 2;
const MANUAL: u32 = 1;
/// Places of the exposure's mode, the exposure and the gain in the table.
const MODE: usize = 0;
const EXPOSURE: usize = 1;
const GAIN: usize = 2;

fn controls() -> [Control; 6] {
    [
        // Bits: 1 manual, 8 aperture priority; its step is the bits it has.
        control((CAMERA, 2), 1, [0, 0, 9], 8),
        control((CAMERA, 4), 4, [1, 10_000, 1], 156),
        control((PROCESSING, 4), 2, [16, 256, 1], 32),
        control((PROCESSING, 2), 2, [0, 255, 1], 128),
        control((PROCESSING, 10), 2, [2800, 6500, 10], 4600),
        control((PROCESSING, 11), 1, [0, 1, 1], 1),
    ]
}

/// What goes wrong.
#[derive(Debug, Default)]
pub struct Faults {
    /// It stalls where its exposure is set.
    pub stalls_exposure: bool,
    /// It confirms exposures and keeps the one that it has.
    pub ignores_exposure: bool,
    /// So many frames carry the class's error bit.
    pub damaged: u32,
    /// So many frames end after half of their bytes.
    pub cut: u32,
    /// It sends no frames, as if it hung.
    pub silent: bool,
}

/// Handle by which a test makes the camera fail.
pub type CameraFaults = Failing<Faults>;

/// A frame that is being sent.
#[derive(Debug)]
struct Sending {
    bytes: Vec<u8>,
    sent: usize,
    is_damaged: bool,
}

/// A frame that is being exposed.
#[derive(Clone, Copy, Debug)]
struct Exposing {
    start_s: f64,
    exposure_s: f64,
    gain: f64,
}

/// The camera.
pub struct UsbCamera {
    descriptors: Descriptors,
    sensor: SensorModel,
    scene: Arc<dyn RadianceSource>,
    bench: Bench,
    controls: [Control; 6],
    faults: CameraFaults,
    /// What was negotiated: number of the format, interval.
    format: usize,
    interval: u32,
    exposing: Option<Exposing>,
    sending: Option<Sending>,
    frames: u32,
    kept_exposure: u32,
}

impl UsbCamera {
    /// A camera with this serial number, whose sensor sees `scene` in the light
    /// of the bench.
    pub fn new(
        serial: &str,
        sensor: SensorModel,
        scene: Arc<dyn RadianceSource>,
        bench: Bench,
    ) -> Self {
        let controls = controls();
        let strings = ["mock-devices", "Simulated USB camera", serial];
        let [width, height] = sensor.resolution_px();
        let interfaces = [control_interface(), streaming_interface(width, height)];
        Self {
            descriptors: Descriptors::new(Identity::gadget(0x0e01), strings, &interfaces),
            sensor,
            scene,
            bench,
            kept_exposure: controls[EXPOSURE].value,
            controls,
            faults: CameraFaults::default(),
            format: 1,
            interval: INTERVALS[0],
            exposing: None,
            sending: None,
            frames: 0,
        }
    }

    /// Handle for making it fail.
    pub fn faults(&self) -> CameraFaults {
        self.faults.clone()
    }

    fn begin(&mut self) -> Exposing {
        let wanted = self.controls[EXPOSURE].value;
        if !self.faults.now().ignores_exposure {
            self.kept_exposure = wanted;
        }
        Exposing {
            start_s: self.bench.clock().now_s(),
            exposure_s: f64::from(self.kept_exposure) * EXPOSURE_STEP_S,
            gain: f64::from(self.controls[GAIN].value) / UNIT_GAIN,
        }
    }

    /// The frame that was exposed since `exposing`, as the format has it.
    fn read_out(&mut self, exposing: Exposing) -> Sending {
        self.frames += 1;
        let Exposing {
            start_s,
            exposure_s,
            gain,
        } = exposing;
        let light = self.bench.illumination_over(start_s, start_s + exposure_s);
        let key = NoiseKey {
            seed: 1,
            frame: FrameKey {
                light: 0,
                exposure: 0,
                repeat: self.frames,
                kind: 0,
            },
        };
        let radiance = self.scene.radiance(&light);
        let counts = self.sensor.expose(&radiance, exposure_s, gain, key);
        let shift = self.sensor.config().bit_depth.saturating_sub(8);
        let eight = |count: &u16| (count >> shift) as u8;
        let mut bytes: Vec<u8> = match &FORMATS[self.format - 1].0 {
            b"YUY2" => counts
                .iter()
                .flat_map(|count| [eight(count), 128])
                .collect(),
            b"Y800" => counts.iter().map(eight).collect(),
            _ => counts
                .iter()
                .flat_map(|count| count.to_le_bytes())
                .collect(),
        };
        let mut faults = self.faults.now();
        if due(&mut faults.cut) {
            bytes.truncate(bytes.len() / 2);
        }
        let is_damaged = due(&mut faults.damaged);
        Sending {
            bytes,
            sent: 0,
            is_damaged,
        }
    }

    /// The stream's parameters (UVC 1.1, §4.3.1.1).
    fn parameters(&self, format: u8, interval: u32) -> Vec<u8> {
        let [width, height] = self.sensor.resolution_px();
        let depth = u32::from(FORMATS[usize::from(format) - 1].1);
        let mut bytes = vec![0, 0, format, 1];
        bytes.extend(interval.to_le_bytes());
        bytes.extend([0; 10]);
        bytes.extend((width * height * depth / 8).to_le_bytes());
        bytes.extend((PAYLOAD as u32).to_le_bytes());
        bytes
    }

    fn stream_request(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        let is_commit = setup.value >> 8 == 2;
        let last = FORMATS.len() as u8;
        match setup.request {
            SET_CUR => {
                let format = *data.get(2).ok_or(Stall)?;
                let interval = data.get(4..8).ok_or(Stall)?;
                let interval = u32::from_le_bytes(interval.try_into().map_err(|_| Stall)?);
                self.format = usize::from(format.clamp(1, last));
                let known = INTERVALS.contains(&interval);
                self.interval = if known { interval } else { INTERVALS[0] };
                if is_commit {
                    (self.exposing, self.sending) = (None, None);
                }
                Ok(Vec::new())
            }
            GET_CUR => Ok(self.parameters(self.format as u8, self.interval)),
            GET_MIN | GET_DEF => Ok(self.parameters(1, INTERVALS[0])),
            GET_MAX => Ok(self.parameters(last, INTERVALS[2])),
            GET_LEN => Ok(vec![26, 0]),
            GET_INFO => Ok(vec![3]),
            _ => Err(Stall),
        }
    }

    fn control_request(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        let place = ((setup.index >> 8) as u8, (setup.value >> 8) as u8);
        let at = self.controls.iter().position(|c| c.place == place);
        let at = at.ok_or(Stall)?;
        let is_manual = self.controls[MODE].value == MANUAL;
        let control = &mut self.controls[at];
        let bytes = |value: u32| Ok(value.to_le_bytes()[..control.bytes].to_vec());
        match setup.request {
            SET_CUR => {
                let stalls = self.faults.now().stalls_exposure || !is_manual;
                if at == EXPOSURE && stalls {
                    return Err(Stall);
                }
                let mut value = [0; 4];
                let given = data.get(..control.bytes).ok_or(Stall)?;
                value[..control.bytes].copy_from_slice(given);
                control.value = u32::from_le_bytes(value);
                Ok(Vec::new())
            }
            GET_CUR => bytes(control.value),
            GET_MIN => bytes(control.minimum),
            GET_MAX => bytes(control.maximum),
            GET_RES => bytes(control.step),
            GET_DEF => bytes(control.default),
            GET_LEN => Ok(vec![control.bytes as u8, 0]),
            GET_INFO => Ok(vec![3]),
            _ => Err(Stall),
        }
    }
}

impl UsbDevice for UsbCamera {
    fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        if setup.index & 0xff == 1 {
            self.stream_request(setup, data)
        } else {
            self.control_request(setup, data)
        }
    }

    fn take(&mut self, _: u8, _: &[u8]) {}

    fn give(&mut self, _: u8, most: usize) -> Option<Vec<u8>> {
        if self.sending.is_none() {
            if self.faults.now().silent {
                return None;
            }
            let exposing = match self.exposing {
                Some(exposing) => exposing,
                None => {
                    let begun = self.begin();
                    *self.exposing.insert(begun)
                }
            };
            let interval_s = f64::from(self.interval) * 100e-9;
            let due_s = exposing.start_s + exposing.exposure_s.max(interval_s);
            if self.bench.clock().now_s() < due_s {
                return None;
            }
            self.exposing = None;
            self.sending = Some(self.read_out(exposing));
        }
        let sending = self.sending.as_mut()?;
        let left = &sending.bytes[sending.sent..];
        let part = &left[..left.len().min(most.min(PAYLOAD).saturating_sub(2))];
        let ends = part.len() == left.len();
        // End of header, error, end of frame, and a bit that turns with every frame.
        let flags = 0x80
            | u8::from(sending.is_damaged) << 6
            | u8::from(ends) << 1
            | (self.frames & 1) as u8;
        let payload = [&[2, flags], part].concat();
        sending.sent += part.len();
        if ends {
            self.sending = None;
        }
        Some(payload)
    }
}

/// The interface that controls the camera: terminal 1 (the sensor), unit 2
/// (processing), terminal 3 (USB).
fn control_interface() -> Vec<u8> {
    let mut bytes = vec![
        8, 11, 0, 2, 0x0e, 3, 0, 2, // both interfaces are one function
        9, 4, 0, 0, 0, 0x0e, 1, 0, 2, //
        13, 0x24, 1, 0, 1, 51, 0, // class version 1.0; 51 bytes follow and precede
    ];
    bytes.extend(48_000_000_u32.to_le_bytes());
    bytes.extend([
        1, 1, // streams on interface 1
        18, 0x24, 2, 1, 1, 2, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x0a, 0, 0, // mode and exposure
        11, 0x24, 5, 2, 1, 0, 0, 2, 0x41, 0x12, 0, // brightness, white balance, gain
        9, 0x24, 3, 3, 1, 1, 0, 2, 0,
    ]);
    bytes
}

/// The interface that streams: every format in the sensor's size.
fn streaming_interface(width: u32, height: u32) -> Vec<u8> {
    let mut formats = Vec::new();
    for (index, (code, depth)) in FORMATS.iter().enumerate() {
        formats.extend([27, 0x24, 4, index as u8 + 1, 1]);
        // A code becomes a GUID (UVC 1.1, uncompressed payload, §2.2).
        formats.extend(code);
        formats.extend([0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71]);
        formats.extend([*depth, 1, 0, 0, 0, 0]);
        let size = width * height * u32::from(*depth) / 8;
        formats.extend([26 + 4 * INTERVALS.len() as u8, 0x24, 5, 1, 0]);
        formats.extend((width as u16).to_le_bytes());
        formats.extend((height as u16).to_le_bytes());
        for rate in [2, 30] {
            formats.extend((size * 8 * rate).to_le_bytes());
        }
        formats.extend(size.to_le_bytes());
        formats.extend(INTERVALS[0].to_le_bytes());
        formats.push(INTERVALS.len() as u8);
        formats.extend(INTERVALS.iter().flat_map(|interval| interval.to_le_bytes()));
    }
    let count = FORMATS.len() as u8;
    let header_length = 13 + count;
    let mut bytes = vec![9, 4, 1, 0, 1, 0x0e, 2, 0, 0, header_length, 0x24, 1, count];
    bytes.extend((u16::from(header_length) + formats.len() as u16).to_le_bytes());
    bytes.extend([BULK_IN, 0, 3, 0, 0, 0, 1]);
    bytes.extend(FORMATS.map(|_| 0));
    bytes.extend(formats);
    bytes.extend([7, 5, BULK_IN, 2, 0, 2, 0]);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use mock_devices::Illumination;
    use mock_devices::bench::BenchConfig;
    use mock_devices::clock::Clock;
    use mock_devices::sensor::SensorConfig;

    struct Grey;

    impl RadianceSource for Grey {
        fn resolution_px(&self) -> [u32; 2] {
            [128, 96]
        }
        fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
            Arc::new(vec![0.5; 128 * 96])
        }
    }

    fn camera(clock: Clock) -> UsbCamera {
        let sensor = SensorModel::new(SensorConfig::typical([128, 96], 1));
        let bench = Bench::new(BenchConfig::default(), clock);
        UsbCamera::new("C1", sensor, Arc::new(Grey), bench)
    }

    fn request(camera: &mut UsbCamera, request: u8, place: (u8, u8), data: &[u8]) -> Option<u32> {
        let setup = Setup {
            request_type: if request & 0x80 != 0 { 0xa1 } else { 0x21 },
            request,
            value: u16::from(place.1) << 8,
            index: u16::from(place.0) << 8,
            length: 4,
        };
        let answer = camera.control(setup, data).ok()?;
        let mut value = [0; 4];
        value[..answer.len()].copy_from_slice(&answer);
        Some(u32::from_le_bytes(value))
    }

    /// A frame's bytes, and whether all its payloads were whole.
    fn frame(camera: &mut UsbCamera) -> Option<(Vec<u8>, bool)> {
        let (mut bytes, mut whole) = (Vec::new(), true);
        loop {
            let payload = camera.give(1, PAYLOAD)?;
            whole &= payload[1] & 0x40 == 0;
            bytes.extend(&payload[2..]);
            if payload[1] & 2 != 0 {
                return Some((bytes, whole));
            }
        }
    }

    #[test]
    fn descriptors_are_chained_by_their_lengths() {
        for interface in [control_interface(), streaming_interface(128, 96)] {
            let mut rest = &interface[..];
            while let Some(&length) = rest.first() {
                assert!(length >= 2 && usize::from(length) <= rest.len(), "{rest:?}");
                rest = &rest[usize::from(length)..];
            }
        }
        // The headers tell how long what they lead is, themselves included.
        let control = control_interface();
        assert_eq!(control.len() - 17, usize::from(control[22]));
        let streaming = streaming_interface(128, 96);
        let length = u16::from_le_bytes([streaming[13], streaming[14]]);
        assert_eq!(streaming.len() - 9 - 7, usize::from(length));
    }

    #[test]
    fn exposures_are_refused_until_they_are_manual_and_show_in_the_frames() {
        let clock = Clock::manual();
        let mut camera = camera(clock.clone());
        let exposure = |value: u32| value.to_le_bytes();
        assert_eq!(
            request(&mut camera, SET_CUR, (CAMERA, 4), &exposure(50)),
            None
        );
        request(&mut camera, SET_CUR, (CAMERA, 2), &[1]).unwrap();
        let mut means = Vec::new();
        for steps in [50, 100] {
            request(&mut camera, SET_CUR, (CAMERA, 4), &exposure(steps)).unwrap();
            assert_eq!(request(&mut camera, GET_CUR, (CAMERA, 4), &[]), Some(steps));
            camera.format = 2;
            assert_eq!(frame(&mut camera), None);
            clock.advance(0.034);
            let (bytes, whole) = frame(&mut camera).unwrap();
            assert!(whole);
            assert_eq!(bytes.len(), 2 * 128 * 96);
            let sum: f64 = bytes
                .as_chunks::<2>()
                .0
                .iter()
                .map(|&count| f64::from(u16::from_le_bytes(count)))
                .sum();
            let black = camera.sensor.config().black_level_dn;
            means.push(sum / (128.0 * 96.0) - black);
        }
        assert!((means[1] / means[0] - 2.0).abs() < 0.02, "{means:?}");
    }

    #[test]
    fn it_fails_as_it_is_told() {
        let clock = Clock::manual();
        let mut camera = camera(clock.clone());
        let faults = camera.faults();
        let mut next = || {
            assert_eq!(frame(&mut camera), None);
            clock.advance(0.1);
            frame(&mut camera)
        };
        let whole = next().unwrap();
        faults.now().damaged = 1;
        assert!(!next().unwrap().1);
        faults.now().cut = 1;
        assert_eq!(next().unwrap().0.len(), whole.0.len() / 2);
        faults.now().silent = true;
        assert_eq!(next(), None);
        faults.now().silent = false;
        clock.advance(0.1);
        assert!(next().is_some());
        faults.now().stalls_exposure = true;
        request(&mut camera, SET_CUR, (CAMERA, 2), &[1]).unwrap();
        assert_eq!(
            request(&mut camera, SET_CUR, (CAMERA, 4), &[9, 0, 0, 0]),
            None
        );
        faults.now().stalls_exposure = false;
        faults.now().ignores_exposure = true;
        assert!(request(&mut camera, SET_CUR, (CAMERA, 4), &[9, 0, 0, 0]).is_some());
        assert_eq!(camera.begin().exposure_s, 156.0 * EXPOSURE_STEP_S);
    }
}
