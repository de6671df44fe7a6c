//! What distinguishes a lens from an ideal one that looks straight at the middle of the
//! image.

use glam::DVec2;

use super::distortion::{Coefficients, Distortion, Folded};

/// What a bench states of a lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensSpec {
    /// Where the lens' axis meets the image, against its middle: parts of the image's
    /// width and height.
    pub principal_offset: DVec2,
    /// How much taller the image is than the projection says; 1 for square pixels.
    pub aspect: f64,
    /// Distortion, in units of the focal length, or of half the field's width for a
    /// telecentric lens.
    pub distortion: Coefficients,
}

impl LensSpec {
    /// Nothing to correct.
    pub const IDEAL: Self = Self {
        principal_offset: DVec2::ZERO,
        aspect: 1.0,
        distortion: Coefficients {
            radial: [0.0; 3],
            tangential: [0.0; 2],
        },
    };
}

/// A lens that maps every position of the image to one ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    spec: LensSpec,
    /// `None` where nothing is distorted.
    distortion: Option<Distortion>,
}

impl Lens {
    /// The ideal lens.
    pub const IDEAL: Self = Self {
        spec: LensSpec::IDEAL,
        distortion: None,
    };

    /// For an image of this many pixels; `scale_px`: pixels of one unit, across and down,
    /// aspect excluded.
    pub(super) fn new(
        spec: LensSpec,
        resolution_px: [usize; 2],
        scale_px: DVec2,
    ) -> Result<Self, Folded> {
        let mut lens = Self {
            spec,
            distortion: None,
        };
        if spec.distortion != Coefficients::default() {
            let [width, height] = resolution_px.map(|n| n as f64);
            let corners = [[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]];
            let farthest = corners
                .map(|corner| lens.seen(DVec2::from_array(corner), resolution_px, scale_px))
                .map(DVec2::length)
                .into_iter()
                .fold(0.0, f64::max);
            lens.distortion = Some(Distortion::new(spec.distortion, farthest)?);
        }
        Ok(lens)
    }

    /// What was stated.
    pub fn spec(&self) -> &LensSpec {
        &self.spec
    }

    /// Whether there is nothing to correct.
    pub fn is_ideal(&self) -> bool {
        self.spec == LensSpec::IDEAL
    }

    /// The sensor position at which an ideal position appears.
    pub(super) fn position_px(
        &self,
        ideal: DVec2,
        resolution_px: [usize; 2],
        scale_px: DVec2,
    ) -> DVec2 {
        let seen = match &self.distortion {
            Some(distortion) => distortion.apply(ideal),
            None => ideal,
        };
        self.principal_px(resolution_px) + seen * self.scale(scale_px)
    }

    /// The ideal position of what appears at a sensor position.
    pub(super) fn ideal(
        &self,
        position_px: DVec2,
        resolution_px: [usize; 2],
        scale_px: DVec2,
    ) -> DVec2 {
        let seen = self.seen(position_px, resolution_px, scale_px);
        match &self.distortion {
            Some(distortion) => distortion.invert(seen),
            None => seen,
        }
    }

    fn seen(&self, position_px: DVec2, resolution_px: [usize; 2], scale_px: DVec2) -> DVec2 {
        (position_px - self.principal_px(resolution_px)) / self.scale(scale_px)
    }

    fn principal_px(&self, resolution_px: [usize; 2]) -> DVec2 {
        let size = DVec2::from_array(resolution_px.map(|n| n as f64));
        (self.spec.principal_offset + 0.5) * size
    }

    fn scale(&self, scale_px: DVec2) -> DVec2 {
        scale_px * DVec2::new(1.0, self.spec.aspect)
    }
}
