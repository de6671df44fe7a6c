//! The part of a plane that an OpenEXR file shows, and the part of which it has pixels.

use std::ops::Range;
use std::path::Path;

use exr::math::Vec2;
use exr::meta::attribute::IntegerBounds;
use exr::meta::header::Header;

use super::{ExrError, MOST_PER_BYTE, MOST_PIXELS, SMALL_PIXELS};
use crate::radiance_image::RadianceImage;

/// The image (display window) and the pixels that the file has of it (data window).
#[derive(Clone, Copy)]
pub(super) struct Window {
    /// Pixels per row of the image, and rows.
    pub size: [usize; 2],
    /// Pixels per row of the data, and rows.
    pub data_size: [usize; 2],
    /// Where the data begin in the image.
    pub data_at: [i64; 2],
}

impl Window {
    /// Those of a part. Compared are the image's size with the expected one, where there is one,
    /// and else with what a file of so many bytes may well hold.
    pub fn of(
        header: &Header,
        bytes: u64,
        path: &Path,
        expected: Option<[usize; 2]>,
    ) -> Result<Self, ExrError> {
        let (data, display) = (
            header.data_window(),
            header.shared_attributes.display_window,
        );
        let Vec2(width, height) = display.size;
        if let Some(expected) = expected.filter(|&expected| expected != [width, height]) {
            return Err(ExrError::OtherSize {
                file: path.to_owned(),
                width,
                height,
                expected,
            });
        }
        let dense = |Vec2(width, height): Vec2<usize>| {
            let pixels = (width as u64).saturating_mul(height as u64);
            let most = SMALL_PIXELS
                .max(MOST_PER_BYTE.saturating_mul(bytes))
                .min(MOST_PIXELS);
            (1..=most).contains(&pixels)
        };
        // The camera's size is known to be one; the data may still be larger.
        let expected_data = expected == Some([data.size.0, data.size.1]);
        let fits =
            (expected.is_some() || dense(display.size)) && (expected_data || dense(data.size));
        if !fits {
            return Err(size_error(header, bytes, path));
        }
        let at = |axis: fn(Vec2<i32>) -> i32| {
            i64::from(axis(data.position)) - i64::from(axis(display.position))
        };
        let data_at = [at(|p| p.0), at(|p| p.1)];
        let data_size = [data.size.0, data.size.1];
        let overlap = (0..2).all(|axis| {
            let size = [width, height][axis] as i64;
            data_at[axis] < size && data_at[axis] + data_size[axis] as i64 > 0
        });
        if !overlap {
            let numbers = |window: IntegerBounds| {
                let Vec2(left, top) = window.position;
                let Vec2(width, height) = window.size;
                [width as i64, height as i64, left.into(), top.into()]
            };
            return Err(ExrError::Windows {
                file: path.to_owned(),
                data: numbers(data),
                display: numbers(display),
            });
        }
        Ok(Self {
            size: [width, height],
            data_size,
            data_at,
        })
    }

    /// Rows of the image of which the file has no pixels.
    pub fn without_data(&self, rows: usize) -> RadianceImage {
        let mut band = RadianceImage::new(self.size[0], rows);
        band.valid.fill(false);
        band
    }

    /// These rows of data as rows of the image.
    pub fn in_image(&self, data: RadianceImage, rows: Range<usize>) -> RadianceImage {
        let (width, left) = (self.size[0], self.data_at[0]);
        if left == 0 && data.width == width && rows == (0..data.height) {
            return data;
        }
        let mut band = self.without_data(rows.len());
        let skipped = usize::try_from(-left).unwrap_or(0);
        let at = usize::try_from(left).unwrap_or(0);
        let count = (data.width - skipped.min(data.width)).min(width - at.min(width));
        for (y, row) in rows.enumerate() {
            let from = row * data.width + skipped;
            let to = y * width + at;
            band.mean[to..to + count].copy_from_slice(&data.mean[from..from + count]);
            band.variance[to..to + count].copy_from_slice(&data.variance[from..from + count]);
            band.valid[to..to + count].copy_from_slice(&data.valid[from..from + count]);
        }
        band
    }
}

pub(super) fn size_error(header: &Header, bytes: u64, path: &Path) -> ExrError {
    ExrError::Size {
        file: path.to_owned(),
        width: header.layer_size.0,
        height: header.layer_size.1,
        channels: header.channels.list.len(),
        bytes,
    }
}
