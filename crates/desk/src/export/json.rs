//! The fit as one JSON document.

use serde_json::{Value, json};

use super::{Format, SIMULATED_NOTE, Writer, replace};
use crate::brdf::discrepancy;
use crate::session::fit_record::{DiscrepancyRecord, FitRecord};

/// Everything, for programs.
pub(super) const FORMAT: Format = Format {
    name: "json",
    about: "Dictionary, weights, model discrepancy and the table with its intervals (.json)",
    ending: "json",
    companion: None,
    writer: Writer::OfFit(|record, files| replace(&files[0], to_json(record).as_bytes())),
};

/// Version of the document's layout.
const VERSION: u32 = 1;

/// ln of what f is more than the mixture's, `ln_factor` + `by_cos_2phi` cos 2φd, bilinear in its
/// exponential between the angles.
fn discrepancy(discrepancy: &DiscrepancyRecord) -> Value {
    let by_channel = discrepancy.by_channel.each_ref();
    let nodes: Vec<Value> = discrepancy::nodes()
        .enumerate()
        .map(|(k, node)| {
            json!({
                "theta_h_deg": node.theta_h_deg,
                "theta_d_deg": node.theta_d_deg,
                "ln_factor": by_channel.map(|g| g.at_node(k)[0]),
                "by_cos_2phi": by_channel.map(|g| g.at_node(k)[1]),
            })
        })
        .collect();
    json!({ "amplitude": discrepancy.amplitude, "nodes": nodes })
}

/// Dictionary, weights with their deviations, the model discrepancy (`discrepancy`), and the (θh, θd) table with its
/// 95% interval. BRDF values are in 1/sr, cosine excluded; channels are R, G, B;
/// table values are indexed `[θh][θd][channel]`.
pub fn to_json(record: &FitRecord) -> String {
    let atoms: Vec<Value> = record
        .atoms
        .iter()
        .map(|atom| {
            let mut value = json!({ "type": atom.kind });
            for (key, number) in [
                ("alpha", atom.alpha),
                ("eta", atom.eta),
                ("albedo", atom.albedo),
            ] {
                if let Some(number) = number {
                    value[key] = json!(number);
                }
            }
            value
        })
        .collect();
    let table = &record.table;
    let rows = |of: fn(&crate::session::fit_record::Interval) -> Value| -> Vec<Vec<Value>> {
        let row = |cells: &[_]| cells.iter().map(of).collect();
        table
            .cells
            .chunks(table.theta_d_deg.len().max(1))
            .map(row)
            .collect()
    };
    let mut document = json!({
        "format": "rig-brdf",
        "version": VERSION,
        "simulated": record.simulated,
        "program": concat!("rig ", env!("CARGO_PKG_VERSION")),
        "brdf_unit": "1/sr, cosine excluded",
        "channels": ["r", "g", "b"],
        "dictionary": { "name": record.dictionary, "atoms": atoms },
        "weights": record.weights,
        "weight_standard_deviations": record.weight_deviations,
        "weights_note": "weights alone are not identifiable: compare BRDF values, not weights",
        "reduced_chi_square": record.reduced_chi_square,
        "discrepancy": record.discrepancy.as_ref().map(discrepancy),
        "verdict": record.verdict(),
        "warnings": record.warnings,
        "table": {
            "theta_h_deg": table.theta_h_deg,
            "theta_d_deg": table.theta_d_deg,
            "phi_d_deg": 90.0,
            "value": rows(|cell| json!(cell.value)),
            "interval": 0.95,
            "lower": rows(|cell| json!(cell.lower)),
            "upper": rows(|cell| json!(cell.upper)),
            "constrained": rows(|cell| json!(cell.constrained)),
        },
    });
    if record.simulated {
        document["note"] = json!(SIMULATED_NOTE);
    }
    let mut text = document.to_string();
    text.push('\n');
    text
}
