//! Files that people give as frames and that are none, by their first bytes.

/// The kind of a camera's raw file that is no TIFF, or only nearly one; `None` for others.
pub(super) fn camera_raw(bytes: &[u8]) -> Option<&'static str> {
    let begins = |with: &[u8]| bytes.starts_with(with);
    let at = |offset: usize, what: &[u8]| bytes.get(offset..).is_some_and(|b| b.starts_with(what));
    match bytes {
        _ if at(8, b"CR\x02") => Some("Canon CR2"),
        _ if at(4, b"ftypcrx ") => Some("Canon CR3"),
        _ if begins(b"IIRO") || begins(b"IIRS") || begins(b"MMOR") => Some("Olympus ORF"),
        _ if begins(b"IIU\0") => Some("Panasonic RW2"),
        _ if begins(b"FUJIFILMCCD-RAW") => Some("Fujifilm RAF"),
        _ if begins(b"FOVb") => Some("Sigma X3F"),
        _ if begins(b"\0MRM") => Some("Minolta MRW"),
        _ => None,
    }
}

/// What else a file is, with its article; `None` where it is not recognised.
pub(super) fn kind(bytes: &[u8]) -> Option<&'static str> {
    let begins = |with: &[u8]| bytes.starts_with(with);
    let at = |offset: usize, what: &[u8]| bytes.get(offset..).is_some_and(|b| b.starts_with(what));
    match bytes {
        [] => Some("an empty file"),
        _ if begins(b"SIMPLE  =") => Some("a FITS image"),
        [b'P', b'1'..=b'6', blank, ..] if blank.is_ascii_whitespace() => Some("a PGM or PPM image"),
        _ if begins(b"BM") => Some("a BMP image"),
        _ if begins(b"GIF8") => Some("a GIF image"),
        _ if begins(b"RIFF") && at(8, b"WEBP") => Some("a WebP image"),
        _ if begins(b"RIFF") => Some("an AVI film"),
        _ if at(4, b"ftyphei") || at(4, b"ftypmif1") => Some("a HEIF image"),
        _ if at(4, b"ftypavif") => Some("an AVIF image"),
        _ if at(4, b"ftyp") => Some("a film"),
        _ if begins(b"\x76\x2f\x31\x01") => Some("an OpenEXR image"),
        _ if begins(b"#?RADIANCE") || begins(b"#?RGBE") => Some("a Radiance HDR image"),
        _ if begins(b"\x93NUMPY") => Some("a NumPy array"),
        _ if begins(b"\x89HDF") => Some("an HDF5 file"),
        _ if begins(b"\0\0\0\x0cjP") || begins(b"\xff\x4f\xff\x51") => Some("a JPEG 2000 image"),
        _ if begins(b"\0\x05\x16\x07") => Some("what macOS keeps next to a file (AppleDouble)"),
        _ if begins(b"<") => Some("a web page or XML"),
        _ => None,
    }
}
