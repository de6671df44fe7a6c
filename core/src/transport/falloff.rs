//! How the irradiance of a lamp differs over the sample from what its position and strength
//! say: a low-order polynomial.

use glam::Vec3;

/// Factor on a lamp's irradiance: 1 + s·(x, y) + c·(x², xy, y²), of positions in the sample's
/// frame. The default is even light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Falloff {
    /// Along x and y, per millimetre.
    pub slope_per_mm: [f64; 2],
    /// Of x², xy and y², per square millimetre.
    pub curve_per_mm2: [f64; 3],
}

impl Falloff {
    /// The factor at a position, at least 0.
    #[inline]
    pub fn at(&self, position_mm: Vec3) -> f32 {
        let [x, y] = [position_mm.x, position_mm.y].map(f64::from);
        let ([a, b], [c, d, e]) = (self.slope_per_mm, self.curve_per_mm2);
        (1.0 + a * x + b * y + c * x * x + d * x * y + e * y * y).max(0.0) as f32
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;
    use std::sync::Arc;

    use glam::{DVec2, DVec3};

    use super::*;
    use crate::brdf::{Atom, Dictionary, Mixture};
    use crate::geometry::Mesh;
    use crate::transport::{
        Camera, Cells, DirectMatrix, Light, RenderOptions, Scene, Shading, render,
    };

    /// A level white plate under an uneven lamp and an even one.
    #[test]
    fn a_plate_shows_the_factor() {
        let corners = [(-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0)];
        let corners = corners.map(|(x, y)| Vec3::new(x, y, 0.0)).to_vec();
        let plate = Mesh::new(corners, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        let camera = Camera::above([8, 8], DVec2::splat(8.0), 50.0);
        let lamp = Light::distant(DVec3::Z, [1.0; 3]);
        let mut scene = Scene::new(plate, Shading::Flat, camera, vec![lamp; 2]);
        scene.falloffs = vec![Falloff {
            slope_per_mm: [0.02, -0.03],
            curve_per_mm2: [-0.004, 0.002, 0.001],
        }];
        let dictionary = Dictionary::new("white", vec![Atom::Lambertian { albedo: 1.0 }]).unwrap();
        let white = Mixture::grey(Arc::new(dictionary), vec![1.0]).unwrap();
        let options = RenderOptions {
            samples_per_pixel: 64,
            max_reflections: 1,
            ..RenderOptions::default()
        };
        let images = render(&scene, &white, &options);
        let cells = Cells::of_pixels(scene.camera.resolution_px);
        let direct = DirectMatrix::new(&scene, &cells, white.dictionary(), 8, 1);
        for pixel in 0..64 {
            let x = (pixel % 8) as f64 - 3.5;
            let y = 3.5 - (pixel / 8) as f64;
            let factor = 1.0 + 0.02 * x - 0.03 * y - 0.004 * x * x + 0.002 * x * y + 0.001 * y * y;
            for (light, expected) in [(0, factor / PI), (1, 1.0 / PI)] {
                let rendered = f64::from(images[light].mean[pixel][1]);
                let exact = f64::from(direct.row(pixel, light)[0]);
                assert!((rendered / expected - 1.0).abs() < 0.01, "{pixel} {light}");
                assert!((exact / expected - 1.0).abs() < 3e-3, "{pixel} {light}");
            }
        }
    }
}
