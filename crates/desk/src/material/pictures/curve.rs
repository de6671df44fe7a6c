//! One curve: f along a line of angles, with its interval, cut where the images stop
//! constraining it.

use std::ops::Range;

use super::{Channel, Named};
use crate::brdf::HalfDifference;
use crate::session::fit_record::lookup::SMALLEST;

/// Logarithmic scales show at most so many powers of ten below the largest value.
const MOST_DECADES: f64 = 4.0;
/// A band widens the scale by at most so many at either end.
const BAND_DECADES: f64 = 0.5;
/// Room at either end.
const MARGIN_DECADES: f64 = 0.1;

/// A section of a curve whose points are all constrained by the images, or all not.
pub(super) struct Piece {
    pub constrained: bool,
    /// Position and log10 f.
    pub points: Vec<[f64; 2]>,
    /// Position, log10 lower and log10 upper; empty without intervals.
    pub band: Vec<[f64; 3]>,
}

/// Index into the palette, and the curve's pieces.
pub(super) type Curve = (usize, Vec<Piece>);

/// f of one channel at each (position, angles). Neighbouring pieces share a point, so that no
/// gap shows.
pub(super) fn pieces(
    named: &Named,
    channel: Channel,
    positions: impl Iterator<Item = (f64, HalfDifference)>,
) -> Vec<Piece> {
    let c = channel.index();
    let mut pieces: Vec<Piece> = Vec::new();
    for (at, angles) in positions {
        let (to_light, to_viewer) = angles.to_directions();
        let f = named.brdf.eval(to_light.as_vec3(), to_viewer.as_vec3())[c];
        let log_f = f64::from(f).max(SMALLEST).log10();
        let table_deg = [angles.theta_h_rad, angles.theta_d_rad].map(f64::to_degrees);
        let interval = named.table.as_ref();
        let interval = interval.and_then(|table| table.relative_interval(table_deg, c));
        let band = interval.map(|[low, high]| [at, log_f + low, log_f + high]);
        let constrained = named.is_constrained(table_deg[0], table_deg[1]);
        if pieces
            .last()
            .is_none_or(|last| last.constrained != constrained)
        {
            let joint = pieces.last().map(|last| {
                let band = last.band.last().copied();
                (last.points.last().copied(), band)
            });
            let (point, band) = joint.unwrap_or_default();
            pieces.push(Piece {
                constrained,
                points: point.into_iter().collect(),
                band: band.into_iter().collect(),
            });
        }
        if let Some(last) = pieces.last_mut() {
            last.points.push([at, log_f]);
            last.band.extend(band);
        }
    }
    pieces
}

/// Powers of ten around all curves, with what of the constrained bands is not far from them.
pub(super) fn decades<'a>(pieces: impl Iterator<Item = &'a Piece> + Clone) -> Range<f64> {
    let values = pieces
        .clone()
        .flat_map(|piece| piece.points.iter().map(|p| p[1]));
    let (mut low, mut high) = values.fold((f64::MAX, f64::MIN), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if low > high {
        return -3.0..0.0;
    }
    // Intervals that reach further are cut off: they would flatten everything else.
    let [lowest, highest] = [low - BAND_DECADES, high + BAND_DECADES];
    let constrained = pieces.filter(|piece| piece.constrained);
    for band in constrained.flat_map(|piece| &piece.band) {
        low = low.min(band[1].max(lowest));
        high = high.max(band[2].min(highest));
    }
    let end = high + MARGIN_DECADES;
    (low - MARGIN_DECADES).max(end - MOST_DECADES)..end
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::source;
    use crate::session::fit_record::{AngleTable, Interval};

    #[test]
    fn a_curve_is_cut_where_it_stops_being_constrained() {
        let cell = |constrained| Interval {
            value: [0.1; 3],
            lower: [0.05; 3],
            upper: [0.2; 3],
            constrained,
        };
        let named = Named {
            label: "fit".to_owned(),
            brdf: Arc::from(source::load("lambertian:0.5").unwrap()),
            table: Some(AngleTable {
                theta_h_deg: vec![0.0, 90.0],
                theta_d_deg: vec![0.0, 90.0],
                cells: vec![cell(true), cell(true), cell(false), cell(false)],
            }),
        };
        let angles = (0..9).map(|n| {
            let theta_h_rad = f64::from(10 * n).to_radians();
            let angles = HalfDifference {
                theta_h_rad,
                theta_d_rad: 0.3,
                phi_d_rad: std::f64::consts::FRAC_PI_2,
            };
            (f64::from(n), angles)
        });
        let pieces = pieces(&named, Channel::G, angles);
        let constrained: Vec<bool> = pieces.iter().map(|piece| piece.constrained).collect();
        assert_eq!(constrained, [true, false]);
        // The last constrained point is the first of the grey piece.
        assert_eq!(pieces[0].points.last(), pieces[1].points.first());
        // f = 0.5/π between half and twice of it.
        let [_, low, high] = pieces[0].band[0];
        let log_f = (0.5 / std::f64::consts::PI).log10();
        assert!((low - log_f - 0.5f64.log10()).abs() < 1e-6);
        assert!((high - log_f - 2f64.log10()).abs() < 1e-6);
        // The grey piece's band does not count, and the other's as a whole: it is narrow.
        let scale = decades(pieces.iter());
        assert!((scale.start - (log_f + 0.5f64.log10() - 0.1)).abs() < 1e-6);
        assert!((scale.end - (log_f + 2f64.log10() + 0.1)).abs() < 1e-6);
    }
}
