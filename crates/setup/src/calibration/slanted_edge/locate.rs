//! Finding a straight edge in an image, and the pixels around it.

use glam::{DVec2, DVec3};

use super::{EdgeError, LEAST_SIDE_PX};
use crate::calibration::mirror_sphere::Grey;
use crate::calibration::white::Region;
use crate::statistics::median;
use crate::transport::Camera;

/// A straight edge and the pixels around it.
#[derive(Clone, Debug)]
pub struct Edge {
    /// Which image, from 0.
    pub image: usize,
    /// Height of the target above the sample's datum, millimetres.
    pub height_mm: f64,
    /// Its distance along the camera's axis, millimetres.
    pub depth_mm: f64,
    /// Pixels per millimetre across the view there.
    pub px_per_mm: f64,
    /// A point on the edge, pixels from the image's top left corner.
    pub point_px: DVec2,
    /// Unit vector across it, towards the brighter side.
    pub normal: DVec2,
    /// Distance from the edge up to which pixels count.
    pub reach_px: f64,
    /// Mean radiance of the darker and of the brighter side.
    pub levels: [f64; 2],
    /// The pixels.
    pub pixels: Vec<EdgePixel>,
}

/// One pixel near the edge.
#[derive(Clone, Copy, Debug)]
pub struct EdgePixel {
    /// Its middle, pixels from the image's top left corner.
    pub at_px: DVec2,
    /// Radiance.
    pub value: f64,
    /// Its variance.
    pub variance: f64,
}

impl Edge {
    /// Angle to the nearer of the image's axes, radians, 0 to π/4.
    pub fn tilt_rad(&self) -> f64 {
        let [a, b] = self.normal.abs().to_array();
        a.min(b).atan2(a.max(b))
    }
}

const TILT_DEG: std::ops::RangeInclusive<f64> = 2.0..=40.0;
const LEAST_PIXELS: usize = 200;
const LEAST_LENGTH_PX: f64 = 12.0;
const LEAST_CONTRAST: f64 = 0.2;
const LEAST_DEVIATIONS: f64 = 10.0;
const LEAST_STRAIGHT: f64 = 0.6;
const MOST_MASKED: f64 = 0.05;
/// Changes farther from the line than this do not pull at it.
const PULL_PX: f64 = 12.0;

/// Finds the edge in a region (all of the image where none is given) of the image with
/// number `image`, of a target at `height_mm` above the sample's datum and across the
/// camera's axis.
///
/// # Errors
/// See [`EdgeError`]: not one straight, contrasty, slightly tilted, unsaturated edge.
pub fn locate(
    image: usize,
    grey: &Grey,
    region: Option<Region>,
    camera: &Camera,
    height_mm: f64,
) -> Result<Edge, EdgeError> {
    // Image and region.
    let found = [grey.width, grey.height];
    if found != camera.resolution_px {
        let camera = camera.resolution_px;
        return Err(EdgeError::Size {
            image,
            found,
            camera,
        });
    }
    let size = [grey.width, grey.height];
    let region = region.unwrap_or_else(|| Region::whole(size));
    if !region.is_inside(size) || region.width.min(region.height) < LEAST_SIDE_PX {
        return Err(EdgeError::Region { image, region });
    }
    // The line, and the pixels near it.
    let changes = changes(grey, region);
    let line = line(&changes);
    let reach_px = (5.0 * line.width_px + 3.0).clamp(6.0, 24.0);
    let mut near = Vec::new();
    let (mut masked, mut sides) = (0usize, [[0.0f64; 2]; 2]);
    for y in region.y..region.y + region.height {
        for x in region.x..region.x + region.width {
            let at_px = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let t = (at_px - line.point).dot(line.normal);
            if t.abs() > reach_px {
                continue;
            }
            let pixel = y * grey.width + x;
            let (value, variance) = (grey.value[pixel], grey.variance[pixel]);
            if !grey.valid[pixel] || variance.is_nan() || variance <= 0.0 || !value.is_finite() {
                masked += 1;
                continue;
            }
            if t.abs() > 0.6 * reach_px {
                let side = &mut sides[usize::from(t > 0.0)];
                side[0] += value;
                side[1] += 1.0;
            }
            near.push(EdgePixel {
                at_px,
                value,
                variance,
            });
        }
    }
    // Whether there are enough.
    let length = near.len() as f64 / (2.0 * reach_px);
    let too_few = near.len() < LEAST_PIXELS || length < LEAST_LENGTH_PX;
    let part = masked as f64 / (near.len() + masked).max(1) as f64;
    if part > MOST_MASKED {
        let percent = 100.0 * part;
        return Err(EdgeError::Masked { image, percent });
    }
    if too_few || sides.iter().any(|side| side[1] < 20.0) {
        let pixels = near.len();
        return Err(EdgeError::TooFew {
            image,
            pixels,
            length,
        });
    }
    // Contrast, from the darker to the brighter side, and straightness.
    let mut levels = sides.map(|[sum, count]| sum / count);
    let mut normal = line.normal;
    if levels[0] > levels[1] {
        levels.swap(0, 1);
        normal = -normal;
    }
    let difference = levels[1] - levels[0];
    let contrast = difference / (0.5 * (levels[0] + levels[1])).abs();
    let noise2 = near.iter().map(|p| p.variance).sum::<f64>() / near.len() as f64;
    let deviations = difference / noise2.sqrt();
    if !(contrast >= LEAST_CONTRAST && deviations >= LEAST_DEVIATIONS) {
        return Err(EdgeError::Contrast {
            image,
            percent: 100.0 * contrast,
            deviations,
        });
    }
    if line.straight < LEAST_STRAIGHT {
        let percent = 100.0 * line.straight;
        return Err(EdgeError::NotStraight { image, percent });
    }
    // Depth, scale and tilt.
    let (depth_mm, px_per_mm) =
        scale(camera, line.point, height_mm).ok_or(EdgeError::Height { image, height_mm })?;
    let edge = Edge {
        image,
        height_mm,
        depth_mm,
        px_per_mm,
        point_px: line.point,
        normal,
        reach_px,
        levels,
        pixels: near,
    };
    let degrees = edge.tilt_rad().to_degrees();
    if !TILT_DEG.contains(&degrees) {
        return Err(EdgeError::Tilt { image, degrees });
    }
    Ok(edge)
}

/// Distance along the axis of the point that a sensor position sees at a height, and
/// pixels per millimetre across the view there.
fn scale(camera: &Camera, at_px: DVec2, height_mm: f64) -> Option<(f64, f64)> {
    let (origin, direction) = camera.chief_ray(at_px);
    let to_sample = &camera.sample_from_camera;
    let (from, along) = (to_sample.point(origin), to_sample.direction(direction));
    let t = (height_mm - from.z) / along.z;
    if !(t.is_finite() && t > 0.0) {
        return None;
    }
    let place = origin + direction * t;
    let here = camera.position_px(to_sample.point(place))?;
    let step_mm = 1e-3 * place.z.abs().max(1.0);
    let moved = |axis: DVec3| {
        let there = camera.position_px(to_sample.point(place + axis * step_mm))?;
        Some((there - here).length() / step_mm)
    };
    let px_per_mm = 0.5 * (moved(DVec3::X)? + moved(DVec3::Y)?);
    Some((place.z, px_per_mm))
}

/// The gradient of the image at a pixel, where it stands above the noise.
struct Change {
    at: DVec2,
    gradient: DVec2,
    weight: f64,
}

/// Sobel's gradient at every pixel of the region whose neighbours are all valid.
fn changes(grey: &Grey, region: Region) -> Vec<Change> {
    let mut changes = Vec::new();
    for y in region.y + 1..region.y + region.height - 1 {
        for x in region.x + 1..region.x + region.width - 1 {
            let mut gradient = DVec2::ZERO;
            let mut valid = true;
            for (dy, across) in [(0, 1.0), (1, 2.0), (2, 1.0)] {
                for (dx, down) in [(0, 1.0), (1, 2.0), (2, 1.0)] {
                    let pixel = (y + dy - 1) * grey.width + x + dx - 1;
                    let value = grey.value[pixel];
                    valid &= grey.valid[pixel];
                    gradient.x += across * (dx as f64 - 1.0) * value / 8.0;
                    gradient.y += down * (dy as f64 - 1.0) * value / 8.0;
                }
            }
            if valid {
                changes.push(Change {
                    at: DVec2::new(x as f64 + 0.5, y as f64 + 0.5),
                    gradient,
                    weight: gradient.length_squared(),
                });
            }
        }
    }
    // Most of the image is not edge: its gradients are the noise's.
    if let Some(noise) = median(changes.iter().map(|c| c.weight)) {
        for change in &mut changes {
            change.weight = (change.weight - 6.0 * noise).max(0.0);
        }
    }
    changes
}

struct Line {
    point: DVec2,
    normal: DVec2,
    /// Standard deviation of the changes about it, pixels.
    width_px: f64,
    /// Part of all changes near it.
    straight: f64,
}

/// The line along which the changes lie, by their directions first, then by their positions.
fn line(changes: &[Change]) -> Line {
    let total: f64 = changes.iter().map(|c| c.weight).sum();
    let tensor = |of: &dyn Fn(&Change) -> (f64, DVec2)| {
        let mut sum = [0.0; 3];
        for change in changes {
            let (weight, v) = of(change);
            sum[0] += weight * v.x * v.x;
            sum[1] += weight * v.x * v.y;
            sum[2] += weight * v.y * v.y;
        }
        // Direction of the greater eigenvector.
        DVec2::from_angle(0.5 * (2.0 * sum[1]).atan2(sum[0] - sum[2]))
    };
    let mut normal = tensor(&|c| (f64::from(u8::from(c.weight > 0.0)), c.gradient));
    let middle = |within: &dyn Fn(&Change) -> bool| {
        let near = changes.iter().filter(|c| within(c));
        let (sum, weight) = near.fold((DVec2::ZERO, 0.0), |(sum, weight), c| {
            (sum + c.at * c.weight, weight + c.weight)
        });
        (weight > 0.0).then(|| sum / weight)
    };
    let mut point = middle(&|_| true).unwrap_or_default();
    for _ in 0..6 {
        let (from, across) = (point, normal);
        let near = move |c: &Change| (c.at - from).dot(across).abs() < PULL_PX;
        let Some(centre) = middle(&near) else { break };
        let along = tensor(&|c| (if near(c) { c.weight } else { 0.0 }, c.at - centre));
        let turned = along.perp();
        point = centre;
        normal = if turned.dot(normal) < 0.0 {
            -turned
        } else {
            turned
        };
    }
    let distance = |c: &Change| (c.at - point).dot(normal);
    let near = |reach: f64| {
        changes
            .iter()
            .filter(move |c| distance(c).abs() < reach)
            .fold([0.0; 2], |[sum, sum2], c| {
                [sum + c.weight, sum2 + c.weight * distance(c).powi(2)]
            })
    };
    let [weight, square] = near(PULL_PX);
    let width_px = (square / weight.max(f64::MIN_POSITIVE)).sqrt();
    let [close, _] = near(3.0 * width_px.max(1.0));
    Line {
        point,
        normal,
        width_px,
        straight: close / total.max(f64::MIN_POSITIVE),
    }
}
