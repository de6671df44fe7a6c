//! How exactly a sample must be made: the error that faults of its surface cause where the fit
//! takes it for the ideal shape.

use std::f32::consts::TAU;
use std::sync::Arc;

use glam::Vec3;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table};
use super::lab::capture::{SENSOR, photograph};
use super::lab::{Lab, Material, Sample, of_materials};
use crate::brdf::Dictionary;
use crate::geometry::{FormError, Mesh, MeshError};
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};
use crate::random::{Purpose, stream};
use crate::transport::{Scene, Shading};

/// Errors of a bowl that is not made as described.
pub static TOLERANCE: Experiment = Experiment {
    name: "tolerance",
    shows: "Error where a bowl of 40 mm is not made as described: slope errors, waviness, the layers of a printer, a coat of paint; the fit takes it for the ideal shape",
    full: Scale {
        materials: &["nbrdf:pvc", "nbrdf:teflon", "nbrdf:blue-metallic-paint"],
        samples_per_pixel: 256,
        truth_samples_per_pixel: 512,
        lights: 4,
        dictionary: Dictionary::DEFAULT,
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        materials: &["nbrdf:pvc"],
        lights: 1,
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

/// Diameter of the sample that lengths are stated for.
const DIAMETER_MM: f64 = 40.0;
/// Of the laboratory's bowl, whose radius is 1.
const PER_MM: f64 = 2.0 / DIAMETER_MM;

/// How a surface differs from the ideal one.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    /// Not at all.
    None,
    /// Its normals, root mean square in degrees, over about a millimetre: sanding, orange peel.
    Slope(f64),
    /// Its height, root mean square in millimetres, over a centimetre: shrinkage, clamping.
    Waviness(f64),
    /// Steps of this height in millimetres: a printed surface as it leaves the printer.
    Layers(f64),
    /// A coat of this thickness in millimetres, even but not in the file.
    Paint(f64),
}

const FAULTS: [Fault; 13] = [
    Fault::None,
    Fault::Slope(0.5),
    Fault::Slope(1.0),
    Fault::Slope(2.0),
    Fault::Slope(4.0),
    Fault::Waviness(0.02),
    Fault::Waviness(0.05),
    Fault::Waviness(0.1),
    Fault::Layers(0.1),
    Fault::Layers(0.2),
    Fault::Paint(0.05),
    Fault::Paint(0.1),
    Fault::Paint(0.2),
];

/// Length over which a slope error and a waviness stay alike, millimetres.
const FINE_MM: f64 = 1.0;
const COARSE_MM: f64 = 10.0;

impl Fault {
    /// Its kind, as in tables.
    fn kind(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Slope(_) => "slope error",
            Self::Waviness(_) => "waviness",
            Self::Layers(_) => "layers",
            Self::Paint(_) => "paint",
        }
    }

    /// How much of it, degrees or millimetres, and the unit.
    fn amount(self) -> (f64, &'static str) {
        match self {
            Self::None => (0.0, ""),
            Self::Slope(deg) => (deg, "deg"),
            Self::Waviness(mm) | Self::Layers(mm) | Self::Paint(mm) => (mm, "mm"),
        }
    }

    /// The scene whose sample has it. The sample of `sound` is a bowl of radius 1.
    fn scene(self, sound: Scene, seed: u64) -> Result<Scene, EvaluateError> {
        let mesh = sound.sample();
        let deformed = |error: Option<FormError>| match error {
            None => mesh.clone(),
            Some(error) => {
                let mut numbers = stream(seed, Purpose::Experiment, 0, 0, 0);
                let field = error.field(mesh.mean_edge_mm(), &mut numbers);
                field.deform(mesh, 1.0)
            }
        };
        let height = |slope_rad: f64, length_mm: f64| {
            slope_rad * length_mm * PER_MM / std::f64::consts::SQRT_2
        };
        let (mesh, shading) = match self {
            Self::None => return Ok(sound),
            Self::Slope(deg) => {
                let slope_rad = deg.to_radians();
                let error = FormError::new(height(slope_rad, FINE_MM), slope_rad);
                (deformed(error), Shading::Smooth)
            }
            Self::Waviness(mm) => {
                let slope_rad = std::f64::consts::SQRT_2 * mm / COARSE_MM;
                let error = FormError::new(mm * PER_MM, slope_rad);
                (deformed(error), Shading::Smooth)
            }
            Self::Layers(mm) => (terraced_bowl((mm * PER_MM) as f32)?, Shading::Flat),
            Self::Paint(mm) => {
                let mut thinner = mesh.clone();
                let scale = 1.0 - (mm * PER_MM) as f32;
                thinner.positions_mm.iter_mut().for_each(|p| *p *= scale);
                (thinner, Shading::Smooth)
            }
        };
        Ok(Scene::new(mesh, shading, sound.camera, sound.lights))
    }
}

/// A bowl of radius 1 from flat rings and upright walls, `layer` high each.
fn terraced_bowl(layer: f32) -> Result<Mesh, MeshError> {
    const AROUND: u32 = 240;
    let layers = (1.0 / layer).round() as u32;
    // Radius and height, from the rim to the bottom.
    let mut profile = Vec::new();
    for k in 0..layers {
        let [above, below] = [k, k + 1].map(|k| k as f32 / layers as f32);
        let radius = (1.0 - above * above).max(0.0).sqrt();
        profile.extend([(radius, -above), (radius, -below)]);
    }
    let ring = |&(radius, z): &(f32, f32)| {
        (0..AROUND).map(move |i| {
            let angle = TAU * i as f32 / AROUND as f32;
            Vec3::new(radius * angle.cos(), radius * angle.sin(), z)
        })
    };
    let mut positions: Vec<Vec3> = profile.iter().flat_map(ring).collect();
    let bottom = positions.len() as u32;
    positions.push(Vec3::new(0.0, 0.0, -1.0));
    // Counter-clockwise as seen from inside.
    let mut triangles = Vec::new();
    for k in 0..profile.len() as u32 {
        for i in 0..AROUND {
            let at = |ring: u32, i: u32| ring * AROUND + i % AROUND;
            if k + 1 == profile.len() as u32 {
                triangles.push([at(k, i), at(k, i + 1), bottom]);
            } else {
                triangles.push([at(k, i), at(k, i + 1), at(k + 1, i)]);
                triangles.push([at(k, i + 1), at(k + 1, i + 1), at(k + 1, i)]);
            }
        }
    }
    Mesh::new(positions, triangles)
}

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let name = |fault: Fault| match fault.amount() {
        (_, "") => fault.kind().to_owned(),
        (amount, unit) => format!("{} {amount} {unit}", fault.kind()),
    };
    let few = [Fault::None, Fault::Slope(2.0), Fault::Layers(0.2)];
    let faults = if lab.settings.quick {
        &few[..]
    } else {
        &FAULTS
    };
    Ok(of_materials(lab, faults, name, one))
}

fn one(lab: &Lab, material: &Arc<Material>, fault: Fault) -> Result<Vec<Row>, EvaluateError> {
    let sample = Sample::Bowl;
    let lights = sample.lights(lab.settings.lights);
    let sound = sample.true_scene(lab.settings.resolution_px, lights.clone())?;
    let truth = fault.scene(sound, lab.settings.seed)?;
    let captured = photograph(&SENSOR, &lab.render_truth(&truth, &*material.brdf))?;
    let estimate = lab.fit(sample, &lights, &captured, material)?;
    let score = lab.score(&estimate.fit.material, &*material.brdf);
    let (amount, unit) = fault.amount();
    let row = material
        .row(sample)
        .with("fault", fault.kind())
        .with("amount", amount)
        .with("unit", unit)
        .with("lights", lab.settings.lights)
        .with("reduced_chi2", estimate.mean_reduced_chi2())
        .with("environment_error", score.environment)
        .with("cube_root_error", score.cube_root);
    Ok(vec![row])
}

/// A panel per kind of fault: errors of all materials against its amount.
fn figures(lab: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let column = "cube_root_error";
    let panel = |kind: &str, unit: &str| {
        let series = lab.materials.iter().enumerate().map(|(color, material)| {
            let rows = table.rows.iter().filter(|row| {
                row.text("material") == material.name && ["none", kind].contains(&row.text("fault"))
            });
            let points = rows.filter_map(|row| Some([row.number("amount")?, row.number(column)?]));
            Series::new(&material.name, color, Mark::Points, points.collect())
        });
        let series: Vec<Series> = series.collect();
        let points = || series.iter().flat_map(|series| &series.points);
        let largest = |at: usize| points().map(|p| p[at]).fold(1e-3, f64::max);
        Chart {
            title: kind.to_owned(),
            x: Axis::linear(0.0..1.05 * largest(0), unit),
            y: Axis::linear(0.0..1.1 * largest(1), "cube-root error"),
            series,
        }
    };
    let panels = [
        panel("slope error", "degrees, root mean square"),
        panel("waviness", "mm, root mean square"),
        panel("layers", "mm high"),
        panel("paint", "mm thick"),
    ];
    Ok(vec![charts("tolerance", 2, &panels)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The walls of the terraces look inwards and the rings up; together they are as wide and as
    /// deep as the bowl.
    #[test]
    fn terraces_face_the_camera_and_the_axis() {
        let mesh = terraced_bowl(0.1).unwrap();
        for triangle in 0..mesh.triangles.len() {
            let normal = mesh.face_normal(triangle);
            let corners = mesh.corners(triangle);
            let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
            let inward = -Vec3::new(middle.x, middle.y, 0.0).normalize();
            let [up, inwards] = [normal.z, normal.dot(inward)];
            assert!(
                up > 0.999 || inwards > 0.999,
                "{triangle}: {normal} at {middle}"
            );
        }
        let lowest = mesh.positions_mm.iter().map(|p| p.z).fold(0.0, f32::min);
        assert_eq!(lowest, -1.0);
    }

    /// Lengths are those of a sample of 40 mm.
    #[test]
    fn lengths_are_relative_to_the_sample() {
        let lights = Sample::Bowl.lights(1);
        let sound = Sample::Bowl.true_scene(16, lights).unwrap();
        let painted = Fault::Paint(0.2).scene(sound, 1).unwrap();
        let radius = painted.sample().positions_mm[0].length();
        assert!((radius - 0.99).abs() < 1e-5, "{radius}");
    }
}
