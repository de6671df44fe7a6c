//! Sample shapes that need no mesh file.

use super::ConfigError;
use super::reader::Section;

/// A shape by its parameters; lengths in millimetres, in the sample frame, its
/// opening (or top) towards +z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ShapeSpec {
    /// A hollow hemisphere, open towards +z, its centre in the origin.
    Bowl {
        /// Inner radius, mm.
        radius_mm: f64,
        /// Facets around the rim.
        segments: u32,
    },
    /// A convex sphere around the origin.
    Sphere {
        /// Radius, mm.
        radius_mm: f64,
        /// Facets around the equator.
        segments: u32,
    },
    /// A hollow part of a sphere, less deep than a bowl; the sphere's centre is the origin.
    Cap {
        /// Inner radius of the sphere, mm.
        radius_mm: f64,
        /// Angle between the axis and the rim, seen from the sphere's centre, degrees.
        half_angle_deg: f64,
        /// Facets around the rim.
        segments: u32,
    },
    /// Three mutually inclined faces that meet in a point below the origin: a hollow corner.
    Tetrahedron {
        /// Distance from the opening's plane (z = 0) down to the point, mm.
        depth_mm: f64,
        /// Distance from the opening's centre to its corners, mm.
        radius_mm: f64,
    },
    /// The two-bounce retroreflecting profile of the paper's Section 6.
    Designed {
        /// Radius of the convex arc, mm.
        radius_mm: f64,
        /// The profile's constant of integration over `radius_mm`; above 0 it
        /// adds a wall between the arc and its partner.
        c: f64,
        /// Where the arc ends, the angle of its normal from the axis, degrees.
        phi_min_deg: f64,
        /// How the profile becomes a surface.
        form: DesignedForm,
        /// Facets along the profile (and around, if revolved).
        segments: u32,
    },
}

/// How a profile becomes a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DesignedForm {
    /// Drawn out along y by this length, mm.
    Extruded {
        /// Length along y, mm.
        length_mm: f64,
    },
    /// Turned about the axis.
    Revolved,
}

/// Lengths of samples, mm.
const LENGTH_MM: std::ops::RangeInclusive<f64> = 1e-3..=1e4;

impl ShapeSpec {
    /// Reads `{ kind = "bowl", radius_mm = 1.0, … }`.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        let kind = table
            .choice(
                "kind",
                &[
                    ("bowl", 0),
                    ("sphere", 1),
                    ("cap", 2),
                    ("tetrahedron", 3),
                    ("designed", 4),
                ],
            )?
            .required()?;
        let radius_mm = table.number("radius_mm", LENGTH_MM)?.or(1.0);
        let shape = match kind {
            0 => ShapeSpec::Bowl {
                radius_mm,
                segments: segments(&mut table)?,
            },
            1 => ShapeSpec::Sphere {
                radius_mm,
                segments: segments(&mut table)?,
            },
            2 => ShapeSpec::Cap {
                radius_mm,
                half_angle_deg: table.number("half_angle_deg", 1.0..=90.0)?.required()?,
                segments: segments(&mut table)?,
            },
            3 => ShapeSpec::Tetrahedron {
                depth_mm: table.number("depth_mm", LENGTH_MM)?.required()?,
                radius_mm,
            },
            _ => ShapeSpec::Designed {
                radius_mm,
                c: table.number("c", 0.0..=10.0)?.or(0.5),
                phi_min_deg: table.number("phi_min_deg", 10.0..=89.0)?.or(45.0),
                form: read_form(&mut table)?,
                segments: segments(&mut table)?,
            },
        };
        table.finish()?;
        Ok(shape)
    }
}

fn segments(table: &mut Section) -> Result<u32, ConfigError> {
    Ok(table.integer("segments", 8..=4096)?.or(128) as u32)
}

fn read_form(table: &mut Section) -> Result<DesignedForm, ConfigError> {
    let extruded = table
        .choice("form", &[("extruded", true), ("revolved", false)])?
        .or(true);
    if !extruded {
        return Ok(DesignedForm::Revolved);
    }
    let length_mm = table.number("length_mm", LENGTH_MM)?.required()?;
    Ok(DesignedForm::Extruded { length_mm })
}
