//! The scene file: camera, lights, sample, and what it is made of.

use std::path::Path;

use super::ConfigError;
use super::reader::Section;
use super::reflectance::BrdfSpec;
use super::view::{BodySpec, SampleSpec, take_bodies, take_camera};
use crate::bench_priors::BenchPriors;
use crate::transport::{Camera, Light};

/// A scene file, valid but with its meshes and tables still unread.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFile {
    /// The camera.
    pub camera: Camera,
    /// At least one; each gives an image.
    pub lights: Vec<Light>,
    /// The fitted surface.
    pub sample: SampleSpec,
    /// The sample's reflectance; a fit doesn't need it.
    pub brdf: Option<BrdfSpec>,
    /// Other things in view: holder, occluder, reference.
    pub bodies: Vec<BodySpec>,
    /// Whether it is rendered with polarised light.
    pub polarised: bool,
    /// How well all this is known.
    pub uncertainty: BenchPriors,
}

impl SceneFile {
    /// Reads a scene file; paths in it are relative to it.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = super::read_text(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Self::parse(&path.display().to_string(), folder, &text)
    }

    /// Reads a scene from text; `file` is what errors call it.
    pub fn parse(file: &str, folder: &Path, text: &str) -> Result<Self, ConfigError> {
        let mut root = Section::parse(file, folder, text)?;
        let mut camera = root.section("camera")?.required()?;
        let resolution_px = camera.resolution("resolution_px")?.required()?;
        let view = take_camera(&mut camera, resolution_px)?;
        camera.finish()?;
        let lights = root.sections("light")?.required()?;
        let brdf = root.section("brdf")?.optional();
        let mut render = root.section_or_empty("render")?;
        let polarised = render.flag("polarised")?.or(false);
        render.finish()?;
        let scene = Self {
            camera: view,
            polarised,
            lights: lights
                .into_iter()
                .map(read_light)
                .collect::<Result<_, _>>()?,
            sample: SampleSpec::read(root.section("sample")?.required()?)?,
            brdf: brdf.map(BrdfSpec::read).transpose()?,
            bodies: take_bodies(&mut root)?,
            uncertainty: super::uncertainty::read(root.section_or_empty("uncertainty")?)?,
        };
        root.finish()?;
        Ok(scene)
    }
}

fn read_light(mut table: Section) -> Result<Light, ConfigError> {
    let directional = table
        .choice("kind", &[("directional", true), ("point", false)])?
        .required()?;
    let light = if directional {
        let radius_deg = table.number("angular_radius_deg", 0.0..=45.0)?.or(0.0);
        Light::Directional {
            to_light: table.direction("to_light")?.required()?,
            irradiance: table.channels("irradiance", 0.0..=1e9)?.or([1.0; 3]),
            angular_radius_rad: radius_deg.to_radians(),
        }
    } else {
        Light::Point {
            position_mm: table.position("position_mm")?.required()?,
            intensity_mm2: table.channels("intensity", 0.0..=1e18)?.required()?,
        }
    };
    table.finish()?;
    Ok(light)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec2, DVec3};

    use crate::brdf::Atom;
    use crate::config::mesh::MeshSpec;
    use crate::config::view::SurfaceSpec;
    use crate::geometry::Shape;
    use crate::geometry::shapes::Form;
    use crate::transport::{Projection, Shading};

    const BOWL: &str = r#"
[camera]
model = "orthographic"
resolution_px = [64, 48]
extent_mm = [2.2, 1.65]
position_mm = [0.0, 0.0, 5.0]

[[light]]
kind = "directional"
to_light = [0.0, 3.0, 4.0]
irradiance = [1.0, 2.0, 3.0]

[[light]]
kind = "point"
position_mm = [0, 0, 300]
intensity = 9e4

[sample]
mesh = "meshes/bowl.ply"

[render]
polarised = true

[brdf]
mixture = [
  { weight = 0.6, lambertian = { albedo = 0.9 } },
  { weight = [0.1, 0.2, 0.3], ggx = { alpha = 0.15, eta = 1.5 } },
  { weight = [0.3, 0.2, 0.1], black = {} },
]

[[body]]
shape = { kind = "designed", radius_mm = 1.0, offset = 1.0, form = "extruded", length_mm = 6.0 }
shading = "smooth"
brdf = { table = "holder.binary" }
"#;

    fn parse(text: &str) -> Result<SceneFile, ConfigError> {
        SceneFile::parse("scene.toml", Path::new("/s"), text)
    }

    #[test]
    fn everything_is_read() {
        let scene = parse(BOWL).unwrap();
        assert_eq!(scene.camera.resolution_px, [64, 48]);
        assert!(scene.polarised);
        let extent_mm = DVec2::new(2.2, 1.65);
        assert_eq!(
            scene.camera.projection,
            Projection::Orthographic { extent_mm }
        );
        let Light::Directional {
            to_light,
            irradiance,
            ..
        } = scene.lights[0]
        else {
            panic!("{:?}", scene.lights[0]);
        };
        assert!((to_light - DVec3::new(0.0, 0.6, 0.8)).length() < 1e-12);
        assert_eq!(irradiance, [1.0, 2.0, 3.0]);
        assert_eq!(
            scene.lights[1],
            Light::Point {
                position_mm: DVec3::new(0.0, 0.0, 300.0),
                intensity_mm2: [9e4; 3]
            }
        );
        assert_eq!(
            scene.sample.surface,
            SurfaceSpec::Mesh(MeshSpec::of("/s/meshes/bowl.ply".into()))
        );
        let Some(BrdfSpec::Mixture(atoms)) = scene.brdf else {
            panic!("a mixture was given");
        };
        assert_eq!(
            atoms[1].atom,
            Atom::Ggx {
                alpha: 0.15,
                eta: 1.5
            }
        );
        assert_eq!(scene.bodies[0].shading, Shading::Smooth);
        assert_eq!(
            scene.bodies[0].surface,
            SurfaceSpec::Shape(Shape::Designed {
                radius_mm: 1.0,
                offset: 1.0,
                phi_min_deg: 45.0,
                form: Form::Extruded,
                length_mm: 6.0,
                segments: 128
            })
        );
        assert_eq!(
            scene.bodies[0].brdf,
            BrdfSpec::Table("/s/holder.binary".into())
        );
    }

    #[test]
    fn bad_scenes_are_refused_with_the_place() {
        const CASES: &[(&str, &str, &str)] = &[
            (
                "weight = 0.6",
                "weight = 0.5",
                "scene.toml:25: `brdf.mixture` is a mixture whose weights sum to 0.900000",
            ),
            (
                "albedo = 0.9",
                "albedo = 1.2",
                "`brdf.mixture[0].lambertian.albedo` is 1.2",
            ),
            (
                "position_mm = [0.0, 0.0, 5.0]",
                "position_mm = [0.0, 5.0, 0.0]",
                "`camera.up`",
            ),
            (
                "[sample]\n",
                "[sample]\nshape = { kind = \"sphere\" }\n",
                "`sample.mesh` is /s/meshes/bowl.ply, but must be absent",
            ),
            (
                "kind = \"point\"",
                "kind = \"spot\"",
                "`light[1].kind` is \"spot\", but must be \"directional\" or \"point\"",
            ),
            (
                "length_mm = 6.0",
                "length_m = 6.0",
                "`body[0].shape.length_mm` is missing",
            ),
            (
                "table = \"holder.binary\"",
                "",
                "`body[0].brdf.mixture` is missing",
            ),
            (
                "polarised = true",
                "polarised = 1",
                "`render.polarised` is 1",
            ),
            (
                "irradiance =",
                "iradiance =",
                "scene.toml:11: unknown key `light[0].iradiance`",
            ),
        ];
        for (good, bad, expected) in CASES {
            assert!(BOWL.contains(good), "{good}");
            let error = parse(&BOWL.replacen(good, bad, 1)).unwrap_err().to_string();
            assert!(error.contains(expected), "{bad}: {error}");
        }
    }
}
