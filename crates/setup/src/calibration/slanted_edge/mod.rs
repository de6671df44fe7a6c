//! How sharp the camera is: its point spread in focus, where that focus is, and how fast
//! points off it blur, from images of a straight edge at known heights (after the
//! slanted-edge method of ISO 12233, with the edge's profile fitted by a model).

#[cfg(feature = "figures")]
mod figure;
mod fit;
pub mod locate;
mod profile;
mod values;

#[cfg(feature = "figures")]
pub use figure::figure;
pub use fit::{EdgeFit, Fitted, Lens, fit_edges};
pub use locate::{Edge, locate};
pub use values::{FocusValues, LensValues, MeasuredEdge};

use super::mirror_sphere::Grey;
use super::white::Region;
use crate::shown::nth;
use crate::transport::Camera;

/// Edges at known heights, and the images that show them.
#[derive(Clone, Copy, Debug)]
pub struct FocusRequest<'a> {
    /// One image for all edges, or one for each.
    pub images: &'a [Grey],
    /// The part of its image in which each edge is: none (all of it), one for all, or one
    /// for each.
    pub regions: &'a [Region],
    /// Height of each edge above the sample's datum, millimetres.
    pub heights_mm: &'a [f64],
    /// Standard uncertainty that all heights share, millimetres.
    pub height_std_mm: f64,
    /// The camera as described.
    pub camera: &'a Camera,
    /// The sensor's pixels along one side of an image's pixel.
    pub cell_px: usize,
}

/// Measures point spread, focus and aperture from edges.
pub fn measure(request: &FocusRequest) -> Result<(Vec<Edge>, Fitted, FocusValues), EdgeError> {
    let &FocusRequest {
        images,
        regions,
        heights_mm,
        camera,
        ..
    } = request;
    check_counts(images.len(), regions.len(), heights_mm.len())?;
    let edge = |(i, &height_mm): (usize, &f64)| {
        let image = i.min(images.len() - 1);
        let region = regions.get(i).or(regions.first()).copied();
        locate(image, &images[image], region, camera, height_mm)
    };
    let edges: Vec<Edge> = heights_mm
        .iter()
        .enumerate()
        .map(edge)
        .collect::<Result<_, _>>()?;
    let tangent = camera.object_na / (1.0 - camera.object_na.powi(2)).sqrt();
    let stated = Lens {
        spread_px2: 0.25,
        focus_mm: camera.focus_mm,
        tangent2: tangent * tangent,
    };
    let found = fit_edges(&edges, stated)?;
    let values = FocusValues::new(&edges, &found, request.cell_px, request.height_std_mm);
    Ok((edges, found, values))
}

/// Whether so many images and regions can show edges at so many heights.
///
/// # Errors
/// [`EdgeError::Counts`], [`EdgeError::OneImage`].
pub fn check_counts(images: usize, regions: usize, heights: usize) -> Result<(), EdgeError> {
    let serve = |n: usize| n == 1 || n == heights;
    if !serve(images) || !(serve(regions) || regions == 0) {
        return Err(EdgeError::Counts {
            images,
            regions,
            heights,
        });
    }
    if images == 1 && heights > 1 && regions != heights {
        return Err(EdgeError::OneImage { heights });
    }
    Ok(())
}

/// Why images of edges do not determine the lens. Images count from 0.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum EdgeError {
    #[error("{images} images and {regions} regions were named for {heights} heights")]
    Counts {
        images: usize,
        regions: usize,
        heights: usize,
    },
    #[error("one image cannot show {heights} heights at the same position")]
    OneImage { heights: usize },
    #[error("{image} has {} x {} pixels, the camera {} x {}", found[0], found[1], camera[0], camera[1], image = nth("image", *image))]
    Size {
        image: usize,
        /// Its width and height.
        found: [usize; 2],
        camera: [usize; 2],
    },
    #[error(
        "the region of {width} x {height} pixels at ({x}, {y}) is not inside {image} or has less than {LEAST_SIDE_PX} pixels on a side", width = .region.width, height = .region.height, x = .region.x, y = .region.y, image = nth("image", *image)
    )]
    Region { image: usize, region: Region },
    /// No edge stands out.
    #[error(
        "no edge in {image}: its sides differ by {percent:.1}% of their mean, {deviations:.1} standard deviations of a pixel", image = nth("image", *image)
    )]
    Contrast {
        image: usize,
        percent: f64,
        deviations: f64,
    },
    /// More than one edge, or a curved one.
    #[error(
        "{image} does not show one straight edge: {percent:.0}% of its changes lie along the best line", image = nth("image", *image)
    )]
    NotStraight {
        image: usize,
        /// Part of the squared gradient near the line.
        percent: f64,
    },
    /// The edge runs along the pixels, or diagonally.
    #[error(
        "the edge in {image} is tilted by {degrees:.1} degrees against the pixels' rows or columns", image = nth("image", *image)
    )]
    Tilt { image: usize, degrees: f64 },
    #[error(
        "{pixels} usable pixels along {length:.0} pixels of the edge in {image}: too few", image = nth("image", *image)
    )]
    TooFew {
        image: usize,
        pixels: usize,
        length: f64,
    },
    #[error("{percent:.0}% of the pixels near the edge in {image} are masked or saturated", image = nth("image", *image))]
    Masked { image: usize, percent: f64 },
    /// The camera does not see a target at that height.
    #[error("{image}: the camera sees nothing at a height of {height_mm} mm", image = nth("image", *image))]
    Height { image: usize, height_mm: f64 },
    /// The iteration does not settle, or the data determine nothing.
    #[error("the edges' profiles could not be fitted: {0}")]
    Unfitted(&'static str),
    /// Focus and aperture are not determined.
    #[error(
        "the edges are as sharp at {nearest_mm:.2} mm from the camera as at {farthest_mm:.2} mm, or the blur between does not follow a lens"
    )]
    NoDefocus { nearest_mm: f64, farthest_mm: f64 },
    /// The model is far from what the images show.
    #[error(
        "the edges differ from a blurred straight edge by {deviations:.1} times their noise (root mean square), {percent:.1}% of their contrast"
    )]
    NotTheModel { deviations: f64, percent: f64 },
}

/// Least width and height of the region that is searched.
pub const LEAST_SIDE_PX: usize = 16;

#[cfg(test)]
mod tests;
