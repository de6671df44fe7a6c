//! Measured materials of the RGL database: `.bsdf` files (Dupuy & Jakob 2018,
//! "An Adaptive Parameterization for Efficient Material Acquisition and Rendering").
//!
//! A tensor file holds, per angle of incidence, a density over half vectors and
//! the reflectance over the unit square into which that density warps them:
//! f_r·cos θo = rgb(warp⁻¹(h))·D(h) / (4 σ(i)). Angles map to the unit square by
//! u = √(2θ/π) and v = (φ + π)/2π. Isotropic materials in RGB only.

use std::collections::HashMap;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::path::Path;

use glam::{DVec3, Vec3};

use super::{Brdf, BrdfError};
use crate::outside_file;

/// Most fields a tensor file may have.
const MAX_FIELDS: u32 = 64;

/// Why a tensor file holds no isotropic material in RGB.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RglFault {
    /// It was measured over azimuths, which an isotropic one does not need.
    #[error(
        "the material is anisotropic ({azimuths} azimuths of incidence); isotropic ones are read"
    )]
    Anisotropic {
        /// Azimuths of incidence.
        azimuths: usize,
    },
    /// Spectra in the place of red, green and blue.
    #[error("the file is spectral ({wavelengths} wavelengths); files in RGB are read")]
    Spectral {
        /// How many wavelengths.
        wavelengths: usize,
    },
    /// Another kind of file of the same ending, in words.
    #[error("the file is {0}; tensor files of the RGL database are read")]
    OtherKind(&'static str),
    /// What is wrong with it, in words.
    #[error("{0}")]
    Damaged(String),
}

impl From<String> for RglFault {
    fn from(fact: String) -> Self {
        Self::Damaged(fact)
    }
}

/// One isotropic material.
#[derive(Clone, Debug)]
pub struct RglBrdf {
    description: String,
    /// Angles of incidence of the slices, radians, ascending.
    theta_i_rad: Vec<f64>,
    /// D over half vectors.
    ndf: Grid,
    /// Projected area of the facets over directions.
    sigma: Grid,
    /// Per angle of incidence: the density that warps half vectors.
    warp: Vec<Warp>,
    /// Per angle of incidence: reflectance over the warped square, R, G, B.
    rgb: Vec<[Grid; 3]>,
}

impl RglBrdf {
    /// Reads a `.bsdf` file.
    pub fn read(path: &Path) -> Result<Self, BrdfError> {
        let bytes =
            outside_file::read_regular(path, super::LARGEST_FILE_BYTES).map_err(|source| {
                BrdfError::Io {
                    path: path.into(),
                    source,
                }
            })?;
        Self::parse(&bytes).map_err(|fault| match fault {
            RglFault::Damaged(fact) => BrdfError::File {
                path: path.into(),
                fact,
            },
            kind => BrdfError::RglKind {
                path: path.into(),
                kind,
            },
        })
    }

    /// [`Self::read`] from memory.
    pub fn parse(bytes: &[u8]) -> Result<Self, RglFault> {
        if let Some(kind) = other_kind(bytes) {
            return Err(RglFault::OtherKind(kind));
        }
        let fields = read_fields(bytes)?;
        let (_, phi_i) = floats(&fields, "phi_i", 1)?;
        if phi_i.len() > 2 {
            let azimuths = phi_i.len();
            return Err(RglFault::Anisotropic { azimuths });
        }
        if let (Some(field), false) = (fields.get("wavelengths"), fields.contains_key("rgb")) {
            let wavelengths = field.shape.first().copied().unwrap_or(0);
            return Err(RglFault::Spectral { wavelengths });
        }
        Ok(Self::isotropic_rgb(&fields, &phi_i)?)
    }

    fn isotropic_rgb(fields: &HashMap<String, Field<'_>>, phi_i: &[f32]) -> Result<Self, String> {
        if phi_i.is_empty() {
            return Err("field phi_i is empty; it needs one azimuth of incidence".to_owned());
        }
        let (_, theta) = floats(fields, "theta_i", 1)?;
        let theta_i_rad: Vec<f64> = theta.iter().map(|&t| f64::from(t)).collect();
        if !theta_i_rad.is_sorted_by(|a, b| a < b) || theta_i_rad.is_empty() {
            return Err(format!(
                "field theta_i has {} angles; at least one is needed, ascending",
                theta_i_rad.len()
            ));
        }
        let flat = |name: &str| -> Result<Grid, String> {
            let (shape, values) = floats(fields, name, 2)?;
            let grid = Grid::new(name, shape[1], shape[0], &values)?;
            some_positive(name, &values)?;
            Ok(grid)
        };
        // Fields of one slice per incidence; those of the first azimuth stand first.
        let incidences = [phi_i.len(), theta_i_rad.len()];
        let (shape, values) = floats(fields, "vndf", 4)?;
        let warp: Vec<Warp> = slices("vndf", &shape, incidences, &[], &values)?
            .map(|slice| Ok(Warp::new(Grid::new("vndf", shape[3], shape[2], slice)?)))
            .collect::<Result<_, String>>()?;
        let empty = warp.iter().filter(|warp| !warp.is_density()).count();
        if empty > 0 {
            return Err(format!(
                "field vndf: {empty} of {} slices have no positive integral, which a density has",
                warp.len()
            ));
        }
        let (shape, values) = floats(fields, "rgb", 5)?;
        let rgb = slices("rgb", &shape, incidences, &[3], &values)?
            .map(|slice| {
                let planes: Vec<&[f32]> = slice.chunks_exact(shape[3] * shape[4]).collect();
                let grid = |c: usize| Grid::new("rgb", shape[4], shape[3], planes[c]);
                Ok([grid(0)?, grid(1)?, grid(2)?])
            })
            .collect::<Result<_, String>>()?;
        // All 0 is a black material; all negative is none.
        if values.iter().all(|&value| value < 0.0) {
            let count = values.len();
            return Err(format!("field rgb: all of its {count} values are negative"));
        }
        if fields.get("jacobian").map(|field| field.bytes) != Some(&[1]) {
            return Err("the field jacobian is missing or not 1".to_owned());
        }
        let description = fields
            .get("description")
            .map(|field| String::from_utf8_lossy(field.bytes).into_owned())
            .unwrap_or_default();
        Ok(Self {
            description,
            theta_i_rad,
            ndf: flat("ndf")?,
            sigma: flat("sigma")?,
            warp,
            rgb,
        })
    }

    /// What the file calls the material.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// f_r·cos θo as the format defines it for light from `i` leaving towards `o`
    /// (unit, above the horizon): measured values, not exactly reciprocal; colours
    /// outside the RGB gamut are clipped at 0.
    pub fn eval_cosine(&self, i: DVec3, o: DVec3) -> [f64; 3] {
        let Some(h) = (i + o).try_normalize() else {
            return [0.0; 3];
        };
        let theta_i = elevation(i);
        let azimuth = h.y.atan2(h.x) - i.y.atan2(i.x);
        let u_h = to_square(elevation(h), azimuth);
        let u_i = to_square(theta_i, 0.0);
        // Slices around the angle of incidence.
        let last = self.theta_i_rad.len() - 1;
        let upper = self
            .theta_i_rad
            .partition_point(|&t| t <= theta_i)
            .clamp(1.min(last), last);
        let lower = upper.saturating_sub(1);
        let span = self.theta_i_rad[upper] - self.theta_i_rad[lower];
        let t = if span > 0.0 {
            ((theta_i - self.theta_i_rad[lower]) / span).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let warped = invert(&self.warp[lower], &self.warp[upper], t, u_h);
        let scale = self.ndf.at(u_h) / (4.0 * self.sigma.at(u_i)).max(f64::MIN_POSITIVE);
        [0, 1, 2].map(|c| {
            let value =
                (1.0 - t) * self.rgb[lower][c].at(warped) + t * self.rgb[upper][c].at(warped);
            (scale * value).max(0.0)
        })
    }
}

/// The material as measured, light and viewer not exchangeable: for judging the data.
#[derive(Clone, Copy, Debug)]
pub struct AsMeasured<'a>(pub &'a RglBrdf);

impl Brdf for AsMeasured<'_> {
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        if !(to_light.z > 0.0 && to_viewer.z > 0.0) {
            return [0.0; 3];
        }
        let value = self
            .0
            .eval_cosine(to_light.as_dvec3(), to_viewer.as_dvec3());
        value.map(|v| (v / f64::from(to_viewer.z)) as f32)
    }
}

impl Brdf for RglBrdf {
    /// The mean of both orders of the directions.
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        if !(to_light.z > 0.0 && to_viewer.z > 0.0) {
            return [0.0; 3];
        }
        let (i, o) = (to_light.as_dvec3(), to_viewer.as_dvec3());
        let (there, back) = (self.eval_cosine(i, o), self.eval_cosine(o, i));
        [0, 1, 2].map(|c| (0.5 * (there[c] / o.z + back[c] / i.z)) as f32)
    }
}

/// Angle to the normal, accurate near it.
fn elevation(d: DVec3) -> f64 {
    d.x.hypot(d.y).atan2(d.z)
}

fn to_square(theta: f64, phi: f64) -> [f64; 2] {
    let v = (phi + PI) / TAU;
    [(theta / FRAC_PI_2).max(0.0).sqrt(), v - v.floor()]
}

/// Values at the nodes of a regular grid over the unit square, row by row, bilinear between.
#[derive(Clone, Debug)]
struct Grid {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Grid {
    /// `field` is for messages.
    fn new(field: &str, width: usize, height: usize, values: &[f32]) -> Result<Self, String> {
        if width < 2 || height < 2 || values.len() != width * height {
            return Err(format!(
                "field {field} holds grids of {height} x {width} nodes; at least 2 x 2 are needed"
            ));
        }
        if let Some(bad) = values.iter().find(|v| !v.is_finite()) {
            return Err(format!("field {field} holds the value {bad}"));
        }
        Ok(Self {
            width,
            height,
            values: values.to_vec(),
        })
    }

    fn value(&self, x: usize, y: usize) -> f64 {
        f64::from(self.values[y * self.width + x])
    }

    fn at(&self, [u, v]: [f64; 2]) -> f64 {
        let (x, tx) = cell(u, self.width);
        let (y, ty) = cell(v, self.height);
        let row = |y: usize| (1.0 - tx) * self.value(x, y) + tx * self.value(x + 1, y);
        (1.0 - ty) * row(y) + ty * row(y + 1)
    }
}

/// Cell of a coordinate in [0, 1] among `nodes` nodes, and the fraction inside it.
fn cell(u: f64, nodes: usize) -> (usize, f64) {
    let position = u.clamp(0.0, 1.0) * (nodes - 1) as f64;
    let lower = (position as usize).min(nodes - 2);
    (lower, position - lower as f64)
}

/// A density over the unit square with its cumulated sums.
#[derive(Clone, Debug)]
struct Warp {
    density: Grid,
    /// Per node: integral of its row from the left, in cells.
    along_row: Vec<f64>,
    /// Per row: integral over all rows above, in cells.
    above: Vec<f64>,
    /// Integral of the whole.
    total: f64,
}

impl Warp {
    fn new(density: Grid) -> Self {
        let (w, h) = (density.width, density.height);
        let mut along_row = Vec::with_capacity(w * h);
        for y in 0..h {
            let mut sum = 0.0;
            along_row.push(sum);
            for x in 1..w {
                sum += 0.5 * (density.value(x - 1, y) + density.value(x, y));
                along_row.push(sum);
            }
        }
        let row_total = |y: usize| along_row[y * w + w - 1];
        let mut total = 0.0;
        let mut above = vec![0.0];
        for y in 1..h {
            total += 0.5 * (row_total(y - 1) + row_total(y));
            above.push(total);
        }
        Self {
            density,
            along_row,
            above,
            total,
        }
    }

    /// Whether the whole can be normalised.
    fn is_density(&self) -> bool {
        self.total > 0.0
    }
}

/// Cumulated coordinates of a point under the density interpolated between two
/// slices, each normalised: marginal over rows, then along the row.
fn invert(lower: &Warp, upper: &Warp, t: f64, [u, v]: [f64; 2]) -> [f64; 2] {
    let grid = &lower.density;
    let (w, h) = (grid.width, grid.height);
    let (x, tx) = cell(u, w);
    let (y, ty) = cell(v, h);
    let (a, b) = ((1.0 - t) / lower.total, t / upper.total);
    let mix = |of: &dyn Fn(&Warp) -> f64| a * of(lower) + b * of(upper);
    let row_total = |y: usize| mix(&|s| s.along_row[y * w + w - 1]);
    let (r0, r1) = (row_total(y), row_total(y + 1));
    let up_to = mix(&|s| s.above[y]) + ty * (r0 + 0.5 * ty * (r1 - r0));
    // The row at v itself.
    let in_row = |of: &dyn Fn(&Warp, usize) -> f64| {
        (1.0 - ty) * mix(&|s| of(s, y)) + ty * mix(&|s| of(s, y + 1))
    };
    let left = in_row(&|s, y| s.along_row[y * w + x]);
    let (v0, v1) = (
        in_row(&|s, y| s.density.value(x, y)),
        in_row(&|s, y| s.density.value(x + 1, y)),
    );
    let row = in_row(&|s, y| s.along_row[y * w + w - 1]);
    let along = left + tx * (v0 + 0.5 * tx * (v1 - v0));
    let fraction = if row > 0.0 { along / row } else { u };
    [fraction.clamp(0.0, 1.0), up_to.clamp(0.0, 1.0)]
}

/// Refuses a density that is 0, negative or empty throughout: no direction could be drawn from
/// it. Values of f may all be 0, a black material's.
fn some_positive(name: &str, values: &[f32]) -> Result<(), String> {
    if values.iter().any(|&value| value > 0.0) {
        return Ok(());
    }
    Err(format!(
        "field {name}: none of its {} values is above 0",
        values.len()
    ))
}

/// The values of a field, cut into those of each angle of incidence at the first azimuth.
///
/// # Errors
/// Other extents than `[azimuths, angles]`, then `inner`, then a grid of at least 2 × 2 nodes.
fn slices<'a>(
    name: &str,
    shape: &[usize],
    incidences: [usize; 2],
    inner: &[usize],
    values: &'a [f32],
) -> Result<impl Iterator<Item = &'a [f32]>, String> {
    let leading = [&incidences[..], inner].concat();
    let (found, grid) = shape.split_at(leading.len());
    if found != leading || grid.iter().any(|&nodes| nodes < 2) {
        let wanted = leading.iter().map(usize::to_string).collect::<Vec<_>>();
        let found = shape.iter().map(usize::to_string).collect::<Vec<_>>();
        return Err(format!(
            "field {name} is {}; needed is {} x at least 2 x 2",
            found.join(" x "),
            wanted.join(" x ")
        ));
    }
    let slice: usize = shape[2..].iter().product();
    Ok(values.chunks_exact(slice).take(incidences[1]))
}

struct Field<'a> {
    /// 1 for u8, 10 for f32, others as the format numbers them.
    kind: u8,
    shape: Vec<usize>,
    bytes: &'a [u8],
}

/// The named arrays of a tensor file, each within the file.
/// What else ends in `.bsdf`, or is met in the place of any file.
fn other_kind(bytes: &[u8]) -> Option<&'static str> {
    const STARTS: [(&str, &str); 8] = [
        ("scatfun", "a Fourier BSDF of pbrt-v3 or layerlab"),
        ("<?xml", "XML (a BSDF of WINDOW and Radiance, or another)"),
        ("<windowelement", "XML (a BSDF of WINDOW and Radiance)"),
        ("<!doctype", "a web page"),
        ("<html", "a web page"),
        (
            "version https://git-lfs",
            "a pointer of Git LFS in place of the file",
        ),
        ("pk\u{3}\u{4}", "a ZIP archive"),
        ("\u{1f}", "compressed by gzip"),
    ];
    /// Words of the tables of scatter that programs for illumination exchange.
    const OF_SCATTER: [&str; 4] = [
        "scattertype",
        "symmetry",
        "spectralcontent",
        "angleofincidence",
    ];
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(2048)]).to_ascii_lowercase();
    let head = head.trim_start_matches('\u{feff}').trim_start();
    let known = STARTS.iter().find(|(start, _)| head.starts_with(start));
    let is_scatter = || {
        OF_SCATTER
            .iter()
            .filter(|word| head.contains(*word))
            .count()
            >= 2
    };
    match known {
        Some((_, kind)) => Some(kind),
        None if is_scatter() => Some("a table of scatter in text (Zemax, Radiant, LightTools)"),
        None => None,
    }
}

fn read_fields(bytes: &[u8]) -> Result<HashMap<String, Field<'_>>, String> {
    let mut rest = bytes;
    let magic = take(&mut rest, 12)?;
    let version = take(&mut rest, 2)?;
    if magic != b"tensor_file\0" || version != [1, 0] {
        return Err("not a tensor file of version 1.0".to_owned());
    }
    let count = u32::from_le_bytes(word(&mut rest)?);
    if count > MAX_FIELDS {
        return Err(format!("{count} fields, allowed are {MAX_FIELDS}"));
    }
    let mut fields = HashMap::new();
    for _ in 0..count {
        let length = u16::from_le_bytes(word(&mut rest)?);
        let name = String::from_utf8_lossy(take(&mut rest, length.into())?).into_owned();
        let rank = u16::from_le_bytes(word(&mut rest)?);
        let [kind] = word(&mut rest)?;
        let offset = u64::from_le_bytes(word(&mut rest)?);
        let mut shape = Vec::new();
        let mut size: usize = match kind {
            1 | 2 => 1,
            3 | 4 | 9 => 2,
            5 | 6 | 10 => 4,
            7 | 8 | 11 => 8,
            _ => return Err(format!("field {name} has the unknown type {kind}")),
        };
        for _ in 0..rank {
            let extent =
                usize::try_from(u64::from_le_bytes(word(&mut rest)?)).unwrap_or(usize::MAX);
            size = size.saturating_mul(extent);
            shape.push(extent);
        }
        let data = usize::try_from(offset)
            .ok()
            .and_then(|offset| bytes.get(offset..offset.checked_add(size)?))
            .ok_or_else(|| format!("field {name} of {size} bytes lies outside the file"))?;
        let field = Field {
            kind,
            shape,
            bytes: data,
        };
        fields.insert(name, field);
    }
    Ok(fields)
}

fn take<'a>(rest: &mut &'a [u8], length: usize) -> Result<&'a [u8], String> {
    let (head, tail) = rest
        .split_at_checked(length)
        .ok_or("the file ends inside its header")?;
    *rest = tail;
    Ok(head)
}

fn word<const N: usize>(rest: &mut &[u8]) -> Result<[u8; N], String> {
    let mut bytes = [0; N];
    bytes.copy_from_slice(take(rest, N)?);
    Ok(bytes)
}

/// Shape and values of an f32 field of the given rank.
fn floats(
    fields: &HashMap<String, Field>,
    name: &str,
    rank: usize,
) -> Result<(Vec<usize>, Vec<f32>), String> {
    let field = fields.get(name).ok_or_else(|| format!("no field {name}"))?;
    if field.kind != 10 || field.shape.len() != rank {
        return Err(format!(
            "field {name} has type {} and {} dimensions, not f32 and {rank}",
            field.kind,
            field.shape.len()
        ));
    }
    let words = field.bytes.as_chunks::<4>().0;
    let values = words.iter().map(|w| f32::from_le_bytes(*w)).collect();
    Ok((field.shape.clone(), values))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PAPER: &[u8] = include_bytes!("../../tests/data/brdf/paper_white_rgb.bsdf");

    #[test]
    fn white_paper_is_white_and_diffuse() {
        let paper = RglBrdf::parse(PAPER).unwrap();
        assert!(paper.description().starts_with("White A4 paper"));
        let tilt = |theta: f32, phi: f32| {
            Vec3::new(
                theta.sin() * phi.cos(),
                theta.sin() * phi.sin(),
                theta.cos(),
            )
        };
        for (i, o) in [
            (tilt(0.5, 0.0), tilt(0.3, 2.0)),
            (tilt(0.1, 1.0), tilt(0.9, 4.0)),
        ] {
            for value in paper.eval(i, o) {
                let reflectance = value * std::f32::consts::PI;
                assert!((0.6..1.1).contains(&reflectance), "{reflectance}");
            }
            assert_eq!(paper.eval(i, o), paper.eval(o, i));
        }
        assert_eq!(paper.eval(Vec3::Z, -Vec3::Z), [0.0; 3]);
    }

    /// f_r·cos θo at random directions, by Mitsuba 3.9.1's `measured`.
    #[test]
    fn agrees_with_an_independent_reader() {
        let paper = RglBrdf::parse(PAPER).unwrap();
        let reference = include_str!("../../tests/data/brdf/rgl_reference_values.csv");
        let mut worst = 0.0f64;
        let mut rows = 0;
        for line in reference.lines().skip(1) {
            let v: Vec<f64> = line.split(',').map(|x| x.parse().unwrap()).collect();
            let (i, o) = (DVec3::new(v[0], v[1], v[2]), DVec3::new(v[3], v[4], v[5]));
            for (got, want) in paper.eval_cosine(i, o).into_iter().zip(&v[6..9]) {
                worst = worst.max((got - want).abs() / want);
            }
            rows += 1;
        }
        assert!(rows >= 200 && worst < 1e-4, "{rows} rows, {worst}");
    }

    #[test]
    fn a_warp_is_the_cumulated_density() {
        let density = Grid::new("", 3, 2, &[0.0, 1.0, 0.0, 2.0, 3.0, 2.0]).unwrap();
        let warp = Warp::new(density);
        assert_eq!(invert(&warp, &warp, 0.5, [0.0, 0.0]), [0.0, 0.0]);
        assert_eq!(invert(&warp, &warp, 0.5, [1.0, 1.0]), [1.0, 1.0]);
        // Row totals 1 and 5: half the height holds (1 + 3)/2·½ of 3.
        let [x, y] = invert(&warp, &warp, 0.25, [0.5, 0.5]);
        assert!((x - 0.5).abs() < 1e-12 && (y - 1.0 / 3.0).abs() < 1e-12);
    }

    /// The paper's file with one field of another shape, filled with `value`.
    fn with_field(changed: &str, shape: &[usize], value: f32) -> Vec<u8> {
        let fields = read_fields(PAPER).unwrap();
        let mut body = Vec::new();
        let mut head = b"tensor_file\0\x01\0".to_vec();
        head.extend((fields.len() as u32).to_le_bytes());
        let names: usize = fields
            .iter()
            .map(|(name, field)| {
                let rank = if name == changed {
                    shape.len()
                } else {
                    field.shape.len()
                };
                name.len() + 13 + 8 * rank
            })
            .sum();
        let start = head.len() + names;
        for (name, field) in &fields {
            let (shape, data) = if name == changed {
                let count = shape.iter().product();
                (shape, value.to_le_bytes().repeat(count))
            } else {
                (&field.shape[..], field.bytes.to_vec())
            };
            head.extend((name.len() as u16).to_le_bytes());
            head.extend(name.as_bytes());
            head.extend((shape.len() as u16).to_le_bytes());
            head.push(field.kind);
            head.extend(((start + body.len()) as u64).to_le_bytes());
            head.extend(shape.iter().flat_map(|&n| (n as u64).to_le_bytes()));
            body.extend(data);
        }
        [head, body].concat()
    }

    #[test]
    fn other_files_of_that_ending_are_named() {
        for (start, kind) in [
            (
                &b"# paint\nSymmetry  PlaneSymmetrical\nScatterType  BRDF\n"[..],
                "Zemax",
            ),
            (b"SCATFUN\x01\0\0", "layerlab"),
            (b"\xef\xbb\xbf<?xml version=\"1.0\"?>", "WINDOW"),
            (b"version https://git-lfs.github.com/spec/v1", "Git LFS"),
            (b"tensor_fil", "inside its header"),
        ] {
            let error = RglBrdf::parse(start).unwrap_err().to_string();
            assert!(error.contains(kind), "{error}");
        }
    }

    #[test]
    fn odd_shapes_and_empty_densities_are_refused_by_name() {
        let fields = read_fields(PAPER).unwrap();
        let shape = |name: &str| fields[name].shape.clone();
        let changed = |name: &str, axis: usize, extent: usize| {
            let mut shape = shape(name);
            shape[axis] = extent;
            shape
        };
        assert!(RglBrdf::parse(&with_field("rgb", &shape("rgb"), 0.5)).is_ok());
        let slices = shape("vndf")[1];
        for (name, shape, value, said) in [
            ("phi_i", vec![0], 0.0, "field phi_i is empty"),
            ("theta_i", vec![0], 0.0, "field theta_i has 0 angles"),
            ("theta_i", vec![1], 0.5, "needed is 1 x 1 x at least 2 x 2"),
            ("vndf", vec![1, slices, 0, 0], 1.0, "x 0 x 0; needed is 1 x"),
            ("vndf", changed("vndf", 0, 0), 1.0, "field vndf is 0 x"),
            ("vndf", changed("vndf", 1, 2), 1.0, "field vndf is 1 x 2 x"),
            ("vndf", changed("vndf", 3, 1), 1.0, "x 1; needed is 1 x"),
            (
                "vndf",
                shape("vndf"),
                0.0,
                "slices have no positive integral",
            ),
            (
                "vndf",
                shape("vndf"),
                -1.0,
                "slices have no positive integral",
            ),
            ("rgb", vec![1, slices, 3, 0, 0], 1.0, "field rgb"),
            ("rgb", changed("rgb", 2, 4), 1.0, "needed is 1 x"),
            ("rgb", shape("rgb"), -1e38, "field rgb: all of its"),
            ("ndf", vec![0, 0], 1.0, "field ndf holds grids of 0 x 0"),
            ("ndf", vec![1, 5], 1.0, "field ndf holds grids of 1 x 5"),
            ("sigma", shape("sigma"), 0.0, "field sigma: none of its"),
        ] {
            let error = RglBrdf::parse(&with_field(name, &shape, value));
            let error = error.err().map_or(String::new(), |error| error.to_string());
            assert!(error.contains(said), "{name} {shape:?} {value}: {error}");
        }
    }

    proptest! {
        #[test]
        fn damage_never_panics(at in 0usize..600, byte: u8, length in 0usize..1200) {
            let mut bytes = PAPER.to_vec();
            bytes[at] = byte;
            let _ = RglBrdf::parse(&bytes);
            let _ = RglBrdf::parse(&bytes[..length]);
        }
    }
}
