//! Fig. 5: the shape of Section 6 and the rays that it is made for.

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table};
use super::lab::{Lab, Sample};
use crate::geometry::Shape;
use crate::geometry::shapes::designed_wall;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};

/// Profile, mirror rays, and a check by tracing.
pub static SHAPE_CONSTRUCTION: Experiment = Experiment {
    name: "shape-construction",
    shows: "Fig. 5: profile of the designed shape for several wall heights, mirror rays that return after two reflections, and how well rays traced on the mesh do so",
    full: Scale::NONE,
    quick: Scale::NONE,
    cases,
    figures,
};

/// Wall heights C over the arc's radius.
const OFFSETS: [f32; 4] = [0.0, 0.25, 0.5, 1.0];
const PHI_MIN_DEG: f64 = 45.0;

fn cases(_: &Lab) -> Result<Vec<Case>, EvaluateError> {
    Ok(OFFSETS
        .into_iter()
        .map(|offset| Case::new(format!("C = {offset}"), move |_: &Lab| profile(offset)))
        .collect())
}

/// Both reflections of the mirror rays in units of the arc's radius, by the angle of the
/// first normal; with every row what the traced mesh does.
fn profile(offset: f32) -> Result<Vec<Row>, EvaluateError> {
    let Shape::Designed {
        phi_min_deg,
        form,
        length_mm,
        ..
    } = Sample::Designed.shape(1024)
    else {
        return Err(EvaluateError::Fact(
            "the designed sample is no designed shape".to_owned(),
        ));
    };
    let shape = Shape::Designed {
        radius_mm: 1.0,
        offset,
        phi_min_deg,
        form,
        length_mm,
        segments: 1024,
    };
    let mirror = shape.mirror_check(&shape.mesh()?);
    Ok((0..=45)
        .map(|step| {
            let phi_deg = PHI_MIN_DEG + f64::from(step);
            let phi = phi_deg.to_radians();
            let [x2, z2] = designed_wall(1.0, f64::from(offset), phi);
            Row::new()
                .with("offset", f64::from(offset))
                .with("phi_deg", phi_deg)
                .with("arc_x", phi.sin())
                .with("arc_z", phi.cos())
                .with("wall_x", x2)
                .with("wall_z", z2)
                .with("theta_d_first_deg", phi_deg)
                .with("theta_d_second_deg", 90.0 - phi_deg)
                .with("rays_traced", mirror.map_or(0, |m| m.rays))
                .with("rays_returned", mirror.map_or(0, |m| m.returned_after_two))
                .with(
                    "worst_deviation_deg",
                    mirror.map(|m| f64::from(m.worst_deviation_deg)),
                )
        })
        .collect())
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let of = |offset: f64| {
        let rows = table.rows.iter();
        rows.filter(move |row| row.number("offset") == Some(offset))
    };
    let point = |row: &Row, x: &str, z: &str| Some([row.number(x)?, row.number(z)?]);
    // Equal scales: the panel is 308 by 232 pixels.
    let x = Axis::linear(-0.2..4.3, "x / R");
    let z = Axis::linear(-1.25..2.14, "z / R");
    let arc: Vec<_> = (0..=90)
        .map(|deg| f64::from(deg).to_radians())
        .map(|phi| [phi.sin(), phi.cos()])
        .collect();
    let mut walls = vec![Series::new("convex arc", 7, Mark::Line, arc.clone())];
    for (color, offset) in table.numbers("offset").into_iter().enumerate() {
        let wall = of(offset).filter_map(|row| point(row, "wall_x", "wall_z"));
        let mut wall: Vec<_> = wall.collect();
        wall.push([1.0, 0.0]);
        walls.push(Series::new(
            &format!("C = {offset} R"),
            color,
            Mark::Line,
            wall,
        ));
    }
    let chosen = 0.5;
    let mut rays = vec![Series::new("", 7, Mark::Line, arc)];
    let mut wall: Vec<_> = of(chosen)
        .filter_map(|row| point(row, "wall_x", "wall_z"))
        .collect();
    wall.push([1.0, 0.0]);
    rays.push(Series::new("", 2, Mark::Line, wall));
    for row in of(chosen) {
        let steps = row.number("phi_deg").map(|phi| phi as i64 % 6);
        let ends = (point(row, "arc_x", "arc_z"), point(row, "wall_x", "wall_z"));
        if let (Some(3), (Some(a), Some(b))) = (steps, ends) {
            let ray = vec![[a[0], 2.1], a, b, [b[0], 2.1]];
            rays.push(Series::new("mirror ray", 4, Mark::Line, ray));
        }
    }
    let panel = |title: &str, series| Chart {
        title: title.to_owned(),
        x: x.clone(),
        y: z.clone(),
        series,
    };
    Ok(vec![charts(
        "shape-construction",
        2,
        &[
            panel("profiles for φ from 45° to 90°", walls),
            panel("mirror rays, C = 0.5 R", rays),
        ],
    )])
}
