//! A pair of directions with all that the models need of it.

use glam::DVec3;

use crate::brdf::ggx::Cosines;

/// Light and viewer above a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Directions {
    /// Their cosines.
    pub at: Cosines<f64>,
    /// Cosine of the angle between them.
    pub cos_io: f64,
    /// The direction to the light in the frame whose z axis is the normal and whose xz plane
    /// holds the viewer, at x ≥ 0.
    pub light_beside_viewer: [f64; 3],
}

impl Directions {
    /// From unit vectors in the local frame; `None` if either is at or below the horizon.
    pub fn new(to_light: DVec3, to_viewer: DVec3) -> Option<Self> {
        let at = Cosines::new(to_light.to_array(), to_viewer.to_array())?;
        let sin_o = to_viewer.x.hypot(to_viewer.y);
        let (x, y) = if sin_o > 0.0 {
            (to_viewer.x / sin_o, to_viewer.y / sin_o)
        } else {
            (1.0, 0.0)
        };
        Some(Self {
            at,
            cos_io: to_light.dot(to_viewer),
            light_beside_viewer: [
                x * to_light.x + y * to_light.y,
                x * to_light.y - y * to_light.x,
                to_light.z,
            ],
        })
    }
}
