//! The value of `camera.device`: which camera, and features that are set when it is opened.

/// What the value may be, as errors state it.
pub const ALLOWED: &str = "the camera as `rig devices` lists it, its serial number or its IP address, and features with their values where wanted, such as \"Basler-acA1920-12345678; BlackLevel = 64\", without those that the driver sets itself";

/// Features that the driver sets itself.
const OWN: [&str; 11] = [
    "ExposureTime",
    "ExposureMode",
    "ExposureAuto",
    "Gain",
    "GainAuto",
    "PixelFormat",
    "AcquisitionMode",
    "TriggerSelector",
    "TriggerMode",
    "TriggerSource",
    "GammaEnable",
];

/// A camera and its features.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Name, serial number or address.
    pub name: String,
    /// Names and values in the order in which they are set.
    pub features: Vec<(String, String)>,
}

impl Choice {
    /// Reads the value; `None` where it is not as [`ALLOWED`] states.
    pub fn parse(text: &str) -> Option<Self> {
        let mut parts = text.split(';').map(str::trim);
        let name = parts.next()?;
        if name.is_empty() || name.contains('=') {
            return None;
        }
        let mut features = Vec::new();
        for part in parts.filter(|part| !part.is_empty()) {
            let (feature, value) = part.split_once('=')?;
            let (feature, value) = (feature.trim(), value.trim());
            let is_name = !feature.is_empty() && feature.chars().all(char::is_alphanumeric);
            if !is_name || value.is_empty() || OWN.contains(&feature) {
                return None;
            }
            features.push((feature.to_owned(), value.to_owned()));
        }
        Some(Self {
            name: name.to_owned(),
            features,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_and_its_features_are_read() {
        let read = Choice::parse("Basler-12345678; BlackLevel = 64;ReverseX=true;").unwrap();
        assert_eq!(read.name, "Basler-12345678");
        let features = [("BlackLevel", "64"), ("ReverseX", "true")];
        let features = features.map(|(name, value)| (name.to_owned(), value.to_owned()));
        assert_eq!(read.features, features);
        assert_eq!(Choice::parse("192.168.5.2").unwrap().features, []);
        for other in ["", ";", "BlackLevel = 64", "a; b", "a; b =", "a; Gain = 2"] {
            assert_eq!(Choice::parse(other), None, "{other}");
        }
    }
}
