//! `rig shape --inspect`: the content of a mesh file, and the lines that place it in a rig or
//! scene file.

use std::fmt::Write;
use std::path::Path;

use super::output::{write_bytes, write_json};
use super::{CliError, Context};
use crate::geometry::inspect::{Inspection, Suggestion, inspect};

pub(super) fn run(file: &Path, json: bool, context: &Context) -> Result<(), CliError> {
    let found = inspect(file)?;
    for remark in &found.remarks {
        context.warn(format_args!("{}: {remark}", file.display()));
    }
    if json {
        return write_json(&found);
    }
    write_bytes(text(file, &found).as_bytes())
}

/// The findings, then the lines to paste.
fn text(file: &Path, found: &Inspection) -> String {
    let mut text = String::new();
    let mut line = |text_line: String| {
        let _ = writeln!(text, "{text_line}");
    };
    let size: [f64; 3] = std::array::from_fn(|i| found.high[i] - found.low[i]);
    let nothing = 1e-6 * size.iter().copied().fold(0.0, f64::max);
    // Rounding errors count as zero.
    let length = |v: f64| short(if v.abs() < nothing { 0.0 } else { v });
    let of = |v: [f64; 3]| v.map(length).join(", ");
    let unit_vector = |v: [f64; 3]| v.map(|x| short((x * 1e5).round() / 1e5)).join(", ");
    line(format!(
        "{}: {} facets, {} vertices{}",
        file.display(),
        found.facets,
        found.vertices,
        if found.has_normals {
            " with normals"
        } else {
            ""
        }
    ));
    line(format!(
        "size: {} of the file's unit, from {} to {}",
        size.map(short).join(" × "),
        of(found.low),
        of(found.high)
    ));
    // The surface.
    line(match found.openings.first() {
        _ if found.is_closed => "surface: closed".to_owned(),
        None => "surface: open, without a border that surrounds an area".to_owned(),
        Some(widest) => format!(
            "surface: open; borders: {}, the widest of {} corners around [{}], {} long",
            found.openings.len(),
            widest.corners,
            of(widest.centre),
            short(widest.length)
        ),
    });
    if found.turned_edges + found.crowded_edges > 0 {
        line(format!(
            "edges: {} where neighbours face opposite ways, {} of more than two facets",
            found.turned_edges, found.crowded_edges
        ));
    }
    // The hollow, and which side is its front.
    match &found.hollow {
        Some(hollow) => line(format!(
            "hollow: {} deep, its rim around [{}] plane to {}, its axis [{}]",
            short(hollow.depth),
            of(hollow.rim.centre),
            length(hollow.rim.off_plane),
            unit_vector(hollow.axis)
        )),
        None => line("hollow: none with a plane rim, so its orientation is unknown".to_owned()),
    }
    line(match found.is_inside_out {
        Some(true) if found.is_closed => "fronts: inside the body, so it is inside out".to_owned(),
        Some(true) => "fronts: outside the hollow, so it is inside out, or a dome".to_owned(),
        Some(false) if found.is_closed => "fronts: outside the body, as they should be".to_owned(),
        Some(false) => "fronts: inside the hollow, as they should be".to_owned(),
        None => "fronts: whether they are on the right side is unknown".to_owned(),
    });
    // The lines to paste.
    line(format!(
        "\n# For [sample] of a scene file or [geometry.sample] of a rig file: {} mm across,",
        short(found.suggestion.size_mm)
    ));
    line("# free to turn about its axis".to_owned());
    line(lines(file, &found.suggestion, "").trim_end().to_owned());
    if let Some(dome) = &found.as_dome {
        line("\n# Or, if it is a dome that is seen from outside:".to_owned());
        line(lines(file, dome, "# ").trim_end().to_owned());
    }
    text
}

fn lines(file: &Path, suggestion: &Suggestion, start: &str) -> String {
    let name = toml::Value::String(file.display().to_string());
    let mut text = format!("{start}mesh = {name}\n");
    let _ = writeln!(text, "{start}mesh_unit = \"{}\"", suggestion.mesh_unit);
    if suggestion.flip_facets {
        let _ = writeln!(text, "{start}flip_facets = true");
    }
    if let (Some(turn), Some(shift)) = (suggestion.rotate_deg, suggestion.translate_mm)
        && (turn, shift) != ([0.0; 3], [0.0; 3])
    {
        let _ = writeln!(
            text,
            "{start}mesh_to_sample = {{ rotate_deg = {turn:?}, translate_mm = {shift:?} }}"
        );
    }
    text
}

/// Five digits.
fn short(value: f64) -> String {
    let digits = (4 - value.abs().max(1e-9).log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.digits$}");
    let text = match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.'),
        false => &text,
    };
    // No negative zero.
    text.strip_prefix('-')
        .filter(|rest| *rest == "0")
        .unwrap_or(text)
        .to_owned()
}
