//! Where lights are, from their highlights on mirror spheres: the sphere's outline and
//! each highlight are found in the image, and a ray mirrored at the sphere points to the
//! light. With two spheres two such rays meet at the lamp.

mod clipped;
pub(super) mod gauss;
pub mod highlight;
pub mod light;
pub mod lights;
pub mod outline;
pub mod search;

use glam::{DVec2, DVec3};
use image::DynamicImage;
use nalgebra::{Matrix3, Vector3};

use self::light::{Distance, FoundLight};
use self::outline::Stated;
use super::record::Measured;
use crate::radiance_image::RadianceImage;
use crate::shown::nth;
use crate::transport::{Camera, Projection};

/// Why an image of a mirror sphere does not determine the light. Pixels count from the
/// top left corner.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum SphereError {
    /// Sphere or camera for which nothing can be found.
    #[error("{what} is {value}, but must be {allowed}")]
    Impossible {
        what: &'static str,
        value: String,
        allowed: &'static str,
    },
    #[error("an image has {} x {} pixels, the camera {} x {}", found[0], found[1], camera[0], camera[1])]
    Size {
        /// Width and height of the image.
        found: [usize; 2],
        /// Width and height that the camera has.
        camera: [usize; 2],
    },
    #[error(
        "no outline of a sphere of {radius_mm} mm ({radius_px:.1} pixels) in the image: its best circle is visible along {percent:.0}% of its way"
    )]
    NoOutline {
        radius_mm: f64,
        radius_px: f64,
        /// Part of the best circle along which the image has an edge.
        percent: f64,
    },
    /// A part of the sphere is not in the image.
    #[error(
        "the sphere at ({x:.0}, {y:.0}) with a radius of {radius_px:.0} pixels lies outside the view or reaches over its edge"
    )]
    OutsideView { x: f64, y: f64, radius_px: f64 },
    /// The outline is too faint or too irregular.
    #[error("the outline at ({x:.0}, {y:.0}) could not be fitted: {why}")]
    Unfitted { x: f64, y: f64, why: String },
    #[error(
        "the outline has a radius of {found_mm:.4} ± {std_mm:.4} mm by the camera's scale, the sphere {stated_mm}"
    )]
    Radius {
        found_mm: f64,
        std_mm: f64,
        stated_mm: f64,
    },
    /// Nothing stands out.
    #[error(
        "no highlight on the sphere at ({x:.0}, {y:.0}) in {image}: its brightest spot stands {contrast:.1} times above its surroundings, {deviations:.0} standard deviations", image = nth("image", *image)
    )]
    NoHighlight {
        /// Which image, from 0.
        image: usize,
        x: f64,
        y: f64,
        contrast: f64,
        deviations: f64,
    },
    /// Too many pixels of the highlight are clipped, or not those of its core.
    #[error(
        "the highlight at ({x:.0}, {y:.0}) in {image} is saturated or masked in {pixels} of its pixels, more than a round core", image = nth("image", *image)
    )]
    Saturated {
        /// Which image, from 0.
        image: usize,
        x: f64,
        y: f64,
        pixels: usize,
    },
    /// More than one lamp, or a window that is mirrored.
    #[error(
        "two highlights on one sphere in {image}: at ({:.1}, {:.1}) and at ({:.1}, {:.1}), the second with {percent:.0}% of the first's light", .first[0], .first[1], .second[0], .second[1], image = nth("image", *image)
    )]
    TwoHighlights {
        /// Which image, from 0.
        image: usize,
        /// Column and row of the brighter one.
        first: [f64; 2],
        /// Column and row of the other one.
        second: [f64; 2],
        /// Light of the second over that of the first.
        percent: f64,
    },
    #[error(
        "the two spheres' highlights in {image} do not belong to one lamp: their rays miss each other by {deviations:.1} standard deviations", image = nth("image", *image)
    )]
    NotOneLamp {
        /// Which image, from 0.
        image: usize,
        deviations: f64,
    },
}

/// One number per pixel with its variance: the light of all channels together.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Grey {
    pub width: usize,
    pub height: usize,
    /// Radiance.
    pub value: Vec<f64>,
    pub variance: Vec<f64>,
    /// Whether the pixel was measured.
    pub valid: Vec<bool>,
}

impl Grey {
    /// The sum of an image's channels.
    pub fn of(image: &RadianceImage) -> Self {
        let sum = |rgb: &[f32; 3]| rgb.iter().map(|&v| f64::from(v)).sum();
        Self {
            width: image.width,
            height: image.height,
            value: image.mean.iter().map(sum).collect(),
            variance: image.variance.iter().map(sum).collect(),
            valid: image.valid.clone(),
        }
    }

    /// A picture's luminance, 0 to 1, without noise.
    pub fn of_picture(picture: &DynamicImage) -> Self {
        let luma = picture.to_luma32f();
        let value: Vec<f64> = luma.as_raw().iter().map(|v| f64::from(*v)).collect();
        Self {
            width: luma.width() as usize,
            height: luma.height() as usize,
            variance: vec![0.0; value.len()],
            valid: vec![true; value.len()],
            value,
        }
    }

    /// Middle of a pixel, from the top left corner.
    fn position(&self, pixel: usize) -> DVec2 {
        DVec2::new(
            (pixel % self.width) as f64 + 0.5,
            (pixel / self.width) as f64 + 0.5,
        )
    }

    /// The mean of images of one size; what is invalid in one is left out of the mean,
    /// and invalid where it is so in all. `None` without images or if sizes differ.
    pub fn mean(images: &[Grey]) -> Option<Self> {
        let first = images.first()?;
        if images
            .iter()
            .any(|i| (i.width, i.height) != (first.width, first.height))
        {
            return None;
        }
        let mut mean = first.clone();
        for pixel in 0..mean.value.len() {
            let valid = images.iter().filter(|image| image.valid[pixel]);
            let count = valid.clone().count();
            let n = count.max(1) as f64;
            mean.value[pixel] = valid.clone().map(|i| i.value[pixel]).sum::<f64>() / n;
            mean.variance[pixel] = valid.map(|i| i.variance[pixel]).sum::<f64>() / (n * n);
            mean.valid[pixel] = count > 0;
        }
        Some(mean)
    }
}

/// A sphere found from its outline in the image, in the camera's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Sphere {
    /// Middle, millimetres. A telecentric camera doesn't see its z, which is as stated.
    pub centre_mm: DVec3,
    /// Radius that belongs to the outline, millimetres: measured by a telecentric camera,
    /// the stated one where the distance was found from it.
    pub radius_mm: f64,
    /// Covariance of x, y and radius (telecentric) or x, y, z (perspective), mm².
    pub covariance: Matrix3<f64>,
    /// Standard deviation of the image's blur, the pixel's own extent included, pixels.
    pub blur_px: f64,
    /// Where the outline is in the image, roughly: middle and radius, pixels.
    pub circle: Circle,
}

/// A circle in the image, pixels from the top left corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    /// Its middle.
    pub centre_px: DVec2,
    /// Its radius.
    pub radius_px: f64,
}

impl Sphere {
    /// The sphere with its three measured numbers changed by `delta`, millimetres.
    fn shifted(&self, camera: &Camera, delta: Vector3<f64>) -> (DVec3, f64) {
        match camera.projection {
            Projection::Orthographic { .. } => (
                self.centre_mm + DVec3::new(delta.x, delta.y, 0.0),
                self.radius_mm + delta.z,
            ),
            Projection::Perspective { .. } => (
                self.centre_mm + DVec3::new(delta.x, delta.y, delta.z),
                self.radius_mm,
            ),
        }
    }
}

/// Millimetres that one pixel spans at a point of the camera's frame.
fn mm_per_px(camera: &Camera, point_mm: DVec3) -> f64 {
    camera.field_at_depth_mm(point_mm.z).x / camera.resolution_px[0] as f64
}

/// Where a point of the camera's frame is in the image, pixels from the top left corner;
/// not a number behind the camera.
fn project(camera: &Camera, point_mm: DVec3) -> DVec2 {
    camera.position_of_px(point_mm).unwrap_or(DVec2::NAN)
}

/// The spheres in images of one scene under several lights: near the given circles, else
/// searched for. Their outlines are fitted in `outline` where it is given, else in the
/// images themselves, each around the side that its light shines on.
pub fn spheres_in(
    images: &[Grey],
    outline: Option<&Grey>,
    camera: &Camera,
    stated: &Stated,
    near: &[Circle],
    count: usize,
) -> Result<Vec<Sphere>, SphereError> {
    let impossible = |what, value: f64, allowed| SphereError::Impossible {
        what,
        value: value.to_string(),
        allowed,
    };
    if !(1e-3..=1e4).contains(&stated.radius_mm) {
        let allowed = "from 0.001 to 10000 mm";
        return Err(impossible("the sphere's radius", stated.radius_mm, allowed));
    }
    for image in images.iter().chain(outline) {
        of_camera(image, camera)?;
    }
    let mean = Grey::mean(images);
    let Some(image) = outline.or(mean.as_ref()) else {
        return Err(impossible("the number of images", 0.0, "at least 1"));
    };
    let expected_px = outline::expected_radius_px(camera, stated);
    if expected_px < LEAST_RADIUS_PX {
        let allowed = "at least 10 pixels in the image";
        return Err(impossible("the sphere's radius", expected_px, allowed));
    }
    let circles = match near {
        [] => {
            let range = match camera.projection {
                Projection::Orthographic { .. } => [0.95, 1.05],
                Projection::Perspective { .. } => [0.8, 1.25],
            };
            search::circles(image, expected_px, range, stated.radius_mm, count)?
        }
        near if near.len() == count => near.to_vec(),
        near => {
            let allowed = "given for every sphere or for none";
            return Err(impossible(
                "the number of circles",
                near.len() as f64,
                allowed,
            ));
        }
    };
    let fit = |circle: &Circle| {
        let rough = outline::fit(image, camera, stated, circle)?;
        match outline {
            Some(_) => Ok(rough),
            None => {
                let lit = lit_limb(images, &rough.circle);
                outline::fit(&lit, camera, stated, &rough.circle)
            }
        }
    };
    circles.iter().map(fit).collect()
}

fn of_camera(image: &Grey, camera: &Camera) -> Result<(), SphereError> {
    let found = [image.width, image.height];
    if found == camera.resolution_px {
        return Ok(());
    }
    Err(SphereError::Size {
        found,
        camera: camera.resolution_px,
    })
}

/// The sum of the images, each weighted around the sphere by the squared cosine of the
/// azimuth from its highlight, 0 on the far side: so that no edge of a light's own shadow
/// is near the limb. Lights from nearly straight above have no such side and are left out;
/// where fewer than three others remain, the sum is plain.
fn lit_limb(images: &[Grey], circle: &Circle) -> Grey {
    let mut sum = images[0].clone();
    sum.value.fill(0.0);
    sum.variance.fill(0.0);
    sum.valid.fill(true);
    let sides: Vec<Option<DVec2>> = images
        .iter()
        .map(|image| {
            let offset = highlight::brightest_on(image, circle)? - circle.centre_px;
            (offset.length() > LEAST_OFFSET * circle.radius_px).then(|| offset.normalize())
        })
        .collect();
    let plain = sides.iter().flatten().count() < 3;
    for (image, side) in images.iter().zip(&sides) {
        for pixel in 0..sum.value.len() {
            let place = image.position(pixel) - circle.centre_px;
            let weight = match side {
                _ if plain => 1.0,
                None => continue,
                Some(side) => place.normalize_or_zero().dot(*side).max(0.0).powi(2),
            };
            if weight > 0.0 {
                sum.value[pixel] += weight * image.value[pixel];
                sum.variance[pixel] += weight * weight * image.variance[pixel];
                sum.valid[pixel] &= image.valid[pixel];
            }
        }
    }
    sum
}

/// Highlights nearer to the sphere's middle than this part of its radius hardly depend on
/// the side from which the light comes.
const LEAST_OFFSET: f64 = 0.03;

/// Smaller spheres do not give a tenth of a degree.
const LEAST_RADIUS_PX: f64 = 10.0;
/// A stated distance is taken as known within this part of it.
const STATED_DISTANCE_STD: f64 = 0.02;

/// Every image's light, and the lamp's distance where two spheres determine it. `stated_mm`:
/// the distance that is assumed with a single sphere, `None` for parallel light.
pub fn locate_all(
    camera: &Camera,
    spheres: &[Sphere],
    images: &[Grey],
    reference_mm: DVec3,
    stated_mm: &[Option<f64>],
) -> Result<(Vec<FoundLight>, Option<Measured>), SphereError> {
    let mut highlights = Vec::new();
    for (index, image) in images.iter().enumerate() {
        of_camera(image, camera)?;
        let of_image: Result<Vec<_>, _> = spheres
            .iter()
            .map(|sphere| highlight::find(image, sphere, index))
            .collect();
        highlights.push(of_image?);
    }
    let all = |distance: &dyn Fn(usize) -> Distance| -> Result<Vec<FoundLight>, SphereError> {
        let each = highlights.iter().enumerate().map(|(index, highlights)| {
            let distance = distance(index);
            light::locate(camera, spheres, highlights, reference_mm, distance, index)
        });
        each.collect()
    };
    let by_stated = |index: usize| match stated_mm.get(index).copied().flatten() {
        Some(mm) => Distance::Stated(mm, STATED_DISTANCE_STD * mm),
        None => Distance::Infinite,
    };
    if spheres.len() < 2 {
        return Ok((all(&by_stated)?, None));
    }
    let free = all(&|_| Distance::Unknown)?;
    let weights = free.iter().map(|f| f.inverse_distance[1].powi(-2));
    let inverse = free
        .iter()
        .map(|f| f.inverse_distance[0] * f.inverse_distance[1].powi(-2))
        .sum::<f64>()
        / weights.sum::<f64>();
    // Errors of the spheres' positions are common to all lights: no better than one light's.
    let squares = free.iter().map(|f| f.inverse_distance[1].powi(2));
    let std = (squares.sum::<f64>() / free.len().max(1) as f64).sqrt();
    let moves = stated_mm.iter().flatten().count() == stated_mm.len()
        && stated_mm.windows(2).any(|pair| pair[0] != pair[1]);
    if inverse < 5.0 * std || moves {
        // Too far to be determined, or another distance for every light.
        return Ok((all(&by_stated)?, None));
    }
    let distance = Measured::new(1.0 / inverse, std / (inverse * inverse));
    let found = all(&|_| Distance::Stated(distance.value, distance.std))?;
    Ok((found, Some(distance)))
}

#[cfg(test)]
mod tests;
