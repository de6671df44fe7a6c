//! Whether the depth of field covers the sample: the defocus blur over the sample in view.

use std::fmt;

use glam::DVec2;

use super::slanted_edge::FocusValues;
use crate::config::BuildError;
use crate::config::RigConfig;
use crate::transport::{Camera, Scene};

/// Blur at a point of the sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blur {
    /// Height above the sample's datum, millimetres.
    pub height_mm: f64,
    /// Diameter of the disc into which the lens blurs a point there, pixels.
    pub disc_px: f64,
}

/// What the camera sees of the sample, by its sharpness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthOfField {
    /// At the lowest and the highest point in view.
    pub ends: [Blur; 2],
    /// At the most blurred point.
    pub worst: Blur,
    /// Part of the points in view that are blurred by more than the limit.
    pub beyond: f64,
    /// Heights between which nothing is blurred by more, on the camera's axis; `None` where the lens has
    /// no aperture.
    pub sharp_mm: Option<[f64; 2]>,
}

impl DepthOfField {
    /// How much of the sample is blurred by more than the limit.
    pub fn concern(&self, limit_px: f64) -> String {
        let sharp = self.sharp_mm.map_or(String::new(), |[low, high]| {
            format!("; only heights from {low:.2} to {high:.2} mm are blurred by less")
        });
        let percent = 100.0 * self.beyond;
        format!("{self}, which is above {limit_px} px on {percent:.0}% of it{sharp}")
    }
}

impl fmt::Display for DepthOfField {
    /// The blur at both ends of the sample's depth.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [low, high] = self.ends;
        // Before a tilted camera the nearest and farthest point are neither the lowest nor the
        // highest.
        let elsewhere = match self.worst.disc_px > 1.05 * low.disc_px.max(high.disc_px) {
            true => format!(", and by up to {:.2} px elsewhere", self.worst.disc_px),
            false => String::new(),
        };
        write!(
            out,
            "the sample is blurred by {:.2} px at {:.2} mm and by {:.2} px at {:.2} mm{elsewhere}",
            low.disc_px, low.height_mm, high.disc_px, high.height_mm
        )
    }
}

/// Points sampled along the longer side of the image.
const POINTS: usize = 96;

/// The blur of a rig's sample, with its record of focus where there is one. `None` where
/// no aperture is known or the camera does not see the sample.
///
/// # Errors
/// The rig file's scene cannot be built.
pub fn of_rig(
    rig: &RigConfig,
    focus: Option<&FocusValues>,
) -> Result<Option<DepthOfField>, BuildError> {
    let mut geometry = rig.geometry.clone();
    if let Some(focus) = focus {
        focus.apply(&mut geometry);
    }
    if geometry.camera.object_na <= 0.0 {
        return Ok(None);
    }
    let scene = geometry.scene(&[])?;
    Ok(over_sample(&scene, rig.capture.blur_limit_px))
}

/// The blur at points of the sample through the middles of a grid of pixels. `None` where
/// the camera does not see it.
pub fn over_sample(scene: &Scene, limit_px: f64) -> Option<DepthOfField> {
    let camera = &scene.camera;
    let [width, height] = camera.resolution_px;
    let step = width.max(height).div_ceil(POINTS);
    let mut seen: Vec<Blur> = Vec::new();
    for y in (0..height).step_by(step) {
        for x in (0..width).step_by(step) {
            let at = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let ray = camera.ray(at, DVec2::ZERO);
            let Some((surface, _)) = scene.first(&ray).filter(|(s, _)| s.is_sample()) else {
                continue;
            };
            let point = surface.origin_mm.as_dvec3();
            let depth_mm = camera.sample_from_camera.inverse().point(point).z;
            seen.push(Blur {
                height_mm: point.z,
                disc_px: 2.0 * camera.defocus_mm(depth_mm) * px_per_mm(camera, at, depth_mm),
            });
        }
    }
    let first = *seen.first()?;
    let most = |of: &dyn Fn(&Blur) -> f64| {
        seen.iter()
            .fold(first, |best, b| if of(b) > of(&best) { *b } else { best })
    };
    let beyond = seen.iter().filter(|b| b.disc_px > limit_px).count();
    Some(DepthOfField {
        ends: [most(&|b| -b.height_mm), most(&|b| b.height_mm)],
        worst: most(&|b| b.disc_px),
        beyond: beyond as f64 / seen.len() as f64,
        sharp_mm: heights_mm(camera, limit_px),
    })
}

/// Heights above the sample's datum, on the camera's axis, between which the disc of a
/// point is narrower than `limit_px`; `None` without an aperture or where the camera looks
/// along the datum's plane.
pub fn heights_mm(camera: &Camera, limit_px: f64) -> Option<[f64; 2]> {
    let [width, height] = camera.resolution_px.map(|n| n as f64);
    let middle = DVec2::new(0.5 * width, 0.5 * height);
    let blur =
        |depth_mm: f64| 2.0 * camera.defocus_mm(depth_mm) * px_per_mm(camera, middle, depth_mm);
    let (origin, direction) = camera.chief_ray(middle);
    let to_sample = &camera.sample_from_camera;
    let (from, along) = (to_sample.point(origin), to_sample.direction(direction));
    if camera.object_na <= 0.0 || along.z.abs() < 1e-6 {
        return None;
    }
    // Bisection on each side of the focus, where the disc is a point.
    let end = |far_mm: f64| {
        let (mut sharp, mut blurred) = (camera.focus_mm, far_mm);
        for _ in 0..60 {
            let middle = 0.5 * (sharp + blurred);
            if blur(middle) < limit_px {
                sharp = middle;
            } else {
                blurred = middle;
            }
        }
        from.z + along.z * sharp / direction.z
    };
    let mut ends = [end(1e-3 * camera.focus_mm), end(3.0 * camera.focus_mm)];
    ends.sort_by(f64::total_cmp);
    Some(ends)
}

/// Pixels per millimetre across the view at a depth.
fn px_per_mm(camera: &Camera, at_px: DVec2, depth_mm: f64) -> f64 {
    let place = |at: DVec2| {
        let (origin, direction) = camera.chief_ray(at);
        origin + direction * ((depth_mm - origin.z) / direction.z)
    };
    1.0 / place(at_px + DVec2::X).distance(place(at_px))
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::geometry::Shape;
    use crate::transport::Shading;

    fn scene(object_na: f64, focus_mm: f64) -> Scene {
        let mut camera = Camera::above([100, 100], DVec2::splat(20.0), 200.0);
        camera.object_na = object_na;
        camera.focus_mm = focus_mm;
        let bowl = Shape::Bowl {
            radius_mm: 8.0,
            segments: 128,
        };
        Scene::new(bowl.mesh().unwrap(), Shading::Flat, camera, Vec::new())
    }

    /// A bowl 8 mm deep under five pixels per millimetre, by hand.
    #[test]
    fn the_bottom_of_a_bowl_is_out_of_focus() {
        let tangent = 0.05 / (1.0f64 - 0.05 * 0.05).sqrt();
        let found = over_sample(&scene(0.05, 200.0), 1.0).unwrap();
        let [low, high] = found.ends;
        assert!((low.height_mm + 8.0).abs() < 0.05, "{low:?}");
        assert!(high.height_mm > -1.6, "{high:?}");
        let expected = 2.0 * tangent * -low.height_mm * 5.0;
        assert!(
            (low.disc_px - expected).abs() < 1e-3 && found.worst == low,
            "{low:?}"
        );
        let reach = 1.0 / (2.0 * tangent * 5.0);
        let [from, to] = found.sharp_mm.unwrap();
        assert!((from + reach).abs() < 1e-6 && (to - reach).abs() < 1e-6);
        // Above 2 mm of depth lies the ring beyond radius √(64 − 4).
        assert!((0.9..0.97).contains(&found.beyond), "{}", found.beyond);
        // Focused on its middle, each end is half as blurred.
        let middle = over_sample(&scene(0.05, 204.0), 1.0).unwrap();
        assert!((middle.ends[0].disc_px - 0.5 * low.disc_px).abs() < 0.05);
    }

    #[test]
    fn a_pinhole_is_sharp_everywhere() {
        let found = over_sample(&scene(0.0, 200.0), 1.0).unwrap();
        assert!(found.worst.disc_px == 0.0 && found.beyond == 0.0 && found.sharp_mm.is_none());
    }
}
