//! The lamp's irradiance, and each light's intensity, from a standard of known reflectance.

use std::path::Path;

use super::{CalibratingError, Kept, Place, session_of};
use crate::calibration::record::{LightsValues, Measured};
use crate::calibration::white::{Region, WhiteStandard, irradiance};
use crate::calibration::white_lights::WhiteLights;
use crate::config::RigConfig;
use crate::radiance_image::exr;
use crate::workflow::{BenchRecords, Observer};

/// A standard before the camera of a rig.
pub struct WhiteRequest<'a> {
    /// The bench.
    pub rig: &'a RigConfig,
    /// A radiance image of the standard, or a session, which gives each light's intensity too.
    pub images: &'a Path,
    /// Radiance factor by the certificate.
    pub reflectance: Measured,
    /// Angle between the standard's normal and the lamp, degrees; of a session each light's own is
    /// taken.
    pub incidence_deg: f64,
    /// Standard uncertainty of that angle, degrees.
    pub incidence_std_deg: f64,
    /// The standard's certificate: a part of the record's source.
    pub certificate: Option<&'a str>,
    /// The standard's own pixels; else all.
    pub region: Option<Region>,
    /// Height of the standard's surface above the sample's datum, mm (sessions only).
    pub height_mm: f64,
    /// Relative standard deviation of the radiance factor between directions (sessions only).
    pub direction_std: f64,
}

/// The lights as measured.
pub struct MeasuredWhite {
    /// What the record holds; intensities only of a session.
    pub values: LightsValues,
    source: String,
    method: String,
}

impl WhiteRequest<'_> {
    /// Reads the image or session and finds the irradiance; reports the records that were used.
    ///
    /// # Errors
    /// Images that cannot be read, or that are not of such a standard.
    pub fn measure(&self, observer: &dyn Observer) -> Result<MeasuredWhite, CalibratingError> {
        let images = self.images.display();
        let (values, images, how) = match self.images.is_dir() {
            true => {
                let values = self.of_session(observer)?;
                let how = format!("under {} lights", values.lights.len());
                (values, format!("session {images}"), how)
            }
            false => {
                let how = format!("at {} degrees", self.incidence_deg);
                (self.of_image()?, images.to_string(), how)
            }
        };
        let Measured { value, std } = self.reflectance;
        Ok(MeasuredWhite {
            values,
            source: match self.certificate {
                Some(certificate) => format!("{images}; standard's certificate {certificate}"),
                None => images,
            },
            method: format!("diffuse standard of reflectance {value} ± {std} {how}"),
        })
    }

    fn standard(&self, incidence_deg: f64) -> WhiteStandard {
        WhiteStandard {
            reflectance: self.reflectance,
            incidence_rad: incidence_deg.to_radians(),
            incidence_std_rad: self.incidence_std_deg.to_radians(),
        }
    }

    fn region_of(&self, width: usize, height: usize) -> Region {
        self.region.unwrap_or([0, 0, width, height].into())
    }

    fn of_image(&self) -> Result<LightsValues, CalibratingError> {
        let image = exr::read(self.images)?.image;
        let region = self.region_of(image.width, image.height);
        Ok(LightsValues {
            irradiance_w_m2: irradiance(&image, region, &self.standard(self.incidence_deg))?,
            lights: Vec::new(),
        })
    }

    /// Intensity and evenness of every light of a session, with the mean irradiance.
    fn of_session(&self, observer: &dyn Observer) -> Result<LightsValues, CalibratingError> {
        // The bench with its measured lens and lights.
        let mut session = session_of(self.images, &self.rig.name)?;
        let read_back = session.places.clone();
        let records = BenchRecords::without_irradiance(self.images)?;
        let geometry = records
            .apply(&session.config, &mut session.places, observer)
            .geometry;
        let places = session.places.iter().zip(read_back);
        let lights: Vec<_> = places
            .map(|(&there, at)| (geometry.light(there), at))
            .collect();
        // The standard under every light.
        let camera = geometry.image_camera();
        let [width, height] = camera.resolution_px;
        let white = WhiteLights {
            camera: &camera,
            region: self.region_of(width, height),
            height_mm: self.height_mm,
            standard: self.standard(0.0),
            direction_std: self.direction_std,
            lights: &lights,
        };
        let found = white.measure(&session.captured)?;
        let stated = geometry.light.irradiance_w_m2;
        Ok(LightsValues {
            irradiance_w_m2: std::array::from_fn(|c| Measured {
                value: found.strength[c].value * stated[c],
                std: found.strength[c].std * stated[c],
            }),
            lights: found.lights,
        })
    }
}

impl MeasuredWhite {
    /// Keeps the record.
    ///
    /// # Errors
    /// A file that cannot be written, or a record of that name that is there.
    pub fn keep(&self, mut place: Place) -> Result<Kept, CalibratingError> {
        place.measurement.source = self.source.clone();
        place.keep(self.values.clone(), &self.method, &[])
    }

    /// The smallest and largest intensity of a light over their mean, in green, and the largest
    /// relative uncertainty of one.
    pub fn intensities(&self) -> ([f64; 2], f64) {
        let green = || self.values.lights.iter().map(|light| light.relative[1]);
        let (low, high) = green().fold((f64::INFINITY, 0.0f64), |(low, high), m| {
            (low.min(m.value), high.max(m.value))
        });
        let worst = green().map(|m| m.std / m.value).fold(0.0, f64::max);
        ([low, high], worst)
    }
}
