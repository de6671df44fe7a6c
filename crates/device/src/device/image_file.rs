//! A raw frame in an image file that some other program wrote.

use std::path::Path;

use image::ImageFormat;

use super::RawFrame;
use super::retake::FrameFault;
use crate::outside_file::read_regular;
use crate::radiometry::frame_file::{FrameFileError, decode_sized};

/// Largest raw frame, bytes: 250 megapixels of 16 bits, not compressed.
const LARGEST_BYTES: u64 = 1 << 29;

/// Whether a file's name is that of a format which can hold raw counts.
pub fn has_raw_ending(path: &Path) -> bool {
    let ending = path.extension().and_then(|ending| ending.to_str());
    ending.is_some_and(|ending| {
        ["png", "tif", "tiff"].contains(&ending.to_ascii_lowercase().as_str())
    })
}

/// Whether a file's name is that of a picture, developed or a camera's own raw format, in
/// which counts are not read.
pub fn has_other_ending(path: &Path) -> bool {
    const OTHERS: [&str; 16] = [
        "jpg", "jpeg", "heic", "heif", "webp", "bmp", "dng", "cr2", "cr3", "nef", "arw", "raf",
        "orf", "rw2", "pef", "raw",
    ];
    let ending = path.extension().and_then(|ending| ending.to_str());
    ending.is_some_and(|ending| OTHERS.contains(&ending.to_ascii_lowercase().as_str()))
}

/// The counts of a greyscale PNG or TIFF of 8 to 16 bits, one sample per pixel
/// (a colour sensor's mosaic as it is, not interpolated). Nothing is allocated
/// for a declared size other than `expected`.
///
/// # Errors
/// What is wrong with the file, as a fault of the frame.
pub fn read(path: &Path, expected: [u32; 2], bit_depth: u32) -> Result<RawFrame, FrameFault> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let unreadable =
        |what: &dyn std::fmt::Display| FrameFault::Undecodable(format!("{name}: {what}"));
    let not_raw = |kind: &str| FrameFault::NotRaw {
        name: name.to_string(),
        kind: kind.to_owned(),
    };
    let bytes = read_regular(path, LARGEST_BYTES).map_err(|error| unreadable(&error))?;
    match image::guess_format(&bytes) {
        Ok(ImageFormat::Png | ImageFormat::Tiff) | Err(_) => {}
        Ok(other) => return Err(not_raw(&format!("a {} file", name_of(other)))),
    }
    let [width, height] = expected;
    let size = [width as usize, height as usize];
    let mut frame = decode_sized(&bytes, Some(size)).map_err(|error| match error {
        FrameFileError::Size { found, .. } => FrameFault::Size {
            found: found.map(|side| side as u32),
            counts: found[0] * found[1],
            expected,
        },
        error => unreadable(&error),
    })?;
    let counts = match frame.planes.len() {
        1 => frame.planes.remove(0),
        _ => {
            return Err(not_raw("in colour, with all channels at every pixel"));
        }
    };
    let largest = ((1_u32 << bit_depth.min(16)) - 1) as u16;
    if let Some(place) = counts.iter().position(|&count| count > largest) {
        let (x, y) = (place as u32 % width, place as u32 / width);
        let count = counts[place];
        return Err(unreadable(&format!(
            "pixel ({x}, {y}) is {count}, more than {bit_depth} bits"
        )));
    }
    Ok(RawFrame::new(width, height, counts))
}

fn name_of(format: ImageFormat) -> String {
    match format {
        ImageFormat::OpenExr => "EXR".to_owned(),
        other => format!("{other:?}").to_uppercase(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{ImageBuffer, Luma, Rgb};

    #[test]
    fn counts_of_8_and_16_bits_are_read_as_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let deep = ImageBuffer::from_fn(5, 3, |x, y| Luma([(1000 * y + 7 * x) as u16]));
        let flat = ImageBuffer::from_fn(5, 3, |x, y| Luma([(10 * y + x) as u8]));
        for ending in ["png", "tif", "TIFF"] {
            let path = folder.path().join(format!("a.{ending}"));
            assert!(has_raw_ending(&path));
            deep.save_with_format(&path, ImageFormat::from_path(&path).unwrap())
                .unwrap();
            let frame = read(&path, [5, 3], 12).unwrap();
            assert_eq!((frame.width, frame.height), (5, 3));
            assert_eq!(frame.counts, *deep.as_raw(), "{ending}");
            let path = folder.path().join(format!("b.{ending}"));
            flat.save_with_format(&path, ImageFormat::from_path(&path).unwrap())
                .unwrap();
            let counts: Vec<u16> = flat.as_raw().iter().map(|&c| c.into()).collect();
            assert_eq!(read(&path, [5, 3], 8).unwrap().counts, counts, "{ending}");
        }
        assert!(!has_raw_ending(Path::new("a.jpg")) && !has_raw_ending(Path::new("png")));
    }

    #[test]
    fn what_is_no_raw_frame_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let fault = |bits| read(&path, [5, 3], bits).unwrap_err().to_string();
        assert!(fault(12).contains("a.png: No such file"));
        for (fact, special) in [
            ("it is a named pipe, not a regular file", "p"),
            ("Is a directory (os error 21)", "d"),
            ("it is a device, not a regular file", "l"),
        ] {
            let made = match special {
                "p" => rustix::fs::mkfifoat(rustix::fs::CWD, &path, 0o600.into())
                    .map_err(std::io::Error::from),
                "d" => std::fs::create_dir(&path),
                _ => std::os::unix::fs::symlink("/dev/zero", &path),
            };
            made.unwrap();
            assert_eq!(fault(12), format!("a.png: {fact}"));
            std::fs::remove_file(&path)
                .or_else(|_| std::fs::remove_dir(&path))
                .unwrap();
        }
        std::fs::write(&path, "no image").unwrap();
        assert_eq!(fault(12), "a.png: it is neither PNG nor TIFF nor JPEG");
        ImageBuffer::from_pixel(5, 3, Rgb([1_u8, 2, 3]))
            .save(&path)
            .unwrap();
        assert_eq!(
            fault(12),
            "a.png holds no raw counts: it is in colour, with all channels at every pixel"
        );
        let jpeg = ImageBuffer::from_pixel(5, 3, Luma([9_u8]));
        jpeg.save_with_format(&path, ImageFormat::Jpeg).unwrap();
        assert_eq!(fault(12), "a.png holds no raw counts: it is a JPEG file");
        for (bytes, name) in [
            (&b"BM\x36\0\0\0"[..], "BMP"),
            (b"\x76\x2f\x31\x01\x02\0\0\0", "EXR"),
            (b"RIFF\x10\0\0\0WEBPVP8 ", "WEBP"),
        ] {
            std::fs::write(&path, bytes).unwrap();
            assert!(
                fault(12).ends_with(&format!("it is a {name} file")),
                "{name}: {}",
                fault(12)
            );
        }
        ImageBuffer::from_pixel(3, 5, Luma([1_u16]))
            .save(&path)
            .unwrap();
        assert_eq!(
            fault(12),
            "it has 15 counts in 3 × 5 pixels instead of 5 × 3"
        );
        ImageBuffer::from_pixel(5, 3, Luma([1024_u16]))
            .save(&path)
            .unwrap();
        assert_eq!(fault(10), "a.png: pixel (0, 0) is 1024, more than 10 bits");
        assert!(read(&path, [5, 3], 11).is_ok());
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() - 20]).unwrap();
        assert!(fault(11).starts_with("a.png: "), "{}", fault(11));
    }
}
