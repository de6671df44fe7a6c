//! Which bench for which sample: shape, tilt of the camera and lights together, from one, two
//! and four images.
//!
//! A convex sample has no interreflection. Each concave one stands next to its twin whose
//! indirect light is removed from the truth and the fit alike, so that what the geometry of
//! direct light gains is not taken for a gain of interreflection; and next to an outside method
//! on the very same images, which takes all light as reflected once.

use std::sync::{Arc, OnceLock};

use glam::{DVec2, DVec3};

use super::baseline::{LEAST_COSINE, Pair, Training, linear, table_shape};
use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table, doublings};
use super::lab::samples::{BELIEVED_SEGMENTS, TRUE_SEGMENTS, directional};
use super::lab::{Lab, Material};
use super::shown_angles::figure;
use crate::brdf::Dictionary;
use crate::design::profile::HEIGHTS;
use crate::design::{Limits, Profile};
use crate::geometry::shapes::Form;
use crate::geometry::{Mesh, MeshError, Shape};
use crate::inverse::FitOptions;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};
use crate::radiance_image::RadianceImage;
use crate::transport::{Camera, Light, Projection, RenderOptions, Scene, Shading, render};

/// Errors of all designs.
pub static DESIGNS: Experiment = Experiment {
    name: "designs",
    shows: "environment error from one, two and four images of a bowl under a camera on its axis, of a ridge and a cap before a tilted camera, of the two shipped designs, and of a ball with lamps behind it; concave ones with their twins without indirect light, and the method of Nielsen et al. on the same images",
    full: Scale {
        materials: &["bundled"],
        samples_per_pixel: 256,
        truth_samples_per_pixel: 1024,
        lights: 4,
        dictionary: Dictionary::DEFAULT,
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        materials: &["nbrdf:green-latex"],
        samples_per_pixel: 16,
        truth_samples_per_pixel: 64,
        lights: 4,
        dictionary: "rig26",
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

/// A sample with its camera and lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Design {
    Bowl,
    Ridge,
    Cap,
    Ball,
    /// The shipped design to be turned, for four images.
    Turned,
    /// The shipped design for sheets, for two images.
    Sheet,
}

/// Heights of the shipped designs' profiles before the rim, in units of the radius
/// (docs/designs).
const TURNED: [f64; HEIGHTS] = [
    -0.028_063_309_225_953_514,
    0.002_565_831_053_082_31,
    0.056_785_045_080_478_38,
    0.064_477_615_956_536_57,
    -0.045_009_534_690_689_74,
];
const SHEET: [f64; HEIGHTS] = [
    -0.111_975_052_598_631_3,
    -0.045_542_718_836_021_97,
    0.078_348_909_802_909_04,
    0.091_926_475_310_806_51,
    0.022_878_704_264_062_327,
];

/// A shipped design, as large as the others.
fn shipped(heights: &[f64; HEIGHTS], form: Form, segments: u32) -> Result<Mesh, MeshError> {
    let limits = Limits {
        form,
        radius_mm: 1.0,
        ..Limits::default()
    };
    Profile::through(heights).mesh(&limits, segments)
}

/// Pairs of an angle from the sample's axis and an azimuth, degrees.
type Lamps = &'static [(f64, f64)];

impl Design {
    const ALL: [Self; 6] = [
        Self::Bowl,
        Self::Ridge,
        Self::Cap,
        Self::Ball,
        Self::Turned,
        Self::Sheet,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Bowl => "bowl",
            Self::Ridge => "ridge",
            Self::Cap => "cap",
            Self::Ball => "ball",
            Self::Turned => "turned",
            Self::Sheet => "sheet",
        }
    }

    fn is_concave(self) -> bool {
        !matches!(self, Self::Cap | Self::Ball)
    }

    /// The numbers of images that it is for.
    fn images(self) -> &'static [usize] {
        match self {
            Self::Turned => &[4],
            Self::Sheet => &[2],
            _ => &IMAGES,
        }
    }

    /// About 2 mm wide, with `segments` facets around.
    fn mesh(self, segments: u32) -> Result<Mesh, MeshError> {
        let radius_mm = 1.0;
        let shape = match self {
            Self::Turned => return shipped(&TURNED, Form::Revolved, segments),
            Self::Sheet => return shipped(&SHEET, Form::Extruded, segments),
            Self::Bowl => Shape::Bowl {
                radius_mm,
                segments,
            },
            Self::Ridge => Shape::Ridge {
                radius_mm,
                form: Form::Revolved,
                length_mm: 0.0,
                segments,
            },
            Self::Cap => Shape::Cap {
                radius_mm: 60f32.to_radians().sin().recip(),
                opening_deg: 60.0,
                segments,
            },
            Self::Ball => Shape::Sphere {
                radius_mm,
                segments,
            },
        };
        shape.mesh()
    }

    /// Angle of the camera from the sample's axis, degrees, at azimuth 180°.
    fn tilt_deg(self) -> f64 {
        match self {
            Self::Bowl | Self::Ball => 0.0,
            Self::Ridge => 54.46,
            Self::Cap => 60.0,
            Self::Turned => 59.055_905,
            Self::Sheet => 39.720_971,
        }
    }

    /// The lamps of one, two or four images. One lamp in front of bowl or cap stands 45° from
    /// the camera; those of the ridge come from the search that found its profile.
    fn lamps(self, images: usize) -> Lamps {
        match (self, images) {
            (Self::Bowl, 1) => &[(45.0, 20.0)],
            (Self::Bowl, 2) => &[(45.0, 0.0), (45.0, 180.0)],
            (Self::Bowl, _) => &[(0.0, 0.0), (41.41, 137.5), (28.96, 275.0), (51.32, 52.5)],
            (Self::Ridge, 1) => &[(46.0, 101.1)],
            (Self::Ridge, 2) => &[(75.0, -18.8), (29.9, 23.8)],
            (Self::Ridge, _) => &[(46.0, 101.1), (75.0, -18.8), (31.3, -37.2), (29.9, 23.8)],
            (Self::Cap, 1) => &[(15.0, 180.0)],
            (Self::Cap, 2) => &[(75.0, 0.0), (20.0, 90.0)],
            (Self::Cap, _) => &[(75.0, 0.0), (40.0, 20.0), (10.0, 0.0), (60.0, 100.0)],
            (Self::Ball, 1) => &[(100.0, 0.0)],
            (Self::Ball, 2) => &[(75.0, 0.0), (135.0, 137.5)],
            (Self::Turned, _) => &[(30.0, 60.0), (60.0, 0.0), (30.0, 120.0), (75.0, 0.0)],
            (Self::Sheet, _) => &[(45.0, 0.0), (30.0, 30.0)],
            (Self::Ball, _) => &[(30.0, 0.0), (90.0, 137.5), (120.0, 275.0), (145.0, 52.5)],
        }
    }

    fn camera(self, resolution_px: usize) -> Result<Camera, EvaluateError> {
        let middle_mm = match self {
            // Half of its height of 1 / sin 60° - cot 60°.
            Self::Cap => 0.29 * DVec3::Z,
            _ => DVec3::ZERO,
        };
        let (sin, cos) = self.tilt_deg().to_radians().sin_cos();
        let up = if sin > 0.0 { DVec3::Z } else { DVec3::Y };
        let extent_mm = DVec2::splat(2.2);
        Camera::looking_at(
            [resolution_px; 2],
            Projection::Orthographic { extent_mm },
            middle_mm + 8.0 * DVec3::new(-sin, 0.0, cos),
            middle_mm,
            up,
        )
        .ok_or_else(|| EvaluateError::Fact("the camera's pose is singular".to_owned()))
    }

    /// The scene with one, two or four images' lamps.
    pub(super) fn scene(
        self,
        images: usize,
        resolution_px: usize,
        segments: u32,
    ) -> Result<Scene, EvaluateError> {
        let lights: Vec<Light> = self
            .lamps(images)
            .iter()
            .map(|&(polar_deg, azimuth_deg)| directional(polar_deg, azimuth_deg))
            .collect();
        let mesh = self.mesh(segments)?;
        let camera = self.camera(resolution_px)?;
        Ok(Scene::new(mesh, Shading::Smooth, camera, lights))
    }
}

/// Numbers of images.
const IMAGES: [usize; 3] = [1, 2, 4];

/// What is measured: a design from so many images, with or without indirect light.
#[derive(Clone, Copy, Debug)]
struct Variant {
    design: Design,
    images: usize,
    indirect: bool,
}

impl Variant {
    fn name(self) -> String {
        let Self { design, images, .. } = self;
        let twin = if self.indirect { "" } else { "/direct" };
        format!("{}/{images}{twin}", design.name())
    }
}

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let training = Arc::new(OnceLock::new());
    let mut cases = Vec::new();
    for material in &lab.materials {
        for design in Design::ALL {
            let counts = design.images().iter().copied();
            for images in counts.filter(|&n| n <= lab.settings.lights) {
                for indirect in [true, false] {
                    let is_last = images == lab.settings.lights;
                    let has_twin = design.is_concave() && (is_last || !lab.settings.quick);
                    if !indirect && !has_twin {
                        continue;
                    }
                    let variant = Variant {
                        design,
                        images,
                        indirect,
                    };
                    let (training, material) = (training.clone(), material.clone());
                    let key = format!("{}/{}", material.name, variant.name());
                    cases.push(Case::new(key, move |lab: &Lab| {
                        one(lab, &training, &material, variant)
                    }));
                }
            }
        }
    }
    Ok(cases)
}

fn one(
    lab: &Lab,
    training: &OnceLock<Training>,
    material: &Material,
    variant: Variant,
) -> Result<Vec<Row>, EvaluateError> {
    let Variant {
        design,
        images,
        indirect,
    } = variant;
    let size = lab.settings.resolution_px;
    let longest = if indirect {
        lab.settings.max_reflections
    } else {
        1
    };

    // The truth, and the fit to it.
    let truth = design.scene(images, size, TRUE_SEGMENTS)?;
    let options = RenderOptions {
        max_reflections: longest,
        ..lab.truth_options(&truth, &*material.brdf)
    };
    let captured = render(&truth, &*material.brdf, &options);
    let believed = design.scene(images, size, BELIEVED_SEGMENTS)?;
    let mut options: FitOptions = lab.fit_options_for(material);
    options.cache.max_reflections = longest;
    let estimate = lab.fit_with(&believed, &captured, &lab.dictionary, &options)?;
    let mut row = Row::new()
        .with("material", material.name.as_str())
        .with("class", material.class.name())
        .with("design", design.name())
        .with("images", images)
        .with("indirect_light", if indirect { "yes" } else { "no" })
        .with("lights_deg", shown(design, images))
        .with("reduced_chi2", estimate.mean_reduced_chi2())
        .and(lab.score_row(&estimate.fit.material, material)?);

    // The outside method on the same images.
    let (pairs, values) = reflected_once(&believed, &captured);
    let linear_error = match pairs.is_empty() {
        true => None,
        false => {
            let shape = table_shape(lab);
            let training = training.get_or_init(|| Training::embedded(shape));
            let found = linear(training, material, &pairs, &values)?;
            Some(lab.score(&found, &*material.brdf).environment)
        }
    };
    row = row
        .with("observations", pairs.len())
        .with("environment_error_nielsen", linear_error);
    Ok(vec![row])
}

/// Angles between lights and camera.
fn shown(design: Design, images: usize) -> String {
    let (sin, cos) = design.tilt_deg().to_radians().sin_cos();
    let to_camera = DVec3::new(-sin, 0.0, cos);
    let angle = |&(polar_deg, azimuth_deg): &(f64, f64)| {
        let (s, c) = polar_deg.to_radians().sin_cos();
        let (y, x) = azimuth_deg.to_radians().sin_cos();
        let off = to_camera.angle_between(DVec3::new(s * x, s * y, c));
        format!("{:.0}", off.to_degrees())
    };
    let all: Vec<String> = design.lamps(images).iter().map(angle).collect();
    all.join(" ")
}

/// f at every pixel's pair of directions, as if all of its light were reflected once, where both
/// are within 80° of the normal and nothing hides the lamp.
fn reflected_once(scene: &Scene, images: &[RadianceImage]) -> (Vec<Pair>, Vec<[f64; 3]>) {
    let [width, height] = scene.camera.resolution_px;
    let (mut pairs, mut values) = (Vec::new(), Vec::new());
    for pixel in 0..width * height {
        let at = DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
        let Some((surface, to_viewer)) = scene.first(&scene.camera.ray(at, DVec2::ZERO)) else {
            continue;
        };
        for (light, image) in images.iter().enumerate() {
            let Some(connection) = scene.connect(&surface, light, [0.5; 2]) else {
                continue;
            };
            if connection.to_light.z <= LEAST_COSINE
                || to_viewer.z <= LEAST_COSINE
                || !image.valid[pixel]
            {
                continue;
            }
            let strength = scene.lights[light].strength();
            let irradiance = f64::from(connection.irradiance);
            let of = |c: usize| f64::from(image.mean[pixel][c]) / (irradiance * strength[c]);
            pairs.push((connection.to_light, to_viewer));
            values.push(std::array::from_fn(|c| of(c).max(0.0)));
        }
    }
    (pairs, values)
}

/// Geometric means over the materials against the number of images; twins dashed.
fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let images = table.numbers("images");
    let mut series = Vec::new();
    let mut all = Vec::new();
    for (color, design) in Design::ALL.into_iter().enumerate() {
        for indirect in ["yes", "no"] {
            let mean = |n: f64| {
                let errors = table.figures("environment_error", |row| {
                    row.text("design") == design.name()
                        && row.text("indirect_light") == indirect
                        && row.number("images") == Some(n)
                });
                let logs: f64 = errors.iter().map(|e| e.max(1e-4).log10()).sum();
                (!errors.is_empty()).then(|| logs / errors.len() as f64)
            };
            let points: Vec<[f64; 2]> = images
                .iter()
                .filter_map(|&n| Some([n.log2(), mean(n)?]))
                .collect();
            if points.is_empty() {
                continue;
            }
            all.extend(points.iter().map(|[_, y]| *y));
            let (label, mark) = match indirect {
                "yes" => (design.name().to_owned(), Mark::Points),
                _ => (
                    format!("{}, direct light alone", design.name()),
                    Mark::Dashed,
                ),
            };
            series.push(Series::new(&label, color, mark, points));
        }
    }
    let low = all.iter().copied().fold(0.0, f64::min);
    let high = all.iter().copied().fold(-3.0, f64::max);
    let shown = Chart {
        title: "geometric means over the materials".to_owned(),
        x: doublings(&images, "number of images"),
        y: Axis::decades(low - 0.1..high + 0.1, "environment error (relative)"),
        series,
    };
    let samples = [
        ("bowl, four lamps", Design::Bowl.scene(4, 40, 128)?),
        ("ridge, four lamps", Design::Ridge.scene(4, 40, 128)?),
    ];
    Ok(vec![charts("designs", 1, &[shown]), figure(&samples)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::{Atom, Mixture};

    /// Every design is in view, each lamp lights 20 pixels of it or more, and only concave ones
    /// have lamps in front alone.
    #[test]
    fn every_lamp_of_every_design_is_seen() {
        for design in Design::ALL {
            for &images in design.images() {
                let scene = design.scene(images, 32, 64).unwrap();
                let seen = crate::transport::Visibility::of(&scene);
                assert!(
                    seen.concerns().is_empty(),
                    "{design:?}: {:?}",
                    seen.concerns()
                );
                assert_eq!(scene.lights.len(), images);
                assert!(
                    (seen.in_view - 1.0).abs() < 0.02,
                    "{design:?}: {}",
                    seen.in_view
                );
                for reach in &seen.lights {
                    assert!(reach.lit * seen.covered_px > 20.0, "{design:?}: {reach:?}");
                }
            }
        }
    }

    /// The two designs are those whose drawings are shipped.
    #[test]
    fn shipped_designs_are_those_of_the_documents() {
        let turned = include_str!("../../../../docs/designs/turned/design.json");
        let sheet = include_str!("../../../../docs/designs/sheet/design.json");
        for (design, heights, text) in [
            (Design::Turned, TURNED, turned),
            (Design::Sheet, SHEET, sheet),
        ] {
            let written: serde_json::Value = serde_json::from_str(text).unwrap();
            let knots = &written["profile_height_and_slope"];
            let known = Profile::through(&heights).knots;
            for (k, knot) in known.iter().flatten().enumerate() {
                let stated = knots[k / 2][k % 2].as_f64().unwrap();
                assert!((stated - knot).abs() < 1e-12, "{design:?}: {k}");
            }
            let found = &written["design"];
            let tilt_deg = found["camera_tilt_deg"].as_f64().unwrap();
            assert!((tilt_deg - design.tilt_deg()).abs() < 1e-5);
            let lamps = found["lights"].as_array().unwrap();
            let lamps: Vec<(f64, f64)> = lamps
                .iter()
                .map(|lamp| ["elevation_deg", "azimuth_deg"].map(|key| lamp[key].as_f64().unwrap()))
                .map(|[elevation_deg, azimuth_deg]| (90.0 - elevation_deg, azimuth_deg))
                .collect();
            assert_eq!(lamps, design.lamps(lamps.len()));
        }
    }

    /// On a convex sample all light is reflected once: a white Lambertian one is found to have
    /// f = 1/π everywhere; on a concave one indirect light adds to it.
    #[test]
    fn convex_images_are_reflectances_at_their_pairs() {
        let white = Dictionary::new("white", vec![Atom::Lambertian { albedo: 1.0 }]).unwrap();
        let white = Mixture::new(Arc::new(white), std::array::from_fn(|_| vec![1.0])).unwrap();
        let mean = |design: Design| {
            let scene = design.scene(1, 24, 128).unwrap();
            let images = render(&scene, &white, &RenderOptions::default());
            let (pairs, values) = reflected_once(&scene, &images);
            assert!(pairs.len() > 60, "{design:?}: {}", pairs.len());
            let sum: f64 = values.iter().map(|value| value[0]).sum();
            std::f64::consts::PI * sum / values.len() as f64
        };
        for design in [Design::Ball, Design::Cap] {
            assert!(
                (mean(design) - 1.0).abs() < 0.05,
                "{design:?}: {}",
                mean(design)
            );
        }
        assert!(mean(Design::Bowl) > 1.3, "{}", mean(Design::Bowl));
    }
}
