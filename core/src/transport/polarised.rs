//! Rendering with polarised light: lamps are unpolarised, the camera measures intensity,
//! GGX facets reflect s and p differently, diffuse reflection depolarises.
//!
//! A path is followed from the camera, so what it carries is a row (I, Q, U) that reads
//! Stokes vectors: the camera's (1, 0, 0) times the Mueller matrices of the reflections so
//! far, about a reference axis across the ray (Wilkie et al. 2001). After two coplanar
//! mirror reflections ½(Rs² + Rp²) is left of the light, not ¼(Rs + Rp)².

use glam::Vec3;

use super::render::{Carrier, Event, RenderOptions, render_carrying};
use super::scene::Scene;
use crate::brdf::Brdf;
use crate::progress::Progress;
use crate::radiance_image::RadianceImage;

/// A material whose polarisation is not known.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what} is no mixture of GGX, Lambertian and black: how it polarises is not known")]
pub struct NotPolarisable {
    /// The sample, or a known body by its index from 0.
    pub what: String,
}

/// [`super::render()`] with polarised light; the same paths for the same seed.
pub fn render_polarised(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    progress: &dyn Progress,
) -> Result<Vec<RadianceImage>, NotPolarisable> {
    let refuse = |what: String| Err(NotPolarisable { what });
    if brdf.as_mixture().is_none() {
        return refuse("the sample's BRDF".to_owned());
    }
    let unknown = |body: &std::sync::Arc<dyn Brdf>| body.as_mixture().is_none();
    if let Some(body) = scene.bodies().iter().position(unknown) {
        return refuse(format!("the BRDF of body {body}"));
    }
    Ok(render_carrying::<Row>(scene, brdf, options, progress))
}

/// Reads the Stokes vector of light that travels towards the camera.
#[derive(Clone, Debug)]
struct Row {
    /// Reference across the ray, unit, sample frame.
    axis: Vec3,
    /// I, Q, U for R, G, B.
    iqu: [[f64; 3]; 3],
}

impl Row {
    /// Takes the row through a reflection; the axis becomes the plane's normal s.
    fn through(&self, event: &Event<'_>) -> Self {
        let [to_light, to_viewer] =
            [event.to_light, event.to_viewer].map(|d| event.surface.world(d));
        // Light travels along −to_light, then along to_viewer. Back along itself, any plane will do.
        let s = to_viewer.cross(to_light);
        let s = if s.length_squared() > 1e-12 {
            s.normalize()
        } else {
            self.axis
        };
        let (x, y) = (self.axis.dot(s), to_viewer.cross(self.axis).dot(s));
        let norm = f64::from(x * x + y * y).max(f64::MIN_POSITIVE);
        let cos2 = f64::from(x * x - y * y) / norm;
        let sin2 = f64::from(2.0 * x * y) / norm;
        // What is no mixture was refused before.
        let matrices = event
            .brdf
            .as_mixture()
            .map(|m| m.mueller(event.to_light, event.to_viewer))
            .unwrap_or_default();
        let mut iqu = [[0.0; 3]; 3];
        for ((out, [i, q, u]), m) in iqu.iter_mut().zip(self.iqu).zip(matrices) {
            let (q, u) = (q * cos2 + u * sin2, u * cos2 - q * sin2);
            let [ii, iq, qq, uu] = [m.ii, m.iq, m.qq, m.uu].map(f64::from);
            *out = [i * ii + q * iq, i * iq + q * qq, u * uu];
        }
        Self { axis: s, iqu }
    }
}

impl Carrier for Row {
    fn start(direction: Vec3) -> Self {
        Self {
            axis: direction.any_orthonormal_vector(),
            iqu: [[1.0, 0.0, 0.0]; 3],
        }
    }

    fn reading(&self, event: &Event<'_>, irradiance: f32) -> [f64; 3] {
        self.through(event)
            .iqu
            .map(|[i, ..]| i * f64::from(irradiance))
    }

    fn reflect(&mut self, event: &Event<'_>, [cosine, pdf]: [f32; 2]) -> bool {
        *self = self.through(event);
        let weight = f64::from(cosine / pdf);
        for value in self.iqu.iter_mut().flatten() {
            *value *= weight;
        }
        self.iqu.iter().any(|[i, ..]| *i != 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::ggx::fresnel_amplitudes;
    use crate::brdf::nbrdf::NeuralBrdf;
    use crate::brdf::{Atom, Dictionary, Mixture};
    use crate::geometry::Mesh;
    use crate::transport::{Body, Camera, Light, Proposal, Shading, render};
    use glam::{DVec2, DVec3};
    use std::sync::Arc;

    fn single(atom: Atom) -> Mixture {
        Mixture::grey(
            Arc::new(Dictionary::new("one", vec![atom]).unwrap()),
            vec![1.0],
        )
        .unwrap()
    }

    /// Two squares: the camera looks along −z at the first, whose normal is (1, 0, 1)/√2
    /// rotated by `turn` about the beam that leaves it along x.
    fn two_mirrors(first: Vec3, centre: Vec3, second: Vec3, to_light: DVec3) -> Scene {
        let mut positions = Vec::new();
        let mut triangles = Vec::new();
        for (centre, normal) in [(Vec3::ZERO, first), (centre, second)] {
            let (a, b) = normal.normalize().any_orthonormal_pair();
            let n = positions.len() as u32;
            for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                positions.push(centre + 2.0 * (a * x + b * y));
            }
            triangles.extend([[n, n + 1, n + 2], [n, n + 2, n + 3]]);
        }
        let mesh = Mesh::new(positions, triangles).unwrap();
        let camera = Camera::above([4, 4], DVec2::splat(0.1), 20.0);
        let light = Light::distant(to_light, [1.0; 3]);
        Scene::new(mesh, Shading::Flat, camera, vec![light])
    }

    /// Polarised over scalar light after two reflections of a lobe of width 0.005.
    fn ratio(scene: &Scene, eta: f64) -> f64 {
        let brdf = single(Atom::Ggx { alpha: 0.005, eta });
        let options = RenderOptions {
            samples_per_pixel: 256,
            max_reflections: 2,
            seed: 1,
            proposal: Proposal::resembling(&brdf, 0.1),
            ..RenderOptions::default()
        };
        let sum = |images: Vec<RadianceImage>| -> f64 {
            images[0].mean.iter().map(|p| f64::from(p[0])).sum()
        };
        let polarised = render_polarised(scene, &brdf, &options, &()).unwrap();
        sum(polarised) / sum(render(scene, &brdf, &options))
    }

    /// The normal of a mirror that turns light from direction `to_light` to `to_viewer`.
    fn half(to_light: Vec3, to_viewer: Vec3) -> Vec3 {
        (to_light + to_viewer).normalize()
    }

    #[test]
    fn two_coplanar_reflections_have_the_closed_form() {
        for (degrees, published) in [(45.0f64, 1.69), (56.0, 1.50)] {
            // The beam from the camera: down, then `out`, then back up to the lamp, which
            // leaves 90° less the first angle for the second.
            let theta = degrees.to_radians();
            let turn = (std::f64::consts::PI - 2.0 * theta) as f32;
            let (down, out) = (-Vec3::Z, Vec3::new(turn.sin(), 0.0, -turn.cos()));
            let scene = two_mirrors(half(-down, out), out * 6.0, half(-out, Vec3::Z), DVec3::Z);
            for eta in [1.5, 20.0] {
                let reflectances = |cos: f64| {
                    let (r_s, r_p) = fresnel_amplitudes(eta, cos);
                    (r_s * r_s, r_p * r_p)
                };
                let ((s1, p1), (s2, p2)) = (reflectances(theta.cos()), reflectances(theta.sin()));
                let exact = 2.0 * (s1 * s2 + p1 * p2) / ((s1 + p1) * (s2 + p2));
                let found = ratio(&scene, eta);
                assert!(
                    (found / exact - 1.0).abs() < 0.01,
                    "{degrees}°, {eta}: {found} for {exact}"
                );
                if eta == 1.5 {
                    assert!((exact - published).abs() < 0.015, "{exact}");
                } else {
                    assert!(exact < 1.02, "{exact}");
                }
            }
        }
    }

    #[test]
    fn perpendicular_planes_leave_the_product() {
        let (down, out, on) = (-Vec3::Z, Vec3::X, Vec3::Y);
        let scene = two_mirrors(half(-down, out), out * 6.0, half(-out, on), DVec3::Y);
        let (r_s, r_p) = fresnel_amplitudes(1.5, 0.5f64.sqrt());
        let (s, p) = (r_s * r_s, r_p * r_p);
        let exact = s * p / (0.5 * (s + p)).powi(2);
        let found = ratio(&scene, 1.5);
        assert!((found / exact - 1.0).abs() < 0.02, "{found} for {exact}");
    }

    /// Two reflections leave at most ½ R² of one polarisation, twice the scalar ¼ R².
    #[test]
    fn light_is_not_made_and_one_reflection_is_the_scalar_one() {
        let (down, out, on) = (-Vec3::Z, Vec3::X, Vec3::new(0.0, 0.6, 0.8));
        let scene = two_mirrors(half(-down, out), out * 6.0, half(-out, on), on.as_dvec3());
        let blend = Mixture::grey(
            Arc::new(
                Dictionary::new(
                    "blend",
                    vec![
                        Atom::Lambertian { albedo: 0.7 },
                        Atom::Ggx {
                            alpha: 0.3,
                            eta: 1.6,
                        },
                        Atom::Black,
                    ],
                )
                .unwrap(),
            ),
            vec![0.4, 0.5, 0.1],
        )
        .unwrap();
        for (brdf, reflections) in [(&blend, 1), (&single(Atom::Lambertian { albedo: 1.0 }), 8)] {
            let options = RenderOptions {
                samples_per_pixel: 64,
                max_reflections: reflections,
                ..RenderOptions::default()
            };
            let scalar = render(&scene, brdf, &options).remove(0);
            let polarised = render_polarised(&scene, brdf, &options, &())
                .unwrap()
                .remove(0);
            for (a, b) in scalar.mean.iter().zip(&polarised.mean) {
                assert!(
                    (a[1] - b[1]).abs() <= 1e-6 * a[1] && a[1] > 0.0,
                    "{a:?} {b:?}"
                );
            }
        }
        let options = RenderOptions {
            samples_per_pixel: 64,
            max_reflections: 2,
            ..RenderOptions::default()
        };
        let scalar = render(&scene, &blend, &options).remove(0);
        let polarised = render_polarised(&scene, &blend, &options, &()).unwrap();
        for (a, b) in scalar.mean.iter().zip(&polarised[0].mean) {
            assert!(b[0] > 0.0 && b[0] <= 2.0 * a[0], "{a:?} {b:?}");
        }
    }

    #[test]
    fn measured_materials_are_refused() {
        let measured = NeuralBrdf::named("pvc").unwrap();
        let grey = single(Atom::Lambertian { albedo: 0.5 });
        let mut scene = two_mirrors(Vec3::Z, Vec3::X * 6.0, Vec3::Z, DVec3::Z);
        let refusal = |scene: &Scene, brdf: &dyn Brdf| {
            render_polarised(scene, brdf, &RenderOptions::default(), &())
                .unwrap_err()
                .to_string()
        };
        assert!(refusal(&scene, &measured).starts_with("the sample's BRDF is no mixture"));
        scene = Scene::with_bodies(
            scene.sample().clone(),
            Shading::Flat,
            vec![Body {
                mesh: scene.sample().clone(),
                shading: Shading::Flat,
                brdf: Arc::new(measured),
            }],
            scene.camera,
            scene.lights.clone(),
        );
        assert!(refusal(&scene, &grey).starts_with("the BRDF of body 0 is no mixture"));
    }
}
