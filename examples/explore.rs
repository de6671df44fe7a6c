use std::fmt::Write;
use std::sync::Arc;
use rig::brdf::{Brdf, Dictionary, Mixture, in_span};
use rig::evaluate::{intervals, small_bench::*};
use rig::inverse::*;
use rig::transport::*;

fn cpu() -> f64 {
    let s = std::fs::read_to_string("/proc/self/stat").unwrap();
    let f: Vec<&str> = s.rsplit(')').next().unwrap().split_whitespace().collect();
    (f[11].parse::<f64>().unwrap() + f[12].parse::<f64>().unwrap()) / 100.0
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let get = |k: &str, d: f64| args.iter().find_map(|a| a.strip_prefix(&format!("{k}=")).map(|v| v.parse().unwrap())).unwrap_or(d);
    let text = |k: &str| args.iter().find_map(|a| a.strip_prefix(&format!("{k}=")).map(str::to_owned)).unwrap_or_default();
    let captures = get("n", 10.0) as u64;
    let first = get("first", 0.0) as u64;
    let dictionary = Arc::new(Dictionary::paper42());
    let bench = SmallBench { size_px: get("px", 16.0) as usize, truth_samples: get("truth", 512.0) as u32, sample: if get("designed", 0.0) > 0.0 {Sample1::Designed} else {Sample1::Bowl}, ..SmallBench::default() };
    let mut options = FitOptions::default();
    options.cache.samples_per_pixel = get("spp", 256.0) as u32;
    options.model_error = get("tau", 0.02);
    options.draws = get("draws", 200.0) as usize;
    let theta_h: Vec<f64> = (0..12).map(|i| 85.0 * (f64::from(i) / 11.0).powi(2)).collect();
    let theta_d: Vec<f64> = (0..9).map(|i| 10.0 * f64::from(i)).collect();
    let oos = get("oos", 0.0) > 0.0;
    let dump = text("dump");
    let set: Vec<Mixture> = in_span::set().iter().map(|m| m.mixture()).collect();
    let mut trials = Vec::new();
    let t0 = cpu();
    let oos_mats: Vec<(&str, Box<dyn Brdf>)> = if oos { rig::brdf::nbrdf::NAMES.iter().filter(|n| !["chrome", "brass", "aluminium"].contains(n)).map(|n| (*n, rig::brdf::source::load(&format!("nbrdf:{n}")).unwrap())).collect() } else { vec![] };
    let t1 = cpu();
    let (mut det, mut named) = (0, 0);
    for i in first..first + captures {
        let k = i as usize % 20; let j = i as usize / 20;
        let w = [k, (k + 7 + j) % 20, (k + 13 + 2 * j) % 20].map(|m| set[m].weights()[1].clone());
        let mix = Mixture::new(set[0].dictionary().clone(), w).unwrap();
        let brdf: &dyn Brdf = if oos { &*oos_mats[i as usize % oos_mats.len()].1 } else { &mix };
        let second: Arc<dyn Brdf> = Arc::new(set[(k + 3) % 20].clone());
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        let defect = match text("def").as_str() {
            "second" => Some(Defect::SecondMaterial(second)),
            "deep" => Some(Defect::Deeper(1.0 + 0.06 * sign as f32)),
            "pose" => Some(Defect::Pose(glam::DVec3::new(0.02 * sign, 0.015, 0.0), glam::DVec3::new(0.02, -0.02 * sign, 0.0))),
            "stray" => Some(Defect::StrayLight(0.08)),
            "blur" => Some(Defect::Translucent(0.5, 1.2)),
            _ => None };
        let truth = bench.true_scene(None).unwrap();
        let proposal = suited_proposal(&truth, brdf, &RenderOptions { samples_per_pixel: 64, max_reflections: 16, seed: 5, proposal: Proposal::default() });
        let t = intervals::trial(&bench, brdf, &proposal, &dictionary, &options, [&theta_h, &theta_d], defect.as_ref(), 1000 + i).unwrap();
        let d = &t.fit.diagnosis;
        let chi: f64 = t.fit.reduced_chi2.iter().flatten().sum::<f64>() / t.fit.reduced_chi2.len() as f64 / 3.0;
        println!("D {i} ms {:.3} chi {chi:.3} corr {:.3} expl {} doubt {:.3?} misfit {:.4?} -> {:?}", d.mean_square, d.correlation, d.explained.map(|e| format!("{e:.3}")).join(" "), t.fit.doubted, t.fit.draws.iter().map(|d| d.misfit).collect::<Vec<_>>(), d.finding());
        det += d.finding().is_some() as usize; named += 0;
        if !dump.is_empty() {
            std::fs::create_dir_all(&dump).unwrap();
            let mut o = String::new();
            for c in 0..3 { let _ = writeln!(o, "{} {}", t.fit.draws[c].misfit, t.truth.iter().map(|f| f[c].to_string()).collect::<Vec<_>>().join(" ")); }
            std::fs::write(format!("{dump}/{i}_truth.txt"), o).unwrap();
            for c in 0..3 {
                let by: Vec<u8> = t.fit.draws[c].posterior.iter().flat_map(|x| x.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>()).collect();
                std::fs::write(format!("{dump}/{i}_{c}.bin"), by).unwrap();
            }
        }
        trials.push(t);
    }
    println!("cpu {:.2} per capture; detected {det} of {captures} {named}; timings {:?}", (cpu() - t1) / captures as f64, trials[0].fit.timings);
    let _ = t0;
    let n_cells = theta_h.len() * theta_d.len();
    let mut all = vec![]; let mut con = vec![]; let mut frac = 0.0; let mut width = vec![]; let mut below = 0.0; let mut above = 0.0; let mut tot = 0.0;
    for cell in 0..n_cells { for c in 0..3 {
        let (mut k, mut kc, mut nc) = (0, 0, 0);
        for t in &trials {
            let iv = &t.intervals[cell]; let f = t.truth[cell][c];
            let inside = iv.lower[c] <= f && f <= iv.upper[c];
            tot += 1.0;
            if f < iv.lower[c] { below += 1.0 } else if f > iv.upper[c] { above += 1.0 }
            k += inside as usize;
            if iv.constrained { nc += 1; kc += inside as usize; width.push((iv.upper[c] - iv.lower[c]) / f.max(1e-6)); }
        }
        all.push(k as f64 / trials.len() as f64);
        frac += nc as f64 / trials.len() as f64 / (3 * n_cells) as f64;
        if nc * 4 >= trials.len() { con.push(kc as f64 / nc as f64); }
    }}
    let q = |v: &mut Vec<f64>, p: f64| { v.sort_by(f64::total_cmp); if v.is_empty() { f64::NAN } else { v[((v.len() - 1) as f64 * p) as usize] } };
    println!("all cells: median {:.3} worst decile {:.3} min {:.3}", q(&mut all, 0.5), q(&mut all, 0.1), q(&mut all, 0.0));
    println!("constrained ({} cells): median {:.3} worst decile {:.3} min {:.3}; fraction {:.3}; rel width median {:.4} p90 {:.4}", con.len(), q(&mut con, 0.5), q(&mut con, 0.1), q(&mut con, 0.0), frac, q(&mut width, 0.5), q(&mut width, 0.9));
    println!("truth below {:.3} above {:.3}", below / tot, above / tot);
}
