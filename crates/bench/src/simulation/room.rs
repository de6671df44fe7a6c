//! What a simulated camera sees while the lamp is off.

use std::sync::Arc;

use mock_devices::{Illumination, RadianceSource};

use crate::config::RigConfig;

/// The room's light alone.
pub struct Room {
    resolution_px: [u32; 2],
    radiance_w_m2_sr: f32,
}

impl Room {
    /// Around the simulated bench of a rig.
    pub fn of_rig(rig: &RigConfig) -> Self {
        let simulation = rig.simulation.as_ref();
        Self {
            resolution_px: rig.camera.resolution_px,
            radiance_w_m2_sr: simulation.map_or(0.0, |s| s.ambient_w_m2_sr) as f32,
        }
    }
}

impl RadianceSource for Room {
    fn resolution_px(&self) -> [u32; 2] {
        self.resolution_px
    }

    fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
        let [width, height] = self.resolution_px;
        let pixels = width as usize * height as usize;
        Arc::new(vec![self.radiance_w_m2_sr; pixels])
    }
}
