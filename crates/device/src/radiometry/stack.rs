//! Brackets larger than memory: the frames wait in a file without a name and are
//! merged in bands of rows.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::Path;

use super::agreement::{ExposureAgreement, ExposureTally, add_all, by_colour};
use super::merge::{BracketMerge, FrameRole, MergeError, halo_rows};
use super::mosaic::Mosaic;
use super::plane::MergedPlane;
use super::response::{Response, ResponseMerge};
use super::sensor::SensorNoise;

/// A bracket that cannot be merged from disk.
#[derive(Debug, thiserror::Error)]
pub enum StackError {
    /// The frames do not make a bracket.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// The disk refuses.
    #[error("the frames cannot be kept on disk: {}", reason(.0))]
    Io(#[from] io::Error),
}

/// Frames of one size on disk.
#[derive(Debug)]
pub struct Stack {
    file: File,
    width: usize,
    height: usize,
    planes: usize,
    /// Role and exposure, seconds, in the file's order.
    frames: Vec<(FrameRole, f64)>,
}

/// Memory that the pixels of one band may take, bytes.
const BAND_BYTES: usize = 64 << 20;
/// Bytes per pixel of a merge: rates and results, and the sums of an exposure.
const PIXEL_BYTES: usize = 64;
const EXPOSURE_BYTES: usize = 8;

/// The system's error; a full disk as in all messages.
fn reason(error: &std::io::Error) -> String {
    match error.kind() {
        std::io::ErrorKind::StorageFull => "no space left".to_owned(),
        _ => error.to_string(),
    }
}

#[cfg(unix)]
fn write_at(file: &File, bytes: &[u8], at: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, at)
}

#[cfg(unix)]
fn read_at(file: &File, bytes: &mut [u8], at: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, at)
}

/// All at once, as files on a disk are written and read there.
#[cfg(windows)]
fn write_at(file: &File, bytes: &[u8], at: u64) -> io::Result<()> {
    let written = std::os::windows::fs::FileExt::seek_write(file, bytes, at)?;
    (written == bytes.len())
        .then_some(())
        .ok_or(io::ErrorKind::WriteZero.into())
}

#[cfg(windows)]
fn read_at(file: &File, bytes: &mut [u8], at: u64) -> io::Result<()> {
    let read = std::os::windows::fs::FileExt::seek_read(file, bytes, at)?;
    (read == bytes.len())
        .then_some(())
        .ok_or(io::ErrorKind::UnexpectedEof.into())
}

impl Stack {
    /// An empty stack of frames of `planes` planes in a file of this folder,
    /// which vanishes with it.
    ///
    /// # Errors
    /// The system refuses.
    pub fn new(
        folder: &Path,
        width: usize,
        height: usize,
        planes: usize,
    ) -> Result<Self, StackError> {
        Ok(Self {
            file: tempfile::tempfile_in(folder)?,
            width,
            height,
            planes,
            frames: Vec::new(),
        })
    }

    /// Forgets all frames; the file is written anew from its beginning.
    pub fn clear(&mut self) {
        self.frames.clear();
    }

    /// Frames that were added.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Adds a frame of raw counts, DN, plane by plane, row by row.
    ///
    /// # Errors
    /// Another size, an exposure that cannot be, or the disk refuses.
    pub fn add<P: AsRef<[u16]>>(
        &mut self,
        role: FrameRole,
        exposure_s: f64,
        planes: &[P],
    ) -> Result<(), StackError> {
        let found: usize = planes.iter().map(|plane| plane.as_ref().len()).sum();
        if found != self.planes * self.width * self.height {
            let (width, height) = (self.width, self.height);
            return Err(MergeError::FrameSize {
                found,
                width,
                height,
            }
            .into());
        }
        if !(exposure_s.is_finite() && exposure_s > 0.0) {
            return Err(MergeError::Exposure { exposure_s }.into());
        }
        for (plane, counts) in planes.iter().enumerate() {
            let at = self.offset(self.frames.len(), plane, 0);
            write_at(&self.file, bytemuck::cast_slice(counts.as_ref()), at)?;
        }
        self.frames.push((role, exposure_s));
        Ok(())
    }

    /// Merges band after band, from the top. Each has `margin` rows more on each
    /// side where the image has them.
    pub fn bands<'a>(&'a self, noise: &'a SensorNoise, mosaic: Mosaic, margin: usize) -> Bands<'a> {
        self.bands_of((0..self.frames.len()).collect(), noise, mosaic, margin)
    }

    /// [`bands`](Self::bands) of only these frames, by the order in which they were added:
    /// those under one channel of the lamp.
    pub fn bands_of<'a>(
        &'a self,
        frames: Vec<usize>,
        noise: &'a SensorNoise,
        mosaic: Mosaic,
        margin: usize,
    ) -> Bands<'a> {
        Bands {
            stack: self,
            frames,
            noise: vec![noise],
            mosaic,
            margin: margin.next_multiple_of(mosaic.period()),
            rows: self.band_rows(),
            at: 0,
            tallies: vec![Vec::new(); self.planes],
        }
    }

    /// Merges band after band, from the top, through the response of each plane. Noise is
    /// estimated in each band.
    pub fn response_bands<'a>(&'a self, responses: &'a [Response]) -> ResponseBands<'a> {
        ResponseBands {
            stack: self,
            responses,
            at: 0,
            tallies: vec![Vec::new(); self.planes],
        }
    }

    /// Gives every frame another exposure: what `of` makes of its present one, seconds.
    pub fn change_exposures(&mut self, of: impl Fn(f64) -> f64) {
        for (_, exposure_s) in &mut self.frames {
            *exposure_s = of(*exposure_s);
        }
    }

    /// Merges some rows through the response of each plane, and returns how the light exposures
    /// of each agree.
    fn through_response(
        &self,
        responses: &[Response],
        rows: Range<usize>,
    ) -> Result<Vec<(MergedPlane, Vec<ExposureTally>)>, StackError> {
        // A pixel depends on its neighbours.
        let (top, bottom) = (
            rows.start.saturating_sub(1),
            (rows.end + 1).min(self.height),
        );
        let merge = |(plane, response): (usize, &Response)| {
            let mut frames = Vec::with_capacity(self.frames.len());
            for (frame, &(role, exposure_s)) in self.frames.iter().enumerate() {
                if role == FrameRole::Light {
                    let mut counts = vec![0u16; (bottom - top) * self.width];
                    let at = self.offset(frame, plane, top);
                    read_at(&self.file, bytemuck::cast_slice_mut(&mut counts), at)?;
                    frames.push((exposure_s, counts));
                }
            }
            if frames.is_empty() {
                return Err(MergeError::NoLightFrame.into());
            }
            let views = frames.iter().map(|(s, counts)| (*s, counts.as_slice()));
            let merge = ResponseMerge::new(response, self.width, views.collect());
            let counted = rows.start - top..rows.end - top;
            let (whole, tallies) = merge.finish_band(counted.clone());
            Ok((whole.rows(counted), tallies))
        };
        responses
            .iter()
            .take(self.planes)
            .enumerate()
            .map(merge)
            .collect()
    }

    /// Rows of a band that takes little memory.
    fn band_rows(&self) -> usize {
        let per_row = self.width.max(1) * (PIXEL_BYTES + EXPOSURE_BYTES * self.frames.len());
        (BAND_BYTES / per_row).next_multiple_of(2).max(16)
    }

    fn offset(&self, frame: usize, plane: usize, row: usize) -> u64 {
        let rows = (frame * self.planes + plane) * self.height + row;
        2 * (rows as u64) * (self.width as u64)
    }
}

/// The bands of a stack.
#[derive(Debug)]
pub struct Bands<'a> {
    stack: &'a Stack,
    frames: Vec<usize>,
    /// One for all pixels, or red's, green's and blue's.
    noise: Vec<&'a SensorNoise>,
    mosaic: Mosaic,
    margin: usize,
    rows: usize,
    at: usize,
    tallies: Vec<Vec<ExposureTally>>,
}

/// Some rows of the merged image.
#[derive(Clone, Debug)]
pub struct Band {
    /// Its rows, those of the margins included.
    pub planes: Vec<MergedPlane>,
    /// Rows of the upper margin.
    pub above: usize,
    /// Rows without the margins.
    pub rows: usize,
}

impl<'a> Bands<'a> {
    /// The noise of each colour: red, green, blue, of the planes or of the mosaic.
    #[must_use]
    pub fn of_colours(mut self, noise: &'a [SensorNoise; 3]) -> Self {
        self.noise = noise.iter().collect();
        self
    }

    /// Bands of this many rows (rounded up to an even number).
    #[must_use]
    pub fn of_rows(mut self, rows: usize) -> Self {
        self.rows = rows.next_multiple_of(2).max(2);
        self
    }

    /// The next band; `None` below the last.
    ///
    /// # Errors
    /// No light frame, or the disk refuses.
    pub fn next_band(&mut self) -> Result<Option<Band>, StackError> {
        let stack = self.stack;
        let (start, end) = (self.at, (self.at + self.rows).min(stack.height));
        if start >= end {
            return Ok(None);
        }
        let halo = halo_rows(self.mosaic) + self.margin;
        let (top, bottom) = (start.saturating_sub(halo), (end + halo).min(stack.height));
        let merged = start.saturating_sub(self.margin)..(end + self.margin).min(stack.height);
        let noise = self.noise.iter();
        let noise: Vec<SensorNoise> = noise.map(|n| n.rows(stack.width, top..bottom)).collect();
        let mut counts = vec![0u16; (bottom - top) * stack.width];
        let mut planes = Vec::with_capacity(stack.planes);
        for (plane, tallies) in self.tallies.iter_mut().enumerate() {
            let noise = match self.mosaic {
                Mosaic::None => vec![&noise[plane.min(noise.len() - 1)]],
                _ => noise.iter().collect(),
            };
            let merge = BracketMerge::with_colours(noise, self.mosaic, stack.width, bottom - top)?;
            let mut merge =
                merge.only(merged.start - top..merged.end - top, start - top..end - top);
            for &frame in &self.frames {
                let (role, exposure_s) = stack.frames[frame];
                let at = stack.offset(frame, plane, top);
                read_at(&stack.file, bytemuck::cast_slice_mut(&mut counts), at)?;
                merge.add(role, exposure_s, &counts)?;
            }
            let (merged, more) = merge.finish_band()?;
            planes.push(merged);
            add_all(tallies, more);
        }
        self.at = end;
        Ok(Some(Band {
            planes,
            above: start - merged.start,
            rows: end - start,
        }))
    }

    /// How the light exposures of each plane, or of each colour of a mosaic, agree, as far as
    /// merged, shortest first.
    pub fn agreement(&self) -> Vec<Vec<ExposureAgreement>> {
        let planes = self.tallies.iter();
        planes.flat_map(|tallies| by_colour(tallies)).collect()
    }
}

/// The bands of a stack, through response curves.
#[derive(Debug)]
pub struct ResponseBands<'a> {
    stack: &'a Stack,
    responses: &'a [Response],
    at: usize,
    tallies: Vec<Vec<ExposureTally>>,
}

impl ResponseBands<'_> {
    /// The next band; `None` below the last.
    ///
    /// # Errors
    /// No light frame, or the disk refuses.
    pub fn next_band(&mut self) -> Result<Option<Band>, StackError> {
        let rows = self.at..(self.at + self.stack.band_rows()).min(self.stack.height);
        if rows.is_empty() {
            return Ok(None);
        }
        self.at = rows.end;
        let merged = self.stack.through_response(self.responses, rows.clone())?;
        let planes = merged
            .into_iter()
            .zip(&mut self.tallies)
            .map(|((plane, more), tallies)| {
                add_all(tallies, more);
                plane
            });
        Ok(Some(Band {
            planes: planes.collect(),
            above: 0,
            rows: rows.len(),
        }))
    }

    /// How the light exposures of each plane agree, as far as merged, shortest first.
    pub fn agreement(&self) -> Vec<Vec<ExposureAgreement>> {
        let planes = self.tallies.iter();
        planes.flat_map(|tallies| by_colour(tallies)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_core::random::{Purpose, stream};

    /// A ramp with an edge, a mosaic, repeats and dark frames.
    fn frames(width: usize, height: usize) -> Vec<(FrameRole, f64, Vec<u16>)> {
        let plan = [
            (FrameRole::Light, 0.01),
            (FrameRole::Light, 0.04),
            (FrameRole::Dark, 0.04),
            (FrameRole::Light, 0.04),
            (FrameRole::Dark, 0.04),
        ];
        (0u64..)
            .zip(plan)
            .map(|(frame, (role, exposure_s))| {
                let counts = (0..width * height)
                    .map(|p| {
                        let (x, y) = ((p % width) as f64, p / width);
                        let lit = 1e4 * (1.0 + x) * if y > 20 { 3.0 } else { 1.0 };
                        let rate = if role == FrameRole::Light { lit } else { 0.0 };
                        let electrons = rate * exposure_s;
                        let mut random = stream(3, Purpose::Experiment, frame, p as u64, 0);
                        let noisy = electrons + (electrons + 6.0).sqrt() * random.normal();
                        (64.0 + 0.4 * noisy).round().clamp(0.0, 4095.0) as u16
                    })
                    .collect();
                (role, exposure_s, counts)
            })
            .collect()
    }

    #[test]
    fn bands_are_the_rows_of_the_image_merged_whole() {
        let (width, height) = (23, 61);
        let mut noise = SensorNoise::ideal(0.4, 2.4, 64.0, 12);
        noise.hot_pixels = Some((0..width * height).map(|p| p % 101 == 7).collect());
        noise.black_level_spread_dn = 0.3;
        for mosaic in [Mosaic::None, Mosaic::Gbrg] {
            let mut whole = BracketMerge::new(&noise, mosaic, width, height).unwrap();
            let folder = tempfile::tempdir().unwrap();
            let mut stack = Stack::new(folder.path(), width, height, 1).unwrap();
            for (role, exposure_s, counts) in frames(width, height) {
                whole.add(role, exposure_s, &counts).unwrap();
                stack.add(role, exposure_s, &[counts]).unwrap();
            }
            let whole = whole.finish().unwrap();
            for (rows, margin) in [(16, 0), (2, 1), (61, 3)] {
                let mut bands = stack.bands(&noise, mosaic, margin).of_rows(rows);
                let mut at = 0;
                while let Some(band) = bands.next_band().unwrap() {
                    let plane = &band.planes[0];
                    let from = (at - band.above) * width;
                    let part = from..from + plane.mean.len();
                    assert_eq!(plane.mean, whole.mean[part.clone()], "{rows} rows at {at}");
                    assert_eq!(plane.variance, whole.variance[part.clone()]);
                    assert_eq!(plane.valid, whole.valid[part]);
                    at += band.rows;
                }
                assert_eq!(at, height);
                let agreement = bands.agreement();
                assert_eq!(agreement.len(), mosaic.colours());
                let agreement = agreement.concat();
                assert_eq!(agreement.len(), whole.agreement.len());
                for (band, whole) in agreement.iter().zip(&whole.agreement) {
                    assert_eq!(band.pixels, whole.pixels);
                    assert!((band.signal_ratio / whole.signal_ratio - 1.0).abs() < 1e-12);
                    assert!((band.drift - whole.drift).abs() < 1e-12);
                    assert_eq!(band.moved_pixels, whole.moved_pixels);
                }
            }
        }
    }

    #[test]
    fn frames_of_another_size_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut stack = Stack::new(folder.path(), 4, 4, 1).unwrap();
        let error = stack
            .add(FrameRole::Light, 0.1, &[vec![0; 15]])
            .unwrap_err();
        assert!(error.to_string().contains("15 pixels"), "{error}");
        assert!(
            stack
                .add(FrameRole::Light, f64::NAN, &[vec![0; 16]])
                .is_err()
        );
        let noise = SensorNoise::ideal(0.4, 2.4, 64.0, 12);
        stack.add(FrameRole::Dark, 0.1, &[vec![0; 16]]).unwrap();
        let error = stack
            .bands(&noise, Mosaic::None, 0)
            .next_band()
            .unwrap_err();
        assert!(error.to_string().contains("no light frame"), "{error}");
    }
}
