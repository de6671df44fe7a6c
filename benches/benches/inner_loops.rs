//! The inner loops: `cargo bench`, or `cargo bench -- rays` for some of them.

use std::sync::Arc;

use divan::{Bencher, black_box};
use rig::brdf::{Dictionary, Mixture};
use rig::geometry::{Bvh, Mesh};
use rig::simplex::Quadratic;
use rig::cells::Captured;
use rig::inverse::{Channels, objective::Objective};
use rig::random::{Purpose, stream};
use rig::transport::{
    Cache, CacheOptions, Cells, DirectMatrix, Kernel, Proposal, RenderOptions, Scene, render,
};
use rig_benches::{rays, scenes};

fn main() {
    divan::main();
}

const SHAPES: [&str; 2] = ["bowl", "corner"];

fn scene(shape: &str, resolution_px: usize) -> Scene {
    let (mesh, lamp_deg) = match shape {
        "bowl" => (scenes::bowl(), 0.0),
        _ => (scenes::corner(), 25.0),
    };
    scenes::scene(mesh.expect("a valid shape"), resolution_px, &[lamp_deg])
}

fn bowl() -> Mesh {
    scenes::bowl().expect("a valid shape")
}

/// Every pixel of a scene's image as a cell.
fn pixels_of(scene: &Scene) -> Cells {
    Cells::of_pixels(scene.camera.resolution_px)
}

/// What fits use unless another is named.
fn dictionary() -> Dictionary {
    Dictionary::load(Dictionary::DEFAULT).expect("it is built in")
}

fn cache(shape: &str, resolution_px: usize) -> Cache {
    let options = CacheOptions {
        max_reflections: 8,
        ..CacheOptions::default()
    };
    let scene = scene(shape, resolution_px);
    Cache::trace(&scene, &pixels_of(&scene), &dictionary(), &options)
        .expect("one lamp and a usual dictionary")
}

/// Image and Jacobian of 32 × 32 pixels, 256 samples each.
#[divan::bench(args = SHAPES, sample_count = 20)]
fn evaluate(bencher: Bencher, shape: &str) {
    evaluate_with(bencher, shape, Kernel::detect());
}

/// The same in plain Rust.
#[divan::bench(args = SHAPES, sample_count = 5)]
fn evaluate_portable(bencher: Bencher, shape: &str) {
    evaluate_with(bencher, shape, Kernel::Portable);
}

fn evaluate_with(bencher: Bencher, shape: &str, kernel: Kernel) {
    let cache = cache(shape, 32);
    let atoms = dictionary().len();
    let weights = vec![1.0 / atoms as f64; atoms];
    bencher.bench_local(|| {
        cache.evaluate(
            kernel,
            &[&weights],
            || 0.0f32,
            |sum, rows| *sum += rows.value[0][0] + rows.jacobian[1][7],
        )
    });
}

/// Paths of 16 × 16 pixels, 256 samples each.
#[divan::bench(args = SHAPES, sample_count = 5)]
fn trace(bencher: Bencher, shape: &str) {
    let scene = scene(shape, 16);
    let dictionary = dictionary();
    let options = CacheOptions {
        max_reflections: 8,
        ..CacheOptions::default()
    };
    bencher.bench_local(|| Cache::trace(&scene, &pixels_of(&scene), &dictionary, &options).map(|c| c.size()));
}

#[divan::bench(sample_count = 20)]
fn rays_closest(bencher: Bencher) {
    let mesh = bowl();
    let bvh = Bvh::new(&mesh);
    let rays = rays::bounces(&mesh, &bvh, 20_000);
    bencher
        .counter(divan::counter::ItemsCount::new(rays.len()))
        .bench_local(|| rays.iter().filter(|r| bvh.closest(r).is_some()).count());
}

#[divan::bench(sample_count = 20)]
fn rays_any(bencher: Bencher) {
    let mesh = bowl();
    let bvh = Bvh::new(&mesh);
    let rays = rays::bounces(&mesh, &bvh, 20_000);
    bencher
        .counter(divan::counter::ItemsCount::new(rays.len()))
        .bench_local(|| rays.iter().filter(|r| bvh.any(r)).count());
}

#[divan::bench(sample_count = 5)]
fn build_tree(bencher: Bencher) {
    let mesh = bowl();
    bencher.bench_local(|| Bvh::new(black_box(&mesh)));
}

/// 16 × 16 pixels, 16² samples each.
#[divan::bench(args = SHAPES, sample_count = 5)]
fn direct_matrix(bencher: Bencher, shape: &str) {
    let scene = scene(shape, 16);
    let dictionary = dictionary();
    bencher.bench_local(|| DirectMatrix::new(&scene, &pixels_of(&scene), &dictionary, 16, 1));
}

/// Residuals, gradient and Gauss–Newton matrix of one 32 × 32 image in three channels.
#[divan::bench(args = SHAPES, sample_count = 5)]
fn linearise(bencher: Bencher, shape: &str) {
    let scene = scene(shape, 32);
    let dictionary = dictionary();
    let cache = cache(shape, 32);
    let direct = DirectMatrix::new(&scene, &pixels_of(&scene), &dictionary, 4, 1);
    let atoms = dictionary.len();
    let mut half_white = vec![0.0; atoms];
    half_white[atoms - 2..].fill(0.5);
    let material =
        Mixture::grey(Arc::new(dictionary.clone()), half_white).expect("weights on the simplex");
    let captured = render(
        &scene,
        &material,
        &RenderOptions {
            samples_per_pixel: 16,
            max_reflections: 8,
            seed: 3,
            ..RenderOptions::default()
        },
    );
    let captured = Captured::of_pixels(&captured, |_| true);
    let objective = Objective::new(
        &cache,
        &direct,
        &captured,
        Channels::Separate,
        Kernel::detect(),
        0.02,
    );
    let weights = objective.weights(None);
    let mixture = vec![nalgebra::DVector::from_element(atoms, 1.0 / atoms as f64); 3];
    bencher.bench_local(|| objective.linearise(&mixture, &weights));
}

/// Least squares of 42 unknowns on the simplex, about half of them zero.
#[divan::bench]
fn simplex(bencher: Bencher) {
    let mut numbers = stream(5, Purpose::Experiment, 0, 0, 0);
    let rows = nalgebra::DMatrix::from_fn(200, 42, |_, _| numbers.normal());
    let target = nalgebra::DVector::from_fn(200, |_, _| numbers.normal());
    let quadratic = Quadratic::least_squares(&rows, &target, None);
    bencher.bench_local(|| quadratic.minimise().map(|s| s.x.sum()));
}
