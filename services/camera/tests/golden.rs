//! Pictures of every kind become the frames that they must, and broken ones are refused in words.

#![allow(clippy::unwrap_used)]

use camera::{Config, PictureReader, RecordedCamera, SimulatedCamera};
use messages::{Frame, Message, PIXELS_MAX, Status};
use png::{BitDepth, ColorType, Encoder};
use std::path::PathBuf;
use traverse::FrameRow;
use zerocopy::FromZeros;

fn golden(name: &str) -> Vec<u8> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("golden").join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// What must be found in a picture, row by row.
fn gray_values(name: &str) -> Vec<u8> {
    let text = String::from_utf8(golden(&format!("{name}.csv"))).unwrap();
    text.split_whitespace()
        .flat_map(|line| line.split(','))
        .map(|cell| cell.parse().unwrap())
        .collect()
}

fn row() -> FrameRow {
    FrameRow {
        line: 9,
        sequence: 7,
        file: "000.png".into(),
        taken_ns: 233_333_333,
        center_x_px: 6.5,
        center_y_px: 2.25,
        rim_radius_px: 3.0,
        wheel_radius_px: 4.0,
        pitch_rad: 0.1,
        homography: None,
    }
}

fn gray_png(width: u32, height: u32, pixel: impl Fn(u32, u32) -> u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, width, height);
    encoder.set_color(ColorType::Grayscale);
    encoder.set_depth(BitDepth::Eight);
    let pixels: Vec<u8> = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .map(|(x, y)| pixel(x, y))
        .collect();
    encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
    bytes
}

fn checker(x: u32, y: u32) -> u8 {
    ((x * 2_654_435 + y * 40_503) >> 7) as u8
}

#[test]
fn every_kind_of_png_gives_its_gray_values() {
    let (mut reader, mut frame) = (PictureReader::default(), Frame::new_box_zeroed().unwrap());
    for (picture, values) in [
        ("gray8", "gray"),
        ("gray8_interlaced", "gray"),
        ("gray16", "gray"),
        ("gray_alpha8", "gray"),
        ("gray1", "gray1"),
        ("rgb8", "rgb"),
        ("rgb8_interlaced", "rgb"),
        ("rgba16", "rgb"),
        ("palette4", "palette"),
    ] {
        reader
            .fill(&row(), &golden(&format!("{picture}.png")), &mut frame)
            .unwrap();
        let expected = gray_values(values);
        assert_eq!((frame.width, frame.height), (13, 7), "{picture}");
        assert_eq!(frame.image(), expected, "{picture}");
        assert_eq!(frame.check(), Ok(()), "{picture}");
    }
}

#[test]
fn a_frame_carries_its_row() {
    let (mut reader, mut frame) = (PictureReader::default(), Frame::new_box_zeroed().unwrap());
    frame.crop_x_px = 99;
    frame.header.status = Status::BAD_SAMPLE;
    reader.fill(&row(), &golden("gray8.png"), &mut frame).unwrap();
    assert_eq!((frame.header.taken_ns, frame.header.sequence), (233_333_333, 7));
    assert_eq!(frame.header.status, Status::OK);
    assert_eq!((frame.crop_x_px, frame.crop_y_px), (0, 0));
    assert_eq!((frame.center_x_px, frame.center_y_px), (6.5, 2.25));
    assert_eq!(
        (frame.rim_radius_px, frame.wheel_radius_px, frame.pitch_rad),
        (3.0, 4.0, 0.1)
    );
    // v_down = (sin, cos) and v_right = (cos, -sin) of the pitch, one radius long.
    let (sin, cos) = 0.1_f64.sin_cos();
    let circle = [4.0 * cos, 4.0 * sin, 6.5, -4.0 * sin, 4.0 * cos, 2.25, 0.0, 0.0, 1.0];
    assert_eq!(frame.homography, circle);
}

#[test]
fn a_large_picture_is_cropped_and_the_wheel_stays_where_it_was() {
    let (mut reader, mut frame) = (PictureReader::default(), Frame::new_box_zeroed().unwrap());
    let homography = [150.0, 4.0, 1300.0, -3.0, 160.0, 700.0, -0.002, 0.01, 1.0];
    let row = FrameRow {
        center_x_px: 1300.0,
        center_y_px: 700.0,
        wheel_radius_px: 200.0,
        homography: Some(homography),
        ..row()
    };
    reader.fill(&row, &gray_png(1500, 1200, checker), &mut frame).unwrap();
    assert!((frame.width * frame.height) as usize <= PIXELS_MAX);
    assert_eq!((frame.crop_x_px, frame.crop_y_px), (1050, 450));
    for y in 0..frame.height {
        for x in 0..frame.width {
            let pixel = frame.image()[(y * frame.width + x) as usize];
            assert_eq!(pixel, checker(x + frame.crop_x_px, y + frame.crop_y_px), "({x}, {y})");
        }
    }
    assert_eq!((frame.center_x_px, frame.center_y_px), (250.0, 250.0));
    let map = |h: &[f64; 9], x: f64, z: f64| {
        let w = h[6] * x + h[7] * z + h[8];
        ((h[0] * x + h[1] * z + h[2]) / w, (h[3] * x + h[4] * z + h[5]) / w)
    };
    for (x, z) in [(0.0, 0.0), (1.0, 0.0), (-0.5, 0.9), (0.3, -1.0)] {
        let (whole, crop) = (map(&homography, x, z), map(&frame.homography, x, z));
        assert!((whole.0 - 1050.0 - crop.0).abs() < 1e-9 && (whole.1 - 450.0 - crop.1).abs() < 1e-9);
    }
}

#[test]
fn every_kind_of_jpeg_gives_the_gray_values_of_another_decoder() {
    let (mut reader, mut frame) = (PictureReader::default(), Frame::new_box_zeroed().unwrap());
    for picture in ["rgb", "rgb_progressive", "gray"] {
        let file = golden(&format!("{picture}.jpg"));
        reader.fill(&row(), &file, &mut frame).unwrap();
        let expected = gray_values(&format!("{picture}_jpg"));
        assert_eq!((frame.width, frame.height), (33, 18), "{picture}");
        assert_eq!(frame.check(), Ok(()), "{picture}");
        // The standard leaves the last bits of a transform, and how colours are spread over pixels, to the decoder.
        for (found, expected) in frame.image().iter().zip(expected) {
            assert!(found.abs_diff(expected) <= 3, "{picture}: {found} {expected}");
        }
        for tenth in 0..10 {
            let error = reader
                .fill(&row(), &file[..file.len() * tenth / 10], &mut frame)
                .unwrap_err();
            let words = ["cut off", "not a sound JPEG file"];
            assert!(words.iter().any(|words| error.contains(words)), "{picture}: {error}");
        }
    }
    let mut huge = golden("gray.jpg");
    let size = huge.windows(2).position(|marker| marker == [0xff, 0xc0]).unwrap() + 5;
    huge[size..size + 4].copy_from_slice(&[0x27, 0x10, 0x27, 0x10]);
    let error = reader.fill(&row(), &huge, &mut frame).unwrap_err();
    assert!(error.contains("10000x10000 px; at most 64 Mpx"), "{error}");
}

#[test]
fn a_picture_that_fills_a_frame_to_the_last_pixel_is_not_cropped() {
    let (mut reader, mut frame) = (PictureReader::default(), Frame::new_box_zeroed().unwrap());
    reader.fill(&row(), &gray_png(1024, 1024, checker), &mut frame).unwrap();
    assert_eq!(frame.image().len(), PIXELS_MAX);
    assert_eq!(frame.pixels[PIXELS_MAX - 1], checker(1023, 1023));
}

#[test]
fn broken_files_are_refused_in_words() {
    let (mut reader, mut frame) = (PictureReader::default(), Frame::new_box_zeroed().unwrap());
    let whole = golden("rgb8.png");
    let mut huge = whole.clone();
    // The width and height of the header, and the checksum that goes with 10000 x 10000.
    huge[16..24].copy_from_slice(&[0, 0, 0x27, 0x10, 0, 0, 0x27, 0x10]);
    repair_checksums(&mut huge);
    for (bytes, words) in [
        (&b""[..], "cut off"),
        (&whole[..1], "cut off"),
        (&whole[..8], "cut off"),
        (&whole[..33], "cut off"),
        (&whole[..whole.len() - 12], "cut off"),
        (b"GIF89a, which is neither", "neither a sound PNG file nor a JPEG file"),
        (
            &huge,
            "10000x10000 px; at most 64 Mpx and 65535 px a side, crop or scale it down",
        ),
    ] {
        let error = reader.fill(&row(), bytes, &mut frame).unwrap_err();
        assert!(error.contains(words), "{error}");
    }
    for tenth in 0..10 {
        let cut = &whole[..whole.len() * tenth / 10];
        let error = reader.fill(&row(), cut, &mut frame).unwrap_err();
        assert!(error.contains("cut off"), "{tenth}: {error}");
    }
    reader.fill(&row(), &whole, &mut frame).unwrap();
}

#[test]
fn no_bytes_make_it_panic_and_what_it_accepts_is_a_sound_frame() {
    let (mut reader, mut frame) = (PictureReader::default(), Frame::new_box_zeroed().unwrap());
    let pictures = [
        "gray8.png",
        "gray8_interlaced.png",
        "rgba16.png",
        "palette4.png",
        "gray1.png",
        "rgb.jpg",
        "rgb_progressive.jpg",
        "gray.jpg",
    ]
    .map(golden);
    let mut random = 88_172_645_463_325_252_u64;
    let mut next = || {
        // xorshift64
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        random as usize
    };
    for round in 0..4000 {
        let mut bytes = pictures[round % pictures.len()].clone();
        for _ in 0..1 + next() % 4 {
            let at = next() % bytes.len();
            bytes[at] = next() as u8;
        }
        if round % 3 == 0 {
            repair_checksums(&mut bytes);
        }
        if reader.fill(&row(), &bytes, &mut frame).is_ok() {
            assert_eq!(frame.check(), Ok(()));
        }
    }
}

/// So that a changed chunk gets past the checksums, and into the decoder.
fn repair_checksums(bytes: &mut [u8]) {
    let mut at = 8;
    while let Some(length) = bytes.get(at..at + 4) {
        let end = at + 8 + u32::from_be_bytes(length.try_into().unwrap()) as usize;
        if end + 4 > bytes.len() {
            return;
        }
        let sum = crc(&bytes[at + 4..end]);
        bytes[end..end + 4].copy_from_slice(&sum.to_be_bytes());
        at = end + 4;
    }
}

/// The checksum of a PNG chunk, bit by bit.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |sum, byte| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| (sum >> 1) ^ (0xedb8_8320 * (sum & 1)))
    })
}

#[test]
fn a_simulated_frame_is_the_same_whenever_it_is_taken() {
    let (mut early, mut late) = (Frame::new_box_zeroed().unwrap(), Frame::new_box_zeroed().unwrap());
    late.pixels.fill(255);
    SimulatedCamera::new(simulation::Config::default(), 30.0, 5_000).fill(41, &mut early);
    let camera = SimulatedCamera::new(simulation::Config::default(), 30.0, 5_000);
    camera.fill(40, &mut late);
    camera.fill(41, &mut late);
    assert_eq!(early.check(), Ok(()));
    assert_eq!(
        (early.header.taken_ns, early.header.sequence),
        (5_000 + 41 * 33_333_333, 41)
    );
    assert_eq!((early.width, early.height), (late.width, late.height));
    assert!(early.image() == late.image());
}

#[test]
fn a_recorded_traverse_gives_a_frame_a_row_even_without_a_sound_picture() {
    let table = "file,taken_s,center_x_px,center_y_px,rim_radius_px,wheel_radius_px,pitch_rad\n\
                 gray8.png,0.1,6,2,3,4,0\nORIGIN.md,0.2,6,2,3,4,0\n";
    let mut camera = RecordedCamera::open("t", table.into()).unwrap();
    let mut frame = Frame::new_box_zeroed().unwrap();
    let row = camera.next_row().unwrap().unwrap();
    assert_eq!(camera.path(&row), "t/gray8.png");
    camera.fill(&row, Ok(&golden(&row.file)), &mut frame).unwrap();
    assert_eq!((frame.header.taken_ns, frame.header.sequence), (100_000_000, 0));
    let row = camera.next_row().unwrap().unwrap();
    let broken = golden(&row.file);
    for (png, status, words) in [
        (
            Ok(&broken[..]),
            Status::INPUT_REJECTED,
            "ORIGIN.md: neither a sound PNG file nor a JPEG file",
        ),
        (
            Err("t/a.png: no such file".to_owned()),
            Status::NO_DATA,
            "t/a.png: no such file",
        ),
    ] {
        let error = camera.fill(&row, png, &mut frame).unwrap_err().to_string();
        assert!(error.starts_with(&format!("t/frames.csv:3: {words}")), "{error}");
        assert_eq!(
            (frame.header.taken_ns, frame.header.sequence, frame.header.status),
            (200_000_000, 1, status)
        );
        assert!(frame.image().is_empty());
        assert_eq!(frame.check(), Ok(()));
    }
    assert_eq!((camera.next_row(), camera.last_ns()), (Ok(None), 200_000_000));
}

#[test]
fn a_config_is_one_of_the_two_sources_and_nothing_else() {
    let parse = |text: &str| toml::from_str::<Config>(text).map_err(|error| error.message().to_owned());
    let simulated = parse("source = \"simulated\"\nrover = { seed = 3 }").unwrap();
    assert!(matches!(&simulated, Config::Simulated { rate_hz: 30.0, rover } if rover.seed == 3));
    assert_eq!(simulated.validate(), Ok(()));
    let recorded = parse("source = \"recorded\"\nfolder = \"/t\"").unwrap();
    assert_eq!(recorded, Config::Recorded { folder: "/t".into() });
    for bad in [
        "",
        "source = \"device\"",
        "source = \"recorded\"",
        "source = \"recorded\"\nfolder = \"t\"\nrate_hz = 3",
    ] {
        assert!(parse(bad).is_err(), "{bad}");
    }
    let endless = parse("source = \"simulated\"\nrate_hz = inf").unwrap();
    assert_eq!(
        endless.validate(),
        Err(("rate_hz", "must be 0.1 to 1000, is inf".into()))
    );
}
