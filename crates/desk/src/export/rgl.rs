//! A BRDF as an RGL `.bsdf` file (Dupuy & Jakob 2018, "An Adaptive Parameterization
//! for Efficient Material Acquisition and Rendering"), isotropic.
//!
//! A reader evaluates f·cos θo = S(warp⁻¹(m))·D(m) / (4 σ(i)) for the half vector m
//! and samples by warping a uniform point twice: by `luminance` into the square on
//! which S is tabulated, and by `vndf` from there to half vectors. Any `vndf` gives
//! the right values if S is tabulated for it; it decides where the table is fine.
//! Here it is half the visible-normal density D(m)⟨i, m⟩ and half a density that
//! follows how fast log f changes with θh, so that a narrow lobe over a matte ground gets
//! nodes of its own (docs/adr/0016). `luminance` is the reflected radiance's density
//! over half vectors divided by `vndf`, which makes sampling nearly proportional
//! to f·cos θo whatever `vndf` is.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec3;
use rayon::prelude::*;

use super::facets::{DIFFERENCES_DEG, Facets, across, square_of, theta_of};
use super::spectrum;
use super::tensor_file::{self, Field};
use super::warp::Warp;
use super::{ExportError, Format, Writer, replace, summary};
use crate::brdf::Brdf;
use crate::session::fit_record::FitRecord;

/// RGL's file in RGB.
pub(super) const FORMAT: Format = Format {
    name: "rgl",
    about: "RGL .bsdf in RGB, for Mitsuba 3's `measured`",
    ending: "bsdf",
    companion: None,
    writer: Writer::OfFit(|record, files| replace(&files[0], &of_fit(record, Channels::Rgb)?)),
};

/// The same with spectra; they are an assumption.
pub(super) const SPECTRAL_FORMAT: Format = Format {
    name: "rgl-spectral",
    about: "RGL .bsdf with spectra, for pbrt-v4's `measured` and spectral Mitsuba 3",
    ending: "spectral.bsdf",
    writer: Writer::OfFit(|record, files| replace(&files[0], &of_fit(record, Channels::Spectral)?)),
    ..FORMAT
};

/// The bytes of a fit's file.
pub(super) fn of_fit(record: &FitRecord, channels: Channels) -> Result<Vec<u8>, ExportError> {
    let mut text = summary(record);
    if matches!(channels, Channels::Spectral) {
        text += " Spectra are an assumption: smooth ones whose colour under D65 is the RGB value.";
    }
    Ok(to_bytes(&*record.material()?, channels, &text))
}

/// What the table's channels are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channels {
    /// R, G, B: the form that Mitsuba 3 reads in its RGB variants.
    Rgb,
    /// Reflectances at wavelengths, whose colour under D65 is the RGB value: the form
    /// that pbrt-v4 and the spectral variants of Mitsuba 3 read.
    Spectral,
}

/// Angles of incidence, 0 to almost 90°; denser towards grazing, where the Fresnel
/// term rises within a few degrees.
const INCIDENCES: usize = 40;
/// Nodes of D and σ, and of `vndf` along the polar angle.
const POLAR: usize = 256;
/// Nodes of `vndf` along the azimuth.
const AZIMUTHAL: usize = 64;
/// Nodes of the table and of `luminance` along either side; readers want a square.
const SIDE: usize = 64;
/// Share of `vndf` that follows the change of D.
const FOLLOWING: f64 = 0.5;
/// Share of `vndf` and of `luminance` that is uniform: no row of them is empty, and
/// no sample weighs much more than the others.
const UNIFORM: f64 = 0.01;
/// The last incidence; at 90° sharp nothing is lit.
const STEEPEST: f64 = FRAC_PI_2 * 0.999;
/// What counts as dark, 1/sr.
const FAINT: f64 = 1e-3;
/// Distances of the incidences from the last one grow with this power.
const GRAZING: f64 = 1.5;

/// The file's bytes; `description` is kept inside. 5 MB in RGB, 14 MB spectral.
pub fn to_bytes(brdf: &dyn Brdf, channels: Channels, description: &str) -> Vec<u8> {
    let facets = Facets::of(brdf, POLAR);
    let theta_i: Vec<f32> = (0..INCIDENCES)
        .map(|k| k as f64 / (INCIDENCES - 1) as f64)
        .map(|t| (STEEPEST * (1.0 - (1.0 - t).powf(GRAZING))) as f32)
        .collect();
    let following = following_density(brdf);
    let slices: Vec<Slice> = theta_i
        .par_iter()
        .map(|&theta| Slice::new(brdf, &facets, &following, f64::from(theta), channels))
        .collect();
    let join =
        |of: fn(&Slice) -> &Vec<f32>| -> Vec<f32> { slices.iter().flat_map(of).copied().collect() };
    let twice = |values: &[f32]| [values, values].concat();
    let table = join(|slice| &slice.table);
    let mut fields = vec![
        Field::bytes("description", description.as_bytes()),
        Field::floats("phi_i", &[1], &[0.0]),
        Field::floats("theta_i", &[INCIDENCES], &theta_i),
        Field::floats("sigma", &[2, POLAR], &twice(&facets.sigma)),
        Field::floats("ndf", &[2, POLAR], &twice(&facets.ndf)),
        Field::floats(
            "vndf",
            &[1, INCIDENCES, AZIMUTHAL, POLAR],
            &join(|slice| &slice.vndf),
        ),
        Field::floats(
            "luminance",
            &[1, INCIDENCES, SIDE, SIDE],
            &join(|slice| &slice.luminance),
        ),
    ];
    let shape = |count| [1, INCIDENCES, count, SIDE, SIDE];
    match channels {
        Channels::Rgb => fields.push(Field::floats("rgb", &shape(3), &table)),
        Channels::Spectral => {
            let wavelengths = spectrum::WAVELENGTHS_NM;
            fields.push(Field::floats(
                "wavelengths",
                &[wavelengths.len()],
                &wavelengths,
            ));
            fields.push(Field::floats("spectra", &shape(wavelengths.len()), &table));
        }
    }
    fields.push(Field::bytes("jacobian", &[1]));
    tensor_file::encode(&fields)
}

/// How fast the logarithm of f changes with u at the polar nodes, in the channel and at
/// the difference angle where it changes fastest; mean 1.
fn following_density(brdf: &dyn Brdf) -> Vec<f64> {
    let logs: Vec<Vec<f64>> = (0..POLAR)
        .map(|k| theta_of(k as f64 / (POLAR - 1) as f64))
        .map(|theta_h| {
            let f = DIFFERENCES_DEG.map(|theta_d_deg| across(brdf, theta_h, theta_d_deg));
            f.as_flattened().iter().map(|f| (f + FAINT).ln()).collect()
        })
        .collect();
    let change: Vec<f64> = (0..POLAR)
        .map(|k| {
            // f falls to 0 at the horizon: the last node carries no information.
            let (before, after) = (k.saturating_sub(1), (k + 1).min(POLAR - 2));
            let pairs = logs[before].iter().zip(&logs[after]);
            pairs.map(|(a, b)| (b - a).abs()).fold(0.0, f64::max)
        })
        .collect();
    let mean = change.iter().sum::<f64>() / POLAR as f64;
    let normalised = |c: &f64| if mean > 0.0 { c / mean } else { 1.0 };
    change.iter().map(normalised).collect()
}

/// All fields of one angle of incidence.
struct Slice {
    /// `[azimuth][polar]`.
    vndf: Vec<f32>,
    /// `[y][x]`.
    luminance: Vec<f32>,
    /// `[channel][y][x]`.
    table: Vec<f32>,
}

impl Slice {
    fn new(
        brdf: &dyn Brdf,
        facets: &Facets,
        following: &[f64],
        theta_i: f64,
        channels: Channels,
    ) -> Self {
        let i = DVec3::new(theta_i.sin(), 0.0, theta_i.cos());
        let vndf = vndf(facets, following, i);
        let warp = Warp::new(POLAR, vndf.iter().map(|&v| f64::from(v)).collect());
        let sigma = facets.sigma_at(square_of(theta_i));
        let side = |k: usize| k as f64 / (SIDE - 1) as f64;
        let mut radiance = Vec::with_capacity(SIDE * SIDE);
        let mut luminance = Vec::with_capacity(SIDE * SIDE);
        for node in 0..SIDE * SIDE {
            let ([u, v], density) = warp.sample([side(node % SIDE), side(node / SIDE)]);
            let m = half_vector(u, v);
            let i_m = i.dot(m);
            let o = 2.0 * i_m * m - i;
            let d = facets.ndf_at(u);
            if !(o.z > 0.0 && i_m > 0.0 && d > 0.0) {
                radiance.push([0.0; 3]);
                luminance.push(0.0);
                continue;
            }
            let reflected = brdf
                .eval(i.as_vec3(), o.as_vec3())
                .map(|f| f64::from(f) * o.z);
            radiance.push(reflected.map(|r| (r * 4.0 * sigma / d) as f32));
            // Per unit of the square that `vndf` warps from.
            let jacobian = 4.0 * i_m * 2.0 * PI * PI * u * theta_of(u).sin();
            luminance.push(spectrum::luminance(reflected) * jacobian / density.max(1e-12));
        }
        let mean = luminance.iter().sum::<f64>() / (SIDE * SIDE) as f64;
        let floor = (UNIFORM * mean).max(f64::from(f32::MIN_POSITIVE));
        let channel = |c: usize| radiance.iter().map(move |value| value[c]);
        let table = match channels {
            Channels::Rgb => (0..3).flat_map(channel).collect(),
            Channels::Spectral => (0..spectrum::WAVELENGTHS_NM.len())
                .flat_map(|band| {
                    radiance
                        .iter()
                        .map(move |&rgb| spectrum::reflectance(rgb, band))
                })
                .collect(),
        };
        Self {
            vndf,
            luminance: luminance.iter().map(|l| (l + floor) as f32).collect(),
            table,
        }
    }
}

fn half_vector(u: f64, v: f64) -> DVec3 {
    let (sin, cos) = theta_of(u).sin_cos();
    let (sin_phi, cos_phi) = ((v - 0.5) * TAU).sin_cos();
    DVec3::new(sin * cos_phi, sin * sin_phi, cos)
}

/// The density that warps half vectors for light from `i`, `[azimuth][polar]`.
fn vndf(facets: &Facets, following: &[f64], i: DVec3) -> Vec<f32> {
    let node = |index: usize| {
        let u = (index % POLAR) as f64 / (POLAR - 1) as f64;
        let v = (index / POLAR) as f64 / (AZIMUTHAL - 1) as f64;
        (u, i.dot(half_vector(u, v)).max(0.0))
    };
    let nodes = POLAR * AZIMUTHAL;
    let visible = (0..nodes).map(|index| {
        let (u, i_m) = node(index);
        i_m * facets.ndf_at(u) * u * theta_of(u).sin()
    });
    let follows = (0..nodes).map(|index| node(index).1 * following[index % POLAR]);
    let normalised = |values: Vec<f64>| {
        let mean = values.iter().sum::<f64>() / nodes as f64;
        values
            .into_iter()
            .map(move |v| if mean > 0.0 { v / mean } else { 1.0 })
    };
    normalised(visible.collect())
        .zip(normalised(follows.collect()))
        .map(|(visible, follows)| {
            let mixed = (1.0 - FOLLOWING) * visible + FOLLOWING * follows;
            ((1.0 - UNIFORM) * mixed + UNIFORM) as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::atom::cosine_direction;
    use crate::brdf::ggx::sample_visible;
    use crate::brdf::rgl::RglBrdf;
    use crate::brdf::{Dictionary, Mixture};
    use rig_core::random::{Purpose, stream};

    fn mixture(parts: &[(usize, f64)]) -> Mixture {
        let dictionary = Arc::new(Dictionary::paper42());
        let channel = |shift: f64| {
            let mut weights = vec![0.0; 42];
            for &(atom, weight) in parts {
                weights[atom] = weight * shift;
            }
            weights[41] += 1.0 - weights.iter().sum::<f64>();
            weights
        };
        Mixture::new(dictionary, [channel(1.0), channel(0.8), channel(0.5)]).unwrap()
    }

    /// Atoms and weights: matte, broad, narrow, narrow on matte, many.
    const MATERIALS: [&[(usize, f64)]; 5] = [
        &[(40, 0.6)],
        &[(31, 1.0)],
        &[(0, 1.0)],
        &[(32, 0.7), (40, 0.3)],
        &[(32, 0.3), (21, 0.1), (12, 0.1), (3, 0.1), (40, 0.3)],
    ];

    /// By the reader, which was checked against another program: f·cos θo at pairs of
    /// directions up to 72°, half of them in a lobe of one of three widths. Single
    /// values are compared with a floor.
    #[test]
    fn the_file_holds_the_brdf() {
        for parts in MATERIALS {
            let brdf = mixture(parts);
            let back = RglBrdf::parse(&to_bytes(&brdf, Channels::Rgb, "test")).unwrap();
            assert_eq!(back.description(), "test");
            let mut numbers = stream(5, Purpose::Experiment, 0, 0, 0);
            let mut uniform = || numbers.uniform();
            let (mut errors, mut wrong, mut all) = (Vec::new(), 0.0, 0.0);
            for pair in 0..6000 {
                let mut direction = || cosine_direction([uniform(), 0.9 * uniform()]);
                let (i, mut o) = (direction(), direction());
                if pair % 2 == 0 {
                    let alpha = [0.01, 0.05, 0.2][pair / 2 % 3];
                    let u = [uniform(), uniform()];
                    o = DVec3::from_array(sample_visible(alpha, i.to_array(), u));
                }
                if o.z < 0.3 {
                    continue;
                }
                let f = brdf.eval(i.as_vec3(), o.as_vec3());
                for (got, f) in back.eval_cosine(i, o).into_iter().zip(f) {
                    let want = f64::from(f) * o.z;
                    wrong += (got - want).abs();
                    all += want;
                    errors.push((got - want).abs() / (want + FAINT));
                }
            }
            errors.sort_by(f64::total_cmp);
            let at = |share: f64| errors[(share * errors.len() as f64) as usize];
            assert!(
                wrong / all < 0.01 && at(0.5) < 2e-3 && at(0.9) < 0.03,
                "{parts:?}: {} in all, median {}, 90% {}",
                wrong / all,
                at(0.5),
                at(0.9)
            );
        }
    }

    /// The numbers that a reader divides by are positive, those it samples by not negative.
    #[test]
    fn black_makes_a_valid_file() {
        let bytes = to_bytes(&mixture(&[]), Channels::Rgb, "");
        let back = RglBrdf::parse(&bytes).unwrap();
        let tilted = DVec3::new(0.6, 0.0, 0.8);
        assert_eq!(back.eval_cosine(tilted, DVec3::Z), [0.0; 3]);
    }
}
