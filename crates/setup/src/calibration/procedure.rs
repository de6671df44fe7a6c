//! Taking the frames of a sensor calibration with a camera in front of a
//! steady, uniform light, such as an integrating sphere or a lit diffuser.

use super::flat::{FlatError, FlatFit, FlatFrames};
use super::mirror_sphere::Grey;
use super::sensor::{Exposed, PhotonTransfer, SensorFitError};
use crate::device::{Camera, CameraSettings, DeviceError, FrameKey, FrameKind};
use crate::radiometry::sensor::SensorNoise;
use crate::units::Seconds;

/// How frames are taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProcedureOptions {
    /// Analogue gain, a factor; the calibration belongs to it.
    pub gain: f64,
    /// Frames per exposure, at least 2; default 16.
    pub frames: u32,
    /// Frames thrown away after a change of settings; default 3.
    pub discard: u32,
    /// Longest exposure, seconds: of dark frames, and of the search for
    /// saturation; default 2.
    pub longest_s: f64,
    /// Part of saturation at which flats are taken, (0, 1); default 0.6.
    pub flat_level: f64,
}

impl ProcedureOptions {
    /// Usual frames per exposure of a photon transfer.
    pub const FRAMES: u32 = 16;
    /// Usual frames of a flat field.
    pub const FLAT_FRAMES: u32 = 64;
}

impl Default for ProcedureOptions {
    fn default() -> Self {
        Self {
            gain: 1.0,
            frames: Self::FRAMES,
            discard: 3,
            longest_s: 2.0,
            flat_level: 0.6,
        }
    }
}

/// What stops a calibration.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ProcedureError {
    /// The camera failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The frames do not make a photon transfer.
    #[error(transparent)]
    Sensor(#[from] SensorFitError),
    /// The frames do not make a flat field.
    #[error(transparent)]
    Flat(#[from] FlatError),
    #[error("the light brings the sensor to {reached_dn} DN in {longest_s} s, not to saturation")]
    TooDim { reached_dn: u16, longest_s: f64 },
    #[error("the light saturates the sensor in the shortest exposure of {shortest_s} s")]
    TooBright { shortest_s: f64 },
    /// No frames without the light, but with all other, can be had.
    #[error("the light was not switched off")]
    NotOff,
    #[error(
        "the camera has no shutter, and the frames with the light covered are as bright as the others"
    )]
    NotDark,
}

/// Levels of the photon transfer curve, as parts of saturation; the last one is
/// beyond it.
const LEVELS: [f64; 15] = [
    0.01, 0.03, 0.06, 0.10, 0.16, 0.23, 0.30, 0.38, 0.46, 0.54, 0.62, 0.69, 0.82, 0.94, 1.6,
];
/// Exposures of dark frames, as parts of the longest.
const DARK_EXPOSURES: [f64; 4] = [0.0, 0.25, 0.5, 1.0];

/// Light indices of calibration frames, apart from any session's.
const KEY_OF_CALIBRATION: u32 = 1 << 31;

/// A camera in front of the light, with what it takes to vary the exposure.
pub struct LitCamera<'a> {
    camera: &'a mut dyn Camera,
    options: ProcedureOptions,
    /// Covers and uncovers the light where the camera has no shutter; returns
    /// whether it is covered now.
    cover: &'a mut dyn FnMut(bool) -> bool,
    /// Called with every frame taken.
    progress: &'a mut dyn FnMut(),
    /// Switches the light on and off and leaves all other light; returns whether
    /// that was done.
    switch: Option<&'a mut dyn FnMut(bool) -> bool>,
    taken: u32,
}

impl<'a> LitCamera<'a> {
    /// `cover(true)` covers the light or the lens of a camera without shutter,
    /// `cover(false)` uncovers it; it returns whether that was done.
    pub fn new(
        camera: &'a mut dyn Camera,
        options: ProcedureOptions,
        cover: &'a mut dyn FnMut(bool) -> bool,
        progress: &'a mut dyn FnMut(),
    ) -> Self {
        Self {
            camera,
            options,
            cover,
            progress,
            switch: None,
            taken: 0,
        }
    }

    /// With a light that can be switched (`switch(true)`: on): a flat field is then
    /// that of the light alone, whatever else lights the camera.
    #[must_use]
    pub fn with_switch(mut self, switch: &'a mut dyn FnMut(bool) -> bool) -> Self {
        self.switch = Some(switch);
        self
    }

    /// Frames that [`Self::photon_transfer`] takes, without those of the search
    /// for saturation.
    pub fn photon_transfer_frames(options: &ProcedureOptions) -> u32 {
        (LEVELS.len() + DARK_EXPOSURES.len()) as u32 * options.frames
    }

    /// Takes flats from darkness to beyond saturation, and dark frames.
    ///
    /// # Errors
    /// The camera fails, the light does not fit the camera's exposures, or dark
    /// frames are not dark.
    pub fn photon_transfer(&mut self) -> Result<PhotonTransfer, ProcedureError> {
        let mut transfer = PhotonTransfer::default();
        let shortest_s = self.camera.info().exposure_range[0].0;
        self.shut(true)?;
        for part in DARK_EXPOSURES {
            let exposure_s = (part * self.longest_s()).max(shortest_s);
            self.take(exposure_s, Exposed::Dark, |applied_s, counts| {
                Ok(transfer.add(Exposed::Dark, applied_s, counts)?)
            })?;
        }
        let saturating_s = self.saturating_exposure_s()?;
        // Half of the frames up and half down, so that a light that drifts does
        // not look like a sensor that bends.
        let up = self.options.frames.div_ceil(2);
        let down = self.options.frames - up;
        let visits = LEVELS.iter().map(|level| (level, up));
        for (part, frames) in visits.chain(LEVELS.iter().rev().map(|level| (level, down))) {
            let exposure_s = part * saturating_s;
            self.take_frames(exposure_s, Exposed::Flat, frames, |applied_s, counts| {
                Ok(transfer.add(Exposed::Flat, applied_s, counts)?)
            })?;
        }
        Ok(transfer)
    }

    /// Takes flats and as many frames without the light at one exposure and solves
    /// them. Those are ambient frames where the light can be switched, else dark ones.
    ///
    /// # Errors
    /// As [`Self::photon_transfer`], and [`FlatError`].
    pub fn flat_field(&mut self, noise: &SensorNoise) -> Result<FlatFit, ProcedureError> {
        let width = self.camera.info().resolution_px[0] as usize;
        let pixels = width * self.camera.info().resolution_px[1] as usize;
        let exposure_s = self.options.flat_level * self.saturating_exposure_s()?;
        let applied_s = self.configure(exposure_s)?;
        let mut frames = FlatFrames::new(noise, applied_s, pixels);
        self.take(exposure_s, Exposed::Flat, |_, counts| {
            Ok(frames.add_lit(counts)?)
        })?;
        let unlit = match &mut self.switch {
            None => {
                self.shut(true)?;
                Exposed::Dark
            }
            Some(switch) => {
                if !switch(false) {
                    return Err(ProcedureError::NotOff);
                }
                Exposed::Ambient
            }
        };
        self.take(exposure_s, unlit, |_, counts| {
            Ok(frames.add_unlit(unlit, counts)?)
        })?;
        if let Some(switch) = &mut self.switch {
            switch(true);
        }
        Ok(frames.solve(width)?)
    }

    /// Takes frames of whatever is before the camera, most of which must be bright, and as many
    /// dark ones at the same exposure: their difference, DN, by pixel.
    ///
    /// # Errors
    /// As [`Self::photon_transfer`].
    pub fn picture(&mut self) -> Result<Grey, ProcedureError> {
        let [width, height] = self.camera.info().resolution_px.map(|n| n as usize);
        let exposure_s = self.options.flat_level * self.saturating_exposure_s()?;
        let (mut value, mut square) = (vec![0.0; width * height], vec![0.0; width * height]);
        for exposed in [Exposed::Flat, Exposed::Dark] {
            let sign = match exposed {
                Exposed::Dark => {
                    self.shut(true)?;
                    -1.0
                }
                _ => 1.0,
            };
            self.take(exposure_s, exposed, |_, counts| {
                for (pixel, &count) in counts.iter().enumerate() {
                    let count = f64::from(count);
                    value[pixel] += sign * count;
                    square[pixel] += count;
                }
                Ok(())
            })?;
        }
        let frames = f64::from(self.options.frames);
        Ok(Grey {
            width,
            height,
            value: value.into_iter().map(|sum| sum / frames).collect(),
            // Of photons, as if a count were one; nothing is weighted by it.
            variance: square.into_iter().map(|sum| sum / frames.powi(2)).collect(),
            valid: vec![true; width * height],
        })
    }

    /// The exposure at which counts stop growing, found by doubling. Leaves the
    /// light uncovered.
    fn saturating_exposure_s(&mut self) -> Result<f64, ProcedureError> {
        let shortest_s = self.camera.info().exposure_range[0].0;
        let full_scale_dn = ((1u32 << self.camera.info().bit_depth.clamp(1, 16)) - 1) as f64;
        self.shut(true)?;
        let (_, dark_dn) = self.median_dn(shortest_s, Exposed::Dark)?;
        self.shut(false)?;
        let (mut exposure_s, mut level_dn) = self.median_dn(shortest_s, Exposed::Flat)?;
        if f64::from(level_dn) > 0.5 * full_scale_dn {
            return Err(ProcedureError::TooBright { shortest_s });
        }
        loop {
            let (next_s, next_dn) = self.median_dn(2.0 * exposure_s, Exposed::Flat)?;
            let gained_dn = f64::from(next_dn) - f64::from(level_dn);
            let signal_dn = f64::from(level_dn) - f64::from(dark_dn);
            // Twice the exposure gives twice the signal, until something is full.
            let bends = gained_dn < 0.8 * signal_dn;
            if bends && f64::from(next_dn) > 0.2 * full_scale_dn {
                let (_, plateau_dn) = self.median_dn(4.0 * exposure_s, Exposed::Flat)?;
                let plateau = f64::from(plateau_dn) - f64::from(dark_dn);
                return Ok(exposure_s * plateau / signal_dn);
            }
            if next_s >= self.longest_s() * 0.999 {
                return Err(ProcedureError::TooDim {
                    reached_dn: next_dn,
                    longest_s: next_s,
                });
            }
            (exposure_s, level_dn) = (next_s, next_dn);
        }
    }

    fn longest_s(&self) -> f64 {
        let camera_s = self.camera.info().exposure_range[1].0;
        camera_s.min(self.options.longest_s)
    }

    fn shut(&mut self, dark: bool) -> Result<(), ProcedureError> {
        let has_shutter = self.camera.set_shutter(!dark)?;
        if !has_shutter && !(self.cover)(dark) {
            return Err(ProcedureError::NotDark);
        }
        Ok(())
    }

    fn configure(&mut self, exposure_s: f64) -> Result<f64, ProcedureError> {
        let [shortest, longest] = self.camera.info().exposure_range.map(|s| s.0);
        let applied = self.camera.configure(CameraSettings::new(
            Seconds(exposure_s.clamp(shortest, longest)),
            self.options.gain,
        ))?;
        Ok(applied.exposure.0)
    }

    /// Exposure of the last frame, s: as reported with it, else as it was set.
    fn exposure_of_frame_s(&self, applied_s: f64) -> f64 {
        let stated = self.camera.stated_with_frame();
        stated.exposure.map_or(applied_s, |exposure| exposure.0)
    }

    fn grab(&mut self, exposed: Exposed) -> Result<Vec<u16>, ProcedureError> {
        self.taken += 1;
        let key = FrameKey {
            light: KEY_OF_CALIBRATION,
            exposure: 0,
            repeat: self.taken,
            kind: match exposed {
                Exposed::Flat => FrameKind::Light,
                Exposed::Dark => FrameKind::Dark,
                Exposed::Ambient => FrameKind::Ambient,
            },
        };
        Ok(self.camera.grab(key)?.counts)
    }

    /// Sets an exposure, discards, takes the frames.
    fn take(
        &mut self,
        exposure_s: f64,
        exposed: Exposed,
        add: impl FnMut(f64, &[u16]) -> Result<(), ProcedureError>,
    ) -> Result<(), ProcedureError> {
        self.take_frames(exposure_s, exposed, self.options.frames, add)
    }

    fn take_frames(
        &mut self,
        exposure_s: f64,
        exposed: Exposed,
        frames: u32,
        mut add: impl FnMut(f64, &[u16]) -> Result<(), ProcedureError>,
    ) -> Result<(), ProcedureError> {
        let applied_s = self.configure(exposure_s)?;
        for _ in 0..self.options.discard {
            self.grab(exposed)?;
        }
        for _ in 0..frames {
            let counts = self.grab(exposed)?;
            add(self.exposure_of_frame_s(applied_s), &counts)?;
            (self.progress)();
        }
        Ok(())
    }

    fn median_dn(
        &mut self,
        exposure_s: f64,
        exposed: Exposed,
    ) -> Result<(f64, u16), ProcedureError> {
        let applied_s = self.configure(exposure_s)?;
        for _ in 0..self.options.discard {
            self.grab(exposed)?;
        }
        let mut counts = self.grab(exposed)?;
        let applied_s = self.exposure_of_frame_s(applied_s);
        counts.sort_unstable();
        let median = counts.get(counts.len() / 2).copied().unwrap_or(0);
        Ok((applied_s, median))
    }
}

#[cfg(test)]
mod tests;
