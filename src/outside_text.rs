//! Text as the programs of every system save it, made one: UTF-8 with or without a byte order
//! mark, UTF-16 of either order, and lines that end in LF, CR LF or CR.

use encoding_rs::{Encoding, UTF_8, UTF_16BE, UTF_16LE, WINDOWS_1252};

/// Bytes that are text in no encoding that is read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotText {
    /// UTF-16 with halves of characters, or cut within one.
    #[error("it begins as UTF-16 text, but holds what UTF-16 has not")]
    Utf16,
    /// A byte that UTF-8 has not.
    #[error(
        "it is no UTF-8 text: byte {column} of line {line} is 0x{byte:02X} (`{meant}` in Windows-1252)"
    )]
    Utf8 {
        /// Line, from 1.
        line: usize,
        /// Byte of the line, from 1.
        column: usize,
        /// Its value.
        byte: u8,
        /// The character that Windows programs for western languages mean by it.
        meant: char,
    },
}

/// The text of a file that must be Unicode, without byte order mark; a lone CR becomes LF where
/// the text has no LF.
///
/// # Errors
/// The bytes are neither UTF-8 nor UTF-16 with a byte order mark or two first ASCII characters.
pub fn decode(bytes: Vec<u8>) -> Result<String, NotText> {
    let unicode = unicode(&bytes);
    if unicode == UTF_8 {
        return match String::from_utf8(bytes) {
            Ok(text) => Ok(plain(&text)),
            Err(error) => Err(not_utf8(error.as_bytes(), error.utf8_error().valid_up_to())),
        };
    }
    let (text, _, damaged) = unicode.decode(&bytes);
    match damaged {
        true => Err(NotText::Utf16),
        false => Ok(plain(&text)),
    }
}

/// As [`decode`], but what is not Unicode is taken as Windows-1252, which spreadsheets save and
/// of which Latin-1 is nearly a part: any bytes are text in it.
pub fn decode_any(bytes: &[u8]) -> String {
    let (text, _, damaged) = unicode(bytes).decode(bytes);
    match damaged {
        true => plain(&WINDOWS_1252.decode_without_bom_handling(bytes).0),
        false => plain(&text),
    }
}

/// The encoding by a byte order mark, or by the zeros next to two first ASCII characters.
fn unicode(bytes: &[u8]) -> &'static Encoding {
    match bytes {
        [0xFF, 0xFE, ..] | [1..=127, 0, 1..=127, 0, ..] => UTF_16LE,
        [0xFE, 0xFF, ..] | [0, 1..=127, 0, 1..=127, ..] => UTF_16BE,
        _ => UTF_8,
    }
}

fn plain(text: &str) -> String {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    match text.contains('\n') {
        true => text.to_owned(),
        false => text.replace('\r', "\n"),
    }
}

fn not_utf8(bytes: &[u8], at: usize) -> NotText {
    let before = &bytes[..at];
    let start = before
        .iter()
        .rposition(|&b| b == b'\n')
        .map_or(0, |n| n + 1);
    let meant = WINDOWS_1252.decode_without_bom_handling(&bytes[at..=at]).0;
    NotText::Utf8 {
        line: 1 + before.iter().filter(|&&b| b == b'\n').count(),
        column: at - start + 1,
        byte: bytes[at],
        meant: meant.chars().next().unwrap_or('\u{fffd}'),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn utf16(text: &str, order: fn(u16) -> [u8; 2]) -> Vec<u8> {
        text.encode_utf16().flat_map(order).collect()
    }

    #[test]
    fn one_text_in_every_encoding() {
        let text = "file;exposure_s\nPrüfling µ.png;0,02\n";
        let marked = format!("\u{feff}{text}");
        for bytes in [
            text.as_bytes().to_vec(),
            marked.as_bytes().to_vec(),
            utf16(&marked, u16::to_le_bytes),
            utf16(&marked, u16::to_be_bytes),
            utf16(text, u16::to_le_bytes),
            utf16(text, u16::to_be_bytes),
            text.replace('\n', "\r").into_bytes(),
        ] {
            assert_eq!(decode_any(&bytes), text);
            assert_eq!(decode(bytes).unwrap(), text);
        }
        assert_eq!(decode(b"a\r\nb\r\n".to_vec()).unwrap(), "a\r\nb\r\n");
    }

    #[test]
    fn what_windows_saves_for_western_languages_is_read_or_named() {
        let bytes = b"a\nPr\xfcfling\n".to_vec();
        assert_eq!(decode_any(&bytes), "a\nPrüfling\n");
        let error = decode(bytes).unwrap_err();
        let expected = NotText::Utf8 {
            line: 2,
            column: 3,
            byte: 0xfc,
            meant: 'ü',
        };
        assert_eq!(error, expected);
        assert_eq!(decode(vec![0xff, 0xfe, b'a']), Err(NotText::Utf16));
    }

    proptest! {
        #[test]
        fn any_bytes_are_text_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
            let _ = decode_any(&bytes);
            let _ = decode(bytes);
        }
    }
}
