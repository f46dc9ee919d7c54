//! Pictures that no one would choose: the tracker never panics on them, and says honestly what it saw.

#![allow(clippy::unwrap_used)]

use messages::{Frame, Message, PIXELS_MAX, Sinkage, Status};
use sinkage::profile::profiles;
use sinkage::{Config, Method, SinkageTracker};
use zerocopy::FromZeros;

const SIZES: [(u32, u32); 6] = [(320, 240), (640, 480), (1024, 1024), (1 << 20, 1), (1, 1 << 20), (1, 1)];

/// A picture of this size, with a wheel of some share of it in its middle.
fn picture(width: u32, height: u32, gray: impl Fn(u32, u32) -> u8) -> Box<Frame> {
    let mut frame = Frame::new_box_zeroed().unwrap();
    (frame.width, frame.height) = (width, height);
    for (index, pixel) in frame.pixels[..(width * height) as usize].iter_mut().enumerate() {
        *pixel = gray(index as u32 % width, index as u32 / width);
    }
    let radius_px = f64::from(width.min(height)) / 3.0;
    put_wheel(&mut frame, f64::from(width) / 2.0, f64::from(height) / 2.0, radius_px);
    frame
}

fn put_wheel(frame: &mut Frame, x_px: f64, y_px: f64, radius_px: f64) {
    (frame.center_x_px, frame.center_y_px) = (x_px, y_px);
    (frame.rim_radius_px, frame.wheel_radius_px) = (0.8 * radius_px, radius_px);
    frame.homography = Frame::circle_homography(x_px, y_px, radius_px, 0.0);
}

/// A gray rim on a dark wheel, dark ground from `depth` radii above the wheel's lowest point on, in a picture of any size.
fn wheel(width: u32, height: u32, depth: f64) -> Box<Frame> {
    let (x_px, y_px) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
    let radius_px = f64::from(width.min(height)) / 3.0;
    picture(width, height, |column, row| {
        let grain = (scrambled(row * width + column) % 12) as u8;
        let (x, z) = (
            (f64::from(column) - x_px) / radius_px,
            (f64::from(row) - y_px) / radius_px,
        );
        grain
            + match x.hypot(z) {
                _ if z > 1.0 - depth => 80,
                r if r < 0.8 => 30,
                r if r < 1.0 => 180,
                _ => 110,
            }
    })
}

/// The hash of a number.
fn scrambled(number: u32) -> u32 {
    let mixed = (number ^ number >> 16).wrapping_mul(0x7feb_352d);
    let mixed = (mixed ^ mixed >> 15).wrapping_mul(0x846c_a68b);
    mixed ^ mixed >> 16
}

/// What both methods say, new and after another picture: the default method's answer.
fn answer(frame: &Frame) -> Sinkage {
    let [contrast, change] = [Method::Contrast, Method::LargestChange].map(|method| {
        let mut tracker = SinkageTracker::new(Config {
            method,
            ..Config::default()
        });
        let first = tracker.step(frame);
        for answer in [first, tracker.step(frame)] {
            assert_eq!(answer.check_values(), Ok(()), "{method:?}: {answer:?}");
            assert_eq!(
                answer.header.status.is_answer(),
                answer.entry_rad.is_finite(),
                "{method:?}"
            );
        }
        first
    });
    let _ = (change, profiles(frame));
    contrast
}

#[test]
fn a_wheel_is_measured_in_pictures_of_every_size() {
    for (width, height) in [(320, 240), (640, 480), (1024, 1024), (1365, 768), (700, 1400)] {
        for depth in [0.1, 0.3] {
            let answer = answer(&wheel(width, height, depth));
            let found = 1.0 - answer.entry_rad.cos();
            assert_eq!(answer.header.status, Status::OK, "{width}x{height}: {answer:?}");
            assert!(
                (found - depth).abs() < 0.015,
                "{width}x{height}: {found} instead of {depth}"
            );
        }
    }
}

#[test]
fn black_white_and_gray_pictures_show_nothing() {
    for (width, height) in SIZES {
        for gray in [0, 1, 128, 255] {
            assert_eq!(
                answer(&picture(width, height, |_, _| gray)).header.status,
                Status::NOT_VISIBLE,
                "{width}x{height}, {gray}"
            );
        }
    }
}

#[test]
fn noise_is_never_a_sure_answer() {
    for (width, height) in SIZES {
        for seed in 0..3 {
            for contrast in [1, 4, 20, 255] {
                let noise = |x, y| (scrambled(scrambled(y * width + x) + seed) % (contrast + 1)) as u8;
                let answer = answer(&picture(width, height, noise));
                assert_ne!(
                    answer.header.status,
                    Status::OK,
                    "{width}x{height}, {contrast}: {answer:?}"
                );
            }
        }
    }
}

#[test]
fn a_wheel_beyond_the_picture_is_not_visible_and_one_across_its_edge_is_never_wrong_and_sure() {
    let mut frame = wheel(640, 480, 0.2);
    let pixels = frame.image().to_vec();
    for right_px in (-800..=800).step_by(160) {
        for down_px in (-600..=600).step_by(100) {
            // The picture is shifted under its frame.
            for y in 0..480 {
                for x in 0..640 {
                    let (from_x, from_y) = ((x - right_px).clamp(0, 639), (y - down_px).clamp(0, 479));
                    frame.pixels[(y * 640 + x) as usize] = pixels[(from_y * 640 + from_x) as usize];
                }
            }
            let (x_px, y_px) = (320.0 + f64::from(right_px), 240.0 + f64::from(down_px));
            put_wheel(&mut frame, x_px, y_px, 160.0);
            let answer = answer(&frame);
            let status = answer.header.status;
            let outside = !(-160.0..=800.0).contains(&x_px) || !(-160.0..=480.0).contains(&y_px);
            assert!(
                !outside || status == Status::NOT_VISIBLE,
                "({x_px}, {y_px}): {answer:?}"
            );
            let wrong = ((1.0 - answer.entry_rad.cos()) - 0.2).abs() > 0.03;
            assert!(!wrong || status != Status::OK, "({x_px}, {y_px}): {answer:?}");
        }
    }
}

#[test]
fn a_radius_beyond_the_picture_gets_an_honest_status() {
    let mut frame = wheel(640, 480, 0.2);
    for radius_px in [0.0, 1e-300, 1.0, 19.0, 400.0, 1e3, 1e5, 9.9e5, 1e6, 1e300] {
        for (x_px, y_px) in [
            (320.0, 240.0),
            (0.0, 0.0),
            (320.0, 240.0 - radius_px),
            (-radius_px, radius_px),
        ] {
            put_wheel(&mut frame, x_px, y_px, radius_px);
            let status = answer(&frame).header.status;
            assert_ne!(status, Status::OK, "{radius_px} px at ({x_px}, {y_px})");
        }
    }
}

#[test]
fn geometry_and_size_that_lie_are_survived() {
    let wrong = [f64::NAN, f64::INFINITY, -f64::INFINITY, 0.0, -0.0, -1.0, 1e308];
    let (good, mut frame) = (wheel(320, 240, 0.2), wheel(320, 240, 0.2));
    for value in wrong {
        put_wheel(&mut frame, value, value, value);
        assert_eq!(answer(&frame).header.status, Status::BAD_GEOMETRY, "{value}");
        frame.homography = good.homography;
        assert_eq!(answer(&frame).header.status, Status::BAD_GEOMETRY, "{value}");
    }
    put_wheel(&mut frame, 160.0, 120.0, 80.0);
    let sizes = [0, 1, 3, 239, 240, 319, 321, 1 << 20, u32::MAX];
    for (width, height) in sizes.into_iter().flat_map(|width| sizes.map(|height| (width, height))) {
        (frame.width, frame.height) = (width, height);
        let status = answer(&frame).header.status;
        let pixels = u64::from(width) * u64::from(height);
        let fits = (1..=PIXELS_MAX as u64).contains(&pixels);
        assert_eq!(status == Status::INPUT_REJECTED, !fits, "{width}x{height}");
    }
}
