//! On the simulated bench, whose lamp warms up, drifts and flickers as stated.

use super::*;
use crate::calibration::lamp_watch::{Watch, WatchError, WatchOptions};
use crate::device::lit_card::{LampModel, LitCard};

fn watch(lamp: LampModel, radiance: f64, watch_s: f64, seed: u64) -> Result<LampFit, WatchError> {
    let (card, mut camera) = LitCard::new(lamp, radiance, seed);
    let mut switch = |on: bool| {
        card.switch(on);
        Ok(())
    };
    let mut wait = |seconds| card.wait(seconds);
    let mut progress = |_| {};
    let outcome =
        Watch::new(&mut camera, &mut switch, &mut wait, &mut progress).run(&WatchOptions {
            gain: 1.0,
            watch_s,
            interval_s: 5.0,
            burst: 64,
            discard: 3,
        });
    assert!(card.is_dark(), "the lamp is off afterwards");
    outcome
}

fn model() -> LampModel {
    LampModel {
        warm_up_fraction: 0.06,
        warm_up_s: 90.0,
        drift_per_hour: 0.01,
        ..LampModel::default()
    }
}

/// 16 lamps: each error in units of its stated uncertainty is a standard normal,
/// χ² over 16 between the 1e-5 tails of χ²(16).
#[test]
fn warm_up_and_drift_are_recovered_within_their_uncertainty() {
    let mut chi2 = [0.0; 3];
    for seed in 0..16 {
        let fit = watch(model(), 0.1, 900.0, 40 + seed).unwrap();
        let v = &fit.values;
        // Times count from the first frame, a little after switching on; what is
        // missing is then a little less.
        let truths = [
            (v.warm_up_constant_s, 90.0),
            (v.drift_per_hour, 0.01),
            (v.warm_up_fraction, 0.06),
        ];
        for (chi2, (found, truth)) in chi2.iter_mut().zip(truths).take(2) {
            *chi2 += ((found.value - truth) / found.std).powi(2);
        }
        assert!(
            (v.warm_up_fraction.value / 0.06 - 1.0).abs() < 0.05,
            "{v:?}"
        );
        let recommended_s = 90.0 * (0.06f64 / 1e-3).ln();
        assert!(
            (v.warm_up_time_s / recommended_s - 1.0).abs() < 0.05,
            "{v:?}"
        );
        // Without flicker no exposure is called unsteady.
        assert!(v.flicker.iter().all(|f| f.relative.value < 2e-3), "{v:?}");
        assert!(v.steady_from_s.is_some());
    }
    for chi2 in &chi2[..2] {
        assert!((2.0..53.0).contains(chi2), "{chi2}");
    }
}

/// Flicker of 100 Hz averages out over an exposure as its integral says: the
/// standard deviation of a sine of depth m over t is m/√2 |sinc(π f t)|.
#[test]
fn flicker_is_measured_by_exposure() {
    let lamp = LampModel {
        flicker_depth: 0.1,
        flicker_hz: 101.3,
        ..LampModel::default()
    };
    for (seed, radiance) in [(1, 1.0), (2, 0.25)] {
        let fit = watch(lamp, radiance, 300.0, seed).unwrap();
        for f in &fit.values.flicker {
            let phase = std::f64::consts::PI * 101.3 * f.exposure_s;
            let expected = 0.1 / 2f64.sqrt() * (phase.sin() / phase).abs();
            let off = (f.relative.value - expected).abs();
            assert!(
                off < 0.15 * expected + 3.0 * f.relative.std,
                "{f:?}, {expected}"
            );
        }
        assert_eq!(fit.values.steady_from_s, None, "{:?}", fit.values);
    }
}

#[test]
fn what_is_no_warming_lamp_is_refused() {
    let slow = LampModel {
        warm_up_s: 600.0,
        ..model()
    };
    let error = watch(slow, 0.1, 600.0, 1).unwrap_err();
    assert!(
        matches!(error, WatchError::Fit(LampFitError::StillWarming { .. })),
        "{error}"
    );
    for radiance in [0.0, 1e5] {
        let error = watch(model(), radiance, 300.0, 1).unwrap_err();
        assert!(matches!(error, WatchError::Exposure { .. }), "{error}");
    }
    // The lamp is knocked: 5% less from one level to the next.
    let levels: Vec<LampLevel> = (0..100)
        .map(|i| LampLevel {
            time_s: 5.0 * f64::from(i),
            level: if i < 61 { 1.0 } else { 0.95 },
        })
        .collect();
    let error = LampFit::new(&levels, &[]).unwrap_err();
    assert!(matches!(error, LampFitError::Jump { .. }), "{error}");
    let error = LampFit::new(&levels[..5], &[]).unwrap_err();
    assert_eq!(error, LampFitError::TooFew { found: 5 });
}

#[test]
fn a_steady_lamp_needs_no_warm_up() {
    let fit = watch(LampModel::default(), 0.1, 300.0, 9).unwrap();
    assert_eq!(fit.values.warm_up_time_s, 0.0, "{:?}", fit.values);
    let drift = fit.values.drift_per_hour;
    assert!((drift.value / drift.std).abs() < 4.5, "{drift:?}");
}
