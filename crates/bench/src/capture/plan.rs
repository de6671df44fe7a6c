//! The plan of a capture, made and checked before anything moves. Pure data in,
//! pure data out.

use std::path::Path;

use super::CaptureError;
use super::directions::{Aim, plan_order};
use super::duration::Expected;
pub use super::pace::Pace;
use super::reach::StageReach;
use crate::config::RigConfig;
use crate::device::{CameraInfo, LampChannel, manual};
use crate::radiometry::sensor::SensorNoise;
use crate::session::commit::{free_bytes, free_files};
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
    /// What the lights are to show.
    pub aim: Aim,
    /// The plan but for its lights and estimates.
    pub rules: PlanRecord,
    /// Width and height of a frame, pixels.
    pub resolution_px: [u32; 2],
    /// How fast things go, for the estimate.
    pub pace: Pace,
}

impl PlanRequest {
    /// Lights of a rig, by the rules of its rig file.
    pub fn of_rig(rig: &RigConfig, reach: StageReach, lights: LightChoice) -> Self {
        let capture = &rig.capture;
        let [shortest_s, longest_s] = capture.exposure_range;
        let step_s = rig.camera.exposure_step;
        // On a bench whose clock jumps, nothing needs to settle.
        let wait = |time: Seconds| match rig.is_instant() {
            true => Seconds(0.0),
            false => time,
        };
        let exposure = ExposureRules {
            pilot_s: pilot(shortest_s, longest_s, step_s),
            shortest_s,
            longest_s,
            step_s,
            peak_fraction: capture.peak_fraction,
            dark_snr: capture.dark_snr,
            ratio: capture.exposure_ratio,
            max_frames: capture.max_frames,
            ambient: capture.ambient,
            dark_frames: capture.dark_frames,
        };
        let channels = 0..rig.stage.measures.len() as u8;
        let rules = PlanRecord {
            channels: channels.map(LampChannel).collect(),
            gain: rig.camera.gain,
            exposure,
            settle_s: wait(capture.settle),
            lamp_settle_s: wait(capture.lamp_settle),
            lamp_warm_up_s: wait(capture.lamp_warm_up),
            settings_latency_frames: rig.camera.settings_latency_frames,
            revisit_first: capture
                .revisit_first
                .unwrap_or(rig.stage.driver_name() != manual::DRIVER),
            stage_tolerance_deg: rig.stage.position_tolerance_deg().unwrap_or(0.0),
            limits: rig.limits.temperature,
            estimated_s: Seconds(0.0),
            estimated_bytes: 0,
            estimated_files: 0,
            until: None,
            lights: Vec::new(),
        };
        Self {
            lights,
            reach,
            aim: Aim::of(&rig.geometry),
            rules,
            resolution_px: rig.camera.resolution_px,
            pace: Pace::of_rig(rig),
        }
    }

    /// Narrows the exposures to those of the camera that is connected.
    pub fn narrow_to(&mut self, camera: &CameraInfo) {
        let rules = &mut self.rules.exposure;
        let [shortest, longest] = camera.exposure_range;
        rules.shortest_s = Seconds(rules.shortest_s.0.max(shortest.0));
        rules.longest_s = Seconds(rules.longest_s.0.min(longest.0).max(rules.shortest_s.0));
        rules.step_s = Seconds(rules.step_s.0.max(camera.exposure_step.0));
        rules.pilot_s = pilot(rules.shortest_s, rules.longest_s, rules.step_s);
    }
}

/// The exposure in the middle of a range, as ratios go, on the camera's step.
fn pilot(shortest: Seconds, longest: Seconds, step: Seconds) -> Seconds {
    let middle_s = (shortest.0 * longest.0).sqrt();
    Seconds((middle_s / step.0).round().max(1.0) * step.0)
}

/// PNG overhead and sidecar of one frame, bytes.
const FRAME_OVERHEAD_BYTES: u64 = 2048;
/// Mean, variance (32 bits each for three colours) and mask of a merged pixel, bytes.
const MERGED_PIXEL_BYTES: u64 = 28;

/// Files and folders of a session that are of no light, and those of a fit and a report.
const OTHER_FILES: u64 = 40;

/// Makes the plan and checks every light against the soft limits.
///
/// # Errors
/// A light outside the limits or blocked by the camera, more lights than there are directions, exposure
/// rules that make no sense.
pub fn plan(request: &PlanRequest, noise: &SensorNoise) -> Result<PlanRecord, CaptureError> {
    let lights = choose_lights(request)?;
    if request.rules.channels.is_empty() {
        return Err(CaptureError::Empty {
            what: "lamp channel",
        });
    }
    let [width, height] = request.resolution_px.map(u64::from);
    let pixels = width * height;
    let mut planned = PlanRecord {
        lights,
        ..request.rules.clone()
    };
    let lights = planned.most_lights();
    planned.revisit_first &= lights > 1;
    let expected = Expected::of(&planned, pixels, &request.pace, noise)?;
    let chosen = (lights - planned.lights.len()) as f64;
    let planned_s = expected.total_s(planned.lights.len());
    planned.estimated_s = Seconds(planned_s + chosen * expected.chosen_s());
    let frames_bytes = expected.frames_per_light * (2 * pixels + FRAME_OVERHEAD_BYTES);
    // The frames of the light that is merged lie there twice.
    planned.estimated_bytes =
        lights as u64 * (frames_bytes + MERGED_PIXEL_BYTES * pixels) + frames_bytes;
    // Each frame with its sidecar, the merged image and a fit's two.
    planned.estimated_files = lights as u64 * (2 * expected.frames_per_light + 3) + OTHER_FILES;
    Ok(planned)
}

fn choose_lights(request: &PlanRequest) -> Result<Vec<StageAngles>, CaptureError> {
    let order = |count, spacing_deg| plan_order(&request.reach, request.aim, count, spacing_deg);
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
/// plan and `reserve_bytes` beyond, and that so many files can be made there.
pub fn check_space(
    plan: &PlanRecord,
    folder: &Path,
    reserve_bytes: u64,
) -> Result<(), CaptureError> {
    let free_bytes = free_bytes(folder)?;
    let PlanRecord {
        estimated_bytes,
        estimated_files,
        ..
    } = *plan;
    if let Some(free_files) = free_files(folder)?.filter(|free| *free < estimated_files) {
        let folder = folder.to_owned();
        return Err(CaptureError::NotEnoughFiles {
            folder,
            estimated_files,
            free_files,
        });
    }
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
    use glam::DVec3;

    fn request(lights: LightChoice) -> PlanRequest {
        let example = crate::session::example::plan();
        PlanRequest {
            lights,
            reach: StageReach::of_angles([-170.0, 170.0], [10.0, 85.0]),
            aim: Aim::along(DVec3::Z),
            rules: PlanRecord {
                channels: (0..3).map(LampChannel).collect(),
                exposure: ExposureRules {
                    pilot_s: Seconds(0.01),
                    shortest_s: Seconds(1e-4),
                    max_frames: 8,
                    ..example.exposure
                },
                settle_s: Seconds(0.5),
                lamp_settle_s: Seconds(0.05),
                stage_tolerance_deg: 0.05,
                estimated_s: Seconds(0.0),
                estimated_bytes: 0,
                lights: Vec::new(),
                ..example
            },
            resolution_px: [64, 48],
            pace: Pace {
                stage_deg_s: 20.0,
                homing: Seconds(10.0),
                frame_interval: Seconds(1.0 / 30.0),
                view: Seconds(0.0),
            },
        }
    }

    /// The same, with the first light visited again.
    fn revisiting(lights: LightChoice) -> PlanRequest {
        let mut request = request(lights);
        request.rules.revisit_first = true;
        request
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
        let again = plan(&revisiting(LightChoice::Count(2)), &noise()).unwrap();
        assert!(again.revisit_first && again.estimated_s.0 > two.estimated_s.0);
        let alone = plan(&revisiting(LightChoice::Count(1)), &noise()).unwrap();
        assert!(!alone.revisit_first);
        // At least a pilot and one exposure of each channel, and one without lamp.
        assert!(two.estimated_bytes > 2 * (7 * 2 + 28) * 64 * 48);
    }

    #[test]
    fn lights_outside_the_limits_and_too_many_are_refused() {
        let listed = LightChoice::Listed(vec![
            StageAngles::new(0.0, 80.0),
            StageAngles::new(0.0, 86.0),
        ]);
        let error = plan(&request(listed), &noise()).unwrap_err().to_string();
        assert!(
            error.contains("light 2") && error.contains("10° to 85°"),
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
