//! The body of a still camera: properties, objects, and the operations on them.

use std::collections::BTreeMap;

use super::dataset::{Dataset, Property, Width};
use super::dng::RawFile;
use super::faults::BodyFaults;
use mock_devices::camera::SimulatedCamera;
use mock_devices::failing::due;
use mock_devices::sensor::FrameKey;

/// Code of the exposure time, in units of 0.1 ms.
pub const EXPOSURE_TIME: u16 = 0x500d;
/// Code of the sensitivity.
pub const EXPOSURE_INDEX: u16 = 0x500f;
/// Code of the aperture, in hundredths.
pub const F_NUMBER: u16 = 0x5007;
/// Code of the battery's charge, percent.
pub const BATTERY: u16 = 0x5001;
/// Code of the format of the files.
pub const COMPRESSION: u16 = 0x5004;

const OK: u16 = 0x2001;
const GENERAL_ERROR: u16 = 0x2002;
const SESSION_NOT_OPEN: u16 = 0x2003;
const NOT_SUPPORTED: u16 = 0x2005;
const INVALID_STORAGE: u16 = 0x2008;
const INVALID_OBJECT: u16 = 0x2009;
const PROPERTY_NOT_SUPPORTED: u16 = 0x200a;
const STORE_FULL: u16 = 0x200c;
const DEVICE_BUSY: u16 = 0x2019;
const INVALID_FORMAT: u16 = 0x201b;
const INVALID_VALUE: u16 = 0x201c;

const OBJECT_ADDED: u16 = 0x4002;
const CAPTURE_COMPLETE: u16 = 0x400d;

/// The one store.
const STORAGE: u32 = 0x0001_0001;
/// Format of the files: DNG. Clients do not fetch files of an undefined format.
const RAW_FORMAT: u16 = 0x3811;
/// Value of [`COMPRESSION`] for raw files.
const RAW: u32 = 0x10;

const OPERATIONS: [u16; 13] = [
    0x1001, 0x1002, 0x1003, 0x1004, 0x1005, 0x1006, 0x1007, 0x1008, 0x1009, 0x100b, 0x100e, 0x1014,
    0x1015,
];
const SET_VALUE: u16 = 0x1016;

/// What the body is.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyConfig {
    /// Maker and model.
    pub maker_and_model: [String; 2],
    /// Serial number.
    pub serial: String,
    /// Shutter speeds as numerator and denominator, seconds: what the shutter does and the
    /// files state. The list of the protocol has them in steps of 0.1 ms.
    pub speeds: Vec<[u32; 2]>,
    /// Sensitivities; the first is the sensor's gain 1.
    pub isos: Vec<u16>,
    /// Apertures times 100. They do not change the light.
    pub f_numbers_100: Vec<u16>,
    /// Colours of the filters, see [`RawFile::filters`].
    pub filters: Option<[u8; 4]>,
    /// So many files fit.
    pub room: usize,
}

impl Default for BodyConfig {
    /// Speeds in thirds of a stop from 1/1000 s to 2 s.
    fn default() -> Self {
        let fractions = [
            1000, 800, 640, 500, 400, 320, 250, 200, 160, 125, 100, 80, 60, 50, 40, 30, 25, 20, 15,
            13, 10, 8, 6, 5, 4,
        ];
        let tenths = [3, 4, 5, 6, 8, 10, 13, 16, 20];
        let fractions = fractions.map(|below| [1, below]).into_iter();
        Self {
            maker_and_model: ["Simulated".to_owned(), "Still Camera".to_owned()],
            serial: "S0001".to_owned(),
            speeds: fractions.chain(tenths.map(|above| [above, 10])).collect(),
            isos: vec![100, 200, 400, 800],
            f_numbers_100: vec![400, 560, 800, 1100],
            filters: None,
            room: 500,
        }
    }
}

/// How an operation ends.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reply {
    /// Code of the response.
    pub code: u16,
    /// Its parameters.
    pub parameters: Vec<u32>,
    /// Data for the client.
    pub data: Option<Vec<u8>>,
    /// Whether the shutter is released now: [`Body::expose`] is to follow.
    pub exposes: bool,
}

impl Reply {
    fn of(code: u16) -> Self {
        Self {
            code,
            ..Self::default()
        }
    }

    fn data(data: Dataset) -> Self {
        Self {
            data: Some(data.0),
            ..Self::of(OK)
        }
    }
}

/// A body with its store.
pub struct Body {
    config: BodyConfig,
    camera: SimulatedCamera,
    faults: BodyFaults,
    properties: Vec<Property>,
    objects: BTreeMap<u32, Vec<u8>>,
    taken: u32,
    has_session: bool,
}

/// What a speed is in the list of the protocol, 0.1 ms.
fn listed([numerator, denominator]: [u32; 2]) -> u32 {
    let units = 1e4 * f64::from(numerator) / f64::from(denominator);
    (units.round() as u32).max(1)
}

impl Body {
    /// A body around this sensor, at its first speed, sensitivity and aperture.
    pub fn new(config: BodyConfig, camera: SimulatedCamera) -> Self {
        let property = |code, width, allowed: Vec<u32>| Property {
            code,
            width,
            current: allowed.first().copied().unwrap_or_default(),
            allowed,
        };
        let wide = |values: &[u16]| values.iter().map(|&value| value.into()).collect();
        let properties = vec![
            Property {
                code: BATTERY,
                width: Width::U8,
                current: 85,
                allowed: Vec::new(),
            },
            property(COMPRESSION, Width::U8, vec![RAW]),
            property(F_NUMBER, Width::U16, wide(&config.f_numbers_100)),
            property(
                EXPOSURE_TIME,
                Width::U32,
                config.speeds.iter().map(|&speed| listed(speed)).collect(),
            ),
            property(EXPOSURE_INDEX, Width::U16, wide(&config.isos)),
        ];
        Self {
            config,
            camera,
            faults: BodyFaults::default(),
            properties,
            objects: BTreeMap::new(),
            taken: 0,
            has_session: false,
        }
    }

    /// Handle for making it fail.
    pub fn faults(&self) -> BodyFaults {
        self.faults.clone()
    }

    /// What it is.
    pub fn config(&self) -> &BodyConfig {
        &self.config
    }

    /// Files that are stored.
    pub fn objects(&self) -> usize {
        self.objects.len()
    }

    /// A new client.
    pub fn connect(&mut self) {
        self.has_session = false;
    }

    /// An operation with its parameters and the client's data.
    pub fn operation(&mut self, code: u16, parameters: &[u32], data: &[u8]) -> Reply {
        let parameter = |index: usize| parameters.get(index).copied().unwrap_or_default();
        // Before a session.
        match code {
            0x1001 => return Reply::data(self.device_info()),
            0x1002 => {
                self.has_session = true;
                return Reply::of(OK);
            }
            _ if !self.has_session => return Reply::of(SESSION_NOT_OPEN),
            0x1003 => {
                self.has_session = false;
                return Reply::of(OK);
            }
            0x100e | SET_VALUE if due(&mut self.faults.now().busy) => {
                return Reply::of(DEVICE_BUSY);
            }
            _ => {}
        }
        // Storage and objects, then properties.
        let object = parameter(0);
        match code {
            0x1004 => Reply::data(Dataset::default().handles(&[STORAGE])),
            0x1005 if object == STORAGE => Reply::data(self.storage_info()),
            0x1005 => Reply::of(INVALID_STORAGE),
            0x1006 => Reply {
                parameters: vec![self.objects.len() as u32],
                ..Reply::of(OK)
            },
            0x1007 => {
                let handles: Vec<u32> = self.objects.keys().copied().collect();
                Reply::data(Dataset::default().handles(&handles))
            }
            0x1008 => match self.objects.get(&object) {
                Some(file) => Reply::data(self.object_info(object, file.len())),
                None => Reply::of(INVALID_OBJECT),
            },
            0x1009 => match self.objects.get(&object) {
                Some(file) => Reply::data(Dataset(file.clone())),
                None => Reply::of(INVALID_OBJECT),
            },
            0x100b => match self.objects.remove(&object) {
                Some(_) => Reply::of(OK),
                None => Reply::of(INVALID_OBJECT),
            },
            0x100e => self.release(),
            0x1014 | 0x1015 => match self.property(parameter(0)) {
                Some(property) if code == 0x1014 => Reply::data(property.description()),
                Some(property) => Reply::data(property.value()),
                None => Reply::of(PROPERTY_NOT_SUPPORTED),
            },
            SET_VALUE => Reply::of(self.set(parameter(0), data)),
            _ => Reply::of(NOT_SUPPORTED),
        }
    }

    fn property(&mut self, code: u32) -> Option<&mut Property> {
        let is_it = |property: &&mut Property| u32::from(property.code) == code;
        self.properties.iter_mut().find(is_it)
    }

    /// Sets a property and returns the response.
    fn set(&mut self, code: u32, data: &[u8]) -> u16 {
        let is_speed = code == u32::from(EXPOSURE_TIME);
        if is_speed && due(&mut self.faults.now().refused_speeds) {
            return INVALID_VALUE;
        }
        let keeps = is_speed && due(&mut self.faults.now().kept_speeds);
        let Some(property) = self.property(code) else {
            return PROPERTY_NOT_SUPPORTED;
        };
        match property.width.parse(data) {
            None => INVALID_FORMAT,
            Some(value) if !property.allowed.contains(&value) => INVALID_VALUE,
            Some(_) if keeps => OK,
            Some(value) => {
                property.current = value;
                OK
            }
        }
    }

    fn release(&self) -> Reply {
        if self.objects.len() >= self.config.room || self.faults.now().is_full {
            return Reply::of(STORE_FULL);
        }
        Reply {
            exposes: true,
            ..Reply::of(OK)
        }
    }

    fn current(&mut self, code: u16) -> u32 {
        self.property(code.into())
            .map_or(0, |property| property.current)
    }

    /// The speed of the shutter now, exactly.
    fn speed(&mut self) -> [u32; 2] {
        let units = self.current(EXPOSURE_TIME);
        let speeds = self.config.speeds.iter();
        let mut of_units = speeds.filter(|&&speed| listed(speed) == units);
        of_units.next().copied().unwrap_or([units, 10_000])
    }

    /// Takes the frame after a release; the events are for the client.
    ///
    /// # Errors
    /// Code of the response that says why there is no frame.
    pub fn expose(&mut self) -> Result<Vec<(u16, Vec<u32>)>, u16> {
        // The exposure.
        let [numerator, denominator] = self.speed();
        let iso = self.current(EXPOSURE_INDEX);
        let mut exposure_s = f64::from(numerator) / f64::from(denominator);
        if due(&mut self.faults.now().half_exposure) {
            exposure_s /= 2.0;
        }
        let base = self.config.isos.first().copied().unwrap_or(100);
        let gain = f64::from(iso) / f64::from(base);
        self.taken += 1;
        let key = FrameKey {
            light: 0,
            exposure: 0,
            repeat: self.taken,
            kind: 0,
        };
        let configured = self.camera.configure(exposure_s, gain);
        let frame = configured.and_then(|_| self.camera.grab(key));
        let frame = frame.map_err(|_| GENERAL_ERROR)?;
        // The file.
        let stated = match due(&mut self.faults.now().wrong_exif) {
            true => [2 * numerator, denominator],
            false => [numerator, denominator],
        };
        let f_number_100 = self.current(F_NUMBER);
        let sensor = self.camera.sensor();
        let [maker, model] = &self.config.maker_and_model;
        let mut file = RawFile {
            size_px: [frame.width, frame.height],
            counts: &frame.counts,
            filters: self.config.filters,
            black_level_dn: sensor.config().black_level_dn.round() as u32,
            white_level_dn: sensor.saturation_dn().into(),
            exposure: stated,
            f_number_100,
            iso: iso as u16,
            maker_and_model: [maker, model],
            serial: &self.config.serial,
        }
        .encode();
        if due(&mut self.faults.now().cut_files) {
            file.truncate(file.len() / 2);
        }
        if due(&mut self.faults.now().no_file) {
            return Ok(vec![(CAPTURE_COMPLETE, Vec::new())]);
        }
        // The store.
        let handle = self.taken;
        self.objects.insert(handle, file);
        Ok(vec![
            (OBJECT_ADDED, vec![handle]),
            (CAPTURE_COMPLETE, Vec::new()),
        ])
    }

    fn device_info(&self) -> Dataset {
        let mut operations = OPERATIONS.to_vec();
        operations.push(SET_VALUE);
        let properties: Vec<u16> = self.properties.iter().map(|known| known.code).collect();
        let [maker, model] = &self.config.maker_and_model;
        Dataset::default()
            .u16(100)
            .u32(0)
            .u16(100)
            .text("")
            .u16(0)
            .codes(&operations)
            .codes(&[OBJECT_ADDED, CAPTURE_COMPLETE])
            .codes(&properties)
            .codes(&[RAW_FORMAT])
            .codes(&[RAW_FORMAT])
            .text(maker)
            .text(model)
            .text("1.0")
            .text(&self.config.serial)
    }

    fn storage_info(&self) -> Dataset {
        let frame_bytes = 1 << 20;
        let left = self.config.room.saturating_sub(self.objects.len());
        Dataset::default()
            // Removable memory, a camera's folders, full access.
            .u16(4)
            .u16(3)
            .u16(0)
            .u64(frame_bytes * self.config.room as u64)
            .u64(frame_bytes * left as u64)
            .u32(left as u32)
            .text("store")
            .text("")
    }

    fn object_info(&self, handle: u32, length: usize) -> Dataset {
        let [width, height] = self.camera.sensor().resolution_px();
        let time = "20260101T120000";
        Dataset::default()
            .u32(STORAGE)
            .u16(RAW_FORMAT)
            .u16(0)
            .u32(length as u32)
            // No thumbnail.
            .u16(0)
            .u32(0)
            .u32(0)
            .u32(0)
            .u32(width)
            .u32(height)
            .u32(16)
            // At the root, in no association.
            .u32(0)
            .u16(0)
            .u32(0)
            .u32(handle)
            .text(&format!("IMG_{handle:04}.DNG"))
            .text(time)
            .text(time)
            .text("")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ptp::faults::Faults;
    use mock_devices::bench::{Bench, BenchConfig};
    use mock_devices::camera::CameraConfig;
    use mock_devices::clock::Clock;
    use mock_devices::sensor::{SensorConfig, SensorModel};
    use mock_devices::{Illumination, RadianceSource};
    use std::sync::Arc;

    struct Even;

    impl RadianceSource for Even {
        fn resolution_px(&self) -> [u32; 2] {
            [8, 4]
        }
        fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
            Arc::new(vec![0.05; 32])
        }
    }

    fn body() -> Body {
        let bench = Bench::new(BenchConfig::default(), Clock::instant());
        let sensor = SensorModel::new(SensorConfig {
            hot_fraction: 0.0,
            ..SensorConfig::typical([8, 4], 1)
        });
        let config = CameraConfig {
            settings_latency_frames: 0,
            ..CameraConfig::default()
        };
        let camera = SimulatedCamera::new(config, bench, sensor, Arc::new(Even));
        let mut body = Body::new(BodyConfig::default(), camera);
        assert_eq!(body.operation(0x1004, &[], &[]).code, SESSION_NOT_OPEN);
        assert_eq!(body.operation(0x1002, &[1], &[]).code, OK);
        body
    }

    fn set_speed(body: &mut Body, units: u32) -> u16 {
        let data = Dataset::default().u32(units).0;
        let code = u32::from(EXPOSURE_TIME);
        body.operation(SET_VALUE, &[code], &data).code
    }

    fn take(body: &mut Body) -> u32 {
        let reply = body.operation(0x100e, &[0, 0], &[]);
        assert!(reply.exposes);
        let events = body.expose().unwrap();
        assert_eq!(events[0].0, OBJECT_ADDED);
        events[0].1[0]
    }

    /// Mean count above the black level of the file's last 32 samples.
    fn signal(body: &mut Body, handle: u32) -> f64 {
        let file = body.operation(0x1009, &[handle], &[]).data.unwrap();
        let samples = file[file.len() - 64..].chunks(2);
        let sum: f64 = samples
            .map(|pair| f64::from(u16::from_le_bytes([pair[0], pair[1]])) - 64.0)
            .sum();
        sum / 32.0
    }

    #[test]
    fn a_file_follows_the_speed_and_the_sensitivity() {
        let mut body = body();
        assert_eq!(set_speed(&mut body, 200), OK);
        let handle = take(&mut body);
        let at_20_ms = signal(&mut body, handle);
        assert_eq!(set_speed(&mut body, 800), INVALID_VALUE, "not listed");
        assert_eq!(set_speed(&mut body, 1000), OK);
        let handle = take(&mut body);
        let at_100_ms = signal(&mut body, handle);
        assert!(
            (at_100_ms / at_20_ms - 5.0).abs() < 0.2,
            "{at_20_ms} {at_100_ms}"
        );
        let data = Dataset::default().u16(200).0;
        assert_eq!(body.operation(SET_VALUE, &[0x500f], &data).code, OK);
        let handle = take(&mut body);
        let doubled = signal(&mut body, handle);
        assert!(
            (doubled / at_100_ms - 2.0).abs() < 0.1,
            "{at_100_ms} {doubled}"
        );
        assert_eq!(body.objects(), 3);
        assert_eq!(body.operation(0x100b, &[1], &[]).code, OK);
        assert_eq!(body.operation(0x1009, &[1], &[]).code, INVALID_OBJECT);
    }

    #[test]
    fn faults_come_when_asked_for() {
        let mut body = body();
        let faults = body.faults();
        faults.now().busy = 1;
        assert_eq!(set_speed(&mut body, 200), DEVICE_BUSY);
        faults.now().refused_speeds = 1;
        assert_eq!(set_speed(&mut body, 200), INVALID_VALUE);
        faults.now().kept_speeds = 1;
        assert_eq!(set_speed(&mut body, 200), OK);
        let code = u32::from(EXPOSURE_TIME);
        let read = body.operation(0x1015, &[code], &[]).data;
        assert_eq!(read, Some(vec![10, 0, 0, 0]), "1/1000 s as before");
        assert_eq!(set_speed(&mut body, 200), OK);
        let handle = take(&mut body);
        let whole = signal(&mut body, handle);
        faults.now().half_exposure = 1;
        let handle = take(&mut body);
        assert!((signal(&mut body, handle) / whole - 0.5).abs() < 0.05);
        faults.now().no_file = 1;
        body.operation(0x100e, &[0, 0], &[]);
        assert_eq!(body.expose().unwrap().len(), 1);
        faults.now().is_full = true;
        assert_eq!(body.operation(0x100e, &[0, 0], &[]).code, STORE_FULL);
        *faults.now() = Faults::default();
        assert_eq!(body.operation(0x100e, &[0, 0], &[]).code, OK);
    }
}
