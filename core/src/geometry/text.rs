//! Text of mesh files as any program writes it: encodings, line ends, numbers.

use std::borrow::Cow;

use super::mesh_error::MeshError;
use crate::shown::excerpt;

/// The bytes without a byte order mark; UTF-16 becomes UTF-8.
pub fn decoded(bytes: &[u8]) -> Cow<'_, [u8]> {
    if let Some(rest) = bytes.strip_prefix(b"\xef\xbb\xbf") {
        return Cow::Borrowed(rest);
    }
    let unit: fn([u8; 2]) -> u16 = match bytes {
        [0xff, 0xfe, ..] | [0x09..=0x7e, 0, 0x09..=0x7e, 0, 0x09..=0x7e, 0, ..] => {
            u16::from_le_bytes
        }
        [0xfe, 0xff, ..] | [0, 0x09..=0x7e, 0, 0x09..=0x7e, 0, 0x09..=0x7e, ..] => {
            u16::from_be_bytes
        }
        _ => return Cow::Borrowed(bytes),
    };
    let units = bytes.chunks_exact(2).map(|two| unit([two[0], two[1]]));
    let text: String = char::decode_utf16(units.skip_while(|&unit| unit == 0xfeff))
        .map(|decoded| decoded.unwrap_or(char::REPLACEMENT_CHARACTER))
        .collect();
    Cow::Owned(text.into_bytes())
}

/// The lines of a text with their numbers from 1; a line ends in LF, CR LF or CR.
pub fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let mut rest = Some(bytes);
    (1..).map_while(move |number| {
        let bytes = rest?;
        let (line, after) = split_line(bytes);
        rest = after;
        Some((number, line))
    })
}

/// The first line, and what follows its end if it has one.
pub fn split_line(bytes: &[u8]) -> (&[u8], Option<&[u8]>) {
    let Some(end) = bytes.iter().position(|&b| b == b'\n' || b == b'\r') else {
        return (bytes, None);
    };
    let long = bytes[end..].starts_with(b"\r\n");
    (&bytes[..end], Some(&bytes[end + 1 + usize::from(long)..]))
}

/// A number; what C libraries print for one that is none becomes NaN.
///
/// # Errors
/// The word is no number, or one with a decimal comma.
pub fn number(word: &str, line: usize) -> Result<f64, MeshError> {
    let parsed = word.parse().or_else(|_| {
        // Fortran's exponents.
        word.replace(['d', 'D'], "e").parse()
    });
    if let Ok(value) = parsed {
        return Ok(value);
    }
    let lower = word.to_ascii_lowercase();
    if ["#ind", "#qnan", "#snan", "#inf", "nan("]
        .iter()
        .any(|none| lower.contains(none))
    {
        return Ok(f64::NAN);
    }
    let location = format!("line {line}");
    let shown = excerpt(word).to_string();
    let with_point = word.replacen(',', ".", 1);
    if with_point != word && with_point.parse::<f64>().is_ok() {
        return Err(MeshError::DecimalComma {
            location,
            word: shown,
        });
    }
    Err(MeshError::Number {
        location,
        word: shown,
    })
}

/// The next three numbers.
///
/// # Errors
/// As [`number`], or there are fewer.
pub fn vector<'a>(
    mut words: impl Iterator<Item = &'a str>,
    line: usize,
) -> Result<[f64; 3], MeshError> {
    let mut v = [0.0; 3];
    for value in &mut v {
        let missing = || MeshError::format(format!("line {line}: three numbers are needed"));
        *value = number(words.next().ok_or_else(missing)?, line)?;
    }
    Ok(v)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_in_any_way() {
        for text in ["a\nb\n\nc", "a\r\nb\r\n\r\nc", "a\rb\r\rc"] {
            let found: Vec<_> = lines(text.as_bytes()).collect();
            let expected: [(usize, &[u8]); 4] = [(1, b"a"), (2, b"b"), (3, b""), (4, b"c")];
            assert_eq!(found, expected, "{text:?}");
        }
    }

    #[test]
    fn encodings_become_utf_8() {
        let utf16 = |mark: bool, order: fn(u16) -> [u8; 2]| -> Vec<u8> {
            let text = if mark { "\u{feff}v 1 2 3" } else { "v 1 2 3" };
            text.encode_utf16().flat_map(order).collect()
        };
        for bytes in [
            b"\xef\xbb\xbfv 1 2 3".to_vec(),
            utf16(true, u16::to_le_bytes),
            utf16(true, u16::to_be_bytes),
            utf16(false, u16::to_le_bytes),
            utf16(false, u16::to_be_bytes),
        ] {
            assert_eq!(&*decoded(&bytes), b"v 1 2 3", "{bytes:?}");
        }
    }

    #[test]
    fn numbers_are_read_as_programs_write_them() {
        assert_eq!(number("-1.5E+01", 1).unwrap(), -15.0);
        assert_eq!(number("1.25D-02", 1).unwrap(), 0.0125);
        for none in ["nan", "-nan", "-1.#IND", "1.#QNAN0", "-nan(ind)"] {
            assert!(number(none, 1).unwrap().is_nan(), "{none}");
        }
        let error = number("10,000000", 7).unwrap_err();
        assert!(matches!(error, MeshError::DecimalComma { .. }), "{error}");
        assert_eq!(
            error.to_string(),
            "line 7: \"10,000000\" has a decimal comma"
        );
        for word in ["1,2,3", "x", "", "1.000,5"] {
            let error = number(word, 7).unwrap_err();
            assert!(matches!(error, MeshError::Number { .. }), "{error}");
        }
    }
}
