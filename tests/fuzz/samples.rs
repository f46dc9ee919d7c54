//! Samples as a foreign process writes them: any bytes, as many as there are, the rest zero.

use messages::{
    Frame, Message, SERVICES_MAX, Sinkage, Soil, Status, Supervision, Terrain, TerrainClass, Vibration, Wheel,
    label_text,
};
use std::sync::LazyLock;
use terrain::TerrainFusion;
use terramechanics::{Checkpoint, Config, Estimator, SoilEstimator};
use vibration::{Model, VibrationClassifier};
use zerocopy::{FromBytes, FromZeros, IntoBytes};

/// Samples that one input holds at the most.
const SAMPLES: usize = 64;
/// Pieces of vibration that one input holds at the most.
const PIECES: usize = 12;

/// The sample that these bytes begin; what they lack is zero. Takes them off.
fn take<T: Message>(bytes: &mut &[u8]) -> Box<T> {
    let mut sample = T::new_box_zeroed().expect("memory for a sample");
    let (head, rest) = bytes.split_at(bytes.len().min(size_of::<T>()));
    sample.as_mut_bytes()[..head.len()].copy_from_slice(head);
    *bytes = rest;
    sample
}

/// The same as a stage gets it to see: as it is, or, where it cannot be believed, a header that says so.
fn take_trigger<T: Message>(bytes: &mut &[u8]) -> Box<T> {
    let mut sample = take::<T>(bytes);
    if sample.check().is_err() || sample.header().status == Status::ENDED {
        let header = *sample.header();
        sample.zero();
        *sample.header_mut() = header;
        sample.header_mut().status = Status::BAD_SAMPLE;
    }
    sample
}

/// The same for what a stage only takes in: `None` where it cannot be believed.
fn take_observation<T: Message>(bytes: &mut &[u8]) -> Option<Box<T>> {
    Some(take::<T>(bytes)).filter(|sample| sample.check().is_ok())
}

fn take_byte(bytes: &mut &[u8]) -> u8 {
    let (first, rest) = bytes.split_first().unwrap_or((&0, &[]));
    *bytes = rest;
    *first
}

fn assert_answers<T: Message>(answer: &T, trigger: &impl Message) {
    assert_eq!(answer.check(), Ok(()), "{answer:?}");
    let (answer, trigger) = (answer.header(), trigger.header());
    assert_eq!((answer.taken_ns, answer.sequence), (trigger.taken_ns, trigger.sequence));
}

/// Every message: its check, and what reads it without one.
pub fn samples(bytes: &[u8]) {
    let Some((kind, mut bytes)) = bytes.split_first() else {
        return;
    };
    let bytes = &mut bytes;
    match kind % 8 {
        0 => drop(take::<Wheel>(bytes).check()),
        1 => drop(take::<Sinkage>(bytes).check()),
        2 => {
            let soil = take::<Soil>(bytes);
            let _ = (soil.check(), Soil::reason_word(soil.reason));
        }
        3 => {
            let class = take::<TerrainClass>(bytes);
            let _ = (class.check(), class.class_text());
        }
        4 => {
            let terrain = take::<Terrain>(bytes);
            let _ = (terrain.check(), terrain.class_text());
        }
        5 => {
            let piece = take::<Vibration>(bytes);
            let _ = piece.check();
            let known = (0..20).filter(|channel| !piece.channel(*channel).is_empty()).count();
            assert!(known <= messages::CHANNELS_MAX);
        }
        6 => {
            let table = take::<Supervision>(bytes);
            let rows = table.check().map_or(SERVICES_MAX, |()| table.service_count as usize);
            assert!(
                table.name[..rows]
                    .iter()
                    .all(|name| label_text(name).len() <= messages::LABEL_BYTES)
            );
        }
        _ => {
            let head = FRAME_HEAD.min(bytes.len());
            let mut frame = Frame::new_box_zeroed().expect("memory for a frame");
            frame.as_mut_bytes()[..head].copy_from_slice(&bytes[..head]);
            let fits = frame.width as usize * frame.height as usize == frame.image().len();
            assert!(frame.check().is_err() || fits || !frame.header.status.is_answer());
        }
    }
}

const FRAME_HEAD: usize = size_of::<Frame>() - messages::PIXELS_MAX;

/// Terramechanics: a byte says whether a reading of the wheel or a sinkage follows.
pub fn soil_stage(bytes: &[u8]) {
    for estimator in [Estimator::Full, Estimator::Linear] {
        let mut stage = SoilEstimator::new(Config {
            estimator,
            ..Config::default()
        });
        soil_stage_of(&mut stage, bytes);
    }
}

fn soil_stage_of(stage: &mut SoilEstimator, mut bytes: &[u8]) {
    let bytes = &mut bytes;
    for _ in 0..SAMPLES {
        if bytes.is_empty() {
            return;
        }
        if !take_byte(bytes).is_multiple_of(3) {
            take_observation::<Wheel>(bytes)
                .iter()
                .for_each(|wheel| stage.observe_wheel(wheel));
        } else {
            let sinkage = take_trigger::<Sinkage>(bytes);
            assert_answers(&stage.step(&sinkage), &*sinkage);
        }
    }
}

/// A checkpoint whose state these bytes have overwritten, and whose digest is right all the same: two bytes say where, the
/// rest is what. The stage goes on from it, or says why not.
pub fn soil_checkpoint(bytes: &[u8]) {
    static SOUND: LazyLock<Vec<u8>> = LazyLock::new(|| {
        let mut stage = SoilEstimator::new(Config::default());
        soil_stage_of(&mut stage, &soil_drive(SAMPLES as u64 / 3));
        stage.checkpoint().as_bytes().to_vec()
    });
    let Some((place, overwritten)) = bytes.split_at_checked(4) else {
        return;
    };
    let mut checkpoint = SOUND.clone();
    let (first, last) = (16, checkpoint.len() - 8);
    let place = u32::from_le_bytes([place[0], place[1], place[2], place[3]]) as usize % (last - first);
    let state = &mut checkpoint[first..last];
    for (target, value) in state[place..].iter_mut().zip(overwritten) {
        *target = *value;
    }
    let digest = fnv_1a(state);
    checkpoint[last..].copy_from_slice(&digest.to_le_bytes());
    let checkpoint = Box::new(Checkpoint::read_from_bytes(&checkpoint).expect("the length of a checkpoint"));
    let mut stage = SoilEstimator::new(Config::default());
    if stage.restore(&checkpoint).is_ok() {
        soil_stage_of(&mut stage, &soil_drive(2));
    }
}

/// FNV-1a over words of eight bytes.
fn fnv_1a(bytes: &[u8]) -> u64 {
    let words = bytes
        .chunks_exact(8)
        .map(|word| u64::from_le_bytes(word.try_into().expect("eight bytes")));
    words.fold(0xcbf2_9ce4_8422_2325, |digest, word| {
        (digest ^ word).wrapping_mul(0x0100_0000_01b3)
    })
}

/// The drive of a simulated rover as [`soil_stage`] reads it: a reading of the wheel and a sinkage at each instant.
fn soil_drive(cycles: u64) -> Vec<u8> {
    let rover = simulation::Rover::new(simulation::Config {
        picture_width_px: 64,
        picture_height_px: 64,
        ..simulation::Config::default()
    });
    let mut bytes = Vec::new();
    for cycle in 1..=cycles {
        let (time_s, taken_ns) = (cycle as f64 * 0.2, cycle * 200_000_000);
        let state = rover.state(time_s);
        let mut wheel = rover.wheel(time_s);
        (wheel.header.taken_ns, wheel.header.sequence) = (taken_ns, cycle);
        let mut sinkage = Sinkage::unknown(wheel.header);
        (sinkage.entry_rad, sinkage.entry_sigma_rad) = (state.entry_rad, 0.01);
        (sinkage.exit_rad, sinkage.exit_sigma_rad) = (state.exit_rad, 0.01);
        (sinkage.sinkage_m, sinkage.confidence) = (state.sinkage_m, 0.9);
        bytes.push(1);
        bytes.extend(wheel.as_bytes());
        bytes.push(0);
        bytes.extend(sinkage.as_bytes());
    }
    bytes
}

/// Vibration: each piece is its head, and a number of sample bytes that fill it.
pub fn class_stage(mut bytes: &[u8]) {
    static MODEL: LazyLock<Model> = LazyLock::new(Model::built_in);
    const HEAD: usize = 56;
    let mut stage = VibrationClassifier::new(&vibration::Config::default(), MODEL.clone());
    let mut piece = Vibration::new_box_zeroed().expect("memory for a piece");
    for _ in 0..PIECES {
        if bytes.is_empty() {
            return;
        }
        let named = take_byte(&mut bytes).is_multiple_of(2);
        piece.zero();
        let (head, rest) = bytes.split_at(bytes.len().min(HEAD));
        piece.as_mut_bytes()[..head.len()].copy_from_slice(head);
        let (values, rest) = rest.split_at(rest.len().min(256));
        bytes = rest;
        let filled = if named { HEAD + 24 * 8 } else { HEAD };
        if !values.is_empty() {
            let targets = piece.as_mut_bytes()[filled..].iter_mut();
            targets
                .zip(values.iter().cycle())
                .for_each(|(target, value)| *target = *value);
        }
        if named {
            for (target, name) in piece.channels.iter_mut().zip(simulation::CHANNELS) {
                *target = messages::label(name);
            }
        }
        let piece = take_trigger::<Vibration>(&mut piece.as_bytes());
        let _ = stage.check_fit(&piece);
        assert_answers(&stage.step(&piece), &*piece);
    }
}

/// Fusion: a byte says whether a sinkage, a class or a soil follows.
pub fn terrain_stage(mut bytes: &[u8]) {
    let bytes = &mut bytes;
    let mut stage = TerrainFusion::new(terrain::Config::default());
    for _ in 0..SAMPLES {
        if bytes.is_empty() {
            return;
        }
        match take_byte(bytes) % 3 {
            0 => take_observation(bytes)
                .iter()
                .for_each(|sinkage| stage.observe_sinkage(sinkage)),
            1 => take_observation(bytes)
                .iter()
                .for_each(|class| stage.observe_class(class)),
            _ => {
                let soil = take_trigger::<Soil>(bytes);
                assert_answers(&stage.step(&soil), &*soil);
            }
        }
    }
}
