//! The figures of a calibrated sensor as a page, in the terms of EMVA Standard 1288.

use minijinja::value::Value;
use minijinja::{Environment, UndefinedBehavior, context};

use super::ReportError;
use super::value::{value, values};
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

/// A row of a table.
struct Row {
    symbol: &'static str,
    name: &'static str,
    value: String,
    section: &'static str,
    note: String,
}

impl SensorPage<'_> {
    /// The page: one HTML file without anything from elsewhere.
    ///
    /// # Errors
    /// A figure that could not be drawn, or a defect of the template.
    pub fn render(&self) -> Result<String, ReportError> {
        let plot = figures::photon_transfer(self.fit);
        let plot = plot.inline("Photon transfer curve and linearity")?;
        let row = |row: Row| {
            let (symbol, subscript) = parts(row.symbol);
            context! {
                symbol,
                subscript,
                name => row.name,
                value => row.value,
                section => row.section,
                note => row.note,
            }
        };
        let page = context! {
            camera => &self.camera,
            simulated => self.simulated,
            measured => values(self.measured(), row),
            absent => values(self.absent(), |(symbol, name, note)| {
                let (symbol, subscript) = parts(symbol);
                context! { symbol, subscript, name, note }
            }),
            plot => Value::from(plot),
            conditions => value(self.conditions()),
            version => env!("CARGO_PKG_VERSION"),
        };
        let mut environment = Environment::new();
        environment.set_undefined_behavior(UndefinedBehavior::Strict);
        environment.add_template("emva1288.html", include_str!("emva1288.html.j2"))?;
        Ok(environment.get_template("emva1288.html")?.render(page)?)
    }

    fn measured(&self) -> Vec<Row> {
        let f = self.figures;
        let row = |symbol, name, value, section, note: &str| Row {
            symbol,
            name,
            value,
            section,
            note: note.to_owned(),
        };
        let at = format!("at {:.3} ms", 1e3 * f.nonuniformity_exposure_s);
        let linearity = f.linearity_error;
        let limit = match f.dark_noise_is_limit {
            true => "upper limit: rounding to whole counts hides the noise",
            false => "without that of rounding",
        };
        // Gain, noise, range, nonuniformity of darkness.
        let mut rows = vec![
            row(
                "K",
                "system gain",
                with_std(f.system_gain_dn_per_e, "DN/e⁻"),
                "2.1, 6.6",
                "slope of the photon transfer curve up to 70% of saturation",
            ),
            row(
                "1/K",
                "inverse of the system gain",
                with_std(inverse(f.system_gain_dn_per_e), "e⁻/DN"),
                "2.1",
                "",
            ),
            row(
                "σ_y.dark",
                "temporal dark noise in counts",
                format!("{:.3} DN", f.dark_noise_dn),
                "2.2",
                "with that of rounding",
            ),
            row(
                "σ_d",
                "temporal dark noise",
                with_std(f.dark_noise_e, "e⁻"),
                "2.2, 6.6",
                limit,
            ),
            row(
                "μ_e.sat",
                "saturation capacity",
                with_std(f.saturation_capacity_e, "e⁻"),
                "2.4",
                "from the mean count that more light does not raise; the standard takes the greatest variance of 50 exposures, a few noise widths lower",
            ),
            row(
                "μ_e.min",
                "absolute sensitivity threshold",
                with_std(f.sensitivity_threshold_e, "e⁻"),
                "2.4",
                "the signal whose SNR is 1",
            ),
            row(
                "SNR_max",
                "greatest signal-to-noise ratio",
                format!("{} ({:.1} dB)", with_std(f.snr_max, ""), f.snr_max_db()),
                "2.4",
                "",
            ),
            row(
                "DR",
                "dynamic range",
                format!(
                    "{} ({:.1} dB)",
                    with_std(f.dynamic_range, ""),
                    f.dynamic_range_db()
                ),
                "2.4",
                "",
            ),
            row(
                "DSNU_1288",
                "dark signal nonuniformity",
                with_std(f.dsnu_e, "e⁻"),
                "4, 8",
                &at,
            ),
            row(
                "",
                "dark signal nonuniformity at no exposure",
                with_std(f.dsnu_offset_e, "e⁻"),
                "4",
                "from each pixel's line over dark exposures",
            ),
        ];
        // Nonuniformity of the response, where it can be stated.
        if let Some(prnu) = f.prnu {
            rows.push(row(
                "PRNU_1288",
                "photo response nonuniformity",
                with_std(percent(prnu), "%"),
                "4, 8",
                &format!("{at}; includes the unevenness of the light"),
            ));
        }
        // Linearity and dark current.
        let deviations = format!(
            "mean of absolute deviations at {} exposures from 5% to 95% of saturation, which lie \
             between {:+.3}% and {:+.3}%; before the correction that the record holds",
            linearity.levels,
            100.0 * linearity.lowest,
            100.0 * linearity.highest
        );
        rows.push(row(
            "LE",
            "linearity error",
            format!("{:.3} %", 100.0 * linearity.mean),
            "6.7",
            &deviations.replace('-', "−"),
        ));
        let temperature = self
            .settings
            .sensor_c
            .map(|c| format!("at a sensor temperature of {c:.1} °C"));
        rows.push(row(
            "μ_I.mean",
            "dark current, from the mean",
            with_std(f.dark_current_e_s, "e⁻/s"),
            "3",
            &temperature.unwrap_or("the camera reports no temperature".to_owned()),
        ));
        rows
    }

    /// Symbol, name, and why there is no value.
    fn absent(&self) -> Vec<(&'static str, &'static str, &'static str)> {
        let mut rows = vec![
            (
                "η",
                "quantum efficiency",
                "needs the irradiance at the sensor in photons per pixel, from a calibrated radiometer (6.4)",
            ),
            ("R", "responsivity", "likewise"),
            (
                "μ_p",
                "threshold and saturation in photons",
                "likewise; both are stated in electrons",
            ),
            (
                "",
                "column, row and pixel parts of DSNU and PRNU",
                "not separated: DSNU and PRNU are those of all pixels together",
            ),
            (
                "μ_I.var",
                "dark current, from the variance",
                "the mean determines it better",
            ),
            (
                "",
                "doubling temperature of the dark current",
                "needs a sensor that can be heated and cooled (3.2)",
            ),
        ];
        if let Some(why) = self.figures.prnu_absent {
            rows.push(("PRNU_1288", "photo response nonuniformity", why));
        }
        rows
    }

    fn conditions(&self) -> Vec<(&'static str, String)> {
        let settings = &self.settings;
        let mut conditions = vec![
            ("record", self.record.clone()),
            ("date", self.date.clone()),
            ("method", self.method.clone()),
        ];
        if let Some([width, height]) = settings.resolution_px {
            conditions.push(("image size", format!("{width} × {height} pixels")));
        }
        if let Some(bits) = settings.bit_depth {
            conditions.push(("bits of a count", bits.to_string()));
        }
        if let Some(gain) = settings.gain {
            conditions.push(("gain setting", gain.to_string()));
        }
        let hot = format!("{}, left out of every figure", self.figures.hot_pixels);
        conditions.push(("hot pixels", hot));
        conditions
    }
}

/// A symbol and what stands below it, after the first `_`.
fn parts(symbol: &str) -> (&str, &str) {
    symbol.split_once('_').unwrap_or((symbol, ""))
}

fn percent(m: Measured) -> Measured {
    Measured::new(100.0 * m.value, 100.0 * m.std)
}

fn inverse(m: Measured) -> Measured {
    Measured::new(1.0 / m.value, m.std / m.value.powi(2))
}

/// Value and uncertainty to two digits of the latter, with the unit.
fn with_std(m: Measured, unit: &str) -> String {
    let decimals = match m.std > 0.0 && m.std.is_finite() {
        true => (1.0 - m.std.log10().floor()).clamp(0.0, 9.0) as usize,
        false => 3,
    };
    let text = format!("{:.decimals$} ± {:.decimals$} {unit}", m.value, m.std);
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
