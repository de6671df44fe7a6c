//! Writing radiance images: whole ones, and such as are made from the top, some rows at a time.

use std::io::{Cursor, Seek, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use exr::block::writer::{ChunkWriter, ParallelBlocksCompressor, SequentialBlocksCompressor};
use exr::block::{BlockIndex, UncompressedBlock};
use exr::image::Encoding;
use exr::meta::attribute::{ChannelDescription, LineOrder, SampleType, Text};
use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::SmallVec;

use super::{COLOURS, ExrError, MASK, VARIANCES, io_error};
use crate::radiance_image::RadianceImage;
use crate::whole_file;

/// Writes a radiance image: to a temporary file in the same folder, which then
/// takes the name, so that no reader ever sees half a file.
///
/// # Errors
/// The image's parts differ in size, or the system refuses.
pub fn write(path: &Path, image: &RadianceImage) -> Result<(), ExrError> {
    let bytes = encode(image, path)?;
    whole_file::replace(path, |out| out.write_all(&bytes)).map_err(|source| io_error(path, source))
}

/// The bytes of the file that [`write()`] makes; `path` is for messages.
///
/// # Errors
/// The image is empty or its parts differ in size.
pub fn encode(image: &RadianceImage, path: &Path) -> Result<Vec<u8>, ExrError> {
    let (width, height) = (image.width, image.height);
    let same = [image.mean.len(), image.variance.len(), image.valid.len()]
        .iter()
        .all(|&n| n == width * height);
    if !same || width * height == 0 {
        return Err(inconsistent(path, [width, height], image));
    }
    let mut next = 0;
    encode_rows(path, [width, height], || {
        let rows = next..height.min(next + 64);
        next = rows.end;
        Ok(image.rows(rows))
    })
}

/// The bytes of the file that [`write_rows`] makes of an image of this width and height;
/// `path` is for messages.
///
/// # Errors
/// As [`write_rows`].
pub fn encode_rows<E: From<ExrError>>(
    path: &Path,
    size: [usize; 2],
    next_rows: impl FnMut() -> Result<RadianceImage, E>,
) -> Result<Vec<u8>, E> {
    let mut bytes = Cursor::new(Vec::new());
    put_rows(&mut bytes, path, size, next_rows)?;
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
    next_rows: impl FnMut() -> Result<RadianceImage, E>,
) -> Result<(), E> {
    let mut failed = None;
    let written = whole_file::replace(path, |out| {
        put_rows(out, path, [width, height], next_rows).map_err(|error| {
            failed = Some(error);
            std::io::ErrorKind::Other.into()
        })
    });
    match (failed, written) {
        (Some(error), _) => Err(error),
        (None, Err(source)) => Err(io_error(path, source).into()),
        (None, Ok(())) => Ok(()),
    }
}

/// Writes the whole file, its blocks compressed by as many threads as there are
/// processors.
fn put_rows<E: From<ExrError>>(
    out: impl Write + Seek,
    path: &Path,
    size: [usize; 2],
    next_rows: impl FnMut() -> Result<RadianceImage, E>,
) -> Result<(), E> {
    let [width, height] = size;
    // The header.
    let mut names: Vec<&'static str> = [&COLOURS[..], &VARIANCES, &[MASK]].concat();
    names.sort_unstable(); // as the format has it
    let channels = names
        .iter()
        .map(|name| ChannelDescription::named(*name, SampleType::F32));
    let header = Header::new(Text::from("radiance"), (width, height), channels.collect())
        .with_encoding(
            Encoding::SMALL_LOSSLESS.compression,
            BlockDescription::ScanLines,
            LineOrder::Increasing,
        );
    // Blocks in the order of the file, compressed by all processors where that is possible.
    let mut rows = RowQueue {
        next_rows,
        path,
        size,
        first: 0,
        held: RadianceImage::new(width, 0),
    };
    let mut failed = None;
    let blocks = |meta: MetaData, chunks: &mut ChunkWriter<_>| {
        let list = &meta.headers[0].channels;
        let mut block_of = |position: BlockIndex| -> exr::error::Result<UncompressedBlock> {
            let end = position.pixel_position.1 + position.pixel_size.1;
            rows.advance(position.pixel_position.1..end)
                .map_err(|error| {
                    failed = Some(error);
                    exr::error::Error::Aborted
                })?;
            Ok(UncompressedBlock::from_lines(list, position, |line| {
                let at = (line.location.position.1 - rows.first) * width;
                let name = names[line.location.channel];
                let samples = line.write_samples(|x| sample(&rows.held, at + x, name));
                debug_assert!(samples.is_ok(), "a line of the block's own length");
            }))
        };
        let positions = exr::block::enumerate_ordered_header_block_indices(&meta.headers);
        if let Some(mut compressor) = ParallelBlocksCompressor::new(&meta, chunks) {
            for (index, position) in positions {
                compressor.add_block_to_compression_queue(index, block_of(position)?)?;
            }
        } else {
            let mut compressor = SequentialBlocksCompressor::new(&meta, chunks);
            for (index, position) in positions {
                compressor.compress_block(index, block_of(position)?)?;
            }
        }
        Ok(())
    };
    let written = exr::block::write(out, SmallVec::from_iter([header]), true, blocks);
    match (failed, written) {
        (Some(error), _) => Err(error),
        (None, Err(exr::error::Error::Io(source))) => Err(io_error(path, source).into()),
        (None, Err(error)) => Err(io_error(path, std::io::Error::other(error)).into()),
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
struct RowQueue<'a, F> {
    next_rows: F,
    path: &'a Path,
    size: [usize; 2],
    first: usize,
    held: RadianceImage,
}

impl<F> RowQueue<'_, F> {
    /// Drops the rows above these and fetches more until these are in memory.
    fn advance<E: From<ExrError>>(&mut self, rows: Range<usize>) -> Result<(), E>
    where
        F: FnMut() -> Result<RadianceImage, E>,
    {
        while self.first + self.held.height < rows.end {
            let more = (self.next_rows)()?;
            if more.width != self.held.width || more.height == 0 {
                return Err(inconsistent(self.path, self.size, &more).into());
            }
            let above = (rows.start - self.first).min(self.held.height);
            let mut held = self.held.rows(above..self.held.height);
            self.first += above;
            held.extend(&more, 0..more.height);
            self.held = held;
        }
        Ok(())
    }
}

fn inconsistent(path: &Path, [width, height]: [usize; 2], parts: &RadianceImage) -> ExrError {
    ExrError::Inconsistent {
        file: PathBuf::from(path),
        width,
        height,
        mean: parts.mean.len(),
        variance: parts.variance.len(),
        valid: parts.valid.len(),
    }
}
