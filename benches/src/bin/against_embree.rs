//! Ray queries of rig and of Embree 4 in one run, on one thread, in turns:
//! `EMBREE_LIBRARY=… cargo run --release --bin against-embree [--json] [--verbose]`.

use std::hint::black_box;
use std::process::ExitCode;

use rig::geometry::{Bvh, Mesh, Ray, Shape};
use rig_benches::clock::{cpu_s, least, median};
use rig_benches::embree::{Embree, Mode};
use rig_benches::{rays, scenes};

const RAYS: usize = 200_000;
const ROUNDS: usize = 11;
const AIMED: usize = 400_000;

fn main() -> ExitCode {
    let flags: Vec<String> = std::env::args().skip(1).collect();
    match run(
        flags.iter().any(|f| f == "--json"),
        flags.iter().any(|f| f == "--verbose"),
    ) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::FAILURE
        }
    }
}

const ROBUST: Mode = Mode {
    robust: true,
    coherent: false,
};

fn run(json: bool, verbose: bool) -> Result<(), String> {
    let bowl = scenes::bowl().map_err(|e| e.to_string())?;
    let bvh = Bvh::new(&bowl);
    let modes = [
        ("embree robust", ROBUST),
        (
            "embree robust, coherent flag",
            Mode {
                coherent: true,
                ..ROBUST
            },
        ),
        (
            "embree fast",
            Mode {
                robust: false,
                ..ROBUST
            },
        ),
    ];
    let mut others = Vec::new();
    for (name, mode) in modes {
        others.push((name, Embree::new(&bowl, mode, verbose)?));
    }
    let rays = rays::bounces(&bowl, &bvh, RAYS);
    let agreement = agreement(&rays, &bvh, &mut others[0].1);

    // seconds[query][program][round]; rig comes first.
    const QUERIES: [&str; 3] = ["closest", "any", "closest, each after the other's hit"];
    let mut seconds = vec![vec![Vec::new(); 1 + others.len()]; QUERIES.len()];
    for _ in 0..ROUNDS {
        seconds[0][0].push(cpu_s(|| {
            closest(&rays, |ray| bvh.closest(ray).map(|h| h.distance_mm))
        }));
        seconds[1][0].push(cpu_s(|| any(&rays, |ray| bvh.any(ray))));
        seconds[2][0].push(cpu_s(|| {
            chain(&rays, |ray| bvh.closest(ray).map(|h| h.distance_mm))
        }));
        for (k, (_, embree)) in others.iter_mut().enumerate() {
            seconds[0][k + 1].push(cpu_s(|| {
                closest(&rays, |ray| embree.closest(ray).map(|h| h.0))
            }));
            seconds[1][k + 1].push(cpu_s(|| any(&rays, |ray| embree.any(ray))));
            seconds[2][k + 1].push(cpu_s(|| {
                chain(&rays, |ray| embree.closest(ray).map(|h| h.0))
            }));
        }
    }
    drop(others);
    let leaks = leaks()?;

    let mut rows = Vec::new();
    for (query, of_query) in QUERIES.iter().zip(&seconds) {
        let names = std::iter::once("rig").chain(modes.iter().map(|m| m.0));
        for (name, of_program) in names.zip(of_query) {
            let ratios: Vec<f64> = of_program
                .iter()
                .zip(&of_query[0])
                .map(|(o, r)| o / r)
                .collect();
            rows.push((
                *query,
                name,
                RAYS as f64 / median(of_program) / 1e6,
                RAYS as f64 / least(of_program) / 1e6,
                median(&ratios),
            ));
        }
    }
    if json {
        let rows: Vec<_> = rows
            .iter()
            .map(|(query, program, median, best, ratio)| {
                serde_json::json!({
                    "query": query, "program": program, "mrays_per_s_median": median,
                    "mrays_per_s_best": best, "rig_over_this": ratio,
                })
            })
            .collect();
        let leaks: Vec<_> = leaks
            .iter()
            .map(|(program, closest, any)| {
                serde_json::json!({"program": program, "closest": closest, "any": any})
            })
            .collect();
        let all = serde_json::json!({
            "triangles": bowl.triangles.len(), "rays": RAYS, "rounds": ROUNDS,
            "same_hit": agreement, "queries": rows, "aimed_rays": AIMED, "leaks": leaks,
        });
        println!("{all:#}");
        return Ok(());
    }
    println!(
        "bowl of {} triangles, {RAYS} bounce rays, {ROUNDS} rounds in turns, one thread, CPU time",
        bowl.triangles.len()
    );
    println!(
        "same hit in rig and embree robust: {:.4}%",
        100.0 * agreement
    );
    println!(
        "{:36} {:30} {:>10} {:>10} {:>12}",
        "query", "program", "Mrays/s", "best", "rig is ×"
    );
    for (query, program, median, best, ratio) in rows {
        println!("{query:36} {program:30} {median:10.2} {best:10.2} {ratio:12.2}");
    }
    println!("rays aimed at vertices and edges of a closed sphere that escape, of {AIMED}:");
    for (program, closest, any) in leaks {
        println!("{program:30} closest {closest:6}  any {any:6}");
    }
    Ok(())
}

fn closest(rays: &[Ray], mut query: impl FnMut(&Ray) -> Option<f32>) {
    let mut sum = 0.0;
    for ray in rays {
        sum += query(ray).unwrap_or(0.0);
    }
    black_box(sum);
}

fn any(rays: &[Ray], mut query: impl FnMut(&Ray) -> bool) {
    black_box(rays.iter().filter(|ray| query(ray)).count());
}

/// No ray can begin before the one before it has ended: latency, not throughput.
fn chain(rays: &[Ray], mut query: impl FnMut(&Ray) -> Option<f32>) {
    let mut before = 0.0;
    for ray in rays {
        let mut ray = *ray;
        ray.origin_mm.x += 0.0 * before;
        before = query(&ray).unwrap_or(0.0);
    }
    black_box(before);
}

/// Share of the rays for which both find the same triangle or the same distance.
fn agreement(rays: &[Ray], bvh: &Bvh, embree: &mut Embree) -> f64 {
    let same = rays
        .iter()
        .filter(|ray| match (bvh.closest(ray), embree.closest(ray)) {
            (Some(ours), Some((distance, triangle))) => {
                ours.triangle == triangle || (ours.distance_mm - distance).abs() < 1e-5
            }
            (None, None) => true,
            _ => false,
        })
        .count();
    same as f64 / rays.len() as f64
}

/// Aimed rays that escape a closed sphere: closest-hit and any-hit, by program.
fn leaks() -> Result<Vec<(&'static str, usize, usize)>, String> {
    let sphere: Mesh = Shape::Sphere {
        radius_mm: 1.0,
        segments: 64,
    }
    .mesh()
    .map_err(|e| e.to_string())?;
    let aimed = rays::aimed_at_edges(&sphere, AIMED);
    let escaped = |hits: &mut dyn FnMut(&Ray) -> bool| aimed.iter().filter(|r| !hits(r)).count();
    let bvh = Bvh::new(&sphere);
    let mut rows = vec![(
        "rig",
        escaped(&mut |r| bvh.closest(r).is_some()),
        escaped(&mut |r| bvh.any(r)),
    )];
    for (name, robust) in [("embree robust", true), ("embree fast", false)] {
        let mut embree = Embree::new(&sphere, Mode { robust, ..ROBUST }, false)?;
        let closest = escaped(&mut |r| embree.closest(r).is_some());
        rows.push((name, closest, escaped(&mut |r| embree.any(r))));
    }
    Ok(rows)
}
