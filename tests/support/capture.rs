//! A bench in memory for tests of the capture: a sphere under a lamp, a sensor
//! with keyed noise and late settings, and a record of what was done to it.

// Each test file uses a part of it.
#![allow(dead_code)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use rig::capture::plan::Pace;
use rig::capture::{BracketSink, Capture, CaptureError, Observer, Outcome, Progress};
use rig::device::*;
use rig::interrupt::{Interrupt, Signal};
use rig::radiometry::sensor::SensorNoise;
use rig::random::{Purpose, stream};
use rig::session::commit::Disk;
use rig::session::*;
use rig::units::{Seconds, StageAngles};

/// Pixels a side of the camera, unless the world says otherwise.
pub const SIZE: u32 = 8;
const LATENCY: u32 = 2;
/// What a capture calls the frames that nobody keeps.
const THROWN_AWAY: u32 = u32::MAX;

/// What the bench is, and what shall go wrong.
#[derive(Clone, Debug)]
pub struct World {
    pub position: Option<StageAngles>,
    pub lamp: LampState,
    pub stops: u32,
    pub moves: u32,
    pub homings: u32,
    pub grabs: u32,
    /// Pixels a side of the camera.
    pub size: u32,
    /// Of the sensor's noise.
    pub noise_seed: u64,
    /// Radiance of the sample in electrons per second.
    pub brightness_e_s: f64,
    /// Settings asked for, and how many frames still come with the old ones.
    settings: CameraSettings,
    old: CameraSettings,
    late: u32,
    shutter_open: bool,
    /// Frames beyond the camera's stated latency, at other than the first exposure.
    pub extra_latency: u32,
    /// True exposure over the one claimed.
    pub exposure_factor: f64,
    pub lamp_is_dead: bool,
    /// What a check of the stage's reference finds; `None`: it cannot tell.
    pub reference: Option<ReferenceCheck>,
    /// How far above its target's elevation the lamp truly stands, degrees.
    pub turned_deg: f64,
    pub fail_at_move: Option<u32>,
    pub fail_at_grab: Option<u32>,
    /// A defect of the camera's driver.
    pub panic_at_grab: Option<u32>,
    /// A driver that never returns from this frame.
    pub hang_at_grab: Option<u32>,
    /// A defect of who watches, at this many frames.
    pub panic_at_frame: Option<usize>,
    /// Who watches never returns from this frame.
    pub hang_at_frame: Option<usize>,
    /// `move_to` raises the interrupt this often, then waits until the stage is
    /// stopped from another thread.
    pub hang_in_move: u32,
    /// Stops are carried out but not confirmed.
    pub stop_fails: bool,
    /// Every move takes until the camera has its new settings.
    pub moves_wait_for_settings: bool,
    /// What the last frame was for, and what shone then; unknown after a change of
    /// settings.
    last: Option<(FrameKey, LampState, Option<StageAngles>, bool)>,
    /// What must remain free on the disk.
    pub reserve_bytes: u64,
    /// Brightness of the lamp is multiplied by this at every frame.
    pub drift_per_frame: f64,
    /// What sensor and lamp say of their temperature, °C, before the first frame.
    pub temperatures_c: [Option<f64>; 2],
    /// By how much both become warmer with every frame, °C.
    pub warming_c: f64,
    /// Asked for when this many frames have been grabbed.
    pub pause_at_grab: Option<u32>,
    /// How long a frame takes.
    pub frame_time: Duration,
    /// Raised when this many frames have been grabbed.
    pub interrupt_at_grab: Option<u32>,
    pub interrupt: Interrupt,
}

#[derive(Clone)]
pub struct Bench(pub Arc<Mutex<World>>);

impl Bench {
    pub fn new() -> Self {
        let settings = CameraSettings::new(Seconds(1.0), 1.0);
        Self(Arc::new(Mutex::new(World {
            position: None,
            lamp: LampState::Off,
            stops: 0,
            moves: 0,
            homings: 0,
            grabs: 0,
            size: SIZE,
            noise_seed: 5,
            brightness_e_s: 4e5,
            settings,
            old: settings,
            late: 0,
            shutter_open: true,
            extra_latency: 0,
            exposure_factor: 1.0,
            lamp_is_dead: false,
            reference: None,
            turned_deg: 0.0,
            fail_at_move: None,
            fail_at_grab: None,
            panic_at_grab: None,
            hang_at_grab: None,
            panic_at_frame: None,
            hang_at_frame: None,
            hang_in_move: 0,
            stop_fails: false,
            moves_wait_for_settings: false,
            last: None,
            reserve_bytes: 0,
            drift_per_frame: 1.0,
            temperatures_c: [None; 2],
            warming_c: 0.0,
            pause_at_grab: None,
            frame_time: Duration::ZERO,
            interrupt_at_grab: None,
            interrupt: Interrupt::new(),
        })))
    }

    pub fn with(change: impl FnOnce(&mut World)) -> Self {
        let bench = Self::new();
        change(&mut bench.world());
        bench
    }

    pub fn world(&self) -> MutexGuard<'_, World> {
        self.0.lock().unwrap()
    }
}

impl World {
    fn temperature_c(&self, part: usize) -> Option<f64> {
        let warmer_c = self.warming_c * f64::from(self.grabs);
        self.temperatures_c[part].map(|temperature_c| temperature_c + warmer_c)
    }
}

impl Bench {
    pub fn lamp_and_stops(&self) -> (LampState, u32) {
        let world = self.world();
        (world.lamp, world.stops)
    }

    /// At which frames whoever watches panics or hangs.
    fn at_frames(&self) -> (Option<usize>, Option<usize>) {
        let world = self.world();
        (world.panic_at_frame, world.hang_at_frame)
    }

    pub fn homings_and_grabs(&self) -> (u32, u32) {
        let world = self.world();
        (world.homings, world.grabs)
    }
}

pub struct Stage(Bench, StageInfo);
pub struct Cam(Bench, CameraInfo);
struct Stop(Bench);

pub fn stage_info() -> StageInfo {
    StageInfo {
        driver: "memory".into(),
        firmware: "1".into(),
        port: "memory".into(),
        has_watchdog: false,
    }
}

pub fn camera_info() -> CameraInfo {
    camera_of(SIZE)
}

pub fn camera_of(size: u32) -> CameraInfo {
    CameraInfo {
        driver: "memory".into(),
        model: "memory".into(),
        serial: "M-1".into(),
        resolution_px: [size, size],
        bit_depth: 12,
        mosaic: Mosaic::None,
        exposure_range: [Seconds(1e-4), Seconds(1.0)],
        exposure_step: Seconds(1e-4),
    }
}

fn io(what: &str) -> DeviceError {
    DeviceError::Io {
        device: "memory".into(),
        source: std::io::Error::other(what.to_owned()),
    }
}

impl StopHandle for Stop {
    fn stop(&mut self) -> Result<(), DeviceError> {
        let mut world = self.0.world();
        world.stops += 1;
        world.position = None;
        world.lamp = LampState::Off;
        if world.stop_fails {
            return Err(io("no confirmation"));
        }
        Ok(())
    }
}

impl LightStage for Stage {
    fn info(&self) -> &StageInfo {
        &self.1
    }

    fn home(&mut self) -> Result<StageStatus, DeviceError> {
        let mut world = self.0.world();
        world.homings += 1;
        world.position = Some(StageAngles::new(0.0, 0.0));
        Ok(StageStatus {
            activity: StageActivity::Idle,
            position: world.position,
            lamp: Some(world.lamp),
        })
    }

    fn move_to(&mut self, target: StageAngles) -> Result<StageAngles, DeviceError> {
        let mut world = self.0.world();
        assert_eq!(world.lamp, LampState::Off, "moved with the lamp on");
        if world.position.is_none() {
            return Err(DeviceError::NotHomed {
                device: "memory".into(),
                since: "connection".into(),
            });
        }
        world.moves += 1;
        if world.fail_at_move == Some(world.moves) {
            return Err(io("the move failed"));
        }
        if world.hang_in_move > 0 {
            for _ in 0..world.hang_in_move {
                world.interrupt.raise(Signal::Interrupt);
            }
            let stops = world.stops;
            drop(world);
            while self.0.world().stops == stops {
                std::thread::sleep(Duration::from_millis(1));
            }
            return Err(io("stopped"));
        }
        let until = Instant::now() + Duration::from_secs(20);
        while world.moves_wait_for_settings && world.late > 0 {
            assert!(Instant::now() < until, "the settings wait for the move");
            drop(world);
            std::thread::sleep(Duration::from_millis(1));
            world = self.0.world();
        }
        world.position = Some(target);
        Ok(target)
    }

    fn set_lamp(&mut self, lamp: LampState) -> Result<LampState, DeviceError> {
        self.0.world().lamp = lamp;
        Ok(lamp)
    }

    fn status(&mut self) -> Result<StageStatus, DeviceError> {
        let world = self.0.world();
        Ok(StageStatus {
            activity: StageActivity::Idle,
            position: world.position,
            lamp: Some(world.lamp),
        })
    }

    fn temperature_c(&mut self) -> Option<f64> {
        self.0.world().temperature_c(1)
    }

    fn check_reference(&mut self) -> Result<Option<ReferenceCheck>, DeviceError> {
        let world = self.0.world();
        assert_eq!(world.lamp, LampState::Off, "moved with the lamp on");
        assert!(world.position.is_some(), "checked without being homed");
        Ok(world.reference)
    }

    fn stop_handle(&self) -> Result<Box<dyn StopHandle>, DeviceError> {
        Ok(Box::new(Stop(self.0.clone())))
    }
}

impl Camera for Cam {
    fn info(&self) -> &CameraInfo {
        &self.1
    }

    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        let mut world = self.0.world();
        world.last = None;
        world.old = world.settings;
        world.settings = requested;
        let on_time = requested.exposure == PILOT;
        world.late = LATENCY + if on_time { 0 } else { world.extra_latency };
        Ok(requested)
    }

    fn temperature_c(&mut self) -> Option<f64> {
        self.0.world().temperature_c(0)
    }

    fn set_shutter(&mut self, open: bool) -> Result<bool, DeviceError> {
        self.0.world().shutter_open = open;
        Ok(true)
    }

    fn grab(&mut self, key: FrameKey) -> Result<RawFrame, DeviceError> {
        let frame_time = self.0.world().frame_time;
        std::thread::sleep(frame_time);
        let mut world = self.0.world();
        world.grabs += 1;
        if world.fail_at_grab == Some(world.grabs) {
            return Err(io("no frame"));
        }
        if world.panic_at_grab == Some(world.grabs) {
            drop(world);
            panic!("a defect of the driver");
        }
        if world.hang_at_grab == Some(world.grabs) {
            drop(world);
            hang();
        }
        let now = (world.lamp, world.position, world.shutter_open);
        if let Some((last, lamp, position, open)) = world.last
            && last.kind == key.kind
            && key.exposure != THROWN_AWAY
            && (last.light, last.exposure) == (key.light, key.exposure)
        {
            // A camera may hand over one that it began before it was asked.
            assert_eq!(
                (lamp, position, open),
                now,
                "a row of equal frames: {key:?}"
            );
        }
        world.last = Some((key, now.0, now.1, now.2));
        world.brightness_e_s *= world.drift_per_frame;
        if world.pause_at_grab == Some(world.grabs) {
            world.interrupt.ask_for_pause();
        }
        if world.interrupt_at_grab == Some(world.grabs) {
            world.interrupt.raise(Signal::Interrupt);
        }
        let settings = if world.late > 0 {
            world.late -= 1;
            world.old
        } else {
            world.settings
        };
        let exposure_s = settings.exposure.0 * world.exposure_factor_of(settings);
        let turned_deg = world.turned_deg;
        let light = world.position.map_or(glam::DVec3::Z, |angles| {
            let elevation_deg = angles.elevation_deg + turned_deg;
            let angles = StageAngles {
                elevation_deg,
                ..angles
            };
            angles.to_light()
        });
        let counts = (0..world.size * world.size)
            .map(|pixel| {
                let rate_e_s = world.rate_e_s(pixel, light);
                let seed =
                    u64::from(key.exposure) * 64 + u64::from(key.repeat) * 4 + key.kind as u64;
                let normal = stream(
                    world.noise_seed,
                    Purpose::Experiment,
                    key.light.into(),
                    pixel.into(),
                    seed,
                )
                .normal();
                let signal_e = (rate_e_s + 1.0) * exposure_s;
                let noisy_e = signal_e + normal * (signal_e + 6.25).sqrt();
                (64.0 + 0.4 * noisy_e).round().clamp(0.0, 4095.0) as u16
            })
            .collect();
        Ok(RawFrame {
            width: world.size,
            height: world.size,
            counts,
            sequence: Some(world.grabs.into()),
            timestamp: None,
        })
    }
}

impl World {
    /// The fault shows only at other than the first exposure.
    fn exposure_factor_of(&self, settings: CameraSettings) -> f64 {
        if settings.exposure == PILOT {
            1.0
        } else {
            self.exposure_factor
        }
    }

    /// A shaded sphere of contrast 1 : 50 before a black background, and a
    /// little light from the room.
    fn rate_e_s(&self, pixel: u32, light: glam::DVec3) -> f64 {
        if !self.shutter_open {
            return 0.0;
        }
        let centred = |i: u32| (f64::from(i) + 0.5) / f64::from(self.size) * 2.0 - 1.0;
        let (x, y) = (centred(pixel % self.size), -centred(pixel / self.size));
        let height_sq = 1.0 - x * x - y * y;
        let room_e_s = 20.0;
        let albedo = match self.lamp {
            LampState::On(LampChannel(0)) if !self.lamp_is_dead => 1.0,
            LampState::On(LampChannel(_)) if !self.lamp_is_dead => 0.3,
            _ => return room_e_s,
        };
        if height_sq <= 0.0 {
            return room_e_s;
        }
        let cosine = glam::DVec3::new(x, y, height_sq.sqrt())
            .dot(light)
            .max(0.02);
        room_e_s + self.brightness_e_s * albedo * cosine
    }
}

/// The merged image is the sum of what came in: enough to notice any difference.
#[derive(Default)]
struct SumSink {
    light: u32,
    sums: BTreeMap<(FrameKind, u64), Vec<u64>>,
}

impl BracketSink for SumSink {
    fn begin(&mut self, light: u32) -> Result<(), rig::capture::SinkError> {
        self.light = light;
        self.sums.clear();
        Ok(())
    }

    fn add(&mut self, frame: &RawFrame, sidecar: &Sidecar) -> Result<(), rig::capture::SinkError> {
        assert!(sidecar.key.light == self.light && !sidecar.pilot);
        let key = (sidecar.key.kind, sidecar.applied.exposure.0.to_bits());
        let sums = self
            .sums
            .entry(key)
            .or_insert_with(|| vec![0; frame.counts.len()]);
        for (sum, &count) in sums.iter_mut().zip(&frame.counts) {
            *sum += u64::from(count);
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<Vec<u8>, rig::capture::SinkError> {
        Ok(format!("{:?}", self.sums).into_bytes())
    }
}

/// Keeps what was reported.
#[derive(Default)]
pub struct Heard {
    pub events: Vec<Progress>,
    pub warnings: Vec<String>,
    pub done: Vec<f64>,
    pub resumed: usize,
    /// The lamp in every pause, and the frames that were on the disk.
    pub pauses: Vec<(LampState, usize)>,
    watched: Option<(Bench, PathBuf)>,
    panic_at_frame: Option<usize>,
    hang_at_frame: Option<usize>,
}

/// For as long as the process lives.
fn hang() -> ! {
    loop {
        std::thread::sleep(Duration::from_secs(60));
    }
}

impl Observer for Heard {
    fn observe(&mut self, progress: &Progress) {
        self.events.push(progress.clone());
        match progress {
            Progress::Warning { text } => self.warnings.push(text.to_owned()),
            // One that only compares the light after a new homing becomes no file.
            Progress::Frame {
                done, kept: true, ..
            } => {
                self.done.push(*done);
                assert!(self.panic_at_frame != Some(self.done.len()), "a defect");
                if self.hang_at_frame == Some(self.done.len()) {
                    hang();
                }
            }
            Progress::Resumed { frames } => self.resumed = *frames,
            _ => {}
        }
    }

    fn pause(&mut self) {
        let (bench, root) = self.watched.as_ref().unwrap();
        let frames = Session::open(root).unwrap().frames().count();
        self.pauses.push((bench.world().lamp, frames));
    }
}

pub fn noise() -> SensorNoise {
    SensorNoise {
        dark_current_e_s: 1.0,
        ..SensorNoise::ideal(0.4, 2.5, 64.0, 12)
    }
}

const PILOT: Seconds = Seconds(0.01);

pub fn record() -> SessionRecord {
    let mut record = SessionRecord {
        sample: "sphere".into(),
        true_material: None,
        seed: 1,
        rig: "memory".into(),
        config: String::new(),
        versions: Versions {
            rig: "0".into(),
            camera: camera_info(),
            stage: stage_info(),
        },
        ..example::record()
    };
    let plan = &mut record.plan;
    plan.channels = vec![LampChannel(0), LampChannel(1)];
    plan.exposure.pilot_s = PILOT;
    plan.exposure.shortest_s = Seconds(1e-4);
    plan.exposure.dark_frames = 1;
    plan.settle_s = Seconds(0.0);
    plan.settings_latency_frames = LATENCY;
    plan.estimated_s = Seconds(10.0);
    plan.lights = vec![StageAngles::new(0.0, 90.0), StageAngles::new(40.0, 35.0)];
    record
}

/// One light, one lamp channel, no averaging: as few frames as a capture has.
pub fn small_record() -> SessionRecord {
    let mut record = record();
    let plan = &mut record.plan;
    plan.channels.truncate(1);
    plan.lights.truncate(1);
    plan.exposure.max_frames = 1;
    plan.exposure.ratio = 64.0;
    record
}

pub fn create(disk: Arc<dyn Disk>, parent: &Path) -> Result<SessionWriter, SessionError> {
    create_from(disk, parent, &record())
}

pub fn create_from(
    disk: Arc<dyn Disk>,
    parent: &Path,
    record: &SessionRecord,
) -> Result<SessionWriter, SessionError> {
    SessionWriter::create(
        disk,
        &NewSession {
            parent,
            created: jiff::Timestamp::UNIX_EPOCH,
            short_id: "abc123",
            record,
            calibration: &[("sensor.toml".into(), b"gain".to_vec())],
        },
    )
}

pub fn capture(bench: &Bench, session: SessionWriter) -> (Result<Outcome, CaptureError>, Heard) {
    let camera = Box::new(Cam(bench.clone(), camera_of(bench.world().size)));
    let stage = Box::new(Stage(bench.clone(), stage_info()));
    run(bench, camera, stage, session)
}

/// The camera in memory, to be put behind another one.
pub fn camera_in_memory(bench: &Bench) -> Box<dyn Camera> {
    Box::new(Cam(bench.clone(), camera_of(bench.world().size)))
}

/// Likewise with another camera that looks at the bench.
pub fn capture_with_camera(
    bench: &Bench,
    camera: Box<dyn Camera>,
    session: SessionWriter,
) -> (Result<Outcome, CaptureError>, Heard) {
    let stage = Box::new(Stage(bench.clone(), stage_info()));
    run(bench, camera, stage, session)
}

/// Likewise with another stage, which keeps the bench's state true.
pub fn capture_with_stage(
    bench: &Bench,
    stage: Box<dyn LightStage>,
    session: SessionWriter,
) -> (Result<Outcome, CaptureError>, Heard) {
    let camera = Box::new(Cam(bench.clone(), camera_of(bench.world().size)));
    run(bench, camera, stage, session)
}

fn run(
    bench: &Bench,
    camera: Box<dyn Camera>,
    stage: Box<dyn LightStage>,
    session: SessionWriter,
) -> (Result<Outcome, CaptureError>, Heard) {
    let (panic_at_frame, hang_at_frame) = bench.at_frames();
    let mut heard = Heard {
        panic_at_frame,
        hang_at_frame,
        watched: Some((bench.clone(), session.root().to_owned())),
        ..Heard::default()
    };
    let interrupt = bench.world().interrupt.clone();
    let reserve_bytes = bench.world().reserve_bytes;
    let result = Capture {
        camera,
        stage,
        session,
        reserve_bytes,
        position_tolerance_deg: Some(0.05),
        pace: Pace {
            stage_deg_s: 20.0,
            homing: Seconds(1.0),
            frame_interval: Seconds(0.03),
            view: Seconds(0.0),
        },
        noise: &noise(),
        region_of_interest: None,
        sink: Box::new(SumSink::default()),
        chooser: None,
        observer: &mut heard,
        interrupt,
    }
    .run();
    (result, heard)
}

/// Goes on with the session on an undisturbed bench until it is complete.
pub fn resume(disk: Arc<dyn Disk>, root: &Path) -> Heard {
    let session = SessionWriter::resume(disk, root).unwrap();
    let (result, heard) = capture(&Bench::new(), session);
    assert_eq!(result.unwrap(), Outcome::Complete);
    heard
}

/// Every file of a session but its history (journal, manifest, quarantine);
/// sidecars without their times.
pub fn content(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let found = verify::verify(root).unwrap();
    assert!(found.is_intact() && found.complete, "{found:?}");
    let journal = Journal::read(root).unwrap();
    journal
        .files()
        .iter()
        .filter(|file| file.path != layout::MANIFEST_FILE)
        .map(|file| {
            let path = PathBuf::from(&file.path);
            let mut bytes = std::fs::read(root.join(&path)).unwrap();
            if path.starts_with(layout::RAW_FOLDER) && path.extension().unwrap() == "toml" {
                let text = String::from_utf8(bytes).unwrap();
                let (before, times) = text.split_once("[time]").unwrap();
                assert!(!times.contains("\n["), "{times}");
                bytes = before.as_bytes().to_vec();
            }
            (path, bytes)
        })
        .collect()
}

pub fn session_in(parent: &Path) -> Option<PathBuf> {
    std::fs::read_dir(parent)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| !path.file_name().unwrap().to_str().unwrap().starts_with('.'))
}
