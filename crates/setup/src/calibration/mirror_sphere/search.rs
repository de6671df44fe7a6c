//! Roughly where spheres are: circles of about the expected size, for which the
//! directions of the image's edges vote (Hough transform).

use glam::DVec2;

use super::{Circle, Grey, SphereError};
use crate::statistics::order_statistic;

/// Images are searched at about this size at most, pixels.
const SEARCH_PX: usize = 480;
/// Radii tried over the expected one, relative.
const STEP: f64 = 0.02;
/// Part of a circle along which there must be an edge.
const LEAST_VISIBLE: f64 = 0.35;

/// The `count` best circles with radii from `low` to `high` times `expected_px`, from left
/// to right, that do not overlap by more than a third of their radius.
///
/// # Errors
/// Fewer circles are visible along a third of their way, or one reaches out of the image.
pub fn circles(
    image: &Grey,
    expected_px: f64,
    [low, high]: [f64; 2],
    radius_mm: f64,
    count: usize,
) -> Result<Vec<Circle>, SphereError> {
    let scale = (image.width.max(image.height)).div_ceil(SEARCH_PX).max(1);
    let scale = scale.min((expected_px / 8.0).max(1.0) as usize);
    let small = reduced(image, scale);
    let edges = edges(&small);
    let mut best: Vec<(f64, Circle)> = Vec::new();
    let steps = ((high / low).ln() / STEP).ceil().max(1.0) as usize;
    for step in 0..=steps {
        let part = step as f64 / steps as f64;
        let radius_px = expected_px * low * (high / low).powf(part) / scale as f64;
        best.extend(peaks(&small, &edges, radius_px, 2 * count));
    }
    best.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<(f64, Circle)> = Vec::new();
    for (score, circle) in best {
        let apart = |other: &(f64, Circle)| {
            let distance = other.1.centre_px.distance(circle.centre_px);
            distance > 1.3 * other.1.radius_px.max(circle.radius_px)
        };
        if kept.len() < count && kept.iter().all(apart) {
            kept.push((score, circle));
        }
    }
    let worst = kept.get(count.max(1) - 1).map_or(0.0, |k| k.0);
    if worst < LEAST_VISIBLE {
        return Err(SphereError::NoOutline {
            radius_mm,
            radius_px: expected_px,
            percent: 100.0 * worst,
        });
    }
    let mut found: Vec<Circle> = kept
        .into_iter()
        .map(|(_, circle)| Circle {
            centre_px: circle.centre_px * scale as f64,
            radius_px: circle.radius_px * scale as f64,
        })
        .collect();
    found.sort_by(|a, b| a.centre_px.x.total_cmp(&b.centre_px.x));
    for circle in &found {
        inside(circle, image)?;
    }
    Ok(found)
}

/// Refuses a circle that reaches out of the image.
pub fn inside(circle: &Circle, image: &Grey) -> Result<(), SphereError> {
    let size = DVec2::new(image.width as f64, image.height as f64);
    let margin = DVec2::splat(circle.radius_px + 1.5);
    let low = (circle.centre_px - margin).min_element();
    let high = (size - circle.centre_px - margin).min_element();
    if low >= 0.0 && high >= 0.0 {
        return Ok(());
    }
    Err(SphereError::OutsideView {
        x: circle.centre_px.x,
        y: circle.centre_px.y,
        radius_px: circle.radius_px,
    })
}

/// Cube roots, so that highlights do not hide the rest, of means over squares.
struct Small {
    width: usize,
    height: usize,
    value: Vec<f64>,
}

fn reduced(image: &Grey, scale: usize) -> Small {
    let (width, height) = (image.width / scale, image.height / scale);
    let mut value = Vec::with_capacity(width * height);
    for row in 0..height {
        for column in 0..width {
            let (mut sum, mut n) = (0.0, 0.0);
            for y in row * scale..(row + 1) * scale {
                for x in column * scale..(column + 1) * scale {
                    let pixel = y * image.width + x;
                    if image.valid[pixel] {
                        sum += image.value[pixel];
                        n += 1.0;
                    }
                }
            }
            value.push(if n > 0.0 { (sum / n).cbrt() } else { 0.0 });
        }
    }
    Small {
        width,
        height,
        value,
    }
}

/// Pixels with a clear gradient: middle and unit direction.
fn edges(image: &Small) -> Vec<(DVec2, DVec2)> {
    let at = |x: usize, y: usize| image.value[y * image.width + x];
    let mut gradients = Vec::new();
    for y in 1..image.height.saturating_sub(1) {
        for x in 1..image.width.saturating_sub(1) {
            // Sobel's operator.
            let across = |y: usize| at(x + 1, y) - at(x - 1, y);
            let down = |x: usize| at(x, y + 1) - at(x, y - 1);
            let gradient = DVec2::new(
                across(y - 1) + 2.0 * across(y) + across(y + 1),
                down(x - 1) + 2.0 * down(x) + down(x + 1),
            );
            let middle = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            gradients.push((middle, gradient));
        }
    }
    let strength =
        |p: f64| order_statistic(gradients.iter().map(|g| g.1.length()), p).unwrap_or(0.0);
    // Above the noise of the even half of the image, and no more than a tenth of it.
    let least = (3.0 * strength(0.5)).max(0.2 * strength(0.97)).max(1e-12);
    gradients
        .into_iter()
        .filter(|(_, gradient)| gradient.length() >= least)
        .map(|(middle, gradient)| (middle, gradient.normalize()))
        .collect()
}

/// The centres with most votes for one radius, each with the part of its circle that voted.
fn peaks(
    image: &Small,
    edges: &[(DVec2, DVec2)],
    radius_px: f64,
    count: usize,
) -> Vec<(f64, Circle)> {
    // Circles may be centred outside of the image: they are refused by name later.
    let pad = radius_px.ceil() as usize + 2;
    let (width, height) = (image.width + 2 * pad, image.height + 2 * pad);
    let mut votes = vec![0f32; width * height];
    for (middle, direction) in edges {
        for sign in [-1.0, 1.0] {
            let vote = *middle + *direction * (sign * radius_px) + DVec2::splat(pad as f64);
            let (x, y) = (vote.x.floor(), vote.y.floor());
            if x >= 1.0 && y >= 1.0 && x < (width - 1) as f64 && y < (height - 1) as f64 {
                votes[y as usize * width + x as usize] += 1.0;
            }
        }
    }
    let mut found = Vec::new();
    let mut sums = vec![0f32; width * height];
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let mut sum = 0.0;
            for row in y - 1..=y + 1 {
                for column in x - 1..=x + 1 {
                    sum += votes[row * width + column];
                }
            }
            sums[y * width + x] = sum;
        }
    }
    for _ in 0..count {
        let Some((peak, &most)) = sums.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)) else {
            break;
        };
        let centre = DVec2::new((peak % width) as f64, (peak / width) as f64)
            + DVec2::splat(0.5 - pad as f64);
        // An edge is about two pixels wide.
        let visible = f64::from(most) / (2.0 * std::f64::consts::TAU * radius_px);
        found.push((
            visible.min(1.0),
            Circle {
                centre_px: centre,
                radius_px,
            },
        ));
        let far = radius_px as isize;
        let (px, py) = ((peak % width) as isize, (peak / width) as isize);
        for y in (py - far).max(0)..=(py + far).min(height as isize - 1) {
            for x in (px - far).max(0)..=(px + far).min(width as isize - 1) {
                sums[y as usize * width + x as usize] = 0.0;
            }
        }
    }
    found
}
