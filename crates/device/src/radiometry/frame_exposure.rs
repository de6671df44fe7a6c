//! The exposure of a photograph as its EXIF data or its file name state it.

use std::io::Cursor;

use exif::{Context, Exif, In, Tag, Value};
use tiff::decoder::{Decoder, Limits, ifd};

pub use super::written_time::{Ambiguous, from_name};
use crate::shown::excerpt;

/// What the camera wrote about a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraNote {
    /// Exposures by ExposureTime of the EXIF directory and of the first one, seconds.
    times_s: Vec<f64>,
    /// Exposure by ShutterSpeedValue, seconds.
    shutter_s: Option<f64>,
    /// What has one value throughout a bracket, where stated: the tag's number, and its value
    /// in words that follow "was taken".
    pub settings: Vec<(u16, String)>,
    /// Whether the camera chose the white balance of this frame by itself.
    pub automatic_white_balance: bool,
    /// How the camera processed the frame beyond the usual, in words.
    pub processing: Option<&'static str>,
    /// How the picture is to be turned when it is shown, 1 (not at all) to 8, where stated.
    pub orientation: Option<u32>,
}

/// EXIF data that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum NoteError {
    /// Two statements of the exposure, too far apart for rounding.
    #[error(
        "its EXIF data contradict themselves: an exposure of {exposure_s} s, and {what} of {other_s:.6} s"
    )]
    Contradiction {
        exposure_s: f64,
        what: &'static str,
        other_s: f64,
    },
    /// A number that no exposure can be.
    #[error("its EXIF data state an exposure of {exposure_s} s")]
    Impossible { exposure_s: f64 },
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
    pub const MODEL: u16 = 0x0110;
    pub const FLASH: u16 = 0x9209;
    pub const FOCAL_LENGTH: u16 = 0x920a;
    pub const CUSTOM_RENDERED: u16 = 0xa401;
    pub const WHITE_BALANCE: u16 = 0xa403;
    pub const DIGITAL_ZOOM: u16 = 0xa404;
    pub const FOCAL_LENGTH_35: u16 = 0xa405;
    pub const BODY_NUMBER: u16 = 0xa431;
    pub const LENS_MODEL: u16 = 0xa434;
    pub const COMPOSITE_IMAGE: u16 = 0xa460;
}

/// Value of a tag.
enum Stated {
    Number(f64),
    Text(String),
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
        let mut limits = Limits::default();
        limits.decoding_buffer_size = bytes.len();
        limits.ifd_value_size = bytes.len();
        let mut decoder = Decoder::new(Cursor::new(bytes)).ok()?.with_limits(limits);
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
            own.into_iter().chain(first).filter_map(stated_of).collect()
        }))
    }

    /// `fields` gives the values of a tag, that of the EXIF directory first.
    fn of(mut fields: impl FnMut(u16) -> Vec<Stated>) -> Self {
        let mut numbers = |number| -> Vec<f64> {
            let known = fields(number).into_iter().filter_map(|value| match value {
                Stated::Number(value) if !value.is_nan() => Some(value),
                _ => None,
            });
            known.collect()
        };
        let times_s = numbers(tag::EXPOSURE_TIME);
        let mut first = |number| numbers(number).first().copied();
        // Numbers of the settings; 0 is an unknown focal length and no zoom.
        let iso = match first(tag::ISO) {
            // A camera whose speed does not fit 16 bits writes this, and has another tag.
            Some(65535.0) => first(tag::RECOMMENDED_INDEX),
            iso => iso,
        };
        let mut above_0 = |number| first(number).filter(|&value| value > 0.0);
        let focal_length = above_0(tag::FOCAL_LENGTH).map(|f| format!("at {f} mm"));
        let equivalent = above_0(tag::FOCAL_LENGTH_35);
        let equivalent = equivalent.map(|f| format!("at {f} mm in terms of 35 mm film"));
        let zoom = first(tag::DIGITAL_ZOOM).map(|zoom| if zoom > 0.0 { zoom } else { 1.0 });
        let flash = first(tag::FLASH).map(|flash| match flash as u32 & 1 {
            1 => "with flash".to_owned(),
            _ => "without flash".to_owned(),
        });
        let mut settings = vec![
            (tag::ISO, iso.map(|iso| format!("at ISO {iso}"))),
            (
                tag::F_NUMBER,
                first(tag::F_NUMBER).map(|f| format!("at f/{f}")),
            ),
            (tag::FOCAL_LENGTH, focal_length),
            (tag::FOCAL_LENGTH_35, equivalent),
            (
                tag::DIGITAL_ZOOM,
                zoom.map(|zoom| format!("with a digital zoom of {zoom}")),
            ),
            (tag::FLASH, flash),
        ];
        let processing = match (first(tag::COMPOSITE_IMAGE), first(tag::CUSTOM_RENDERED)) {
            (Some(2.0 | 3.0), _) => Some("composed of several exposures (CompositeImage)"),
            (_, Some(custom)) if custom > 0.0 => {
                Some("processed by the camera in a way of its own, such as HDR (CustomRendered)")
            }
            _ => None,
        };
        let (orientation, shutter) = (first(tag::ORIENTATION), first(tag::SHUTTER_SPEED));
        let automatic_white_balance = first(tag::WHITE_BALANCE) == Some(0.0);
        // Names of the settings.
        for (number, words) in [
            (tag::MODEL, "with the camera"),
            (tag::BODY_NUMBER, "with the camera number"),
            (tag::LENS_MODEL, "with the lens"),
        ] {
            let name = fields(number).into_iter().find_map(|value| match value {
                Stated::Text(text) if !text.is_empty() => Some(text),
                _ => None,
            });
            settings.push((
                number,
                name.map(|name| format!("{words} {}", excerpt(&name))),
            ));
        }
        let stated = settings.into_iter();
        Self {
            settings: stated
                .filter_map(|(tag, words)| Some((tag, words?)))
                .collect(),
            automatic_white_balance,
            processing,
            orientation: orientation.map(|value| value as u32),
            // APEX: the negative binary logarithm of the time.
            shutter_s: shutter.map(|apex| (-apex).exp2()),
            times_s,
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

fn field(exif: &Exif, tag: Tag) -> Option<Stated> {
    let number = match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(values) => values.first().map(exif::Rational::to_f64),
        Value::SRational(values) => values.first().map(exif::SRational::to_f64),
        Value::Short(values) => values.first().map(|&v| f64::from(v)),
        Value::Long(values) => values.first().map(|&v| f64::from(v)),
        Value::SLong(values) => values.first().map(|&v| f64::from(v)),
        Value::Float(values) => values.first().map(|&v| f64::from(v)),
        Value::Double(values) => values.first().copied(),
        Value::Ascii(texts) => {
            let text = texts.first()?;
            return Some(Stated::Text(name(&String::from_utf8_lossy(text))));
        }
        _ => None,
    };
    number.map(Stated::Number)
}

/// Cameras fill fields of a fixed length.
fn name(text: &str) -> String {
    text.trim_matches(|c: char| c.is_whitespace() || c == '\0')
        .to_owned()
}

fn stated_of(value: ifd::Value) -> Option<Stated> {
    use ifd::Value::{Ascii, Double, Float, Rational, SRational};
    let number = match value {
        Ascii(text) => return Some(Stated::Text(name(&text))),
        Rational(above, below) => f64::from(above) / f64::from(below),
        SRational(above, below) => f64::from(above) / f64::from(below),
        Float(value) => value.into(),
        Double(value) => value,
        other => other.into_u64().ok()? as f64,
    };
    Some(Stated::Number(number))
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
        let settings: Vec<&str> = note.settings.iter().map(|s| s.1.as_str()).collect();
        assert_eq!(settings, ["at ISO 400", "at f/5.6"]);
        let exposure_s = |tags: &[_]| CameraNote::read(&tiff(tags)).exposure_s();
        assert_eq!(exposure_s(&[apex(3, 1)]), Ok(Some(0.125)));
        assert_eq!(exposure_s(&[time(0, 0), apex(3, 1)]), Ok(Some(0.125)));
        assert_eq!(exposure_s(&[time(0, 0)]), Ok(None));
        let nothing = CameraNote::read(b"no picture at all");
        assert_eq!(nothing, CameraNote::default());
    }

    /// What a bracket has in common, each in words; and what the camera did by itself.
    #[test]
    fn exif_states_lens_camera_and_processing() {
        let rational = |num, denom| Value::Rational(vec![Rational { num, denom }]);
        let short = |value| Value::Short(vec![value]);
        let text = |text: &str| Value::Ascii(vec![text.as_bytes().to_vec()]);
        for (tag, value, words) in [
            (Tag::FocalLength, rational(42, 10), "at 4.2 mm"),
            (
                Tag::FocalLengthIn35mmFilm,
                short(26),
                "at 26 mm in terms of 35 mm film",
            ),
            (
                Tag::DigitalZoomRatio,
                rational(2, 1),
                "with a digital zoom of 2",
            ),
            (
                Tag::DigitalZoomRatio,
                rational(0, 1),
                "with a digital zoom of 1",
            ),
            (Tag::Flash, short(0x19), "with flash"),
            (Tag::Flash, short(0x10), "without flash"),
            (Tag::Model, text("Phone 7  "), "with the camera Phone 7"),
            (
                Tag::BodySerialNumber,
                text("0123"),
                "with the camera number 0123",
            ),
            (
                Tag::LensModel,
                text("wide 4.2mm"),
                "with the lens wide 4.2mm",
            ),
            (Tag::FocalLength, rational(0, 1), ""),
            (Tag::LensModel, text("  "), ""),
        ] {
            let note = CameraNote::read(&tiff(&[(tag, value)]));
            let settings: Vec<&str> = note.settings.iter().map(|s| s.1.as_str()).collect();
            assert_eq!(settings.concat(), words);
            assert!(!note.automatic_white_balance && note.processing.is_none());
        }
        let note = |tag, value| CameraNote::read(&tiff(&[(tag, short(value))]));
        assert!(note(Tag::WhiteBalance, 0).automatic_white_balance);
        assert!(!note(Tag::WhiteBalance, 1).automatic_white_balance);
        for (tag, value, is_processed) in [
            (Tag::CustomRendered, 0, false),
            (Tag::CustomRendered, 3, true),
            (Tag::CompositeImage, 1, false),
            (Tag::CompositeImage, 3, true),
        ] {
            assert_eq!(
                note(tag, value).processing.is_some(),
                is_processed,
                "{tag} {value}"
            );
        }
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
