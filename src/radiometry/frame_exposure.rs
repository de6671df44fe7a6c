//! The exposure of a photograph as its EXIF data or its file name state it.

use std::io::Cursor;

use exif::{Exif, In, Tag, Value};

/// What the camera wrote about a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraNote {
    /// Exposure, seconds.
    pub exposure_s: f64,
    /// ISO speed, where stated.
    pub iso: Option<f64>,
    /// Aperture number, where stated.
    pub f_number: Option<f64>,
}

/// EXIF data that cannot be gone by.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoteError {
    /// Two statements of the exposure, too far apart for rounding.
    #[error(
        "its EXIF data contradict themselves: an exposure of {exposure_s} s, and a shutter speed of {shutter_s:.6} s"
    )]
    Contradiction {
        /// The tag ExposureTime, seconds.
        exposure_s: f64,
        /// The tag ShutterSpeedValue, seconds.
        shutter_s: f64,
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

/// The exposure by the EXIF data of a JPEG, TIFF or PNG; `None` where there are none.
///
/// # Errors
/// Tags that contradict each other or state what cannot be.
pub fn from_exif(bytes: &[u8]) -> Result<Option<CameraNote>, NoteError> {
    let Ok(exif) = exif::Reader::new().read_from_container(&mut Cursor::new(bytes)) else {
        return Ok(None);
    };
    let exposure_s = number(&exif, Tag::ExposureTime);
    // APEX: the negative binary logarithm of the time.
    let shutter_s = number(&exif, Tag::ShutterSpeedValue).map(|apex| (-apex).exp2());
    if let (Some(exposure_s), Some(shutter_s)) = (exposure_s, shutter_s) {
        let ratio = exposure_s / shutter_s;
        if !(1.0 / ROUNDING..=ROUNDING).contains(&ratio) {
            return Err(NoteError::Contradiction {
                exposure_s,
                shutter_s,
            });
        }
    }
    let Some(exposure_s) = exposure_s.or(shutter_s) else {
        return Ok(None);
    };
    if !(exposure_s.is_finite() && exposure_s > 0.0) {
        return Err(NoteError::Impossible { exposure_s });
    }
    Ok(Some(CameraNote {
        exposure_s,
        iso: number(&exif, Tag::PhotographicSensitivity),
        f_number: number(&exif, Tag::FNumber),
    }))
}

fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(values) => values.first().map(exif::Rational::to_f64),
        Value::SRational(values) => values.first().map(exif::SRational::to_f64),
        Value::Short(values) => values.first().map(|&v| f64::from(v)),
        Value::Long(values) => values.first().map(|&v| f64::from(v)),
        _ => None,
    }
}

/// The exposure in a file's name: the last part (between `_`, `,` or spaces) that
/// is a number with `s`, `ms` or `us`, such as `scene_0.25s.png`, `t20ms_02.tif`
/// or, as a fraction, `scene_1-250s.jpg`. Seconds, > 0.
pub fn from_name(name: &str) -> Option<f64> {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let parts = stem.split(['_', ',', ' ']);
    parts.rev().find_map(|part| {
        let part = part.trim_start_matches(|c: char| c.is_ascii_alphabetic());
        let (number, scale) = part
            .strip_suffix("us")
            .map(|number| (number, 1e-6))
            .or_else(|| part.strip_suffix("ms").map(|number| (number, 1e-3)))
            .or_else(|| part.strip_suffix('s').map(|number| (number, 1.0)))?;
        let seconds = match number.split_once('-') {
            Some((above, below)) => decimal(above)? / decimal(below)?,
            None => decimal(number)?,
        };
        let seconds = seconds * scale;
        (seconds.is_finite() && seconds > 0.0).then_some(seconds)
    })
}

fn decimal(text: &str) -> Option<f64> {
    let plain = text.chars().all(|c| c.is_ascii_digit() || c == '.');
    plain.then(|| text.parse().ok()).flatten()
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
        let note = from_exif(&tiff(&[
            time(1, 60),
            apex(6, 1), // 1/64 s, as cameras round
            (Tag::PhotographicSensitivity, Value::Short(vec![400])),
            (
                Tag::FNumber,
                Value::Rational(vec![Rational { num: 56, denom: 10 }]),
            ),
        ]));
        let note = note.unwrap().unwrap();
        assert!((note.exposure_s - 1.0 / 60.0).abs() < 1e-12);
        assert_eq!((note.iso, note.f_number), (Some(400.0), Some(5.6)));
        let note = from_exif(&tiff(&[apex(3, 1)])).unwrap().unwrap();
        assert_eq!(note.exposure_s, 0.125);
        assert_eq!(from_exif(b"no picture at all").unwrap(), None);
    }

    #[test]
    fn contradictions_and_impossible_times_are_refused() {
        let error = from_exif(&tiff(&[time(1, 60), apex(2, 1)])).unwrap_err();
        assert!(error.to_string().contains("0.25"), "{error}");
        assert!(from_exif(&tiff(&[time(0, 60)])).is_err());
        assert!(from_exif(&tiff(&[time(1, 0)])).is_err());
    }

    #[test]
    fn names_state_the_exposure() {
        for (name, seconds) in [
            ("scene_0.25s.png", 0.25),
            ("t20ms_02.tif", 0.02),
            ("scene_1-250s.jpg", 0.004),
            ("a_3s_500us.png", 5e-4),
            ("exp2s.png", 2.0),
        ] {
            assert_eq!(from_name(name), Some(seconds), "{name}");
        }
        for name in [
            "bracket.png",
            "img_0001.jpg",
            "s.png",
            "_0s.png",
            "1-0s.png",
            "-3s.png",
        ] {
            assert_eq!(from_name(name), None, "{name}");
        }
    }

    proptest! {
        #[test]
        fn any_name_and_any_bytes_are_an_exposure_or_none(
            name in "[ a-z0-9._,é-]{0,20}",
            bytes in proptest::collection::vec(any::<u8>(), 0..300),
        ) {
            if let Some(seconds) = from_name(&name) {
                assert!(seconds > 0.0);
            }
            let _ = from_exif(&bytes);
            let mut damaged = tiff(&[time(1, 60)]);
            for (old, new) in damaged.iter_mut().skip(8).zip(&bytes) {
                *old ^= *new;
            }
            let _ = from_exif(&damaged);
        }
    }
}
