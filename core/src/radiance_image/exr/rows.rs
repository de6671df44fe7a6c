//! The rows of a radiance image from the top, of which only a few are in memory.

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use exr::block::UncompressedBlock;
use exr::block::chunk::Chunk;
use exr::math::Vec2;
use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData};

use super::layers::{self, Layer};
use super::planes::{Planes, drop_meaningless, sample_bytes};
use super::window::{Window, size_error};
use super::{ExrError, MAX_EXPANSION, MOST_BYTES, OtherKind, io_error};
use crate::outside_file::open_regular;
use crate::radiance_image::RadianceImage;

/// A radiance image whose rows are read from the top, some at a time. What is in memory is
/// one row of the file's blocks (16 lines of the files that [`write()`](super::write())
/// makes, up to 256 of others, a tile's height of tiled ones), in whatever order they lie.
///
/// Opening it checks what [`check`](super::check) checks; after an error of
/// [`next_rows`](Self::next_rows) it is of no more use.
pub struct ExrRows<R = BufReader<File>> {
    file: PathBuf,
    source: R,
    bytes: u64,
    meta: MetaData,
    layer: Layer,
    planes: Planes,
    window: Window,
    /// Pixels per row of a block, and rows.
    block: [usize; 2],
    /// Where the blocks of full resolution begin, row of blocks after row of blocks.
    offsets: Vec<u64>,
    /// Rows that were decoded, and how many of them were handed out.
    band: RadianceImage,
    handed_out: usize,
    /// Where the next ones begin, rows of the image.
    next_row: usize,
}

impl ExrRows {
    /// Opens a regular file, of an image of this width and height where one is expected.
    ///
    /// # Errors
    /// As [`read`](super::read) and [`read_sized`](super::read_sized), but for what only
    /// decoding shows.
    pub fn open(path: &Path, expected: Option<[usize; 2]>) -> Result<Self, ExrError> {
        let (name, layer) = layers::split(path);
        let file = open_regular(&name).map_err(|source| io_error(path, source))?;
        Self::of_layer(file, path, layer.as_deref(), expected)
    }

    /// As [`open`](Self::open), of a file that is open at its beginning; `path` is for
    /// messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn of_file(
        file: File,
        path: &Path,
        expected: Option<[usize; 2]>,
    ) -> Result<Self, ExrError> {
        Self::of_layer(file, path, None, expected)
    }

    fn of_layer(
        file: File,
        path: &Path,
        layer: Option<&str>,
        expected: Option<[usize; 2]>,
    ) -> Result<Self, ExrError> {
        let length = file
            .metadata()
            .map_err(|source| io_error(path, source))?
            .len();
        if length > MOST_BYTES {
            let text = format!("it has {length} bytes, but at most {MOST_BYTES} are read");
            let error = std::io::Error::new(std::io::ErrorKind::FileTooLarge, text);
            return Err(io_error(path, error));
        }
        Self::new(
            BufReader::with_capacity(1 << 16, file),
            length,
            path,
            layer,
            expected,
        )
    }
}

impl<'a> ExrRows<Cursor<&'a [u8]>> {
    /// As [`ExrRows::open`], of a file's bytes; `path` is for messages.
    ///
    /// # Errors
    /// As [`ExrRows::open`].
    pub fn of_bytes(
        bytes: &'a [u8],
        path: &Path,
        expected: Option<[usize; 2]>,
    ) -> Result<Self, ExrError> {
        Self::new(Cursor::new(bytes), bytes.len() as u64, path, None, expected)
    }
}

impl<R: Read + Seek> ExrRows<R> {
    fn new(
        mut source: R,
        bytes: u64,
        path: &Path,
        layer: Option<&str>,
        expected: Option<[usize; 2]>,
    ) -> Result<Self, ExrError> {
        // What the file declares, against what it can hold.
        let meta = match MetaData::read_from_buffered(&mut source, true) {
            Ok(meta) => meta,
            Err(error) => return Err(read_error(&mut source, bytes, path, error)),
        };
        MetaData::validate(&meta.headers, false).map_err(|error| not_read(path, error))?;
        for header in &meta.headers {
            check_size(header, bytes, path)?;
        }
        let mut offsets = offset_tables(&mut source, &meta, bytes, path)?;

        // What of it is read.
        let layer = layers::choose(&meta.headers, layer, path)?;
        let header = &meta.headers[layer.part];
        let window = Window::of(header, bytes, path, expected)?;
        let mut offsets = offsets.swap_remove(layer.part);
        let Vec2(width, height) = header.layer_size;
        let planes = Planes::of(&header.channels, &layer);
        let block = match header.blocks {
            BlockDescription::ScanLines => [width, header.compression.scan_lines_per_block()],
            BlockDescription::Tiles(tiles) => [tiles.tile_size.0, tiles.tile_size.1],
        };
        offsets.truncate(width.div_ceil(block[0]) * height.div_ceil(block[1]));
        if offsets.contains(&0) {
            let problem = "blocks are missing: the program that wrote it has not finished";
            return Err(format_error(path, problem));
        }
        Ok(Self {
            file: path.to_owned(),
            source,
            bytes,
            layer,
            planes,
            window,
            block,
            offsets,
            band: RadianceImage::new(window.size[0], 0),
            handed_out: 0,
            next_row: 0,
            meta,
        })
    }

    /// Pixels per row, and rows.
    pub fn size(&self) -> [usize; 2] {
        self.window.size
    }

    /// Whether the file has the three variance channels; else the variances are 0.
    pub fn has_variance(&self) -> bool {
        self.planes.has_variance
    }

    /// The next `count` rows; fewer at the image's end, none after it.
    ///
    /// # Errors
    /// The file is damaged or was cut meanwhile, or the system refuses.
    pub fn next_rows(&mut self, count: usize) -> Result<RadianceImage, ExrError> {
        let [width, height] = self.size();
        let mut rows = RadianceImage::new(width, 0);
        while rows.height < count {
            if self.handed_out == self.band.height {
                if self.next_row == height {
                    break;
                }
                self.next_band()?;
            }
            let end = self.band.height.min(self.handed_out + count - rows.height);
            rows.extend(&self.band, self.handed_out..end);
            self.handed_out = end;
        }
        Ok(rows)
    }

    /// Makes the image's next rows: those of the next row of blocks, or some without data.
    fn next_band(&mut self) -> Result<(), ExrError> {
        let rest = self.window.size[1] - self.next_row;
        let data_row = self.next_row as i64 - self.window.data_at[1];
        self.band = if (0..self.window.data_size[1] as i64).contains(&data_row) {
            let data_row = data_row as usize;
            let first = data_row / self.block[1] * self.block[1];
            let band = self.decode_band(first)?;
            let rows = data_row - first..band.height.min(data_row - first + rest);
            self.window.in_image(band, rows)
        } else {
            let gap = if data_row < 0 { -data_row } else { i64::MAX };
            let rows = rest.min(64).min(usize::try_from(gap).unwrap_or(rest));
            self.window.without_data(rows)
        };
        self.next_row += self.band.height;
        self.handed_out = 0;
        Ok(())
    }

    /// Decodes the row of blocks whose first row is `top`, of the data.
    fn decode_band(&mut self, top: usize) -> Result<RadianceImage, ExrError> {
        let [width, height] = self.window.data_size;
        let [block_width, block_height] = self.block;
        let mut band = RadianceImage::new(width, block_height.min(height - top));
        let across = width.div_ceil(block_width);
        for column in 0..across {
            let offset = self.offsets[top / block_height * across + column];
            let block = self.decode_block(offset)?;
            let in_place = block.index.layer == self.layer.part
                && block.index.level == Vec2(0, 0)
                && block.index.pixel_position == Vec2(column * block_width, top);
            if !in_place || !self.planes.put(&block, top, &mut band) {
                return Err(format_error(
                    &self.file,
                    "a block is not where its table has it",
                ));
            }
        }
        drop_meaningless(&mut band);
        Ok(band)
    }

    fn decode_block(&mut self, offset: u64) -> Result<UncompressedBlock, ExrError> {
        let position = self.source.stream_position();
        if position.map_err(|source| io_error(&self.file, source))? != offset {
            let sought = self.source.seek(SeekFrom::Start(offset));
            sought.map_err(|source| io_error(&self.file, source))?;
        }
        let chunk = match Chunk::read(&mut self.source, &self.meta) {
            Ok(chunk) => chunk,
            Err(error) => return Err(read_error(&mut self.source, self.bytes, &self.file, error)),
        };
        UncompressedBlock::decompress_chunk(chunk, &self.meta, true)
            .map_err(|error| not_read(&self.file, error))
    }
}

fn format_error(path: &Path, problem: impl ToString) -> ExrError {
    ExrError::Format {
        file: path.to_owned(),
        problem: problem.to_string(),
    }
}

fn cut_short(path: &Path, bytes: u64, needed: u64) -> ExrError {
    ExrError::CutShort {
        file: path.to_owned(),
        bytes,
        needed,
    }
}

/// Why something could not be read: where the file has ended, that is why.
fn read_error<R: Read + Seek>(
    source: &mut R,
    bytes: u64,
    path: &Path,
    error: exr::error::Error,
) -> ExrError {
    let position = source.stream_position();
    let mut start = Vec::new();
    let reread = source
        .rewind()
        .and_then(|()| source.take(16).read_to_end(&mut start));
    if let (Ok(_), Some(found)) = (reread, OtherKind::of(&start)) {
        let file = path.to_owned();
        return ExrError::OtherKind { file, found };
    }
    match error {
        exr::error::Error::Io(source) => io_error(path, source),
        _ if position.is_ok_and(|position| position >= bytes) => cut_short(path, bytes, bytes + 1),
        error => not_read(path, error),
    }
}

/// What the decoder does not read, by what it is.
fn not_read(path: &Path, error: exr::error::Error) -> ExrError {
    let exr::error::Error::NotSupported(problem) = &error else {
        return format_error(path, error);
    };
    let what = if problem.contains("deep") {
        "it holds deep data, of which a pixel has any number of samples"
    } else if problem.contains("subsampling") {
        "some channels have fewer pixels than others (as chroma, RY and BY, has)"
    } else if problem.contains("unknown compression") {
        "its compression is younger than the reader"
    } else {
        &**problem
    };
    ExrError::Kind {
        file: path.to_owned(),
        what: what.to_owned(),
    }
}

/// Compares a part's declared size with what the bytes can hold.
fn check_size(header: &Header, bytes: u64, path: &Path) -> Result<(), ExrError> {
    let pixel_bytes: usize = header.channels.list.iter().map(sample_bytes).sum();
    let fits = |Vec2(width, height): Vec2<usize>| {
        let pixels = (width as u64).checked_mul(height as u64)?;
        let held = pixels.checked_mul(pixel_bytes as u64)? / MAX_EXPANSION <= bytes;
        (held && pixels > 0).then_some(())
    };
    let tile = match header.blocks {
        BlockDescription::ScanLines => Vec2(1, 1),
        BlockDescription::Tiles(tiles) => tiles.tile_size,
    };
    match fits(header.layer_size).and(fits(tile)) {
        Some(()) => Ok(()),
        None => Err(size_error(header, bytes, path)),
    }
}

/// Where each layer's blocks begin, after a look whether the file reaches to their ends.
/// The source stands at the tables.
fn offset_tables<R: Read + Seek>(
    source: &mut R,
    meta: &MetaData,
    bytes: u64,
    path: &Path,
) -> Result<Vec<Vec<u64>>, ExrError> {
    let io = |source| io_error(path, source);
    let begin = source.stream_position().map_err(io)?;
    let entries: u64 = meta
        .headers
        .iter()
        .map(|header| header.chunk_count as u64)
        .sum();
    let blocks_begin = begin + 8 * entries;
    if blocks_begin > bytes {
        return Err(cut_short(path, bytes, blocks_begin));
    }
    let longest: u64 = meta
        .headers
        .iter()
        .map(|header| header.max_pixel_file_bytes() as u64)
        .sum();
    let mut tables = Vec::new();
    for header in &meta.headers {
        let mut table = vec![0; 8 * header.chunk_count];
        source.read_exact(&mut table).map_err(io)?;
        let table: Vec<u64> = table
            .as_chunks()
            .0
            .iter()
            .map(|&entry| u64::from_le_bytes(entry))
            .collect();
        // An entry of 0 is a block that was never written.
        let positions = blocks_begin..=blocks_begin + longest;
        if table
            .iter()
            .any(|entry| *entry != 0 && !positions.contains(entry))
        {
            return Err(format_error(path, "its table of blocks points elsewhere"));
        }
        tables.push(table);
    }
    for (header, table) in meta.headers.iter().zip(&tables) {
        // A block begins with its position (after its layer, where there are several) and
        // the number of bytes that follow.
        let layer = if meta.requirements.is_multilayer() {
            4
        } else {
            0
        };
        let position = if header.blocks.has_tiles() { 16 } else { 4 };
        let last = table.iter().copied().max().unwrap_or(blocks_begin);
        let mut end = last + layer + position + 4;
        if end <= bytes {
            let mut length = [0; 4];
            source.seek(SeekFrom::Start(end - 4)).map_err(io)?;
            source.read_exact(&mut length).map_err(io)?;
            end += u64::try_from(i32::from_le_bytes(length)).unwrap_or(0);
        }
        if end > bytes {
            return Err(cut_short(path, bytes, end));
        }
    }
    Ok(tables)
}
