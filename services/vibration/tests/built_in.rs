//! The built-in model: made by the example, and right about the simulated rover.

#[allow(dead_code, unreachable_pub)]
#[path = "../examples/built_in_model.rs"]
mod example;

use messages::{Status, Vibration, label};
use simulation::{CHANNELS, Rover, SOILS};
use vibration::{Config, Model, VibrationClassifier};
use zerocopy::FromZeros;

#[test]
fn the_checked_in_model_is_what_the_example_prints() {
    let printed = example::built_in_model().expect("trains");
    let checked_in = include_str!("../src/built_in.toml");
    assert!(printed == checked_in, "train it again: see examples/built_in_model.rs");
}

#[test]
fn the_default_rover_is_recognised_on_every_soil() {
    let rover = Rover::new(simulation::Config::default());
    let mut classifier = VibrationClassifier::new(&Config::default(), Model::built_in());
    let mut piece = Vibration::new_box_zeroed().expect("memory");
    piece.period_ns = 10_000_000;
    piece.count = 10;
    piece.channel_count = 7;
    for (name, text) in piece.channels.iter_mut().zip(CHANNELS) {
        *name = label(text);
    }
    let (mut right, mut decided) = (0, 0);
    for index in 0..200_u64 {
        piece.start_ns = 5_000_000_000 + index * 100_000_000;
        for sample in 0..10 {
            piece.offset_ns[sample] = sample as u32 * 10_000_000;
            let values = rover.vibration(index as f64 * 0.1 + sample as f64 * 0.01);
            for (channel, value) in values.into_iter().enumerate() {
                piece.samples[channel][sample] = value;
            }
        }
        let answer = classifier.step(&piece);
        if index % 10 == 9 {
            let soil = rover.state(index as f64 * 0.1 - 0.4).soil;
            assert!([Status::OK, Status::UNKNOWN_TERRAIN].contains(&answer.header.status));
            decided += 1;
            right += u32::from(answer.class_text() == SOILS[soil].name);
        }
    }
    assert!(decided == 20 && right >= 18, "{right} of {decided}");
}
