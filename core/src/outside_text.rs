//! Text as the programs of every system save it, made one: UTF-8 with or without a byte order
//! mark, UTF-16 of either order, and lines that end in LF, CR LF or CR.

/// What Windows-1252 means by the bytes 0x80 to 0x9F, as <https://encoding.spec.whatwg.org>
/// has it: the five that it leaves open are control characters, as in Latin-1. All others are
/// the first characters of Unicode.
const WINDOWS_1252: [char; 32] = [
    '€', '\u{81}', '‚', 'ƒ', '„', '…', '†', '‡', 'ˆ', '‰', 'Š', '‹', 'Œ', '\u{8d}', 'Ž', '\u{8f}',
    '\u{90}', '‘', '’', '“', '”', '•', '–', '—', '˜', '™', 'š', '›', 'œ', '\u{9d}', 'ž', 'Ÿ',
];

/// Bytes that are text in no encoding that is read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotText {
    /// UTF-16 with halves of characters, or cut within one.
    #[error("it starts as UTF-16 text, but has an invalid code unit")]
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
    match utf16_order(&bytes) {
        Some(order) => utf16(&bytes, order).ok_or(NotText::Utf16),
        None => match String::from_utf8(bytes) {
            Ok(text) => Ok(plain(&text)),
            Err(error) => Err(not_utf8(error.as_bytes(), error.utf8_error().valid_up_to())),
        },
    }
}

/// As [`decode`], but what is not Unicode is taken as Windows-1252, which spreadsheets save and
/// of which Latin-1 is nearly a part: any bytes are text in it.
pub fn decode_any(bytes: &[u8]) -> String {
    let text = match utf16_order(bytes) {
        Some(order) => utf16(bytes, order),
        None => str::from_utf8(bytes).ok().map(plain),
    };
    text.unwrap_or_else(|| {
        let text: String = bytes.iter().copied().map(windows_1252).collect();
        plain(&text)
    })
}

/// How two bytes make a unit of UTF-16.
type Order = fn([u8; 2]) -> u16;

/// The order of UTF-16's bytes by a byte order mark, or by the zeros next to two first ASCII
/// characters; none where it is another encoding.
fn utf16_order(bytes: &[u8]) -> Option<Order> {
    match bytes {
        [0xFF, 0xFE, ..] | [1..=127, 0, 1..=127, 0, ..] => Some(u16::from_le_bytes),
        [0xFE, 0xFF, ..] | [0, 1..=127, 0, 1..=127, ..] => Some(u16::from_be_bytes),
        _ => None,
    }
}

/// None where the bytes are cut or hold halves of characters.
fn utf16(bytes: &[u8], order: Order) -> Option<String> {
    let (pairs, []) = bytes.as_chunks() else {
        return None;
    };
    let units = pairs.iter().map(|&pair| order(pair));
    let text: Result<String, _> = char::decode_utf16(units).collect();
    Some(plain(&text.ok()?))
}

fn windows_1252(byte: u8) -> char {
    match byte {
        0x80..=0x9F => WINDOWS_1252[usize::from(byte - 0x80)],
        _ => char::from(byte),
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
    NotText::Utf8 {
        line: 1 + before.iter().filter(|&&b| b == b'\n').count(),
        column: at - start + 1,
        byte: bytes[at],
        meant: windows_1252(bytes[at]),
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
        assert_eq!(decode(vec![0xff, 0xfe, 0, 0xd8]), Err(NotText::Utf16));
        assert_eq!(decode_any(b"\x80 \x8d \x9f \xff \xe9"), "€ \u{8d} Ÿ ÿ é");
    }

    proptest! {
        #[test]
        fn any_bytes_are_text_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
            let _ = decode_any(&bytes);
            let _ = decode(bytes);
        }
    }
}
