//! Directions of lights by their highlights on mirror spheres.

use glam::DVec3;

use super::{EvaluateError, Recovered, failed};
use crate::calibration::mirror_sphere::light::{FoundLight, tangents};
use crate::calibration::mirror_sphere::outline::Stated;
use crate::calibration::mirror_sphere::{Grey, locate_all, spheres_in};
use crate::calibration::record::Measured;
use crate::simulation::glossy_spheres::GlossySpheres;

/// Six far lights by one sphere.
pub(super) fn one_sphere(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    let bench = GlossySpheres::under_six_lights(seed);
    let (lights, _) = find(&bench, seed)?;
    Ok(directions(&bench, &lights))
}

/// Three positions of a near lamp, and its distance, by two spheres.
pub(super) fn two_spheres(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    let bench = GlossySpheres::under_a_near_lamp(seed);
    let (lights, distance) = find(&bench, seed)?;
    let mut all = directions(&bench, &lights);
    let found = distance.ok_or_else(|| failed("no distance of the lamp was found"))?;
    all.push(Recovered {
        quantity: "distance of the lamp",
        unit: "mm",
        truth: bench.lamps_mm[0].length(),
        found,
    });
    Ok(all)
}

fn find(
    bench: &GlossySpheres,
    seed: u64,
) -> Result<(Vec<FoundLight>, Option<Measured>), EvaluateError> {
    let images: Vec<Grey> = bench.photographs(seed).iter().map(Grey::of).collect();
    let stated = Stated {
        radius_mm: bench.radius_mm,
        height_mm: bench.centres_mm[0].z,
    };
    let count = bench.centres_mm.len();
    let spheres = spheres_in(&images, None, &bench.camera, &stated, &[], count).map_err(failed)?;
    let distances = vec![None; images.len()];
    locate_all(&bench.camera, &spheres, &images, DVec3::ZERO, &distances).map_err(failed)
}

fn directions(bench: &GlossySpheres, lights: &[FoundLight]) -> Vec<Recovered> {
    let names = ["direction, along azimuth", "direction, along elevation"];
    let of = |(found, lamp): (&FoundLight, &DVec3)| {
        let off = found.to_light - lamp.normalize();
        let across = tangents(found.to_light);
        let covariance = found.covariance();
        [0, 1].map(|axis| Recovered {
            quantity: names[axis],
            unit: "°",
            truth: 0.0,
            found: Measured {
                value: across[axis].dot(off).to_degrees(),
                std: covariance[(axis, axis)].sqrt().to_degrees(),
            },
        })
    };
    lights.iter().zip(&bench.lamps_mm).flat_map(of).collect()
}
