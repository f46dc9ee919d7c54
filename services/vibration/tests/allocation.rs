//! The stage allocates nothing once it is built, whatever comes.

#![allow(clippy::unwrap_used)]

use allocation_counter::measure;
use messages::{Resumable, Status, Vibration, label};
use simulation::{CHANNELS, Rover};
use vibration::{Config, Model, VibrationClassifier};
use zerocopy::FromZeros;

fn pieces() -> Vec<Box<Vibration>> {
    let rover = Rover::new(simulation::Config::default());
    let piece = |index: u64| {
        let mut piece = Vibration::new_box_zeroed().unwrap();
        piece.start_ns = index * 100_000_000;
        piece.period_ns = 10_000_000;
        piece.count = 10;
        piece.channel_count = 7;
        for (name, text) in piece.channels.iter_mut().zip(CHANNELS) {
            *name = label(text);
        }
        for sample in 0..10 {
            piece.offset_ns[sample] = sample as u32 * 10_000_000;
            let values = rover.vibration(index as f64 * 0.1 + sample as f64 * 0.01);
            for (channel, value) in values.into_iter().enumerate() {
                piece.samples[channel][sample] = value;
            }
        }
        piece
    };
    (0..100).map(piece).collect()
}

#[test]
fn no_window_needs_memory() {
    let mut pieces = pieces();
    pieces[42].samples[0][3] = f32::NAN;
    pieces[55].header.status = Status::BAD_SAMPLE;
    pieces[68].count = 0;
    pieces[79].start_ns = 0;
    let mut classifier = VibrationClassifier::new(&Config::default(), Model::built_in());
    let mut state = vec![0; classifier.state_bytes()];
    let mut decided = 0;
    let counted = measure(|| {
        for piece in &pieces {
            decided += u32::from(classifier.step(piece).header.status == Status::OK);
            classifier.save(&mut state);
        }
    });
    assert!(decided > 30, "{decided}");
    assert_eq!(counted.count_total, 0);
}

#[test]
fn what_needs_memory_is_counted() {
    assert_eq!(measure(|| drop(std::hint::black_box(vec![0.0; 100]))).count_total, 1);
}
