//! The way of a picture: PNG bytes, a frame, the sinkage.

use camera::PictureReader;
use messages::{Frame, Header, Message, PIXELS_MAX, Status};
use sinkage::{Config, Method, SinkageTracker};
use std::cell::RefCell;
use traverse::FrameRow;
use zerocopy::{FromZeros, IntoBytes};

/// What is large, made once.
struct Bench {
    frame: Box<Frame>,
    trackers: [SinkageTracker; 2],
    reader: PictureReader,
}

thread_local! {
    static BENCH: RefCell<Bench> = RefCell::new(Bench {
        frame: Frame::new_box_zeroed().expect("memory for a frame"),
        trackers: [Method::Contrast, Method::LargestChange].map(|method| SinkageTracker::new(Config { method, ..Config::default() })),
        reader: PictureReader::default(),
    });
}

/// A PNG file: what is decoded is a frame that can be believed, and the tracker answers it.
pub fn picture(png: &[u8]) {
    BENCH.with_borrow_mut(|bench| {
        let row = FrameRow {
            line: 2,
            sequence: png.len() as u64,
            file: "a.png".into(),
            taken_ns: png.len() as u64,
            center_x_px: 64.0,
            center_y_px: 40.0,
            rim_radius_px: 32.0,
            wheel_radius_px: 40.0,
            pitch_rad: 0.1,
            homography: None,
        };
        if bench.reader.fill(&row, png, &mut bench.frame).is_ok() {
            assert_eq!(bench.frame.check(), Ok(()));
            track(bench);
        }
    });
}

/// A frame as a foreign process writes it: the first bytes are its head, the rest fills the picture. It is tried without
/// the shell's check, too: who writes it can change it after that.
pub fn frame_sample(bytes: &[u8]) {
    const HEAD: usize = size_of::<Frame>() - PIXELS_MAX;
    BENCH.with_borrow_mut(|bench| {
        let frame = &mut bench.frame;
        let (head, pixels) = bytes.split_at(bytes.len().min(HEAD));
        frame.as_mut_bytes()[..HEAD].fill(0);
        frame.as_mut_bytes()[..head.len()].copy_from_slice(head);
        if !pixels.is_empty() {
            let shown = frame.image().len().max(1);
            for (target, value) in frame.pixels[..shown].iter_mut().zip(pixels.iter().cycle()) {
                *target = *value;
            }
        }
        track(bench);
        if bench.frame.check().is_err() {
            (bench.frame.width, bench.frame.height) = (0, 0);
            bench.frame.header.status = Status::BAD_SAMPLE;
            track(bench);
        }
    });
}

/// Each method's answer is to this frame, and can be believed.
fn track(bench: &mut Bench) {
    let asked = bench.frame.header;
    for tracker in &mut bench.trackers {
        let answer = tracker.step(&bench.frame);
        assert_eq!(answer.check(), Ok(()), "{answer:?}");
        assert_eq!(
            answer.header,
            Header {
                status: answer.header.status,
                ..asked.answer(asked.status)
            }
        );
        assert_ne!(answer.header.status, Status::ENDED);
        assert_eq!(answer.header.status.is_answer(), answer.entry_rad.is_finite());
    }
}
