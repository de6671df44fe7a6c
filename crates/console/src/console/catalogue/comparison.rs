//! Fits against each other: one number for each pair, and their curves of f.

use std::sync::{Arc, PoisonError};

use serde::Serialize;

use super::pages::SessionPages;
use super::served::FileError;
use crate::brdf::Brdf;
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::score::{image_error, summarise};
use crate::brdf::sphere::sphere_images;
use crate::catalogue::row::{self, read_fit};
use crate::session::fit_record::AngleTable;
use crate::session::fit_record::lookup::nearest_index;

/// Fits that are compared at once.
const MOST_FITS: usize = 4;
/// Pixels a side of the spheres of the environment error.
const SPHERE_PX: usize = 64;
/// Difference angles of the curves, degrees; the nearest of the fit's table.
const THETA_D_DEG: [f64; 3] = [6.0, 30.0, 60.0];
/// From an interval of 95 % to a standard uncertainty.
const WIDTHS: f64 = 2.0 * 1.96;

/// Two or more fits.
#[derive(Debug, Serialize)]
pub struct FitComparison {
    /// Each fit, as asked for.
    pub fits: Vec<Compared>,
    /// Each two of them.
    pub pairs: Vec<Pair>,
}

/// One of the fits.
#[derive(Debug, Serialize)]
pub struct Compared {
    /// Its session's name.
    pub session: String,
    /// Its number.
    pub fit: u32,
    /// f over the half angle at some difference angles; empty if the fit left no table.
    pub curves: Vec<Curve>,
}

/// f at one difference angle.
#[derive(Debug, Serialize)]
pub struct Curve {
    /// The difference angle, degrees.
    pub theta_d_deg: f64,
    /// Half angles, degrees.
    pub theta_h_deg: Vec<f64>,
    /// f at each by channel, 1/sr.
    pub value: Vec<[f64; 3]>,
    /// Lower ends of the 95 % intervals.
    pub lower: Vec<[f64; 3]>,
    /// Upper ends.
    pub upper: Vec<[f64; 3]>,
}

/// How far two fits are apart.
#[derive(Debug, PartialEq, Serialize)]
pub struct Pair {
    /// Index of the reference among the fits.
    pub of: usize,
    /// Index of the one that is compared with it.
    pub with: usize,
    /// Environment error of `with` against `of`, relative.
    pub environment_error: f64,
    /// Root mean square of their difference in f in units of its standard uncertainty, over
    /// the cells that the images of both constrain; `None` if there is none.
    pub in_uncertainties: Option<f64>,
}

/// Why fits are not compared; facts only.
#[derive(Debug, thiserror::Error)]
pub enum ComparisonError {
    /// What was asked for is no list of fits.
    #[error("{asked:?} is no list of 2 to {MOST_FITS} fits as SESSION:FIT/SESSION:FIT")]
    Asked {
        /// As it was asked for.
        asked: String,
    },
    /// A session or fit.
    #[error(transparent)]
    File(#[from] FileError),
}

impl SessionPages {
    /// Compares fits, each as `SESSION:FIT`, with slashes between them. Takes up to some seconds.
    ///
    /// # Errors
    /// No such list, or a fit that cannot be read.
    pub fn compare(&self, asked: &str) -> Result<FitComparison, ComparisonError> {
        let malformed = || ComparisonError::Asked {
            asked: asked.to_owned(),
        };
        let named = |fit: &str| {
            let (session, number) = fit.rsplit_once(':')?;
            Some((session.to_owned(), number.parse().ok()?))
        };
        let fits: Option<Vec<(String, u32)>> = asked.split('/').map(named).collect();
        let fits = fits.filter(|fits| (2..=MOST_FITS).contains(&fits.len()));
        let fits = fits.ok_or_else(malformed)?;
        let _turn = (self.comparing.lock()).unwrap_or_else(PoisonError::into_inner);

        let read = |(name, number): &(String, u32)| -> Result<_, FileError> {
            let session = row::open(self.catalogue().folder(), name)?;
            let record = read_fit(&session, *number)?;
            Ok((record.material()?, record.table))
        };
        let read: Vec<(Arc<dyn Brdf>, AngleTable)> =
            fits.iter().map(read).collect::<Result<_, _>>()?;
        let (brdfs, maps) = (read.iter().map(|(brdf, _)| &**brdf), EnvironmentMap::all());
        let spheres = sphere_images(&brdfs.collect::<Vec<_>>(), &maps, SPHERE_PX);
        let mut pairs = Vec::new();
        for (of, reference) in read.iter().enumerate() {
            for (with, other) in read.iter().enumerate().skip(of + 1) {
                let errors = spheres.iter().map(|u| image_error(&u[with], &u[of]));
                let errors: Vec<_> = errors.collect();
                pairs.push(Pair {
                    of,
                    with,
                    environment_error: summarise(&maps, &errors).mean.all,
                    in_uncertainties: in_uncertainties(&reference.1, &other.1),
                });
            }
        }
        let fits = fits.into_iter().zip(&read);
        Ok(FitComparison {
            fits: fits
                .map(|((session, fit), (_, table))| Compared {
                    session,
                    fit,
                    curves: curves(table),
                })
                .collect(),
            pairs,
        })
    }
}

fn curves(table: &AngleTable) -> Vec<Curve> {
    let column = |wanted: f64| nearest_index(&table.theta_d_deg, wanted);
    let curve = |column: usize| {
        let cells = || (0..table.theta_h_deg.len()).filter_map(move |i| table.cell(i, column));
        Curve {
            theta_d_deg: table.theta_d_deg[column],
            theta_h_deg: table.theta_h_deg.clone(),
            value: cells().map(|cell| cell.value).collect(),
            lower: cells().map(|cell| cell.lower).collect(),
            upper: cells().map(|cell| cell.upper).collect(),
        }
    };
    let mut columns: Vec<usize> = THETA_D_DEG.into_iter().filter_map(column).collect();
    columns.dedup();
    columns.into_iter().map(curve).collect()
}

/// See [`Pair::in_uncertainties`]. Tables of other angles are not compared.
fn in_uncertainties(a: &AngleTable, b: &AngleTable) -> Option<f64> {
    if (&a.theta_h_deg, &a.theta_d_deg) != (&b.theta_h_deg, &b.theta_d_deg) {
        return None;
    }
    let both = a.cells.iter().zip(&b.cells);
    let both = both.filter(|(a, b)| a.constrained && b.constrained);
    let (mut sum, mut count) = (0.0, 0u32);
    for (a, b) in both {
        for c in 0..3 {
            let u = [a, b].map(|cell| (cell.upper[c] - cell.lower[c]) / WIDTHS);
            let variance = u[0] * u[0] + u[1] * u[1];
            if variance > 0.0 {
                sum += (a.value[c] - b.value[c]).powi(2) / variance;
                count += 1;
            }
        }
    }
    (count > 0).then(|| (sum / f64::from(count)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::fit_record::Interval;

    fn table(value: f64, half_width: f64, constrained: bool) -> AngleTable {
        let cell = Interval {
            value: [value; 3],
            lower: [value - half_width; 3],
            upper: [value + half_width; 3],
            constrained,
        };
        AngleTable {
            theta_h_deg: vec![0.0, 45.0],
            theta_d_deg: vec![0.0, 30.0],
            cells: vec![cell; 4],
        }
    }

    #[test]
    fn a_difference_is_measured_by_its_uncertainty() {
        let (a, b) = (table(1.0, 0.3 * 1.96, true), table(2.0, 0.4 * 1.96, true));
        // Deviations of 0.3 and 0.4 make one of 0.5.
        let apart = in_uncertainties(&a, &b).unwrap();
        assert!((apart - 2.0).abs() < 1e-12, "{apart}");
        assert_eq!(in_uncertainties(&a, &a), Some(0.0));
        assert_eq!(in_uncertainties(&a, &table(1.0, 0.1, false)), None);
        assert_eq!(in_uncertainties(&a, &AngleTable::default()), None);
        let curves = curves(&b);
        let angles: Vec<f64> = curves.iter().map(|curve| curve.theta_d_deg).collect();
        assert_eq!((angles, curves[1].value[1]), (vec![0.0, 30.0], [2.0; 3]));
        assert!(super::curves(&AngleTable::default()).is_empty());
    }
}
