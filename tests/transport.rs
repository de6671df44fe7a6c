//! Light transport against an independent renderer and closed forms.
//!
//! Each image gives a χ² of per-pixel z-scores; the whole table is tested at a
//! family significance of 1e-4 (Šidák). On failure the images are left in the
//! temporary folder.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec2, DVec3};
use rig::brdf::Brdf;
use rig::brdf::dictionary::{Atom, Dictionary};
use rig::brdf::ggx::{self, Cosines};
use rig::brdf::mixture::Mixture;
use rig::geometry::{Mesh, files};
use rig::radiance_image::RadianceImage;
use rig::transport::{
    Cache, CacheOptions, Camera, DirectMatrix, Kernel, Light, Projection, Proposal, RenderOptions,
    Scene, Shading, render,
};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data/references")
        .join(name)
}

/// The numbers of a NumPy file of f64 or bytes.
fn npy(name: &str) -> Vec<f64> {
    let bytes = std::fs::read(data(name)).unwrap();
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]])) + 10;
    let text = String::from_utf8_lossy(&bytes[10..header]);
    let body = &bytes[header..];
    if text.contains("<f8") {
        body.chunks_exact(8)
            .map(|c| f64::from_le_bytes(c.try_into().unwrap()))
            .collect()
    } else {
        assert!(text.contains("|b1") || text.contains("|u1"), "{text}");
        body.iter().map(|&b| f64::from(b)).collect()
    }
}

fn scene(mesh: Mesh, oblique: bool) -> Scene {
    let camera = Camera::looking_at(
        [64, 64],
        Projection::Orthographic {
            extent_mm: DVec2::splat(2.2),
        },
        DVec3::new(0.0, 0.0, 5.0),
        DVec3::ZERO,
        DVec3::Y,
    )
    .unwrap();
    let (theta, phi) = if oblique {
        (25f64.to_radians(), 20f64.to_radians())
    } else {
        (0.0, 0.0)
    };
    let to_light = DVec3::new(
        theta.sin() * phi.cos(),
        theta.sin() * phi.sin(),
        theta.cos(),
    );
    let light = Light::Directional {
        to_light,
        irradiance: [1.0; 3],
        angular_radius_rad: 0.0,
    };
    Scene::new(mesh, Shading::Flat, camera, vec![light])
}

fn reference_mesh(name: &str) -> Mesh {
    files::read(&data(name), 1.0).unwrap()
}

fn mixture(atoms: &[(f64, Atom)]) -> Mixture {
    let dictionary = Dictionary::new("test", atoms.iter().map(|a| a.1).collect()).unwrap();
    Mixture::grey(Arc::new(dictionary), atoms.iter().map(|a| a.0).collect()).unwrap()
}

fn blend() -> Mixture {
    mixture(&[
        (0.4, Atom::Lambertian { albedo: 1.0 }),
        (
            0.35,
            Atom::Ggx {
                alpha: 0.15,
                eta: 1.5,
            },
        ),
        (
            0.15,
            Atom::Ggx {
                alpha: 0.4,
                eta: 2.0,
            },
        ),
        (0.1, Atom::Black),
    ])
}

fn ggx015() -> Mixture {
    mixture(&[(
        1.0,
        Atom::Ggx {
            alpha: 0.15,
            eta: 1.5,
        },
    )])
}

fn lambertian(albedo: f64) -> Mixture {
    mixture(&[(1.0, Atom::Lambertian { albedo })])
}

/// χ² of z-scores over the pixels that both renderers see, its degrees of freedom, and
/// the relative difference of the means with its standard error.
struct Agreement {
    chi2: f64,
    pixels: f64,
    mean_difference: f64,
    mean_error: f64,
}

/// Pixels along creases and silhouettes get the reference's own systematic floor of 1e-3.
fn compare(image: &RadianceImage, mean: &[f64], se: &[f64]) -> Agreement {
    let (mut chi2, mut pixels) = (0.0, 0.0);
    let (mut total, mut total_reference, mut variance) = (0.0, 0.0, 0.0);
    for (i, (&reference, &error)) in mean.iter().zip(se).enumerate() {
        let (ours, ours_variance) = (f64::from(image.mean[i][0]), f64::from(image.variance[i][0]));
        total += ours;
        total_reference += reference;
        variance += ours_variance + error * error;
        // Where a few rare paths carry the light, an estimated variance says little.
        let reliable = ours_variance.sqrt().max(error) < 0.1 * reference;
        if reference > 0.0 && ours_variance > 0.0 && reliable {
            let floor = 1e-3 * reference;
            chi2 += (ours - reference).powi(2) / (ours_variance + error * error + floor * floor);
            pixels += 1.0;
        }
    }
    Agreement {
        chi2,
        pixels,
        mean_difference: total / total_reference - 1.0,
        mean_error: variance.sqrt() / total_reference,
    }
}

/// Standard score of a χ² (Wilson–Hilferty).
fn chi2_score(chi2: f64, dof: f64) -> f64 {
    let k = 2.0 / (9.0 * dof);
    ((chi2 / dof).cbrt() - (1.0 - k)) / k.sqrt()
}

struct Case {
    mesh: &'static str,
    reference: &'static str,
    oblique: bool,
    max_reflections: u32,
    material: fn() -> Mixture,
    samples: u32,
}

const CASES: &[Case] = &[
    Case {
        mesh: "tet_concave.ply",
        reference: "tet_concave_L25_blend_k1",
        oblique: true,
        max_reflections: 1,
        material: blend,
        samples: 64,
    },
    Case {
        mesh: "tet_concave.ply",
        reference: "tet_concave_L25_blend_k2",
        oblique: true,
        max_reflections: 2,
        material: blend,
        samples: 512,
    },
    Case {
        mesh: "tet_concave.ply",
        reference: "tet_concave_L25_blend_kfull",
        oblique: true,
        max_reflections: 32,
        material: blend,
        samples: 512,
    },
    Case {
        mesh: "tet_concave.ply",
        reference: "tet_concave_L25_lambert1_kfull",
        oblique: true,
        max_reflections: 32,
        material: || lambertian(1.0),
        samples: 256,
    },
    Case {
        mesh: "tet_concave.ply",
        reference: "tet_concave_L25_ggx015_kfull",
        oblique: true,
        max_reflections: 32,
        material: ggx015,
        samples: 1024,
    },
    Case {
        mesh: "tet_convex.ply",
        reference: "tet_convex_L25_blend_k1",
        oblique: true,
        max_reflections: 8,
        material: blend,
        samples: 64,
    },
    Case {
        mesh: "bowl_concave.ply",
        reference: "bowl_concave_L0_blend_k1",
        oblique: false,
        max_reflections: 1,
        material: blend,
        samples: 128,
    },
    Case {
        mesh: "bowl_concave.ply",
        reference: "bowl_concave_L0_blend_k2",
        oblique: false,
        max_reflections: 2,
        material: blend,
        samples: 512,
    },
    Case {
        mesh: "bowl_concave.ply",
        reference: "bowl_concave_L0_blend_kfull",
        oblique: false,
        max_reflections: 32,
        material: blend,
        samples: 512,
    },
];

fn rendered(case: &Case, brdf: &Mixture) -> RadianceImage {
    rendered_with(case, brdf, brdf)
}

fn rendered_with(case: &Case, brdf: &dyn Brdf, like: &Mixture) -> RadianceImage {
    let scene = scene(reference_mesh(case.mesh), case.oblique);
    let options = RenderOptions {
        samples_per_pixel: case.samples,
        max_reflections: case.max_reflections,
        seed: 17,
        proposal: Proposal::resembling(like, 0.1),
    };
    render(&scene, brdf, &options, &|_| {}).remove(0)
}

#[test]
fn renders_agree_with_an_independent_renderer() {
    // Two tests per case, family significance 1e-5 two-sided.
    let limit = 5.0;
    let mut failed = Vec::new();
    for case in CASES {
        let image = rendered(case, &(case.material)());
        let (mean, se) = (
            npy(&format!("{}_mean.npy", case.reference)),
            npy(&format!("{}_se.npy", case.reference)),
        );
        let a = compare(&image, &mean, &se);
        let score = chi2_score(a.chi2, a.pixels);
        let mean_z = a.mean_difference / a.mean_error.hypot(2e-4);
        println!(
            "{:34} chi2/dof {:.3} over {} (score {score:+.1}), mean {:+.1e} ± {:.1e}",
            case.reference,
            a.chi2 / a.pixels,
            a.pixels,
            a.mean_difference,
            a.mean_error
        );
        // A floor makes χ² small where it dominates, so only an excess fails.
        if score > limit || mean_z.abs() > limit || a.pixels < 100.0 {
            failed.push(format!(
                "{}: score {score:.1}, mean z {mean_z:.1}",
                case.reference
            ));
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

/// The comparison must notice a wrong renderer: each mutant of the GGX lobe fails it.
#[test]
fn the_comparison_has_power() {
    /// A lobe of (alpha, eta).
    struct Mutant(fn(f32, f32, &Cosines<f32>) -> f32);
    impl Brdf for Mutant {
        fn eval(&self, to_light: glam::Vec3, to_viewer: glam::Vec3) -> [f32; 3] {
            let Some(at) = Cosines::new(to_light.to_array(), to_viewer.to_array()) else {
                return [0.0; 3];
            };
            let lobes = 0.35 * self.0(0.15, 1.5, &at) + 0.15 * self.0(0.4, 2.0, &at);
            [0.4 / std::f32::consts::PI + lobes; 3]
        }
    }
    let case = &CASES[8];
    let reference = ["mean", "se"].map(|k| npy(&format!("{}_{k}.npy", case.reference)));
    let mutants: [(&str, Mutant, bool); 4] = [
        ("none", Mutant(ggx::eval), true),
        (
            "alpha squared",
            Mutant(|a, n, at| ggx::eval(a * a, n, at)),
            false,
        ),
        (
            "no masking",
            Mutant(|a, n, at| {
                ggx::distribution(a, at.sin2_h) * ggx::fresnel(n, at.cos_d)
                    / (4.0 * at.cos_i * at.cos_o)
            }),
            false,
        ),
        (
            "Fresnel at normal incidence",
            Mutant(|a, n, at| ggx::d_g(a, at.cos_i, at.cos_o, at.sin2_h) * ggx::fresnel(n, 1.0)),
            false,
        ),
    ];
    for (name, mutant, passes) in mutants {
        let image = rendered_with(case, &mutant, &blend());
        let a = compare(&image, &reference[0], &reference[1]);
        let score =
            chi2_score(a.chi2, a.pixels).max(a.mean_difference.abs() / a.mean_error.hypot(2e-4));
        println!("{name}: score {score:.1}");
        assert_eq!(score < 5.0, passes, "{name} has score {score}");
    }
}

/// The closed form of a Lambertian bowl, by reflections; the tessellation differs from
/// it by 0.11% rms (1.7% at most), which enters as a floor per pixel.
#[test]
fn lambertian_bowl_agrees_with_the_closed_form() {
    let scene = scene(reference_mesh("bowl_concave.ply"), false);
    let mask = npy("analytic_bowl_L0_mask.npy");
    let brdf = lambertian(0.9);
    for (name, max_reflections) in [("K1", 1), ("K2", 2), ("K32", 32)] {
        let exact = npy(&format!("analytic_bowl_L0_lambert09_{name}.npy"));
        let options = RenderOptions {
            samples_per_pixel: 256,
            max_reflections,
            seed: 23,
            proposal: Proposal::resembling(&brdf, 0.0),
        };
        let image = render(&scene, &brdf, &options, &|_| {}).remove(0);
        let (mut total, mut expected, mut variance) = (0.0, 0.0, 0.0);
        for (i, _) in mask.iter().enumerate().filter(|&(_, &m)| m > 0.0) {
            total += f64::from(image.mean[i][0]);
            expected += exact[i];
            variance += f64::from(image.variance[i][0]);
        }
        let difference = total / expected - 1.0;
        let error = variance.sqrt() / expected;
        println!("{name}: mean {difference:+.1e} ± {error:.1e}");
        assert!(
            difference.abs() < 4.0 * error.hypot(1e-4),
            "{name}: {difference} ± {error}"
        );
    }
}

/// Image of the cached paths plus the direct matrix against the plain renderer, for
/// both record layouts, with the fit's own (unadapted) proposal in the cache.
#[test]
fn cached_paths_give_the_rendered_image() {
    let scene = scene(reference_mesh("tet_concave.ply"), true);
    for (dictionary, weights) in [
        (
            Dictionary::reference_grid42(),
            vec![(16, 0.35), (32, 0.15), (40, 0.4), (41, 0.1)],
        ),
        (
            Dictionary::paper42(),
            vec![(1, 0.3), (6, 0.3), (40, 0.3), (41, 0.1)],
        ),
    ] {
        let mut w = vec![0.0; dictionary.len()];
        weights.iter().for_each(|&(i, v): &(usize, f64)| w[i] = v);
        let truth = Mixture::grey(Arc::new(dictionary.clone()), w.clone()).unwrap();
        let options = RenderOptions {
            samples_per_pixel: 2048,
            max_reflections: 8,
            seed: 5,
            proposal: Proposal::resembling(&truth, 0.1),
        };
        let image = render(&scene, &truth, &options, &|_| {}).remove(0);
        let options = CacheOptions {
            samples_per_pixel: 512,
            max_reflections: 8,
            ..CacheOptions::default()
        };
        let cache = Cache::trace(&scene, &dictionary, &options).unwrap();
        let direct = DirectMatrix::new(&scene, &dictionary, 16, 3);
        let pixels: Vec<_> = cache
            .evaluate(Kernel::detect(), &[&w], Vec::new, |out, rows| {
                out.push((
                    0.5 * (rows.value[0][0] + rows.value[1][0]),
                    rows.variance[0],
                ));
            })
            .concat();
        let (mut chi2, mut n) = (0.0, 0.0);
        for (i, &(value, variance)) in pixels.iter().enumerate() {
            let direct: f64 = direct
                .row(i, 0)
                .iter()
                .zip(&w)
                .map(|(&d, &w)| f64::from(d) * w)
                .sum();
            let (ours, theirs) = (f64::from(value) + direct, f64::from(image.mean[i][0]));
            let spread = f64::from(variance) + f64::from(image.variance[i][0]);
            if spread > 0.0 && spread.sqrt() < 0.1 * theirs && direct.min(1.0) > 0.0 {
                chi2 += (ours - theirs).powi(2) / (spread + (2e-3 * theirs).powi(2));
                n += 1.0;
            }
        }
        let score = chi2_score(chi2, n);
        println!(
            "{}: chi2/dof {:.3} over {n} (score {score:+.1})",
            dictionary.name(),
            chi2 / n
        );
        assert!(
            n > 500.0 && score.abs() < 4.5,
            "{}: score {score}",
            dictionary.name()
        );
    }
}
