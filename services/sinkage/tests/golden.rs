//! The tracker on rendered traverses with known truth, on drawn wheels, and on frames no camera would send.

#![allow(clippy::unwrap_used)]

use messages::{Frame, Header, Message, Sinkage, Status};
use sinkage::cells::{COLUMNS, Cells, Lookup, log_table};
use sinkage::center::Shift;
use sinkage::rim::Rim;
use sinkage::rows::{ROWS, Side, accumulate};
use sinkage::weights::{NAMES, Weights};
use sinkage::{Config, Method, Rolls, SinkageTracker};
use std::path::{Path, PathBuf};
use zerocopy::FromZeros;

fn clip(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("golden/sinkage_sample")
        .join(name)
}

/// The lines of a table after its heading, in cells.
fn table(path: &Path) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines()
        .skip(1)
        .map(|line| line.split(',').map(str::to_owned).collect())
        .collect()
}

fn load(clip: &Path, row: &[String]) -> Box<Frame> {
    let picture = image::open(clip.join(&row[0])).unwrap().into_luma8();
    let numbers: Vec<f64> = row[1..].iter().map(|cell| cell.parse().unwrap()).collect();
    let mut frame = Frame::new_box_zeroed().unwrap();
    frame.header.taken_ns = 1_000_000_000 + (1e9 * numbers[0]) as u64;
    (frame.width, frame.height) = picture.dimensions();
    frame.pixels[..picture.len()].copy_from_slice(&picture);
    (frame.center_x_px, frame.center_y_px) = (numbers[1], numbers[2]);
    (frame.rim_radius_px, frame.wheel_radius_px, frame.pitch_rad) = (numbers[3], numbers[4], numbers[5]);
    frame.homography.copy_from_slice(&numbers[6..15]);
    frame
}

/// Every side of a clip: error of 1 - cos θ, its sigma by the way of the angle, and the answer.
fn errors(name: &str, method: Method) -> Vec<(f64, f64, Sinkage)> {
    let clip = clip(name);
    let mut tracker = SinkageTracker::new(Config {
        method,
        ..Config::default()
    });
    let mut errors = Vec::new();
    for (row, truth) in table(&clip.join("frames.csv"))
        .iter()
        .zip(table(&clip.join("truth.csv")))
    {
        let answer = tracker.step(&load(&clip, row));
        let sides = [
            (answer.left_rad, answer.left_sigma_rad),
            (answer.right_rad, answer.right_sigma_rad),
        ];
        for ((angle, sigma), truth) in sides.into_iter().zip(&truth[1..3]) {
            errors.push((
                truth.parse::<f64>().unwrap().cos() - angle.cos(),
                sigma * angle.sin(),
                answer,
            ));
        }
    }
    errors
}

/// Root mean square and largest error of a clip, in wheel radii.
fn summary(errors: &[(f64, f64, Sinkage)]) -> (f64, f64) {
    let square: f64 = errors.iter().map(|(error, ..)| error * error).sum();
    let largest = errors.iter().map(|(error, ..)| error.abs()).fold(0.0, f64::max);
    ((square / errors.len() as f64).sqrt(), largest)
}

#[test]
fn every_condition_is_measured_to_one_percent_of_the_radius_and_hard_shadows_to_three() {
    for (name, bound) in [
        ("c1_a", 0.006),
        ("c2_a", 0.006),
        ("c3_a", 0.009),
        ("c4_a", 0.010),
        ("c5_a", 0.030),
        ("c6_a", 0.011),
    ] {
        let errors = errors(name, Method::Contrast);
        let (rms, largest) = summary(&errors);
        println!("{name}: rms {rms:.4}, largest {largest:.4}");
        assert!(rms < bound, "{name}: rms {rms}, largest {largest}");
        for (error, sigma, answer) in errors {
            assert!(answer.header.status == Status::OK || name == "c5_a", "{name}");
            assert!(
                error.abs() < 4.0 * sigma,
                "{name}: {error} is more than four times {sigma}"
            );
        }
    }
}

#[test]
fn the_papers_method_measures_clean_scenes_to_two_percent_of_the_radius() {
    for name in ["c1_a", "c3_a"] {
        let errors = errors(name, Method::LargestChange);
        let (rms, largest) = summary(&errors);
        println!("{name}: rms {rms:.4}, largest {largest:.4}");
        assert!(rms < 0.018 && largest < 0.03, "{name}: rms {rms}, largest {largest}");
        for (error, sigma, answer) in errors {
            assert_eq!(answer.header.status, Status::OK, "{name}");
            assert!(
                error.abs() < 3.0 * sigma,
                "{name}: {error} is more than three times {sigma}"
            );
        }
    }
}

#[test]
fn every_rendered_frame_gets_a_valid_answer() {
    for name in ["c1_a", "c2_a", "c3_a", "c4_a", "c5_a", "c6_a"] {
        let errors = errors(name, Method::Contrast);
        assert_eq!(errors.len(), 8, "{name}");
        let (rms, largest) = summary(&errors);
        println!("{name}: rms {rms:.4}, largest {largest:.4}");
        for (_, _, answer) in errors {
            assert_eq!(answer.check_values(), Ok(()), "{name}");
            assert!(answer.header.status.is_answer(), "{name}");
            assert!(
                (answer.sinkage_m - 0.15 * (1.0 - answer.entry_rad.cos())).abs() < 1e-12,
                "{name}"
            );
            assert_eq!(
                (answer.entry_rad, answer.exit_rad),
                (answer.right_rad, -answer.left_rad),
                "{name}"
            );
        }
    }
}

/// The point of the wheel-face plane that a pixel shows, from the two linear equations of the projection.
fn plane_point(h: &[f64; 9], column: f64, row: f64) -> (f64, f64) {
    let (a, b, p) = (h[0] - column * h[6], h[1] - column * h[7], column * h[8] - h[2]);
    let (c, d, q) = (h[3] - row * h[6], h[4] - row * h[7], row * h[8] - h[5]);
    let determinant = a * d - b * c;
    ((p * d - b * q) / determinant, (a * q - p * c) / determinant)
}

/// Two tones: a rim of 170 down to the soil of 90 on each side, under spokes of 20 and before a sky of 240.
fn draw(homography: [f64; 9], pose: [f64; 5], left_rad: f64, right_rad: f64) -> Box<Frame> {
    let mut frame = Frame::new_box_zeroed().unwrap();
    (frame.width, frame.height) = (640, 480);
    (frame.center_x_px, frame.center_y_px) = (pose[0], pose[1]);
    (frame.rim_radius_px, frame.wheel_radius_px, frame.pitch_rad) = (pose[2], pose[3], pose[4]);
    frame.homography = homography;
    frame.header = Header {
        taken_ns: 5,
        sequence: 7,
        ..Header::default()
    };
    for row in 0..480 {
        for column in 0..640 {
            let (x, z) = plane_point(&homography, f64::from(column), f64::from(row));
            let soil = z > if x < 0.0 { left_rad.cos() } else { right_rad.cos() };
            let radius = x.hypot(z);
            let above = if radius < pose[2] / pose[3] { 20 } else { 170 };
            let sky = if radius > 1.0 { 240 } else { above };
            frame.pixels[(row * 640 + column) as usize] = if soil { 90 } else { sky };
        }
    }
    frame
}

const POSE: [f64; 5] = [321.3, 200.7, 131.2, 163.9, 0.07];

fn face_on() -> [f64; 9] {
    Frame::circle_homography(POSE[0], POSE[1], POSE[3], POSE[4])
}

/// Seen somewhat from above and from the side, the sign of the matrix the other way round.
fn perspective() -> [f64; 9] {
    [-163.0, -10.5, -321.0, 12.0, -165.0, -201.0, 0.002, -0.011, -1.0]
}

#[test]
fn a_drawn_wheel_is_measured_to_one_row() {
    let mut tracker = SinkageTracker::new(Config::default());
    for homography in [face_on(), perspective()] {
        for (left_rad, right_rad) in [(0.3, 0.6), (0.45, 0.35), (0.9, 1.2), (0.5, 0.5), (0.25, 1.0)] {
            let answer = tracker.step(&draw(homography, POSE, left_rad, right_rad));
            assert_eq!(answer.header.status, Status::OK, "{left_rad} {right_rad}: {answer:?}");
            for (found, truth) in [(answer.left_rad, left_rad), (answer.right_rad, right_rad)] {
                let rows = (found.cos() - truth.cos()) * ROWS as f64;
                assert!(rows.abs() < 1.0, "{truth} is found at {found}, {rows} rows away");
            }
            assert_eq!((answer.header.taken_ns, answer.header.sequence), (5, 7));
        }
    }
}

#[test]
fn the_entry_is_on_the_side_to_which_the_wheel_rolls() {
    let frame = draw(face_on(), POSE, 0.4, 0.7);
    let right = SinkageTracker::new(Config {
        radius_m: 0.2,
        ..Config::default()
    })
    .step(&frame);
    assert_eq!((right.entry_rad, right.exit_rad), (right.right_rad, -right.left_rad));
    assert!((right.sinkage_m - 0.2 * (1.0 - 0.7_f64.cos())).abs() < 0.2 / ROWS as f64);
    let left = SinkageTracker::new(Config {
        rolls: Rolls::Left,
        ..Config::default()
    })
    .step(&frame);
    assert_eq!((left.entry_rad, left.exit_rad), (right.left_rad, -right.right_rad));
    assert!((left.sinkage_m - 0.15 * (1.0 - 0.4_f64.cos())).abs() < 0.15 / ROWS as f64);
}

/// A tracker of the paper's method.
fn paper() -> SinkageTracker {
    SinkageTracker::new(Config {
        method: Method::LargestChange,
        ..Config::default()
    })
}

#[test]
fn two_changes_alike_are_uncertain_and_one_of_them_is_given() {
    let mut frame = draw(face_on(), POSE, 0.5, 0.5);
    for row in 0..480 {
        for column in 0..640 {
            let (x, z) = plane_point(&frame.homography, f64::from(column), f64::from(row));
            let stripe = x > 0.0 && z > 0.5 && z < 0.7;
            frame.pixels[(row * 640 + column) as usize] = if stripe || (x < 0.0 && z > 0.6) { 90 } else { 170 };
        }
    }
    let answer = paper().step(&frame);
    assert_eq!(answer.header.status, Status::UNCERTAIN);
    assert!(answer.confidence < 0.6, "{answer:?}");
    assert!(
        [0.5, 0.7]
            .iter()
            .any(|z| (answer.entry_rad.cos() - z).abs() < 1.0 / ROWS as f64),
        "{answer:?}"
    );
    assert!(answer.sinkage_sigma_m > 0.1 * 0.15, "{answer:?}");
    assert_eq!(answer.check_values(), Ok(()));
}

#[test]
fn row_means_agree_with_the_slow_obvious_ones() {
    let name = clip("c2_a");
    let mut frames: Vec<Box<Frame>> = table(&name.join("frames.csv"))
        .iter()
        .map(|row| load(&name, row))
        .collect();
    frames.push(draw(perspective(), POSE, 0.4, 0.7));
    for frame in frames {
        let mut slow = [Side::EMPTY; 2];
        let inner = frame.rim_radius_px / frame.wheel_radius_px + 0.01;
        for (index, gray) in frame.image().iter().enumerate() {
            let (column, row) = (index % frame.width as usize, index / frame.width as usize);
            let (x, z) = plane_point(&frame.homography, column as f64, row as f64);
            if z >= 0.0 && (inner..0.99).contains(&x.hypot(z)) {
                let side = &mut slow[usize::from(x >= 0.0)];
                side.sums[(z * ROWS as f64) as usize] += f64::from(*gray);
                side.counts[(z * ROWS as f64) as usize] += 1.0;
            }
        }
        let mut sides = [Side::EMPTY; 2];
        let rim = Rim::locate(&frame, 640, 480).unwrap();
        accumulate(frame.image(), 640, &rim, &mut sides);
        assert!(slow.iter().all(|side| (side.pixels() / rim.side_px - 1.0).abs() < 0.1));
        assert_eq!(sides, slow);
    }
}

#[test]
fn a_wrong_centre_and_radius_are_refined_on_the_inner_edge() {
    for (x_px, y_px, growth) in [(0.0, 0.0, 1.0), (1.2, -0.8, 1.003), (-0.5, 1.3, 0.997)] {
        let mut frame = draw(face_on(), POSE, 0.5, 0.5);
        frame.homography = Frame::circle_homography(POSE[0] + x_px, POSE[1] + y_px, growth * POSE[3], POSE[4]);
        let shift = Shift::find(frame.image(), 640, &frame).unwrap();
        let pixel = 1.0 / POSE[3];
        let (sin, cos) = POSE[4].sin_cos();
        let (column, row) = (
            shift.right * cos + shift.down * sin,
            shift.down * cos - shift.right * sin,
        );
        assert!((column + x_px * pixel).abs() < 0.15 * pixel, "{column} {x_px}");
        assert!((row + y_px * pixel).abs() < 0.15 * pixel, "{row} {y_px}");
        assert!(
            (shift.growth - (1.0 / growth - 1.0)).abs() < 0.001,
            "{} {growth}",
            shift.growth
        );
        let answer = SinkageTracker::new(Config::default()).step(&frame);
        assert!(
            (answer.center_x_px - POSE[0]).hypot(answer.center_y_px - POSE[1]) < 0.2,
            "{answer:?}"
        );
        assert!((answer.left_rad.cos() - 0.5_f64.cos()).abs() < 0.006, "{answer:?}");
    }
}

#[test]
fn cells_agree_with_the_slow_obvious_ones() {
    let table = log_table();
    for frame in [draw(face_on(), POSE, 0.4, 0.7), draw(perspective(), POSE, 0.4, 0.7)] {
        let rim = Rim::locate(&frame, 640, 480).unwrap();
        let mut slow = [Cells::EMPTY; 2];
        for side in &mut slow {
            side.bands.fill(0..ROWS);
        }
        for (index, gray) in frame.image().iter().enumerate() {
            let (x, z) = plane_point(&frame.homography, (index % 640) as f64, (index / 640) as f64);
            if z >= 0.0 && (rim.inner..rim.outer).contains(&x.hypot(z)) {
                let column = (x.abs() * COLUMNS as f64) as usize;
                let cell = &mut slow[usize::from(x >= 0.0)].cells[column][(z * ROWS as f64) as usize];
                // Texture is the step from two pixels to the left, or to the right where no rim is on the left.
                let inside = |index: usize| {
                    let (x, z) = plane_point(&frame.homography, (index % 640) as f64, (index / 640) as f64);
                    z >= 0.0 && (rim.inner..rim.outer).contains(&x.hypot(z))
                };
                let other = if inside(index - 1) && inside(index - 2) {
                    index - 2
                } else {
                    index + 2
                };
                let texture = |gray: u8| (f32::from(gray) + 16.0).ln();
                cell[0] += 1.0;
                cell[1] += table[usize::from(*gray)][1];
                cell[2] += table[usize::from(*gray)][1].powi(2);
                cell[3] += (texture(*gray) - texture(frame.image()[other])).powi(2);
            }
        }
        let mut cells = [Cells::EMPTY; 2];
        let mut lookup = Lookup::new();
        lookup.prepare(&rim, 640);
        lookup.accumulate(frame.image(), &table, &mut cells);
        let total: f32 = slow.iter().map(Cells::pixels).sum();
        let pairs = cells.iter().zip(&slow);
        // Single precision may put a pixel on a border into the neighbouring cell.
        let moved: f32 = pairs
            .flat_map(|(a, b)| a.cells.as_flattened().iter().zip(b.cells.as_flattened()))
            .map(|(a, b)| (a[0] - b[0]).abs())
            .sum();
        assert!(moved < 0.002 * total, "{moved} of {total} pixels");
        for sum in 1..4 {
            let all = |sides: &[Cells; 2]| {
                sides
                    .iter()
                    .flat_map(|side| side.cells.as_flattened())
                    .map(|cell| f64::from(cell[sum]))
                    .sum::<f64>()
            };
            assert!(
                (all(&cells) / all(&slow) - 1.0).abs() < 1e-3,
                "{sum}: {} {}",
                all(&cells),
                all(&slow)
            );
        }
    }
}

#[test]
fn the_weights_file_names_every_feature() {
    let text = include_str!("../src/weights.txt");
    for name in NAMES
        .into_iter()
        .chain(["units_out", "units_bias", "bias", "sigma", "temper"])
    {
        let lines = text.lines().filter(|line| line.split(' ').next() == Some(name));
        assert_eq!(lines.count(), 1, "{name}");
    }
    let fitted = Weights::fitted();
    assert!(fitted.features.iter().all(|weight| *weight != 0.0));
    assert!(
        fitted
            .units
            .iter()
            .all(|unit| unit.weights.iter().all(|weight| *weight != 0.0))
    );
    let parsed = Weights::parse("contrast 2 3\nbias none\nunits_out 4 5\n");
    assert_eq!(
        (
            parsed.features[0],
            parsed.units[0].weights[0],
            parsed.units[1].out,
            parsed.bias
        ),
        (2.0, 3.0, 5.0, 0.0)
    );
}

fn status_of(frame: &Frame) -> Status {
    let answer = SinkageTracker::new(Config::default()).step(frame);
    assert_eq!(answer.check_values(), Ok(()), "{answer:?}");
    answer.header.status
}

#[test]
fn frames_that_are_no_answer_are_rejected_and_a_missing_picture_stays_missing() {
    let mut frame = draw(face_on(), POSE, 0.5, 0.5);
    for number in (0..20).chain([u32::MAX]) {
        frame.header.status = Status(number);
        let status = status_of(&frame);
        match frame.header.status {
            Status::OK | Status::UNCERTAIN => assert!(status.is_answer(), "{number}"),
            Status::NO_DATA => assert_eq!(status, Status::NO_DATA),
            _ => assert_eq!(status, Status::INPUT_REJECTED, "{number}"),
        }
    }
}

#[test]
fn sizes_that_no_frame_has_are_survived() {
    let mut frame = draw(face_on(), POSE, 0.5, 0.5);
    let sizes = [0, 1, 2, 639, 640, 1 << 20, (1 << 20) + 1, u32::MAX];
    for width in sizes {
        for height in sizes {
            (frame.width, frame.height) = (width, height);
            let status = status_of(&frame);
            let pixels = u64::from(width) * u64::from(height);
            assert_eq!(
                status == Status::INPUT_REJECTED,
                pixels == 0 || pixels > 1 << 20,
                "{width} {height}"
            );
        }
    }
    (frame.width, frame.height) = (1, 1);
    assert_eq!(status_of(&frame), Status::NOT_VISIBLE);
}

#[test]
fn geometry_that_contradicts_itself_is_refused() {
    let wrong = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        0.0,
        -1.0,
        1e-300,
        1e6,
        1e9,
        -1e9,
        f64::MAX,
    ];
    let mut frame = draw(face_on(), POSE, 0.5, 0.5);
    for value in wrong {
        for k in 0..14 {
            (frame.center_x_px, frame.center_y_px) = (POSE[0], POSE[1]);
            (frame.rim_radius_px, frame.wheel_radius_px, frame.pitch_rad) = (POSE[2], POSE[3], POSE[4]);
            frame.homography = face_on();
            match k {
                0 => frame.center_x_px = value,
                1 => frame.center_y_px = value,
                2 => frame.rim_radius_px = value,
                3 => frame.wheel_radius_px = value,
                4 => frame.pitch_rad = value,
                _ => frame.homography[k - 5] = value,
            }
            let status = status_of(&frame);
            assert!(
                value.is_finite() || status == Status::BAD_GEOMETRY,
                "{value} at {k}: {status:?}"
            );
        }
        frame.homography = [value; 9];
        assert_eq!(status_of(&frame), Status::BAD_GEOMETRY, "{value}");
    }
}

#[test]
fn a_wheel_without_contrast_or_outside_the_picture_is_not_visible() {
    let mut frame = draw(face_on(), POSE, 0.5, 0.5);
    for gray in [0, 128, 255] {
        frame.pixels.fill(gray);
        assert_eq!(status_of(&frame), Status::NOT_VISIBLE);
    }
    for (x_px, y_px) in [
        (-500.0, 200.0),
        (1200.0, 200.0),
        (320.0, -400.0),
        (320.0, 700.0),
        (320.0, 430.0),
        (9e5, -9e5),
    ] {
        let homography = Frame::circle_homography(x_px, y_px, POSE[3], 0.0);
        let frame = draw(homography, [x_px, y_px, POSE[2], POSE[3], 0.0], 0.5, 0.5);
        assert_eq!(status_of(&frame), Status::NOT_VISIBLE, "{x_px} {y_px}");
    }
    let small = draw(
        Frame::circle_homography(320.0, 240.0, 9.0, 0.0),
        [320.0, 240.0, 6.0, 9.0, 0.0],
        0.5,
        0.5,
    );
    assert_eq!(status_of(&small), Status::NOT_VISIBLE);
}

#[test]
fn a_side_outside_the_picture_is_nan_and_the_other_is_given() {
    let pose = [600.0, 200.7, 131.2, 163.9, 0.0];
    let frame = draw(Frame::circle_homography(600.0, 200.7, 163.9, 0.0), pose, 0.5, 0.5);
    let exit = SinkageTracker::new(Config {
        rolls: Rolls::Left,
        ..Config::default()
    })
    .step(&frame);
    assert_eq!(exit.header.status, Status::UNCERTAIN);
    assert!(exit.exit_rad.is_nan() && exit.right_rad.is_nan() && exit.entry_rad == exit.left_rad);
    let entry = SinkageTracker::new(Config::default()).step(&frame);
    assert_eq!(entry.header.status, Status::NOT_VISIBLE);
    assert!(entry.entry_rad.is_nan() && entry.sinkage_m.is_nan() && entry.exit_rad == -exit.left_rad);
}

#[test]
fn a_configuration_names_what_is_wrong() {
    let parse = |text: &str| toml::from_str::<Config>(text);
    assert_eq!(parse(""), Ok(Config::default()));
    let given = parse("radius_m = 0.1\nrolls = 'left'\nmethod = 'largest_change'").unwrap();
    assert_eq!(
        given,
        Config {
            radius_m: 0.1,
            rolls: Rolls::Left,
            method: Method::LargestChange
        }
    );
    assert!(parse("radius = 0.1").is_err() && parse("rolls = 'up'").is_err() && parse("method = 'best'").is_err());
    assert_eq!(Config::default().validate(), Ok(()));
    for radius_m in [0.0, -1.0, 10.1, f64::NAN, f64::INFINITY] {
        let (key, remedy) = Config {
            radius_m,
            ..Config::default()
        }
        .validate()
        .unwrap_err();
        assert_eq!(key, "radius_m");
        assert!(remedy.contains("above 0 and at most 10"), "{remedy}");
    }
}

#[test]
fn the_largest_change_agrees_with_numpy_to_a_fifth_of_a_percent_of_the_radius() {
    let reference = table(&Path::new(env!("CARGO_MANIFEST_DIR")).join("golden/largest_change.csv"));
    for name in ["c1_a", "c2_a", "c3_a", "c4_a", "c5_a", "c6_a"] {
        let rows: Vec<_> = reference.iter().filter(|row| row[0] == name).collect();
        let frames = table(&clip(name).join("frames.csv"));
        assert_eq!(rows.len(), frames.len());
        let mut square = 0.0;
        for (row, frame) in rows.iter().zip(&frames) {
            let answer = paper().step(&load(&clip(name), frame));
            for (angle, cosine) in [answer.left_rad, answer.right_rad].into_iter().zip(&row[2..4]) {
                square += (angle.cos() - cosine.parse::<f64>().unwrap()).powi(2);
            }
        }
        let rms = (square / (2 * rows.len()) as f64).sqrt();
        assert!(rms < 0.002, "{name}: {rms}");
    }
}
