//! Sample shapes that need no mesh file, as both kinds of file name them.

use std::ops::RangeInclusive;

use super::ConfigError;
use super::reader::Section;
use crate::geometry::Shape;
use crate::geometry::shapes::{Form, Profile};

/// Lengths of samples, mm.
const LENGTH_MM: RangeInclusive<f64> = 1e-3..=1e4;

/// Reads `{ kind = "bowl", radius_mm = 10.0, segments = 128 }`.
pub fn read_shape(mut table: Section) -> Result<Shape, ConfigError> {
    let kind = table
        .choice(
            "kind",
            &[
                ("bowl", 0),
                ("sphere", 1),
                ("cap", 2),
                ("tetrahedron", 3),
                ("designed", 4),
                ("groove", 5),
                ("ridge", 6),
            ],
        )?
        .required()?;
    let radius_mm = table.number("radius_mm", LENGTH_MM)?.required()? as f32;
    let shape = match kind {
        0 => Shape::Bowl {
            radius_mm,
            segments: segments(&mut table)?,
        },
        1 => Shape::Sphere {
            radius_mm,
            segments: segments(&mut table)?,
        },
        2 => Shape::Cap {
            radius_mm,
            opening_deg: table.number("opening_deg", 5.0..=170.0)?.or(90.0) as f32,
            segments: segments(&mut table)?,
        },
        3 => Shape::Tetrahedron {
            radius_mm,
            depth_mm: table.number("depth_mm", -1e4..=1e4)?.required()? as f32,
        },
        4 => {
            let (form, length_mm) = swept(&mut table, Form::Extruded)?;
            Shape::Designed {
                radius_mm,
                offset: table.number("offset", 0.0..=2.0)?.or(0.5) as f32,
                phi_min_deg: table.number("phi_min_deg", 30.0..=60.0)?.or(45.0) as f32,
                form,
                length_mm,
                segments: segments(&mut table)?,
            }
        }
        6 => {
            let (form, length_mm) = swept(&mut table, Form::Revolved)?;
            Shape::Ridge {
                radius_mm,
                form,
                length_mm,
                segments: segments(&mut table)?,
            }
        }
        _ => groove(&mut table, radius_mm)?,
    };
    table.finish()?;
    Ok(shape)
}

/// How a profile is swept, and how far.
fn swept(table: &mut Section, usual: Form) -> Result<(Form, f32), ConfigError> {
    let form = [("extruded", Form::Extruded), ("revolved", Form::Revolved)];
    let form = table.choice("form", &form)?.or(usual);
    let length_mm = table.number("length_mm", LENGTH_MM)?;
    let length_mm = match form {
        Form::Extruded => length_mm.required()?,
        Form::Revolved => length_mm.or(0.0),
    };
    Ok((form, length_mm as f32))
}

fn groove(table: &mut Section, radius_mm: f32) -> Result<Shape, ConfigError> {
    let width_mm = table.number("width_mm", LENGTH_MM)?.required()? as f32;
    if width_mm >= 2.0 * radius_mm {
        let allowed = "less than twice radius_mm";
        return Err(table.conflict("width_mm", width_mm, allowed));
    }
    let kinds = [("round", true), ("vee", false)];
    let round = table.choice("profile", &kinds)?.or(true);
    let depth_mm = table.number("depth_mm", LENGTH_MM)?;
    let profile = if round {
        if let Some(depth_mm) = depth_mm.optional() {
            let allowed = "absent where profile is \"round\"";
            return Err(table.conflict("depth_mm", depth_mm, allowed));
        }
        Profile::Round
    } else {
        Profile::Vee {
            depth_mm: depth_mm.or(f64::from(0.5 * width_mm)) as f32,
        }
    };
    Ok(Shape::Groove {
        radius_mm,
        width_mm,
        profile,
        segments: segments(table)?,
    })
}

fn segments(table: &mut Section) -> Result<u32, ConfigError> {
    let segments = table.integer("segments", 8..=4096)?.or(128) as u32;
    if segments.is_multiple_of(4) {
        Ok(segments)
    } else {
        Err(table.conflict("segments", segments, "a multiple of 4"))
    }
}
