//! Finding the board in an image.

use chess_corners::{Detector, DetectorConfig};
use glam::DVec2;

use super::corner::{Corner, refine};
use super::grid::{Candidate, label};
use super::{Board, CameraError};
use crate::calibration::mirror_sphere::Grey;

/// A view with fewer corners than these is not used.
const LEAST_CORNERS: usize = 12;
/// Half the side of the pixels around a corner that are fitted, over a square's side.
const RADIUS: f64 = 0.45;
/// The same in pixels.
const RADIUS_PX: [f64; 2] = [3.2, 9.0];
/// Percent of pixels that may be darker or brighter than the detector's range.
const TAIL: f64 = 0.01;

/// A corner of the board and where it was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Column and row of the corner on the board; without offset where not all of the board
    /// is in view.
    pub node: [i32; 2],
    /// Where it is in the image.
    pub corner: Corner,
}

/// The board's corners in an image.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// The corners.
    pub seen: Vec<Seen>,
    /// Whether the board is in view along both sides, so that nodes are its own.
    pub whole: bool,
}

/// Finds the board in image number `index`.
///
/// # Errors
/// [`CameraError::NotFound`], [`CameraError::OtherBoard`].
pub fn find(image: &Grey, board: &Board, index: usize) -> Result<View, CameraError> {
    let bytes = stretched(image);
    let mut found = 0;
    for config in [DetectorConfig::chess(), DetectorConfig::chess_multiscale()] {
        let candidates = candidates(&bytes, image, config);
        let labels = label(&candidates);
        found = found.max(labels.len());
        if labels.len() < LEAST_CORNERS {
            continue;
        }
        let extent = |i: usize| labels.keys().map(|node| node[i]).max().unwrap_or(0) + 1;
        let extents = [extent(0), extent(1)];
        let [long, short] = sorted(board.corners());
        let [wide, narrow] = sorted(extents);
        if wide > long || narrow > short {
            return Err(CameraError::OtherBoard {
                index,
                found: [wide, narrow],
                stated: [long, short],
            });
        }
        // The board's columns run along its longer side where the sides differ.
        let turned = extents[0] > extents[1] && board.corners()[0] < board.corners()[1]
            || extents[0] < extents[1] && board.corners()[0] > board.corners()[1];
        let whole = [wide, narrow] == [long, short];
        let mut nodes: Vec<_> = labels.into_iter().collect();
        nodes.sort();
        let at = |node: [i32; 2]| {
            nodes
                .iter()
                .find(|(other, _)| *other == node)
                .map(|(_, index)| candidates[*index].at_px)
        };
        let mut seen = Vec::new();
        for (node, index) in &nodes {
            let candidate = candidates[*index];
            let mut shortest = f64::INFINITY;
            for (x, y) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                if let Some(other) = at([node[0] + x, node[1] + y]) {
                    shortest = shortest.min(other.distance(candidate.at_px));
                }
            }
            // Edges that run obliquely come closer to the next ones.
            let [a, b] = candidate.angles_rad;
            let radius = (RADIUS * shortest * (a - b).sin().abs()).min(RADIUS_PX[1]);
            if radius < RADIUS_PX[0] {
                continue;
            }
            let corner = refine(image, candidate.at_px, candidate.angles_rad, radius);
            if let Some(corner) = corner {
                // A quarter turn keeps the system right-handed.
                let node = match turned {
                    true => [node[1], extents[0] - 1 - node[0]],
                    false => *node,
                };
                seen.push(Seen { node, corner });
            }
        }
        if seen.len() >= LEAST_CORNERS {
            return Ok(View { seen, whole });
        }
    }
    Err(CameraError::NotFound { index, found })
}

fn sorted([a, b]: [i32; 2]) -> [i32; 2] {
    [a.max(b), a.min(b)]
}

/// The image in 8 bits between its dark and bright ends; what is invalid is in the middle.
fn stretched(image: &Grey) -> Vec<u8> {
    let valid = image.value.iter().zip(&image.valid);
    let mut values: Vec<f64> = valid.filter(|(_, ok)| **ok).map(|(v, _)| *v).collect();
    values.sort_by(f64::total_cmp);
    let end = |part: f64| {
        let index = (part * values.len() as f64) as usize;
        values.get(index.min(values.len().saturating_sub(1)))
    };
    let (Some(&dark), Some(&bright)) = (end(TAIL), end(1.0 - TAIL)) else {
        return vec![0; image.value.len()];
    };
    let range = (bright - dark).max(1e-30);
    let pixels = image.value.iter().zip(&image.valid);
    pixels
        .map(|(value, valid)| match valid {
            true => (255.0 * (value - dark) / range).clamp(0.0, 255.0) as u8,
            false => 128,
        })
        .collect()
}

fn candidates(bytes: &[u8], image: &Grey, config: DetectorConfig) -> Vec<Candidate> {
    let size = [image.width, image.height].map(|n| n as u32);
    let corners = Detector::new(config).and_then(|mut d| d.detect_u8(bytes, size[0], size[1]));
    let corners = corners.unwrap_or_default();
    let candidate = |c: chess_corners::CornerDescriptor| {
        let axes = c.axes?;
        Some(Candidate {
            // The library counts from the first pixel's middle.
            at_px: DVec2::new(f64::from(c.x), f64::from(c.y)) + 0.5,
            angles_rad: [f64::from(axes[0].angle), f64::from(axes[1].angle)],
            response: f64::from(c.response),
        })
    };
    corners.into_iter().filter_map(candidate).collect()
}
