//! The head of the page: verdict, key figures, scores.

use minijinja::context;
use minijinja::value::Value;

use super::value::value;
use crate::session::fit_record::{ChannelScore, FitRecord, MetricScores, Verdict};

/// Three significant digits.
pub(super) fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let magnitude = value.abs().log10().floor() as i32;
    if (-4..6).contains(&magnitude) {
        let digits = (2 - magnitude).max(0) as usize;
        format!("{value:.digits$}")
    } else {
        format!("{value:.2e}")
    }
}

pub(super) fn percent(value: f64) -> String {
    format!("{}%", short(value * 100.0))
}

pub(super) fn verdict_view(record: Option<&FitRecord>) -> Value {
    let Some(record) = record else {
        return context! {
            class => "none",
            sign => "–",
            title => "No fit yet: this session has captured images only",
            text => "“rig fit” adds the material’s BRDF to this report.",
        };
    };
    let verdict = record.verdict();
    let worst = record.worst_reduced_chi_square();
    let (class, sign, title) = match (verdict, worst) {
        (Verdict::Reservations, None) => {
            ("doubtful", "!", "The fit cannot be judged: it has no χ²")
        }
        (Verdict::Explains, _) => ("good", "✓", verdict.sentence()),
        (Verdict::Reservations, _) => ("doubtful", "!", verdict.sentence()),
        (Verdict::NotToBeTrusted, _) => ("bad", "✗", verdict.sentence()),
    };
    let worst = worst.map_or("not known".to_owned(), |worst| format!("{worst:.2}"));
    let mut text = format!(
        "Worst reduced χ² over lights and channels: {worst} (about 1 or less where noise and the allowed model error explain the images)."
    );
    if let Some(score) = &record.score {
        let (own, floor) = (
            &score.environment_error.estimate,
            &score.environment_error.floor,
        );
        text = format!(
            "The environment error against the true material ({}) is {}. The best mixture of {} \
             would reach {}. {text}",
            score.truth,
            percent(own.overall),
            record.dictionary,
            percent(floor.overall),
        );
    } else {
        text += " No truth is known for this sample, so neither is the error of the BRDF itself.";
    }
    context! { class, sign, title, text }
}

pub(super) fn tiles(record: Option<&FitRecord>) -> Vec<Value> {
    let Some(record) = record else {
        return Vec::new();
    };
    let mut tiles = Vec::new();
    let mut tile = |label: &str, value: String, note: &str| {
        tiles.push(context! { label, value, note });
    };
    if let Some(score) = &record.score {
        let errors = &score.environment_error;
        tile(
            "This fit",
            percent(errors.estimate.overall),
            "environment error",
        );
        if let Some(plain) = &score.plain {
            let signed = |value: f64, digits: usize| format!("{value:+.digits$}").replace('-', "−");
            let albedo = signed(plain.worst_albedo(), 3);
            tile("Albedo", albedo, "off by, at worst of 8°, 45°, 75°");
            let peak = format!("{}%", signed(100.0 * plain.worst_peak(), 0));
            tile("Peak", peak, "off by, in the mirror direction");
        }
        tile(
            "Dictionary floor",
            percent(errors.floor.overall),
            "of any mixture",
        );
        tile(
            "Reference projection",
            percent(errors.reference_projection.overall),
            "truth, projected",
        );
        if let Some(start) = &errors.single_bounce_start {
            tile(
                "Single-bounce start",
                percent(start.overall),
                "without interreflections",
            );
        }
    }
    if let Some(worst) = record.worst_reduced_chi_square() {
        tile("Worst reduced χ²", format!("{worst:.2}"), "1 is expected");
    }
    if let Some(discrepancy) = &record.discrepancy {
        let times = format!("{:.1}×", discrepancy.amplitude);
        tile(
            "Model discrepancy",
            times,
            "of measured materials’ usual one",
        );
    }
    if !record.table.cells.is_empty() {
        let share = percent(record.table.constrained_share());
        tile("Constrained", share, "of the (θh, θd) table");
    }
    tiles
}

pub(super) fn score_rows(record: Option<&FitRecord>) -> Vec<Value> {
    let Some(score) = record.and_then(|record| record.score.as_ref()) else {
        return Vec::new();
    };
    let mut rows = Vec::new();
    let mut add = |metric: &str, scores: &MetricScores| {
        let mut row = |estimate: &str, score: &ChannelScore, first: bool, own: bool| {
            let [r, g, b] = score.channels;
            let values = value([r, g, b, score.overall].map(percent));
            rows.push(context! { metric, estimate, values, first, own });
        };
        row("this fit", &scores.estimate, true, true);
        row(
            "reference projection",
            &scores.reference_projection,
            false,
            false,
        );
        row("dictionary floor", &scores.floor, false, false);
        if let Some(start) = &scores.single_bounce_start {
            row("single-bounce start", start, false, false);
        }
    };
    add("Environment error", &score.environment_error);
    add("BRDF error", &score.brdf_error);
    if let Some(scores) = &score.brdf_cube_root_error {
        add("BRDF error, cube root", scores);
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_significant_digits() {
        let cases = [
            (0.0, "0"),
            (0.012345, "0.0123"),
            (1234.5, "1234"),
            (9.9e-9, "9.90e-9"),
            (-2.5, "-2.50"),
        ];
        for (value, text) in cases {
            assert_eq!(short(value), text);
        }
    }
}
