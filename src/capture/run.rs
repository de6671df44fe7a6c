//! The execution of a plan on a camera and a stage.

mod as_claimed;

use std::collections::HashMap;
use std::sync::Arc;

use super::CaptureError;
use super::bracket::{self, Decision, PilotRound};
use super::devices::Devices;
use super::disk::{BracketSink, Disk, Merger};
use super::exposure_check::Exposed;
use super::progress::{Clock, Observer, Outcome, Progress};
use crate::device::{
    Camera, CameraInfo, CameraSettings, FrameKey, FrameKind, LampChannel, LampState, LightStage,
    RawFrame,
};
use crate::interrupt::{Interrupt, StopLevel};
use crate::radiometry::exposure::BracketStep;
use crate::radiometry::sensor::SensorNoise;
use crate::session::{
    Event, FrameEntry, FrameTimes, PlanRecord, Session, SessionWriter, Sidecar, layout, utc_now,
};
use crate::units::{Seconds, StageAngles};

/// Frames beyond the camera's own latency that may be thrown away until a
/// change of settings shows.
const PATIENCE_FRAMES: u32 = 8;

/// Everything that a capture needs. The session was created, or opened by
/// [`SessionWriter::resume`]; its plan says what is done.
pub struct Capture<'a> {
    /// Connected, not configured.
    pub camera: Box<dyn Camera>,
    /// Connected, not homed.
    pub stage: Box<dyn LightStage>,
    /// Where the frames go.
    pub session: SessionWriter,
    /// The sensor as calibrated.
    pub noise: &'a SensorNoise,
    /// The sample's pixels, row by row; `None`: all pixels count as sample.
    pub interest: Option<&'a [bool]>,
    /// Merges each bracket.
    pub sink: Box<dyn BracketSink>,
    /// Hears of the progress.
    pub observer: &'a mut dyn Observer,
    /// Asked between frames, and while waiting.
    pub interrupt: Interrupt,
}

impl Capture<'_> {
    /// Carries out the plan. On every way out the lamp is off; where the session
    /// was not finished, it can be resumed.
    pub fn run(mut self) -> Result<Outcome, CaptureError> {
        let session = Session::open(self.session.root())?;
        check_camera(self.camera.info(), &session.record().versions.camera)?;
        if session.journal().is_complete() && missing_radiance(&session).is_empty() {
            if !session.root().join(layout::MANIFEST_FILE).exists() {
                self.session.write_manifest()?;
            }
            return Ok(Outcome::Complete);
        }
        tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .map_err(CaptureError::Thread)?
            .block_on(self.run_async(session))
    }

    async fn run_async(self, session: Session) -> Result<Outcome, CaptureError> {
        let devices = Devices::new(self.camera, self.stage, self.interrupt.clone())?;
        let disk = Disk::spawn(self.session)?;
        let merger = Merger::spawn(self.sink, &disk)?;
        let held: HashMap<FrameKey, FrameEntry> =
            session.frames().map(|entry| (entry.key, entry)).collect();
        let mut run = Run {
            lights: session.record().plan.lights.len(),
            plan: session.record().plan.clone(),
            noise: self.noise,
            interest: self.interest,
            observer: self.observer,
            interrupt: self.interrupt,
            devices,
            disk,
            merger,
            held,
            session,
            position: None,
            discarded: 0,
            clock: Clock::start(),
        };
        let result = run.all_lights().await;
        run.leave(result).await
    }
}

/// A resumed or planned capture needs the camera that it was planned for.
fn check_camera(found: &CameraInfo, expected: &CameraInfo) -> Result<(), CaptureError> {
    let words = |info: &CameraInfo| {
        let [width, height] = info.resolution_px;
        [
            ("resolution", format!("{width} x {height}")),
            ("bit depth", info.bit_depth.to_string()),
            ("colour filter", format!("{:?}", info.mosaic).to_lowercase()),
            ("serial number", info.serial.clone()),
        ]
    };
    for ((what, found), (_, expected)) in words(found).into_iter().zip(words(expected)) {
        if found != expected {
            return Err(CaptureError::OtherCamera {
                what,
                found,
                expected,
            });
        }
    }
    Ok(())
}

/// Lights whose frames are all there but whose merged image is not.
fn missing_radiance(session: &Session) -> Vec<u32> {
    let files = session.journal().files();
    (0..session.record().plan.lights.len() as u32)
        .filter(|&light| session.light_is_finished(light))
        .filter(|&light| {
            let name = layout::radiance_file(light);
            !(files.iter().any(|file| file.path == name) && session.root().join(&name).exists())
        })
        .collect()
}

struct Run<'a> {
    plan: PlanRecord,
    lights: usize,
    noise: &'a SensorNoise,
    interest: Option<&'a [bool]>,
    observer: &'a mut dyn Observer,
    interrupt: Interrupt,
    devices: Devices,
    disk: Disk,
    merger: Merger,
    /// Frames that were journalled before this run.
    held: HashMap<FrameKey, FrameEntry>,
    session: Session,
    /// The light that the stage stands at, and the position read back.
    position: Option<(u32, StageAngles)>,
    /// Frames thrown away since the settings changed.
    discarded: u32,
    clock: Clock,
}

/// One frame to take.
#[derive(Clone, Copy, Debug)]
struct Shot {
    key: FrameKey,
    exposure: Seconds,
    lamp: LampState,
    pilot: bool,
}

/// A frame that is there, and the exposure that the camera applied.
#[derive(Clone)]
struct Taken {
    frame: Arc<RawFrame>,
    exposure_s: f64,
}

impl Taken {
    fn exposed(&self) -> Exposed<'_> {
        Exposed {
            counts: &self.frame.counts,
            exposure_s: self.exposure_s,
        }
    }
}

impl Run<'_> {
    async fn all_lights(&mut self) -> Result<(), CaptureError> {
        if !self.held.is_empty() {
            let frames = self.held.len();
            self.observer.observe(Progress::Resumed { frames });
        }
        let unmerged = missing_radiance(&self.session);
        for light in 0..self.lights as u32 {
            if !self.session.light_is_finished(light) {
                self.one_light(light).await?;
            } else if unmerged.contains(&light) {
                self.merge_again(light).await?;
            }
            self.observer.observe(Progress::LightDone { light });
        }
        Ok(())
    }

    /// Feeds the merge from the disk.
    async fn merge_again(&mut self, light: u32) -> Result<(), CaptureError> {
        self.merger.begin(light).await?;
        let entries: Vec<FrameEntry> = self
            .session
            .frames()
            .filter(|entry| entry.key.light == light)
            .collect();
        for entry in entries {
            let (frame, sidecar) = self.session.read_frame(&entry)?;
            if !sidecar.pilot {
                self.merger.add(Arc::new(frame), sidecar).await?;
            }
        }
        self.merger.finish_bracket().await
    }

    /// Pilots, the bracket with its ambient frames, dark frames.
    async fn one_light(&mut self, light: u32) -> Result<(), CaptureError> {
        self.merger.begin(light).await?;
        let channels = self.plan.channels.clone();
        // The latest frame of each channel: what the next exposure is checked against.
        let mut latest: Vec<Option<Taken>> = vec![None; channels.len()];
        let mut rounds: Vec<PilotRound> = Vec::new();
        let mut is_lit = true;
        let steps = loop {
            match bracket::decide(self.noise, &self.plan.exposure, &rounds)? {
                Decision::Pilot { exposure_s } => {
                    let round = rounds.len() as u32;
                    let (pilot, lit) = self
                        .pilot_round(light, round, exposure_s, &mut latest)
                        .await?;
                    rounds.push(pilot);
                    is_lit = lit;
                }
                Decision::Bracket {
                    steps,
                    dark_snr,
                    reached,
                    clips,
                } if is_lit => {
                    self.planned(light, &steps, dark_snr, reached, clips)
                        .await?;
                    break steps;
                }
                Decision::Bracket { .. } | Decision::NoLight => {
                    return Err(CaptureError::NoLight {
                        light,
                        exposure_s: rounds.last().map_or(0.0, |round| round.exposure_s),
                    });
                }
            }
        };
        let rules = self.plan.exposure;
        let dark_frames = if self.has_shutter(light).await? {
            rules.dark_frames
        } else {
            0
        };
        let first = rounds.len() as u32;
        for (step, index) in steps.iter().zip(first..) {
            let part = f64::from(index - first) / steps.len() as f64;
            self.clock.within_light(light, self.lights, part);
            for (channel, latest) in latest.iter_mut().enumerate() {
                for repeat in 0..step.frames {
                    let shot = self.light_shot(light, index, channel, repeat, step.exposure_s);
                    let taken = self.take(shot, latest.as_ref()).await?;
                    if repeat + 1 == step.frames {
                        *latest = Some(taken);
                    }
                }
            }
            let ambient = if rules.ambient { step.frames } else { 0 };
            for (kind, frames) in [
                (FrameKind::Ambient, ambient),
                (FrameKind::Dark, dark_frames),
            ] {
                for repeat in 0..frames {
                    let shot = self.unlit_shot(light, index, repeat, step.exposure_s, kind);
                    self.take(shot, None).await?;
                }
            }
        }
        self.disk.record(Event::LightStop { light }).await?;
        self.merger.finish_bracket().await
    }

    /// One frame per channel, and one without the lamp to tell its light from
    /// the room's; whether any channel shows light.
    async fn pilot_round(
        &mut self,
        light: u32,
        round: u32,
        exposure_s: f64,
        latest: &mut [Option<Taken>],
    ) -> Result<(PilotRound, bool), CaptureError> {
        self.clock.within_light(light, self.lights, 0.0);
        for (channel, latest) in latest.iter_mut().enumerate() {
            let shot = Shot {
                pilot: true,
                ..self.light_shot(light, round, channel, 0, exposure_s)
            };
            *latest = Some(self.take(shot, latest.as_ref()).await?);
        }
        let unlit = if self.plan.exposure.ambient {
            let shot = Shot {
                pilot: true,
                ..self.unlit_shot(light, round, 0, exposure_s, FrameKind::Ambient)
            };
            Some(self.take(shot, None).await?)
        } else {
            None
        };
        let taken: Vec<&Taken> = latest.iter().flatten().collect();
        let frames: Vec<&[u16]> = taken.iter().map(|t| t.frame.counts.as_slice()).collect();
        let applied_s = taken.first().map_or(exposure_s, |t| t.exposure_s);
        let pilot = PilotRound::read(self.noise, applied_s, &frames, self.interest);
        let is_lit = match &unlit {
            None => true,
            Some(unlit) => frames.iter().any(|lit| {
                bracket::shows_light(self.noise, lit, &unlit.frame.counts, self.interest)
            }),
        };
        Ok((pilot, is_lit))
    }

    async fn planned(
        &mut self,
        light: u32,
        steps: &[BracketStep],
        dark_snr: f64,
        reached: bool,
        clips: bool,
    ) -> Result<(), CaptureError> {
        self.observer.observe(Progress::Planned {
            light,
            steps,
            dark_snr,
        });
        if clips {
            let shortest_s = self.plan.exposure.shortest_s;
            let text = format!(
                "light {light}: pixels of the sample are saturated in the shortest exposure of {shortest_s}"
            );
            self.warn(light, text).await?;
        }
        if !reached {
            let wanted = self.plan.exposure.dark_snr;
            let text = format!(
                "light {light}: the sample's dark pixels reach a signal-to-noise ratio of {dark_snr:.1} instead of {wanted}"
            );
            self.warn(light, text).await?;
        }
        Ok(())
    }

    async fn warn(&mut self, light: u32, text: String) -> Result<(), CaptureError> {
        self.observer.observe(Progress::Warning(&text));
        self.disk.record(Event::Warning { light, text }).await
    }

    /// Whether the camera can take dark frames. It is not asked where none are
    /// wanted or the session holds some of this light already.
    async fn has_shutter(&mut self, light: u32) -> Result<bool, CaptureError> {
        let is_dark = |key: &FrameKey| key.light == light && key.kind == FrameKind::Dark;
        if self.plan.exposure.dark_frames == 0 || self.held.keys().any(is_dark) {
            return Ok(true);
        }
        self.devices.shutter(true).await
    }

    /// Exposures of a light are numbered by round, then by lamp state: the
    /// channels in order, then the lamp off.
    fn light_shot(
        &self,
        light: u32,
        round: u32,
        channel: usize,
        repeat: u32,
        exposure_s: f64,
    ) -> Shot {
        let states = self.plan.channels.len() as u32 + 1;
        Shot {
            key: FrameKey {
                light,
                exposure: round * states + channel as u32,
                repeat,
                kind: FrameKind::Light,
            },
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

    fn unlit_shot(
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
    /// camera. `before` is the channel's frame at the exposure before.
    async fn take(&mut self, shot: Shot, before: Option<&Taken>) -> Result<Taken, CaptureError> {
        let (frame, sidecar, fresh) = match self.held.get(&shot.key) {
            Some(entry) => {
                let (frame, sidecar) = self.session.read_frame(entry)?;
                check_same(&shot, &sidecar)?;
                (Arc::new(frame), sidecar, false)
            }
            None => {
                if self.interrupt.level() >= StopLevel::AfterThisFrame {
                    return Err(CaptureError::Interrupted);
                }
                let (frame, sidecar) = self.expose_again_if_lost(shot, before).await?;
                (Arc::new(frame), sidecar, true)
            }
        };
        if fresh {
            self.disk.frame(Arc::clone(&frame), sidecar.clone()).await?;
        }
        let exposure_s = sidecar.applied.exposure.0;
        if !sidecar.pilot {
            self.merger.add(Arc::clone(&frame), sidecar).await?;
        }
        Ok(Taken { frame, exposure_s })
    }

    /// Brings stage, lamp and camera into the shot's state and takes the frame.
    async fn expose(
        &mut self,
        shot: Shot,
        before: Option<&Taken>,
    ) -> Result<(RawFrame, Sidecar), CaptureError> {
        let stage_position = self.go_to(shot.key.light).await?;
        self.observer.observe(Progress::Frame {
            key: shot.key,
            exposure: shot.exposure,
            lamp: shot.lamp,
            done: self.clock.done,
            left: self.clock.left(self.plan.estimated_s),
        });
        let requested = CameraSettings {
            exposure: shot.exposure,
            gain: self.plan.gain,
        };
        let (applied, changed) = self.devices.configure(requested).await?;
        self.devices
            .lamp(shot.lamp, self.plan.lamp_settle_s)
            .await?;
        self.devices
            .shutter(shot.key.kind != FrameKind::Dark)
            .await?;
        if changed {
            self.discarded = 0;
            for _ in 0..self.plan.settings_latency_frames {
                self.devices.grab(shot.key).await?;
                self.discarded += 1;
            }
        }
        let before = before.filter(|taken| {
            shot.key.repeat == 0 && (taken.exposure_s - applied.exposure.0).abs() > 1e-9
        });
        let (frame, exposure_ratio) = self.grab_as_claimed(shot, applied, before).await?;
        let retakes = self.devices.take_retakes();
        if !retakes.is_none() {
            let name = layout::frame_stem(shot.key);
            let text = format!("frame {name} was taken again: {retakes}");
            self.warn(shot.key.light, text).await?;
        }
        let sidecar = Sidecar {
            key: shot.key,
            pilot: shot.pilot,
            lamp: shot.lamp,
            requested,
            applied,
            black_level_dn: self.noise.black_level_dn,
            bit_depth: self.devices.camera_info.bit_depth,
            mosaic: self.devices.camera_info.mosaic,
            camera_serial: self.devices.camera_info.serial.clone(),
            stage_target: self.plan.lights[shot.key.light as usize],
            stage_position,
            frames_discarded: self.discarded,
            exposure_ratio,
            time: FrameTimes {
                utc: utc_now(),
                monotonic_s: Seconds(self.clock.start.elapsed().as_secs_f64()),
                device_s: frame.timestamp,
                device_sequence: frame.sequence,
                retakes,
            },
        };
        Ok((frame, sidecar))
    }

    /// The stage stands at the light, homed before its first move.
    async fn go_to(&mut self, light: u32) -> Result<StageAngles, CaptureError> {
        if let Some((at, position)) = self.position
            && at == light
        {
            return Ok(position);
        }
        let target = self.plan.lights[light as usize];
        self.devices.lamp(LampState::Off, Seconds(0.0)).await?;
        if !self.devices.is_homed() {
            self.observer.observe(Progress::Homing);
            self.devices.home().await?;
            self.disk.record(Event::Homed).await?;
        }
        self.observer.observe(Progress::Moving { light, target });
        let position = self.devices.move_to(target).await?;
        self.devices.pause(self.plan.settle_s).await?;
        if self.position.is_none()
            && self.plan.lamp_warm_up_s.0 > 0.0
            && let Some(&channel) = self.plan.channels.first()
        {
            self.devices
                .lamp(LampState::On(channel), self.plan.lamp_warm_up_s)
                .await?;
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

    /// Lamp off first, then the disk; the first error is the one that counts.
    async fn leave(self, result: Result<(), CaptureError>) -> Result<Outcome, CaptureError> {
        let Self {
            devices,
            disk,
            merger,
            observer,
            interrupt,
            clock,
            ..
        } = self;
        let mut spent = devices.spent();
        let result = match result {
            Ok(()) | Err(CaptureError::Interrupted) => devices.shut_down().await.and(result),
            Err(error) => {
                // Dropped while on guard: motion and lamp are stopped.
                drop(devices);
                Err(error)
            }
        };
        let result = match result {
            Ok(()) => {
                observer.observe(Progress::Merging);
                wait_for_merges(merger, &interrupt).await
            }
            stopped => stopped,
        };
        spent.wall_s = clock.start.elapsed().as_secs_f64();
        observer.observe(Progress::Ended(spent));
        match result {
            Ok(()) => disk.finish().await.map(|()| Outcome::Complete),
            Err(stop @ (CaptureError::Interrupted | CaptureError::StoppedNow)) => disk
                .leave(stop.to_string())
                .await
                .map(|()| Outcome::Interrupted),
            Err(error) => {
                // Where the disk is what failed, it cannot note it.
                drop(disk.leave(error.to_string()).await);
                Err(error)
            }
        }
    }
}

/// The lamp is off by now; a request to stop leaves the rest to a resume.
async fn wait_for_merges(merger: Merger, interrupt: &Interrupt) -> Result<(), CaptureError> {
    let merged = merger.finish();
    tokio::pin!(merged);
    loop {
        tokio::select! {
            biased;
            result = &mut merged => return result,
            () = tokio::time::sleep(std::time::Duration::from_millis(50)) => {}
        }
        if interrupt.level() >= StopLevel::AfterThisFrame {
            return Err(CaptureError::Interrupted);
        }
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
        format!("{exposure}, lamp {lamp:?}, as {role}")
    };
    Err(CaptureError::OtherFrame {
        frame: layout::frame_stem(shot.key),
        found: words(sidecar.requested.exposure, sidecar.lamp, sidecar.pilot),
        expected: words(shot.exposure, shot.lamp, shot.pilot),
    })
}
