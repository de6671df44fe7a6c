//! What a simulated camera sees while the lamp is off.

use std::sync::Arc;

use mock_devices::{Illumination, RadianceSource};

/// The room's light alone.
pub struct Room {
    /// Pixels per row, rows.
    pub resolution_px: [u32; 2],
    /// Radiance everywhere, W/(m² sr).
    pub radiance_w_m2_sr: f32,
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
