//! Reflectance: closed forms, the dictionary and its mixtures, measured
//! tables, and the checks that they are physical.
//!
//! All directions are in the local frame of the surface (+z is the normal) and
//! point away from it. Values are in 1/sr, cosine excluded, 0 below the horizon.

use glam::Vec3;

/// An isotropic BRDF in three colour channels.
pub trait Brdf: Send + Sync {
    /// f_r at `to_light` and `to_viewer` (unit, local frame), 1/sr, cosine excluded.
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3];
}
