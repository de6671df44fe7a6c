//! A free-running camera that looks at the bench.

use crate::bench::Bench;
use crate::failing::{Failing, due};
use crate::sensor::{FrameKey, NoiseKey, SensorModel};
use crate::{Illumination, RadianceSource, random};
use std::collections::VecDeque;
use std::sync::Arc;

/// What the camera around the sensor can do.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct CameraConfig {
    /// Shortest and longest exposure, seconds.
    pub exposure_range_s: [f64; 2],
    pub exposure_step_s: f64,
    /// Smallest and largest gain, as factors.
    pub gain_range: [f64; 2],
    pub gain_step: f64,
    /// Time between the starts of two frames, seconds, where the exposure is not longer.
    pub frame_interval_s: f64,
    /// From the end of an exposure until the frame is there, seconds.
    pub readout_s: f64,
    /// How many frames begin with the old settings after a change.
    pub settings_latency_frames: u32,
    /// Whether it can shut out the light by itself.
    pub has_shutter: bool,
    /// Seed of the noise of every frame.
    pub noise_seed: u64,
    /// Temperature of the sensor when it is switched on, and when it has run for long,
    /// degrees Celsius.
    pub temperature_c: [f64; 2],
    /// Time constant between them, seconds.
    pub warming_s: f64,
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            exposure_range_s: [20e-6, 30.0],
            exposure_step_s: 10e-6,
            gain_range: [1.0, 16.0],
            gain_step: 0.01,
            frame_interval_s: 1.0 / 30.0,
            readout_s: 0.01,
            settings_latency_frames: 2,
            has_shutter: true,
            noise_seed: 0,
            temperature_c: [24.0, 36.0],
            warming_s: 900.0,
        }
    }
}

/// Exposure and gain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MockSettings {
    /// Exposure of one frame, seconds.
    pub exposure_s: f64,
    /// Gain as a factor.
    pub gain: f64,
}

/// A frame and what is true of it.
#[derive(Clone, Debug, PartialEq)]
pub struct MockFrame {
    /// Pixels per row.
    pub width: u32,
    /// Rows, from the top.
    pub height: u32,
    /// Raw counts, DN, row by row.
    pub counts: Vec<u16>,
    /// Running number of the frame; a gap is a frame that nobody got.
    pub sequence: u64,
    /// Start of the exposure on the bench's clock, seconds.
    pub timestamp_s: f64,
    /// Settings it was truly taken with.
    pub settings: MockSettings,
    /// Light it was truly taken under.
    pub illumination: Illumination,
    /// Whether the stage turned during the exposure (by more than 1e-6 degrees).
    pub moved: bool,
    /// Frames that are missing before it, counted from the moment it was requested.
    pub lost: u64,
    /// Whether the transfer says of itself that it went wrong.
    pub damaged: bool,
}

/// Why there is no frame.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum MockCameraError {
    #[error("the camera was disconnected")]
    Disconnected,
    #[error("no frame within {timeout_s} s")]
    NoFrame { timeout_s: f64 },
    #[error("the radiance has {radiance} values, the sensor {sensor} pixels")]
    SizeMismatch { radiance: usize, sensor: usize },
}

/// What goes wrong at a camera; numbers count what it happens to.
#[derive(Debug, Default)]
pub struct Failures {
    /// Frames are lost; their numbers are missing.
    pub lost: u32,
    /// Frames come with a band of random counts, marked as damaged.
    pub corrupt: u32,
    /// Frames end early: a quarter of their counts is missing.
    pub truncated: u32,
    /// Frames have half the height.
    pub resized: u32,
    /// Grabs give the frame before, which nobody had fetched.
    pub late: u32,
    /// Grabs end without a frame.
    pub stalled: u32,
    /// Changes of settings are confirmed but not applied.
    pub ignored_settings: u32,
    /// It is unplugged.
    pub is_disconnected: bool,
}

/// Handle by which a test makes a camera fail.
pub type CameraFaults = Failing<Failures>;

/// A grab without a frame gives up after this long on the bench's clock, seconds.
const STALL_TIMEOUT_S: f64 = 5.0;

/// The camera: bench and sensor are the truth, the source is the scene.
pub struct SimulatedCamera {
    config: CameraConfig,
    bench: Bench,
    sensor: SensorModel,
    source: Arc<dyn RadianceSource>,
    faults: CameraFaults,
    settings: MockSettings,
    /// Changes under way: from which frame on, and to what.
    changes: VecDeque<(u64, MockSettings)>,
    shutter_open: bool,
    next_sequence: u64,
    next_start_s: f64,
    /// When it was switched on, on the bench's clock.
    on_since_s: f64,
    /// Number, start and settings of the frame that was given last.
    last: Option<(u64, f64, MockSettings)>,
}

impl SimulatedCamera {
    /// A camera that begins to run now, with its shortest exposure, gain 1 and
    /// its shutter open.
    pub fn new(
        config: CameraConfig,
        bench: Bench,
        sensor: SensorModel,
        source: Arc<dyn RadianceSource>,
    ) -> Self {
        let settings = MockSettings {
            exposure_s: config.exposure_range_s[0],
            gain: config.gain_range[0],
        };
        let next_start_s = bench.clock().now_s();
        Self {
            config,
            bench,
            sensor,
            source,
            faults: CameraFaults::default(),
            settings,
            changes: VecDeque::new(),
            shutter_open: true,
            next_sequence: 0,
            next_start_s,
            on_since_s: next_start_s,
            last: None,
        }
    }

    /// What the camera can do.
    pub fn config(&self) -> &CameraConfig {
        &self.config
    }

    /// The true sensor.
    pub fn sensor(&self) -> &SensorModel {
        &self.sensor
    }

    /// The bench it looks at.
    pub fn bench(&self) -> &Bench {
        &self.bench
    }

    /// Handle for making it fail.
    pub fn faults(&self) -> CameraFaults {
        self.faults.clone()
    }

    /// Of the sensor, degrees Celsius: it warms up from when it was switched on.
    pub fn temperature_c(&self) -> f64 {
        let [cold, warm] = self.config.temperature_c;
        let on_s = self.bench.clock().now_s() - self.on_since_s;
        warm + (cold - warm) * (-on_s / self.config.warming_s).exp()
    }

    /// Sets exposure and gain, rounded to the camera's steps and clamped to its
    /// range, and returns the values it confirms. The frames that begin before
    /// the latency is over still have the old ones.
    pub fn configure(
        &mut self,
        exposure_s: f64,
        gain: f64,
    ) -> Result<MockSettings, MockCameraError> {
        self.check()?;
        let confirmed = MockSettings {
            exposure_s: quantise(
                exposure_s,
                self.config.exposure_step_s,
                self.config.exposure_range_s,
            ),
            gain: quantise(gain, self.config.gain_step, self.config.gain_range),
        };
        self.run_until(self.bench.clock().now_s());
        if !due(&mut self.faults.now().ignored_settings) {
            let from = self.next_sequence + u64::from(self.config.settings_latency_frames);
            self.changes.push_back((from, confirmed));
        }
        Ok(confirmed)
    }

    /// Opens or closes the shutter for the frames that begin from now on.
    /// `false`: there is none, and nothing changed.
    pub fn set_shutter(&mut self, open: bool) -> Result<bool, MockCameraError> {
        self.check()?;
        if self.config.has_shutter {
            self.shutter_open = open;
        }
        Ok(self.config.has_shutter)
    }

    /// The next frame that begins at this moment or later. It is there when its
    /// exposure and readout are over, or, in real time, when it has been
    /// computed, if that takes longer.
    pub fn grab(&mut self, key: FrameKey) -> Result<MockFrame, MockCameraError> {
        let now_s = self.bench.clock().now_s();
        self.grab_since(key, now_s)
    }

    /// The next frame that nobody got yet and that begins at this moment or later,
    /// which may be over: the camera runs by itself, and holds what nobody asked
    /// for until the settings change.
    pub fn grab_since(
        &mut self,
        key: FrameKey,
        since_s: f64,
    ) -> Result<MockFrame, MockCameraError> {
        // Which frame.
        self.check()?;
        let clock = self.bench.clock().clone();
        if due(&mut self.faults.now().stalled) {
            clock.wait_until(clock.now_s() + STALL_TIMEOUT_S);
            self.check()?;
            return Err(MockCameraError::NoFrame {
                timeout_s: STALL_TIMEOUT_S,
            });
        }
        self.run_until(since_s.min(clock.now_s()));
        let first = self.next_sequence;
        while due(&mut self.faults.now().lost) {
            self.next_frame();
        }
        let (sequence, start_s, settings) = match &self.last {
            Some(last) if due(&mut self.faults.now().late) => *last,
            _ => self.next_frame(),
        };
        self.last = Some((sequence, start_s, settings));
        // What the sensor sees meanwhile.
        let end_s = start_s + settings.exposure_s;
        // In real time the scene is rendered during the exposure, from what the
        // bench is going to do, and once more only if something else happened.
        let mut rendered = None;
        if clock.is_real_time() && self.shutter_open {
            let expected = self.bench.illumination_over(start_s, end_s);
            rendered = Some((expected, self.source.radiance(&expected)));
        }
        clock.wait_until(end_s + self.config.readout_s);
        self.check()?;
        let illumination = self.bench.illumination_over(start_s, end_s);
        let [width, mut height] = self.sensor.resolution_px();
        let pixels = width as usize * height as usize;
        let radiance = match rendered {
            _ if !self.shutter_open => Arc::new(vec![0.0; pixels]),
            Some((expected, radiance)) if expected == illumination => radiance,
            _ => self.source.radiance(&illumination),
        };
        if radiance.len() != pixels {
            return Err(MockCameraError::SizeMismatch {
                radiance: radiance.len(),
                sensor: pixels,
            });
        }
        // Its counts, and what spoils them.
        let noise = NoiseKey {
            seed: self.config.noise_seed,
            frame: key,
        };
        let mut counts = self
            .sensor
            .expose(&radiance, settings.exposure_s, settings.gain, noise);
        let damaged = due(&mut self.faults.now().corrupt);
        if damaged {
            self.corrupt(&mut counts, sequence);
        }
        if due(&mut self.faults.now().truncated) {
            counts.truncate(pixels * 3 / 4);
        }
        if due(&mut self.faults.now().resized) {
            height /= 2;
            counts.truncate(width as usize * height as usize);
        }
        Ok(MockFrame {
            width,
            height,
            counts,
            sequence,
            timestamp_s: start_s,
            settings,
            illumination,
            moved: self.bench.turned_deg(start_s, end_s) > 1e-6,
            lost: sequence.saturating_sub(first),
            damaged,
        })
    }

    fn check(&self) -> Result<(), MockCameraError> {
        if self.faults.now().is_disconnected {
            return Err(MockCameraError::Disconnected);
        }
        Ok(())
    }

    /// A quarter of the rows, from a random one on, is noise.
    fn corrupt(&self, counts: &mut [u16], sequence: u64) {
        let mut numbers = random::stream(&[self.config.noise_seed, 12, sequence]);
        let band = counts.len() / 4;
        let first = (numbers.uniform() * (counts.len() - band) as f64) as usize;
        let mask = u64::from(self.sensor.saturation_dn());
        for count in &mut counts[first..first + band] {
            *count = (numbers.bits() & mask) as u16;
        }
    }

    /// Lets the frames that began before this moment pass.
    fn run_until(&mut self, now_s: f64) {
        while self.next_start_s < now_s {
            if self.changes.is_empty() {
                // Nothing changes any more: skip them all at once.
                let interval_s = self.interval_s();
                let frames = ((now_s - self.next_start_s) / interval_s).ceil().max(1.0);
                self.next_sequence += frames as u64;
                self.next_start_s += frames * interval_s;
            } else {
                self.next_frame();
            }
        }
    }

    fn interval_s(&self) -> f64 {
        self.config.frame_interval_s.max(self.settings.exposure_s)
    }

    /// Number, start and settings of the next frame, which begins herewith.
    fn next_frame(&mut self) -> (u64, f64, MockSettings) {
        while let Some(&(from, settings)) = self.changes.front() {
            if from > self.next_sequence {
                break;
            }
            self.settings = settings;
            self.changes.pop_front();
        }
        let frame = (self.next_sequence, self.next_start_s, self.settings);
        self.next_sequence += 1;
        self.next_start_s += self.interval_s();
        frame
    }
}

fn quantise(value: f64, step: f64, [low, high]: [f64; 2]) -> f64 {
    if value.is_nan() {
        return low;
    }
    ((value / step).round() * step).max(low).min(high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::BenchConfig;
    use crate::clock::Clock;
    use crate::clock::lock;
    use crate::sensor::SensorConfig;
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// As bright as the sum of the channels.
    #[derive(Default)]
    struct Lamp {
        calls: AtomicUsize,
        /// A bench whose lamp goes on at the next rendering.
        lights: Mutex<Option<Bench>>,
    }

    impl RadianceSource for Lamp {
        fn resolution_px(&self) -> [u32; 2] {
            [16, 8]
        }
        fn radiance(&self, illumination: &Illumination) -> Arc<Vec<f32>> {
            self.calls.fetch_add(1, Ordering::Relaxed);
            if let Some(bench) = lock(&self.lights).take() {
                bench.set_lamp(bench.clock().now_s(), [1.0; 3]);
            }
            let sum: f64 = illumination.channels.iter().sum();
            Arc::new(vec![sum as f32; 16 * 8])
        }
    }

    const KEY: FrameKey = FrameKey {
        light: 0,
        exposure: 0,
        repeat: 0,
        kind: 0,
    };

    fn camera(clock: Clock) -> (SimulatedCamera, Arc<Lamp>) {
        let bench = Bench::new(BenchConfig::default(), clock);
        let sensor = SensorModel::new(SensorConfig {
            hot_fraction: 0.0,
            ..SensorConfig::typical([16, 8], 1)
        });
        let lamp = Arc::new(Lamp::default());
        (
            SimulatedCamera::new(CameraConfig::default(), bench, sensor, lamp.clone()),
            lamp,
        )
    }

    #[test]
    fn settings_are_rounded_clamped_and_applied_two_frames_late() {
        let (mut camera, _) = camera(Clock::instant());
        let applied = camera.configure(0.012_344, 2.004).unwrap();
        assert!((applied.exposure_s - 0.012_34).abs() < 1e-12);
        assert!((applied.gain - 2.0).abs() < 1e-12);
        let exposures: Vec<f64> = (0..4)
            .map(|_| camera.grab(KEY).unwrap().settings.exposure_s)
            .collect();
        assert_eq!(exposures, [20e-6, 20e-6, 0.012_34, 0.012_34]);
        assert_eq!(camera.configure(1e9, 0.0).unwrap().exposure_s, 30.0);
        assert_eq!(camera.configure(f64::NAN, 1.0).unwrap().exposure_s, 20e-6);
    }

    #[test]
    fn frames_come_at_the_interval_or_the_exposure_whichever_is_longer() {
        let (mut camera, _) = camera(Clock::instant());
        let frames: Vec<_> = (0..4).map(|_| camera.grab(KEY).unwrap()).collect();
        for pair in frames.windows(2) {
            // Readout overlaps the next frame's wait, but not its start: every
            // second frame is missed when the grab ends after the start.
            let gap = pair[1].timestamp_s - pair[0].timestamp_s;
            let number = (pair[1].sequence - pair[0].sequence) as f64;
            assert!((gap - number / 30.0).abs() < 1e-9);
        }
        camera.configure(2.0, 1.0).unwrap();
        for _ in 0..3 {
            camera.grab(KEY).unwrap();
        }
        let a = camera.grab(KEY).unwrap();
        let b = camera.grab(KEY).unwrap();
        let number = (b.sequence - a.sequence) as f64;
        assert!((b.timestamp_s - a.timestamp_s - 2.0 * number).abs() < 1e-9);
    }

    #[test]
    fn light_dark_and_half_lit_frames() {
        let (mut camera, lamp) = camera(Clock::instant());
        camera.configure(0.002, 1.0).unwrap();
        let mean = |frame: &MockFrame| {
            frame.counts.iter().map(|&c| f64::from(c)).sum::<f64>() / frame.counts.len() as f64
        };
        for _ in 0..2 {
            camera.grab(KEY).unwrap();
        }
        let off = camera.grab(KEY).unwrap();
        assert_eq!(off.illumination.channels, [0.0; 3]);
        assert!((mean(&off) - 64.0).abs() < 3.0);
        let bench = camera.bench().clone();
        bench.set_lamp(bench.clock().now_s(), [1.0, 0.0, 0.0]);
        let on = camera.grab(KEY).unwrap();
        // 1e6 e/s × 2 ms × 0.38 DN/e = 760 DN.
        assert!((mean(&on) - 824.0).abs() < 20.0, "{}", mean(&on));
        let calls = lamp.calls.load(Ordering::Relaxed);
        assert!(camera.set_shutter(false).unwrap());
        let dark = camera.grab(KEY).unwrap();
        assert!((mean(&dark) - 64.0).abs() < 3.0);
        assert_eq!(
            lamp.calls.load(Ordering::Relaxed),
            calls,
            "nothing to render"
        );
        // The lamp goes off in the middle of an exposure.
        camera.set_shutter(true).unwrap();
        camera.run_until(bench.clock().now_s());
        bench.set_lamp(camera.next_start_s + 0.0005, [0.0; 3]);
        let half = camera.grab(KEY).unwrap();
        assert!((half.illumination.channels[0] - 0.25).abs() < 1e-9);
    }

    #[test]
    fn faults_come_when_asked_for_and_go() {
        let (mut camera, _) = camera(Clock::instant());
        let faults = camera.faults();
        let before = camera.grab(KEY).unwrap().sequence;
        let ordinary = camera.grab(KEY).unwrap().sequence - before;
        faults.now().lost = 2;
        let after = camera.grab(KEY).unwrap();
        assert_eq!(after.sequence, before + 2 * ordinary + 2);
        assert_eq!(after.lost, 2);
        faults.now().corrupt = 1;
        let corrupt = camera.grab(KEY).unwrap();
        assert!(corrupt.damaged);
        assert!(corrupt.counts.iter().filter(|&&c| c > 200).count() > 16);
        assert!(camera.grab(KEY).unwrap().counts.iter().all(|&c| c < 100));
        faults.now().truncated = 1;
        let short = camera.grab(KEY).unwrap();
        assert_eq!((short.height, short.counts.len()), (8, 96));
        faults.now().resized = 1;
        let small = camera.grab(KEY).unwrap();
        assert_eq!((small.width, small.height, small.counts.len()), (16, 4, 64));
        faults.now().late = 1;
        let asked_s = camera.bench().clock().now_s();
        let late = camera.grab(KEY).unwrap();
        assert!(late.timestamp_s < asked_s && late.sequence == small.sequence);
        assert!(camera.grab(KEY).unwrap().timestamp_s >= asked_s);
        faults.now().stalled = 1;
        assert!(matches!(
            camera.grab(KEY),
            Err(MockCameraError::NoFrame { .. })
        ));
        faults.now().ignored_settings = 1;
        camera.configure(0.5, 1.0).unwrap();
        for _ in 0..4 {
            assert_eq!(camera.grab(KEY).unwrap().settings.exposure_s, 20e-6);
        }
        faults.now().is_disconnected = true;
        assert_eq!(camera.grab(KEY), Err(MockCameraError::Disconnected));
        assert_eq!(
            camera.configure(0.1, 1.0),
            Err(MockCameraError::Disconnected)
        );
        *faults.now() = Failures::default();
        assert!(camera.grab(KEY).is_ok());
    }

    /// From what the bench is going to do; only if it did something else is the
    /// scene rendered a second time.
    #[test]
    fn in_real_time_the_scene_is_rendered_during_the_exposure() {
        let (mut camera, lamp) = camera(Clock::real_time());
        camera.configure(0.2, 1.0).unwrap();
        for _ in 0..2 {
            camera.grab(KEY).unwrap();
        }
        let calls = lamp.calls.load(Ordering::Relaxed);
        let frame = camera.grab(KEY).unwrap();
        assert_eq!(lamp.calls.load(Ordering::Relaxed), calls + 1);
        assert!(camera.bench().clock().now_s() >= frame.timestamp_s + 0.2 + 0.01);
        // The lamp goes on while the scene is rendered as dark.
        *lock(&lamp.lights) = Some(camera.bench().clone());
        let frame = camera.grab(KEY).unwrap();
        assert_eq!(lamp.calls.load(Ordering::Relaxed), calls + 3);
        assert!(frame.illumination.channels[0] > 0.0);
    }

    #[test]
    fn a_source_of_another_size_is_an_error() {
        let bench = Bench::new(BenchConfig::default(), Clock::instant());
        let sensor = SensorModel::new(SensorConfig::typical([20, 8], 1));
        let mut camera = SimulatedCamera::new(
            CameraConfig::default(),
            bench,
            sensor,
            Arc::new(Lamp::default()),
        );
        assert_eq!(
            camera.grab(KEY),
            Err(MockCameraError::SizeMismatch {
                radiance: 128,
                sensor: 160
            })
        );
    }

    #[test]
    fn hours_of_exposures_take_no_wall_time() {
        let wall = std::time::Instant::now();
        let (mut camera, _) = camera(Clock::instant());
        camera.configure(30.0, 1.0).unwrap();
        for _ in 0..200 {
            camera.grab(KEY).unwrap();
        }
        assert!(camera.bench().clock().now_s() > 5000.0);
        assert!(wall.elapsed().as_secs() < 5);
    }
}
