//! Watching the lamp: frames of a still scene from the moment it is switched on.

use std::time::Instant;

use super::lamp::{Burst, LampFit, LampFitError, LampLevel};
use crate::device::{Camera, CameraSettings, DeviceError, FrameKey, FrameKind, RawFrame};
use crate::units::Seconds;

/// How the lamp is watched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchOptions {
    /// Analogue gain, a factor.
    pub gain: f64,
    /// How long, seconds.
    pub watch_s: f64,
    /// Time between two levels, seconds.
    pub interval_s: f64,
    /// Frames of each burst.
    pub burst: u32,
    /// Frames thrown away after a change of settings.
    pub discard: u32,
}

impl WatchOptions {
    /// Usual duration, minutes.
    pub const MINUTES: f64 = 30.0;
    /// Usual time between two levels, seconds.
    pub const INTERVAL_S: f64 = 5.0;
    /// Usual frames of a burst.
    pub const BURST: u32 = 64;
}

/// What stops a watch.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum WatchError {
    /// A device failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The levels do not make a calibration.
    #[error(transparent)]
    Fit(#[from] LampFitError),
    /// Too much or too little light.
    #[error(
        "the scene reaches {reached_dn} of {full_scale_dn:.0} DN between {shortest_s} s and {longest_s} s of exposure; a quarter to three quarters are needed"
    )]
    Exposure {
        /// Ninth decile of the counts above those without lamp at the last try, DN.
        reached_dn: i64,
        full_scale_dn: f64,
        shortest_s: f64,
        longest_s: f64,
    },
}

/// Parts of the exposure at which bursts are taken.
const BURSTS: [f64; 4] = [1.0, 0.5, 0.25, 0.125];
/// Longest exposure that is tried, seconds.
const LONGEST_S: f64 = 1.0;
/// Frames without lamp at each exposure.
const DARK_FRAMES: u32 = 4;
/// Light index of these frames, apart from any session's.
const KEY_OF_WATCH: u32 = (1 << 31) + 1;

/// A camera before a scene that the lamp lights.
pub struct Watch<'a> {
    /// The camera.
    pub camera: &'a mut dyn Camera,
    /// Switches the lamp.
    pub lamp: &'a mut dyn FnMut(bool) -> Result<(), DeviceError>,
    /// Lets so many seconds pass.
    pub wait: &'a mut dyn FnMut(f64),
    /// Called with the part of the watch that is over, 0 to 1.
    pub progress: &'a mut dyn FnMut(f64),
    taken: u32,
}

impl<'a> Watch<'a> {
    /// See the fields.
    pub fn new(
        camera: &'a mut dyn Camera,
        lamp: &'a mut dyn FnMut(bool) -> Result<(), DeviceError>,
        wait: &'a mut dyn FnMut(f64),
        progress: &'a mut dyn FnMut(f64),
    ) -> Self {
        Self {
            camera,
            lamp,
            wait,
            progress,
            taken: 0,
        }
    }

    /// Switches a cold lamp on, watches it, takes bursts, and switches it off,
    /// whatever happens.
    ///
    /// # Errors
    /// A device fails, the scene is too bright or too dark, or the levels do not
    /// make a calibration.
    pub fn run(&mut self, options: &WatchOptions) -> Result<LampFit, WatchError> {
        (self.lamp)(false)?;
        let outcome = self.watched(options);
        (self.lamp)(false)?;
        let (levels, bursts) = outcome?;
        Ok(LampFit::new(&levels, &bursts)?)
    }

    fn watched(
        &mut self,
        options: &WatchOptions,
    ) -> Result<(Vec<LampLevel>, Vec<Burst>), WatchError> {
        // The dark level at a short exposure serves while the exposure is searched.
        let dark_dn = self.dark_dn(self.camera.info().exposure_range[0].0, options)?;
        (self.lamp)(true)?;
        let host = Instant::now();
        let exposure_s = self.find_exposure(dark_dn, options)?;
        let mut origin_s = None;
        let mut timed: Vec<(f64, f64)> = Vec::new();
        loop {
            let frame = self.grab(FrameKind::Light)?;
            let now_s = match frame.timestamp {
                Some(Seconds(device_s)) => device_s,
                None => host.elapsed().as_secs_f64(),
            };
            let time_s = now_s - *origin_s.get_or_insert(now_s);
            timed.push((time_s, mean_dn(&frame)));
            (self.progress)((time_s / options.watch_s).min(1.0));
            if time_s >= options.watch_s {
                break;
            }
            (self.wait)(options.interval_s);
        }
        let mut lit = Vec::new();
        for part in BURSTS {
            let applied_s = self.configure(part * exposure_s, options)?;
            let frames = (0..options.burst)
                .map(|_| self.grab(FrameKind::Light))
                .collect::<Result<Vec<_>, _>>()?;
            let stated = self.camera.stated_with_frame();
            let exposure_s = stated.exposure.map_or(applied_s, |exposure| exposure.0);
            lit.push((exposure_s, frames));
        }
        (self.lamp)(false)?;
        let dark_dn = self.dark_dn(exposure_s, options)?;
        let levels = timed.into_iter().map(|(time_s, dn)| LampLevel {
            time_s,
            level: (dn - dark_dn) / exposure_s,
        });
        let levels: Vec<LampLevel> = levels.collect();
        let mut bursts = Vec::new();
        for (exposure_s, frames) in lit {
            let dark_dn = self.dark_dn(exposure_s, options)?;
            bursts.push(Burst {
                exposure_s,
                noise_dn2: noise_of_mean(&frames),
                signals_dn: frames.iter().map(|f| mean_dn(f) - dark_dn).collect(),
            });
        }
        Ok((levels, bursts))
    }

    /// An exposure at which bright pixels reach about half of full scale, by
    /// doubling from the shortest. Applied when it returns.
    fn find_exposure(&mut self, dark_dn: f64, options: &WatchOptions) -> Result<f64, WatchError> {
        let [shortest_s, longest_s] = self.camera.info().exposure_range.map(|s| s.0);
        let longest_s = longest_s.min(LONGEST_S);
        let full_scale_dn = ((1u32 << self.camera.info().bit_depth.clamp(1, 16)) - 1) as f64;
        let mut exposure_s = shortest_s;
        loop {
            let applied_s = self.configure(exposure_s, options)?;
            let mut counts = self.grab(FrameKind::Light)?.counts;
            counts.sort_unstable();
            let bright = counts.get(counts.len() * 9 / 10).copied().unwrap_or(0);
            let reached_dn = f64::from(bright) - dark_dn;
            if (0.25..0.75).contains(&(reached_dn / full_scale_dn)) {
                return Ok(applied_s);
            }
            let too_bright = reached_dn > 0.75 * full_scale_dn;
            if too_bright || exposure_s >= 0.999 * longest_s {
                return Err(WatchError::Exposure {
                    reached_dn: reached_dn as i64,
                    full_scale_dn,
                    shortest_s,
                    longest_s,
                });
            }
            exposure_s = (2.0 * exposure_s).min(longest_s);
        }
    }

    /// Mean count without lamp.
    fn dark_dn(&mut self, exposure_s: f64, options: &WatchOptions) -> Result<f64, WatchError> {
        self.configure(exposure_s, options)?;
        let mut sum = 0.0;
        for _ in 0..DARK_FRAMES {
            sum += mean_dn(&self.grab(FrameKind::Ambient)?);
        }
        Ok(sum / f64::from(DARK_FRAMES))
    }

    fn configure(&mut self, exposure_s: f64, options: &WatchOptions) -> Result<f64, WatchError> {
        let [shortest, longest] = self.camera.info().exposure_range.map(|s| s.0);
        let applied = self.camera.configure(CameraSettings::new(
            Seconds(exposure_s.clamp(shortest, longest)),
            options.gain,
        ))?;
        for _ in 0..options.discard {
            self.grab(FrameKind::Light)?;
        }
        Ok(applied.exposure.0)
    }

    fn grab(&mut self, kind: FrameKind) -> Result<RawFrame, WatchError> {
        self.taken += 1;
        Ok(self
            .camera
            .grab(FrameKey::new(KEY_OF_WATCH, 0, self.taken, kind))?)
    }
}

fn mean_dn(frame: &RawFrame) -> f64 {
    let sum: u64 = frame.counts.iter().map(|&c| u64::from(c)).sum();
    sum as f64 / frame.counts.len().max(1) as f64
}

/// Variance of a frame's mean from what its pixels do against the next frame's,
/// the frames' own levels taken out.
fn noise_of_mean(frames: &[RawFrame]) -> f64 {
    let (mut sum2, mut pairs) = (0.0, 0.0);
    for pair in frames.windows(2) {
        let apart = mean_dn(&pair[1]) - mean_dn(&pair[0]);
        let pixels = pair[0].counts.len() as f64;
        let square: f64 = pair[0]
            .counts
            .iter()
            .zip(&pair[1].counts)
            .map(|(&a, &b)| (f64::from(b) - f64::from(a) - apart).powi(2))
            .sum();
        sum2 += 0.5 * square / pixels / pixels;
        pairs += 1.0;
    }
    sum2 / f64::max(pairs, 1.0)
}
