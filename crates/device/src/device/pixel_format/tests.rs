use super::*;
use proptest::prelude::*;

fn of(name: &[u8; 4]) -> PixelFormat {
    of_fourcc(*name).unwrap()
}

#[test]
fn codes_are_unique_and_named() {
    for (i, format) in FORMATS.iter().enumerate() {
        assert!(FORMATS[i + 1..].iter().all(|f| f.fourcc != format.fourcc));
        assert_eq!(of_fourcc(format.fourcc), Some(*format));
    }
    assert_eq!(of(b"Y16 ").name(), "Y16");
    assert_eq!(of(&[b'Y', b'1', b'6', 0xa0]).name(), "Y16-BE");
    assert_eq!(of_fourcc(*b"H264"), None);
    for format in FORMATS {
        assert_eq!(fourcc_of_name(&format.name()), Some(format.fourcc));
    }
    assert_eq!(fourcc_of_name("Y16 "), Some(*b"Y16 "));
    for bad in ["", "-BE", "Y1234", "é16", "Y16-LE"] {
        assert_eq!(fourcc_of_name(bad), None, "{bad}");
    }
}

/// Codes, depths and filters as the kernel's `videodev2.h` names them.
#[test]
fn every_bayer_depth_comes_in_all_four_orders() {
    for (bits, plain, packed) in [
        (8, ["RGGB", "GRBG", "GBRG", "BA81"], None),
        (10, ["RG10", "BA10", "GB10", "BG10"], Some("AA")),
        (12, ["RG12", "BA12", "GB12", "BG12"], Some("CC")),
        (14, ["RG14", "GR14", "GB14", "BG14"], Some("EE")),
        (16, ["RG16", "GR16", "GB16", "BYR2"], None),
    ] {
        let orders = [Mosaic::Rggb, Mosaic::Grbg, Mosaic::Gbrg, Mosaic::Bggr];
        for (i, (code, mosaic)) in plain.iter().zip(orders).enumerate() {
            let mut codes = vec![(*code).to_owned()];
            codes.extend(packed.map(|end| format!("p{}{end}", ["R", "g", "G", "B"][i])));
            for code in codes {
                let format = of(code.as_bytes().try_into().unwrap());
                assert_eq!((format.bits, format.mosaic), (bits, mosaic), "{code}");
                assert_eq!(format.fidelity, Fidelity::Raw);
            }
        }
    }
}

#[test]
fn the_sensors_own_counts_are_chosen_before_others() {
    let choose = |offered: &[&[u8; 4]], bits, preview| {
        let offered: Vec<[u8; 4]> = offered.iter().map(|&&code| code).collect();
        best_of(&offered, bits, preview).map(|format| format.name())
    };
    let name = |text: &str| Some(text.to_owned());
    let all: &[&[u8; 4]] = &[b"MJPG", b"YUYV", b"GREY", b"pBAA", b"BG10", b"Y16 "];
    assert_eq!(choose(all, None, false), name("Y16"));
    assert_eq!(choose(all, Some(10), false), name("BG10"));
    assert_eq!(choose(all, Some(8), false), name("GREY"));
    assert_eq!(choose(&[b"MJPG", b"YUYV"], Some(12), false), name("YUYV"));
    assert_eq!(choose(&[b"MJPG", b"NV12"], None, false), None);
    assert!(choose(&[b"MJPG", b"NV12"], None, true).is_some());
    assert_eq!(choose(&[b"H264"], None, true), None);
}

#[test]
fn rows_are_taken_at_their_stride_and_words_in_their_order() {
    let bytes = [1, 2, 9, 9, 3, 4];
    assert_eq!(of(b"GREY").decode(&bytes, 2, 2, 4), Ok(vec![1, 2, 3, 4]));
    assert_eq!(
        of(b"GREY").decode(&bytes, 3, 2, 0),
        Ok(vec![1, 2, 9, 9, 3, 4])
    );
    let bytes = [0x34, 0x02, 0xff, 0x03];
    assert_eq!(of(b"Y10 ").decode(&bytes, 2, 1, 4), Ok(vec![0x234, 0x3ff]));
    assert_eq!(of(b"RG16").decode(&bytes, 1, 2, 2), Ok(vec![0x234, 0x3ff]));
    let big = of(&[b'Y', b'1', b'6', 0xa0]);
    assert_eq!(big.decode(&bytes, 2, 1, 4), Ok(vec![0x3402, 0xff03]));
}

/// Worked by hand from the tables of `pixfmt-srggb10p`, `12p` and `14p`.
#[test]
fn packed_samples_are_put_together() {
    // Low bits 3, 1, 2, 0 of the samples in byte 4, the first lowest.
    let bytes = [0x01, 0x80, 0xff, 0x00, 0b00_10_01_11];
    let counts = vec![0x007, 0x201, 0x3fe, 0x000];
    assert_eq!(of(b"Y10P").decode(&bytes, 4, 1, 5), Ok(counts.clone()));
    assert_eq!(of(b"pRAA").decode(&bytes, 4, 1, 0), Ok(counts));
    // Byte 2: the second sample's low bits above the first's.
    let bytes = [0x12, 0xab, 0xc3];
    assert_eq!(of(b"pBCC").decode(&bytes, 2, 1, 3), Ok(vec![0x123, 0xabc]));
    // Low bits 0x3f, 0, 0x2a (101010), 1 from bit 0 on: 24 bits
    // 000001 101010 000000 111111.
    let bytes = [
        0x01,
        0x02,
        0x03,
        0x04,
        0b0011_1111,
        0b1010_0000,
        0b0000_0110,
    ];
    let counts = vec![0x7f, 0x80, 0xea, 0x101];
    assert_eq!(of(b"pGEE").decode(&bytes, 4, 1, 7), Ok(counts));
    // Six samples per row are two groups, whose last two samples are padding.
    let rows = [[0x10_u8; 10], [0x20; 10]].concat();
    let counts = of(b"pgAA").decode(&rows, 6, 2, 10).unwrap();
    // 0x10 << 2 with the low bits 00, 00, 01, 00 of 0x10; 0x20: 00, 00, 10, 00.
    assert_eq!(counts[..6], [0x40, 0x40, 0x41, 0x40, 0x40, 0x40]);
    assert_eq!(counts[6..], [0x80, 0x80, 0x82, 0x80, 0x80, 0x80]);
    assert!(of(b"pgAA").decode(&rows[..19], 6, 2, 10).is_err());
}

#[test]
fn luma_is_taken_out_of_colour_formats() {
    let yuyv = [10, 128, 20, 127, 30, 126, 40, 125];
    assert_eq!(of(b"YUYV").decode(&yuyv, 4, 1, 8), Ok(vec![10, 20, 30, 40]));
    // An odd width still has a whole pair at its end.
    assert_eq!(of(b"YUYV").decode(&yuyv, 3, 1, 8), Ok(vec![10, 20, 30]));
    let nv12 = [1, 2, 3, 4, 128, 128];
    assert_eq!(of(b"NV12").decode(&nv12, 2, 2, 2), Ok(vec![1, 2, 3, 4]));
    let without_colour = of(b"NV12").decode(&nv12[..4], 2, 2, 2);
    assert!(matches!(without_colour, Err(DecodeError::Short { .. })));
    assert_eq!(of(b"YUYV").fidelity, Fidelity::Luma);
    assert_eq!(of(b"NV12").fidelity, Fidelity::Preview);
    assert_eq!(of(b"MJPG").fidelity, Fidelity::Preview);
}

#[test]
fn a_jpeg_image_is_shown_only_if_it_is_whole_and_of_the_streams_size() {
    let mut jpeg = Vec::new();
    let image = image::GrayImage::from_fn(32, 16, |x, _| image::Luma([(8 * x) as u8]));
    image
        .write_to(
            &mut std::io::Cursor::new(&mut jpeg),
            image::ImageFormat::Jpeg,
        )
        .unwrap();
    let counts = of(b"MJPG").decode(&jpeg, 32, 16, 0).unwrap();
    assert_eq!(counts.len(), 512);
    assert!(
        (0..32).all(|x| counts[x].abs_diff(8 * x as u16) < 8),
        "{:?}",
        &counts[..32]
    );
    assert_eq!(
        of(b"MJPG").decode(&jpeg, 16, 32, 0),
        Err(DecodeError::Size {
            found: [32, 16],
            expected: [16, 32]
        })
    );
    assert!(of(b"MJPG").decode(b"no image", 32, 16, 0).is_err());
}

#[test]
fn short_buffers_and_stray_bits_are_told() {
    let short = of(b"Y12 ").decode(&[0; 10], 3, 2, 6).unwrap_err();
    assert_eq!(
        short.to_string(),
        "10 bytes, but 3 × 2 pixels in rows of 6 bytes need 12"
    );
    assert!(matches!(
        of(b"Y12 ").decode(&[0; 100], 3, 2, 4),
        Err(DecodeError::Short { .. })
    ));
    let mut bytes = [0; 12];
    bytes[9] = 0x10;
    assert_eq!(
        of(b"BG12").decode(&bytes, 3, 2, 6).unwrap_err().to_string(),
        "pixel (1, 1) is 4096, more than 12 bits"
    );
}

/// Bit by bit as MIPI CSI-2 draws RAW10, RAW12 and RAW14: the high bits of a
/// group as bytes, then a stream of low bits that fills bytes from bit 0 up.
fn pack(counts: &[u16], bits: usize, samples: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    for group in counts.chunks(samples) {
        let mut stream = Vec::new();
        for i in 0..samples {
            let count = group.get(i).copied().unwrap_or(0);
            bytes.push((count >> (bits - 8)) as u8);
            stream.extend((0..bits - 8).map(|bit| count >> bit & 1 == 1));
        }
        for byte in stream.chunks(8) {
            let value = |(bit, &set): (usize, &bool)| u8::from(set) << bit;
            bytes.push(byte.iter().enumerate().map(value).sum());
        }
    }
    bytes
}

proptest! {
    #[test]
    fn any_buffer_and_any_size_end_without_panic(
        bytes in proptest::collection::vec(any::<u8>(), 0..64),
        width in 0..9_u32,
        height in 0..9_u32,
        stride in prop_oneof![0..20_u32, Just(u32::MAX)],
        index in 0..FORMATS.len(),
    ) {
        let format = FORMATS[index];
        if let Ok(counts) = format.decode(&bytes, width, height, stride) {
            prop_assert_eq!(counts.len(), (width * height) as usize);
            prop_assert!(counts.iter().all(|&count| u32::from(count) < 1 << format.bits));
        }
    }

    #[test]
    fn what_was_encoded_is_decoded(
        counts in proptest::collection::vec(0..4096_u16, 12),
        gap in 0..5_usize,
    ) {
        let mut bytes = Vec::new();
        for row in counts.chunks(4) {
            bytes.extend(row.iter().flat_map(|count| count.to_le_bytes()));
            bytes.extend(std::iter::repeat_n(0xee, gap));
        }
        let decoded = of(b"Y12 ").decode(&bytes, 4, 3, 8 + gap as u32);
        prop_assert_eq!(decoded, Ok(counts));
    }

    #[test]
    fn what_was_packed_is_unpacked(
        counts in proptest::collection::vec(0..1_u16 << 14, 21),
        gap in 0..5_usize,
        width in prop_oneof![Just(1_usize), Just(3), Just(7), Just(21)],
    ) {
        for (code, bits, samples) in [(b"pBAA", 10, 4), (b"pRCC", 12, 2), (b"Y14P", 14, 4)] {
            let counts: Vec<u16> = counts.iter().map(|count| count >> (14 - bits)).collect();
            let mut bytes = Vec::new();
            let mut stride = 0;
            for row in counts.chunks(width) {
                let start = bytes.len();
                bytes.extend(pack(row, bits, samples));
                bytes.extend(std::iter::repeat_n(0xee, gap));
                stride = bytes.len() - start;
            }
            let height = counts.len() / width;
            let decoded = of(code).decode(&bytes, width as u32, height as u32, stride as u32);
            prop_assert_eq!(decoded, Ok(counts));
        }
    }
}
