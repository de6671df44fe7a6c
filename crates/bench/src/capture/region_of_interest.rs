//! Which pixels see the sample: those whose exposure matters.

use glam::DVec2;

use crate::transport::{Camera, Scene};

/// Positions within a pixel that are looked at: corners (a little inside) and
/// centre, so that the silhouette's pixels count.
const POSITIONS: [[f64; 2]; 5] = [
    [0.5, 0.5],
    [0.02, 0.02],
    [0.98, 0.02],
    [0.02, 0.98],
    [0.98, 0.98],
];

/// Pixels, row by row, through which `camera` sees the sample.
pub fn sample_pixels(scene: &Scene, camera: &Camera) -> Vec<bool> {
    let [width, height] = camera.resolution_px;
    let sees = |x: usize, y: usize| {
        POSITIONS.iter().any(|[dx, dy]| {
            let position_px = DVec2::new(x as f64 + dx, y as f64 + dy);
            let ray = camera.ray(position_px, DVec2::ZERO);
            scene.intersect(&ray).is_some_and(|hit| hit.is_sample())
        })
    };
    (0..width * height)
        .map(|pixel| sees(pixel % width, pixel / width))
        .collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::{BUILT_IN, RigConfig};

    /// A bowl of radius 10 mm in a field of 29.3 × 22 mm: a disk of that area.
    #[test]
    fn the_bowl_is_a_disk() {
        let rig = RigConfig::parse("simulated", Path::new(""), BUILT_IN[0].1).unwrap();
        let scene = rig.geometry.scene(&[]).unwrap();
        let pixels = sample_pixels(&scene, &rig.geometry.camera);
        let seen = pixels.iter().filter(|&&seen| seen).count() as f64;
        let disk = std::f64::consts::PI * (10.0 / 29.3 * 640.0) * (10.0 / 22.0 * 480.0);
        // Pixels cut by the rim count whole: half a pixel more all around, about.
        assert!(
            (disk..disk * 1.015).contains(&seen),
            "{seen} pixels of {disk:.0}"
        );
    }
}
