//! Radiance images as OpenEXR files: channels `R`, `G`, `B`, their variances
//! `var.R`, `var.G`, `var.B`, and `mask` (1 where a pixel is valid), 32-bit
//! floats, compressed without loss.

use std::io::Cursor;
use std::ops::Range;
use std::path::{Path, PathBuf};

use exr::prelude::*;

use super::RadianceImage;
use crate::shown::{MESSAGE, shortened};
use crate::{outside_file, whole_file};

/// What a file says about radiance.
#[derive(Clone, Debug, PartialEq)]
pub struct RadianceFile {
    /// The image. Without variances in the file they are 0 here; without a mask
    /// every finite pixel is valid. Pixels that are not finite are invalid and 0.
    pub image: RadianceImage,
    /// Whether the file has the three variance channels.
    pub has_variance: bool,
}

/// A radiance image that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ExrError {
    /// The system refuses.
    #[error("{file}: {source}")]
    Io {
        /// The file.
        file: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// Not an OpenEXR file, or a damaged one.
    #[error("{file} is not a readable OpenEXR file: {problem}")]
    Format {
        /// The file.
        file: PathBuf,
        /// What the decoder says.
        problem: String,
    },
    /// Another size than that of the camera whose image it should be.
    #[error("{file} is {width} x {height} pixels; the camera's image is {} x {}", expected[0], expected[1])]
    OtherSize {
        /// The file.
        file: PathBuf,
        /// Its pixels per row.
        width: usize,
        /// Its rows.
        height: usize,
        /// The camera's pixels per row, and rows.
        expected: [usize; 2],
    },
    /// A size that the file's bytes cannot hold, or that no camera has.
    #[error(
        "{file} declares {width} x {height} pixels in {channels} channels, which its {bytes} bytes cannot hold (at most {MOST_PER_BYTE} pixels for each, and {MOST_PIXELS} in all)"
    )]
    Size {
        /// The file.
        file: PathBuf,
        /// Declared pixels per row.
        width: usize,
        /// Declared rows.
        height: usize,
        /// Declared channels.
        channels: usize,
        /// Length of the file.
        bytes: usize,
    },
    /// Channels from which no radiance can be had.
    #[error("{file} has the channels {found}, but {wanted} are needed")]
    Channels {
        /// The file.
        file: PathBuf,
        /// Those in the file, joined by commas.
        found: String,
        /// What is needed.
        wanted: &'static str,
    },
    /// An image whose parts differ in size.
    #[error(
        "{file}: {width} x {height} pixels, but {mean} means, {variance} variances and {valid} mask values"
    )]
    Inconsistent {
        /// The file to be written.
        file: PathBuf,
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Means.
        mean: usize,
        /// Variances.
        variance: usize,
        /// Mask values.
        valid: usize,
    },
}

const COLOURS: [&str; 3] = ["R", "G", "B"];
const VARIANCES: [&str; 3] = ["var.R", "var.G", "var.B"];
const MASK: &str = "mask";

/// Most bytes that one byte becomes: by Deflate, and more than by the other methods.
const MAX_EXPANSION: usize = 1032;
/// Most pixels that a byte stands for where nobody knows the image's size: above the 37 of a
/// black image with variance and mask as [`write()`] writes it.
const MOST_PER_BYTE: usize = 64;
/// Images up to this many pixels may be better compressed than that: a few dozen megabytes.
const SMALL_PIXELS: usize = 1 << 20;
/// Most pixels of an image whose size nobody knows.
const MOST_PIXELS: usize = 1 << 28;
/// Largest file, bytes: that many pixels of seven floats.
const MOST_BYTES: u64 = 7 << 30;

/// Reads a radiance image. A file with `Y` instead of `R`, `G`, `B` is grey;
/// other channels are ignored.
///
/// # Errors
/// The file cannot be read, is damaged, declares more than it can hold, or
/// lacks channels.
pub fn read(path: &Path) -> std::result::Result<RadianceFile, ExrError> {
    decode(&bytes_of(path)?, path)
}

/// [`read`] for an image of this width and height; the size is compared before
/// anything is decoded.
///
/// # Errors
/// As [`read`]; another size.
pub fn read_sized(path: &Path, size: [usize; 2]) -> std::result::Result<RadianceFile, ExrError> {
    decode_sized(&bytes_of(path)?, path, size)
}

fn bytes_of(path: &Path) -> std::result::Result<Vec<u8>, ExrError> {
    outside_file::read_regular(path, MOST_BYTES).map_err(|source| io_error(path, source))
}

/// Reads a radiance image from a file's bytes; `path` is for messages.
///
/// # Errors
/// As [`read`].
pub fn decode(bytes: &[u8], path: &Path) -> std::result::Result<RadianceFile, ExrError> {
    decode_within(bytes, path, None)
}

/// [`decode`] for an image of this width and height.
///
/// # Errors
/// As [`read_sized`].
pub fn decode_sized(
    bytes: &[u8],
    path: &Path,
    size: [usize; 2],
) -> std::result::Result<RadianceFile, ExrError> {
    decode_within(bytes, path, Some(size))
}

fn decode_within(
    bytes: &[u8],
    path: &Path,
    expected: Option<[usize; 2]>,
) -> std::result::Result<RadianceFile, ExrError> {
    let format_error = |error: Error| ExrError::Format {
        file: path.to_owned(),
        problem: error.to_string(),
    };
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), true).map_err(format_error)?;
    for header in &meta.headers {
        let Vec2(width, height) = header.layer_size;
        if let Some(expected) = expected.filter(|&expected| expected != [width, height]) {
            return Err(ExrError::OtherSize {
                file: path.to_owned(),
                width,
                height,
                expected,
            });
        }
        let channels = header.channels.list.len();
        let sample_bytes: usize = header.channels.list.iter().map(sample_bytes).sum();
        let fits = |Vec2(width, height): Vec2<usize>| {
            let pixels = width.checked_mul(height)?;
            let held = pixels.checked_mul(sample_bytes)? / MAX_EXPANSION <= bytes.len();
            let dense = pixels <= SMALL_PIXELS.max(MOST_PER_BYTE * bytes.len());
            (held && (expected.is_some() || dense && pixels <= MOST_PIXELS)).then_some(())
        };
        let tile = match header.blocks {
            exr::meta::BlockDescription::ScanLines => Vec2(1, 1),
            exr::meta::BlockDescription::Tiles(tiles) => tiles.tile_size,
        };
        if fits(header.layer_size).is_none() || fits(tile).is_none() {
            return Err(ExrError::Size {
                file: path.to_owned(),
                width,
                height,
                channels,
                bytes: bytes.len(),
            });
        }
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .pedantic()
        .from_buffered(Cursor::new(bytes))
        .map_err(format_error)?;
    from_layer(image.layer_data, path)
}

fn sample_bytes(channel: &ChannelDescription) -> usize {
    channel.sample_type.bytes_per_sample()
}

fn from_layer(
    layer: Layer<AnyChannels<FlatSamples>>,
    path: &Path,
) -> std::result::Result<RadianceFile, ExrError> {
    let Vec2(width, height) = layer.size;
    let list = &layer.channel_data.list;
    let samples = |name: &str| -> Option<Vec<f32>> {
        let channel = list.iter().find(|c| c.name == *name)?;
        let values: Vec<f32> = channel.sample_data.values_as_f32().collect();
        (channel.sampling == Vec2(1, 1) && values.len() == width * height).then_some(values)
    };
    let three = |names: [&str; 3], grey: &str| -> Option<Vec<Vec<f32>>> {
        let colours: Option<Vec<_>> = names.into_iter().map(samples).collect();
        colours.or_else(|| Some(vec![samples(grey)?]))
    };
    // Of a channel and a pixel; grey has one plane for all.
    let value =
        |planes: &[Vec<f32>], c: usize, pixel: usize| planes[c.min(planes.len() - 1)][pixel];
    let colours = three(COLOURS, "Y");
    let Some(colours) = colours else {
        let names: Vec<String> = list.iter().map(|c| c.name.to_string()).collect();
        return Err(ExrError::Channels {
            file: path.to_owned(),
            found: shortened(&names.join(", "), MESSAGE).into_owned(),
            wanted: "R, G, B (or Y), at full resolution,",
        });
    };
    let variances = three(VARIANCES, "var.Y");
    let mask = samples(MASK);

    let mut image = RadianceImage::new(width, height);
    for pixel in 0..width * height {
        let mean = [0, 1, 2].map(|c| value(&colours, c, pixel));
        let variance = variances
            .as_ref()
            .map_or([0.0; 3], |v| [0, 1, 2].map(|c| value(v, c, pixel)));
        let good = mean.iter().all(|x| x.is_finite())
            && variance.iter().all(|x| x.is_finite() && *x >= 0.0);
        if good {
            image.mean[pixel] = mean;
            image.variance[pixel] = variance;
        }
        image.valid[pixel] = good && mask.as_ref().is_none_or(|m| m[pixel] > 0.5);
    }
    Ok(RadianceFile {
        image,
        has_variance: variances.is_some(),
    })
}

/// Writes a radiance image: to a temporary file in the same folder, which then
/// takes the name, so that no reader ever sees half a file.
///
/// # Errors
/// The image's parts differ in size, or the system refuses.
pub fn write(path: &Path, image: &RadianceImage) -> std::result::Result<(), ExrError> {
    let bytes = encode(image, path)?;
    whole_file::replace(path, |out| out.write_all(&bytes)).map_err(|source| io_error(path, source))
}

/// The bytes of the file that [`write()`] makes; `path` is for messages.
///
/// # Errors
/// The image is empty or its parts differ in size.
pub fn encode(image: &RadianceImage, path: &Path) -> std::result::Result<Vec<u8>, ExrError> {
    let pixels = image.width * image.height;
    let same = [image.mean.len(), image.variance.len(), image.valid.len()]
        .iter()
        .all(|&n| n == pixels);
    if !same || pixels == 0 {
        return Err(ExrError::Inconsistent {
            file: path.to_owned(),
            width: image.width,
            height: image.height,
            mean: image.mean.len(),
            variance: image.variance.len(),
            valid: image.valid.len(),
        });
    }
    let channel = |name: &str, values: Vec<f32>| AnyChannel::new(name, FlatSamples::F32(values));
    let mut channels = SmallVec::new();
    for c in 0..3 {
        channels.push(channel(
            COLOURS[c],
            image.mean.iter().map(|m| m[c]).collect(),
        ));
        let variance = image.variance.iter().map(|v| v[c]).collect();
        channels.push(channel(VARIANCES[c], variance));
    }
    let mask = image.valid.iter().map(|&v| f32::from(u8::from(v)));
    channels.push(channel(MASK, mask.collect()));
    let layer = Layer::new(
        (image.width, image.height),
        LayerAttributes::default(),
        Encoding::SMALL_LOSSLESS,
        AnyChannels::sort(channels),
    );
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer)
        .write()
        .to_buffered(&mut bytes)
        .map_err(|error| ExrError::Format {
            file: path.to_owned(),
            problem: error.to_string(),
        })?;
    Ok(bytes.into_inner())
}

/// Writes a radiance image that is made from the top, some rows at a time, so
/// that only those are in memory; as [`write()`], the file appears whole.
/// `next_rows` gives images of this width, `height` rows in all.
///
/// # Errors
/// What `next_rows` returns; rows of another width or too few; the system refuses.
pub fn write_rows<E: From<ExrError>>(
    path: &Path,
    width: usize,
    height: usize,
    next_rows: impl FnMut() -> std::result::Result<RadianceImage, E>,
) -> std::result::Result<(), E> {
    let mut names: Vec<&'static str> = [&COLOURS[..], &VARIANCES, &[MASK]].concat();
    names.sort_unstable(); // as the format has it
    let channels = names
        .iter()
        .map(|name| ChannelDescription::named(*name, SampleType::F32));
    let encoding = Encoding::SMALL_LOSSLESS;
    let header =
        exr::meta::header::Header::new(Text::from("radiance"), (width, height), channels.collect())
            .with_encoding(
                encoding.compression,
                exr::meta::BlockDescription::ScanLines,
                LineOrder::Increasing,
            );
    let mut rows = RowQueue {
        next_rows,
        first: 0,
        held: RadianceImage::new(width, 0),
    };
    let mut failed = None;
    let written = whole_file::replace(path, |out| {
        let blocks = |meta: MetaData, chunks: &mut exr::block::writer::ChunkWriter<_>| {
            let list = &meta.headers[0].channels;
            let mut compressor = exr::block::writer::SequentialBlocksCompressor::new(&meta, chunks);
            for (index, block) in exr::block::enumerate_ordered_header_block_indices(&meta.headers)
            {
                let end = block.pixel_position.1 + block.pixel_size.1;
                rows.advance(block.pixel_position.1..end).map_err(|error| {
                    failed = Some(error);
                    Error::Aborted
                })?;
                let block = exr::block::UncompressedBlock::from_lines(list, block, |line| {
                    let at = (line.location.position.1 - rows.first) * width;
                    let name = names[line.location.channel];
                    let samples = line.write_samples(|x| sample(&rows.held, at + x, name));
                    debug_assert!(samples.is_ok(), "a line of the block's own length");
                });
                compressor.compress_block(index, block)?;
            }
            Ok(())
        };
        exr::block::write(out, SmallVec::from_iter([header]), true, blocks)
            .map_err(std::io::Error::other)
    });
    match (failed, written) {
        (Some(error), _) => Err(error),
        (None, Err(source)) => Err(io_error(path, source).into()),
        (None, Ok(())) => Ok(()),
    }
}

/// One channel of one pixel.
fn sample(image: &RadianceImage, pixel: usize, name: &str) -> f32 {
    let colour = |names: &[&str; 3]| names.iter().position(|n| *n == name);
    if let Some(c) = colour(&COLOURS) {
        image.mean[pixel][c]
    } else if let Some(c) = colour(&VARIANCES) {
        image.variance[pixel][c]
    } else {
        f32::from(u8::from(image.valid[pixel]))
    }
}

/// The rows that the next block needs.
struct RowQueue<F> {
    next_rows: F,
    first: usize,
    held: RadianceImage,
}

impl<F> RowQueue<F> {
    /// Forgets the rows above these and asks for more until these are held.
    fn advance<E: From<ExrError>>(&mut self, rows: Range<usize>) -> std::result::Result<(), E>
    where
        F: FnMut() -> std::result::Result<RadianceImage, E>,
    {
        while self.first + self.held.height < rows.end {
            let more = (self.next_rows)()?;
            if more.width != self.held.width || more.height == 0 {
                return Err(ExrError::Inconsistent {
                    file: PathBuf::new(),
                    width: self.held.width,
                    height: rows.end,
                    mean: more.mean.len(),
                    variance: more.variance.len(),
                    valid: more.valid.len(),
                }
                .into());
            }
            let above = (rows.start - self.first).min(self.held.height);
            let mut held = self.held.rows(above..self.held.height);
            self.first += above;
            held.height += more.height;
            held.mean.extend(more.mean);
            held.variance.extend(more.variance);
            held.valid.extend(more.valid);
            self.held = held;
        }
        Ok(())
    }
}

fn io_error(path: &Path, source: std::io::Error) -> ExrError {
    ExrError::Io {
        file: path.to_owned(),
        source,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::{any, prop_assert, prop_assert_eq, proptest};

    fn picture(width: usize, height: usize) -> RadianceImage {
        let mut image = RadianceImage::new(width, height);
        for p in 0..width * height {
            let x = p as f32;
            image.mean[p] = [x * 0.1 - 0.3, (x * 1.7).sin() * 1e-6, 1e5 / (x + 1.0)];
            image.variance[p] = [1e-9 * x, 0.5, x * x];
            image.valid[p] = p % 7 != 3;
        }
        image
    }

    #[test]
    fn what_was_written_is_read_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("radiance_L000.exr");
        let image = picture(37, 21);
        write(&path, &image).unwrap();
        write(&path, &image).unwrap();
        let back = read(&path).unwrap();
        assert_eq!(back.image, image);
        assert!(back.has_variance);
        let files = std::fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(files, 1, "no temporary file is left");
    }

    #[test]
    fn rows_written_one_after_the_other_make_the_same_image() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.exr");
        let image = picture(19, 83);
        for step in [1, 7, 40, 83] {
            let mut at = 0;
            write_rows(&path, 19, 83, || {
                let rows = at..(at + step).min(83);
                at = rows.end;
                Ok::<_, ExrError>(image.rows(rows))
            })
            .unwrap();
            assert_eq!(read(&path).unwrap().image, image, "{step} rows at a time");
        }
        let before = std::fs::read(&path).unwrap();
        let error = write_rows(&path, 19, 83, || Ok::<_, ExrError>(picture(18, 2))).unwrap_err();
        assert!(matches!(error, ExrError::Inconsistent { .. }), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), before, "the old file stays");
    }

    fn bytes_of(channels: &[(&str, Vec<f32>)], size: (usize, usize)) -> Vec<u8> {
        let list = channels
            .iter()
            .map(|(name, values)| AnyChannel::new(*name, FlatSamples::F32(values.clone())))
            .collect();
        let mut bytes = Cursor::new(Vec::new());
        Image::from_channels(size, AnyChannels::sort(list))
            .write()
            .to_buffered(&mut bytes)
            .unwrap();
        bytes.into_inner()
    }

    #[test]
    fn a_single_channel_is_grey_of_unknown_variance() {
        let bytes = bytes_of(&[("Y", vec![1.0, 2.0, f32::NAN, -4.0])], (2, 2));
        let file = decode(&bytes, Path::new("y.exr")).unwrap();
        assert!(!file.has_variance);
        assert_eq!(file.image.mean[3], [-4.0; 3]);
        assert_eq!(file.image.valid, [true, true, false, true]);
        assert_eq!(file.image.mean[2], [0.0; 3]);
    }

    #[test]
    fn missing_channels_are_named() {
        let bytes = bytes_of(&[("R", vec![1.0]), ("B", vec![1.0])], (1, 1));
        let message = decode(&bytes, Path::new("rb.exr")).unwrap_err().to_string();
        assert!(
            message.contains("rb.exr has the channels B, R, but"),
            "{message}"
        );
    }

    #[test]
    fn missing_and_foreign_files_are_told_apart() {
        let error = read(Path::new("/nonexistent/x.exr")).unwrap_err();
        assert!(matches!(error, ExrError::Io { .. }), "{error}");
        let error = decode(b"\x89PNG and so on", Path::new("x.exr")).unwrap_err();
        assert!(matches!(error, ExrError::Format { .. }), "{error}");
    }

    /// Only the declared window of a small file is changed, to 2^30 x 2^30.
    #[test]
    fn a_declared_size_beyond_the_file_is_refused_before_memory_is_taken() {
        let mut bytes = encode(&picture(8, 8), Path::new("x.exr")).unwrap();
        let key = b"dataWindow\0box2i\0";
        let at = bytes.windows(key.len()).position(|w| w == key).unwrap() + key.len() + 4;
        bytes[at + 8..at + 12].copy_from_slice(&(1i32 << 30).to_le_bytes());
        bytes[at + 12..at + 16].copy_from_slice(&(1i32 << 30).to_le_bytes());
        let error = decode(&bytes, Path::new("x.exr")).unwrap_err();
        assert!(
            matches!(error, ExrError::Size { .. } | ExrError::Format { .. }),
            "{error}"
        );
    }

    proptest! {
        /// Any bytes changed, any length cut: an image or an error, never a panic.
        #[test]
        fn damaged_files_never_panic(
            changes in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..12),
            keep in any::<proptest::sample::Index>(),
            cut in any::<bool>(),
        ) {
            let mut bytes = encode(&picture(9, 20), Path::new("x.exr")).unwrap();
            for (at, value) in changes {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            if cut {
                bytes.truncate(keep.index(bytes.len()));
            }
            if let Ok(file) = decode(&bytes, Path::new("x.exr")) {
                let pixels = file.image.width * file.image.height;
                prop_assert!(pixels <= SMALL_PIXELS.max(MOST_PER_BYTE * bytes.len()));
                prop_assert_eq!(file.image.mean.len(), pixels);
            }
        }
    }
}
