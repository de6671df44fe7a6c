//! Fits of rendered images whose material the dictionary holds: the truth must come
//! back, better than the single-bounce start, by either optimiser.
//!
//! The images are rendered with other paths and a finer mesh than the fit uses.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::{DVec2, DVec3};
use rig_core::brdf::discrepancy::Material;
use rig_core::brdf::score::{brdf_errors, cells};
use rig_core::brdf::{Atom, Brdf, Dictionary, Mixture};
use rig_core::cells::AverageError;
use rig_core::cells::{Captured, CellOptions};
use rig_core::example;
use rig_core::geometry::shapes::Form;
use rig_core::geometry::{FormError, Shape};
use rig_core::inverse::budget::Source;
use rig_core::inverse::exponentiated_gradient::ExponentiatedGradient;
use rig_core::inverse::findings::Finding;
use rig_core::inverse::variance_shares;
use rig_core::inverse::{Channels, Fit, FitOptions, Optimizer, fit, fit_with_progress, intervals};
use rig_core::progress::Progress;
use rig_core::radiance_image::RadianceImage;
use rig_core::transport::{Camera, Light, Proposal, RenderOptions, Scene, Shading, render};

fn scene(shape: Shape, directions: &[DVec3]) -> Scene {
    scene_of(24, shape, directions)
}

/// With so many pixels per side.
fn scene_of(size: usize, shape: Shape, directions: &[DVec3]) -> Scene {
    let camera = Camera::above([size; 2], DVec2::splat(2.2), 5.0);
    let lights = directions
        .iter()
        .map(|d| Light::distant(*d, [1.0, 2.0, 0.5]))
        .collect();
    Scene::new(shape.mesh().unwrap(), Shading::Smooth, camera, lights)
}

fn bowl(segments: u32) -> Shape {
    Shape::Bowl {
        radius_mm: 1.0,
        segments,
    }
}

fn designed(segments: u32) -> Shape {
    Shape::Designed {
        radius_mm: 0.32,
        offset: 0.5,
        phi_min_deg: 45.0,
        form: Form::Extruded,
        length_mm: 2.0,
        segments,
    }
}

/// Bright, so that interreflection matters; three different channels.
fn truth(dictionary: &Arc<Dictionary>) -> Mixture {
    let channel = |parts: &[(usize, f64)]| {
        let mut weights = vec![0.0; dictionary.len()];
        parts.iter().for_each(|&(atom, w)| weights[atom] = w);
        weights
    };
    let weights = [
        channel(&[(5, 0.35), (24, 0.5), (25, 0.15)]),
        channel(&[(13, 0.2), (8, 0.2), (24, 0.5), (25, 0.1)]),
        channel(&[(6, 0.25), (24, 0.65), (25, 0.1)]),
    ];
    Mixture::new(dictionary.clone(), weights).unwrap()
}

fn images(scene: &Scene, material: &Mixture) -> Vec<RadianceImage> {
    let options = RenderOptions {
        samples_per_pixel: 1024,
        max_reflections: 12,
        seed: 71,
        proposal: Proposal::resembling(material, 0.1),
        ..RenderOptions::default()
    };
    render(scene, material, &options)
}

fn options() -> FitOptions {
    let mut options = FitOptions::default();
    options.cache.samples_per_cell = 256;
    options.cache.max_reflections = 12;
    options.model_error = 0.005;
    options
}

/// One round of an optimiser, and nothing after it.
fn one_round(optimizer: Optimizer, channels: Channels) -> FitOptions {
    FitOptions {
        optimizer,
        channels,
        rounds: 1,
        adapt_paths: false,
        posterior_samples: 20,
        ..options()
    }
}

/// Cube-root BRDF error over all channels: of the fit, of its start.
fn errors(fit: &Fit, dictionary: &Arc<Dictionary>, truth: &Mixture) -> [f64; 2] {
    let cells = cells(6);
    let start = Mixture::new(dictionary.clone(), fit.start.clone()).unwrap();
    let brdfs: [&dyn Brdf; 2] = [&fit.material, &start];
    brdfs.map(|brdf| brdf_errors(brdf, truth, &cells).cube_root.all)
}

fn averaged(scene: &Scene, images: &[RadianceImage]) -> Captured {
    Captured::new(scene, images, &CellOptions::exact()).unwrap()
}

#[test]
fn the_truth_comes_back_through_interreflections() {
    let dictionary = Arc::new(Dictionary::rig26());
    let truth = truth(&dictionary);
    let oblique = DVec3::new(0.5, 0.2, 1.0);
    for (name, shape, fine, lights, limit) in [
        ("bowl", bowl(96), bowl(192), vec![DVec3::Z, oblique], 0.02),
        (
            "designed",
            designed(64),
            designed(128),
            vec![DVec3::Z],
            0.02,
        ),
    ] {
        let captured = images(&scene(fine, &lights), &truth);
        let scene = scene(shape, &lights);
        let fit = fit(
            &scene,
            &averaged(&scene, &captured),
            &dictionary,
            &options(),
        )
        .unwrap();
        let [error, start] = errors(&fit, &dictionary, &truth);
        let theta: Vec<f64> = (0..9).map(|i| 10.0 * f64::from(i)).collect();
        let cells = intervals::table(&fit.material, &fit.posterior_samples, &theta, &theta, 90.0);
        let constrained = cells.iter().filter(|c| c.constrained).count();
        println!(
            "{name}: cube-root error {error:.4}, start {start:.4}, constrained {constrained} of {}, chi2 {:?}",
            cells.len(),
            fit.comparison.reduced_chi2()
        );
        assert!(error < limit, "{name}: {error}");
        assert!(
            error < 0.5 * start,
            "{name}: {error} against the start's {start}"
        );
        // Cells of one fit err together, so fewer than 95% may hold the truth; and hardly
        // any is told much better than by the prior of few atoms (docs/adr/0006).
        let true_cells =
            intervals::table(&Material::from(truth.clone()), &[], &theta, &theta, 90.0);
        let held = cells.iter().zip(&true_cells).flat_map(|(cell, truth)| {
            (0..3).map(move |c| (cell.lower[c]..=cell.upper[c]).contains(&truth.value[c]))
        });
        let missed = held.filter(|held| !held).count();
        println!("{name}: {missed} of {} intervals miss", 3 * cells.len());
        assert!(
            missed * 4 < 3 * cells.len(),
            "{name}: {missed} intervals miss"
        );
        assert!(constrained > 0, "{name}: no cell is constrained");
        for weights in fit.material.mixture.weights().iter().chain(&fit.start) {
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-9);
            assert!(weights.iter().all(|&w| w >= 0.0));
        }
    }
}

#[test]
fn both_optimisers_lower_the_same_loss() {
    let dictionary = Arc::new(Dictionary::rig26());
    let truth = truth(&dictionary);
    let lights = [DVec3::Z];
    let captured = images(&scene(bowl(192), &lights), &truth);
    let scene = scene(bowl(96), &lights);
    let run = |optimizer: Optimizer, channels| {
        let options = one_round(optimizer, channels);
        let fit = fit(&scene, &averaged(&scene, &captured), &dictionary, &options).unwrap();
        let total = |i: usize| -> f64 { fit.trace[i].1.loss.iter().sum() };
        (total(0), total(fit.trace.len() - 1), fit)
    };
    let gauss_newton = options().optimizer;
    let (first, last, _) = run(gauss_newton.clone(), Channels::Separate);
    assert!(last < 0.1 * first, "Gauss-Newton: {first} to {last}");
    let gradient = ExponentiatedGradient {
        max_steps: 60,
        ..ExponentiatedGradient::default()
    };
    let (first, slower, _) = run(
        Optimizer::ExponentiatedGradient(gradient),
        Channels::Separate,
    );
    assert!(
        slower < 0.5 * first,
        "exponentiated gradient: {first} to {slower}"
    );
    assert!(
        last <= slower,
        "Gauss-Newton {last}, exponentiated gradient {slower}"
    );
    // One set for three different channels cannot do as well.
    let (_, shared, fit) = run(gauss_newton, Channels::Shared);
    let [red, _, blue] = fit.material.mixture.weights();
    assert_eq!(red, blue);
    assert!(shared > last, "shared {shared}, separate {last}");
}

/// What is returned is never worse than the best point on the way by more than 1%, also
/// with steps so long that the loss rises again and again.
#[test]
fn the_last_point_is_as_good_as_the_best() {
    let dictionary = Arc::new(Dictionary::rig26());
    let lights = [DVec3::Z];
    let captured = images(&scene(bowl(192), &lights), &truth(&dictionary));
    let scene = scene(bowl(96), &lights);
    let restless = ExponentiatedGradient {
        max_steps: 40,
        rate: 1.0,
        ..ExponentiatedGradient::default()
    };
    for optimizer in [
        options().optimizer,
        Optimizer::ExponentiatedGradient(restless),
    ] {
        let options = one_round(optimizer, Channels::Separate);
        let fit = fit(&scene, &averaged(&scene, &captured), &dictionary, &options).unwrap();
        let mut rises = 0;
        for set in 0..3 {
            let losses: Vec<f64> = fit.trace.iter().map(|(_, step)| step.loss[set]).collect();
            let best = losses.iter().copied().fold(f64::INFINITY, f64::min);
            let last = losses[losses.len() - 1];
            let name = options.optimizer.name();
            println!("{name}, channel {set}: last {last:.2}, best {best:.2}");
            assert!(last - best <= 0.01 * best.abs(), "{name}: {last}, {best}");
            rises += losses.windows(2).filter(|pair| pair[1] > pair[0]).count();
        }
        if matches!(options.optimizer, Optimizer::ExponentiatedGradient(_)) {
            assert!(rises > 10, "the loss rose {rises} times only: no trial");
        }
    }
}

/// Specks in one pixel of fifty, as bright as three times the surface or black, that no
/// variance tells of: the material is found as without them, and told of.
#[test]
fn dust_counts_for_less() {
    let dictionary = Arc::new(Dictionary::rig26());
    let truth = truth(&dictionary);
    let lights = [DVec3::Z, DVec3::new(0.5, 0.2, 1.0)];
    let clean = images(&scene(bowl(192), &lights), &truth);
    let mut dusty = clean.clone();
    for image in &mut dusty {
        for (speck, pixel) in (11..image.mean.len()).step_by(50).enumerate() {
            let factor = if speck % 2 == 0 { 3.0 } else { 0.0 };
            image.mean[pixel] = image.mean[pixel].map(|v| factor * v);
        }
    }
    let scene = scene(bowl(96), &lights);
    let options = FitOptions {
        adapt_paths: false,
        ..options()
    };
    let [without, with] = [&clean, &dusty].map(|captured| {
        let fit = fit(&scene, &averaged(&scene, captured), &dictionary, &options).unwrap();
        (errors(&fit, &dictionary, &truth)[0], fit.outlier_fraction)
    });
    println!("without dust {without:?}, with {with:?} (cube-root error, doubted)");
    assert!(with.0 < 0.02 && with.0 < 2.0 * without.0);
    for (without, with) in without.1.iter().zip(&with.1) {
        assert!(*without == 0.0 && *with > 0.004, "{without}, {with}");
    }
}

/// Light of the room in the attached shadow of a ball, where the model is black, does not take the
/// weight of the lit cells; it is reported.
#[test]
fn stray_light_does_not_decide() {
    // The attached shadow must have cells of its own, away from the edge.
    const SIZE: usize = 64;
    let sphere = |segments| Shape::Sphere {
        radius_mm: 1.0,
        segments,
    };
    let lamp = [DVec3::new(0.68, 0.0, 0.73)];
    let dictionary = Arc::new(Dictionary::paper42());
    let atoms = vec![Atom::Lambertian { albedo: 1.0 }, Atom::Black];
    let grey = Arc::new(Dictionary::new("grey", atoms).unwrap());
    for albedo in [0.5, 0.1] {
        let truth = Mixture::grey(grey.clone(), vec![albedo, 1.0 - albedo]).unwrap();
        let photographed = RenderOptions {
            samples_per_pixel: 64,
            max_reflections: 1,
            seed: 7,
            ..RenderOptions::default()
        };
        for share in [0.0, 0.005, 0.01f32] {
            let mut images = render(&scene_of(SIZE, sphere(96), &lamp), &truth, &photographed);
            let level = share * albedo as f32 / std::f32::consts::PI;
            let noise = 2e-4 * albedo as f32;
            let image = &mut images[0];
            let pixels = image.mean.iter_mut().zip(&mut image.variance);
            for (k, (mean, variance)) in pixels.enumerate() {
                // Rising to the right in one of the cases.
                let rise = if share == 0.01 {
                    (k % SIZE) as f32 / (SIZE - 1) as f32
                } else {
                    1.0
                };
                let stray = [1.0, 2.0, 0.5].map(|lamp| level * lamp * rise);
                *mean = std::array::from_fn(|c| mean[c] + stray[c]);
                *variance = variance.map(|v| v + noise * noise);
            }
            let mut options = options();
            options.model_error = FitOptions::default().model_error;
            options.cache.samples_per_cell = 16;
            let scene = scene_of(SIZE, sphere(64), &lamp);
            let fit = fit(&scene, &averaged(&scene, &images), &dictionary, &options).unwrap();
            for (theta_h_deg, theta_d_deg) in [(15.0, 10.0), (40.0, 2.0)] {
                let found = fit.interval(theta_h_deg, theta_d_deg).value[1];
                let ratio = found * std::f64::consts::PI / albedo;
                println!("albedo {albedo}, stray light {share}: {ratio:.3}");
                assert!((ratio - 1.0).abs() < 0.04, "{albedo} {share}: {ratio}");
            }
            let is_stray = |f: &Finding| matches!(f, Finding::StrayLight { image: 0, .. });
            assert_eq!(fit.findings.first().is_some_and(is_stray), share > 0.0);
            let is_misfit = |f: &Finding| matches!(f, Finding::Misfit { .. });
            assert!(!fit.findings.iter().any(is_misfit), "{:?}", fit.findings);
            if (albedo, share) == (0.5, 0.01) {
                // Half of the sample is of another material.
                for (k, mean) in images[0].mean.iter_mut().enumerate() {
                    let factor = if k / SIZE < SIZE / 2 { 0.6 } else { 1.0 };
                    *mean = mean.map(|v| factor * v);
                }
                let both = averaged(&scene, &images);
                let both = rig_core::inverse::fit(&scene, &both, &dictionary, &options).unwrap();
                assert!(both.findings.iter().any(is_misfit), "{:?}", both.findings);
            }
        }
    }
}

#[test]
fn images_that_do_not_belong_to_the_scene_are_refused() {
    let scene = scene(bowl(32), &[DVec3::Z]);
    let run = |images: &[RadianceImage]| Captured::new(&scene, images, &CellOptions::exact());
    assert!(matches!(
        run(&[]),
        Err(AverageError::ImageCount {
            images: 0,
            lights: 1
        })
    ));
    let small = RadianceImage::new(8, 24);
    assert!(matches!(
        run(&[small]),
        Err(AverageError::ImageSize {
            image: 0,
            width: 8,
            ..
        })
    ));
    let mut blind = RadianceImage::new(24, 24);
    blind.valid.fill(false);
    assert!(matches!(
        run(&[blind]),
        Err(AverageError::NothingValid { image: 0 })
    ));
}

/// A discrepancy from the mesh that is stated is a part of the budget of its own and leaves
/// the minimum; none that is not. (How large that part is: `inverse::form`.)
#[test]
fn a_stated_form_error_is_a_part_of_the_budget() {
    let atoms = vec![
        Atom::Lambertian { albedo: 1.0 },
        Atom::Ggx {
            alpha: 0.3,
            eta: 1.5,
        },
        Atom::Black,
    ];
    let dictionary = Arc::new(Dictionary::new("three", atoms).unwrap());
    let weights = std::array::from_fn(|_| vec![0.4, 0.4, 0.2]);
    let truth = Mixture::new(dictionary.clone(), weights).unwrap();
    let scene = scene_of(12, bowl(48), &[DVec3::new(0.3, 0.1, 1.0)]);
    let rendering = RenderOptions {
        samples_per_pixel: 96,
        max_reflections: 3,
        seed: 71,
        proposal: Proposal::resembling(&truth, 0.1),
        ..RenderOptions::default()
    };
    let captured = render(&scene, &truth, &rendering);
    let run = |form_error| {
        let mut options = FitOptions {
            form_error,
            adapt_paths: false,
            ..options()
        };
        options.cache.samples_per_cell = 32;
        options.cache.max_reflections = 3;
        fit(&scene, &averaged(&scene, &captured), &dictionary, &options).unwrap()
    };
    let mesh = |fit: &Fit| {
        let cell = variance_shares::at(&fit.material, &fit.posterior_samples, 10.0, 20.0).unwrap();
        cell.relative_variance[Source::Mesh as usize]
    };
    let exact = run(None);
    let [slight, notable] = [0.02f64, 1.0].map(|slope_deg| {
        let slope_rad = slope_deg.to_radians();
        run(FormError::new(0.3 * slope_rad, slope_rad))
    });
    assert_eq!(mesh(&exact), 0.0);
    // The same minimum; what is made of it knows how sure it is.
    let losses = |fit: &Fit| -> Vec<_> { fit.trace.iter().map(|(_, s)| s.loss.clone()).collect() };
    assert_eq!(losses(&exact), losses(&notable));
    assert!(mesh(&slight) > 0.0);
    assert!(
        mesh(&notable) > 100.0 * mesh(&slight),
        "{} and {}",
        mesh(&notable),
        mesh(&slight)
    );
}

/// Counts pulses; unwinds at the one that is the last to be wanted.
struct Unwanted {
    pulses: AtomicUsize,
    last: usize,
}

/// What it unwinds with.
struct Ended;

impl Progress for Unwanted {
    fn pulse(&self) {
        if self.pulses.fetch_add(1, Ordering::Relaxed) == self.last {
            resume_unwind(Box::new(Ended));
        }
    }
}

#[test]
fn a_receiver_of_progress_can_end_a_fit() {
    let (scene, captured) = example::captured_bowl();
    let dictionary = Dictionary::paper42();
    let options = FitOptions {
        posterior_samples: 0,
        ..options()
    };
    let fit =
        |progress: &Unwanted| fit_with_progress(&scene, &captured, &dictionary, &options, progress);
    let wanted = Unwanted {
        pulses: AtomicUsize::new(0),
        last: usize::MAX,
    };
    fit(&wanted).unwrap();
    let pulses = wanted.pulses.into_inner();

    // In the first group of cells, from one of many threads; and in the optimiser's last step.
    for last in [0, pulses - 1] {
        let unwanted = Unwanted {
            pulses: AtomicUsize::new(0),
            last,
        };
        let end = catch_unwind(AssertUnwindSafe(|| fit(&unwanted))).err();
        assert!(
            end.is_some_and(|end| end.is::<Ended>()),
            "pulse {last} of {pulses}"
        );
    }
}
