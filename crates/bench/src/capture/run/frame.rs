//! One frame: stage, lamp and camera brought into its state, the frame taken and
//! handed on.

use std::sync::Arc;

use super::Run;
use crate::capture::CaptureError;
use crate::capture::exposure_check::Exposed;
use crate::capture::progress::{DriftSpan, FrameEvent, Progress};
use crate::device::temperature::Part;
use crate::device::{CameraSettings, FrameKey, FrameKind, LampChannel, LampState, RawFrame};
use crate::session::{Event, FrameTimes, Sidecar, drift, layout, utc_now};
use crate::units::{Seconds, StageAngles};

/// Number of an exposure that becomes no file, less the lamp's channel: frames of one number
/// follow each other under one lamp.
pub(super) const NOT_KEPT: u32 = u32::MAX - 1;

/// Whether a frame becomes a file.
fn is_kept(key: FrameKey) -> bool {
    key.exposure < NOT_KEPT - u32::from(u8::MAX)
}

/// One frame to take.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shot {
    pub(super) key: FrameKey,
    pub(super) exposure: Seconds,
    pub(super) lamp: LampState,
    pub(super) pilot: bool,
}

/// A frame that is there, and the exposure that the camera applied.
#[derive(Clone)]
pub(super) struct Taken {
    pub(super) frame: Arc<RawFrame>,
    pub(super) requested_s: f64,
    /// Read back.
    pub(super) exposure_s: f64,
    /// After how many homings of this run it was taken; 0: before this run.
    pub(super) homing: u32,
}

/// What a frame's signal is compared with.
#[derive(Clone, Copy)]
pub(super) enum Reference<'a> {
    /// Nothing.
    None,
    /// The channel's frame at another exposure: is the exposure what it claims?
    Exposure(&'a Taken),
    /// The channel's frame at the same exposure: is the lamp what it was?
    Lamp(&'a Taken),
    /// Likewise after all lights: it is reported and nothing is refused.
    Revisit(&'a Taken),
}

impl Reference<'_> {
    /// Whether the lamp is compared with itself.
    fn is_of_the_lamp(self) -> bool {
        matches!(self, Self::Lamp(_) | Self::Revisit(_))
    }
}

impl<'a> From<Option<&'a Taken>> for Reference<'a> {
    fn from(before: Option<&'a Taken>) -> Self {
        before.map_or(Self::None, Self::Exposure)
    }
}

impl Taken {
    pub(super) fn exposed(&self) -> Exposed<'_> {
        Exposed {
            counts: &self.frame.counts,
            exposure_s: self.exposure_s,
        }
    }
}

impl Run<'_> {
    /// Exposures of a light are numbered by round, then by lamp state: the
    /// channels in order, then the lamp off.
    pub(super) fn light_shot(
        &self,
        light: u32,
        round: u32,
        channel: usize,
        repeat: u32,
        exposure_s: f64,
    ) -> Shot {
        let states = self.plan.channels.len() as u32 + 1;
        Shot {
            key: FrameKey::new(
                light,
                round * states + channel as u32,
                repeat,
                FrameKind::Light,
            ),
            exposure: Seconds(exposure_s),
            lamp: LampState::On(
                self.plan
                    .channels
                    .get(channel)
                    .copied()
                    .unwrap_or(LampChannel(0)),
            ),
            pilot: false,
        }
    }

    pub(super) fn unlit_shot(
        &self,
        light: u32,
        round: u32,
        repeat: u32,
        exposure_s: f64,
        kind: FrameKind,
    ) -> Shot {
        let off = self.plan.channels.len();
        let mut shot = self.light_shot(light, round, off, repeat, exposure_s);
        shot.key.kind = kind;
        shot.lamp = LampState::Off;
        shot
    }

    /// The frame of this shot: from the session if it is there, else from the
    /// camera.
    pub(super) async fn take(
        &mut self,
        shot: Shot,
        reference: Reference<'_>,
    ) -> Result<Taken, CaptureError> {
        let (frame, sidecar, homing) = match self.present.get(&shot.key) {
            Some(entry) => {
                let (frame, sidecar) = self.session.read_frame(entry)?;
                check_same(&shot, &sidecar)?;
                let now_s = self.clock.now_s();
                self.clock.held(shot.exposure.0, shot.lamp, now_s);
                (Arc::new(frame), sidecar, 0)
            }
            None => {
                self.before_frame().await?;
                self.check_wall_clock(shot.key.light).await?;
                self.check_return(&shot, reference).await?;
                let place = self.disk.place().await?;
                let (frame, sidecar) = self.expose_again_if_lost(shot, reference).await?;
                let frame = Arc::new(frame);
                place.frame(Arc::clone(&frame), sidecar.clone());
                (frame, sidecar, self.homing)
            }
        };
        self.report_drift(&shot, reference, &sidecar, homing);
        let exposure_s = sidecar.applied.exposure.0;
        if !sidecar.pilot {
            self.merger.add(Arc::clone(&frame), sidecar).await?;
        }
        let taken = Taken {
            frame,
            requested_s: shot.exposure.0,
            exposure_s,
            homing,
        };
        if !matches!(reference, Reference::Revisit(_)) {
            self.keep_as_witness(shot, &taken);
        }
        Ok(taken)
    }

    /// What a frame that compares the lamp with itself shows.
    fn report_drift(
        &mut self,
        shot: &Shot,
        reference: Reference<'_>,
        sidecar: &Sidecar,
        homing: u32,
    ) {
        let (before, span) = match reference {
            Reference::Lamp(before) => (before, DriftSpan::Light),
            Reference::Revisit(before) => (before, DriftSpan::Session),
            Reference::None | Reference::Exposure(_) => return,
        };
        let (LampState::On(channel), Some(ratio), Some(of_noise)) =
            (shot.lamp, sidecar.exposure_ratio, sidecar.lamp_ratio_std)
        else {
            return;
        };
        let has_moved = span == DriftSpan::Session || before.homing != homing;
        let of_stage = if has_moved {
            drift::of_revisit(self.plan.stage_tolerance_deg)
        } else {
            0.0
        };
        self.observer.observe(&Progress::Drift {
            light: shot.key.light,
            channel,
            span,
            relative: ratio - 1.0,
            uncertainty: of_noise.hypot(of_stage),
        });
    }

    /// Brings stage, lamp and camera into the shot's state and takes the frame.
    pub(super) async fn expose(
        &mut self,
        shot: Shot,
        reference: Reference<'_>,
    ) -> Result<(RawFrame, Sidecar), CaptureError> {
        // Settings travel to the camera while the stage moves.
        let requested = CameraSettings::new(shot.exposure, self.plan.gain);
        let shutter_open = shot.key.kind != FrameKind::Dark;
        let stands = self.position.is_some_and(|(at, _)| at == shot.key.light);
        let discards = if stands && self.devices.is_set(shot.lamp, shutter_open) {
            shot.key
        } else {
            // No row with the frame itself, which must begin after stage and lamp are ready.
            FrameKey {
                exposure: u32::MAX,
                ..shot.key
            }
        };
        let latency = self.plan.settings_latency_frames;
        let change = self.devices.begin_settings(requested, latency, discards);
        let stage_position = self.go_to(shot.key.light).await?;
        self.stored.report(self.observer);
        let seconds = self.clock.left_s();
        self.observer.observe(&Progress::Left { seconds });
        self.observer.observe(&Progress::Frame {
            frame: FrameEvent::new(shot.key, shot.pilot, shot.exposure, shot.lamp),
            kept: is_kept(shot.key),
            done: self.clock.done(),
        });
        // Lamp, temperatures, shutter.
        self.devices
            .lamp(shot.lamp, self.plan.lamp_settle_s)
            .await?;
        let lamp_c = self.devices.lamp_c().await?;
        self.check_temperature(shot.key.light, Part::Lamp, lamp_c)
            .await?;
        let (applied, changed) = self.devices.settings_applied(change).await?;
        self.devices.shutter(shutter_open).await?;
        if changed {
            self.discarded = latency;
        }
        // The frame.
        let (frame, ratio) = self.grab_as_claimed(shot, applied, reference).await?;
        let applied = self.devices.stated().settings(applied);
        let camera_serial = self.check_serial()?;
        let now_s = self.clock.now_s();
        self.clock.took(shot.exposure.0, shot.lamp, !stands, now_s);
        let sensor_c = self.devices.sensor_c();
        self.check_temperature(shot.key.light, Part::Sensor, sensor_c)
            .await?;
        let retakes = self.devices.take_retakes();
        if !retakes.is_none() {
            let name = layout::frame_stem(shot.key);
            let text = format!("frame {name} was taken again: {retakes}");
            self.warn(shot.key.light, text).await?;
        }
        // How it was taken.
        let sidecar = Sidecar {
            key: shot.key,
            pilot: shot.pilot,
            lamp: shot.lamp,
            requested,
            applied,
            black_level_dn: self.noise.black_level_dn,
            bit_depth: self.devices.camera_info.bit_depth,
            mosaic: self.devices.camera_info.mosaic,
            camera_serial,
            stage_target: self.plan.lights[shot.key.light as usize],
            stage_position,
            frames_discarded: self.discarded,
            exposure_ratio: ratio.map(|known| known.ratio),
            lamp_ratio_std: ratio
                .filter(|_| reference.is_of_the_lamp())
                .map(|known| known.std_dev),
            time: FrameTimes {
                utc: utc_now(),
                monotonic_s: Seconds(self.clock.now_s()),
                device_s: frame.timestamp,
                device_sequence: frame.sequence,
                sensor_c,
                lamp_c,
                retakes,
            },
        };
        Ok((frame, sidecar))
    }

    /// Serial number of the camera that took the last frame, as it was reported with the
    /// frame or at the connection: all frames of a session are of one camera.
    fn check_serial(&mut self) -> Result<String, CaptureError> {
        let Some(found) = &self.devices.stated().serial else {
            return Ok(self.devices.camera_info.serial.clone());
        };
        let found = found.clone();
        let expected = self.camera_serial.get_or_insert_with(|| found.clone());
        if *expected == found {
            return Ok(found);
        }
        Err(CaptureError::OtherCamera {
            what: "serial number",
            expected: expected.clone(),
            found,
        })
    }

    /// The stage stands at the light, homed before its first move.
    pub(super) async fn go_to(&mut self, light: u32) -> Result<StageAngles, CaptureError> {
        if let Some((at, position)) = self.position
            && at == light
        {
            return Ok(position);
        }
        let target = self.plan.lights[light as usize];
        self.devices.lamp(LampState::Off, Seconds(0.0)).await?;
        if !self.devices.is_homed() {
            self.observer.observe(&Progress::Homing);
            let homed = self.devices.home();
            self.stored.report_during(self.observer, homed).await?;
            self.clock.homed(self.clock.now_s());
            self.homing += 1;
            self.granted = None;
            self.disk.record(Event::Homed).await?;
        }
        self.observer.observe(&Progress::Moving { light, target });
        let moved = self.devices.move_to(target);
        let position = self.stored.report_during(self.observer, moved).await?;
        self.devices.pause(self.plan.settle_s).await?;
        if self.position.is_none()
            && self.plan.lamp_warm_up_s.0 > 0.0
            && let Some(&channel) = self.plan.channels.first()
        {
            let warm_up_s = self.plan.lamp_warm_up_s;
            let warmed = self.devices.lamp(LampState::On(channel), warm_up_s);
            self.stored.report_during(self.observer, warmed).await?;
        }
        self.position = Some((light, position));
        self.disk
            .record(Event::LightStart {
                light,
                azimuth_deg: position.azimuth_deg,
                elevation_deg: position.elevation_deg,
            })
            .await?;
        Ok(position)
    }
}

/// A frame of the session must be the one that the plan leads to.
fn check_same(shot: &Shot, sidecar: &Sidecar) -> Result<(), CaptureError> {
    let same = sidecar.requested.exposure == shot.exposure
        && sidecar.lamp == shot.lamp
        && sidecar.pilot == shot.pilot;
    if same {
        return Ok(());
    }
    let words = |exposure: Seconds, lamp: LampState, pilot: bool| {
        let role = if pilot { "pilot" } else { "bracket" };
        format!("{exposure}, lamp {lamp}, as {role}")
    };
    Err(CaptureError::OtherFrame {
        frame: layout::frame_stem(shot.key),
        found: words(sidecar.requested.exposure, sidecar.lamp, sidecar.pilot),
        expected: words(shot.exposure, shot.lamp, shot.pilot),
    })
}
