//! The `[lab]` table: who measures, and what of the instrument no device tells. Results that
//! others read state it: the universal BRDF JSON, the certificate.

use std::ops::RangeInclusive;

use super::ConfigError;
use super::reader::Section;

/// Who measures. Everything is optional; what is not stated is named as such in results.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LabConfig {
    /// Company, institute or university.
    pub organisation: Option<String>,
    /// The laboratory in it: a name, an accreditation number.
    pub laboratory: Option<String>,
    /// Who works at the bench.
    pub operator: Option<String>,
    /// Whom to ask.
    pub contact: Option<String>,
    /// Address for questions.
    pub email: Option<String>,
    /// Its pages.
    pub website: Option<String>,
    /// Where it is.
    pub address: Address,
    /// Temperature of the room during a measurement, °C.
    pub room_temperature_c: Option<f64>,
    /// Its relative humidity, %.
    pub room_humidity_percent: Option<f64>,
    /// What no device tells.
    pub instrument: InstrumentFacts,
}

impl LabConfig {
    /// Keys of what a certificate names and is not stated.
    pub fn not_stated(&self) -> Vec<&'static str> {
        let keys = [
            ("organisation", self.organisation.is_none()),
            ("laboratory", self.laboratory.is_none()),
            ("operator", self.operator.is_none()),
            ("contact", self.contact.is_none()),
            ("city", self.address.city.is_none()),
            ("room_temperature_c", self.room_temperature_c.is_none()),
            (
                "room_humidity_percent",
                self.room_humidity_percent.is_none(),
            ),
        ];
        let lacking = keys.into_iter().filter(|(_, lacks)| *lacks);
        lacking.map(|(key, _)| key).collect()
    }
}

/// Where the laboratory is.
#[derive(Clone, Debug, Default, PartialEq)]
#[allow(missing_docs)]
pub struct Address {
    /// Name of the street.
    pub street: Option<String>,
    /// Number in the street.
    pub building: Option<String>,
    pub postal_code: Option<String>,
    /// Town.
    pub city: Option<String>,
    pub country: Option<String>,
}

/// Bands and power of the instrument, by data sheets.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InstrumentFacts {
    /// Band of what R, G and B measure (lamp and camera together), from and to, nm.
    pub band_nm: [Option<[f64; 2]>; 3],
    /// Band in which the camera sees, nm.
    pub camera_band_nm: Option<[f64; 2]>,
    /// Electrical power of the lamp, W.
    pub lamp_power_w: Option<f64>,
}

/// Temperatures that a room may have, °C.
pub(super) const ROOM_TEMPERATURE_C: RangeInclusive<f64> = -40.0..=60.0;
/// Relative humidities, %.
pub(super) const ROOM_HUMIDITY_PERCENT: RangeInclusive<f64> = 0.0..=100.0;

pub(super) const LINE: &str = "a text of 1 to 200 characters on one line";

pub(super) fn line(text: &str) -> Option<String> {
    let text = text.trim();
    let is_line = (1..=200).contains(&text.chars().count()) && !text.contains(char::is_control);
    is_line.then(|| text.to_owned())
}

fn email(text: &str) -> Option<String> {
    let text = line(text)?;
    let (user, host) = text.split_once('@')?;
    let whole = !user.is_empty() && !host.is_empty() && !host.contains('@');
    (whole && !text.contains(char::is_whitespace)).then_some(text)
}

fn website(text: &str) -> Option<String> {
    let text = line(text)?;
    let rest = text
        .strip_prefix("https://")
        .or(text.strip_prefix("http://"))?;
    (!rest.is_empty() && !text.contains(char::is_whitespace)).then_some(text)
}

impl LabConfig {
    /// Reads the table.
    ///
    /// # Errors
    /// A key or value that may not stand there.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        let mut text = |key| Ok::<_, ConfigError>(table.parsed(key, LINE, line)?.optional());
        let organisation = text("organisation")?;
        let laboratory = text("laboratory")?;
        let operator = text("operator")?;
        let contact = text("contact")?;
        let address = Address {
            street: text("street")?,
            building: text("building")?,
            postal_code: text("postal_code")?,
            city: text("city")?,
            country: text("country")?,
        };
        let email = table.parsed("email", "an address such as name@example.org", email)?;
        let website = table.parsed("website", "an address that begins with https://", website)?;
        let lab = Self {
            organisation,
            laboratory,
            operator,
            contact,
            email: email.optional(),
            website: website.optional(),
            address,
            room_temperature_c: table
                .number("room_temperature_c", ROOM_TEMPERATURE_C)?
                .optional(),
            room_humidity_percent: table
                .number("room_humidity_percent", ROOM_HUMIDITY_PERCENT)?
                .optional(),
            instrument: InstrumentFacts {
                band_nm: [
                    band(&mut table, "band_r_nm")?,
                    band(&mut table, "band_g_nm")?,
                    band(&mut table, "band_b_nm")?,
                ],
                camera_band_nm: band(&mut table, "camera_band_nm")?,
                lamp_power_w: table.number("lamp_power_w", 1e-3..=1e5)?.optional(),
            },
        };
        table.finish()?;
        Ok(lab)
    }

    /// The keys that the universal BRDF format demands and that are not stated.
    pub fn missing(&self) -> Vec<&'static str> {
        let address = &self.address;
        [
            ("organisation", &self.organisation),
            ("contact", &self.contact),
            ("email", &self.email),
            ("street", &address.street),
            ("building", &address.building),
            ("postal_code", &address.postal_code),
            ("city", &address.city),
            ("country", &address.country),
        ]
        .into_iter()
        .filter(|(_, value)| value.is_none())
        .map(|(key, _)| key)
        .collect()
    }
}

/// A band in nanometres, from and to.
fn band(table: &mut Section, key: &'static str) -> Result<Option<[f64; 2]>, ConfigError> {
    let found = table.numbers::<2>(key, 100.0..=20_000.0)?.optional();
    match found {
        Some([from, to]) if from >= to => {
            let value = format!("[{from}, {to}]");
            Err(table.conflict(key, value, "two wavelengths, the shorter one first"))
        }
        found => Ok(found),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::{BUILT_IN, RigConfig};

    fn with(table: &str) -> Result<RigConfig, ConfigError> {
        let text = BUILT_IN[0]
            .1
            .replace("\n[lab]\n", &format!("\n[lab]\n{table}\n"));
        RigConfig::parse("rig.toml", Path::new(""), &text)
    }

    #[test]
    fn a_lab_is_read_and_what_it_lacks_is_known() {
        assert_eq!(with("").unwrap().lab, LabConfig::default());
        assert_eq!(with("").unwrap().lab.missing().len(), 8);
        let lab = with(
            "organisation = \" Institute of Optics \"\nemail = \"a@b.org\"\nband_r_nm = [590, 650]",
        );
        let lab = lab.unwrap().lab;
        assert_eq!(lab.organisation.as_deref(), Some("Institute of Optics"));
        assert_eq!(lab.instrument.band_nm, [Some([590.0, 650.0]), None, None]);
        assert_eq!(lab.missing().len(), 6);
    }

    #[test]
    fn bad_labs_are_refused_with_the_place() {
        const CASES: &str = r#"
organisation = "" | `lab.organisation` is "", but must be a text of 1 to 200
operator = "a\nb" | `lab.operator`
email = "nobody" | `lab.email` is "nobody", but must be an address
website = "ftp://x" | `lab.website`
band_g_nm = [550, 510] | `lab.band_g_nm` is [550, 510], but must be two wavelengths
lamp_power_w = 0 | `lab.lamp_power_w` is 0, but must be a number from 0.001
room_humidity_percent = 101 | `lab.room_humidity_percent` is 101, but must be a number from 0 to 100
organization = "x" | organization
"#;
        for case in CASES.trim().lines() {
            let (table, said) = case.split_once(" | ").unwrap();
            let error = with(table).unwrap_err().to_string();
            assert!(error.contains(said), "{table}: {error}");
        }
    }
}
