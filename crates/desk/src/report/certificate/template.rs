//! From a result to the values of the certificate's template.

use minijinja::value::Value;
use minijinja::{Environment, UndefinedBehavior, context};

use super::CertificateError;
use super::budget::Budget;
use crate::checksum::sha256_hex;
use crate::outside_file::read_regular;
use crate::report::figures;
use crate::report::value::{value, values};
use crate::session::fit_record::coverage;
use crate::session::journal::LARGEST_JOURNAL_BYTES;
use crate::session::layout::{FITS_FOLDER, JOURNAL_FILE, SESSION_FILE};
use crate::session::{Event, FrameEntry, SessionError};
use crate::workflow::StatedResult;

/// What stands where nothing is known.
const NOT_STATED: &str = "not stated";

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
        results => results(result, budget),
        map => value(maps.map(|[of_f, _]| of_f)),
        validity => validity(result),
        budget => budget_view(budget),
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
    let or = |text: &Option<String>| text.clone().unwrap_or_else(|| NOT_STATED.to_owned());
    context! {
        organisation => or(&lab.organisation),
        laboratory => or(&lab.laboratory),
        operator => or(&lab.operator),
        contact => or(&lab.contact),
        email => value(&lab.email),
        address => match lines.is_empty() {
            true => NOT_STATED.to_owned(),
            false => lines.join(", "),
        },
    }
}

/// Names and texts of what was measured and how, in order.
fn facts(result: &StatedResult) -> Vec<(String, String)> {
    let (record, session) = (&result.record, result.session.record());
    let (camera, stage) = (&session.versions.camera, &session.versions.stage);
    let settings = &record.settings;
    let frames: Vec<FrameEntry> = result.session.frames().collect();
    let bench = match &record.bench {
        None => {
            "taken as described; its uncertainty is in the budget only as far as residuals show it"
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
                "{} light directions from {:?} stage; camera {}",
                session.plan.lights.len(),
                stage.driver,
                result.camera_geometry()
            ),
        ),
        fact(
            "Instrument",
            format!(
                "rig {:?}; camera {}, serial {}, {} bits; stage firmware {}",
                result.config.name,
                camera.model,
                or_none(&camera.serial),
                camera.bit_depth,
                or_none(&stage.firmware)
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
        fact("Environment", "temperature and humidity of the room were not recorded".to_owned()),
    ]
}

fn or_none(text: &str) -> &str {
    if text.is_empty() { "none" } else { text }
}

/// The table's cells nearest to the budget's angles, as table.csv has them.
fn results(result: &StatedResult, budget: &Budget) -> Vec<Value> {
    let table = &result.record.table;
    let nearest = |angles: &[f64], angle: f64| {
        crate::session::fit_record::lookup::nearest_index(angles, angle)
    };
    let rows = budget.columns.iter().filter_map(|column| {
        let i = nearest(&table.theta_h_deg, column.theta_h_deg)?;
        let j = nearest(&table.theta_d_deg, column.theta_d_deg)?;
        let cell = table.cell(i, j)?;
        let channel = |c: usize| {
            context! {
                value => significant(cell.value[c]),
                exact => format!("{:?}", cell.value[c]),
                lower => significant(cell.lower[c]),
                upper => significant(cell.upper[c]),
            }
        };
        Some(context! {
            theta_h => format!("{:.1}°", table.theta_h_deg[i]),
            theta_d => format!("{:.1}°", table.theta_d_deg[j]),
            channels => values(0..3, channel),
            constrained => cell.constrained,
        })
    });
    rows.collect()
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
    let percent = |relative: f64| digits(100.0 * relative, 3);
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
            angles => format!("{:.0}°, {:.0}°", column.theta_h_deg, column.theta_d_deg),
            value => significant(column.value),
            exact_value => format!("{:?}", column.value),
            combined => percent(column.combined),
            exact_combined => format!("{:?}", column.combined),
            expanded => column.expanded.map_or("–".to_owned(), percent),
            factor => column.coverage_factor().map_or("–".to_owned(), |k| format!("{k:.2}")),
            constrained => column.constrained,
        }),
        sources => values(&budget.sources, |source| context! {
            name => &source.name,
            evaluation => source.evaluation.letter(),
            contributions => values(source.contribution.iter().enumerate(), |(n, part)| context! {
                shown => percent(*part),
                exact => format!("{part:?}"),
                largest => *part > 0.0 && *part >= largest[n],
            }),
        }),
    }
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

/// Four significant digits.
fn significant(value: f64) -> String {
    digits(value, 4)
}

/// So many significant digits.
fn digits(value: f64, count: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let magnitude = value.abs().log10().floor() as i32;
    if (-3..count).contains(&magnitude) {
        let decimals = (count - 1 - magnitude).max(0) as usize;
        format!("{value:.decimals$}")
    } else {
        let decimals = count.max(1) as usize - 1;
        format!("{value:.decimals$e}").replace('-', "−")
    }
}
