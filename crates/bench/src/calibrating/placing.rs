//! Whether a target lies before the camera as its calibration needs it, by one live frame.

use crate::calibration::camera::{Board, described, find};
use crate::calibration::mirror_sphere::outline::Stated;
use crate::calibration::mirror_sphere::{Grey, spheres_in};
use crate::calibration::slanted_edge::locate;
use crate::calibration::white::Region;
use crate::config::geometry::GeometryConfig;
use crate::device::RawFrame;
use crate::radiometry::mosaic::Mosaic;

/// What is put before the camera.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// A light that is even over the image.
    EvenLight,
    /// Equal glossy spheres.
    Spheres {
        /// Radius and height.
        stated: Stated,
        /// How many.
        count: usize,
    },
    /// A checkerboard.
    Board(Board),
    /// Slanted edges, one in each part of the image; none named: one edge in all of it.
    Edges(Vec<Region>),
    /// A white standard that fills this part of the image, or all of it.
    Standard(Option<Region>),
    /// A white card with a black trap in each of these parts of the image.
    Traps(Vec<Region>),
}

/// What was seen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Placing {
    /// Whether the calibration can use it.
    pub is_right: bool,
    /// In words.
    pub seen: String,
}

/// The dimmest part of an even light over its brightest.
const LEAST_EVENNESS: f64 = 0.5;
/// Likewise of a white standard.
const LEAST_EVENNESS_OF_STANDARD: f64 = 0.7;
/// What a trap shows over what the card does, at most.
const DARKEST: f64 = 0.1;
/// Part of the pixels that may be saturated.
const MOST_SATURATED: f64 = 0.01;
/// A frame whose mean is below this part of full scale is too dark.
const DARK: f64 = 0.02;
/// Blocks along each side whose means are compared.
const BLOCKS: usize = 8;

/// A frame in parts of full scale: the mean of each cell of a colour filter. The variance is
/// that of a usual sensor.
pub fn grey(frame: &RawFrame, bit_depth: u32, mosaic: Mosaic) -> Grey {
    let cell = if mosaic == Mosaic::None { 1 } else { 2 };
    let (wide, full) = (
        frame.width as usize,
        f64::from((1u32 << bit_depth.min(16)) - 1),
    );
    let [width, height] = [wide / cell, frame.height as usize / cell];
    let mut grey = Grey {
        width,
        height,
        value: Vec::with_capacity(width * height),
        variance: Vec::with_capacity(width * height),
        valid: Vec::with_capacity(width * height),
    };
    for pixel in 0..width * height {
        let (x, y) = (cell * (pixel % width), cell * (pixel / width));
        let counts =
            (0..cell * cell).map(|i| f64::from(frame.counts[(y + i / cell) * wide + x + i % cell]));
        let value = counts.clone().sum::<f64>() / (full * (cell * cell) as f64);
        grey.value.push(value);
        grey.variance.push(1e-4 * value + 1e-7);
        grey.valid
            .push(counts.into_iter().all(|count| count < full));
    }
    grey
}

/// Looks for the target in a frame, see [`grey`], of the camera of this geometry.
pub fn placing(target: &Target, image: &Grey, geometry: &GeometryConfig) -> Placing {
    let mean = image.value.iter().sum::<f64>() / image.value.len().max(1) as f64;
    if mean < DARK {
        return wrong("the live picture is dark: give it light, or a longer exposure");
    }
    let (camera, _) = described(geometry, [image.width, image.height]);
    let all = Region::whole([image.width, image.height]);
    match target {
        Target::EvenLight => even(image, all, LEAST_EVENNESS, "the light"),
        Target::Standard(region) => {
            let region = region.unwrap_or(all);
            even(image, region, LEAST_EVENNESS_OF_STANDARD, "the standard")
        }
        Target::Spheres { stated, count } => {
            match spheres_in(
                std::slice::from_ref(image),
                None,
                &camera,
                stated,
                &[],
                *count,
            ) {
                Ok(spheres) => {
                    let at = spheres.iter().map(|sphere| {
                        let circle = sphere.circle;
                        format!(
                            "({:.0}, {:.0}), radius {:.0} pixels",
                            circle.centre_px.x, circle.centre_px.y, circle.radius_px
                        )
                    });
                    right(format!(
                        "a sphere at {}",
                        at.collect::<Vec<_>>().join(" and one at ")
                    ))
                }
                Err(error) => wrong(error),
            }
        }
        Target::Board(board) => match find(image, board, 0) {
            Ok(view) if view.whole => {
                right(format!("the whole board, {} corners", view.seen.len()))
            }
            Ok(view) => right(format!("a part of the board, {} corners", view.seen.len())),
            Err(error) => wrong(error),
        },
        Target::Edges(regions) => {
            let regions: Vec<_> = match regions.is_empty() {
                true => vec![None],
                false => regions.iter().copied().map(Some).collect(),
            };
            let edges: Result<Vec<_>, _> = regions
                .into_iter()
                .map(|region| locate(0, image, region, &camera, 0.0))
                .collect();
            match edges {
                Ok(edges) => {
                    let tilts = edges
                        .iter()
                        .map(|edge| format!("{:.1}°", edge.tilt_rad().to_degrees()));
                    right(format!(
                        "edges tilted by {}",
                        tilts.collect::<Vec<_>>().join(", ")
                    ))
                }
                Err(error) => wrong(error),
            }
        }
        Target::Traps(traps) => dark_in(image, traps, mean),
    }
}

fn right(seen: String) -> Placing {
    Placing {
        is_right: true,
        seen,
    }
}

fn wrong(seen: impl ToString) -> Placing {
    Placing {
        is_right: false,
        seen: seen.to_string(),
    }
}

fn mean_in(image: &Grey, region: Region) -> f64 {
    let rows = region.y..region.y + region.height;
    let pixels =
        rows.flat_map(|y| (region.x..region.x + region.width).map(move |x| y * image.width + x));
    pixels.map(|pixel| image.value[pixel]).sum::<f64>() / (region.width * region.height) as f64
}

/// Whether a region has pixels, all of them in the image.
fn is_inside(image: &Grey, region: Region) -> bool {
    region.width.min(region.height) > 0 && region.is_inside([image.width, image.height])
}

/// Compares the means of blocks.
fn even(image: &Grey, region: Region, least: f64, what: &str) -> Placing {
    if !is_inside(image, region) {
        return wrong(format!(
            "the part is empty or not inside the {} x {} image",
            image.width, image.height
        ));
    }
    let blocks = [region.width, region.height].map(|side| BLOCKS.min(side));
    let (mut low, mut high) = (f64::INFINITY, 0.0f64);
    for block in 0..blocks[0] * blocks[1] {
        let [width, height] = [region.width / blocks[0], region.height / blocks[1]];
        let (column, row) = (block % blocks[0], block / blocks[0]);
        let block = Region {
            x: region.x + column * width,
            y: region.y + row * height,
            width,
            height,
        };
        let mean = mean_in(image, block);
        (low, high) = (low.min(mean), high.max(mean));
    }
    let saturated =
        image.valid.iter().filter(|valid| !**valid).count() as f64 / image.valid.len() as f64;
    let seen = format!(
        "{what}'s dimmest part has {:.0}% of its brightest, {:.1}% of the pixels are saturated",
        100.0 * low / high,
        100.0 * saturated
    );
    Placing {
        is_right: low >= least * high && saturated <= MOST_SATURATED,
        seen,
    }
}

fn dark_in(image: &Grey, traps: &[Region], mean: f64) -> Placing {
    if traps.is_empty() {
        return wrong("name the part of the image that is inside each trap");
    }
    if let Some(outside) = traps.iter().find(|trap| !is_inside(image, **trap)) {
        return wrong(format!(
            "the trap at ({}, {}) is not inside the {} x {} image",
            outside.x, outside.y, image.width, image.height
        ));
    }
    let shares = traps.iter().map(|trap| mean_in(image, *trap) / mean);
    let worst = shares.fold(0.0, f64::max);
    Placing {
        is_right: worst <= DARKEST,
        seen: format!(
            "the traps show at most {:.1}% of the card's light",
            100.0 * worst
        ),
    }
}
