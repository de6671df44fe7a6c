//! A raw file as a still camera writes it: Adobe's DNG 1.4, one uncompressed image of
//! 16-bit samples with its EXIF data.

/// Everything a raw file states.
#[derive(Clone, Debug, PartialEq)]
pub struct RawFile<'a> {
    /// Width and height, pixels.
    pub size_px: [u32; 2],
    /// Counts, row by row from the top, DN.
    pub counts: &'a [u16],
    /// Colours of the filters over the first two pixels of the first two rows, 0 red,
    /// 1 green, 2 blue; `None`: a monochrome sensor.
    pub filters: Option<[u8; 4]>,
    /// Count without light, DN.
    pub black_level_dn: u32,
    /// Largest count, DN.
    pub white_level_dn: u32,
    /// Exposure time as numerator and denominator, seconds.
    pub exposure: [u32; 2],
    /// Aperture times 100.
    pub f_number_100: u32,
    /// Sensitivity.
    pub iso: u16,
    /// Maker and model.
    pub maker_and_model: [&'a str; 2],
    /// Of the body.
    pub serial: &'a str,
}

const BYTE: u16 = 1;
const ASCII: u16 = 2;
const SHORT: u16 = 3;
const LONG: u16 = 4;
const RATIONAL: u16 = 5;
const SIGNED_RATIONAL: u16 = 10;

/// A field of a directory: tag, type, number of values, and their bytes.
struct Field {
    tag: u16,
    kind: u16,
    count: u32,
    bytes: Vec<u8>,
}

fn bytes(tag: u16, values: &[u8]) -> Field {
    Field {
        tag,
        kind: BYTE,
        count: values.len() as u32,
        bytes: values.to_vec(),
    }
}

fn text(tag: u16, text: &str) -> Field {
    let bytes: Vec<u8> = text.bytes().chain([0]).collect();
    Field {
        tag,
        kind: ASCII,
        count: bytes.len() as u32,
        bytes,
    }
}

fn shorts(tag: u16, values: &[u16]) -> Field {
    Field {
        tag,
        kind: SHORT,
        count: values.len() as u32,
        bytes: values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect(),
    }
}

fn long(tag: u16, value: u32) -> Field {
    Field {
        tag,
        kind: LONG,
        count: 1,
        bytes: value.to_le_bytes().to_vec(),
    }
}

fn rationals(tag: u16, kind: u16, values: &[[u32; 2]]) -> Field {
    let words = values.iter().flatten();
    Field {
        tag,
        kind,
        count: values.len() as u32,
        bytes: words.flat_map(|word| word.to_le_bytes()).collect(),
    }
}

/// Bytes of a directory with the values that do not fit into it.
fn directory_bytes(fields: &[Field]) -> usize {
    let outside = fields.iter().map(|field| match field.bytes.len() {
        0..=4 => 0,
        length => length.next_multiple_of(2),
    });
    2 + 12 * fields.len() + 4 + outside.sum::<usize>()
}

/// A directory that stands at `offset`, followed by its longer values.
fn directory(fields: &[Field], offset: usize) -> Vec<u8> {
    let mut entries = (fields.len() as u16).to_le_bytes().to_vec();
    let mut outside = Vec::new();
    let values_at = offset + 2 + 12 * fields.len() + 4;
    for field in fields {
        entries.extend(field.tag.to_le_bytes());
        entries.extend(field.kind.to_le_bytes());
        entries.extend(field.count.to_le_bytes());
        let mut value = field.bytes.clone();
        if value.len() > 4 {
            let at = (values_at + outside.len()) as u32;
            value.resize(value.len().next_multiple_of(2), 0);
            outside.extend(value);
            value = at.to_le_bytes().to_vec();
        }
        value.resize(4, 0);
        entries.extend(value);
    }
    entries.extend([0; 4]);
    entries.extend(outside);
    entries
}

impl RawFile<'_> {
    /// The file's bytes.
    ///
    /// # Panics
    /// If there are more or fewer counts than pixels.
    pub fn encode(&self) -> Vec<u8> {
        let [width, height] = self.size_px;
        assert_eq!(
            self.counts.len(),
            width as usize * height as usize,
            "one count per pixel"
        );
        // EXIF first, so that the image's directory can name its place.
        let exif = vec![
            rationals(0x829a, RATIONAL, &[self.exposure]),
            rationals(0x829d, RATIONAL, &[[self.f_number_100, 100]]),
            shorts(0x8827, &[self.iso]),
            text(0x9003, "2026:01:01 12:00:00"),
            text(0xa431, self.serial),
        ];
        let exif_at = 8;
        let main_at = exif_at + directory_bytes(&exif);
        let main_bytes = directory_bytes(&self.image_fields(exif_at, 0));
        let pixels_at = main_at + main_bytes;
        let fields = self.image_fields(exif_at, pixels_at);
        // Header, directories, counts.
        let mut file = b"II\x2a\0".to_vec();
        file.extend((main_at as u32).to_le_bytes());
        file.extend(directory(&exif, exif_at));
        file.extend(directory(&fields, main_at));
        file.extend(self.counts.iter().flat_map(|count| count.to_le_bytes()));
        file
    }

    /// The directory of the image, by ascending tag.
    fn image_fields(&self, exif_at: usize, pixels_at: usize) -> Vec<Field> {
        const COLOUR_FILTERS: u16 = 32803;
        const LINEAR: u16 = 34892;
        let [width, height] = self.size_px;
        let [maker, model] = self.maker_and_model;
        let photometric = match self.filters {
            Some(_) => COLOUR_FILTERS,
            None => LINEAR,
        };
        let mut fields = vec![
            long(254, 0),
            long(256, width),
            long(257, height),
            shorts(258, &[16]),
            shorts(259, &[1]),
            shorts(262, &[photometric]),
            text(271, maker),
            text(272, model),
            long(273, pixels_at as u32),
            shorts(274, &[1]),
            shorts(277, &[1]),
            long(278, height),
            long(279, 2 * width * height),
            shorts(284, &[1]),
        ];
        if let Some(filters) = self.filters {
            fields.push(shorts(33421, &[2, 2]));
            fields.push(bytes(33422, &filters));
        }
        fields.extend([
            long(34665, exif_at as u32),
            bytes(50706, &[1, 4, 0, 0]),
            text(50708, &format!("{maker} {model}")),
            long(50714, self.black_level_dn),
            long(50717, self.white_level_dn),
        ]);
        if self.filters.is_some() {
            let unit = |is_one: bool| [u32::from(is_one), 1];
            let matrix: Vec<[u32; 2]> = (0..9).map(|entry| unit(entry % 4 == 0)).collect();
            fields.push(rationals(50721, SIGNED_RATIONAL, &matrix));
            fields.push(rationals(50728, RATIONAL, &[[1, 1]; 3]));
        }
        fields.push(text(50735, self.serial));
        if self.filters.is_some() {
            // Daylight.
            fields.push(shorts(50778, &[21]));
        }
        fields
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn word(file: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(file[at..at + 4].try_into().unwrap())
    }

    fn half(file: &[u8], at: usize) -> u16 {
        u16::from_le_bytes(file[at..at + 2].try_into().unwrap())
    }

    /// Type, number and the word of a field in the directory at this place.
    fn field(file: &[u8], directory: usize, tag: u16) -> Option<(u16, u32, u32)> {
        let count = usize::from(half(file, directory));
        (0..count)
            .map(|entry| directory + 2 + 12 * entry)
            .find(|&at| half(file, at) == tag)
            .map(|at| (half(file, at + 2), word(file, at + 4), word(file, at + 8)))
    }

    proptest! {
        /// Every field lies inside the file, tags ascend, and the counts are found where
        /// the directory says.
        #[test]
        fn fields_and_counts_are_where_the_file_says(
            width in 1_u32..40, height in 1_u32..30, seed: u16, is_colour: bool,
            serial in "[A-Z0-9]{1,12}", numerator: u32, denominator: u32,
        ) {
            let counts: Vec<u16> = (0..width * height).map(|i| seed.wrapping_add(i as u16)).collect();
            let file = RawFile {
                size_px: [width, height],
                counts: &counts,
                filters: is_colour.then_some([0, 1, 1, 2]),
                black_level_dn: 64,
                white_level_dn: 4095,
                exposure: [numerator, denominator],
                f_number_100: 800,
                iso: 200,
                maker_and_model: ["Maker", "Model"],
                serial: &serial,
            }
            .encode();
            let main = word(&file, 4) as usize;
            let entries = usize::from(half(&file, main));
            let tags: Vec<u16> = (0..entries).map(|e| half(&file, main + 2 + 12 * e)).collect();
            prop_assert!(tags.is_sorted());
            let (_, _, pixels) = field(&file, main, 273).unwrap();
            let (_, _, length) = field(&file, main, 279).unwrap();
            prop_assert_eq!((pixels + length) as usize, file.len());
            for (index, count) in counts.iter().enumerate() {
                prop_assert_eq!(half(&file, pixels as usize + 2 * index), *count);
            }
            let (_, _, exif) = field(&file, main, 34665).unwrap();
            let (kind, count, at) = field(&file, exif as usize, 0x829a).unwrap();
            prop_assert_eq!((kind, count), (RATIONAL, 1));
            prop_assert_eq!(word(&file, at as usize), numerator);
            prop_assert_eq!(word(&file, at as usize + 4), denominator);
        }
    }
}
