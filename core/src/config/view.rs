//! What rig files and scene files say in the same words: where the camera
//! stands, and what lies in front of it.

use std::sync::Arc;

use glam::{DVec2, DVec3};

use super::ConfigError;
use super::mesh::MeshSpec;
use super::reader::Section;
use super::reflectance::BrdfSpec;
use super::shape::read_shape;
use crate::geometry::files::MeshFormat;
use crate::geometry::placement::Placement;
use crate::geometry::{FormError, Mesh, Shape};
use crate::transport::{Camera, CameraBody, Coefficients, LensSpec, Projection, Shading};

/// Takes the camera's place and lens out of a table that may have other keys;
/// the pixel grid is the caller's. A lens with an aperture is sharp at the
/// point it looks at unless `focus_mm` says otherwise.
pub fn take_camera(table: &mut Section, resolution_px: [u32; 2]) -> Result<Camera, ConfigError> {
    let orthographic = table
        .choice("model", &[("orthographic", true), ("perspective", false)])?
        .required()?;
    let projection = if orthographic {
        let extent_mm = table.numbers("extent_mm", 1e-3..=1e4)?.required()?;
        Projection::Orthographic {
            extent_mm: DVec2::from_array(extent_mm),
        }
    } else {
        let fov_deg = table.number("fov_deg", 0.1..=170.0)?.required()?;
        Projection::Perspective {
            fov_rad: fov_deg.to_radians(),
        }
    };
    let position_mm = table.position("position_mm")?.required()?;
    let look_at_mm = table.position("look_at_mm")?.or(DVec3::ZERO);
    let up = table.direction("up")?.or(DVec3::Y);
    let object_na = table.number("object_na", 0.0..=0.95)?.or(0.0);
    let lens = take_lens(table, resolution_px)?;
    let focus_mm = table.number("focus_mm", 1e-3..=1e5)?.optional();
    let point_spread_px = table.number("point_spread_px", 0.0..=20.0)?.or(0.0);
    let resolution_px = resolution_px.map(|side| side as usize);
    let camera = Camera::looking_at(resolution_px, projection, position_mm, look_at_mm, up);
    let mut camera = camera.ok_or_else(|| {
        let allowed = "across the view, with look_at_mm away from position_mm";
        table.conflict("up", up, allowed)
    })?;
    camera.object_na = object_na;
    camera.focus_mm = focus_mm.unwrap_or(camera.focus_mm);
    camera.point_spread_px = point_spread_px;
    match lens {
        Some(lens) => with_lens(camera, lens, table, "radial"),
        None => Ok(camera),
    }
}

/// Takes `body`, the camera's housing and lens; `None` where nothing is said of them. Its
/// front must lie before what is in focus.
pub fn take_camera_body(
    table: &mut Section,
    camera: &Camera,
) -> Result<Option<CameraBody>, ConfigError> {
    let Some(mut body) = table.section("body")?.optional() else {
        return Ok(None);
    };
    let stated = CameraBody {
        radius_mm: body.number("radius_mm", 0.5..=1e3)?.required()?,
        length_mm: body.number("length_mm", 0.5..=1e4)?.required()?,
        front_mm: body.number("front_mm", -1e3..=1e3)?.or(0.0),
    };
    let focus_mm = camera.focus_mm;
    if stated.front_mm >= focus_mm {
        let allowed = format!("below {focus_mm:.1}, the distance at which the image is sharp");
        return Err(body.conflict("front_mm", stated.front_mm, &allowed));
    }
    body.finish()?;
    Ok(Some(stated))
}

/// Takes how the lens departs from an ideal one in front of the middle of an image of this
/// many pixels; `None` where nothing is said of that.
pub fn take_lens(
    table: &mut Section,
    resolution_px: [u32; 2],
) -> Result<Option<LensSpec>, ConfigError> {
    let [width, height] = resolution_px.map(f64::from);
    let principal_point_px = table.numbers("principal_point_px", 0.0..=1e5)?.optional();
    let aspect = table.number("pixel_aspect", 0.5..=2.0)?.optional();
    let opencv = table
        .listed("radial")
        .and_then(|list| in_opencvs_order(&list));
    let radial = table.numbers("radial", -1e6..=1e6);
    let radial = match (radial, opencv) {
        (Err(_), Some((list, allowed))) => return Err(table.conflict("radial", list, &allowed)),
        (radial, _) => radial?.optional(),
    };
    let tangential = table.numbers("tangential", -1e3..=1e3)?.optional();
    if (principal_point_px, aspect, radial, tangential) == (None, None, None, None) {
        return Ok(None);
    }
    let principal_offset = match principal_point_px {
        Some([x, y]) if x <= width && y <= height => DVec2::new(x / width - 0.5, y / height - 0.5),
        Some([x, y]) => {
            let allowed = "within the image";
            return Err(table.conflict("principal_point_px", format!("[{x}, {y}]"), allowed));
        }
        None => DVec2::ZERO,
    };
    Ok(Some(LensSpec {
        principal_offset,
        aspect: aspect.unwrap_or(1.0),
        distortion: Coefficients {
            radial: radial.unwrap_or_default(),
            tangential: tangential.unwrap_or_default(),
        },
    }))
}

/// OpenCV's coefficients in the place of radial ones, as a file has them, and what belongs
/// there.
fn in_opencvs_order(list: &[f64]) -> Option<(String, String)> {
    let &[k1, k2, p1, p2, ref rest @ ..] = list else {
        return None;
    };
    let k3 = rest.first().unwrap_or(&0.0);
    let order =
        "a list of 3, k1, k2, k3; OpenCV's coefficients stand in the order k1, k2, p1, p2, k3";
    let further = match rest.iter().skip(1).any(|k| *k != 0.0) {
        true => "; those after k3 have no place here: calibrate with these five".to_owned(),
        false => {
            format!(", which is radial = [{k1}, {k2}, {k3}] and tangential = [{p1}, {p2}] here")
        }
    };
    Some((format!("{list:?}"), format!("{order}{further}")))
}

/// The camera with this lens, stated under `key`.
pub fn with_lens(
    camera: Camera,
    lens: LensSpec,
    table: &Section,
    key: &str,
) -> Result<Camera, ConfigError> {
    camera.with_lens(lens).map_err(|folded| {
        let value = format!("{:?}", lens.distortion.radial);
        table.conflict(key, value, &format!("another distortion: {folded}"))
    })
}

/// A surface, from a file or by its parameters.
#[derive(Clone, Debug, PartialEq)]
pub enum SurfaceSpec {
    /// A mesh file.
    Mesh(MeshSpec),
    /// A shape by its parameters.
    Shape(Shape),
    /// A mesh that a program has made; no file names it.
    Made(Arc<Mesh>),
}

impl SurfaceSpec {
    /// Takes `mesh` with what says how it is to be taken, `shape` or `obj`, and `shading`.
    pub fn take(table: &mut Section) -> Result<(Self, Shading), ConfigError> {
        let surface = Self::take_alone(table)?;
        let shading = take_shading(table)?;
        match &surface {
            Self::Mesh(MeshSpec {
                crease_deg: Some(crease_deg),
                ..
            }) if shading == Shading::Flat => {
                let allowed = "absent where shading is not \"smooth\"";
                Err(table.conflict("crease_deg", crease_deg, allowed))
            }
            _ => Ok((surface, shading)),
        }
    }

    fn take_alone(table: &mut Section) -> Result<Self, ConfigError> {
        let mesh = table.path("mesh")?.optional();
        let shape = table.section("shape")?.optional();
        let obj = table.parsed("obj", "a mesh as Wavefront OBJ text, millimetres", made)?;
        if let Some(made) = obj.optional() {
            return match mesh.is_some() || shape.is_some() {
                true => Err(table.conflict("obj", "given", "absent where `mesh` or `shape` is")),
                false => Ok(made),
            };
        }
        match (mesh, shape) {
            (Some(mesh), None) => Ok(Self::Mesh(MeshSpec::take(mesh, table)?)),
            (None, Some(shape)) => Ok(Self::Shape(read_shape(shape)?)),
            (Some(mesh), Some(_)) => {
                Err(table.conflict("mesh", mesh.display(), "absent where `shape` is given"))
            }
            (None, None) => Err(table.missing("mesh", "a mesh file, or `shape` a table")),
        }
    }
}

fn made(obj: &str) -> Option<SurfaceSpec> {
    let mesh = MeshFormat::Obj.parse(obj.as_bytes(), &Placement::default());
    Some(SurfaceSpec::Made(Arc::new(mesh.ok()?)))
}

/// The sample under the camera, in its own frame.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleSpec {
    /// Its surface.
    pub surface: SurfaceSpec,
    /// Which normals shade.
    pub shading: Shading,
    /// How far the sample as made departs from that surface; `None`: not stated.
    pub form_error: Option<FormError>,
}

impl SampleSpec {
    /// Reads the `[sample]` table.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        let (surface, shading) = SurfaceSpec::take(&mut table)?;
        let sample = Self {
            surface,
            shading,
            form_error: take_form_error(&mut table)?,
        };
        table.finish()?;
        Ok(sample)
    }
}

/// A thing in view that is not fitted: holder, occluder, reference.
#[derive(Clone, Debug, PartialEq)]
pub struct BodySpec {
    /// Its surface, in the sample's frame.
    pub surface: SurfaceSpec,
    /// Which normals shade.
    pub shading: Shading,
    /// Its reflectance.
    pub brdf: BrdfSpec,
}

impl BodySpec {
    fn read(mut table: Section) -> Result<Self, ConfigError> {
        let brdf = BrdfSpec::read(table.section("brdf")?.required()?)?;
        let (surface, shading) = SurfaceSpec::take(&mut table)?;
        let body = Self {
            surface,
            shading,
            brdf,
        };
        table.finish()?;
        Ok(body)
    }
}

/// Takes the `[[body]]` tables, if any.
pub fn take_bodies(table: &mut Section) -> Result<Vec<BodySpec>, ConfigError> {
    let bodies = table.sections("body")?.optional().unwrap_or_default();
    bodies.into_iter().map(BodySpec::read).collect()
}

/// Takes `shading`, flat if absent.
pub fn take_shading(table: &mut Section) -> Result<Shading, ConfigError> {
    let known = [("flat", Shading::Flat), ("smooth", Shading::Smooth)];
    Ok(table.choice("shading", &known)?.or(Shading::Flat))
}

/// Takes `form_error_mm` and `slope_error_deg`, which determine each other's scale: one
/// alone says too little.
fn take_form_error(table: &mut Section) -> Result<Option<FormError>, ConfigError> {
    let height_mm = table.number("form_error_mm", 0.0..=10.0)?.optional();
    let slope_deg = table.number("slope_error_deg", 0.0..=20.0)?.optional();
    let (height_mm, slope_deg) = (height_mm.unwrap_or(0.0), slope_deg.unwrap_or(0.0));
    if (height_mm > 0.0) == (slope_deg > 0.0) {
        return Ok(FormError::new(height_mm, slope_deg.to_radians()));
    }
    let allowed = "above 0 exactly where `slope_error_deg` is";
    Err(table.conflict("form_error_mm", height_mm, allowed))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn sample(keys: &str) -> Result<SampleSpec, ConfigError> {
        let text = format!("mesh = \"scan.ply\"\n{keys}");
        SampleSpec::read(Section::parse("rig.toml", Path::new(""), &text)?)
    }

    #[test]
    fn coefficients_in_opencvs_order_are_told_apart() {
        for (list, said) in [
            (
                "[-0.1, 0.02, 0.001, -0.0005, 0.003]",
                "radial = [-0.1, 0.02, 0.003] and tangential = [0.001, -0.0005]",
            ),
            (
                "[-1, 0.02, 0.001, 0.0]",
                "radial = [-1, 0.02, 0] and tangential = [0.001, 0]",
            ),
            ("[1, 2, 3, 4, 5, 0, 0, 0]", "radial = [1, 2, 5]"),
            ("[1, 2, 3, 4, 5, 6, 7, 8]", "those after k3 have no place"),
            ("[1, 2]", "must be a list of 3, each"),
        ] {
            let text = format!("radial = {list}");
            let mut table = Section::parse("rig.toml", Path::new(""), &text).unwrap();
            let error = take_lens(&mut table, [64, 64]).unwrap_err().to_string();
            assert!(
                error.starts_with("rig.toml:1: `radial` is [") && error.contains(said),
                "{error}"
            );
        }
    }

    #[test]
    fn a_mesh_says_how_it_is_taken() {
        let spec = |keys: &str| match sample(keys)?.surface {
            SurfaceSpec::Mesh(spec) => Ok::<_, ConfigError>(spec),
            SurfaceSpec::Shape(_) | SurfaceSpec::Made(_) => unreachable!(),
        };
        let plain = spec("").unwrap();
        assert_eq!(plain, MeshSpec::of("scan.ply".into()));
        let keys = "mesh_unit = \"in\"\nflip_facets = true\nshading = \"smooth\"\ncrease_deg = 40\n\
                    mesh_to_sample = { rotate_deg = [90, 0, 90], translate_mm = [1, 2, 3] }";
        let placed = spec(keys).unwrap();
        assert_eq!(placed.placement.mm_per_unit, 25.4);
        assert!(placed.placement.flip_facets);
        assert_eq!(placed.crease_deg, Some(40.0));
        // About x, y becomes z; about z that stays; then it is moved.
        let moved = placed.placement.sample_from_mesh.point(DVec3::Y);
        assert!(
            (moved - DVec3::new(1.0, 2.0, 4.0)).length() < 1e-12,
            "{moved}"
        );
        for (wrong, expected) in [
            ("mesh_unit = \"metre\"", "`mesh_unit`"),
            ("crease_deg = 40", "absent where shading is not \"smooth\""),
            ("mesh_to_sample = { rotate = [1, 2, 3] }", "rotate"),
        ] {
            let error = spec(wrong).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn a_form_error_has_height_and_slope() {
        let stated = sample("form_error_mm = 0.02\nslope_error_deg = 0.5").unwrap();
        let error = stated.form_error.unwrap();
        assert_eq!(error.height_mm(), 0.02);
        assert!((error.slope_rad() - 0.5f64.to_radians()).abs() < 1e-15);
        for none in [
            "",
            "form_error_mm = 0",
            "form_error_mm = 0.0\nslope_error_deg = 0.0",
        ] {
            assert_eq!(sample(none).unwrap().form_error, None, "{none}");
        }
        for half in ["form_error_mm = 0.02", "slope_error_deg = 0.5"] {
            let error = sample(half).unwrap_err().to_string();
            assert!(
                error.contains("exactly where `slope_error_deg` is"),
                "{error}"
            );
        }
        let error = sample("form_error_mm = -1.0").unwrap_err().to_string();
        assert!(
            error.contains("rig.toml:2: `form_error_mm` is -1"),
            "{error}"
        );
    }
}
