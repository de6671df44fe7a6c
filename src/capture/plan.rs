//! The plan of a capture, made and checked before anything moves. Pure data in,
//! pure data out.

use std::path::Path;

use glam::DVec3;

use super::CaptureError;
use super::directions::plan_order;
use super::duration::Expected;
use super::reach::StageReach;
use crate::device::LampChannel;
use crate::device::temperature::TemperatureLimits;
use crate::radiometry::sensor::SensorNoise;
use crate::session::commit::free_bytes;
use crate::session::{ExposureRules, PlanRecord};
use crate::units::{Seconds, StageAngles};

/// Which light directions are wanted.
#[derive(Clone, Debug, PartialEq)]
pub enum LightChoice {
    /// This many, in the order of [`plan_order`].
    Count(usize),
    /// All in that order that keep this angle between them, degrees.
    Spacing(f64),
    /// These, in this order.
    Listed(Vec<StageAngles>),
}

/// What a plan is made from.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanRequest {
    /// Which light directions.
    pub lights: LightChoice,
    /// What the stage can reach.
    pub reach: StageReach,
    /// Unit direction from the sample to the camera in the stage's frame.
    pub coaxial: DVec3,
    /// Lamp channels, lit one after the other.
    pub channels: Vec<LampChannel>,
    /// Analogue gain.
    pub gain: f64,
    /// Exposures and averaging.
    pub exposure: ExposureRules,
    /// Wait after a move.
    pub settle: Seconds,
    /// Wait after the lamp was switched.
    pub lamp_settle: Seconds,
    /// Wait with the lamp on before the first light.
    pub lamp_warm_up: Seconds,
    /// Frames thrown away after a change of the camera's settings.
    pub settings_latency_frames: u32,
    /// Whether the first light is visited again after the last one.
    pub revisit_first: bool,
    /// How far the stage may stand from where it was sent, degrees.
    pub stage_tolerance_deg: f64,
    /// Temperatures above which the capture is suspended.
    pub limits: TemperatureLimits,
    /// Width and height of a frame, pixels.
    pub resolution_px: [u32; 2],
    /// How fast things go, for the estimate.
    pub pace: Pace,
}

/// How fast the devices are, for the estimate only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Speed of the stage, degrees per second; > 0.
    pub stage_deg_s: f64,
    /// Time to home.
    pub homing: Seconds,
    /// Time between frames where the exposure is shorter.
    pub frame_interval: Seconds,
    /// What a simulated bench computes before a light's first frame; 0 of real ones.
    pub view: Seconds,
}

/// PNG overhead and sidecar of one frame, bytes.
const FRAME_OVERHEAD_BYTES: u64 = 2048;
/// Mean, variance (32 bits each for three colours) and mask of a merged pixel, bytes.
const MERGED_PIXEL_BYTES: u64 = 28;

/// Makes the plan and checks every light against the soft limits.
///
/// # Errors
/// A light outside the limits or blocked by the camera, more lights than there are directions, exposure
/// rules that make no sense.
pub fn plan(request: &PlanRequest, noise: &SensorNoise) -> Result<PlanRecord, CaptureError> {
    let lights = choose_lights(request)?;
    if request.channels.is_empty() {
        return Err(CaptureError::Empty {
            what: "lamp channel",
        });
    }
    let [width, height] = request.resolution_px.map(u64::from);
    let pixels = width * height;
    let mut planned = PlanRecord {
        channels: request.channels.clone(),
        gain: request.gain,
        exposure: request.exposure,
        settle_s: request.settle,
        lamp_settle_s: request.lamp_settle,
        lamp_warm_up_s: request.lamp_warm_up,
        settings_latency_frames: request.settings_latency_frames,
        revisit_first: request.revisit_first && lights.len() > 1,
        stage_tolerance_deg: request.stage_tolerance_deg,
        limits: request.limits,
        estimated_s: Seconds(0.0),
        estimated_bytes: 0,
        lights,
    };
    let expected = Expected::of(&planned, pixels, &request.pace, noise)?;
    let lights = planned.lights.len();
    planned.estimated_s = Seconds(expected.total_s(lights));
    let frames_bytes = expected.frames_per_light * (2 * pixels + FRAME_OVERHEAD_BYTES);
    // The frames of the light that is merged lie there twice.
    planned.estimated_bytes =
        lights as u64 * (frames_bytes + MERGED_PIXEL_BYTES * pixels) + frames_bytes;
    Ok(planned)
}

fn choose_lights(request: &PlanRequest) -> Result<Vec<StageAngles>, CaptureError> {
    let order =
        |count, spacing_deg| plan_order(&request.reach, request.coaxial, count, spacing_deg);
    let lights = match &request.lights {
        LightChoice::Count(count) => {
            let lights = order(*count, 0.0);
            if lights.len() < *count {
                return Err(CaptureError::TooManyLights {
                    wanted: *count,
                    reachable: lights.len(),
                    blocked: request.reach.blocked().len(),
                });
            }
            lights
        }
        LightChoice::Spacing(spacing_deg) => order(usize::MAX, *spacing_deg),
        LightChoice::Listed(lights) => lights.clone(),
    };
    if lights.is_empty() {
        return Err(CaptureError::Empty { what: "light" });
    }
    request.reach.check(&lights)?;
    Ok(lights)
}

/// Checks that the disk that holds (or will hold) `folder` has room for the
/// plan and `reserve_bytes` beyond.
pub fn check_space(
    plan: &PlanRecord,
    folder: &Path,
    reserve_bytes: u64,
) -> Result<(), CaptureError> {
    let free_bytes = free_bytes(folder)?;
    let estimated_bytes = plan.estimated_bytes;
    if free_bytes >= estimated_bytes.saturating_add(reserve_bytes) {
        return Ok(());
    }
    Err(CaptureError::NotEnoughSpace {
        folder: folder.to_owned(),
        estimated_bytes,
        reserve_bytes,
        free_bytes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(lights: LightChoice) -> PlanRequest {
        PlanRequest {
            lights,
            reach: StageReach::of_angles([-170.0, 170.0], [10.0, 85.0]),
            coaxial: DVec3::Z,
            channels: (0..3).map(LampChannel).collect(),
            gain: 1.0,
            exposure: ExposureRules {
                pilot_s: Seconds(0.01),
                shortest_s: Seconds(1e-4),
                longest_s: Seconds(1.0),
                step_s: Seconds(1e-4),
                peak_fraction: 0.7,
                dark_snr: 20.0,
                ratio: 4.0,
                max_frames: 8,
                ambient: true,
                dark_frames: 2,
            },
            settle: Seconds(0.5),
            lamp_settle: Seconds(0.05),
            lamp_warm_up: Seconds(0.0),
            settings_latency_frames: 2,
            revisit_first: false,
            stage_tolerance_deg: 0.05,
            limits: TemperatureLimits::default(),
            resolution_px: [64, 48],
            pace: Pace {
                stage_deg_s: 20.0,
                homing: Seconds(10.0),
                frame_interval: Seconds(1.0 / 30.0),
                view: Seconds(0.0),
            },
        }
    }

    fn noise() -> SensorNoise {
        SensorNoise::ideal(0.4, 2.5, 64.0, 12)
    }

    #[test]
    fn time_and_bytes_grow_with_the_lights() {
        let of = |count| plan(&request(LightChoice::Count(count)), &noise()).unwrap();
        let (two, four) = (of(2), of(4));
        assert_eq!(four.lights[..2], two.lights);
        let light_bytes = (four.estimated_bytes - two.estimated_bytes) / 2;
        assert!(two.estimated_bytes > 2 * light_bytes);
        assert!(
            two.estimated_bytes < 3 * light_bytes,
            "one light lies there twice"
        );
        assert!(two.estimated_s.0 > 10.0 + 2.0 * 0.5 && four.estimated_s.0 > two.estimated_s.0);
        let again = PlanRequest {
            revisit_first: true,
            ..request(LightChoice::Count(2))
        };
        let again = plan(&again, &noise()).unwrap();
        assert!(again.revisit_first && again.estimated_s.0 > two.estimated_s.0);
        let alone = PlanRequest {
            revisit_first: true,
            ..request(LightChoice::Count(1))
        };
        assert!(!plan(&alone, &noise()).unwrap().revisit_first);
        // At least a pilot and one exposure of each channel, and one without lamp.
        assert!(two.estimated_bytes > 2 * (7 * 2 + 28) * 64 * 48);
    }

    #[test]
    fn lights_outside_the_limits_and_too_many_are_refused() {
        let listed = LightChoice::Listed(vec![
            StageAngles {
                azimuth_deg: 0.0,
                elevation_deg: 80.0,
            },
            StageAngles {
                azimuth_deg: 0.0,
                elevation_deg: 86.0,
            },
        ]);
        let error = plan(&request(listed), &noise()).unwrap_err().to_string();
        assert!(
            error.contains("light 1") && error.contains("10° to 85°"),
            "{error}"
        );
        assert!(matches!(
            plan(&request(LightChoice::Count(100_000)), &noise()),
            Err(CaptureError::TooManyLights { .. })
        ));
        assert!(plan(&request(LightChoice::Count(0)), &noise()).is_err());
    }

    #[test]
    fn a_plan_that_no_disk_holds_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut plan = plan(&request(LightChoice::Spacing(30.0)), &noise()).unwrap();
        check_space(&plan, folder.path(), 1000).unwrap();
        plan.estimated_bytes = u64::MAX / 2;
        assert!(matches!(
            check_space(&plan, &folder.path().join("not/made/yet"), u64::MAX),
            Err(CaptureError::NotEnoughSpace { .. })
        ));
    }
}
