//! The exposure that each count of a camera that is not linear stands for.

use serde::Serialize;

use super::{CalibratingError, Kept, Place};
use crate::calibration::record::{ResponseCurve, ResponseValues};
use crate::calibration::white::Region;
use crate::radiometry::agreement::ExposureAgreement;
use crate::radiometry::bracket_files::{BracketFile, FrameReader};
use crate::radiometry::frame_file::FrameFile;
use crate::radiometry::response::{
    Response, ResponseMerge, ResponseOptions, contrast_spread, responses,
};

/// A bracket of a still scene.
pub struct ResponseRequest<'a> {
    /// The frames, 8 bits, with their exposures.
    pub files: &'a [BracketFile],
    /// The part of them that is used; `None`: all.
    pub region: Option<Region>,
    /// How the curves are estimated.
    pub options: ResponseOptions,
}

/// A response as measured.
#[derive(Clone, Debug, Serialize)]
#[allow(missing_docs)]
pub struct MeasuredResponse {
    pub exposures_s: Vec<f64>,
    pub values: ResponseValues,
    /// How the exposures of each channel agree once merged.
    #[serde(skip)]
    pub agreement: Vec<Vec<ExposureAgreement>>,
    /// How much the contrast of the channels' curves differs, see [`contrast_spread`].
    #[serde(skip)]
    pub contrast_spread: f64,
    #[serde(skip)]
    source: String,
    #[serde(skip)]
    method: String,
    #[serde(skip)]
    size_px: [u32; 2],
}

impl ResponseRequest<'_> {
    /// Reads the frames and finds the curve of each channel.
    ///
    /// # Errors
    /// Frames that cannot be read or do not determine a curve.
    pub fn measure(&self) -> Result<MeasuredResponse, CalibratingError> {
        let mut reader = FrameReader::default();
        let mut size_px = [0, 0];
        let mut frames = Vec::with_capacity(self.files.len());
        for BracketFile { path, .. } in self.files {
            let frame = reader.read(path)?;
            if frame.bits != 8 {
                return Err(CalibratingError::Bits {
                    path: path.clone(),
                    bits: frame.bits,
                });
            }
            size_px = [frame.width as u32, frame.height as u32];
            frames.push(match self.region {
                Some(region) => inside(region, &frame)?,
                None => frame,
            });
        }
        let exposures_s: Vec<f64> = self.files.iter().map(|file| file.exposure_s).collect();
        let curves = responses(&frames, &exposures_s, &self.options)?;
        let first = self
            .files
            .first()
            .map_or_else(Default::default, |file| file.path.display().to_string());
        let (low, high) = exposures_s
            .iter()
            .fold((f64::INFINITY, 0.0f64), |(low, high), &s| {
                (low.min(s), high.max(s))
            });
        Ok(MeasuredResponse {
            agreement: agreement(&frames, &exposures_s, &curves),
            contrast_spread: contrast_spread(&curves),
            source: format!("{} frames, {first} first", self.files.len()),
            method: format!(
                "{}, {} exposures of {low} to {high} s",
                self.options.estimator.name(),
                exposures_s.len(),
            ),
            values: ResponseValues {
                channels: curves.into_iter().map(ResponseCurve::from).collect(),
            },
            exposures_s,
            size_px,
        })
    }
}

fn inside(region: Region, frame: &FrameFile) -> Result<FrameFile, CalibratingError> {
    let Region {
        x,
        y,
        width,
        height,
    } = region;
    let part = frame.part(x..x.saturating_add(width), y..y.saturating_add(height));
    part.ok_or(CalibratingError::NotInside {
        region,
        frame_px: [frame.width, frame.height],
    })
}

/// How the exposures of each channel agree.
fn agreement(
    frames: &[FrameFile],
    exposures_s: &[f64],
    curves: &[Response],
) -> Vec<Vec<ExposureAgreement>> {
    let of = |(channel, curve): (usize, &Response)| {
        let counts = frames.iter().map(|frame| frame.planes[channel].as_slice());
        let merged = exposures_s.iter().copied().zip(counts).collect();
        let width = frames.first().map_or(1, |frame| frame.width);
        ResponseMerge::new(curve, width, merged).finish().agreement
    };
    curves.iter().enumerate().map(of).collect()
}

impl MeasuredResponse {
    /// Keeps the record with its figure.
    ///
    /// # Errors
    /// A file that cannot be written, or a record of that name that is there.
    pub fn keep(&self, place: &Place) -> Result<Kept, CalibratingError> {
        let mut place = place
            .clone()
            .measured_from(self.source.clone(), self.size_px);
        place.measurement.settings.bit_depth = Some(8);
        let kept = place.keep(self.values.clone(), &self.method, &[])?;
        #[cfg(feature = "figures")]
        let kept = place.draw(kept, &crate::calibration::figures::response(&self.values))?;
        Ok(kept)
    }
}
