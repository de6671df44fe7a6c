//! The device's GenICam description: names and values after the Standard Features Naming
//! Convention (SFNC 2.7).

use std::fmt::Write;

use super::memory::{self as at, EXPOSURE_US, GAIN_DB};
use super::pixels::FORMATS;

/// Names of an enumeration and their values.
type Entries = &'static [(&'static str, u32)];

const OFF_ON: Entries = &[("Off", 0), ("On", 1)];
const AUTO: Entries = &[("Off", 0), ("Once", 1), ("Continuous", 2)];

/// The text of it.
pub fn description([width, height]: [u32; 2]) -> String {
    let mut nodes = Nodes::default();
    // The sensor.
    nodes.integer("Width", at::WIDTH, width, "RO");
    nodes.integer("Height", at::HEIGHT, height, "RO");
    nodes.integer("PayloadSize", at::PAYLOAD_SIZE, u32::MAX, "RO");
    let formats: Vec<(&str, u32)> = FORMATS.iter().map(|f| (f.name, f.code)).collect();
    nodes.enumeration("PixelFormat", at::PIXEL_FORMAT, &formats);
    nodes.float("ExposureTime", at::EXPOSURE, EXPOSURE_US, "us", "RW");
    nodes.float("Gain", at::GAIN, GAIN_DB, "dB", "RW");
    nodes.float(
        "BlackLevel",
        at::BLACK_LEVEL,
        [0.0, 65_535.0, 1.0],
        "DN",
        "RW",
    );
    nodes.enumeration("ExposureAuto", at::EXPOSURE_AUTO, AUTO);
    nodes.enumeration("GainAuto", at::GAIN_AUTO, AUTO);
    nodes.boolean("GammaEnable", at::GAMMA_ENABLE);
    nodes.float(
        "DeviceTemperature",
        at::TEMPERATURE,
        [-50.0, 150.0, 0.001],
        "C",
        "RO",
    );
    // Frames.
    nodes.enumeration(
        "AcquisitionMode",
        at::ACQUISITION_MODE,
        &[("Continuous", 0)],
    );
    nodes.command("AcquisitionStart", at::ACQUISITION_START, 1);
    nodes.command("AcquisitionStop", at::ACQUISITION_STOP, 1);
    nodes.enumeration(
        "TriggerSelector",
        at::TRIGGER_SELECTOR,
        &[("FrameStart", 0)],
    );
    nodes.enumeration("TriggerMode", at::TRIGGER_MODE, OFF_ON);
    nodes.enumeration(
        "TriggerSource",
        at::TRIGGER_SOURCE,
        &[("Software", 0), ("Line1", 1)],
    );
    nodes.command("TriggerSoftware", at::TRIGGER_SOFTWARE, 1);
    // The device and its link.
    nodes.text("DeviceVendorName", 0x0048, 32);
    nodes.text("DeviceModelName", 0x0068, 32);
    nodes.text("DeviceVersion", 0x0088, 32);
    nodes.text("DeviceSerialNumber", at::SERIAL, 16);
    nodes.integer("GevHeartbeatTimeout", at::HEARTBEAT, u32::MAX, "RW");
    nodes.integer("GevTimestampTickFrequency", 0x0940, u32::MAX, "RO");
    nodes.integer("GevStreamChannelCount", 0x0904, 1, "RO");
    nodes.integer("GevCurrentIPAddress", 0x0024, u32::MAX, "RO");
    nodes.integer("GevSCPHostPort", at::STREAM_PORT, 65_535, "RW");
    nodes.integer("GevSCDA", at::STREAM_ADDRESS, u32::MAX, "RW");
    nodes.command("GevTimestampControlLatch", at::TIMESTAMP_CONTROL, 2);
    nodes.long("GevTimestampValue", at::TIMESTAMP_LATCHED);
    nodes.masked("GevSCPSPacketSize", at::PACKET_SIZE, [16, 31], 65_535);
    nodes.masked("GevSCPSFireTestPacket", at::PACKET_SIZE, [0, 0], 1);
    nodes.masked("GevSCPSDoNotFragment", at::PACKET_SIZE, [1, 1], 1);
    nodes.finish()
}

#[derive(Default)]
struct Nodes {
    features: String,
    text: String,
}

/// A register of the device's memory.
fn register(kind: &str, name: &str, address: u32, bytes: u32, access: &str, more: &str) -> String {
    format!(
        "<{kind} Name=\"{name}\"><Address>0x{address:x}</Address><Length>{bytes}</Length>\
         <AccessMode>{access}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>\
         {more}</{kind}>\n"
    )
}

const UNSIGNED: &str = "<Sign>Unsigned</Sign><Endianess>BigEndian</Endianess>";

impl Nodes {
    fn add(&mut self, name: &str, register: &str, feature: &str) {
        // Writing to a text cannot fail.
        let _ = writeln!(self.features, "<pFeature>{name}</pFeature>");
        self.text.push_str(register);
        self.text.push_str(feature);
        self.text.push('\n');
    }

    fn integer_register(name: &str, address: u32, access: &str) -> String {
        register(
            "IntReg",
            &format!("{name}Reg"),
            address,
            4,
            access,
            UNSIGNED,
        )
    }

    fn integer(&mut self, name: &str, address: u32, most: u32, access: &str) {
        let register = Self::integer_register(name, address, access);
        let feature = format!(
            "<Integer Name=\"{name}\"><pValue>{name}Reg</pValue><Min>0</Min><Max>{most}</Max>\
             <Inc>1</Inc></Integer>"
        );
        self.add(name, &register, &feature);
    }

    /// Eight bytes, read only.
    fn long(&mut self, name: &str, address: u32) {
        let register = register("IntReg", &format!("{name}Reg"), address, 8, "RO", UNSIGNED);
        let feature = format!("<Integer Name=\"{name}\"><pValue>{name}Reg</pValue></Integer>");
        self.add(name, &register, &feature);
    }

    fn masked(&mut self, name: &str, address: u32, [high, low]: [u32; 2], most: u32) {
        let bits = format!("<LSB>{low}</LSB><MSB>{high}</MSB>{UNSIGNED}");
        let text = register(
            "MaskedIntReg",
            &format!("{name}Reg"),
            address,
            4,
            "RW",
            &bits,
        );
        let feature = match most {
            1 => format!("<Boolean Name=\"{name}\"><pValue>{name}Reg</pValue></Boolean>"),
            _ => format!(
                "<Integer Name=\"{name}\"><pValue>{name}Reg</pValue><Min>0</Min>\
                 <Max>{most}</Max></Integer>"
            ),
        };
        self.add(name, &text, &feature);
    }

    fn float(&mut self, name: &str, address: u32, range: [f64; 3], unit: &str, access: &str) {
        let [low, high, step] = range;
        let order = "<Endianess>BigEndian</Endianess>";
        let text = register("FloatReg", &format!("{name}Reg"), address, 8, access, order);
        let feature = format!(
            "<Float Name=\"{name}\"><pValue>{name}Reg</pValue><Min>{low}</Min><Max>{high}</Max>\
             <Inc>{step}</Inc><Unit>{unit}</Unit></Float>"
        );
        self.add(name, &text, &feature);
    }

    fn boolean(&mut self, name: &str, address: u32) {
        let register = Self::integer_register(name, address, "RW");
        let feature = format!(
            "<Boolean Name=\"{name}\"><pValue>{name}Reg</pValue><OnValue>1</OnValue>\
             <OffValue>0</OffValue></Boolean>"
        );
        self.add(name, &register, &feature);
    }

    fn enumeration(&mut self, name: &str, address: u32, entries: &[(&str, u32)]) {
        let register = Self::integer_register(name, address, "RW");
        let mut feature = format!("<Enumeration Name=\"{name}\">");
        for (entry, value) in entries {
            let _ = write!(
                feature,
                "<EnumEntry Name=\"{entry}\"><Value>{value}</Value></EnumEntry>"
            );
        }
        let _ = write!(feature, "<pValue>{name}Reg</pValue></Enumeration>");
        self.add(name, &register, &feature);
    }

    fn command(&mut self, name: &str, address: u32, value: u32) {
        let register = Self::integer_register(name, address, "WO");
        let feature = format!(
            "<Command Name=\"{name}\"><pValue>{name}Reg</pValue>\
             <CommandValue>{value}</CommandValue></Command>"
        );
        self.add(name, &register, &feature);
    }

    fn text(&mut self, name: &str, address: u32, bytes: u32) {
        let text = register("StringReg", name, address, bytes, "RO", "");
        self.add(name, "", &text);
    }

    fn finish(self) -> String {
        let Self { features, text } = self;
        format!(
            "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n\
             <RegisterDescription ModelName=\"Simulated\" VendorName=\"mock-devices\" \
             ToolTip=\"\" StandardNameSpace=\"GEV\" SchemaMajorVersion=\"1\" \
             SchemaMinorVersion=\"1\" SchemaSubMinorVersion=\"0\" MajorVersion=\"1\" \
             MinorVersion=\"0\" SubMinorVersion=\"0\" ProductGuid=\"1\" VersionGuid=\"1\" \
             xmlns=\"http://www.genicam.org/GenApi/Version_1_1\">\n\
             <Category Name=\"Root\"><pFeature>Features</pFeature></Category>\n\
             <Category Name=\"Features\">\n{features}</Category>\n\
             {text}<Port Name=\"Device\"/>\n</RegisterDescription>\n"
        )
    }
}
