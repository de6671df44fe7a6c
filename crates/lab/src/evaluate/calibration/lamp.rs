//! A simulated lamp that warms up and drifts, watched on a white card.

use super::{EvaluateError, Recovered};
use crate::calibration::lamp_watch::{Watch, WatchOptions};
use crate::device::lit_card::{LampModel, LitCard};

/// Warm-up and drift of one lamp.
pub(super) fn lamp(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    let model = LampModel {
        warm_up_fraction: 0.06,
        warm_up_s: 90.0,
        drift_per_hour: 0.01,
        ..LampModel::default()
    };
    let (card, mut camera) = LitCard::new(model, 0.1, seed);
    let mut switch = |on: bool| {
        card.switch(on);
        Ok(())
    };
    let mut wait = |seconds| card.wait(seconds);
    let mut progress = |_| {};
    let fit = Watch::new(&mut camera, &mut switch, &mut wait, &mut progress)
        .run(&WatchOptions {
            gain: 1.0,
            watch_s: 900.0,
            interval_s: 5.0,
            burst: 16,
            discard: 3,
        })
        .map_err(|error| EvaluateError::Fact(error.to_string()))?;
    let v = &fit.values;
    Ok(vec![
        Recovered {
            quantity: "warm-up constant",
            unit: "s",
            truth: model.warm_up_s,
            found: v.warm_up_constant_s,
        },
        Recovered {
            quantity: "drift",
            unit: "1/h",
            truth: model.drift_per_hour,
            found: v.drift_per_hour,
        },
    ])
}
