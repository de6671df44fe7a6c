//! `rig shape`: sample shapes as meshes, and the content of mesh files.

use std::path::PathBuf;

use super::number::within;
use super::{CliError, Context, output, shape_inspect};
use crate::geometry::shapes::{Form, Profile};
use crate::geometry::{Mesh, Shape, files};

/// Writes the mesh of a sample shape and prints its figures as JSON, or describes a mesh file.
#[derive(clap::Args, Debug)]
pub struct ShapeArgs {
    /// Which shape
    #[arg(value_enum, required_unless_present = "inspect")]
    kind: Option<Kind>,
    /// Describes a mesh file instead: size, openings, rim and axis, and the lines of a
    /// rig or scene file that place it
    #[arg(long, value_name = "FILE", conflicts_with_all = ["kind", "out"])]
    inspect: Option<PathBuf>,
    /// What --inspect finds, as JSON
    #[arg(long, requires = "inspect")]
    json: bool,
    /// Radius, mm, 0.001 to 10000: of the sphere, of the base's corners, of the convex arc, of the groove's middle, of the ridge's rim
    #[arg(long, value_name = "MM", default_value_t = 10.0, value_parser = within(1e-3f32, 1e4))]
    radius: f32,
    /// Depth, mm: of a corner below its rim, -10000 to 10000, negative for a convex one (tetrahedron; default 7.071); of a V groove, 0.001 to 10000 (default: half the width, which makes it right-angled)
    #[arg(long, value_name = "MM", allow_negative_numbers = true, value_parser = within(-1e4f32, 1e4))]
    depth: Option<f32>,
    /// The profile's constant in radii, 0 to 2 (designed)
    #[arg(long, value_name = "C", default_value_t = 0.5, value_parser = within(0.0f32, 2.0))]
    offset: f32,
    /// Where the designed arc's partner on the wall ends, degrees, 30 to 60 (designed)
    #[arg(long, value_name = "DEG", default_value_t = 45.0, value_parser = within(30.0f32, 60.0))]
    phi_min: f32,
    /// Angle from the axis to the rim, seen from the sphere's centre, degrees, 5 to 170 (cap)
    #[arg(long, value_name = "DEG", default_value_t = 90.0, value_parser = within(5.0f32, 170.0))]
    opening: f32,
    /// Revolved about z instead of extruded along y (designed)
    #[arg(long)]
    revolved: bool,
    /// Extruded along y instead of revolved about z (ridge)
    #[arg(long)]
    extruded: bool,
    /// Length along y, mm, 0.001 to 10000 (designed and ridge, extruded)
    #[arg(long, value_name = "MM", default_value_t = 30.0, value_parser = within(1e-3f32, 1e4))]
    length: f32,
    /// Width between the rims, mm, 0.001 to less than twice the radius (groove)
    #[arg(long, value_name = "MM", default_value_t = 6.0, value_parser = within(1e-3f32, 1e4))]
    width: f32,
    /// Section of the groove
    #[arg(long, value_enum, default_value_t = ProfileArg::Round)]
    profile: ProfileArg,
    /// Facets around, 8 to 4096, a multiple of 4
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = segments)]
    segments: u32,
    /// Mesh to write, millimetres: .ply, .obj or .stl
    #[arg(long, value_name = "FILE", required_unless_present = "inspect")]
    out: Option<PathBuf>,
}

#[derive(clap::ValueEnum, Debug, Clone, Copy)]
enum Kind {
    /// The inside of a hemisphere
    Bowl,
    /// A whole sphere
    Sphere,
    /// The upper part of a sphere, half of it without --opening
    Cap,
    /// Three facets that meet in a point: the corner of a room, or a pyramid
    Tetrahedron,
    /// An arc and a wall that send coaxial light back after two mirror reflections
    Designed,
    /// A groove around the axis, as a lathe cuts it
    Groove,
    /// A convex ridge within a concave moat, for a tilted camera
    Ridge,
}

#[derive(clap::ValueEnum, Debug, Clone, Copy)]
enum ProfileArg {
    /// A half circle
    Round,
    /// Two straight flanks
    Vee,
}

fn segments(text: &str) -> Result<u32, String> {
    match text.parse() {
        Ok(number @ 8u32..=4096) if number.is_multiple_of(4) => Ok(number),
        _ => Err("not a multiple of 4 in 8 to 4096".to_owned()),
    }
}

impl ShapeArgs {
    fn shape(&self, kind: Kind) -> Result<Shape, CliError> {
        let (radius_mm, segments) = (self.radius, self.segments);
        Ok(match kind {
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
                opening_deg: self.opening,
                segments,
            },
            Kind::Tetrahedron => Shape::Tetrahedron {
                radius_mm,
                depth_mm: self.depth.unwrap_or(7.071),
            },
            Kind::Designed => Shape::Designed {
                radius_mm,
                offset: self.offset,
                phi_min_deg: self.phi_min,
                form: if self.revolved {
                    Form::Revolved
                } else {
                    Form::Extruded
                },
                length_mm: self.length,
                segments,
            },
            Kind::Ridge => Shape::Ridge {
                radius_mm,
                form: if self.extruded {
                    Form::Extruded
                } else {
                    Form::Revolved
                },
                length_mm: self.length,
                segments,
            },
            Kind::Groove => Shape::Groove {
                radius_mm,
                width_mm: self.groove_width()?,
                profile: match self.profile {
                    ProfileArg::Round => Profile::Round,
                    ProfileArg::Vee => Profile::Vee {
                        depth_mm: self.groove_depth()?,
                    },
                },
                segments,
            },
        })
    }

    fn groove_width(&self) -> Result<f32, CliError> {
        if self.width < 2.0 * self.radius {
            return Ok(self.width);
        }
        Err(CliError::new(format!(
            "--width is {}, allowed is less than twice --radius, {}",
            self.width,
            2.0 * self.radius
        )))
    }

    fn groove_depth(&self) -> Result<f32, CliError> {
        match self.depth {
            None => Ok(0.5 * self.width),
            Some(depth) if depth >= 1e-3 => Ok(depth),
            Some(depth) => Err(CliError::new(format!(
                "--depth is {depth}, allowed for a groove are 0.001 to 10000"
            ))),
        }
    }
}

/// `rig shape`.
pub fn run(args: &ShapeArgs, context: &Context) -> Result<(), CliError> {
    let (kind, out) = match (&args.inspect, args.kind, &args.out) {
        (Some(file), _, _) => return shape_inspect::run(file, args.json, context),
        (None, Some(kind), Some(out)) => (kind, out),
        _ => {
            return Err(CliError::new(
                "neither a shape with --out nor --inspect is given",
            ));
        }
    };
    let shape = args.shape(kind)?;
    let mesh = shape.mesh()?;
    files::write(out, &mesh)?;
    let [low, high] = mesh.bounds_mm();
    let mut figures = serde_json::json!({
        "mesh": out.display().to_string(),
        "shape": shape,
        "vertices": mesh.positions_mm.len(),
        "triangles": mesh.triangles.len(),
        "low_mm": low.to_array(),
        "high_mm": high.to_array(),
        "facet_step_deg": mesh.facet_step_rad(Mesh::CREASE_RAD).to_degrees(),
    });
    if let Some(check) = shape.mirror_check(&mesh) {
        figures["mirror_check"] = serde_json::json!(check);
    }
    output::write_json(&figures)
}
