//! The drawing of a design: its section with dimensions, the camera and the lamps.

use std::fmt::Write as _;

use super::profile::KNOTS;
use super::{DesignRequest, Found};
use crate::geometry::shapes::Form;

/// Units of the drawing per radius.
const SCALE: f64 = 300.0;
/// Middle of the rim's plane.
const MIDDLE: [f64; 2] = [480.0, 420.0];

/// As SVG; lengths in mm, angles in degrees.
pub fn svg(found: &Found, request: &DesignRequest) -> String {
    let (profile, design) = (&found.profile, &found.design);
    let radius_mm = request.limits.radius_mm;
    let at = |r: f64, z: f64| [MIDDLE[0] + SCALE * r, MIDDLE[1] - SCALE * z];
    let mut text = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-60 0 1040 670\" font-family=\"sans-serif\" font-size=\"14\">\n\
         <rect x=\"-60\" width=\"1040\" height=\"670\" fill=\"white\"/>\n",
    );
    let line = |[x1, y1]: [f64; 2], [x2, y2]: [f64; 2], style: &str| {
        format!("<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" {style}/>\n")
    };
    let label = |[x, y]: [f64; 2], anchor: &str, words: &str| {
        format!("<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{words}</text>\n")
    };
    let (thin, dashed) = (
        "stroke=\"#888\"",
        "stroke=\"#888\" stroke-dasharray=\"8 4 2 4\"",
    );

    // The section, its axis and the plane of the rim.
    let points: Vec<String> = (-200..=200)
        .map(|k| {
            let r = f64::from(k) / 200.0;
            let [x, y] = at(r, profile.at(r.abs())[0]);
            format!("{x:.2},{y:.2}")
        })
        .collect();
    let _ = writeln!(
        text,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"black\" stroke-width=\"2\"/>",
        points.join(" ")
    );
    text += &line(at(0.0, -0.6), at(0.0, 1.3), dashed);
    text += &line(at(-1.0, 0.0), at(1.0, 0.0), thin);

    // Heights at the knots, from the rim's plane.
    for k in 0..KNOTS {
        let r = k as f64 / (KNOTS - 1) as f64;
        let z = profile.at(r)[0];
        text += &line(at(r, 0.0), at(r, z), thin);
        let words = format!("{}: r {:.2}, z {:+.2}", k + 1, r * radius_mm, z * radius_mm);
        text += &label(
            [MIDDLE[0] + 330.0, 460.0 + 18.0 * k as f64],
            "start",
            &words,
        );
        text += &label(at(r, z - 0.05), "middle", &format!("{}", k + 1));
    }
    text += &line(at(-1.0, -0.62), at(1.0, -0.62), thin);
    let sign = match request.limits.form {
        Form::Revolved => "⌀ ",
        Form::Extruded => "",
    };
    text += &label(
        at(0.0, -0.68),
        "middle",
        &format!("{sign}{:.2} mm", 2.0 * radius_mm),
    );
    let limits = &request.limits;
    let made = match limits.form {
        Form::Revolved => "turned about its axis".to_owned(),
        Form::Extruded => format!("{:.2} long", 2.0 * radius_mm),
    };
    let over = match limits.thickness_mm {
        0.0 => String::new(),
        thickness_mm => format!(", the upper face of {thickness_mm:.2} of paint or sheet"),
    };
    text += &label(
        [20.0, 640.0],
        "start",
        &format!("Lengths in mm; {made}{over}."),
    );
    let facts = format!(
        "Steepest {:.0}°, smallest radius {:.2}, between heights a cubic spline.",
        profile.steepest_deg(),
        profile.smallest_radius_mm(limits)
    );
    text += &label([20.0, 660.0], "start", &facts);

    // Camera and lamps, in the plane of the drawing at their elevation.
    let mut ray = |elevation_deg: f64, side: f64, color: &str, words: &str| {
        let (sin, cos) = elevation_deg.to_radians().sin_cos();
        let [near, far] = [0.95, 1.15].map(|d| at(side * d * cos, d * sin));
        let style = format!("stroke=\"{color}\" stroke-width=\"2\"");
        text += &line(near, far, &style);
        let anchor = if side < 0.0 { "end" } else { "start" };
        text += &label(far, anchor, words);
    };
    let tilt_deg = design.camera_tilt_deg;
    let words = format!("camera, {tilt_deg:.1}° from the axis");
    ray(90.0 - tilt_deg, -1.0, "#1f5fbf", &words);
    for lamp in &design.lights {
        let (azimuth, elevation) = (lamp.angles.azimuth_deg, lamp.angles.elevation_deg);
        let to_light = lamp.to_light();
        let side = if to_light.x < -1e-9 { -1.0 } else { 1.0 };
        let words = format!("lamp {azimuth:.0}°, {elevation:.0}°");
        ray(to_light.z.asin().to_degrees(), side, "#c07000", &words);
    }
    text + "</svg>\n"
}
