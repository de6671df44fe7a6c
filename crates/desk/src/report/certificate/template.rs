//! From a result to the values of the certificate's template.

use minijinja::value::Value;
use minijinja::{Environment, UndefinedBehavior, context};

use super::CertificateError;
use super::budget::{Budget, Column};
use crate::checksum::sha256_hex;
use crate::config::lab::LabConfig;
use crate::outside_file::read_regular;
use crate::report::figures;
use crate::report::value::{value, values};
use crate::session::fit_record::coverage;
use crate::session::journal::LARGEST_JOURNAL_BYTES;
use crate::session::layout::{FITS_FOLDER, JOURNAL_FILE, SESSION_FILE};
use crate::session::{Event, FrameEntry, SessionError};
use crate::workflow::StatedResult;

pub(super) fn render(result: &StatedResult, budget: &Budget) -> Result<String, CertificateError> {
    let record = &result.record;
    let session = result.session.record();
    let maps = figures::table_maps(&record.table)?;
    let page = context! {
        simulated => record.simulated,
        number => format!("{} / fit {}", result.session_name(), result.number),
        lab => lab(result),
        sample => &session.sample,
        facts => facts(result),
        traceable => result.traceability.is_traceable(),
        traceability => result.traceability.sentence(),
        calibrations => values(&session.calibration, |copy| context! {
            id => &copy.id,
            sha256 => &copy.sha256,
        }),
        verdict => record.verdict().sentence(),
        warnings => value(&record.warnings),
        results => results(budget),
        map => value(maps.map(|[of_f, _]| of_f)),
        validity => validity(result),
        budget => budget_view(budget),
        bench_exact => record.bench.is_none(),
        coverage => coverage::statement(record),
        coverage_met => coverage::MeasuredCoverage::of(record).is_some_and(|c| c.is_reached()),
        checksums => value(checksums(result)?),
        fit_version => record.versions.get("rig").cloned().unwrap_or_default(),
        version => env!("CARGO_PKG_VERSION"),
        kernel => &record.settings.kernel,
        seed => record.settings.seed.to_string(),
    };
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.add_template("certificate.html", include_str!("certificate.html.j2"))?;
    let text = environment.get_template("certificate.html")?.render(page)?;
    Ok(text)
}

fn lab(result: &StatedResult) -> Value {
    let lab = &result.config.lab;
    let address = &lab.address;
    let joined = |parts: &[&Option<String>]| {
        let parts: Vec<&str> = parts.iter().filter_map(|part| part.as_deref()).collect();
        parts.join(" ")
    };
    let lines = [
        joined(&[&address.street, &address.building]),
        joined(&[&address.postal_code, &address.city]),
        joined(&[&address.country]),
    ];
    let lines: Vec<String> = lines.into_iter().filter(|line| !line.is_empty()).collect();
    let reached: Vec<&str> = [&lab.email, &lab.website]
        .into_iter()
        .flatten()
        .map(String::as_str)
        .collect();
    context! {
        organisation => value(&lab.organisation),
        laboratory => value(&lab.laboratory),
        operator => value(&lab.operator),
        contact => value(&lab.contact),
        reached => reached.join(", "),
        address => lines.join(", "),
        lacking => lab.not_stated().join(", "),
    }
}

/// Names and texts of what was measured and how, in order.
fn facts(result: &StatedResult) -> Vec<(String, String)> {
    let (record, session) = (&result.record, result.session.record());
    let (camera, stage) = (&session.versions.camera, &session.versions.stage);
    let settings = &record.settings;
    let facts = &result.config.lab.instrument;
    let frames: Vec<FrameEntry> = result.session.frames().collect();
    let bench = match &record.bench {
        None => {
            "taken as exact, as the rig file and the calibration records describe it: an error of it is in the budget only as far as residuals show it"
                .to_owned()
        }
        Some(bench) => format!(
            "{} parameters refined with the material",
            bench.parameter.len()
        ),
    };
    let discrepancy = match &record.discrepancy {
        None => String::new(),
        Some(found) => format!(
            ", with a model discrepancy of {:.1} times the usual one of measured materials",
            found.amplitude
        ),
    };
    let fact = |name: &str, text: String| (name.to_owned(), text);
    let clock = result.session.journal().clock_step();
    let clock = clock.map_or(String::new(), |step| format!("; {step}"));
    let ended = result.session.journal().records.iter().rev();
    let mut ended = ended.filter(|record| matches!(record.event, Event::Stop));
    vec![
        fact("Sample", format!("{}; {}", session.sample, result.sample_shape())),
        fact(
            "Measurand",
            "BRDF f(θh, θd) in 1/sr, cosine excluded, in three bands, at an azimuth of the difference vector of φd = 90°; the sample is taken as uniform, isotropic and opaque".to_owned(),
        ),
        fact("Bands", [0, 1, 2].map(|c| result.band(c)).join("; ")),
        fact(
            "Geometry",
            format!(
                "light directions: {}; stage {:?}; camera {}",
                session.plan.lights.len(),
                stage.driver,
                result.camera_geometry()
            ),
        ),
        fact(
            "Instrument",
            format!(
                "rig {:?}; camera {}, serial {}, {} bits{}; stage firmware {}{}",
                result.config.name,
                camera.model,
                or_none(&camera.serial),
                camera.bit_depth,
                facts.camera_band_nm.map_or(String::new(), |[from, to]| format!(", {from} nm to {to} nm")),
                or_none(&stage.firmware),
                facts.lamp_power_w.map_or(String::new(), |power| format!("; lamp {power} W")),
            ),
        ),
        fact(
            "Measured",
            match ended.next() {
                Some(end) => format!("{} to {}, {} frames{clock}", session.created_utc, end.utc, frames.len()),
                None => format!("{}, {} frames{clock}", session.created_utc, frames.len()),
            },
        ),
        fact(
            "Method",
            format!(
                "inverse rendering of interreflections up to {} reflections; mixture of the dictionary {}{discrepancy}",
                settings.max_reflections, record.dictionary
            ),
        ),
        fact("Bench", bench),
        fact("Room", room(&result.config.lab)),
    ]
}

/// The room, as the laboratory states it.
fn room(lab: &LabConfig) -> String {
    let stated = [
        (
            lab.room_temperature_c.map(|c| format!("{c} °C")),
            "temperature",
        ),
        (
            lab.room_humidity_percent.map(|p| format!("{p}%")),
            "relative humidity",
        ),
    ];
    let stated = stated.map(|(value, of)| match value {
        Some(value) => format!("{of} {value}"),
        None => format!("{of} not stated"),
    });
    stated.join(", ")
}

fn or_none(text: &str) -> &str {
    if text.is_empty() { "none" } else { text }
}

/// f by channel at the budget's angles, each figure to the last place of its uncertainty.
fn results(budget: &Budget) -> Vec<Value> {
    let rows = budget.columns.iter().filter_map(|column| {
        let found = column.channels?;
        let channel = |c: usize| {
            let place = last_place(0.25 * (found.upper[c] - found.lower[c]));
            context! {
                value => to_place(found.value[c], place),
                exact => format!("{:?}", found.value[c]),
                lower => to_place(found.lower[c], place),
                upper => to_place(found.upper[c], place),
            }
        };
        Some(context! {
            theta_h => degrees(column.theta_h_deg),
            theta_d => degrees(column.theta_d_deg),
            channels => values(0..3, channel),
            mean => mean_of(column),
            constrained => column.is_constrained(),
        })
    });
    rows.collect()
}

/// f of the mean of the channels, to the last place of its standard uncertainty.
fn mean_of(column: &Column) -> String {
    to_place(column.value, last_place(column.combined * column.value))
}

fn degrees(angle: f64) -> String {
    format!("{angle:.0}°")
}

/// What part of the angles was measured.
fn validity(result: &StatedResult) -> Value {
    let table = &result.record.table;
    let columns = table.theta_d_deg.len().max(1);
    let constrained = table.cells.iter().enumerate();
    let constrained = constrained.filter(|(_, cell)| cell.constrained);
    let angles: Vec<[f64; 2]> = constrained
        .map(|(k, _)| {
            [
                table.theta_h_deg[k / columns],
                table.theta_d_deg[k % columns],
            ]
        })
        .collect();
    let range = |n: usize| {
        let of = angles.iter().map(|angles| angles[n]);
        let (low, high) = of.fold((f64::MAX, f64::MIN), |(low, high), angle| {
            (low.min(angle), high.max(angle))
        });
        match low <= high {
            true => format!("{low:.1}° to {high:.1}°"),
            false => "none".to_owned(),
        }
    };
    context! {
        share => format!("{:.1}%", 100.0 * table.constrained_share()),
        count => angles.len(),
        of => table.cells.len(),
        theta_h => range(0),
        theta_d => range(1),
    }
}

fn budget_view(budget: &Budget) -> Value {
    // Contributions that round to nothing are still not nothing.
    let percent = |relative: f64| match 100.0 * relative {
        part if part < 0.005 => "< 0.01".to_owned(),
        part => to_place(part, last_place(part)),
    };
    let largest: Vec<f64> = (0..budget.columns.len())
        .map(|n| {
            budget
                .sources
                .iter()
                .map(|s| s.contribution[n])
                .fold(0.0, f64::max)
        })
        .collect();
    context! {
        columns => values(&budget.columns, |column| context! {
            angles => format!("{}, {}", degrees(column.theta_h_deg), degrees(column.theta_d_deg)),
            value => mean_of(column),
            exact_value => format!("{:?}", column.value),
            combined => percent(column.combined),
            exact_combined => format!("{:?}", column.combined),
            expanded => column.expanded.map_or("–".to_owned(), percent),
            expanded_of => values(0..3, |c| column.expanded_of(c).map_or("–".to_owned(), percent).into()),
            factor => column.coverage_factor().map_or("–".to_owned(), |k| format!("{k:.1}")),
            constrained => column.is_constrained(),
        }),
        not_evaluated => not_evaluated(budget),
        sources => values(&budget.sources, |source| context! {
            name => &source.name,
            evaluation => source.evaluation.letter(),
            evaluated => source.is_evaluated(),
            contributions => values(source.contribution.iter().enumerate(), |(n, part)| context! {
                shown => percent(*part),
                exact => format!("{part:?}"),
                largest => *part > 0.0 && *part >= largest[n],
            }),
        }),
    }
}

/// Names of the sources that the fit did not allow for.
fn not_evaluated(budget: &Budget) -> String {
    let sources = budget.sources.iter();
    let names = sources.filter(|source| !source.is_evaluated());
    names
        .map(|source| source.name.as_str())
        .collect::<Vec<_>>()
        .join(", ")
}

/// Names and SHA-256 of what the result rests on.
fn checksums(result: &StatedResult) -> Result<Vec<(String, String)>, SessionError> {
    let folder = format!("{FITS_FOLDER}/{}", result.number);
    let wanted = [
        SESSION_FILE.to_owned(),
        format!("{folder}/fit.toml"),
        format!("{folder}/table.csv"),
        format!("{folder}/weights.csv"),
    ];
    let journal = result.session.journal();
    let files = journal.files();
    let mut found: Vec<(String, String)> = wanted
        .iter()
        .filter_map(|name| {
            let file = files.iter().find(|file| file.path == *name)?;
            Some((file.path.clone(), file.sha256.clone()))
        })
        .collect();
    let path = result.session.root().join(JOURNAL_FILE);
    let bytes = read_regular(&path, LARGEST_JOURNAL_BYTES);
    let bytes = bytes.map_err(|error| SessionError::io("read", &path, error))?;
    let name = format!("{JOURNAL_FILE} (has those of all {} files)", files.len());
    found.push((name, sha256_hex(&bytes)));
    Ok(found)
}

/// The power of ten of the second significant digit of a standard uncertainty, the last that
/// is stated (GUM 7.2.6); of none, that of a millionth.
fn last_place(uncertainty: f64) -> i32 {
    if !(uncertainty.is_finite() && uncertainty > 0.0) {
        return -6;
    }
    // Rounded first: 0.0996 is 0.10.
    let rounded = format!("{uncertainty:.1e}");
    let exponent = rounded
        .split_once('e')
        .and_then(|(_, e)| e.parse::<i32>().ok());
    exponent.unwrap_or(0) - 1
}

/// Rounded to a power of ten.
fn to_place(value: f64, place: i32) -> String {
    let magnitude = value.abs().log10().floor() as i32;
    if value == 0.0 || !value.is_finite() || (-4..6).contains(&magnitude) && place < 6 {
        let decimals = usize::try_from(-place).unwrap_or(0);
        let rounded = match place {
            1.. => (value / 10f64.powi(place)).round() * 10f64.powi(place),
            _ => value,
        };
        return format!("{rounded:.decimals$}").replace('-', "−");
    }
    let decimals = usize::try_from(magnitude - place).unwrap_or(0);
    format!("{value:.decimals$e}").replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_end_where_their_uncertainty_does() {
        for (value, uncertainty, shown) in [
            (0.1050, 0.0637, "0.105"),
            (0.03695, 0.00996, "0.037"),
            (1234.5, 152.0, "1230"),
            (12.345, 1.24, "12.3"),
            (0.002_345_6, 0.000_123, "0.00235"),
            (2.3456e-6, 1.23e-7, "2.35e−6"),
            (0.5, 0.0, "0.500000"),
        ] {
            assert_eq!(to_place(value, last_place(uncertainty)), shown);
        }
    }
}
