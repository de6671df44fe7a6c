//! The execution of a plan on a camera and a stage.

mod as_claimed;
mod between;
mod choosing;
mod ending;
mod exposure_proof;
mod frame;
mod returned;
mod revisit;
mod stored;

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

pub use self::choosing::Chooser;
use self::frame::{Reference, Shot, Taken};
use self::stored::Stored;
use super::bracket::{self, Decision, PilotRound};
use super::clock::Clock;
use super::devices::Devices;
use super::disk::{BracketSink, Disk, Merger};
use super::duration::Expected;
use super::plan::Pace;
use super::progress::{Ending, Observer, Outcome, Progress};
use super::wall_clock::WallClock;
use super::{CaptureError, Spent};
use crate::device::temperature::Part;
use crate::device::{Camera, CameraInfo, FrameKey, FrameKind, LightStage};
use crate::interrupt::Interrupt;
use crate::radiometry::exposure::BracketStep;
use crate::radiometry::sensor::SensorNoise;
use crate::session::{
    Event, FrameEntry, PlanRecord, Session, SessionRecord, SessionWriter, commit, layout,
};
use crate::shown::nth;
use crate::shown::with_causes;
use crate::units::StageAngles;

/// Everything that a capture needs. The session was created, or opened by
/// [`SessionWriter::resume`]; its plan says what is done.
pub struct Capture<'a> {
    /// Connected, not configured.
    pub camera: Box<dyn Camera>,
    /// Connected, not homed.
    pub stage: Box<dyn LightStage>,
    /// Where the frames go.
    pub session: SessionWriter,
    /// What must remain free on the session's disk, bytes.
    pub reserve_bytes: u64,
    /// How far a position of the stage may be off, degrees; `None` where nothing moves by
    /// itself. Frames from before and after a homing are one light's within that.
    pub position_tolerance_deg: Option<f64>,
    /// How fast the bench is, for the time left.
    pub pace: Pace,
    /// The sensor as calibrated.
    pub noise: &'a SensorNoise,
    /// The sample's pixels, row by row; `None`: all pixels count as sample.
    pub region_of_interest: Option<&'a [bool]>,
    /// Merges each bracket.
    pub sink: Box<dyn BracketSink>,
    /// Chooses the lights of a plan that is not fixed; without it none follows.
    pub chooser: Option<Box<dyn Chooser>>,
    /// Is informed of the progress.
    pub observer: &'a mut dyn Observer,
    /// Polled between frames, and while waiting.
    pub interrupt: Interrupt,
}

/// A path as other programs read it.
fn shown(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

impl Capture<'_> {
    /// Carries out the plan. On every way out the lamp is off; where the session
    /// was not finished, it can be resumed. The observer is informed of the end last,
    /// whatever it is.
    ///
    /// # Errors
    /// What the capture met that it cannot continue with.
    pub fn run(self) -> Result<Outcome, CaptureError> {
        let began = Instant::now();
        let root = shown(self.session.root());
        let observer = self.observer;
        let mut spent = None;
        let run = Capture {
            camera: self.camera,
            stage: self.stage,
            session: self.session,
            reserve_bytes: self.reserve_bytes,
            position_tolerance_deg: self.position_tolerance_deg,
            pace: self.pace,
            noise: self.noise,
            region_of_interest: self.region_of_interest,
            sink: self.sink,
            chooser: self.chooser,
            observer: &mut *observer,
            interrupt: self.interrupt,
        };
        let result = run.until_ended(&mut spent);
        observer.observe(&Progress::Ended {
            outcome: match result {
                Ok(Outcome::Complete) => Ending::Complete,
                Ok(Outcome::Interrupted) => Ending::Interrupted,
                Err(_) => Ending::Failed,
            },
            session: Some(root),
            elapsed_s: began.elapsed().as_secs_f64(),
            error: result.as_ref().err().map(|error| with_causes(error)),
            spent,
        });
        result
    }

    /// Also returns where the time went, once devices were used.
    fn until_ended(mut self, spent: &mut Option<Spent>) -> Result<Outcome, CaptureError> {
        let session = Session::open(self.session.root())?;
        let SessionRecord { sample, plan, .. } = session.record();
        self.observer.observe(&Progress::Begun {
            session: shown(session.root()),
            sample: sample.clone(),
            lights: plan.lights.clone(),
            channels: plan.channels.clone(),
            pid: std::process::id(),
        });
        check_camera(self.camera.info(), &session.record().versions.camera)?;
        if session.journal().is_complete() && missing_radiance(&session).is_empty() {
            if !session.root().join(layout::MANIFEST_FILE).exists() {
                self.session.write_manifest()?;
            }
            for light in 0..plan.lights.len() as u32 {
                self.observer.observe(&Progress::LightDone { light });
            }
            return Ok(Outcome::Complete);
        }
        tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .map_err(CaptureError::Thread)?
            .block_on(self.run_async(session, spent))
    }

    async fn run_async(
        self,
        session: Session,
        spent: &mut Option<Spent>,
    ) -> Result<Outcome, CaptureError> {
        let devices = Devices::new(self.camera, self.stage, self.interrupt.clone())?;
        let room = self.session.disk();
        let (disk, stored) = Disk::spawn(self.session, devices.watchdog())?;
        let merger = Merger::spawn(self.sink, &disk)?;
        let present: HashMap<FrameKey, FrameEntry> =
            session.frames().map(|entry| (entry.key, entry)).collect();
        let camera_serial = serial_of_frames(&session)?;
        let plan = &session.record().plan;
        let [width, height] = devices.camera_info.resolution_px.map(u64::from);
        let expected = Expected::of(plan, width * height, &self.pace, self.noise)?;
        let lights = 0..plan.lights.len() as u32;
        let finished: Vec<bool> = lights.map(|n| session.light_is_finished(n)).collect();
        let clock = Clock::start(expected, &finished);
        let mut run = Run {
            lights: session.record().plan.lights.len(),
            plan: session.record().plan.clone(),
            noise: self.noise,
            region_of_interest: self.region_of_interest,
            chooser: self.chooser,
            observer: self.observer,
            interrupt: self.interrupt,
            devices,
            disk,
            stored: Stored::new(stored),
            room,
            reserve_bytes: self.reserve_bytes,
            merger,
            present,
            camera_serial,
            session,
            position_tolerance_deg: self.position_tolerance_deg,
            position: None,
            homing: 0,
            witnesses: Vec::new(),
            granted: None,
            discarded: 0,
            unproven_reported: false,
            warm_reported: Vec::new(),
            clock,
            wall_clock: WallClock::start(),
        };
        let result = run.all_lights().await;
        run.leave(result, spent).await
    }
}

/// A resumed or planned capture needs the camera that it was planned for.
fn check_camera(found: &CameraInfo, expected: &CameraInfo) -> Result<(), CaptureError> {
    let words = |info: &CameraInfo| {
        let [width, height] = info.resolution_px;
        [
            ("resolution", format!("{width} x {height}")),
            ("bit depth", info.bit_depth.to_string()),
            ("colour filter", info.mosaic.to_string()),
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

/// The serial number in the sidecars of a session that was begun; `None`: it has no frames,
/// or they state none.
fn serial_of_frames(session: &Session) -> Result<Option<String>, CaptureError> {
    let Some(first) = session.frames().next() else {
        return Ok(None);
    };
    let (_, sidecar) = session.read_frame(&first)?;
    Ok((!sidecar.camera_serial.is_empty()).then_some(sidecar.camera_serial))
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
    region_of_interest: Option<&'a [bool]>,
    chooser: Option<Box<dyn Chooser>>,
    observer: &'a mut dyn Observer,
    interrupt: Interrupt,
    devices: Devices,
    disk: Disk,
    /// What the disk has journalled.
    stored: Stored,
    /// Reports its free space.
    room: Arc<dyn commit::Disk>,
    reserve_bytes: u64,
    merger: Merger,
    /// Frames that were journalled before this run.
    present: HashMap<FrameKey, FrameEntry>,
    /// Serial number of the camera that took the session's frames, once it is known.
    camera_serial: Option<String>,
    session: Session,
    /// As in [`Capture`].
    position_tolerance_deg: Option<f64>,
    /// How often the stage was homed in this run.
    homing: u32,
    /// The latest lit frame of each channel at the light under way.
    witnesses: Vec<(Shot, Taken)>,
    /// Of a light begun before the last homing: how far its signal is off since, relative,
    /// within what the stage's tolerance explains.
    granted: Option<(u32, f64)>,
    /// The light that the stage stands at, and the position read back.
    position: Option<(u32, StageAngles)>,
    /// Frames thrown away since the settings changed.
    discarded: u32,
    /// Whether it was reported that the images cannot show the exposure.
    unproven_reported: bool,
    /// Parts of which it was reported that they are nearly too hot.
    warm_reported: Vec<Part>,
    clock: Clock,
    wall_clock: WallClock,
}

impl Run<'_> {
    async fn all_lights(&mut self) -> Result<(), CaptureError> {
        if !self.present.is_empty() {
            let frames = self.present.len();
            self.observer.observe(&Progress::Resumed { frames });
        }
        let seconds = self.clock.left_s();
        self.observer.observe(&Progress::Left { seconds });
        let unmerged = missing_radiance(&self.session);
        let mut light = 0;
        while light < self.lights as u32 || self.another_follows().await? {
            if !self.session.light_is_finished(light) {
                self.one_light(light).await?;
            } else if unmerged.contains(&light) {
                self.merge_again(light).await?;
            }
            self.observer.observe(&Progress::LightDone { light });
            light += 1;
        }
        self.revisit_first_light().await?;
        self.check_reference().await?;
        self.check_wall_clock(self.lights.saturating_sub(1) as u32)
            .await
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

    /// Pilots, the bracket with its ambient frames, dark frames, and the first
    /// exposure once more.
    async fn one_light(&mut self, light: u32) -> Result<(), CaptureError> {
        // Pilot frames until a bracket can be planned.
        self.merger.begin(light).await?;
        self.clock.begin_light();
        let channels = self.plan.channels.clone();
        // The latest frame of each channel: what the next exposure is checked against.
        let mut latest: Vec<Option<Taken>> = vec![None; channels.len()];
        let mut rounds: Vec<PilotRound> = Vec::new();
        let mut is_lit = true;
        // Whether the images have shown that the camera obeys its exposure.
        let mut is_shown = false;
        let steps = loop {
            match bracket::decide(self.noise, &self.plan.exposure, &rounds)? {
                Decision::Pilot { exposure_s } => {
                    let round = rounds.len() as u32;
                    let before = latest.clone();
                    let (pilot, lit) = self
                        .pilot_round(light, round, exposure_s, &mut latest)
                        .await?;
                    is_shown |= self.any_is_shown(&before, &latest);
                    rounds.push(pilot);
                    is_lit = lit;
                }
                Decision::Bracket {
                    steps,
                    dark_snr,
                    reached,
                    clips,
                } if is_lit => {
                    if clips && rounds.last().is_some_and(PilotRound::is_saturated) {
                        let exposure_s = self.plan.exposure.shortest_s.0;
                        return Err(CaptureError::AllSaturated { light, exposure_s });
                    }
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
        // The bracket: at each exposure all channels, then ambient and dark frames.
        let rules = self.plan.exposure;
        let dark_frames = if self.has_shutter(light).await? {
            rules.dark_frames
        } else {
            0
        };
        let first = rounds.len() as u32;
        // What the lamp is compared with when the light is done.
        let mut before = None;
        for (step, index) in steps.iter().zip(first..) {
            let mut firsts = Vec::new();
            let before_step = latest.clone();
            for (channel, latest) in latest.iter_mut().enumerate() {
                for repeat in 0..step.frames {
                    let shot = self.light_shot(light, index, channel, repeat, step.exposure_s);
                    let taken = self.take(shot, latest.as_ref().into()).await?;
                    if repeat == 0 {
                        firsts.push(taken.clone());
                    }
                    if repeat + 1 == step.frames {
                        *latest = Some(taken);
                    }
                }
            }
            is_shown |= self.any_is_shown(&before_step, &latest);
            self.keep_for_drift(&mut before, firsts);
            let ambient = if rules.ambient { step.frames } else { 0 };
            for (kind, frames) in [
                (FrameKind::Ambient, ambient),
                (FrameKind::Dark, dark_frames),
            ] {
                for repeat in 0..frames {
                    let shot = self.unlit_shot(light, index, repeat, step.exposure_s, kind);
                    self.take(shot, Reference::None).await?;
                }
            }
        }
        // Checks of the exposure and of the lamp.
        let last = first + steps.len() as u32;
        if !is_shown {
            self.prove_exposure(light, last + 1, &latest).await?;
        }
        self.check_drift(light, last, before).await?;
        self.clock.end_light();
        self.disk.record(Event::LightStop { light }).await?;
        self.merger.finish_bracket().await
    }

    /// One frame per channel, and one without the lamp to distinguish its light from
    /// the room's; whether any channel shows light.
    async fn pilot_round(
        &mut self,
        light: u32,
        round: u32,
        exposure_s: f64,
        latest: &mut [Option<Taken>],
    ) -> Result<(PilotRound, bool), CaptureError> {
        for (channel, latest) in latest.iter_mut().enumerate() {
            let shot = Shot {
                pilot: true,
                ..self.light_shot(light, round, channel, 0, exposure_s)
            };
            *latest = Some(self.take(shot, latest.as_ref().into()).await?);
        }
        let unlit = if self.plan.exposure.ambient {
            let shot = Shot {
                pilot: true,
                ..self.unlit_shot(light, round, 0, exposure_s, FrameKind::Ambient)
            };
            Some(self.take(shot, Reference::None).await?)
        } else {
            None
        };
        let taken: Vec<&Taken> = latest.iter().flatten().collect();
        let frames: Vec<&[u16]> = taken.iter().map(|t| t.frame.counts.as_slice()).collect();
        let applied_s = taken.first().map_or(exposure_s, |t| t.exposure_s);
        let pilot = PilotRound::read(self.noise, applied_s, &frames, self.region_of_interest);
        let is_lit = match &unlit {
            None => true,
            Some(unlit) => frames.iter().any(|lit| {
                bracket::shows_light(
                    self.noise,
                    lit,
                    &unlit.frame.counts,
                    self.region_of_interest,
                )
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
        let rules = self.plan.exposure;
        self.clock.decided(steps, &rules, self.plan.channels.len());
        self.observer.observe(&Progress::Planned {
            light,
            steps: steps.to_vec(),
            dark_snr: Some(dark_snr).filter(|snr| snr.is_finite()),
        });
        if clips {
            let shortest_s = self.plan.exposure.shortest_s;
            let text = format!(
                "{light}: pixels of the sample are saturated in the shortest exposure of {shortest_s}",
                light = nth("light", light)
            );
            self.warn(light, text).await?;
        }
        if !reached {
            let wanted = self.plan.exposure.dark_snr;
            let text = format!(
                "{light}: the sample's dark pixels reach a signal-to-noise ratio of {dark_snr:.1} instead of {wanted}",
                light = nth("light", light)
            );
            self.warn(light, text).await?;
        }
        Ok(())
    }

    async fn warn(&mut self, light: u32, text: String) -> Result<(), CaptureError> {
        let warning = Progress::Warning { text: text.clone() };
        self.observer.observe(&warning);
        self.disk.record(Event::Warning { light, text }).await
    }

    /// Whether the camera can take dark frames. It is not tried where none are
    /// wanted or the session holds some of this light already.
    async fn has_shutter(&mut self, light: u32) -> Result<bool, CaptureError> {
        let is_dark = |key: &FrameKey| key.light == light && key.kind == FrameKind::Dark;
        if self.plan.exposure.dark_frames == 0 || self.present.keys().any(is_dark) {
            return Ok(true);
        }
        self.devices.shutter(true).await
    }
}
