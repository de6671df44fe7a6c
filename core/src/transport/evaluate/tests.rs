use super::*;
use crate::brdf::dictionary::Dictionary;
use crate::transport::{CacheOptions, Cells, Light, Scene};
use glam::DVec3;

fn scene() -> Scene {
    let mut scene = Scene::bowl(32, [8, 8], 2.2);
    scene.lights = [0.0, 0.4]
        .map(|x| Light::distant(DVec3::new(x, 0.1, 1.0), [1.0; 3]))
        .to_vec();
    scene
}

/// The paths of every pixel.
fn traced(scene: &Scene, dictionary: &Dictionary, options: &CacheOptions) -> Cache {
    let cells = Cells::of_pixels(scene.camera.resolution_px);
    Cache::trace(scene, &cells, dictionary, options).unwrap()
}

/// Sum over all pixels of the radiance under each lamp, in f64, by walking the
/// records: the definition that the kernels must reproduce.
fn radiance<const B: usize>(
    chunks: &[Chunk<B>],
    atoms: &LaneAtoms,
    weights: &[f64],
    lights: usize,
) -> Vec<f64> {
    // Weights in f64: the kernels' own are rounded to f32.
    let mut exact = vec![0.0f64; B * 8];
    let mut lambertian = 0.0;
    for (n, &weight) in weights.iter().enumerate() {
        let mut unit = vec![0.0; atoms.atoms()];
        unit[n] = 1.0;
        let (one, constant) = atoms.lane_weights::<B>(&unit);
        for (sum, value) in exact.iter_mut().zip(one.iter().flatten()) {
            *sum += f64::from(*value) * weight;
        }
        lambertian += f64::from(constant) * weight;
    }
    let mut total = vec![0.0; lights];
    for record_list in chunks.iter().map(|c| &c.records) {
        let mut throughput = 1.0;
        for record in record_list {
            let head = record.head();
            if head.is_first() {
                throughput = 1.0;
            }
            let mut f = lambertian;
            let mut blocks = [Portable::splat(0.0); B];
            record.accumulate(1.0, &mut blocks);
            for (b, block) in blocks.into_iter().enumerate() {
                let mut values = [0.0; 8];
                block.store(&mut values);
                for i in 0..8 {
                    f += f64::from(values[i]) * f64::from(head.scale()) * exact[b * 8 + i];
                }
            }
            match head.light() {
                Some(light) => total[light] += throughput * f * f64::from(head.weight),
                None => throughput *= f * f64::from(head.weight),
            }
        }
    }
    total
}

/// Central differences of the f64 walk against the kernels' Jacobian, summed over
/// the pixels, also with all weight on one atom (where the others' f is not a factor).
#[test]
fn jacobian_agrees_with_central_differences() {
    let scene = scene();
    for dictionary in [Dictionary::rig26(), Dictionary::paper42()] {
        let options = CacheOptions {
            samples_per_cell: 32,
            max_reflections: 6,
            ..CacheOptions::default()
        };
        let cache = traced(&scene, &dictionary, &options);
        let n = dictionary.len();
        let mut single = vec![0.0; n];
        single[7] = 1.0;
        let mut black = vec![0.0; n];
        black[n - 1] = 1.0;
        for weights in [vec![1.0 / n as f64; n], single, black] {
            let walk = |w: &[f64]| match &*cache.records {
                Records::Blocks3(c) => radiance(c, &cache.atoms, w, 2),
                Records::Blocks5(c) => radiance(c, &cache.atoms, w, 2),
                _ => panic!("unexpected layout"),
            };
            for &kernel in Kernel::available() {
                let (values, gradient) = totals(&cache, kernel, &weights);
                let expected = walk(&weights);
                for light in 0..2 {
                    let scale = expected[light].abs().max(1e-12);
                    assert!(
                        (values[light] - expected[light]).abs() <= 1e-5 * scale,
                        "{} {kernel}: {} for {}",
                        dictionary.name(),
                        values[light],
                        expected[light]
                    );
                }
                let step = 1e-5;
                let mut worst: f64 = 0.0;
                let largest = gradient
                    .iter()
                    .flatten()
                    .fold(0.0f64, |m, v| m.max(v.abs()));
                for atom in 0..n {
                    let (mut up, mut down) = (weights.clone(), weights.clone());
                    up[atom] += step;
                    down[atom] -= step;
                    let (up, down) = (walk(&up), walk(&down));
                    for light in 0..2 {
                        let difference = (up[light] - down[light]) / (2.0 * step);
                        let error = (gradient[light][atom] - difference).abs();
                        worst = worst.max(error / difference.abs().max(1e-2 * largest).max(1e-2));
                    }
                }
                assert!(
                    worst < 1e-4,
                    "{} {kernel}: worst {worst}",
                    dictionary.name()
                );
            }
        }
    }
}

/// Sums over pixels and samples of value and Jacobian per light.
fn totals(cache: &Cache, kernel: Kernel, weights: &[f64]) -> (Vec<f64>, Vec<Vec<f64>>) {
    let n = weights.len();
    let samples = f64::from(cache.samples_per_half);
    let parts = cache.evaluate(
        kernel,
        &[weights],
        || (vec![0.0; 2], vec![vec![0.0; n]; 2]),
        |(values, gradient), rows| {
            for half in 0..2 {
                for light in 0..2 {
                    values[light] += samples * f64::from(rows.value[half][light]);
                    let jacobian = &rows.jacobian[half][light * n..][..n];
                    for (sum, &row) in gradient[light].iter_mut().zip(jacobian) {
                        *sum += samples * f64::from(row);
                    }
                }
            }
        },
    );
    let mut sum = (vec![0.0; 2], vec![vec![0.0; n]; 2]);
    for (values, gradient) in parts {
        for light in 0..2 {
            sum.0[light] += values[light];
            for (sum, part) in sum.1[light].iter_mut().zip(&gradient[light]) {
                *sum += part;
            }
        }
    }
    sum
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let scene = scene();
    let dictionary = Dictionary::paper42();
    let run = |threads: usize, kernel: Kernel| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let options = CacheOptions {
                samples_per_cell: 16,
                ..CacheOptions::default()
            };
            let cache = traced(&scene, &dictionary, &options);
            totals(&cache, kernel, &vec![1.0 / 42.0; 42])
        })
    };
    for &kernel in Kernel::available() {
        assert_eq!(run(1, kernel), run(3, kernel), "{kernel}");
    }
}
