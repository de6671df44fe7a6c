//! The bracket sink of a real capture: HDR merge of each lamp channel, put
//! together to one radiance image. The frames of a light wait in a file and are
//! merged in bands of rows, so that a large sensor's take little memory.

use std::path::PathBuf;
use std::sync::Arc;

use super::disk::{BracketSink, SinkError};
use crate::device::{FrameKind, LampState, Mosaic, RawFrame};
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::{self, ExrError};
use crate::radiometry::merge::{FrameRole, MergeError};
use crate::radiometry::sensor::SensorNoise;
use crate::radiometry::stack::{Bands, Stack, StackError};
use crate::session::{Sidecar, layout};

/// Merges one bracket after the other.
pub struct RadianceSink {
    noise: Arc<SensorNoise>,
    mosaic: Mosaic,
    /// Which of R, G, B (0, 1, 2) the frames under each lamp channel measure.
    colours: Vec<&'static [usize]>,
    folder: PathBuf,
    light: u32,
    size: [usize; 2],
    /// The light's frames; made with the first.
    stack: Option<Stack>,
    /// The lamp channel of each frame of the stack; `None` without the lamp: it belongs to
    /// every channel.
    channels: Vec<Option<usize>>,
}

impl RadianceSink {
    /// For a camera with this noise and these colour filters; `colours` has an
    /// entry per lamp channel: which of R, G, B (0, 1, 2) its frames measure. A light's
    /// frames wait in a file of `folder` that has no name and vanishes with the sink.
    pub fn new(
        noise: Arc<SensorNoise>,
        mosaic: Mosaic,
        colours: Vec<&'static [usize]>,
        folder: PathBuf,
    ) -> Self {
        Self {
            noise,
            mosaic,
            colours,
            folder,
            light: 0,
            size: [0, 0],
            stack: None,
            channels: Vec::new(),
        }
    }

    /// The next rows of the image: those of each channel, in the colours that it measures.
    fn next_rows(&self, bands: &mut [Bands<'_>]) -> Result<RadianceImage, MergingError> {
        let mut merged: Option<RadianceImage> = None;
        for (bands, colours) in bands.iter_mut().zip(&self.colours) {
            let band = bands.next_band()?.ok_or(MergeError::NoLightFrame);
            let image = band.map_err(StackError::from)?.planes[0].binned(self.mosaic);
            let all = merged.get_or_insert_with(|| RadianceImage::new(image.width, image.height));
            for pixel in 0..image.mean.len() {
                for &colour in *colours {
                    all.mean[pixel][colour] = image.mean[pixel][colour];
                    all.variance[pixel][colour] = image.variance[pixel][colour];
                }
                all.valid[pixel] &= image.valid[pixel];
            }
        }
        Ok(merged.ok_or(StackError::from(MergeError::NoLightFrame))?)
    }
}

/// Why no image came of a bracket.
#[derive(Debug, thiserror::Error)]
enum MergingError {
    #[error(transparent)]
    Stack(#[from] StackError),
    #[error(transparent)]
    Image(#[from] ExrError),
}

impl BracketSink for RadianceSink {
    fn begin(&mut self, light: u32) -> Result<(), SinkError> {
        self.light = light;
        self.channels.clear();
        if let Some(stack) = &mut self.stack {
            stack.clear();
        }
        Ok(())
    }

    fn add(&mut self, frame: &RawFrame, sidecar: &Sidecar) -> Result<(), SinkError> {
        let (role, channel) = match (sidecar.key.kind, sidecar.lamp) {
            (FrameKind::Light, LampState::On(channel)) => {
                (FrameRole::Light, Some(usize::from(channel.0)))
            }
            (FrameKind::Light, LampState::Off) => {
                return Err(format!("{} has no lamp", layout::frame_stem(sidecar.key)).into());
            }
            (FrameKind::Ambient, _) => (FrameRole::Ambient, None),
            (FrameKind::Dark, _) => (FrameRole::Dark, None),
        };
        let stack = match &mut self.stack {
            Some(stack) => stack,
            None => {
                self.size = [frame.width, frame.height].map(|n| n as usize);
                let [width, height] = self.size;
                self.noise.check(width * height)?;
                self.stack
                    .insert(Stack::new(&self.folder, width, height, 1)?)
            }
        };
        let exposure_s = sidecar.applied.exposure.0;
        stack.add(role, exposure_s, &[frame.counts.as_slice()])?;
        self.channels.push(channel);
        Ok(())
    }

    fn finish(&mut self) -> Result<Vec<u8>, SinkError> {
        let stack = self.stack.as_ref().filter(|stack| !stack.is_empty());
        let stack = stack.ok_or("the bracket has no frame")?;
        let of_channel = |channel: usize| {
            let belongs = |of: &Option<usize>| of.is_none_or(|of| of == channel);
            let frames = (0..stack.len()).filter(|&k| belongs(&self.channels[k]));
            stack.bands_of(frames.collect(), &self.noise, self.mosaic, 0)
        };
        let mut bands: Vec<Bands<'_>> = (0..self.colours.len()).map(of_channel).collect();
        let size = match self.mosaic {
            Mosaic::None => self.size,
            _ => self.size.map(|n| n / 2),
        };
        let path = PathBuf::from(layout::radiance_file(self.light));
        match exr::encode_rows(&path, size, || self.next_rows(&mut bands)) {
            Ok(bytes) => Ok(bytes),
            // Each as what it is, not as what wraps both.
            Err(MergingError::Stack(error)) => Err(error.into()),
            Err(MergingError::Image(error)) => Err(error.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{CameraSettings, FrameKey, LampChannel};
    use crate::units::Seconds;

    fn sidecar(kind: FrameKind, lamp: LampState) -> Sidecar {
        let key = FrameKey::new(2, 0, 0, kind);
        let settings = CameraSettings::new(Seconds(0.5), 1.0);
        Sidecar::of_frame(key, lamp, settings)
    }

    /// Each lamp channel lands in the colour that it measures, less the room's light.
    #[test]
    fn lamp_channels_become_their_colours() {
        let noise = Arc::new(SensorNoise::ideal(0.5, 2.0, 64.0, 12));
        let mut sink = RadianceSink::new(
            noise,
            Mosaic::None,
            vec![&[2], &[0, 1]],
            std::env::temp_dir(),
        );
        sink.begin(2).unwrap();
        let mut add = |kind, lamp, dn: u16| {
            let frame = RawFrame::new(3, 2, vec![64 + dn; 6]);
            sink.add(&frame, &sidecar(kind, lamp)).unwrap();
        };
        add(FrameKind::Light, LampState::On(LampChannel(0)), 1100);
        add(FrameKind::Light, LampState::On(LampChannel(1)), 600);
        add(FrameKind::Ambient, LampState::Off, 100);
        let bytes = sink.finish().unwrap();
        let read = exr::decode(&bytes, &PathBuf::from("x.exr")).unwrap().image;
        assert_eq!((read.width, read.height), (3, 2));
        // 1000 DN are 2000 electrons in half a second.
        for (colour, rate_e_s) in [(0, 2000.0), (1, 2000.0), (2, 4000.0)] {
            for pixel in 0..6 {
                assert!(read.valid[pixel] && read.variance[pixel][colour] > 0.0);
                let off = (read.mean[pixel][colour] - rate_e_s).abs();
                assert!(off < 1.0, "colour {colour}: {:?}", read.mean[pixel]);
            }
        }
    }
}
