//! What answers must be to each other. A relation counts once all its answers are there.

use super::answer::{AnswerError, Answers};
use super::derived::{channels, field_mm, field_of_view};
use super::table::directions;
use crate::config::camera::offered;

/// Checks every relation whose answers are there.
///
/// # Errors
/// [`AnswerError::Invalid`] with the key of the answer that was asked for last.
pub fn check(answers: &Answers) -> Result<(), AnswerError> {
    let all = [practice, lens, sample, limits, axes, filters, addresses];
    all.iter()
        .try_for_each(|relation| relation(answers).unwrap_or(Ok(())))
}

/// `None`: an answer is not there yet.
type Outcome = Option<Result<(), AnswerError>>;

fn must(
    key: &'static str,
    holds: bool,
    value: impl ToString,
    allowed: String,
) -> Result<(), AnswerError> {
    match holds {
        true => Ok(()),
        false => Err(AnswerError::Invalid {
            key,
            value: value.to_string(),
            allowed,
        }),
    }
}

/// A camera for practice alone has 8 bits.
fn practice(answers: &Answers) -> Outcome {
    let name = answers.text("camera")?.split(' ').next()?;
    offered().find(|driver| driver.name == name && driver.only_practice)?;
    let bits = answers.whole("bit_depth")?;
    Some(must(
        "bit_depth",
        bits == 8,
        bits,
        format!("8 with a {name}"),
    ))
}

/// A lens focuses beyond its focal length, and sees an angle that the rig file can state.
fn lens(answers: &Answers) -> Outcome {
    let distance = answers.number("camera_distance_mm")?;
    if let Some(focal) = answers.number("focal_mm") {
        let allowed = format!("above the focal length ({focal} mm)");
        let key = "camera_distance_mm";
        if let error @ Err(_) = must(key, distance > focal, distance, allowed) {
            return Some(error);
        }
    }
    if answers.text("lens")? == "telecentric" {
        let [across, down] = field_mm(answers)?;
        let allowed = format!(
            "such that the field, {across} × {down} mm by the frame's shape, has sides from 0.001 to 10000 mm"
        );
        let holds = [across, down]
            .iter()
            .all(|side| (1e-3..=1e4).contains(side));
        return Some(must("field_width_mm", holds, across, allowed));
    }
    let angle = field_of_view(answers)?;
    let allowed =
        format!("such that the angle of view is from 0.1 to 170 degrees (it is {angle:.2})");
    let holds = (0.1..=170.0).contains(&angle);
    Some(must("camera_distance_mm", holds, distance, allowed))
}

/// The image shows the whole sample.
fn sample(answers: &Answers) -> Outcome {
    let radius = answers.number("sample_radius_mm")?;
    let width = answers.number("groove_width_mm");
    if let Some(width) = width {
        let allowed = format!("less than twice the radius ({radius} mm)");
        if let error @ Err(_) = must("groove_width_mm", width < 2.0 * radius, width, allowed) {
            return Some(error);
        }
    }
    let [across, down] = field_mm(answers)?;
    let half = 0.5 * across.min(down);
    let part = match answers.number("sample_opening_deg") {
        Some(opening_deg) => opening_deg.min(90.0).to_radians().sin(),
        None => 1.0,
    };
    let outer = radius * part + 0.5 * width.unwrap_or(0.0);
    let allowed = format!(
        "such that the sample ({outer} mm from its middle) is within {half:.2} mm, half of the shorter side of the field of view"
    );
    Some(must("sample_radius_mm", outer <= half, radius, allowed))
}

/// Each axis has a range, and a place in it.
fn limits(answers: &Answers) -> Outcome {
    let axes = [
        ("azimuth_min_deg", "azimuth_max_deg"),
        ("elevation_min_deg", "elevation_max_deg"),
        ("x_min_mm", "x_max_mm"),
        ("y_min_mm", "y_max_mm"),
    ];
    let each = axes.iter().try_for_each(|&(least, most)| {
        let (Some(low), Some(high)) = (answers.number(least), answers.number(most)) else {
            return Ok(());
        };
        must(
            most,
            low <= high,
            high,
            format!("at least `{least}` ({low})"),
        )
    });
    Some(each)
}

/// Two axes are two, and each of them moves.
fn axes(answers: &Answers) -> Outcome {
    if let (Some(first), Some(second)) =
        (answers.text("first_device"), answers.text("second_device"))
    {
        let allowed = format!("another axis than `first_device` ({first})");
        if let error @ Err(_) = must("second_device", first != second, second, allowed) {
            return Some(error);
        }
    }
    let moves = ["first_scale", "second_scale"].iter().try_for_each(|&key| {
        let Some(scale) = answers.number(key) else {
            return Ok(());
        };
        must(key, scale.abs() >= 1e-6, scale, "away from 0".to_owned())
    });
    Some(moves)
}

/// Cells of colour filters are whole.
fn filters(answers: &Answers) -> Outcome {
    let even = |n: u32| n.is_multiple_of(2);
    let [width, height] = [answers.whole("width_px")?, answers.whole("height_px")?];
    let holds = answers.text("mosaic")? == "none" || (even(width) && even(height));
    let allowed = format!("none, because {width} and {height} pixels are not both even");
    Some(must("mosaic", holds, answers.text("mosaic")?, allowed))
}

/// The last light's last channel has a DMX address.
fn addresses(answers: &Answers) -> Outcome {
    let first = answers.whole("dmx_first")?;
    let lights = directions(answers.text("lights")?)?.len() as u32;
    let channels = channels(answers)?;
    let most = 513i64 - i64::from(lights * channels);
    let allowed = format!("at most {most}: {lights} lights of {channels} channels must end at 512");
    Some(must("dmx_first", i64::from(first) <= most, first, allowed))
}
