//! Latitude–longitude maps of incident radiance.
//!
//! Right-handed world, +y up. Row 0 is the top (+y). The centre column is the
//! direction −z, and columns run towards +x: a camera that looks along −z sees the
//! middle of the map behind the object, not mirrored. So column fraction u and
//! row fraction v (both in [0, 1)) are the direction
//! (sin πv · sin 2π(u − ½), cos πv, −sin πv · cos 2π(u − ½)).

use std::f64::consts::{PI, TAU};
use std::path::Path;

use glam::DVec3;

use super::BrdfError;
use crate::radiance_image::exr::ExrRows;

/// Names of the embedded maps, CC0 from Poly Haven, see data/envmaps/NOTICE.md.
pub const NAMES: [&str; 4] = ["city", "forest", "studio", "sunset"];

/// Most texels a map may have.
const MAX_TEXELS: usize = 1 << 26;

/// Incident radiance from every direction, with what is needed to sample it.
///
/// ```
/// use glam::DVec3;
/// use rig_core::brdf::environment::EnvironmentMap;
///
/// let studio = EnvironmentMap::embedded("studio").expect("one of NAMES");
/// assert_eq!(studio.size(), (128, 64));
/// // Radiance from above, and the density with which `sample` draws that direction.
/// let (radiance, density) = studio.look(DVec3::Y);
/// assert!(radiance[0] > 0.0 && density > 0.0);
/// ```
#[derive(Clone, Debug)]
pub struct EnvironmentMap {
    name: String,
    width: usize,
    height: usize,
    radiance: Vec<[f32; 3]>,
    /// Cumulated luminance × solid angle up to and including each texel, ending at 1.
    cumulated: Vec<f64>,
    /// The last of `cumulated` of each row.
    rows: Vec<f64>,
    /// Of one texel, per row, sr.
    solid_angles: Vec<f64>,
}

impl EnvironmentMap {
    /// From texels, row 0 at the top, finite and ≥ 0, not all zero.
    pub fn new(
        name: impl Into<String>,
        width: usize,
        height: usize,
        radiance: Vec<[f32; 3]>,
    ) -> Result<Self, String> {
        if width == 0 || height == 0 || radiance.len() != width * height {
            return Err(format!("{} texels for {width} x {height}", radiance.len()));
        }
        if let Some(bad) = radiance
            .iter()
            .flatten()
            .find(|v| !(v.is_finite() && **v >= 0.0))
        {
            return Err(format!("radiance {bad}, allowed is 0 and above"));
        }
        let solid_angles: Vec<f64> = (0..height)
            .map(|row| texel_solid_angle(width, height, row))
            .collect();
        let mut sum = 0.0;
        let mut cumulated: Vec<f64> = radiance
            .iter()
            .enumerate()
            .map(|(texel, rgb)| {
                sum += luminance(rgb) * solid_angles[texel / width];
                sum
            })
            .collect();
        if sum <= 0.0 {
            return Err("all texels are black".to_owned());
        }
        cumulated.iter_mut().for_each(|c| *c /= sum);
        Ok(Self {
            name: name.into(),
            width,
            height,
            radiance,
            rows: cumulated
                .chunks_exact(width)
                .map(|row| row[width - 1])
                .collect(),
            cumulated,
            solid_angles,
        })
    }

    /// One of [`NAMES`], 128 × 64, scaled to a mean luminance of 1; `None` for any other.
    pub fn embedded(name: &str) -> Option<Self> {
        let bytes: &[u8] = match name {
            "city" => include_bytes!("../../data/envmaps/city.exr"),
            "forest" => include_bytes!("../../data/envmaps/forest.exr"),
            "studio" => include_bytes!("../../data/envmaps/studio.exr"),
            "sunset" => include_bytes!("../../data/envmaps/sunset.exr"),
            _ => return None,
        };
        Some(Self::parse(name, bytes).expect("an embedded map is valid (tested)"))
    }

    /// All embedded maps, in the order of [`NAMES`]: the maps of the environment error.
    pub fn all() -> Vec<Self> {
        NAMES
            .iter()
            .filter_map(|name| Self::embedded(name))
            .collect()
    }

    /// Reads an OpenEXR file with channels R, G, B.
    pub fn read(path: &Path) -> Result<Self, BrdfError> {
        let bytes = crate::outside_file::read_regular(path, super::LARGEST_FILE_BYTES).map_err(
            |source| BrdfError::Io {
                path: path.into(),
                source,
            },
        )?;
        let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or("map");
        Self::parse(stem, &bytes).map_err(|fact| BrdfError::File {
            path: path.into(),
            fact,
        })
    }

    /// [`Self::read`] from memory.
    ///
    /// # Errors
    /// In words: no readable OpenEXR file, or too large.
    pub fn parse(name: &str, bytes: &[u8]) -> Result<Self, String> {
        let path = Path::new(name);
        let mut rows = ExrRows::of_bytes(bytes, path, None).map_err(|error| error.to_string())?;
        let [width, height] = rows.size();
        if width * height > MAX_TEXELS {
            return Err(format!(
                "{width} x {height} texels, allowed are {MAX_TEXELS}"
            ));
        }
        let image = rows.next_rows(height).map_err(|error| error.to_string())?;
        if image.valid.contains(&false) {
            return Err("some texels have no finite radiance".to_owned());
        }
        Self::new(name, width, height, image.mean)
    }

    /// What tables call it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// (columns, rows).
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Radiance R, G, B from a direction (unit), bilinear between texel centres, and the
    /// density of [`Self::sample`] there, per solid angle, 1/sr.
    pub fn look(&self, direction: DVec3) -> ([f32; 3], f64) {
        self.at(MapPosition::of(direction))
    }

    /// [`Self::look`] at a [`MapPosition`], which is the same on all maps.
    pub fn at(&self, MapPosition { u, v }: MapPosition) -> ([f32; 3], f64) {
        (self.radiance_at(u, v), self.density_at(u, v))
    }

    fn radiance_at(&self, u: f64, v: f64) -> [f32; 3] {
        let x = u * self.width as f64 - 0.5;
        let y = (v * self.height as f64 - 0.5).clamp(0.0, (self.height - 1) as f64);
        let (x0, y0) = (x.floor(), y.floor());
        let (tx, ty) = ((x - x0) as f32, (y - y0) as f32);
        let column = |k: f64| (k + self.width as f64) as usize % self.width;
        let (c0, c1) = (column(x0), column(x0 + 1.0));
        let (r0, r1) = (y0 as usize, (y0 as usize + 1).min(self.height - 1));
        let at = |row: usize, column: usize| self.radiance[row * self.width + column];
        let corners = [
            (at(r0, c0), (1.0 - tx) * (1.0 - ty)),
            (at(r0, c1), tx * (1.0 - ty)),
            (at(r1, c0), (1.0 - tx) * ty),
            (at(r1, c1), tx * ty),
        ];
        let mut sum = [0.0; 3];
        for (value, weight) in corners {
            for c in 0..3 {
                sum[c] += weight * value[c];
            }
        }
        sum
    }

    /// A direction drawn by texel luminance from `u` in [0, 1)²: the column in its row by the
    /// first, the row by the second, so that evenly spread `u` spread over both.
    pub fn sample(&self, u: [f64; 2]) -> DVec3 {
        let row = self
            .rows
            .partition_point(|&end| end <= u[1])
            .min(self.height - 1);
        let above = if row == 0 { 0.0 } else { self.rows[row - 1] };
        let in_row = self.rows[row] - above;
        let down = within(u[1], above, self.rows[row]);
        let wanted = above + u[0] * in_row;
        let texels = &self.cumulated[row * self.width..(row + 1) * self.width];
        let column = texels.partition_point(|&c| c <= wanted).min(self.width - 1);
        let left = if column == 0 {
            above
        } else {
            texels[column - 1]
        };
        let across = within(wanted, left, texels[column]);
        let (top, bottom) = row_cosines(self.height, row);
        let cos_v = top + (bottom - top) * down;
        direction((column as f64 + across) / self.width as f64, cos_v)
    }

    fn density_at(&self, u: f64, v: f64) -> f64 {
        let column = ((u * self.width as f64) as usize).min(self.width - 1);
        let row = ((v * self.height as f64) as usize).min(self.height - 1);
        let texel = row * self.width + column;
        let below = if texel == 0 {
            0.0
        } else {
            self.cumulated[texel - 1]
        };
        (self.cumulated[texel] - below) / self.solid_angles[row]
    }
}

/// Where a direction lies on every map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPosition {
    u: f64,
    v: f64,
}

impl MapPosition {
    /// Of a unit direction.
    pub fn of(direction: DVec3) -> Self {
        let (u, v) = coordinates(direction);
        Self { u, v }
    }
}

/// Where `value` lies between two cumulated sums, [0, 1].
fn within(value: f64, low: f64, high: f64) -> f64 {
    if high > low {
        ((value - low) / (high - low)).clamp(0.0, 1.0)
    } else {
        0.5
    }
}

/// Rec. 709 luminance.
fn luminance([r, g, b]: &[f32; 3]) -> f64 {
    0.2126 * f64::from(*r) + 0.7152 * f64::from(*g) + 0.0722 * f64::from(*b)
}

fn row_cosines(height: usize, row: usize) -> (f64, f64) {
    let at = |edge: usize| (PI * edge as f64 / height as f64).cos();
    (at(row), at(row + 1))
}

fn texel_solid_angle(width: usize, height: usize, row: usize) -> f64 {
    let (top, bottom) = row_cosines(height, row);
    TAU / width as f64 * (top - bottom)
}

fn direction(u: f64, cos_v: f64) -> DVec3 {
    let sin_v = (1.0 - cos_v * cos_v).max(0.0).sqrt();
    let (sin, cos) = (TAU * (u - 0.5)).sin_cos();
    DVec3::new(sin_v * sin, cos_v, -sin_v * cos)
}

/// Column and row fractions, both in [0, 1].
fn coordinates(direction: DVec3) -> (f64, f64) {
    let u = direction.x.atan2(-direction.z) / TAU + 0.5;
    (u, direction.y.clamp(-1.0, 1.0).acos() / PI)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_embedded_maps_are_valid_and_of_mean_one() {
        let maps = EnvironmentMap::all();
        assert_eq!(maps.len(), 4);
        for map in &maps {
            assert_eq!(map.size(), (128, 64));
            let mean: f64 = (0..64 * 128)
                .map(|t| luminance(&map.radiance[t]) * texel_solid_angle(128, 64, t / 128))
                .sum::<f64>()
                / (4.0 * PI);
            assert!((mean - 1.0).abs() < 2e-3, "{}: {mean}", map.name);
        }
        assert!(EnvironmentMap::embedded("moon").is_none());
    }

    #[test]
    fn orientation_is_as_documented() {
        // One bright texel right of the centre, in the upper half.
        let mut texels = vec![[0.0; 3]; 16 * 8];
        texels[2 * 16 + 12] = [1.0; 3];
        let map = EnvironmentMap::new("one", 16, 8, texels).unwrap();
        let towards = map.sample([0.5, 0.5]);
        assert!(
            towards.x > 0.5 && towards.y > 0.3 && towards.z.abs() < 0.4,
            "{towards}"
        );
        assert!(map.look(towards).0[0] > 0.5);
        assert_eq!(map.look(DVec3::NEG_Z).0[0], 0.0);
        assert!((coordinates(DVec3::NEG_Z).0 - 0.5).abs() < 1e-12);
    }

    #[test]
    fn sampling_has_its_density() {
        let map = EnvironmentMap::embedded("city").unwrap();
        // E[1/p] over samples is the sphere's solid angle where p > 0.
        let n = 40_000;
        let mut inside = 0;
        let mut weight = 0.0;
        for k in 0..n {
            let d = map.sample(crate::brdf::quadrature::point(k, n, [0.1, 0.2]));
            assert!((d.length() - 1.0).abs() < 1e-9);
            let p = map.look(d).1;
            assert!(p > 0.0);
            weight += 1.0 / p;
            inside += usize::from(d.y > 0.0);
        }
        let sphere = weight / f64::from(n);
        assert!((sphere / (4.0 * PI) - 1.0).abs() < 0.05, "{sphere}");
        assert!(inside > 0);
    }

    #[test]
    fn bad_maps_are_refused() {
        assert!(EnvironmentMap::new("x", 2, 2, vec![[1.0; 3]; 3]).is_err());
        assert!(EnvironmentMap::new("x", 1, 1, vec![[f32::NAN; 3]]).is_err());
        assert!(EnvironmentMap::new("x", 1, 1, vec![[0.0; 3]]).is_err());
        assert!(EnvironmentMap::parse("x", b"not an image").is_err());
    }
}
