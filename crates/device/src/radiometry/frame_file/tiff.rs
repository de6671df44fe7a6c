//! Frames as TIFF and BigTIFF files, their counts as they are: strips or tiles, in one plane or
//! several, of either byte order, without compression or with LZW, Deflate or PackBits.

use std::collections::HashSet;
use std::io::Cursor;

use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{CompressionMethod, IfdPointer, Tag};
use tiff::{Directory, TiffError, TiffUnsupportedError};

use super::{FrameFile, FrameFileError, Tone, check_size, most_bytes, planes};

type Reader<'a> = Decoder<Cursor<&'a [u8]>>;

/// The version of a digital negative.
const DNG_VERSION: Tag = Tag::Unknown(50706);
/// Bits of NewSubfileType: a smaller copy of another image, a mask of one.
const REDUCED_OR_MASK: u32 = 0b101;
/// Photometric interpretations by number.
const COLOURS: [(u16, &str); 12] = [
    (0, "grey"),
    (1, "grey"),
    (2, "red, green, blue"),
    (3, "numbers of the colours in a palette"),
    (4, "a mask"),
    (5, "CMYK"),
    (6, "YCbCr"),
    (8, "CIE L*a*b*"),
    (9, "CIE L*a*b*"),
    (10, "CIE L*a*b*"),
    (32844, "LogL"),
    (32845, "LogLuv"),
];
/// The interpretation of a sensor's mosaic in a camera's raw file.
const MOSAIC: u16 = 32803;

/// Decodes a TIFF of one page of grey or RGB counts of 8 to 16 bits. Smaller copies and masks of
/// the page don't count as pages.
pub(super) fn decode(bytes: &[u8], size: Option<[usize; 2]>) -> Result<FrameFile, FrameFileError> {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = most_bytes(bytes) as usize;
    limits.intermediate_buffer_size = most_bytes(bytes) as usize;
    limits.ifd_value_size = bytes.len();
    let mut reader = Decoder::new(Cursor::new(bytes))
        .map_err(refused)?
        .with_limits(limits);
    seek_to_the_page(&mut reader)?;
    let (width, height) = reader.dimensions().map_err(refused)?;
    let [width, height] = [width as usize, height as usize];
    check_size([width, height], size)?;
    let layout = Layout::of(&mut reader)?;
    let planes = match layout.bits {
        8 | 16 => whole_samples(&mut reader, layout.channels, width * height)?,
        _ => packed_samples(&mut reader, &layout, bytes, [width, height])?,
    };
    let tone = match layout.compression {
        CompressionMethod::ModernJPEG | CompressionMethod::JPEG => Tone::Jpeg,
        _ => Tone::Unstated,
    };
    Ok(FrameFile {
        width,
        height,
        bits: layout.bits,
        planes,
        tone,
    })
}

/// Goes to the only page, past smaller copies and masks.
fn seek_to_the_page(reader: &mut Reader) -> Result<(), FrameFileError> {
    if unsigned(reader, DNG_VERSION).is_some() {
        return Err(FrameFileError::CameraRaw("DNG"));
    }
    let directories = directories(reader)?;
    let mut pages = Vec::new();
    for (index, directory) in directories.iter().enumerate() {
        let mut value = |tag| -> Option<u32> {
            let mut tags = reader.read_directory_tags(directory);
            tags.find_tag_unsigned(tag).ok().flatten()
        };
        let kind = value(Tag::NewSubfileType).unwrap_or(0);
        let size = [Tag::ImageWidth, Tag::ImageLength].map(|tag| value(tag).unwrap_or(0));
        if kind & REDUCED_OR_MASK == 0 && value(Tag::SubfileType) != Some(2) {
            pages.push((index, size));
        }
    }
    let has_inner = directories.iter().any(|d| d.contains(Tag::SubIfd));
    match pages[..] {
        [] if has_inner => return Err(FrameFileError::CameraRaw("such as NEF or ARW")),
        [] => {}
        [(index, _)] => reader.seek_to_image(index).map_err(refused)?,
        [(_, first), ..] => {
            let same = pages.iter().all(|(_, size)| *size == first);
            let of = if same { "each of " } else { "the first of " };
            return Err(FrameFileError::Pages {
                count: pages.len(),
                what: "pages",
                sizes: format!("{of}{} x {} pixels", first[0], first[1]),
            });
        }
    }
    let stack = images_of_imagej(reader);
    if stack > 1 {
        return Err(FrameFileError::Pages {
            count: stack,
            what: "images of an ImageJ stack",
            sizes: "in one page".into(),
        });
    }
    Ok(())
}

/// The chain of directories, each once.
fn directories(reader: &mut Reader) -> Result<Vec<Directory>, FrameFileError> {
    let mut seen = HashSet::new();
    let mut directories = Vec::new();
    let mut next: Option<IfdPointer> = reader.ifd_pointer();
    while let Some(pointer) = next.filter(|pointer| seen.insert(pointer.0)) {
        let directory = reader.read_directory(pointer).map_err(refused)?;
        next = directory.next();
        directories.push(directory);
    }
    Ok(directories)
}

/// ImageJ keeps large stacks as one page, and states in its description how many images it is.
fn images_of_imagej(reader: &mut Reader) -> usize {
    let text = reader.get_tag_ascii_string(Tag::ImageDescription);
    let text = text.unwrap_or_default();
    let mut lines = text.lines().filter(|_| text.starts_with("ImageJ="));
    let images = lines.find_map(|line| line.strip_prefix("images="));
    images.and_then(|n| n.trim().parse().ok()).unwrap_or(1)
}

/// How the samples lie.
struct Layout {
    bits: u32,
    channels: usize,
    compression: CompressionMethod,
}

impl Layout {
    /// Refuses all but grey and RGB counts, by what they are.
    fn of(reader: &mut Reader) -> Result<Self, FrameFileError> {
        let mut list = |tag| -> Vec<u16> {
            let found = reader.find_tag_unsigned_vec::<u16>(tag).ok().flatten();
            found.unwrap_or_default()
        };
        let first = |values: &[u16], default| values.first().copied().unwrap_or(default);
        let bits = first(&list(Tag::BitsPerSample), 1);
        let channels = first(&list(Tag::SamplesPerPixel), 1);
        let photometric = first(&list(Tag::PhotometricInterpretation), 1);
        let compression = first(&list(Tag::Compression), 1);
        let is_signed_or_float = first(&list(Tag::SampleFormat), 1);
        let extra = list(Tag::ExtraSamples);
        let lowest_bit_first = first(&list(Tag::FillOrder), 1) == 2;

        let colour = COLOURS.iter().find(|(number, _)| *number == photometric);
        let colour = colour.map_or("colours", |(_, words)| words);
        let alpha = match extra[..] {
            [] | [0, ..] => "one more",
            _ => "alpha",
        };
        let bare = match photometric {
            0 | 1 => 1,
            2 => 3,
            _ => 0,
        };
        let what = match is_signed_or_float {
            _ if photometric == MOSAIC => return Err(FrameFileError::CameraRaw("TIFF/EP")),
            _ if bare == 0 && channels == 1 => format!("{bits}-bit samples ({colour})"),
            _ if bare == 0 => format!("{channels} samples per pixel ({colour})"),
            _ if channels == bare + 1 => {
                format!("{channels} samples per pixel ({colour} and {alpha})")
            }
            _ if channels != bare => {
                format!(
                    "{channels} samples per pixel ({colour} and {} more)",
                    channels.saturating_sub(bare)
                )
            }
            2 => format!("signed {bits}-bit samples"),
            3 => format!("floating-point {bits}-bit samples"),
            _ if !(8..=16).contains(&bits) => format!("{bits}-bit samples"),
            _ if lowest_bit_first => format!("{bits}-bit samples, the lowest bit first"),
            _ => {
                return Ok(Self {
                    bits: bits.into(),
                    channels: channels.into(),
                    compression: CompressionMethod::from_u16_exhaustive(compression),
                });
            }
        };
        Err(FrameFileError::Samples(what))
    }
}

/// Samples of 8 or 16 bits, interleaved or in planes.
fn whole_samples(
    reader: &mut Reader,
    channels: usize,
    pixels: usize,
) -> Result<Vec<Vec<u16>>, FrameFileError> {
    let mut samples = DecodingResult::U8(Vec::new());
    let layout = reader.read_image_to_buffer(&mut samples).map_err(refused)?;
    let (interleaved, found) = match samples {
        DecodingResult::U8(samples) => (samples.iter().map(|&s| s.into()).collect(), samples.len()),
        DecodingResult::U16(samples) => {
            let found = samples.len();
            (samples, found)
        }
        _ => return Err(FrameFileError::damaged("its samples are no counts")),
    };
    if found < channels * pixels {
        return Err(FrameFileError::damaged("it has fewer samples than pixels"));
    }
    Ok(match layout.planes {
        1 => planes(interleaved, channels),
        _ => interleaved
            .chunks(pixels)
            .take(channels)
            .map(<[u16]>::to_vec)
            .collect(),
    })
}

/// Samples of 9 to 15 bits, one after the other from the highest bit of a byte on, each row from
/// a new byte on.
fn packed_samples(
    reader: &mut Reader,
    layout: &Layout,
    bytes: &[u8],
    [width, height]: [usize; 2],
) -> Result<Vec<Vec<u16>>, FrameFileError> {
    let bits = layout.bits as usize;
    let offsets = reader
        .find_tag_unsigned_vec::<u64>(Tag::StripOffsets)
        .ok()
        .flatten();
    let planar = unsigned(reader, Tag::PlanarConfiguration).unwrap_or(1) != 1;
    let (Some(offsets), CompressionMethod::None, false) = (offsets, layout.compression, planar)
    else {
        let what = format!("packed {bits}-bit samples that are compressed, in tiles or in planes");
        return Err(FrameFileError::Samples(what));
    };
    let row_samples = width * layout.channels;
    let row_bytes = (row_samples * bits).div_ceil(8);
    let rows_per_strip = unsigned(reader, Tag::RowsPerStrip).unwrap_or(u32::MAX) as usize;
    let mut samples = Vec::new();
    for y in 0..height {
        let strip = offsets
            .get(y / rows_per_strip.max(1))
            .copied()
            .unwrap_or(u64::MAX) as usize;
        let begin = strip.saturating_add(y % rows_per_strip.max(1) * row_bytes);
        let row = bytes.get(begin..begin.saturating_add(row_bytes));
        let row = row.ok_or_else(|| FrameFileError::damaged("it ends before its image does"))?;
        samples.extend((0..row_samples).map(|n| packed(row, n * bits, bits)));
    }
    Ok(planes(samples, layout.channels))
}

/// The number in `bits` bits (at most 16) from bit `at` on.
fn packed(row: &[u8], at: usize, bits: usize) -> u16 {
    let three = [0, 1, 2].map(|n| row.get(at / 8 + n).copied().unwrap_or(0));
    let word = u32::from_be_bytes([0, three[0], three[1], three[2]]);
    (word >> (24 - at % 8 - bits)) as u16 & ((1u32 << bits) - 1) as u16
}

fn unsigned(reader: &mut Reader, tag: Tag) -> Option<u32> {
    reader
        .find_tag_unsigned_vec(tag)
        .ok()
        .flatten()?
        .first()
        .copied()
}

/// What the decoder refuses, by what it is.
fn refused(error: TiffError) -> FrameFileError {
    use TiffUnsupportedError::{UnknownInterpretation, UnsupportedCompressionMethod};
    match error {
        TiffError::UnsupportedError(UnknownInterpretation) => FrameFileError::Samples(
            "samples of an unknown interpretation (a camera's mosaic, LogLuv, or none is stated)"
                .into(),
        ),
        TiffError::UnsupportedError(UnsupportedCompressionMethod(method)) => {
            FrameFileError::Compression(format!("{method:?}"))
        }
        error => FrameFileError::damaged(error),
    }
}
