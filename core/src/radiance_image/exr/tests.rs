use std::io::Cursor;

use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, ImageAttributes,
    IntegerBounds, Layer, LayerAttributes, LineOrder, SmallVec, Vec2, WritableImage, f16,
};
use proptest::prelude::{any, prop_assert, prop_assert_eq, proptest};

use super::*;

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
    let error = decode(b"no image at all", Path::new("x.exr")).unwrap_err();
    assert!(matches!(error, ExrError::Format { .. }), "{error}");
    for (start, said) in [
        (
            &b"\x89PNG and so on"[..],
            "x.exr is a PNG image, not OpenEXR",
        ),
        (b"#?RADIANCE\n", "x.exr is a Radiance HDR image (RGBE)"),
        (b"PF\n1 1\n", "x.exr is a PFM image"),
    ] {
        let error = decode(start, Path::new("x.exr")).unwrap_err().to_string();
        assert!(error.starts_with(said), "{error}");
    }
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

/// The same image under every compression and order of blocks of the format that this
/// program can be given.
fn encodings() -> Vec<Encoding> {
    let tiles = |width, height| Blocks::Tiles(Vec2(width, height));
    let compressions = [
        Compression::Uncompressed,
        Compression::RLE,
        Compression::ZIP1,
        Compression::ZIP16,
        Compression::PIZ,
    ];
    let mut all = Vec::new();
    for compression in compressions {
        for (blocks, line_order) in [
            (Blocks::ScanLines, LineOrder::Increasing),
            (Blocks::ScanLines, LineOrder::Decreasing),
            (tiles(16, 7), LineOrder::Increasing),
            (tiles(5, 64), LineOrder::Decreasing),
        ] {
            all.push(Encoding {
                compression,
                blocks,
                line_order,
            });
        }
    }
    all
}

fn encoded(image: &RadianceImage, encoding: Encoding) -> Vec<u8> {
    let plane = |name: &str, values: Vec<f32>| AnyChannel::new(name, FlatSamples::F32(values));
    let mut channels = SmallVec::new();
    for c in 0..3 {
        channels.push(plane(COLOURS[c], image.mean.iter().map(|m| m[c]).collect()));
        let variance = image.variance.iter().map(|v| v[c]).collect();
        channels.push(plane(VARIANCES[c], variance));
    }
    let mask = image.valid.iter().map(|&v| f32::from(u8::from(v)));
    channels.push(plane(MASK, mask.collect()));
    let layer = Layer::new(
        (image.width, image.height),
        LayerAttributes::default(),
        encoding,
        AnyChannels::sort(channels),
    );
    let mut bytes = Cursor::new(Vec::new());
    let written = Image::from_layer(layer).write().to_buffered(&mut bytes);
    written.unwrap();
    bytes.into_inner()
}

#[test]
fn every_compression_and_order_of_blocks_gives_the_same_rows() {
    let image = picture(33, 71);
    for encoding in encodings() {
        let bytes = encoded(&image, encoding);
        let path = Path::new("x.exr");
        for count in [1, 16, 30, 71, 1000] {
            let mut rows = ExrRows::of_bytes(&bytes, path, Some([33, 71])).unwrap();
            let mut top = 0;
            while top < 71 {
                let next = rows.next_rows(count).unwrap();
                let end = (top + count).min(71);
                assert_eq!(next, image.rows(top..end), "{encoding:?} {count}");
                top = end;
            }
            assert_eq!(rows.next_rows(count).unwrap().height, 0);
        }
    }
}

/// What was cut is noticed when the file is opened, whatever lies at its end.
#[test]
fn a_file_cut_anywhere_is_noticed_when_it_is_opened() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("image.exr");
    for encoding in encodings() {
        let bytes = encoded(&picture(33, 71), encoding);
        std::fs::write(&path, &bytes).unwrap();
        check(&path, Some([33, 71])).unwrap();
        for length in [1, 2, 9, 50, 99, 100].map(|percent| bytes.len() * percent / 100 - 1) {
            std::fs::write(&path, &bytes[..length]).unwrap();
            let error = check(&path, Some([33, 71])).unwrap_err();
            let text = error.to_string();
            let named = text.contains("image.exr") && text.contains("cut short");
            assert!(
                matches!(error, ExrError::CutShort { .. }) && named
                    || matches!(error, ExrError::Size { .. }),
                "{encoding:?}, {length} of {} bytes: {text}",
                bytes.len()
            );
        }
    }
}

/// The pixels of `picture` at `at`, in a file whose display window is this.
fn in_window(
    image: &RadianceImage,
    encoding: Encoding,
    at: [i32; 2],
    display: IntegerBounds,
) -> Vec<u8> {
    let plane = |c: usize| FlatSamples::F32(image.mean.iter().map(|m| m[c]).collect());
    let channels = (0..3).map(|c| AnyChannel::new(COLOURS[c], plane(c)));
    let attributes = LayerAttributes {
        layer_position: Vec2(at[0], at[1]),
        ..LayerAttributes::named("rgba")
    };
    let channels = AnyChannels::sort(channels.collect());
    let layer = Layer::new((image.width, image.height), attributes, encoding, channels);
    let mut bytes = Cursor::new(Vec::new());
    let file = Image::from_layers(ImageAttributes::new(display), vec![layer]);
    file.write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

/// Overscan is cut off, and what was trimmed is invalid, in whatever portions rows are read.
#[test]
fn the_display_window_is_the_image() {
    let mut data = picture(19, 40);
    data.valid.fill(true);
    for encoding in [encodings()[0], encodings()[2]] {
        for (at, display_at, [width, height]) in [
            ([0, 0], [0, 0], [19usize, 40usize]),
            ([-3, -4], [0, 0], [11, 20]),
            ([5, 2], [0, 0], [30, 90]),
            ([-7, 25], [-10, -20], [16, 70]),
        ] {
            let display = IntegerBounds::new((display_at[0], display_at[1]), (width, height));
            let bytes = in_window(&data, encoding, at, display);
            for count in [1, 7, 1000] {
                let path = Path::new("x.exr");
                let mut rows = ExrRows::of_bytes(&bytes, path, Some([width, height])).unwrap();
                let mut image = RadianceImage::new(width, 0);
                while image.height < height {
                    let next = rows.next_rows(count).unwrap();
                    image.extend(&next, 0..next.height);
                }
                for pixel in 0..width * height {
                    let x = (pixel % width) as i32 + display_at[0] - at[0];
                    let y = (pixel / width) as i32 + display_at[1] - at[1];
                    let inside = (0..19).contains(&x) && (0..40).contains(&y);
                    assert_eq!(image.valid[pixel], inside, "{encoding:?} {at:?} {pixel}");
                    let expected = match inside {
                        true => data.mean[y as usize * 19 + x as usize],
                        false => [0.0; 3],
                    };
                    assert_eq!(image.mean[pixel], expected, "{encoding:?} {at:?} {pixel}");
                }
            }
        }
    }
    let display = IntegerBounds::new((100, 0), (19, 40));
    let bytes = in_window(&data, encodings()[0], [0, 0], display);
    let error = decode(&bytes, Path::new("x.exr")).unwrap_err();
    assert!(matches!(error, ExrError::Windows { .. }), "{error}");
}

/// A file of 2 x 1 pixels whose channels all hold the number of their part and position.
fn parts(parts: &[(&str, &[&str])]) -> Vec<u8> {
    let layer = |(number, (name, channels)): (usize, &(&str, &[&str]))| {
        let value = |position: usize| (10 * number + position) as f32;
        let channels = channels.iter().enumerate();
        let channels = channels.map(|(position, name)| {
            AnyChannel::new(*name, FlatSamples::F32(vec![value(position); 2]))
        });
        let channels = AnyChannels::sort(channels.collect());
        let attributes = LayerAttributes::named(*name);
        Layer::new((2, 1), attributes, Encoding::SMALL_LOSSLESS, channels)
    };
    let layers: Vec<_> = parts.iter().enumerate().map(layer).collect();
    let bounds = IntegerBounds::from_dimensions((2, 1));
    let mut bytes = Cursor::new(Vec::new());
    let file = Image::from_layers(ImageAttributes::new(bounds), layers);
    file.write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

#[test]
fn the_only_image_is_taken_and_others_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("many.exr");
    let all = ["R", "G", "B"];
    let combined = [
        "Combined.R",
        "Combined.G",
        "Combined.B",
        "Combined.var.Y",
        "Depth.Z",
    ];
    let colours = ["a.red", "a.green", "a.blue", "b.r", "b.g", "b.b"];
    for (file, layer, expected) in [
        (&[("one", &all[..])][..], "", Ok([0.0, 1.0, 2.0])),
        (&[("N", &all), ("C", &all)], "", Err("holds 2 images: N, C")),
        (&[("N", &all), ("C", &all)], ":C", Ok([10.0, 11.0, 12.0])),
        (
            &[("N", &all), ("C", &all)],
            ":D",
            Err("no image named \"D\"; it holds N, C"),
        ),
        (
            &[("depth", &["Z"]), ("rgba", &all)],
            "",
            Ok([10.0, 11.0, 12.0]),
        ),
        (&[("", &combined)], "", Ok([0.0, 1.0, 2.0])),
        (&[("", &colours)], "", Err("holds 2 images: a, b")),
        (&[("", &colours)], ":b", Ok([3.0, 4.0, 5.0])),
        (
            &[("", &["X", "Y", "Z"])],
            "",
            Err("has the channels X, Y, Z"),
        ),
        (
            &[("", &["Y", "RY", "BY"])],
            "",
            Err("has the channels BY, RY, Y"),
        ),
        (&[("", &["Y", "A"])], "", Ok([0.0; 3])),
    ] {
        std::fs::write(&path, parts(file)).unwrap();
        let named = format!("{}{layer}", path.display());
        let found = read(Path::new(&named)).map(|file| file.image.mean[0]);
        match (found, expected) {
            (Ok(found), Ok(expected)) => assert_eq!(found, expected, "{file:?}"),
            (Err(error), Err(said)) => {
                assert!(error.to_string().contains(said), "{said}: {error}");
            }
            (found, expected) => panic!("{file:?}: {found:?} instead of {expected:?}"),
        }
    }
}

/// Half floats and whole numbers of other programs, a layer that is not read after the first.
#[test]
fn other_sample_types_and_further_layers_are_read() {
    let values = [0.0f32, 0.5, -2.0, 1024.0, 3.0, 7.0];
    let half: Vec<f16> = values.iter().map(|&v| f16::from_f32(v)).collect();
    let whole: Vec<u32> = (0..6).collect();
    let layer = |name: &str, channels: SmallVec<[AnyChannel<FlatSamples>; 4]>| {
        Layer::new(
            (3, 2),
            LayerAttributes::named(name),
            Encoding::SMALL_LOSSLESS,
            AnyChannels::sort(channels),
        )
    };
    let first = SmallVec::from_vec(vec![
        AnyChannel::new("R", FlatSamples::F16(half.clone())),
        AnyChannel::new("G", FlatSamples::U32(whole.clone())),
        AnyChannel::new("B", FlatSamples::F32(values.to_vec())),
    ]);
    let second = SmallVec::from_vec(vec![AnyChannel::new("Y", FlatSamples::F16(half))]);
    let image = Image::from_layers(
        ImageAttributes::new(IntegerBounds::from_dimensions((3, 2))),
        vec![layer("first", first), layer("second", second)],
    );
    let mut bytes = Cursor::new(Vec::new());
    image.write().to_buffered(&mut bytes).unwrap();
    let bytes = bytes.into_inner();
    let read = decode(&bytes, Path::new("two.exr")).unwrap().image;
    for pixel in 0..6 {
        let expected = [values[pixel], whole[pixel] as f32, values[pixel]];
        assert_eq!(read.mean[pixel], expected);
    }
    let error = decode(&bytes[..bytes.len() - 1], Path::new("two.exr")).unwrap_err();
    assert!(matches!(error, ExrError::CutShort { .. }), "{error}");
}

proptest! {
    /// Rows in any portions are the image's, under any compression and order.
    #[test]
    fn rows_are_those_of_the_image(
        (width, height) in (1usize..70, 1usize..90),
        encoding in proptest::sample::select(encodings()),
        counts in proptest::collection::vec(1usize..40, 1..12),
    ) {
        let image = picture(width, height);
        let bytes = encoded(&image, encoding);
        prop_assert_eq!(&decode(&bytes, Path::new("x.exr")).unwrap().image, &image);
        let mut rows = ExrRows::of_bytes(&bytes, Path::new("x.exr"), None).unwrap();
        prop_assert!(rows.has_variance() && rows.size() == [width, height]);
        let (mut top, mut portions) = (0, counts.iter().cycle());
        while top < height {
            let next = rows.next_rows(*portions.next().unwrap()).unwrap();
            prop_assert_eq!(&next, &image.rows(top..top + next.height));
            top += next.height;
        }
    }

    /// Whatever is changed in a file of any kind: rows of its image or an error.
    #[test]
    fn damaged_files_of_any_kind_never_panic(
        changes in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..12),
        encoding in proptest::sample::select(encodings()),
    ) {
        let mut bytes = encoded(&picture(19, 40), encoding);
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(mut rows) = ExrRows::of_bytes(&bytes, Path::new("x.exr"), Some([19, 40])) {
            let mut height = 0;
            while let Ok(next) = rows.next_rows(7) {
                height += next.height;
                if next.height < 7 {
                    prop_assert_eq!(height, 40);
                    break;
                }
            }
        }
    }

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
            prop_assert!(pixels as u64 <= SMALL_PIXELS.max(MOST_PER_BYTE * bytes.len() as u64));
            prop_assert_eq!(file.image.mean.len(), pixels);
        }
    }
}
