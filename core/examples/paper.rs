//! "Towards Reflectometry from Interreflections" (Shem-Tov, Bangaru, Levin, Gkioulekas):
//! its algorithm on one page, to be read next to the paper. Equation and section numbers are
//! the paper's.
//!
//! ```sh
//! cargo run --release -p rig-core --example paper
//! ```
//!
//! A concave sample of one unknown material is lit from known directions and photographed.
//! Light reaches the camera after one, two or more reflections, so each pixel depends on the
//! BRDF at many pairs of directions, and nonlinearly. The BRDF is taken to be a convex
//! combination of known ones, the atoms of a dictionary. We look for its weights α by
//! gradient descent on the difference between the photographs and a Monte Carlo rendering
//! that also estimates its own derivative.
//!
//! The library supplies what every path tracer has: the scene with its ray queries, the
//! values of the atoms, a density from which to draw directions, random numbers. Everything
//! that the paper is about stands below. `tests/fit/paper.rs` checks it against the library's
//! renderer and fit, which are made for speed: they trace paths once and reuse them in every
//! step (`transport::cache`), differentiate without division by f_r (docs/adr/0002), and take
//! Gauss–Newton steps (`inverse`).
//!
//! Where this page differs from the paper:
//! - *Indices.* The product in Eq. (6) and the sums in Eqs. (9) and (10) are printed with the
//!   last index K − 1. All K points reflect, so here they end at K. The renderings in Eqs. (4)
//!   and (13) are printed with the image I_m as their argument; it is the light l_m.
//! - *Sampling.* The paper uses bidirectional path tracing. We trace from the camera only and
//!   connect each point to the lights (next-event estimation).
//! - *Length.* Eq. (5) has paths of every length. We stop after [`Sampling::longest`]
//!   reflections.
//! - *Gradient.* The paper doesn't say how a noisy residual and a noisy derivative are
//!   multiplied. See [`loss`] for why they must come from different paths.
//! - *Descent.* The paper names exponentiated gradient with Adam's steps and gives no
//!   formula. See [`descend`] for ours.
//! - *Start.* The paper solves Eq. (13) as linear least squares. We run the same descent with
//!   paths of one reflection. Least squares also gives weights of exactly zero, which a
//!   multiplicative step can't change any more.
//! - *Colour.* We fit one channel. A colour image is three such fits.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use std::error::Error;
use std::sync::Arc;

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use rig_core::brdf::environment::EnvironmentMap;
use rig_core::brdf::evaluator::Evaluator;
use rig_core::brdf::ggx::Cosines;
use rig_core::brdf::score::environment_error;
use rig_core::brdf::{Atom, Dictionary, Mixture};
use rig_core::geometry::{Ray, Shape};
use rig_core::radiance_image::RadianceImage;
use rig_core::random::{Purpose, Stream, stream};
use rig_core::transport::{Camera, Light, Proposal, RenderOptions, Scene, Shading, render};

// ------------------------------------------------------- Section 3: what is known

/// Everything but the weights: shape, camera, lights and dictionary.
pub struct Known {
    /// Shape, camera and lights l_m, m = 1 … M.
    pub scene: Scene,
    /// {f_rⁿ}, n = 1 … N. The paper's has 42 entries ([`Dictionary::paper42`]).
    pub dictionary: Arc<Dictionary>,
    evaluator: Evaluator,
}

impl Known {
    /// A scene and the dictionary for its material.
    pub fn new(scene: Scene, dictionary: Dictionary) -> Self {
        let evaluator = dictionary.evaluator();
        let dictionary = Arc::new(dictionary);
        Self {
            scene,
            dictionary,
            evaluator,
        }
    }

    /// Eq. (3): f_r = Σ α_n f_rⁿ for a pair of directions; leaves the f_rⁿ in `atoms`.
    fn brdf(&self, weights: &[f64], incoming: Vec3, outgoing: Vec3, atoms: &mut [f32]) -> f64 {
        match Cosines::new(incoming.to_array(), outgoing.to_array()) {
            Some(cosines) => self.evaluator.eval(&cosines, atoms),
            None => atoms.fill(0.0), // one of them is below the horizon
        }
        let terms = weights.iter().zip(&*atoms);
        terms.map(|(weight, f)| weight * f64::from(*f)).sum()
    }
}

/// How paths are sampled.
#[derive(Clone)]
pub struct Sampling {
    /// Camera paths per pixel and estimate: P in Eqs. (11) and (12).
    pub paths: u32,
    /// Largest number K of reflections of a path. (In the bowl below, the light of paths of
    /// more than 8 hardly counts.)
    pub longest: u32,
    /// Density q from which the next direction of a path is drawn. It must be positive where
    /// f_r is; the more it resembles f_r cos θ, the less noise.
    pub q: Proposal,
    /// Different seeds give independent paths.
    pub seed: u64,
}

// ------------------------- Section 4: the image and its derivative with respect to α

/// One pixel of one image.
#[derive(Clone)]
pub struct Pixel {
    /// Eq. (5).
    pub radiance: f64,
    /// With respect to each α_n, Eq. (8).
    pub derivative: Vec<f64>,
}

/// Walks from the camera along `ray` through the sample. The paper numbers the points of a
/// path from the light, so the first point met is x_K. Every point met completes a path, by a
/// connection to the light, and is an inner point of the longer ones: one walk samples a path
/// of each length K for each light. For light m, adds f_p/q and f_p S_p/q of these paths, the
/// terms of the sums in Eqs. (11) and (12), to `pixels[m]`.
fn walk(
    known: &Known,
    weights: &[f64],
    sampling: &Sampling,
    ray: &Ray,
    random: &mut Stream,
    pixels: &mut [Pixel],
) {
    let scene = &known.scene;
    let mut atoms = vec![0.0; weights.len()];
    // Over the points so far: the product of Eq. (6) divided by q and by P, and the sum of
    // Eq. (10).
    let mut throughput = 1.0 / f64::from(sampling.paths);
    let mut score = vec![0.0; weights.len()];
    let mut next = scene.first(ray);
    for _ in 0..sampling.longest {
        // x_k, and the direction towards x_{k+1} in the frame of its normal.
        let Some((point, outgoing)) = next else {
            return;
        };

        // Complete a path: x_k is its x_1, lit by light m. `connect` gives the irradiance
        // with G(x_0, x_1), which for a directional light is cosine times visibility, without
        // 1/r². (The two numbers would choose a point on a light of some extent.)
        for (m, pixel) in pixels.iter_mut().enumerate() {
            let Some(light) = scene.connect(&point, m, [0.5; 2]) else {
                continue;
            };
            let f = known.brdf(weights, light.to_light, outgoing, &mut atoms);
            if f > 0.0 {
                let irradiance = f64::from(light.irradiance) * scene.lights[m].strength()[0];
                let contribution = throughput * f * irradiance;
                pixel.radiance += contribution;
                for (n, derivative) in pixel.derivative.iter_mut().enumerate() {
                    *derivative += contribution * (score[n] + f64::from(atoms[n]) / f);
                }
            }
        }

        // Go on to x_{k−1}, in a direction drawn from q. Eq. (11) has a density over surface
        // area, q is one over solid angle: the factor between them cancels 1/r² and one cosine
        // of Eq. (7). What remains is f_r cos θ / q. V is in the ray query `next`.
        let Some((incoming, q)) = sampling.q.sample(outgoing, random) else {
            return;
        };
        let f = known.brdf(weights, incoming, outgoing, &mut atoms);
        if f <= 0.0 {
            return;
        }
        throughput *= f * f64::from(incoming.z / q);
        for (score, atom) in score.iter_mut().zip(&atoms) {
            *score += f64::from(*atom) / f;
        }
        next = scene.next(&point, incoming);
    }
}

/// Eqs. (11) and (12): one pixel of each of the M images, averaged over P paths. The two
/// estimates with `half` 0 and 1 are independent.
///
/// The weights must be positive, as exponentiated gradient keeps them: Eq. (10) divides by
/// f_r, which then is zero only where all atoms are.
pub fn estimate(
    known: &Known,
    weights: &[f64],
    sampling: &Sampling,
    pixel: usize,
    half: u64,
) -> Vec<Pixel> {
    let camera = &known.scene.camera;
    let dark = Pixel {
        radiance: 0.0,
        derivative: vec![0.0; weights.len()],
    };
    let mut images = vec![dark; known.scene.lights.len()];
    for path in 0..sampling.paths {
        let (key, path) = (pixel as u64, u64::from(path));
        let mut random = stream(sampling.seed, Purpose::PathDirection, half, key, path);
        let place = DVec2::new(random.uniform(), random.uniform());
        let pinhole = DVec2::splat(0.5); // would be a point on a wide lens
        let ray = camera.ray_of_pixel(pixel, place, pinhole);
        walk(known, weights, sampling, &ray, &mut random, &mut images);
    }
    images
}

/// Unbiased estimates of the loss of Eq. (4) and of its gradient, for the photographs
/// `captured[m][pixel]`.
///
/// The gradient of (I − R)² is −2 (I − R) ∂R/∂α, a product of two integrals. If the same paths
/// estimate both, their errors are correlated and the product is wrong by their covariance
/// on average: descent would then minimise the squared difference plus the variance of R, and
/// prefer materials that render with little noise. So we take two independent estimates a, b:
///
/// loss = Σ (I − R_a)(I − R_b),
/// ∂loss/∂α_n = −Σ [(I − R_a) ∂R_b/∂α_n + (I − R_b) ∂R_a/∂α_n].
///
/// For given paths the second line is exactly the derivative of the first.
pub fn loss(
    known: &Known,
    captured: &[Vec<f64>],
    weights: &[f64],
    sampling: &Sampling,
) -> (f64, Vec<f64>) {
    let of_pixel = |p: usize| {
        let [a, b] = [0, 1].map(|half| estimate(known, weights, sampling, p, half));
        let (mut loss, mut gradient) = (0.0, vec![0.0; weights.len()]);
        for ((image, a), b) in captured.iter().zip(&a).zip(&b) {
            let (residual_a, residual_b) = (image[p] - a.radiance, image[p] - b.radiance);
            loss += residual_a * residual_b;
            for (n, sum) in gradient.iter_mut().enumerate() {
                *sum -= residual_a * b.derivative[n] + residual_b * a.derivative[n];
            }
        }
        (loss, gradient)
    };
    let pixels = (0..captured[0].len()).into_par_iter().map(of_pixel);
    let pixels: Vec<(f64, Vec<f64>)> = pixels.collect();
    let loss = pixels.iter().map(|pixel| pixel.0).sum();
    let gradient = (0..weights.len()).map(|n| pixels.iter().map(|pixel| pixel.1[n]).sum());
    (loss, gradient.collect())
}

// --------------------------------------------- Section 4: optimization procedure

/// Exponentiated gradient [70] with Adam's steps [72] from the positive weights `start`:
///
/// α_n ← α_n exp(−η m_n/√v_n) / Σ_k α_k exp(−η m_k/√v_k),
///
/// where m and v are Adam's running means of the gradient and of its square, and η is the
/// learning rate. The exponential keeps the weights positive, the division keeps their sum one.
///
/// Every step draws new paths, so that no step fits the noise of the one before. Their
/// density q is made to resemble the current material (`sampling.q` is not used). It counts as
/// fixed in the derivative: the expectation of Eq. (11) doesn't depend on q.
pub fn descend(
    known: &Known,
    captured: &[Vec<f64>],
    start: &[f64],
    sampling: &Sampling,
    steps: u32,
) -> Result<Vec<f64>, Box<dyn Error>> {
    const RATE: f64 = 0.1; // η at the first step
    const DECAYS: [f64; 2] = [0.9, 0.999]; // β₁ and β₂ as in [72]
    let mut weights = start.to_vec();
    let [mut m, mut v] = [vec![0.0; weights.len()], vec![0.0; weights.len()]];
    for step in 0..steps {
        let mixture = Mixture::grey(known.dictionary.clone(), weights.clone())?;
        let sampling = Sampling {
            q: Proposal::resembling(&mixture, 0.2),
            seed: sampling.seed + u64::from(step),
            ..sampling.clone()
        };
        let (_, gradient) = loss(known, captured, &weights, &sampling);
        // As the sum stays one, only differences between the components matter. Adam scales
        // all components to about the same size, and a large common part would drown them. We
        // subtract it as the mean over the mixture, which all used atoms share at the minimum.
        let common: f64 = gradient.iter().zip(&weights).map(|(g, w)| g * w).sum();
        // The rate falls to zero, so that the noise of the gradients averages out.
        let rate = RATE * (1.0 - f64::from(step) / f64::from(steps));
        for n in 0..weights.len() {
            let g = gradient[n] - common;
            m[n] = DECAYS[0] * m[n] + (1.0 - DECAYS[0]) * g;
            v[n] = DECAYS[1] * v[n] + (1.0 - DECAYS[1]) * g * g;
            // The running means begin at zero; Adam corrects the bias from that.
            let [m, v] = [(m[n], DECAYS[0]), (v[n], DECAYS[1])]
                .map(|(mean, decay)| mean / (1.0 - decay.powi(step as i32 + 1)));
            weights[n] *= (-rate * m / (v.sqrt() + 1e-12)).exp();
        }
        let sum: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= sum);
    }
    Ok(weights)
}

/// The weights of the single-bounce start, Eq. (13), and those of the whole algorithm.
pub fn fit(
    known: &Known,
    captured: &[Vec<f64>],
    sampling: &Sampling,
    steps: u32,
) -> Result<[Vec<f64>; 2], Box<dyn Error>> {
    let n = known.dictionary.len();
    let uniform = vec![1.0 / n as f64; n];
    let direct = Sampling {
        longest: 1,
        ..sampling.clone()
    };
    let start = descend(known, captured, &uniform, &direct, steps)?;
    let found = descend(known, captured, &start, sampling, steps)?;
    Ok([start, found])
}

// ------------------------------------------------------------- A small experiment

/// A bowl under an orthographic camera and two directional lights, M = 2.
pub fn bowl(segments: u32, size_px: usize) -> Result<Scene, Box<dyn Error>> {
    let mesh = Shape::Bowl {
        radius_mm: 1.0,
        segments,
    }
    .mesh()?;
    let camera = Camera::above([size_px; 2], DVec2::splat(1.9), 5.0);
    let light = |to_light: DVec3| Light::distant(to_light, [1.0; 3]);
    let lights = vec![light(DVec3::Z), light(DVec3::new(0.5, 0.2, 1.0))];
    Ok(Scene::new(mesh, Shading::Smooth, camera, lights))
}

/// Microfacet lobes of three widths and two indices of refraction, white, black (Sec. 3.1).
pub fn dictionary() -> Result<Dictionary, Box<dyn Error>> {
    let lobe = |eta| [0.1, 0.2, 0.4].map(|alpha| Atom::Ggx { alpha, eta });
    let mut atoms = [lobe(2.0), lobe(10.0)].concat();
    atoms.extend([Atom::Lambertian { albedo: 1.0 }, Atom::Black]);
    Ok(Dictionary::new("eight", atoms)?)
}

/// The weights of the material to be found.
pub const TRUTH: [f64; 8] = [0.0, 0.2, 0.0, 0.0, 0.0, 0.3, 0.4, 0.1];

/// The synthetic photographs I_m. They come from another renderer than the fit's (the
/// library's), with other paths and from a finer mesh, so that the fit can't profit from
/// repeating their errors.
pub fn capture(truth: &Mixture, size_px: usize) -> Result<Vec<Vec<f64>>, Box<dyn Error>> {
    let options = RenderOptions {
        samples_per_pixel: 1024,
        proposal: Proposal::resembling(truth, 0.1),
        seed: 71,
        ..RenderOptions::default()
    };
    let images = render(&bowl(192, size_px)?, truth, &options);
    let red = |image: RadianceImage| image.mean.iter().map(|rgb| f64::from(rgb[0])).collect();
    Ok(images.into_iter().map(red).collect())
}

fn main() -> Result<(), Box<dyn Error>> {
    let size_px = 24;
    let known = Known::new(bowl(96, size_px)?, dictionary()?);
    let material = |weights: &[f64]| Mixture::grey(known.dictionary.clone(), weights.to_vec());
    let truth = material(&TRUTH)?;
    let captured = capture(&truth, size_px)?;

    let sampling = Sampling {
        paths: 8,
        longest: 8,
        q: Proposal::default(),
        seed: 1,
    };
    let [start, found] = fit(&known, &captured, &sampling, 300)?;

    // The three lobes of index 2 reflect little and look alike: the descent finds the sum of
    // their weights long before it separates them, and the material looks right by then.
    println!("atom                                  true   Eq. (13)  found");
    for (n, atom) in known.dictionary.atoms().iter().enumerate() {
        let atom = format!("{atom:?}");
        println!(
            "{atom:36} {:6.3}   {:6.3}   {:6.3}",
            TRUTH[n], start[n], found[n]
        );
    }
    // As in Fig. 4: how different a sphere of the material looks under environment maps.
    let maps = EnvironmentMap::all();
    for (name, weights) in [
        ("Eq. (13), single bounce", start),
        ("with interreflections", found),
    ] {
        let error = environment_error(&material(&weights)?, &truth, &maps, 32);
        println!("environment error, {name}: {:.2} %", 100.0 * error.mean.all);
    }
    Ok(())
}
