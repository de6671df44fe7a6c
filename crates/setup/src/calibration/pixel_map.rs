//! One number per pixel as a 16-bit grey PNG next to a record.

use serde::{Deserialize, Serialize};

use super::record::{BadValue, MapFile, must};
use crate::checksum::sha256_hex;
use crate::radiometry::frame_file::picture;

/// A map whose value at a pixel is `lowest + per_count × count`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PixelMap {
    /// Value of count 0.
    pub lowest: f64,
    /// Step between counts; > 0.
    pub per_count: f64,
    /// 16-bit grey PNG.
    pub map: MapFile,
}

/// A file's name and what it holds.
pub type NamedBytes = (String, Vec<u8>);

/// A map that cannot be written or read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct MapError {
    /// Its name.
    pub file: String,
    /// What is wrong.
    pub problem: String,
}

impl PixelMap {
    /// Rows of `width` finite values as a PNG of this name, rounded to 1/65535 of
    /// their range.
    ///
    /// # Errors
    /// A size that is not `width` times rows.
    pub fn new(values: &[f64], width: usize, file: &str) -> Result<(Self, Vec<u8>), MapError> {
        let lowest = values.iter().copied().fold(f64::INFINITY, f64::min);
        let highest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let per_count = ((highest - lowest) / 65_535.0).max(1e-12);
        let counts = values
            .iter()
            .map(|value| ((value - lowest) / per_count).round().clamp(0.0, 65_535.0) as u16)
            .collect();
        let png = grey_png(counts, width).map_err(|problem| MapError {
            file: file.to_owned(),
            problem,
        })?;
        let map = Self {
            lowest,
            per_count,
            map: MapFile {
                file: file.to_owned(),
                sha256: sha256_hex(&png),
            },
        };
        Ok((map, png))
    }

    /// The values from the map's bytes.
    ///
    /// # Errors
    /// No PNG, or another size than the sensor's.
    pub fn read(&self, png: &[u8], resolution_px: [u32; 2]) -> Result<Vec<f32>, MapError> {
        let counts = grey_counts(png, resolution_px).map_err(|problem| MapError {
            file: self.map.file.clone(),
            problem,
        })?;
        let value = |count: u16| (self.lowest + self.per_count * f64::from(count)) as f32;
        Ok(counts.into_iter().map(value).collect())
    }

    pub(super) fn check(&self, key: &str) -> Result<(), BadValue> {
        let (lowest, step) = (self.lowest, self.per_count);
        let [first, second] = ["lowest", "per_count"].map(|name| format!("{key}.{name}"));
        must(lowest.is_finite(), &first, lowest, "a finite number")?;
        let possible = step > 0.0 && step.is_finite();
        must(possible, &second, step, "a number above 0")
    }
}

/// Rows of `width` counts as a PNG; or the reason why not.
pub(super) fn grey_png(counts: Vec<u16>, width: usize) -> Result<Vec<u8>, String> {
    let height = counts.len() / width.max(1);
    let fills = counts.len() == width * height;
    let image =
        image::ImageBuffer::<image::Luma<u16>, _>::from_raw(width as u32, height as u32, counts)
            .filter(|_| fills)
            .ok_or_else(|| format!("the pixels do not fill {width} x {height}"))?;
    let mut png = std::io::Cursor::new(Vec::new());
    image
        .write_to(&mut png, image::ImageFormat::Png)
        .map_err(|error| error.to_string())?;
    Ok(png.into_inner())
}

/// The counts of a PNG of this size; or the reason why not.
pub(super) fn grey_counts(png: &[u8], resolution_px: [u32; 2]) -> Result<Vec<u16>, String> {
    let size = resolution_px.map(|side| side as usize);
    let image = picture(png, Some(size)).map_err(|error| error.to_string())?;
    Ok(image.into_luma16().into_raw())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back_within_half_a_step() {
        let values: Vec<f64> = (0..12).map(|p| f64::from(p * p) * 0.37 - 5.0).collect();
        let (map, png) = PixelMap::new(&values, 4, "map.png").unwrap();
        let back = map.read(&png, [4, 3]).unwrap();
        for (back, value) in back.iter().zip(&values) {
            assert!((f64::from(*back) - value).abs() <= 0.51 * map.per_count + 1e-6);
        }
        let error = map.read(&png, [3, 4]).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("map.png: it is 4 x 3 pixels; 3 x 4"),
            "{error}"
        );
        assert!(map.read(&png[..20], [4, 3]).is_err());
        assert!(PixelMap::new(&values, 5, "map.png").is_err());
        // A constant is kept too.
        let (map, png) = PixelMap::new(&[2.5; 4], 2, "map.png").unwrap();
        assert_eq!(map.read(&png, [2, 2]).unwrap(), [2.5; 4]);
    }
}
