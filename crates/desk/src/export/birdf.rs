//! The universal BRDF data format of the European BRDF projects (BiRD, BxDiff): one JSON
//! document, schema version 1.0 of 2021 (github.com/BiRD-project/BiRD_view).
//!
//! Columns of equal length, one row for each channel and each cell of (θh, θd) that the
//! images constrain; what they do not constrain was not measured and is left out. The
//! table is f at φd = 90°, so the pairs of directions lie on that surface: both zenith angles
//! are equal, cos θi = cos θr = cos θh cos θd, and the azimuths differ by 2 atan2(sin θd,
//! sin θh cos θd).
//!
//! `uBRDF` is the expanded uncertainty: half the width of the 95% interval. The posterior is
//! not Gaussian, so it is not a multiple of a standard uncertainty; both ends of the interval
//! are in columns of their own.

use glam::DVec3;
use serde_json::{Map, Value, json};

use super::{ExportError, Format, SIMULATED_NOTE, Writer, replace};
use crate::brdf::HalfDifference;
use crate::session::fit_record::coverage;
use crate::session::layout::FITS_FOLDER;
use crate::workflow::StatedResult;

/// With expanded uncertainty, of the cells that the images constrain.
pub(super) const FORMAT: Format = Format {
    name: "birdf",
    about: "Universal BRDF JSON of the European BRDF projects (BiRD), with expanded uncertainty; of a fitted session",
    ending: "json",
    companion: None,
    writer: Writer::OfSession(|result, out| replace(out, to_json(result)?.as_bytes())),
};

/// The schema that the document follows.
pub const SCHEMA: &str = "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json";

/// What stands where the schema demands a text that the rig file does not state.
pub const NOT_STATED: &str = "not stated";
/// The same for an address; by RFC 2606, names that end so belong to nobody.
const NO_EMAIL: &str = "not-stated@example.invalid";

const DIRECTIONS_NOTE: &str = "The measurand is the bivariate BRDF, f over half and difference angle, at an azimuth of the difference vector of 90 degrees; the sample is taken as isotropic. Directions are generated on that surface: both zenith angles are equal, and the azimuth of the illumination is 0 by choice.";

/// The document's text.
///
/// # Errors
/// The images constrain no cell: nothing was measured.
pub fn to_json(result: &StatedResult) -> Result<String, ExportError> {
    let rows = rows(result);
    if rows.is_empty() {
        return Err(ExportError::NothingConstrained);
    }
    let document = json!({ "metadata": metadata(result), "data": data(result, &rows) });
    let mut text = document.to_string();
    text.push('\n');
    Ok(text)
}

/// One channel of one constrained cell.
struct Row {
    theta_deg: f64,
    phi_r_deg: f64,
    channel: usize,
    value: f64,
    lower: f64,
    upper: f64,
}

fn rows(result: &StatedResult) -> Vec<Row> {
    let table = &result.record.table;
    let angles = table.theta_h_deg.iter();
    let angles = angles.flat_map(|&h| table.theta_d_deg.iter().map(move |&d| [h, d]));
    let cells = angles
        .zip(&table.cells)
        // At 90° both directions lie in the surface.
        .filter(|([h, d], cell)| cell.constrained && *h < 90.0 && *d < 90.0);
    let cells: Vec<_> = cells.collect();
    (0..3)
        .flat_map(|channel| {
            cells.iter().map(move |([h, d], cell)| {
                let [theta_deg, phi_r_deg] = directions_deg(*h, *d);
                Row {
                    theta_deg,
                    phi_r_deg,
                    channel,
                    value: cell.value[channel],
                    lower: cell.lower[channel],
                    upper: cell.upper[channel],
                }
            })
        })
        .collect()
}

/// Zenith angle of both directions, and azimuth of the second where that of the first is 0.
fn directions_deg(theta_h_deg: f64, theta_d_deg: f64) -> [f64; 2] {
    let (to_light, _) = HalfDifference {
        theta_h_rad: theta_h_deg.to_radians(),
        theta_d_rad: theta_d_deg.to_radians(),
        phi_d_rad: std::f64::consts::FRAC_PI_2,
    }
    .to_directions();
    let zenith = to_light.x.hypot(to_light.y).atan2(to_light.z);
    // The viewer's azimuth is the light's with the other sign; a mirror image turns neither.
    let between = 2.0 * to_light.y.atan2(to_light.x);
    [zenith, between].map(f64::to_degrees)
}

fn data(result: &StatedResult, rows: &[Row]) -> Value {
    let column = |of: fn(&Row) -> f64| -> Vec<f64> { rows.iter().map(of).collect() };
    let angle = |name: &str, description: &str, values: Vec<f64>| json!({ "name": name, "description": description, "unit": "deg", "values": values, "comments": DIRECTIONS_NOTE });
    let channels: Vec<&str> = rows
        .iter()
        .map(|row| ["R", "G", "B"][row.channel])
        .collect();
    let bands = [0, 1, 2].map(|c| result.band(c)).join("; ");
    let end = |which: &str, values: Vec<f64>| {
        json!({
            "description": format!("{which} end of the 95% interval of BRDF"),
            "unit": "1/sr",
            "type": "number",
            "minimum": 0.0,
            "values": values,
        })
    };
    json!({
        "theta_i": angle("theta_i", "Illumination light/beam incidence zenith angle.", column(|row| row.theta_deg)),
        "phi_i": angle("phi_i", "Illumination light/beam incidence azimuthal angle.", column(|_| 0.0)),
        "theta_r": angle("theta_r", "Reflected light/beam observation zenith angle.", column(|row| row.theta_deg)),
        "phi_r": angle("phi_r", "Reflected light/beam observation azimuthal angle.", column(|row| row.phi_r_deg)),
        "BRDF": {
            "name": "BRDF",
            "description": "Bidirectional reflectance distribution function.",
            "unit": "1/sr",
            "values": column(|row| row.value),
            "comments": format!("One block of rows for each channel of `channel`. The channels are bands, not wavelengths ({bands})."),
        },
        "uBRDF": {
            "unit": "1/sr",
            "values": column(|row| 0.5 * (row.upper - row.lower)),
            "comments": format!(
                "Expanded uncertainty, stated coverage 95%: half the width of the 95% interval of the posterior. The posterior is not Gaussian, so there is no common coverage factor k, and this is not 2 u; `interval_lower` and `interval_upper` are the ends. {}",
                coverage::statement(&result.record)
            ),
        },
        "adhoc_variables": {
            "channel": {
                "description": format!("Colour channel: a band of lamp and camera together, not a wavelength. {bands}."),
                "unit": "",
                "type": "string",
                "values": channels,
            },
            "interval_lower": end("lower", column(|row| row.lower)),
            "interval_upper": end("upper", column(|row| row.upper)),
        },
    })
}

fn metadata(result: &StatedResult) -> Value {
    let record = &result.record;
    let session = result.session.record();
    let simulated = if record.simulated {
        format!("{SIMULATED_NOTE}. ")
    } else {
        String::new()
    };
    let lacking = result.config.lab.missing();
    let lacking = match lacking.is_empty() {
        true => String::new(),
        false => format!(
            " The rig file's [lab] does not state: {}; the texts \"{NOT_STATED}\" and {NO_EMAIL} stand for them.",
            lacking.join(", ")
        ),
    };
    let share = 100.0 * record.table.constrained_share();
    let mut metadata = json!({
        "schema": SCHEMA,
        "id": format!("urn:sha256:{}", fit_digest(result)),
        "type": "BRDF",
        "timestamp": session.created_utc,
        "provenance": provenance(result),
        "description": format!(
            "{simulated}BRDF of the sample {:?}, fitted to images of its interreflections (session {}, fit {}). The images constrain {share:.1}% of the cells of half and difference angle; the file holds these.",
            session.sample,
            result.session_name(),
            result.number,
        ),
        "method": if record.simulated { "simulation" } else { "measurement" },
        "instrumentation": instrumentation(result),
        "software": software(result),
        "sample": {
            "name": session.sample,
            "type": if record.simulated { "virtual sample" } else { "physical sample" },
            "shape": result.sample_shape(),
            "dimensions": { "comments": result.sample_shape() },
            "zero_azimuth_location": "none: the BRDF is taken as isotropic",
            "properties_symmetry": "isotropic",
        },
        "environment": "NA",
        "comments": format!("{simulated}{}.{lacking}", record.verdict().sentence()),
        "adhoc_section": adhoc(result),
    });
    if !lacking.is_empty() {
        metadata["adhoc_section"]["lab_does_not_state"] = json!(result.config.lab.missing());
    }
    metadata
}

/// SHA-256 of `fit.toml`, by which the result is known everywhere.
fn fit_digest(result: &StatedResult) -> String {
    let path = format!("{FITS_FOLDER}/{}/fit.toml", result.number);
    let journal = result.session.journal();
    let mut files = journal.files().into_iter();
    let file = files.find(|file| file.path == path);
    file.map(|file| file.sha256.clone()).unwrap_or_default()
}

fn provenance(result: &StatedResult) -> Value {
    let lab = &result.config.lab;
    let or = |value: &Option<String>, default: &str| value.clone().unwrap_or(default.to_owned());
    let stated = |value: &Option<String>| or(value, NOT_STATED);
    let address = &lab.address;
    let mut location = json!({
        "country": stated(&address.country),
        "city": stated(&address.city),
        "street": stated(&address.street),
        "building_nr": stated(&address.building),
        "postal_code": stated(&address.postal_code),
    });
    if let Some(laboratory) = &lab.laboratory {
        location["room_nr"] = json!(laboratory);
    }
    let mut provenance = json!({
        "organization": stated(&lab.organisation),
        "location": location,
        "email": or(&lab.email, NO_EMAIL),
        "contact_person": stated(&lab.contact),
    });
    if let Some(website) = &lab.website {
        provenance["website"] = json!(website);
    }
    provenance
}

/// The schema demands the lamp's power and the bands of lamp and camera; where the rig file
/// does not state them, the instrument is described in the ad-hoc section alone.
fn instrumentation(result: &StatedResult) -> Value {
    let facts = &result.config.lab.instrument;
    let bands: Option<Vec<[f64; 2]>> = facts.band_nm.iter().copied().collect();
    let (Some(bands), Some([from, to]), Some(power_w)) =
        (bands, facts.camera_band_nm, facts.lamp_power_w)
    else {
        return json!("NA");
    };
    let (camera, stage) = (
        &result.session.record().versions.camera,
        &result.session.record().versions.stage,
    );
    let lowest = bands.iter().map(|band| band[0]).fold(f64::MAX, f64::min);
    let highest = bands.iter().map(|band| band[1]).fold(f64::MIN, f64::max);
    let view = &result.config.geometry.camera;
    let aperture = view.object_na.asin();
    let seen_mm = view.field_mm(DVec3::ZERO);
    let solid_angle_sr = std::f64::consts::TAU * (1.0 - aperture.cos());
    let mut instrumentation = json!({
        "name": format!("rig {}", result.config.name),
        "model": format!("camera {}, stage {}", camera.model, stage.driver),
        "serial_number": camera.serial,
        "firmware_version": stage.firmware,
        "operation_type": if result.traceability.is_traceable() { "relative" } else { "absolute" },
        "illumination_system": {
            "name": "lamp on a stage around the sample",
            "source": {
                "name": "lamp",
                "type": "lamp",
                "power": { "value": power_w, "unit": "W" },
                "wl_range": { "min_value": lowest, "max_value": highest, "unit": "nm" },
            },
            "beam": {
                "shape": "covers the sample",
                "dimensions": {
                    "area": { "value": seen_mm.x * seen_mm.y, "unit": "mm^2" },
                    "comments": "What the camera sees; the beam is at least as large.",
                },
            },
        },
        "detection_system": {
            "name": result.camera_geometry(),
            "sensors": [{
                "name": camera.model,
                "spectral_response_range": { "min_value": from, "max_value": to, "unit": "nm" },
            }],
            "solid_angle": { "value": solid_angle_sr, "unit": "sr" },
        },
        "comments": result.traceability.sentence(),
    });
    if let Some(operator) = &result.config.lab.operator {
        instrumentation["operator_name"] = json!(operator);
    }
    instrumentation
}

fn software(result: &StatedResult) -> Value {
    let settings = &result.record.settings;
    let parameter = |name: &str, description: &str, value: f64| json!({ "name": name, "description": description, "value": value, "unit": "" });
    json!({
        "name": "rig",
        "version": env!("CARGO_PKG_VERSION"),
        "description": "Inverse rendering of the interreflections of a concave sample: the weights of a dictionary of closed BRDFs and a smooth discrepancy from them.",
        "simulation_model": {
            "name": format!("mixture of the dictionary {}", result.record.dictionary),
            "description": "Light is followed through all reflections up to the longest path; the interval is of posterior samples of weights, discrepancy and bench.",
            "parameters": [
                parameter("longest path", "reflections", f64::from(settings.max_reflections)),
                parameter("paths per cell", "light paths", settings.samples_per_pixel as f64),
            ],
        },
    })
}

/// What the schema has no place for.
fn adhoc(result: &StatedResult) -> Value {
    let session = result.session.record();
    let record = &result.record;
    let (camera, stage) = (&session.versions.camera, &session.versions.stage);
    let calibration: Map<String, Value> = session
        .calibration
        .iter()
        .map(|copy| (copy.id.clone(), json!(copy.sha256)))
        .collect();
    json!({
        "simulated": record.simulated,
        "verdict": record.verdict(),
        "warnings": record.warnings,
        "traceability": result.traceability.sentence(),
        "coverage": coverage::statement(record),
        "constrained_share": record.table.constrained_share(),
        "worst_reduced_chi_square": record.worst_reduced_chi_square(),
        "camera": format!("{} ({}), serial {:?}, {} bits", camera.model, camera.driver, camera.serial, camera.bit_depth),
        "camera_geometry": result.camera_geometry(),
        "stage": format!("{}, firmware {:?}", stage.driver, stage.firmware),
        "lights": session.plan.lights.len(),
        "calibration_sha256": calibration,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The directions have the half and difference angles of their cell.
    #[test]
    fn directions_lie_on_the_measured_surface() {
        for (theta_h_deg, theta_d_deg) in [
            (0.0, 0.0),
            (0.0, 30.0),
            (20.0, 0.0),
            (35.0, 50.0),
            (80.0, 70.0),
        ] {
            let [theta, phi] = directions_deg(theta_h_deg, theta_d_deg).map(f64::to_radians);
            let direction = |phi: f64| {
                DVec3::new(
                    theta.sin() * phi.cos(),
                    theta.sin() * phi.sin(),
                    theta.cos(),
                )
            };
            let (light, viewer) = (direction(0.0), direction(phi));
            let half = (light + viewer).normalize();
            assert!((half.z.min(1.0).acos().to_degrees() - theta_h_deg).abs() < 1e-5);
            assert!((light.dot(half).min(1.0).acos().to_degrees() - theta_d_deg).abs() < 1e-5);
            assert!((0.0..=180.0 + 1e-9).contains(&phi.to_degrees()));
        }
    }
}
