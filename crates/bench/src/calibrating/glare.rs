//! The light that the lens scatters, from black traps on a white card.

use super::{Attendant, CalibratingError, Kept, Place, counted, procedure_options};
use crate::calibration::glare::{GlareRequest, GlareValues, measure};
use crate::calibration::mirror_sphere::Grey;
use crate::calibration::procedure::LitCamera;
use crate::calibration::record::Measured;
use crate::calibration::white::Region;
use crate::capture::open::{OpenOptions, open_real_camera};
use crate::config::RigConfig;
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};

/// A white card with black traps before the camera of a rig.
pub struct CardRequest<'a> {
    /// The bench.
    pub rig: &'a RigConfig,
    /// Parts of the image inside the traps; the simulated card's need not be named.
    pub traps: &'a [Region],
    /// What the traps reflect over what the card does.
    pub trap_reflectance: Measured,
    /// Frames of the card, and as many dark ones.
    pub frames: u32,
    /// How a real camera is opened.
    pub open: &'a OpenOptions,
}

/// The glare as measured.
pub struct MeasuredGlare {
    /// The shares of the light.
    pub values: GlareValues,
    /// How many traps there were.
    traps: usize,
}

impl CardRequest<'_> {
    /// Takes frames of the card and finds the glare.
    ///
    /// # Errors
    /// The camera fails, or the traps are not dark enough or not in the image.
    pub fn measure(&self, attendant: &dyn Attendant) -> Result<MeasuredGlare, CalibratingError> {
        let (mut camera, simulated) = match self.rig.camera_before_traps(self.true_reflectance()) {
            Some(card) => (card.camera, card.traps.map(Region::from).to_vec()),
            None => (open_real_camera(self.rig, self.open)?, Vec::new()),
        };
        let traps = match self.traps {
            [] => &simulated,
            named => named,
        };
        let mut cover = |cover| attendant.cover(cover);
        let mut step = counted(attendant, 2 * self.frames);
        let options = procedure_options(&self.rig.camera, self.frames);
        let picture = LitCamera::new(camera.as_mut(), options, &mut cover, &mut step).picture()?;
        self.found(&picture, traps)
    }

    /// Finds the glare in an image of the card.
    ///
    /// # Errors
    /// The traps are not dark enough or not in the image.
    pub fn measure_image(&self, image: &RadianceImage) -> Result<MeasuredGlare, CalibratingError> {
        self.found(&Grey::of(image), self.traps)
    }

    fn found(&self, image: &Grey, traps: &[Region]) -> Result<MeasuredGlare, CalibratingError> {
        let values = measure(&GlareRequest {
            image,
            traps,
            trap_reflectance: self.trap_reflectance,
        })?;
        Ok(MeasuredGlare {
            values,
            traps: traps.len(),
        })
    }

    /// The simulated traps differ from what is stated as real ones do.
    fn true_reflectance(&self) -> f64 {
        let seed = self.rig.simulation.as_ref().map_or(0, |s| s.seed);
        let error = stream(seed, Purpose::BenchPerturbation, u64::MAX, 1, 0).normal();
        (self.trap_reflectance.value + self.trap_reflectance.std * error).max(0.0)
    }
}

impl MeasuredGlare {
    /// Keeps the record.
    ///
    /// # Errors
    /// A file that cannot be written, or a record of that name that is there.
    pub fn keep(&self, place: &Place) -> Result<Kept, CalibratingError> {
        let method = format!("{} black trap(s) on a white card", self.traps);
        place.keep(self.values, &method, &[])
    }
}
