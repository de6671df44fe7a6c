//! The figures of a calibrated sensor as a page, in the terms of EMVA Standard 1288.

use minijinja::value::Value;
use minijinja::{Environment, UndefinedBehavior, context};

use super::ReportError;
use super::value::value;
use crate::calibration::figures;
use crate::calibration::record::{Measured, Settings};
use crate::calibration::sensor::SensorFit;
use crate::calibration::sensor::emva1288::Emva1288;

/// What the page states of the measurement.
#[derive(Clone, Debug)]
#[allow(missing_docs)]
pub struct SensorPage<'a> {
    /// Model and serial number.
    pub camera: String,
    /// Whether the sensor is simulated.
    pub simulated: bool,
    pub record: String,
    /// How it was measured.
    pub method: String,
    /// When, RFC 3339.
    pub date: String,
    /// Gain, bits, size and temperature.
    pub settings: Settings,
    /// The solution, with its curve.
    pub fit: &'a SensorFit,
    pub figures: &'a Emva1288,
}

impl SensorPage<'_> {
    /// The page: one HTML file without anything from elsewhere.
    ///
    /// # Errors
    /// A figure that could not be drawn, or a defect of the template.
    pub fn render(&self) -> Result<String, ReportError> {
        let plot = figures::photon_transfer(self.fit);
        let plot = plot.inline("Photon transfer curve and linearity")?;
        let page = context! {
            camera => &self.camera,
            simulated => self.simulated,
            record => &self.record,
            method => &self.method,
            date => &self.date,
            settings => value(self.settings),
            f => value(self.figures),
            snr_max_db => self.figures.snr_max_db(),
            dynamic_range_db => self.figures.dynamic_range_db(),
            plot => Value::from(plot),
            version => env!("CARGO_PKG_VERSION"),
        };
        let mut environment = Environment::new();
        environment.set_undefined_behavior(UndefinedBehavior::Strict);
        environment.add_filter("with_std", |value: f64, std: f64, unit: &str| {
            with_std(Measured { value, std }, unit)
        });
        environment.add_template("emva1288.html", include_str!("emva1288.html.j2"))?;
        Ok(environment.get_template("emva1288.html")?.render(page)?)
    }
}

/// Value and uncertainty to two digits of the latter, with the unit.
fn with_std(measured: Measured, unit: &str) -> String {
    let text = format!("{measured} {unit}");
    text.trim_end().replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_two_digits_of_their_uncertainty() {
        let of = |value, std| with_std(Measured { value, std }, "e⁻");
        assert_eq!(of(2.4123, 0.0234), "2.412 ± 0.023 e⁻");
        assert_eq!(of(10_512.3, 31.2), "10512 ± 31 e⁻");
        assert_eq!(of(0.5, 0.0), "0.500 ± 0.000 e⁻");
        assert_eq!(
            with_std(
                Measured {
                    value: 102.4,
                    std: 0.16
                },
                ""
            ),
            "102.40 ± 0.16"
        );
    }
}
