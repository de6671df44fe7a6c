//! The device's memory: the bootstrap registers of GigE Vision 2.0, section 28, the features
//! of the GenICam description, and the description itself.

use super::gvcp::Status;
use super::{pixels, xml};

/// Control channel privilege.
pub const CONTROL: u32 = 0x0a00;
/// Heartbeat time-out, milliseconds.
pub const HEARTBEAT: u32 = 0x0938;
/// Command to latch the clock, and where it then is.
pub const TIMESTAMP_CONTROL: u32 = 0x0944;
/// The latched clock, ticks, eight bytes.
pub const TIMESTAMP_LATCHED: u32 = 0x0948;
/// The controller's port of the stream.
pub const STREAM_PORT: u32 = 0x0d00;
/// Size of a packet, and the bit that asks for a test packet.
pub const PACKET_SIZE: u32 = 0x0d04;
/// The controller's address of the stream.
pub const STREAM_ADDRESS: u32 = 0x0d18;
/// The serial number, 16 bytes of text.
pub const SERIAL: u32 = 0x00d8;
/// Bytes of the answer to a discovery.
pub const DISCOVERED: usize = 0xf8;
/// Ticks of the device's clock in a second.
pub const TICKS_PER_S: f64 = 1e9;

const FEATURES: u32 = 0x1_0000;
/// Where the features are.
pub const WIDTH: u32 = FEATURES;
/// Rows.
pub const HEIGHT: u32 = FEATURES + 0x08;
/// Number of the format.
pub const PIXEL_FORMAT: u32 = FEATURES + 0x10;
/// Bytes of a frame.
pub const PAYLOAD_SIZE: u32 = FEATURES + 0x18;
/// Microseconds, a float.
pub const EXPOSURE: u32 = FEATURES + 0x20;
/// Decibel, a float.
pub const GAIN: u32 = FEATURES + 0x28;
/// DN, a float.
pub const BLACK_LEVEL: u32 = FEATURES + 0x30;
/// 1: on.
pub const GAMMA_ENABLE: u32 = FEATURES + 0x38;
/// 0: off, 2: continuous.
pub const EXPOSURE_AUTO: u32 = FEATURES + 0x40;
/// 0: off, 2: continuous.
pub const GAIN_AUTO: u32 = FEATURES + 0x48;
/// 0: off, 1: on.
pub const TRIGGER_MODE: u32 = FEATURES + 0x50;
/// 0: software, 1: a line.
pub const TRIGGER_SOURCE: u32 = FEATURES + 0x58;
/// 0: the start of a frame.
pub const TRIGGER_SELECTOR: u32 = FEATURES + 0x60;
/// Command.
pub const TRIGGER_SOFTWARE: u32 = FEATURES + 0x68;
/// Command.
pub const ACQUISITION_START: u32 = FEATURES + 0x70;
/// Command.
pub const ACQUISITION_STOP: u32 = FEATURES + 0x78;
/// 0: continuous.
pub const ACQUISITION_MODE: u32 = FEATURES + 0x80;
/// Degrees Celsius, a float.
pub const TEMPERATURE: u32 = FEATURES + 0x88;
const FEATURES_END: u32 = FEATURES + 0x90;
const DESCRIPTION: usize = 0x2_0000;

/// Exposure: shortest, longest and step, microseconds.
pub const EXPOSURE_US: [f64; 3] = [20.0, 10e6, 10.0];
/// Gain: lowest, highest and step, decibel.
pub const GAIN_DB: [f64; 3] = [0.0, 24.0, 0.1];

/// What the device is called.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Serial number, at most 15 characters.
    pub serial: String,
    /// Its address.
    pub address: std::net::Ipv4Addr,
}

/// Registers and texts.
pub struct Memory {
    bytes: Vec<u8>,
    largest_black_dn: f64,
}

impl Memory {
    /// As when the device is switched on: everything automatic is on.
    pub fn new(identity: &Identity, [width, height]: [u32; 2], black_dn: f64) -> Self {
        let description = xml::description([width, height]);
        let mut bytes = vec![0; DESCRIPTION];
        bytes.extend(description.as_bytes());
        let mut memory = Self {
            bytes,
            largest_black_dn: 4.0 * black_dn.max(16.0),
        };
        let address = u32::from(identity.address);
        // Version 1.2; big-endian and UTF-8; a locally administered hardware address.
        for (at, value) in [
            (0x0000, 0x0001_0002),
            (0x0004, 0x8000_0001),
            (0x0008, 0x0200),
            (0x000c, address),
            (0x0010, 0x0000_0004),
            (0x0014, 0x0000_0004),
            (0x0024, address),
            (0x0034, 0xff00_0000),
            (0x0600, 1),
            (0x0904, 1),
            // Resending packets, writing memory, several registers in a command.
            (0x0934, 0x0000_0007),
            (HEARTBEAT, 3000),
            (0x093c, 0),
            (0x0940, TICKS_PER_S as u32),
            (PACKET_SIZE, 1500),
            (WIDTH, width),
            (HEIGHT, height),
            (PIXEL_FORMAT, pixels::FORMATS[0].code),
            (GAMMA_ENABLE, 1),
            (EXPOSURE_AUTO, 2),
            (GAIN_AUTO, 2),
        ] {
            memory.put(at, value);
        }
        let url = format!("Local:rig-mock.xml;{DESCRIPTION:x};{:x}", description.len());
        for (at, text) in [
            (0x0048, "mock-devices"),
            (0x0068, "Simulated GigE camera"),
            (0x0088, "1"),
            (SERIAL, &identity.serial),
            (0x0200, &url),
        ] {
            memory.bytes[at as usize..][..text.len()].copy_from_slice(text.as_bytes());
        }
        for (at, value) in [(EXPOSURE, 10e3), (GAIN, 0.0), (BLACK_LEVEL, black_dn)] {
            memory.put_float(at, value);
        }
        memory.settle();
        memory
    }

    /// A register.
    pub fn get(&self, at: u32) -> u32 {
        let four = &self.bytes[at as usize..][..4];
        four.iter()
            .fold(0, |value, &byte| value << 8 | u32::from(byte))
    }

    /// Sets a register, also one that a controller cannot write.
    pub fn put(&mut self, at: u32, value: u32) {
        self.bytes[at as usize..][..4].copy_from_slice(&value.to_be_bytes());
    }

    /// A float.
    pub fn float(&self, at: u32) -> f64 {
        let high = u64::from(self.get(at)) << 32;
        f64::from_bits(high | u64::from(self.get(at + 4)))
    }

    /// Sets a float.
    pub fn put_float(&mut self, at: u32, value: f64) {
        self.bytes[at as usize..][..8].copy_from_slice(&value.to_be_bytes());
    }

    /// Sets the latched clock, ticks.
    pub fn latch(&mut self, ticks: u64) {
        self.bytes[TIMESTAMP_LATCHED as usize..][..8].copy_from_slice(&ticks.to_be_bytes());
    }

    /// Bytes as a controller reads them: whole words, zeros behind the end of the description.
    ///
    /// # Errors
    /// There is nothing.
    pub fn read(&self, at: u32, count: usize) -> Result<Vec<u8>, Status> {
        let at = at as usize;
        if at >= self.bytes.len() {
            return Err(Status::InvalidAddress);
        }
        let there = &self.bytes[at..self.bytes.len().min(at + count)];
        let mut bytes = there.to_vec();
        bytes.resize(count, 0);
        Ok(bytes)
    }

    /// Writes as a controller does; values are rounded to what the device has.
    ///
    /// # Errors
    /// It cannot be written, or not with this value.
    pub fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), Status> {
        let end = at.saturating_add(bytes.len() as u32);
        let is_feature = at >= FEATURES && end <= FEATURES_END;
        let registers = [
            CONTROL,
            HEARTBEAT,
            TIMESTAMP_CONTROL,
            STREAM_PORT,
            PACKET_SIZE,
            STREAM_ADDRESS,
        ];
        let is_register = bytes.len() == 4 && registers.contains(&at);
        if !(is_feature || is_register) {
            return Err(match (at as usize) < self.bytes.len() {
                true => Status::WriteProtect,
                false => Status::InvalidAddress,
            });
        }
        let read_only = [PAYLOAD_SIZE, TEMPERATURE, WIDTH, HEIGHT];
        if read_only.iter().any(|&only| at < only + 8 && end > only) {
            return Err(Status::WriteProtect);
        }
        let before = self.bytes[at as usize..end as usize].to_vec();
        self.bytes[at as usize..end as usize].copy_from_slice(bytes);
        let is_known = pixels::of_code(self.get(PIXEL_FORMAT)).is_some();
        let floats = [EXPOSURE, GAIN, BLACK_LEVEL];
        if !is_known || floats.iter().any(|&at| !self.float(at).is_finite()) {
            self.bytes[at as usize..end as usize].copy_from_slice(&before);
            return Err(Status::InvalidParameter);
        }
        self.settle();
        Ok(())
    }

    /// Values that follow from others, and values rounded to their steps.
    fn settle(&mut self) {
        let black = [0.0, self.largest_black_dn, 1.0];
        for (at, range) in [
            (EXPOSURE, EXPOSURE_US),
            (GAIN, GAIN_DB),
            (BLACK_LEVEL, black),
        ] {
            let [low, high, step] = range;
            let steps = (self.float(at) / step).round();
            self.put_float(at, (steps * step).clamp(low, high));
        }
        let pixels = self.get(WIDTH) as usize * self.get(HEIGHT) as usize;
        if let Some(format) = pixels::of_code(self.get(PIXEL_FORMAT)) {
            self.put(PAYLOAD_SIZE, format.bytes(pixels) as u32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn memory() -> Memory {
        let identity = Identity {
            serial: "M1".to_owned(),
            address: [127, 0, 0, 9].into(),
        };
        Memory::new(&identity, [32, 24], 64.0)
    }

    #[test]
    fn the_description_is_where_the_url_points() {
        let memory = memory();
        let url = memory.read(0x0200, 512).unwrap();
        let text = String::from_utf8(url).unwrap();
        let parts: Vec<&str> = text.trim_end_matches('\0').split(';').collect();
        let number = |at: usize| u32::from_str_radix(parts[at], 16).unwrap();
        let read = memory.read(number(1), number(2) as usize).unwrap();
        assert_eq!(read, xml::description([32, 24]).into_bytes());
        assert!(parts[0].starts_with("Local:"));
    }

    #[test]
    fn values_are_rounded_and_refused_as_on_a_camera() {
        let mut memory = memory();
        memory.write(EXPOSURE, &12_344.0_f64.to_be_bytes()).unwrap();
        assert_eq!(memory.float(EXPOSURE), 12_340.0);
        memory.write(EXPOSURE, &1e30_f64.to_be_bytes()).unwrap();
        assert_eq!(memory.float(EXPOSURE), EXPOSURE_US[1]);
        let nan = memory.write(EXPOSURE, &f64::NAN.to_be_bytes());
        assert_eq!(nan, Err(Status::InvalidParameter));
        assert_eq!(memory.float(EXPOSURE), EXPOSURE_US[1]);
        assert_eq!(memory.write(WIDTH, &[0; 4]), Err(Status::WriteProtect));
        assert_eq!(memory.write(0, &[0; 4]), Err(Status::WriteProtect));
        assert_eq!(memory.write(u32::MAX, &[0; 4]), Err(Status::InvalidAddress));
        assert_eq!(memory.read(u32::MAX, 4), Err(Status::InvalidAddress));
        let unknown = memory.write(PIXEL_FORMAT, &[1, 2, 3, 4]);
        assert_eq!(unknown, Err(Status::InvalidParameter));
        memory
            .write(PIXEL_FORMAT, &0x010c_0047_u32.to_be_bytes())
            .unwrap();
        assert_eq!(memory.get(PAYLOAD_SIZE), 32 * 24 * 3 / 2);
    }
}
