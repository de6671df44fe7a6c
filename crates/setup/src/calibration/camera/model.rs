//! A camera by its numbers, for the fit: unknown ones first, the fixed ones after them.

use glam::{DMat3, DVec2, DVec3};

use crate::transport::{Camera, Coefficients, LensSpec, Projection};

/// Which distortion is sought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Terms {
    /// None.
    None,
    /// k₁.
    Radial,
    /// k₁, k₂, p₁, p₂.
    Usual,
    /// k₁ to k₃, p₁, p₂.
    All,
}

/// All numbers of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    telecentric: bool,
    resolution_px: [usize; 2],
    /// Pixels per unit across and down: focal lengths, or pixels per millimetre.
    scale: DVec2,
    /// Principal point, pixels.
    principal_px: DVec2,
    distortion: Coefficients,
}

/// One number of a [`Model`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Number {
    /// As records name it.
    pub name: &'static str,
    index: usize,
}

const NAMES: [[&str; 9]; 2] = [
    ["fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2"],
    ["mx", "my", "cx", "cy", "k1", "k2", "k3", "p1", "p2"],
];

impl Model {
    /// Of a camera as the rig file has it.
    pub fn of(camera: &Camera) -> Self {
        let spec = *camera.lens.spec();
        let size = DVec2::from_array(camera.resolution_px.map(|n| n as f64));
        let telecentric = matches!(camera.projection, Projection::Orthographic { .. });
        let unit = match camera.projection {
            Projection::Orthographic { extent_mm } => 0.5 * extent_mm.x,
            Projection::Perspective { .. } => 1.0,
        };
        Self {
            telecentric,
            resolution_px: camera.resolution_px,
            scale: camera.scale_px() * DVec2::new(1.0, spec.aspect) / unit,
            principal_px: (spec.principal_offset + 0.5) * size,
            distortion: spec.distortion,
        }
    }

    /// Whether it is telecentric.
    pub fn is_telecentric(&self) -> bool {
        self.telecentric
    }

    /// The numbers that are sought: of a telecentric camera the principal point cannot be
    /// distinguished from a tangential distortion, and is fixed.
    pub fn sought(&self, terms: Terms) -> Vec<Number> {
        let distortion: &[usize] = match terms {
            Terms::None => &[],
            Terms::Radial => &[4],
            Terms::Usual => &[4, 5, 7, 8],
            Terms::All => &[4, 5, 6, 7, 8],
        };
        let first: &[usize] = if self.telecentric {
            &[0, 1]
        } else {
            &[0, 1, 2, 3]
        };
        let names = NAMES[usize::from(self.telecentric)];
        let number = |&index: &usize| Number {
            name: names[index],
            index,
        };
        first.iter().chain(distortion).map(number).collect()
    }

    /// The value of a number.
    pub fn get(&self, number: Number) -> f64 {
        match number.index {
            0 => self.scale.x,
            1 => self.scale.y,
            2 => self.principal_px.x,
            3 => self.principal_px.y,
            i @ 4..=6 => self.distortion.radial[i - 4],
            i => self.distortion.tangential[i - 7],
        }
    }

    /// With another value of a number.
    #[must_use]
    pub fn with(mut self, number: Number, value: f64) -> Self {
        match number.index {
            0 => self.scale.x = value,
            1 => self.scale.y = value,
            2 => self.principal_px.x = value,
            3 => self.principal_px.y = value,
            i @ 4..=6 => self.distortion.radial[i - 4] = value,
            i => self.distortion.tangential[i - 7] = value,
        }
        self
    }

    /// With this focal length (pixels), without distortion, its axis in the middle.
    #[must_use]
    pub fn plain(mut self, scale: DVec2) -> Self {
        self.scale = scale;
        self.distortion = Coefficients::default();
        self.principal_px = 0.5 * DVec2::from_array(self.resolution_px.map(|n| n as f64));
        self
    }

    /// A step of a number that moves corners by some hundredths of a pixel.
    pub fn step(&self, number: Number) -> f64 {
        let size = self.resolution_px[0].max(self.resolution_px[1]) as f64;
        match number.index {
            0 | 1 => 1e-4 * self.scale.x,
            2 | 3 => 0.02,
            // Distortion is in parts of the image's half size.
            i => {
                let half = 0.5 * size / (self.scale.x * self.unit());
                let power = [2, 4, 6, 1, 1][i - 4];
                1e-4 * half.powi(-power)
            }
        }
    }

    /// Where a point of the camera's frame is seen, pixels; `None` behind it.
    pub fn position_px(&self, p: DVec3) -> Option<DVec2> {
        let unit = self.unit();
        let ideal = match self.telecentric {
            true => p.truncate() / unit,
            false if p.z > 0.0 => p.truncate() / p.z,
            false => return None,
        };
        Some(self.principal_px + self.distortion.apply(ideal) * unit * self.scale)
    }

    /// Half the width of a telecentric camera's field, millimetres; else 1.
    fn unit(&self) -> f64 {
        match self.telecentric {
            true => 0.5 * self.resolution_px[0] as f64 / self.scale.x,
            false => 1.0,
        }
    }

    /// Focal lengths and principal point as a matrix.
    pub fn matrix(&self) -> DMat3 {
        let (f, c) = (self.scale, self.principal_px);
        DMat3::from_cols(
            DVec3::new(f.x, 0.0, 0.0),
            DVec3::new(0.0, f.y, 0.0),
            DVec3::new(c.x, c.y, 1.0),
        )
    }

    /// Pixels per unit, across and down.
    pub fn scale(&self) -> DVec2 {
        self.scale
    }

    /// As rig files state it.
    pub fn stated(&self) -> (Projection, LensSpec) {
        let size = DVec2::from_array(self.resolution_px.map(|n| n as f64));
        let principal_offset = self.principal_px / size - 0.5;
        let (projection, aspect) = match self.telecentric {
            true => {
                let extent_mm = size / self.scale;
                (Projection::Orthographic { extent_mm }, 1.0)
            }
            false => {
                let fov_rad = 2.0 * (0.5 * size.x / self.scale.x).atan();
                let aspect = self.scale.y / self.scale.x;
                (Projection::Perspective { fov_rad }, aspect)
            }
        };
        let lens = LensSpec {
            principal_offset,
            aspect,
            distortion: self.distortion,
        };
        (projection, lens)
    }
}
