//! The stage as the shell sees it: pieces in, one answer each, whatever the pieces hold.

#![allow(clippy::unwrap_used)]

use messages::{CHANNELS_MAX, Message, SAMPLES_MAX, Status, TerrainClass, Vibration, label};
use vibration::model::{Filtering, Method, Rejecting};
use vibration::recording::Recording;
use vibration::train::{Setup, Trained, train};
use vibration::{Config, Model, VibrationClassifier};
use zerocopy::FromZeros;

const RATE_HZ: f64 = 100.0;
const PERIOD_NS: u64 = 10_000_000;
const WINDOW: usize = 100;
const PIECE: usize = 10;
const CHANNELS: [&str; 3] = ["acceleration_z_m_s2", "angular_rate_y_rad_s", "linear_velocity_m_s"];

/// Uniform noise, the same on every machine.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    }
}

/// A made-up terrain: noise through a first-order filter, smooth on one class and rough on the next.
struct Terrain {
    noise: Noise,
    state: [f64; 2],
    memory: f64,
}

impl Terrain {
    fn new(class: usize, seed: u64) -> Self {
        Self {
            noise: Noise(seed),
            state: [0.0; 2],
            memory: [0.9, 0.3, -0.5][class],
        }
    }

    fn next(&mut self) -> [f64; 3] {
        for state in &mut self.state {
            *state = self.memory * *state + self.noise.next();
        }
        [self.state[0], self.state[1], 0.2]
    }
}

fn setup(classes: usize, method: Method) -> Setup {
    Setup {
        labels: ["loam", "gravel", "rock"][..classes]
            .iter()
            .map(|name| (*name).to_owned())
            .collect(),
        channels: CHANNELS[..2].iter().map(|name| (*name).to_owned()).collect(),
        rate_hz: RATE_HZ,
        window_samples: WINDOW,
        method,
        filtering: Filtering::Hmm,
        rejecting: Rejecting::Calibrated,
    }
}

/// Three recordings of 20 windows of each class.
fn recordings(classes: usize) -> Vec<Recording> {
    let one = |class: usize, seed: u64| {
        let mut terrain = Terrain::new(class, seed);
        let samples: Vec<[f64; 3]> = (0..20 * WINDOW).map(|_| terrain.next()).collect();
        Recording {
            run: format!("{class}_{seed}"),
            class,
            taken_ns: (0..samples.len() as u64).map(|index| index * PERIOD_NS).collect(),
            channels: (0..2)
                .map(|channel| samples.iter().map(|sample| sample[channel]).collect())
                .collect(),
            speed_m_s: samples.iter().map(|sample| sample[2]).collect(),
        }
    };
    (0..classes)
        .flat_map(|class| (1..4).map(move |seed| one(class, seed)))
        .collect()
}

fn trained(classes: usize, method: Method) -> Trained {
    train(&setup(classes, method), &recordings(classes), &mut |_, _| {}).unwrap()
}

fn model(classes: usize) -> Model {
    trained(classes, Method::Coupled).model
}

/// The `index`-th piece of a drive: `PIECE` samples of all channels.
fn piece(terrain: &mut Terrain, index: u64) -> Box<Vibration> {
    let mut piece = Vibration::new_box_zeroed().unwrap();
    piece.start_ns = 1_000_000_000 + index * PIECE as u64 * PERIOD_NS;
    piece.period_ns = PERIOD_NS;
    piece.count = PIECE as u32;
    piece.channel_count = 3;
    piece.header.sequence = index;
    piece.header.taken_ns = piece.start_ns + PIECE as u64 * PERIOD_NS;
    for (name, text) in piece.channels.iter_mut().zip(CHANNELS) {
        *name = label(text);
    }
    for sample in 0..PIECE {
        piece.offset_ns[sample] = (sample as u64 * PERIOD_NS) as u32;
        for (channel, value) in terrain.next().into_iter().enumerate() {
            piece.samples[channel][sample] = value as f32;
        }
    }
    piece
}

/// Drives `pieces` pieces over one terrain, each changed by `change`, and gives the answers.
fn drive(class: usize, pieces: u64, change: impl FnMut(u64, &mut Vibration)) -> Vec<TerrainClass> {
    drive_with(&Config::default(), model(3), class, pieces, change)
}

fn drive_with(
    config: &Config,
    model: Model,
    class: usize,
    pieces: u64,
    mut change: impl FnMut(u64, &mut Vibration),
) -> Vec<TerrainClass> {
    let mut classifier = VibrationClassifier::new(config, model);
    let mut terrain = Terrain::new(class, 77);
    (0..pieces)
        .map(|index| {
            let mut piece = piece(&mut terrain, index);
            change(index, &mut piece);
            let answer = classifier.step(&piece);
            assert_eq!(answer.check(), Ok(()));
            assert_eq!(answer.header.sequence, piece.header.sequence);
            assert_eq!(answer.header.taken_ns, piece.header.taken_ns);
            answer
        })
        .collect()
}

fn statuses(answers: &[TerrainClass]) -> Vec<Status> {
    let mut statuses: Vec<Status> = answers.iter().map(|answer| answer.header.status).collect();
    statuses.dedup();
    statuses
}

fn decided(status: Status) -> bool {
    status == Status::OK || status == Status::UNKNOWN_TERRAIN
}

#[test]
fn each_terrain_is_recognised_after_the_first_window() {
    for class in 0..3 {
        let answers = drive(class, 200, |_, _| {});
        assert!(
            answers[..9]
                .iter()
                .all(|answer| answer.header.status == Status::WARMING_UP)
        );
        let right = answers[9..]
            .iter()
            .filter(|answer| answer.class as usize == class)
            .count();
        assert!(right > 180, "{class}: {right}");
        assert_eq!(answers[199].windows, 20);
        assert_eq!(answers[199].start_ns, 20_000_000_000);
        assert_eq!(answers[199].class_text(), ["loam", "gravel", "rock"][class]);
    }
}

#[test]
fn probabilities_sum_to_one_and_the_class_has_the_highest_for_most_windows() {
    let answers = drive(1, 100, |_, _| {});
    for answer in &answers[9..] {
        assert!((answer.probability[..3].iter().sum::<f64>() - 1.0).abs() < 1e-9);
        assert!(answer.probability[3..].iter().all(|p| *p == 0.0));
    }
}

#[test]
fn a_few_missing_samples_are_repaired_and_many_are_not() {
    let few = drive(1, 100, |_, piece| {
        piece.samples[0][3] = if piece.header.sequence % 5 == 0 { f32::NAN } else { 0.1 }
    });
    assert!(few[9..].iter().all(|answer| decided(answer.header.status)));
    let many = drive(1, 100, |_, piece| piece.samples[1][3] = f32::NAN);
    assert!(
        many[9..]
            .iter()
            .all(|answer| answer.header.status == Status::INCOMPLETE && answer.unknown == 1)
    );
}

#[test]
fn a_silent_sensor_and_a_restarted_clock_start_a_new_window() {
    let silent = drive(0, 40, |index, piece| {
        if index == 15 {
            piece.count = 0;
            piece.header.status = Status::NO_DATA;
        }
    });
    assert_eq!(silent[15].header.status, Status::NO_DATA);
    assert!(!decided(silent[24].header.status) && decided(silent[25].header.status));
    let restarted = drive(0, 40, |index, piece| {
        if index >= 15 {
            piece.start_ns -= 1_100_000_000;
        }
    });
    assert_eq!(restarted[23].windows, 1);
    assert_eq!(restarted[24].windows, 2);
}

#[test]
fn what_does_not_fit_the_model_is_rejected() {
    let rate = drive(0, 30, |_, piece| piece.period_ns = 5_000_000);
    assert_eq!(statuses(&rate), [Status::INPUT_REJECTED]);
    let channel = drive(0, 30, |_, piece| piece.channels[1] = label("angular_rate_x_rad_s"));
    assert_eq!(statuses(&channel), [Status::INPUT_REJECTED]);
    let bad = drive(0, 30, |_, piece| piece.header.status = Status::BAD_SAMPLE);
    assert_eq!(statuses(&bad), [Status::INPUT_REJECTED]);

    let classifier = VibrationClassifier::new(&Config::default(), model(2));
    let mut piece = piece(&mut Terrain::new(0, 1), 0);
    assert_eq!(classifier.check_fit(&piece), Ok(()));
    piece.channels[1] = label("angular_rate_x_rad_s");
    assert!(
        classifier
            .check_fit(&piece)
            .unwrap_err()
            .contains("angular_rate_y_rad_s")
    );
    piece.period_ns = 5_000_000;
    assert!(classifier.check_fit(&piece).unwrap_err().contains("200.000 Hz"));
}

#[test]
fn samples_that_come_faster_than_they_say_are_rejected() {
    let answers = drive(0, 300, |index, piece| {
        piece.start_ns = 1_000_000_000 + index * 50_000_000;
        for sample in 0..PIECE {
            piece.offset_ns[sample] = sample as u32 * 5_000_000;
        }
    });
    assert!(answers.iter().all(|answer| !decided(answer.header.status)));
    assert_eq!(answers[299].header.status, Status::INPUT_REJECTED);
}

#[test]
fn a_jittering_clock_does_not_matter() {
    let mut noise = Noise(5);
    let still = drive(2, 100, |_, _| {});
    let jittered = drive(2, 100, |_, piece| {
        for offset in &mut piece.offset_ns[..PIECE] {
            *offset += (4e6 * (noise.next() + 0.5)) as u32;
        }
    });
    for (a, b) in still.iter().zip(&jittered) {
        assert_eq!((a.class, a.metric.to_bits()), (b.class, b.metric.to_bits()));
    }
}

#[test]
fn a_rover_that_stands_and_a_broken_channel_get_no_class() {
    let stopped = drive(0, 30, |_, piece| {
        piece.samples[2].fill(0.0);
        piece.samples[..2].iter_mut().flatten().for_each(|value| *value *= 0.01);
    });
    assert_eq!(statuses(&stopped), [Status::WARMING_UP, Status::STANDING_STILL]);
    let dead = drive(0, 30, |_, piece| piece.samples[1].fill(0.25));
    assert_eq!(statuses(&dead), [Status::WARMING_UP, Status::SENSOR_FAULT]);
    let saturated = drive(0, 30, |_, piece| {
        for value in &mut piece.samples[0] {
            *value = value.clamp(-0.3, 0.3);
        }
    });
    assert_eq!(statuses(&saturated), [Status::WARMING_UP, Status::SENSOR_FAULT]);
}

#[test]
fn no_bytes_make_it_panic() {
    let mut noise = Noise(3);
    let mut classifier = VibrationClassifier::new(&Config::default(), model(2));
    for round in 0..2000_u64 {
        let mut piece = piece(&mut Terrain::new(0, round), round);
        let mut wild = || (noise.next() * 2.0_f64.powi(66)) as u64;
        match round % 4 {
            0 => piece.start_ns = wild(),
            1 => piece.offset_ns = std::array::from_fn(|_| wild() as u32),
            2 => piece.count = wild() as u32,
            _ => piece.channel_count = wild() as u32,
        }
        piece.samples[round as usize % CHANNELS_MAX] = [f32::from_bits(wild() as u32); SAMPLES_MAX];
        let _ = classifier.step(&piece);
    }
}

#[test]
fn a_model_survives_its_file_and_the_same_data_give_the_same_bytes() {
    let text = model(3).to_text().unwrap();
    assert_eq!(Model::parse(&text).unwrap(), model(3));
    assert_eq!(model(3).to_text().unwrap(), text);
}

#[test]
fn a_model_file_with_a_mistake_says_what_is_wrong() {
    let text = model(2).to_text().unwrap();
    for (from, to, complaint) in [
        ("model/1", "model/9", "format must be"),
        ("\"gravel\"", "\"loam\"", "stands twice"),
        ("rate_hz = 100.0", "rate_hz = -1.0", "rate_hz must be 0.001 to 1000000"),
        ("window_samples = 100", "window_samples = 50", "weights, has"),
        ("tapers", "taper", "taper"),
        ("offset = ", "offset = nan # ", "not finite"),
    ] {
        let complained = Model::parse(&text.replacen(from, to, 1)).unwrap_err();
        assert!(complained.contains(complaint), "{complained}");
    }
}

#[test]
fn a_class_without_windows_cannot_be_trained() {
    let complaint = train(&setup(2, Method::Paper), &recordings(1), &mut |_, _| {}).unwrap_err();
    assert!(complaint.contains("class gravel has 0 usable windows"), "{complaint}");
}

#[test]
fn the_papers_method_rejects_what_lies_outside_one_standard_deviation() {
    let trained = trained(2, Method::Paper);
    assert_eq!(trained.model.pairs.len(), 1);
    assert_eq!(trained.model.reject.distance_max, 1.0);
    let unknown = trained.validated.iter().filter(|window| window.alone.unknown).count() as f64;
    // A normal variate lies outside with a probability of 0.317.
    let share = unknown / trained.validated.len() as f64;
    assert!((0.1..0.6).contains(&share), "{share}");
}

#[test]
fn filter_and_rejection_can_be_switched_off() {
    let config = Config {
        filter: Some(Filtering::None),
        reject: Some(Rejecting::None),
        ..Config::default()
    };
    let mut noise = Noise(9);
    let answers = drive_with(&config, trained(3, Method::Paper).model, 0, 200, |_, piece| {
        for value in &mut piece.samples[0] {
            *value += 3.0 * noise.next() as f32;
        }
    });
    assert!(
        answers[9..]
            .iter()
            .all(|answer| answer.header.status == Status::OK && answer.unknown == 0)
    );
}

#[test]
fn the_filter_follows_a_change_of_terrain_within_seconds() {
    let mut classifier = VibrationClassifier::new(&Config::default(), model(2));
    let mut terrains = [Terrain::new(0, 5), Terrain::new(1, 6)];
    let mut classes = Vec::new();
    for index in 0..600 {
        let terrain = &mut terrains[usize::from(index >= 300)];
        classes.push(classifier.step(&piece(terrain, index)).class);
    }
    assert!(classes[50..300].iter().all(|class| *class == 0));
    assert!(classes[350..].iter().all(|class| *class == 1));
}

#[test]
fn validation_leaves_whole_recordings_out_and_counts_every_scored_window_once() {
    let trained = trained(3, Method::Coupled);
    let windows = trained.windows.iter().filter(|window| window.scored).count();
    assert_eq!(trained.validated.len(), windows);
    let right = trained
        .validated
        .iter()
        .filter(|window| window.alone.class == window.alone.truth)
        .count();
    assert!(right * 100 > 95 * windows, "{right} of {windows}");
}
