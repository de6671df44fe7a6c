//! `rig shape`: sample shapes as meshes.

use std::path::PathBuf;

use super::{CliError, Context, HintExt, output};
use crate::geometry::shapes::Form;
use crate::geometry::{Shape, files};

/// Writes the mesh of a sample shape, with its figures.
#[derive(clap::Args, Debug)]
pub struct ShapeArgs {
    /// Which shape
    #[arg(value_enum)]
    kind: Kind,
    /// Radius, mm: of the sphere, of the base's corners, of the convex arc
    #[arg(long, value_name = "MM", default_value_t = 10.0, value_parser = positive)]
    radius: f32,
    /// Depth of a corner below its rim, mm; negative for a convex one (tetrahedron)
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 7.071,
        allow_negative_numbers = true
    )]
    depth: f32,
    /// The profile's constant in radii (designed)
    #[arg(long, value_name = "C", default_value_t = 0.5)]
    offset: f32,
    /// Where the designed arc's partner on the wall ends, degrees (designed)
    #[arg(long, value_name = "DEG", default_value_t = 45.0)]
    phi_min: f32,
    /// Revolved about z instead of extruded along y (designed)
    #[arg(long)]
    revolved: bool,
    /// Length along y, mm (designed, extruded)
    #[arg(long, value_name = "MM", default_value_t = 30.0, value_parser = positive)]
    length: f32,
    /// Facets around, 8 to 4096
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = clap::value_parser!(u32).range(8..=4096))]
    segments: u32,
    /// Mesh to write, millimetres: .ply, .obj or .stl
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(clap::ValueEnum, Debug, Clone, Copy)]
enum Kind {
    Bowl,
    Sphere,
    Cap,
    Tetrahedron,
    Designed,
}

fn positive(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(value) if (1e-3..=1e4).contains(&value) => Ok(value),
        _ => Err("not a number in 0.001 to 10000".to_owned()),
    }
}

/// `rig shape`.
pub fn run(args: &ShapeArgs, _: &Context) -> Result<(), CliError> {
    let (radius_mm, segments) = (args.radius, args.segments.next_multiple_of(4));
    let shape = match args.kind {
        Kind::Bowl => Shape::Bowl {
            radius_mm,
            segments,
        },
        Kind::Sphere => Shape::Sphere {
            radius_mm,
            segments,
        },
        Kind::Cap => Shape::Cap {
            radius_mm,
            segments,
        },
        Kind::Tetrahedron => Shape::Tetrahedron {
            radius_mm,
            depth_mm: args.depth,
        },
        Kind::Designed => {
            for (name, value, low, high) in [
                ("offset", args.offset, 0.0, 2.0),
                ("phi-min", args.phi_min, 30.0, 60.0),
            ] {
                if !(low..=high).contains(&value) {
                    return Err(CliError::new(format!(
                        "--{name} is {value}, allowed are {low} to {high}"
                    )));
                }
            }
            Shape::Designed {
                radius_mm,
                offset: args.offset,
                phi_min_deg: args.phi_min,
                form: if args.revolved {
                    Form::Revolved
                } else {
                    Form::Extruded
                },
                length_mm: args.length,
                segments,
            }
        }
    };
    let mesh = shape.mesh()?;
    files::write(&args.out, &mesh)
        .map_err(CliError::from)
        .hint("choose an --out in a folder that exists and can be written")?;
    let [low, high] = mesh.bounds_mm();
    output::write_json(&serde_json::json!({
        "mesh": args.out.display().to_string(),
        "shape": shape,
        "vertices": mesh.positions_mm.len(),
        "triangles": mesh.triangles.len(),
        "low_mm": low.to_array(),
        "high_mm": high.to_array(),
        "facet_step_deg": mesh.facet_step_rad(0.5).to_degrees(),
    }))
}
