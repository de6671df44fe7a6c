//! Where the time of a capture went.

use std::time::{Duration, Instant};

use serde::Serialize;

/// Time by what was waited for, seconds. Writing and merging run at the same time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spent {
    /// From the first command to the last merge.
    pub wall_s: f64,
    /// Exposures of all frames, those thrown away included.
    pub exposures_s: f64,
    /// The camera: exposures, waiting for a frame to begin, readout, settings.
    pub camera_s: f64,
    /// Homing, moves and switching the lamp.
    pub stage_s: f64,
    /// Pauses after moves and after the lamp was switched, warm-up.
    pub settling_s: f64,
}

impl Spent {
    /// Time that the devices needed for the plan.
    pub fn devices_s(&self) -> f64 {
        self.camera_s + self.stage_s + self.settling_s
    }

    /// Wall time over the devices'; `None` where they took none. Above 1 is what
    /// the program itself adds.
    pub fn over_devices(&self) -> Option<f64> {
        over(self.wall_s, self.devices_s())
    }

    /// Wall time over exposures, motion and settling alone. A camera whose frames
    /// follow at an interval longer than the exposure raises it.
    pub fn over_plan(&self) -> Option<f64> {
        over(
            self.wall_s,
            self.exposures_s + self.stage_s + self.settling_s,
        )
    }
}

fn over(wall_s: f64, part_s: f64) -> Option<f64> {
    (part_s > 0.0).then(|| wall_s / part_s)
}

impl std::fmt::Display for Spent {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            out,
            "of this the devices took {:.1} s: camera {:.1} s (exposures {:.1} s), stage {:.1} s, settling {:.1} s",
            self.devices_s(),
            self.camera_s,
            self.exposures_s,
            self.stage_s,
            self.settling_s,
        )
    }
}

/// Measures one wait.
pub(super) struct Stopwatch(Instant);

impl Stopwatch {
    pub(super) fn start() -> Self {
        Self(Instant::now())
    }

    pub(super) fn add_to(self, total_s: &mut f64) {
        *total_s += Duration::as_secs_f64(&self.0.elapsed());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratios_are_of_the_devices_time_and_of_the_plans() {
        let spent = Spent {
            wall_s: 10.5,
            exposures_s: 4.0,
            camera_s: 6.0,
            stage_s: 3.0,
            settling_s: 1.0,
        };
        assert_eq!(spent.devices_s(), 10.0);
        assert_eq!(spent.over_devices(), Some(1.05));
        assert_eq!(spent.over_plan(), Some(10.5 / 8.0));
        assert_eq!(Spent::default().over_devices(), None);
        assert_eq!(
            spent.to_string(),
            "of this the devices took 10.0 s: camera 6.0 s (exposures 4.0 s), stage 3.0 s, settling 1.0 s"
        );
    }
}
