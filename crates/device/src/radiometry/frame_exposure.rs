//! The exposure of a photograph as its EXIF data or its file name state it.

use std::io::Cursor;

use exif::{Context, Exif, In, Tag, Value};
use tiff::decoder::{Decoder, ifd};

pub use super::written_time::{Ambiguous, from_name};

/// What the camera wrote about a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraNote {
    /// Exposures by ExposureTime of the EXIF directory and of the first one, seconds.
    times_s: Vec<f64>,
    /// Exposure by ShutterSpeedValue, seconds.
    shutter_s: Option<f64>,
    /// ISO speed, where stated.
    pub iso: Option<f64>,
    /// Aperture number, where stated.
    pub f_number: Option<f64>,
    /// How the picture is to be turned when it is shown, 1 (not at all) to 8, where stated.
    pub orientation: Option<u32>,
}

/// EXIF data that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoteError {
    /// Two statements of the exposure, too far apart for rounding.
    #[error(
        "its EXIF data contradict themselves: an exposure of {exposure_s} s, and {what} of {other_s:.6} s"
    )]
    Contradiction {
        /// The tag ExposureTime, seconds.
        exposure_s: f64,
        /// The contradicting entry.
        what: &'static str,
        /// Its value, seconds.
        other_s: f64,
    },
    /// A number that no exposure can be.
    #[error("its EXIF data state an exposure of {exposure_s} s")]
    Impossible {
        /// As stated, seconds.
        exposure_s: f64,
    },
}

/// Cameras round both tags, up to a third of a stop each; more is a contradiction.
const ROUNDING: f64 = 1.6;

/// Numbers of the tags that are read, in both directories.
mod tag {
    pub const EXPOSURE_TIME: u16 = 0x829a;
    pub const F_NUMBER: u16 = 0x829d;
    pub const ISO: u16 = 0x8827;
    pub const RECOMMENDED_INDEX: u16 = 0x8832;
    pub const SHUTTER_SPEED: u16 = 0x9201;
    pub const ORIENTATION: u16 = 0x0112;
}

impl CameraNote {
    /// The EXIF data of a JPEG, TIFF, BigTIFF or PNG, in their own directory or in the
    /// first one (as TIFF/EP and scientific programs have it). Fields of 0/0 are unknown.
    pub fn read(bytes: &[u8]) -> Self {
        let mut reader = exif::Reader::new();
        let parsed = reader
            .continue_on_error(true)
            .read_from_container(&mut Cursor::new(bytes))
            .or_else(|error| error.distill_partial_result(|_| ()));
        match parsed {
            Ok(exif) => Self::of(|number| {
                let contexts = [Context::Exif, Context::Tiff].into_iter();
                contexts
                    .filter_map(|context| field(&exif, Tag(context, number)))
                    .collect()
            }),
            Err(_) => Self::of_big_tiff(bytes).unwrap_or_default(),
        }
    }

    /// BigTIFF, which the EXIF reader does not know.
    fn of_big_tiff(bytes: &[u8]) -> Option<Self> {
        let mut decoder = Decoder::new(Cursor::new(bytes)).ok()?;
        let pointer = decoder
            .find_tag(tiff::tags::Tag::ExifDirectory)
            .ok()
            .flatten();
        let directory = pointer
            .and_then(|pointer| pointer.into_ifd_pointer().ok())
            .and_then(|pointer| decoder.read_directory(pointer).ok());
        Some(Self::of(|number| {
            let tag = tiff::tags::Tag::from_u16_exhaustive(number);
            let own = directory
                .as_ref()
                .and_then(|directory| decoder.read_directory_tags(directory).find_tag(tag).ok()?);
            let first = decoder.find_tag(tag).ok().flatten();
            own.into_iter().chain(first).filter_map(number_of).collect()
        }))
    }

    /// `fields` gives the numbers of a tag, that of the EXIF directory first.
    fn of(mut fields: impl FnMut(u16) -> Vec<f64>) -> Self {
        let mut known = |number| -> Vec<f64> {
            let mut values = fields(number);
            values.retain(|value| !value.is_nan());
            values
        };
        let mut first = |number| known(number).first().copied();
        // A camera whose speed does not fit 16 bits writes 65535, and has another tag for it.
        let iso = match first(tag::ISO) {
            Some(65535.0) => first(tag::RECOMMENDED_INDEX),
            iso => iso,
        };
        Self {
            iso,
            f_number: first(tag::F_NUMBER),
            orientation: first(tag::ORIENTATION).map(|value| value as u32),
            // APEX: the negative binary logarithm of the time.
            shutter_s: first(tag::SHUTTER_SPEED).map(|apex| (-apex).exp2()),
            times_s: known(tag::EXPOSURE_TIME),
        }
    }

    /// The exposure, seconds, finite and > 0; `None` where it is not stated.
    ///
    /// # Errors
    /// Tags that contradict each other or state what cannot be.
    pub fn exposure_s(&self) -> Result<Option<f64>, NoteError> {
        let Some(exposure_s) = self.times_s.first().copied().or(self.shutter_s) else {
            return Ok(None);
        };
        if !(exposure_s.is_finite() && exposure_s > 0.0) {
            return Err(NoteError::Impossible { exposure_s });
        }
        let second = self.times_s.get(1).map(|&s| ("another one", s));
        let shutter = self.shutter_s.map(|s| ("a shutter speed", s));
        for (what, other_s) in second.into_iter().chain(shutter) {
            if !(1.0 / ROUNDING..=ROUNDING).contains(&(exposure_s / other_s)) {
                return Err(NoteError::Contradiction {
                    exposure_s,
                    what,
                    other_s,
                });
            }
        }
        Ok(Some(exposure_s))
    }
}

fn field(exif: &Exif, tag: Tag) -> Option<f64> {
    match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(values) => values.first().map(exif::Rational::to_f64),
        Value::SRational(values) => values.first().map(exif::SRational::to_f64),
        Value::Short(values) => values.first().map(|&v| f64::from(v)),
        Value::Long(values) => values.first().map(|&v| f64::from(v)),
        Value::SLong(values) => values.first().map(|&v| f64::from(v)),
        Value::Float(values) => values.first().map(|&v| f64::from(v)),
        Value::Double(values) => values.first().copied(),
        _ => None,
    }
}

fn number_of(value: ifd::Value) -> Option<f64> {
    use ifd::Value::{Double, Float, Rational, SRational};
    match value {
        Rational(above, below) => Some(f64::from(above) / f64::from(below)),
        SRational(above, below) => Some(f64::from(above) / f64::from(below)),
        Float(value) => Some(value.into()),
        Double(value) => Some(value),
        other => other.into_u64().ok().map(|value| value as f64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use exif::experimental::Writer;
    use exif::{Field, Rational, SRational};
    use proptest::prelude::{any, proptest};

    /// A TIFF that holds nothing but EXIF tags.
    fn tiff(tags: &[(Tag, Value)]) -> Vec<u8> {
        let fields: Vec<Field> = tags
            .iter()
            .map(|(tag, value)| Field {
                tag: *tag,
                ifd_num: In::PRIMARY,
                value: value.clone(),
            })
            .collect();
        let mut writer = Writer::new();
        for field in &fields {
            writer.push_field(field);
        }
        let mut bytes = Cursor::new(Vec::new());
        writer.write(&mut bytes, false).unwrap();
        bytes.into_inner()
    }

    fn time(num: u32, denom: u32) -> (Tag, Value) {
        (
            Tag::ExposureTime,
            Value::Rational(vec![Rational { num, denom }]),
        )
    }

    fn apex(num: i32, denom: i32) -> (Tag, Value) {
        let value = SRational { num, denom };
        (Tag::ShutterSpeedValue, Value::SRational(vec![value]))
    }

    #[test]
    fn exif_states_the_exposure_speed_and_aperture() {
        let note = CameraNote::read(&tiff(&[
            time(1, 60),
            apex(6, 1), // 1/64 s, as cameras round
            (Tag::PhotographicSensitivity, Value::Short(vec![400])),
            (
                Tag::FNumber,
                Value::Rational(vec![Rational { num: 56, denom: 10 }]),
            ),
        ]));
        let exposure_s = note.exposure_s().unwrap().unwrap();
        assert!((exposure_s - 1.0 / 60.0).abs() < 1e-12);
        assert_eq!((note.iso, note.f_number), (Some(400.0), Some(5.6)));
        let exposure_s = |tags: &[_]| CameraNote::read(&tiff(tags)).exposure_s();
        assert_eq!(exposure_s(&[apex(3, 1)]), Ok(Some(0.125)));
        assert_eq!(exposure_s(&[time(0, 0), apex(3, 1)]), Ok(Some(0.125)));
        assert_eq!(exposure_s(&[time(0, 0)]), Ok(None));
        let nothing = CameraNote::read(b"no picture at all");
        assert_eq!(nothing, CameraNote::default());
    }

    /// In the first directory, of every type that a number can have.
    #[test]
    fn the_first_directory_states_it_as_well() {
        let first = Tag(Context::Tiff, tag::EXPOSURE_TIME);
        let rational = Value::Rational(vec![Rational { num: 1, denom: 4 }]);
        for value in [
            rational,
            Value::Double(vec![0.25]),
            Value::Float(vec![0.25]),
        ] {
            let note = CameraNote::read(&tiff(&[(first, value)]));
            assert_eq!(note.exposure_s(), Ok(Some(0.25)));
        }
        let both = tiff(&[(first, Value::Double(vec![0.5])), time(1, 60)]);
        let error = CameraNote::read(&both).exposure_s().unwrap_err();
        assert!(error.to_string().contains("another one of 0.5"), "{error}");
    }

    #[test]
    fn contradictions_and_impossible_times_are_refused() {
        let exposure_s = |tags: &[_]| CameraNote::read(&tiff(tags)).exposure_s();
        let error = exposure_s(&[time(1, 60), apex(2, 1)]).unwrap_err();
        assert!(error.to_string().contains("0.25"), "{error}");
        assert!(exposure_s(&[time(0, 60)]).is_err());
        assert!(exposure_s(&[time(1, 0)]).is_err());
    }

    proptest! {
        #[test]
        fn any_bytes_are_an_exposure_or_none(
            bytes in proptest::collection::vec(any::<u8>(), 0..300),
        ) {
            let _ = CameraNote::read(&bytes).exposure_s();
            let mut damaged = tiff(&[time(1, 60)]);
            for (old, new) in damaged.iter_mut().skip(8).zip(&bytes) {
                *old ^= *new;
            }
            let _ = CameraNote::read(&damaged).exposure_s();
        }
    }
}
