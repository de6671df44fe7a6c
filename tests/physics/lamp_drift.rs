//! The lamp compared with itself: what its drift is known to, what is said of it, what
//! suspends a capture.

use std::sync::Arc;

use crate::capture_support::*;
use mock_devices::sensor::{FrameKey as SensorFrame, NoiseKey, SensorConfig, SensorModel};
use rig::capture::exposure_check::{Exposed, signal_ratio};
use rig::capture::{CaptureError, Outcome};
use rig::device::LampState;
use rig::radiometry::sensor::SensorNoise;
use rig::session::drift::{LampChange, LampDrift, Span};
use rig::session::faults::UnsyncedDisk;
use rig::session::{Session, SessionRecord, Sidecar, layout, verify};

/// 7% over a bracket suspends, 3% (at the limit, within the noise) is noted,
/// steadiness is not.
#[test]
fn a_lamp_that_drifts_suspends() {
    let run = |drift_per_frame| {
        let parent = tempfile::tempdir().unwrap();
        let bench = Bench::with(|world| world.drift_per_frame = drift_per_frame);
        let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
        let root = session.root().to_owned();
        let (result, heard) = capture(&bench, session);
        assert_eq!(bench.lamp_and_stops(), (LampState::Off, 0));
        let drift = Session::open(&root).unwrap().lamp_drift().unwrap();
        (result, heard, verify::verify(&root).unwrap(), drift)
    };
    let (result, _, found, drift) = run(0.998);
    assert!(
        matches!(result, Err(CaptureError::LampDrift { light: 0, change, .. }) if change.ratio < 0.96),
        "{result:?}"
    );
    assert!(found.is_intact() && !found.complete);
    assert_eq!(drift.changes, []);
    let (result, heard, _, drift) = run(0.9991);
    assert_eq!(result.unwrap(), Outcome::Complete);
    let drifts = heard.warnings.iter();
    let drifted = |w: &String| w.starts_with("the lamp drifted by -") && w.contains("during light");
    assert!(drifts.clone().any(drifted), "{:?}", heard.warnings);
    // Every light's last frames are some thirty frames after its first.
    let is_near = |c: &LampChange| (-0.04..-0.01).contains(&c.change) && c.std_dev.is_some();
    assert!(drift.within_lights().all(is_near), "{drift:?}");
    assert_eq!(drift.changes.len(), 2 * 2);
    assert!((0.01..0.04).contains(&drift.of_intensities()));
    assert!(!drift.notable().is_empty(), "{drift:?}");
    let (result, heard, _, drift) = run(1.0);
    assert_eq!(result.unwrap(), Outcome::Complete);
    assert_eq!(heard.warnings, [""; 0]);
    assert_eq!(drift.notable(), [], "{drift:?}");
    assert!(drift.of_intensities() < 0.005, "{drift:?}");
}

/// After its last light a capture visits the first again: what the lamp did meanwhile is
/// known, and noted where it is more than a percent, also in a run that was interrupted.
#[test]
fn the_first_light_is_visited_again() {
    let run = |drift_per_frame: f64, interrupt_at_grab: Option<u32>| {
        let parent = tempfile::tempdir().unwrap();
        let bench = Bench::with(|world| {
            world.drift_per_frame = drift_per_frame;
            world.interrupt_at_grab = interrupt_at_grab;
        });
        let mut record = record();
        record.plan.revisit_first = true;
        let session = create_from(Arc::new(UnsyncedDisk), parent.path(), &record).unwrap();
        let root = session.root().to_owned();
        let (result, mut heard) = capture(&bench, session);
        if result.unwrap() == Outcome::Interrupted {
            heard = resume(Arc::new(UnsyncedDisk), &root);
        }
        let session = Session::open(&root).unwrap();
        assert!(verify::verify(&root).unwrap().is_intact());
        assert_eq!(bench.lamp_and_stops(), (LampState::Off, 0));
        let world = bench.world();
        let told = heard
            .warnings
            .iter()
            .filter(|w| w.contains("since light 1"));
        let drift = session.lamp_drift().unwrap();
        (
            drift,
            told.count(),
            world.moves,
            world.grabs,
            content(&root),
        )
    };
    let (steady, told, moves, grabs, expected) = run(1.0, None);
    assert_eq!((told, moves), (0, 3));
    // These few pixels tell the lamp within 1%.
    assert!(steady.over_session().count() > 0, "{steady:?}");
    assert_eq!(steady.notable(), [], "{steady:?}");
    // Some 3% within each light, which does not suspend, and more than twice that between
    // the first light and its second visit, which does not either.
    let (drifting, told, _, all, _) = run(0.9988, None);
    let lost = 0.9988f64.powi(all as i32) - 1.0;
    for change in drifting.over_session() {
        assert!((change.change - lost).abs() < 0.03, "{change} for {lost}");
    }
    assert_eq!(drifting.notable()[0].span, Span::OverSession);
    assert!((1..=2).contains(&told), "{told} channels");
    assert!(drifting.of_intensities() > steady.of_intensities());
    // In the middle, and during the visit.
    for at in [grabs / 2, grabs - 1] {
        let (_, _, _, _, found) = run(1.0, Some(at));
        assert_eq!(found, expected, "interrupted at frame {at} of {grabs}");
    }
}

/// Change over its uncertainty of two frames of a simulated sensor (Poisson noise, full
/// well, uneven and hot pixels) at the same exposure, the lamp brighter by `drift` in
/// the second: a ramp from darkness to twice what `peak` of the full well needs.
fn pull(sensor: &SensorModel, peak: f64, drift: f32, index: u32) -> f64 {
    let config = sensor.config();
    let noise = SensorNoise {
        dark_current_e_s: config.dark_current_e_s,
        linear_max_dn: 3900.0,
        ..SensorNoise::ideal(
            config.gain_dn_per_e,
            config.read_noise_e,
            config.black_level_dn,
            12,
        )
    };
    let exposure_s = 0.1;
    let brightest = (2.0 * peak * config.full_well_e / (config.responsivity * exposure_s)) as f32;
    let pixels = config.resolution_px[0] * config.resolution_px[1];
    let frame = |repeat: u32| {
        let power = brightest * if repeat == 1 { 1.0 + drift } else { 1.0 };
        let ramp: Vec<f32> = (0..pixels)
            .map(|pixel| power * pixel as f32 / pixels as f32)
            .collect();
        let frame = SensorFrame {
            light: index,
            exposure: 0,
            repeat,
            kind: 0,
        };
        sensor.expose(&ramp, exposure_s, 1.0, NoiseKey { seed: 3, frame })
    };
    let [first, second] = [0, 1].map(frame);
    let [earlier, later] = [&first, &second].map(|counts| Exposed { counts, exposure_s });
    let found = signal_ratio(&noise, earlier, later).unwrap();
    (found.ratio - 1.0) / found.std_dev
}

/// The stated uncertainty is the true one, from a few electrons per pixel to frames that
/// clip in half their pixels: the squares of 1500 pulls each add up to χ² within what
/// five tests at 0.1% together allow (3.7 of its standard deviations), and their mean
/// is 0 within as much.
#[test]
fn uncertainties_are_as_stated() {
    let sensor = SensorModel::new(SensorConfig {
        prnu: 0.02,
        hot_fraction: 0.01,
        ..SensorConfig::typical([16, 16], 7)
    });
    for peak in [0.001, 0.02, 0.1, 0.45, 1.0] {
        let n = 1500u32;
        let pulls: Vec<f64> = (0..n).map(|i| pull(&sensor, peak, 0.0, i)).collect();
        let n = f64::from(n);
        let chi2: f64 = pulls.iter().map(|pull| pull * pull).sum();
        let mean = pulls.iter().sum::<f64>() / n;
        println!("peak {peak}: variance {:.3}, mean {mean:+.3}", chi2 / n);
        let allowed = 3.7 * (2.0 * n).sqrt();
        assert!((chi2 - n).abs() < allowed, "peak {peak}: χ² {chi2} of {n}");
        assert!(mean.abs() < 3.7 / n.sqrt(), "peak {peak}: mean {mean}");
    }
}

/// Where `SignalRatio::tells_good` holds, a change of 1% is beyond what ten thousand
/// comparisons ask (5.3) in 95 of 100.
#[test]
fn a_change_of_one_percent_is_found() {
    let sensor = SensorModel::new(SensorConfig::typical([64, 64], 7));
    let found = (0..100).filter(|&i| pull(&sensor, 0.2, 0.01, i) > 5.3);
    assert!(found.count() >= 95);
}

/// Sidecars and plans of before the drift had an uncertainty say less and are read.
#[test]
fn files_without_the_uncertainty_of_the_drift_are_read() {
    let parent = tempfile::tempdir().unwrap();
    let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
    let root = session.root().to_owned();
    assert_eq!(
        capture(&Bench::new(), session).0.unwrap(),
        Outcome::Complete
    );
    let session = Session::open(&root).unwrap();
    let without = |path: &str, key: &str| -> (usize, String) {
        let text = std::fs::read_to_string(root.join(path)).unwrap();
        let kept: Vec<&str> = text.lines().filter(|line| !line.starts_with(key)).collect();
        (text.lines().count() - kept.len(), kept.join("\n"))
    };
    let mut removed = 0;
    for entry in session.frames() {
        let (lines, text) = without(&entry.sidecar.path, "lamp_ratio_std");
        let sidecar: Sidecar = toml::from_str(&text).unwrap();
        let now = session.read_frame(&entry).unwrap().1;
        removed += lines;
        assert_eq!(
            Sidecar {
                lamp_ratio_std: None,
                ..now
            },
            sidecar
        );
    }
    assert!(removed > 0);
    let (removed, text) = without(layout::SESSION_FILE, "stage_tolerance_deg");
    assert_eq!(removed, 1);
    let record: SessionRecord = toml::from_str(&text).unwrap();
    assert_eq!(&record, session.record());
}

/// Captures of two lights by two channels, the first visited again, on a bench of which this
/// seed decides the noise; the lamp is constant or loses about `lost` between the frames of a
/// light that are compared.
fn lamp_of(seed: u64, lost: f64) -> LampDrift {
    // Some thirty frames lie between those that are compared.
    let bench = Bench::with(|world| {
        world.size = 32;
        world.noise_seed = seed;
        world.drift_per_frame = (1.0 - lost).powf(1.0 / 30.0);
    });
    let parent = tempfile::tempdir().unwrap();
    let mut record = record();
    record.plan.revisit_first = true;
    record.versions.camera = camera_of(32);
    let session = create_from(Arc::new(UnsyncedDisk), parent.path(), &record).unwrap();
    let root = session.root().to_owned();
    assert_eq!(capture(&bench, session).0.unwrap(), Outcome::Complete);
    Session::open(&root).unwrap().lamp_drift().unwrap()
}

/// `RIG_DRIFT_CAPTURES` constant lamps (60): none is remarked on, and the changes are what
/// their uncertainties say. Of half as many lamps that lose 1% between the frames that are
/// compared at least 95 of 100 are named.
#[test]
fn constant_lamps_are_not_blamed_and_drifting_ones_are() {
    let captures = std::env::var("RIG_DRIFT_CAPTURES").map_or(60, |n| n.parse().unwrap());
    let (mut squares, mut compared, mut counted) = (0.0, 0.0, 0.0);
    for seed in 0..captures {
        let constant = lamp_of(seed, 0.0);
        assert_eq!(constant.notable(), [], "seed {seed}");
        counted += constant.of_intensities() / captures as f64;
        for change in constant.within_lights() {
            squares += (change.change / change.std_dev.unwrap()).powi(2);
            compared += 1.0;
        }
    }
    let drifting = captures / 2;
    let mut lost = 0.0;
    let is_named = |seed: &u64| {
        let drift = lamp_of(*seed, 0.01);
        lost += drift.changes[0].change / drifting as f64;
        let is_within = |change: &LampChange| change.span != Span::OverSession;
        drift.notable().iter().any(is_within)
    };
    let named = (0..drifting).filter(is_named).count();
    println!(
        "{captures} constant lamps: none blamed, mean square of pulls {:.3}, {:.3}% counted as \
         drift; {named} of {drifting} that lose {:.2}% named",
        squares / compared,
        100.0 * counted,
        -100.0 * lost
    );
    // Noise is not counted as drift, and χ² is within what 0.1% allows.
    assert!(counted < 0.0008, "{counted}");
    assert!((squares - compared).abs() < 3.3 * f64::sqrt(2.0 * compared));
    assert!(
        100 * named >= 95 * drifting as usize,
        "{named} of {drifting}"
    );
}
