//! The tables of two axes: what they do with the lamp, and how far they go.

use crate::config::ConfigError;
use crate::config::reader::Section;
use crate::device::kinematics::{AxisMap, Mechanism, TwoAxes};

#[derive(Clone, Copy)]
enum Kind {
    Rotary,
    Arc,
    Gantry,
}

/// Reads `mechanism` and its keys, and the tables of both axes. `name` takes
/// from an axis' table what the protocol calls it.
pub fn read<T: PartialEq + std::fmt::Display>(
    table: &mut Section,
    mut name: impl FnMut(&mut Section) -> Result<T, ConfigError>,
) -> Result<(TwoAxes, [T; 2]), ConfigError> {
    let kinds = [
        ("rotary", Kind::Rotary),
        ("arc", Kind::Arc),
        ("gantry", Kind::Gantry),
    ];
    let kind = table.choice("mechanism", &kinds)?.or(Kind::Rotary);
    let mechanism = match kind {
        Kind::Rotary => Mechanism::Rotary,
        Kind::Arc => {
            let radius_mm = table.number("radius_mm", 10.0..=1e4)?.required()?;
            let height = table.number("centre_height_mm", -9e3..=9e3)?;
            let centre_height_mm = height.or(0.0);
            if centre_height_mm.abs() > 0.9 * radius_mm {
                let allowed = format!("within 0.9 radius_mm ({}) of 0", 0.9 * radius_mm);
                return Err(table.conflict("centre_height_mm", centre_height_mm, &allowed));
            }
            Mechanism::Arc {
                radius_mm,
                centre_height_mm,
            }
        }
        Kind::Gantry => Mechanism::Gantry {
            height_mm: table.number("height_mm", 10.0..=1e4)?.required()?,
        },
    };
    let (keys, unit) = match kind {
        Kind::Rotary | Kind::Arc => (["azimuth", "elevation"], DEGREES),
        Kind::Gantry => (["x", "y"], MILLIMETRES),
    };
    let mut read = |key| {
        let mut axis = table.section(key)?.required()?;
        let name = name(&mut axis)?;
        Ok((read_axis(axis, &unit)?, name))
    };
    let (first, first_name) = read(keys[0])?;
    let (second, second_name) = read(keys[1])?;
    if first_name == second_name {
        let allowed = format!("another axis than {}'s", keys[0]);
        return Err(table.conflict(&format!("{}.axis", keys[1]), second_name, &allowed));
    }
    let axes = TwoAxes {
        mechanism,
        first,
        second,
        approach: table.number(unit.approach.0, unit.approach.1)?.or(2.0),
    };
    Ok((axes, [first_name, second_name]))
}

/// The keys of an axis in its unit.
#[derive(Clone)]
struct Unit {
    offset: &'static str,
    min: &'static str,
    max: &'static str,
    range: std::ops::RangeInclusive<f64>,
    approach: (&'static str, std::ops::RangeInclusive<f64>),
}

const DEGREES: Unit = Unit {
    offset: "offset_deg",
    min: "min_deg",
    max: "max_deg",
    range: -360.0..=360.0,
    approach: ("approach_deg", 0.0..=45.0),
};

const MILLIMETRES: Unit = Unit {
    offset: "offset_mm",
    min: "min_mm",
    max: "max_mm",
    range: -1e4..=1e4,
    approach: ("approach_mm", 0.0..=100.0),
};

fn read_axis(mut table: Section, unit: &Unit) -> Result<AxisMap, ConfigError> {
    let mut number = |key| table.number(key, unit.range.clone());
    let offset = number(unit.offset)?.or(0.0);
    let min = number(unit.min)?.required()?;
    let max = number(unit.max)?.required()?;
    let scale = table.number("scale", -1e7..=1e7)?.or(1.0);
    if scale.abs() < 1e-6 {
        return Err(table.conflict("scale", scale, "away from 0"));
    }
    if min > max {
        let allowed = format!("at least {} ({min})", unit.min);
        return Err(table.conflict(unit.max, max, &allowed));
    }
    table.finish()?;
    Ok(AxisMap {
        scale,
        offset,
        min,
        max,
    })
}
