//! Renders against those of an independent renderer and against closed forms.
//!
//! Per pixel z = (ours − reference)/√(σ² + se² + floor²), with the floor of 1e-3 of the
//! reference where a crease or a silhouette crosses the pixel (the reference's own
//! single-precision ray offset); the reference's se comes from few groups of paths, so z is
//! taken through Student's distribution. Two tests check whether the z are standard normal,
//! Anderson–Darling and χ²; a third whether the image's mean is within 3 standard errors
//! plus 2e-4. Family significance 1% over all cases and both tests of z (Šidák).
//!
//! The normal approximation needs enough paths: a pixel takes part if a pilot render of
//! other paths promises a relative standard error below 8%. That choice knows nothing of
//! the comparison's outcome. Nor does it take a pixel of which a crease or a silhouette
//! cuts off less than about a seventh: the few paths in so small a part are no normal sum.

use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3, Vec3};
use rig_core::brdf::ggx::{self, Cosines};
use rig_core::brdf::{Brdf, Mixture};
use rig_core::geometry::{Mesh, files};
use rig_core::radiance_image::RadianceImage;
use rig_core::transport::{
    Camera, Light, Projection, Proposal, RenderOptions, Scene, Shading, render, suited_proposal,
};

use super::materials::{blend, ggx, lambertian};
use super::statistics::{anderson_darling, chi2_score, normal_score, sidak, two_sided};

/// The numbers of a NumPy file of f64, f32 or bytes.
fn npy(name: &str) -> Vec<f64> {
    let bytes = std::fs::read(data(name)).unwrap();
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]])) + 10;
    let text = String::from_utf8_lossy(&bytes[10..header]);
    let body = &bytes[header..];
    if text.contains("<f8") {
        body.chunks_exact(8)
            .map(|c| f64::from_le_bytes(c.try_into().unwrap()))
            .collect()
    } else if text.contains("<f4") {
        body.chunks_exact(4)
            .map(|c| f64::from(f32::from_le_bytes(c.try_into().unwrap())))
            .collect()
    } else {
        assert!(text.contains("|b1") || text.contains("|u1"), "{text}");
        body.iter().map(|&b| f64::from(b)).collect()
    }
}

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data/references")
        .join(name)
}

pub fn mesh(name: &str) -> Mesh {
    if name == "hemi_convex" {
        // The bowl turned inside out.
        let mut bowl = mesh("bowl_concave");
        bowl.positions_mm.iter_mut().for_each(|p| p.z = -p.z);
        return bowl;
    }
    files::read(
        &data(&format!("{name}.ply")),
        &rig_core::geometry::Placement::default(),
    )
    .unwrap()
}

fn towards(theta_deg: f64, phi_deg: f64) -> DVec3 {
    let (theta, phi) = (theta_deg.to_radians(), phi_deg.to_radians());
    DVec3::new(
        theta.sin() * phi.cos(),
        theta.sin() * phi.sin(),
        theta.cos(),
    )
}

pub fn sun(theta_deg: f64, phi_deg: f64) -> Light {
    Light::distant(towards(theta_deg, phi_deg), [1.0; 3])
}

fn lamp(position_mm: [f64; 3], intensity: f64) -> Light {
    Light::Point {
        position_mm: DVec3::from_array(position_mm),
        intensity_mm2: [intensity; 3],
    }
}

/// Orthographic along −z, field of view ±1.1.
pub fn above(resolution_px: [usize; 2]) -> Camera {
    Camera::above(resolution_px, DVec2::splat(2.2), 5.0)
}

/// The upper left quarter of [`above`] at 64 × 64.
fn upper_left() -> Camera {
    let extent_mm = DVec2::splat(1.1);
    let at = |z: f64| DVec3::new(-0.55, 0.55, z);
    let projection = Projection::Orthographic { extent_mm };
    Camera::looking_at([32, 32], projection, at(5.0), at(0.0), DVec3::Y).unwrap()
}

fn perspective() -> Camera {
    Camera::looking_at(
        [32, 24],
        Projection::Perspective {
            fov_rad: 38f64.to_radians(),
        },
        DVec3::new(0.9, -0.7, 3.2),
        DVec3::new(0.05, 0.02, -0.3),
        DVec3::Y,
    )
    .unwrap()
}

/// One reference: `{mesh}_{name}`.
struct Case {
    mesh: &'static str,
    name: &'static str,
    shading: Shading,
    camera: fn() -> Camera,
    light: fn() -> Light,
    material: fn() -> Mixture,
    max_reflections: u32,
    /// Groups of paths behind the reference's standard error.
    groups: f64,
    /// Paths per pixel of ours.
    samples: u32,
    /// Whether only the upper left quarter is compared, with more paths.
    quarter: bool,
}

const fn case(mesh: &'static str, name: &'static str) -> Case {
    Case {
        mesh,
        name,
        shading: Shading::Flat,
        camera: || above([64, 64]),
        light: || sun(25.0, 20.0),
        material: blend,
        max_reflections: 32,
        groups: 16.0,
        samples: 512,
        quarter: false,
    }
}

/// A reference of 32 × 32 pixels.
const fn small(mesh: &'static str, name: &'static str) -> Case {
    Case {
        camera: || above([32, 32]),
        ..case(mesh, name)
    }
}

const fn direct(mesh: &'static str, name: &'static str) -> Case {
    Case {
        max_reflections: 1,
        groups: 8.0,
        samples: 256,
        ..case(mesh, name)
    }
}

const fn coaxial(case: Case) -> Case {
    Case {
        light: || sun(0.0, 0.0),
        ..case
    }
}

const CASES: &[Case] = &[
    direct("tet_concave", "L25_blend_k1"),
    Case {
        material: || ggx(0.15, 1.5),
        ..direct("tet_concave", "L25_ggx015_k1")
    },
    Case {
        material: || lambertian(1.0),
        ..direct("tet_concave", "L25_lambert1_k1")
    },
    Case {
        max_reflections: 2,
        samples: 1024,
        ..case("tet_concave", "L25_blend_k2")
    },
    Case {
        samples: 1024,
        ..case("tet_concave", "L25_blend_kfull")
    },
    Case {
        material: || lambertian(1.0),
        samples: 1024,
        ..case("tet_concave", "L25_lambert1_kfull")
    },
    Case {
        material: || ggx(0.15, 1.5),
        samples: 2048,
        ..case("tet_concave", "L25_ggx015_kfull")
    },
    direct("tet_convex", "L25_blend_k1"),
    coaxial(direct("hemi_convex", "L0_blend_k1")),
    coaxial(Case {
        material: || lambertian(1.0),
        ..direct("hemi_convex", "L0_lambert1_k1")
    }),
    coaxial(direct("bowl_concave", "L0_blend_k1")),
    coaxial(Case {
        camera: upper_left,
        quarter: true,
        max_reflections: 2,
        samples: 2048,
        ..case("bowl_concave", "L0_blend_k2")
    }),
    coaxial(Case {
        camera: upper_left,
        quarter: true,
        samples: 2048,
        ..case("bowl_concave", "L0_blend_kfull")
    }),
    Case {
        camera: perspective,
        light: || lamp([-0.6, 0.5, 1.5], 3.0),
        samples: 1024,
        ..small("bowl64", "perspective_point_blend_kfull")
    },
    Case {
        light: || lamp([0.3, 0.4, 0.9], 1.0),
        samples: 1024,
        ..small("tet_concave", "point_blend_kfull")
    },
    Case {
        light: || sun(12.0, 75.0),
        material: || ggx(0.05, 1.5),
        samples: 4096,
        ..small("tet_concave", "L12_ggx005_kfull")
    },
    Case {
        light: || sun(30.0, 200.0),
        material: || ggx(0.2, 20.0),
        max_reflections: 2,
        samples: 1024,
        ..small("tet_concave", "L30_metal_k2")
    },
    Case {
        light: || sun(60.0, -40.0),
        samples: 1024,
        ..small("bowl64", "L60_blend_kfull")
    },
    Case {
        light: || sun(80.0, 10.0),
        material: || lambertian(0.95),
        samples: 4096,
        ..small("bowl64", "L80_lambert_kfull")
    },
    Case {
        light: || Light::Directional {
            to_light: towards(20.0, 110.0),
            irradiance: [1.0; 3],
            angular_radius_rad: 10f64.to_radians(),
        },
        material: || ggx(0.1, 2.5),
        samples: 1024,
        ..small("bowl64", "disc10_ggx01_kfull")
    },
    Case {
        shading: Shading::Smooth,
        light: || sun(15.0, 160.0),
        samples: 1024,
        ..small("bowl64", "smooth_L15_blend_kfull")
    },
];

impl Case {
    fn scene(&self) -> Scene {
        let camera = (self.camera)();
        Scene::new(mesh(self.mesh), self.shading, camera, vec![(self.light)()])
    }

    fn reference(&self) -> [Vec<f64>; 2] {
        ["mean", "se"].map(|kind| {
            let values = npy(&format!("{}_{}_{kind}.npy", self.mesh, self.name));
            if !self.quarter {
                return values;
            }
            let rows = values.chunks(64).take(32);
            rows.flat_map(|row| &row[..32]).copied().collect()
        })
    }

    fn options(&self, scene: &Scene) -> RenderOptions {
        let mut options = RenderOptions {
            samples_per_pixel: self.samples,
            max_reflections: self.max_reflections,
            seed: 17,
            ..RenderOptions::default()
        };
        options.proposal = suited_proposal(scene, &(self.material)(), &options);
        options
    }

    /// Pixels whose relative standard error will be below 3%, and those that a crease or
    /// a silhouette crosses.
    fn choose(&self, scene: &Scene, options: &RenderOptions) -> Chosen {
        let pilot = RenderOptions {
            samples_per_pixel: (self.samples / 4).max(16),
            seed: 4711,
            ..options.clone()
        };
        let scale = f64::from(pilot.samples_per_pixel) / f64::from(self.samples);
        let pilot = render(scene, &(self.material)(), &pilot).remove(0);
        let [width, _] = scene.camera.resolution_px;
        let reliable = |i: usize| {
            let promised = (f64::from(pilot.variance[i][0]) * scale).sqrt();
            pilot.mean[i][0] > 0.0 && promised < 0.08 * f64::from(pilot.mean[i][0])
        };
        // Share of the footprint's points, corners included, that do not look like the first:
        // 0 where neither crease nor silhouette crosses the pixel.
        let crossed = |i: usize| {
            let corner = DVec2::new((i % width) as f64, (i / width) as f64);
            let normals: Vec<Option<Vec3>> = (0..49)
                .map(|k| {
                    let at = corner + DVec2::new(f64::from(k % 7), f64::from(k / 7)) / 6.0;
                    let hit = scene.first(&scene.camera.ray(at, DVec2::ZERO));
                    hit.map(|(surface, _)| surface.world(Vec3::Z))
                })
                .collect();
            let other = normals.iter().filter(|n| match (n, normals[0]) {
                (Some(n), Some(first)) => n.dot(first) < 0.9,
                (None, None) => false,
                _ => true,
            });
            other.count() as f64 / 49.0
        };
        let pixels = scene.camera.pixels();
        let crossed: Vec<f64> = (0..pixels).map(crossed).collect();
        let barely = |share: f64| share > 0.0 && !(0.15..=0.85).contains(&share);
        Chosen {
            reliable: (0..pixels)
                .map(|i| reliable(i) && !barely(crossed[i]))
                .collect(),
            crossed: crossed.iter().map(|&share| share > 0.0).collect(),
        }
    }
}

struct Chosen {
    reliable: Vec<bool>,
    crossed: Vec<bool>,
}

/// How an image compares with its reference.
#[derive(Debug)]
struct Agreement {
    pixels: usize,
    /// χ² over its degrees of freedom.
    reduced: f64,
    /// p of both tests of z.
    p_normal: f64,
    p_chi2: f64,
    /// Relative difference of the means and its standard error.
    mean_difference: f64,
    mean_error: f64,
    /// Largest relative difference where neither renderer has any noise.
    exact: f64,
}

impl Agreement {
    fn new(image: &RadianceImage, reference: &[Vec<f64>; 2], groups: f64, chosen: &Chosen) -> Self {
        let [mean, se] = reference;
        let mut z = Vec::new();
        let (mut total, mut expected, mut variance, mut exact) = (0.0, 0.0, 0.0, 0.0f64);
        for i in 0..mean.len() {
            let (ours, spread) = (f64::from(image.mean[i][0]), f64::from(image.variance[i][0]));
            total += ours;
            expected += mean[i];
            variance += spread + se[i] * se[i];
            if spread < 1e-12 * ours * ours && se[i] < 1e-6 * mean[i] {
                exact = exact.max((ours / mean[i] - 1.0).abs());
                continue;
            }
            if chosen.reliable[i] && mean[i] > 0.0 {
                let floor = if chosen.crossed[i] {
                    1e-3 * mean[i]
                } else {
                    0.0
                };
                let theirs = se[i] * se[i];
                let sum = spread + theirs + floor * floor;
                // Welch and Satterthwaite: only the reference's part has few groups.
                let freedom = (sum / theirs.max(1e-6 * sum)).powi(2) * (groups - 1.0);
                z.push(normal_score((ours - mean[i]) / sum.sqrt(), freedom));
            }
        }
        let chi2: f64 = z.iter().map(|z| z * z).sum();
        let n = z.len() as f64;
        Self {
            pixels: z.len(),
            reduced: chi2 / n,
            p_normal: anderson_darling(&z),
            p_chi2: two_sided(chi2_score(chi2, n)),
            mean_difference: total / expected - 1.0,
            mean_error: variance.sqrt() / expected,
            exact,
        }
    }

    fn passes(&self, significance: f64) -> bool {
        self.p_normal > significance
            && self.p_chi2 > significance
            && self.mean_difference.abs() < 3.0 * self.mean_error + 2e-4
            && self.exact < 2e-5
            && self.pixels >= 50
    }
}

fn significance() -> f64 {
    sidak(0.01, 2 * CASES.len())
}

#[test]
fn renders_agree_with_an_independent_renderer() {
    let mut failed = Vec::new();
    for case in CASES {
        let scene = case.scene();
        let options = case.options(&scene);
        let image = render(&scene, &(case.material)(), &options).remove(0);
        let chosen = case.choose(&scene, &options);
        let a = Agreement::new(&image, &case.reference(), case.groups, &chosen);
        let name = format!("{}_{}", case.mesh, case.name);
        println!(
            "{name:42} {:4} pixels, chi2/dof {:.3} (p {:.1e}), A² p {:.1e}, mean {:+.1e} ± {:.1e}",
            a.pixels, a.reduced, a.p_chi2, a.p_normal, a.mean_difference, a.mean_error
        );
        if !a.passes(significance()) {
            failed.push(format!("{name}: {a:?}"));
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

/// The blend of GGX lobes that the references have, with a lobe of one's own.
struct Altered(fn(f32, f32, &Cosines<f32>) -> f32);

impl Brdf for Altered {
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        let Some(at) = Cosines::new(to_light.to_array(), to_viewer.to_array()) else {
            return [0.0; 3];
        };
        let lobes = 0.35 * self.0(0.15, 1.5, &at) + 0.15 * self.0(0.4, 2.0, &at);
        [0.4 / std::f32::consts::PI + lobes; 3]
    }
}

/// A wrong lobe, or a variance that is stated 40% too small, fails the comparison.
#[test]
fn the_comparison_has_power() {
    let case = CASES
        .iter()
        .find(|c| c.name == "perspective_point_blend_kfull")
        .unwrap();
    let scene = case.scene();
    let options = case.options(&scene);
    let chosen = case.choose(&scene, &options);
    let reference = case.reference();
    let lobes: [(&str, Altered, bool); 4] = [
        ("none", Altered(ggx::eval), true),
        (
            "alpha squared",
            Altered(|a, n, at| ggx::eval(a * a, n, at)),
            false,
        ),
        (
            "one masking factor missing",
            Altered(|a, n, at| {
                ggx::distribution(a, at.sin2_h)
                    * ggx::masking_over_two_cos(a, at.cos_o)
                    * ggx::fresnel(n, at.cos_d)
                    / (2.0 * at.cos_i)
            }),
            false,
        ),
        (
            "Fresnel at normal incidence",
            Altered(|a, n, at| ggx::d_g(a, at.cos_i, at.cos_o, at.sin2_h) * ggx::fresnel(n, 1.0)),
            false,
        ),
    ];
    for (name, lobe, passes) in lobes {
        let mut image = render(&scene, &lobe, &options).remove(0);
        let a = Agreement::new(&image, &reference, case.groups, &chosen);
        println!("{name}: {a:?}");
        let z_passes = a.p_normal > significance() && a.p_chi2 > significance();
        assert_eq!(
            z_passes && a.passes(significance()),
            passes,
            "{name}: {a:?}"
        );
        assert_eq!(z_passes, passes, "the z alone decide {name}: {a:?}");
        if passes {
            image.variance.iter_mut().flatten().for_each(|v| *v *= 0.6);
            let a = Agreement::new(&image, &reference, case.groups, &chosen);
            println!("variance 40% low: {a:?}");
            assert!(!a.passes(significance()), "{a:?}");
        }
    }
}

/// The closed form of a Lambertian bowl, by reflections; the tessellation differs from
/// it by 0.11% rms in single pixels, which the mean of all does not see.
#[test]
fn lambertian_bowl_agrees_with_the_closed_form() {
    let scene = coaxial(case("bowl_concave", "")).scene();
    let mask = npy("analytic_bowl_L0_mask.npy");
    for (albedo, name, max_reflections) in [
        (0.9, "lambert09_K1", 1),
        (0.9, "lambert09_K2", 2),
        (0.9, "lambert09_K32", 32),
        (1.0, "lambert1_K32", 32),
    ] {
        let brdf = lambertian(albedo);
        let exact = npy(&format!("analytic_bowl_L0_{name}.npy"));
        let options = RenderOptions {
            samples_per_pixel: 128,
            max_reflections,
            seed: 23,
            proposal: Proposal::resembling(&brdf, 0.0),
            ..RenderOptions::default()
        };
        let image = render(&scene, &brdf, &options).remove(0);
        let (mut total, mut expected, mut variance) = (0.0, 0.0, 0.0);
        let (mut chi2, mut pixels) = (0.0, 0.0);
        for (i, _) in mask.iter().enumerate().filter(|&(_, &m)| m > 0.0) {
            let (ours, spread) = (f64::from(image.mean[i][0]), f64::from(image.variance[i][0]));
            total += ours;
            expected += exact[i];
            variance += spread;
            // Facets are tilted, up to 1.7%, towards the rim.
            let floor = 3e-3 * exact[i];
            chi2 += (ours - exact[i]).powi(2) / (spread + floor * floor);
            pixels += 1.0;
        }
        let difference = total / expected - 1.0;
        let error = variance.sqrt() / expected;
        let score = chi2_score(chi2, pixels);
        println!("{name}: mean {difference:+.1e} ± {error:.1e}, chi2 score {score:+.1}");
        assert!(
            difference.abs() < 3.0 * error + 2e-4,
            "{name}: {difference} ± {error}"
        );
        assert!(score < 4.0, "{name}: chi2 score {score}");
    }
}
