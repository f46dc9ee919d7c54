//! Files that people bring: the system file, the parts of a traverse, a trained model.

use crate::system::System;
use messages::{Header, Message, SAMPLES_MAX, Status, Vibration, label};
use shell::{Error, SystemFile};
use std::io::Cursor;
use std::path::PathBuf;
use telemetry::{Event, Files, Recording};
use traverse::{FrameRows, Input, Traverse};
use vibration::{Model, VibrationClassifier};
use zerocopy::FromZeros;

/// Events of a recording that are looked at: a gap of a day in a table makes a million.
const EVENTS_MAX: usize = 2_000;
/// Pieces that a model is tried on.
const PIECES: u64 = 8;
/// Pixels of simulated pictures beyond which no rover is made: that takes its time, and is not what is tried here.
const ROVER_PIXELS_MAX: u32 = 1 << 14;

/// `rover.toml`: form, graph, and every service's configuration.
pub fn system_toml(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let file = match SystemFile::parse("rover.toml", text) {
        Ok(file) => file,
        Err(error) => return assert_is_placed(&error),
    };
    for name in file.services.keys() {
        configs(&file, name);
    }
    let programs = |name: &str| name.starts_with("terrasense-").then(|| PathBuf::from(name));
    match System::check(file, programs) {
        Ok(system) => {
            assert_eq!(system.order.len(), system.file.services.len());
            assert_eq!(system.programs.len(), system.order.len());
            assert!(SystemFile::is_name(system.file.system.name.get_ref()));
            assert!(
                system
                    .wires
                    .keys()
                    .all(|wire| !wire.contains("..") && !wire.starts_with('/'))
            );
        }
        Err(error) => assert_is_placed(&error),
    }
}

/// What is refused is refused with file and line, as a configuration.
fn assert_is_placed(error: &Error) {
    let text = error.to_string();
    let line = text.strip_prefix("rover.toml:").and_then(|rest| rest.split(':').next());
    assert!(
        line.is_some_and(|line| line.parse::<u32>().is_ok()),
        "no file and line: {text}"
    );
    assert_eq!(error.code(), 78);
}

/// A service's table as the configuration of each stage: one that is admitted makes a stage.
fn configs(file: &SystemFile, service: &str) {
    if let Ok(config) = file.config(service, sinkage::Config::validate) {
        let _ = sinkage::SinkageTracker::new(config);
    }
    if let Ok(config) = file.config(service, terramechanics::Config::validate) {
        let _ = terramechanics::SoilEstimator::new(config);
    }
    if let Ok(config) = file.config(service, terrain::Config::validate) {
        let _ = terrain::TerrainFusion::new(config);
    }
    let _ = file.config(service, vibration::Config::validate);
    let _ = file.config(service, telemetry::Config::validate);
    if let Ok(camera::Config::Simulated { rover, rate_hz }) = file.config(service, camera::Config::validate)
        && rover.picture_width_px * rover.picture_height_px <= ROVER_PIXELS_MAX
    {
        let _ = camera::SimulatedCamera::new(rover, rate_hz, u64::MAX);
    }
}

/// `traverse.toml`
pub fn description_toml(bytes: &[u8]) {
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = Traverse::parse("traverse.toml", text);
    }
}

/// `frames.csv`
pub fn frames_csv(bytes: &[u8]) {
    let Ok(rows) = FrameRows::open("frames.csv", input(bytes)) else {
        return;
    };
    let mut last_ns = None;
    for row in rows.map_while(Result::ok) {
        assert!(last_ns < Some(row.taken_ns), "time goes on");
        last_ns = Some(row.taken_ns);
        assert!(!row.file.starts_with('/') && !row.file.split('/').any(|part| part == ".."));
        let pose = [
            row.center_x_px,
            row.center_y_px,
            row.rim_radius_px,
            row.wheel_radius_px,
            row.pitch_rad,
        ];
        assert!(
            pose.iter()
                .chain(row.homography.iter().flatten())
                .all(|value| value.is_finite())
        );
    }
}

/// `wheel.csv`
pub fn wheel_csv(bytes: &[u8]) {
    recording(Files {
        wheel: Some(input(bytes)),
        ..described("")
    });
}

/// `sinkage.csv`
pub fn sinkage_csv(bytes: &[u8]) {
    recording(Files {
        sinkage: Some(input(bytes)),
        ..described("")
    });
}

/// `vibration.csv`
pub fn vibration_csv(bytes: &[u8]) {
    recording(Files {
        vibration: Some(input(bytes)),
        ..described("")
    });
}

/// `vibration.wav`
pub fn vibration_wav(bytes: &[u8]) {
    recording(Files {
        sound: Some(input(bytes)),
        ..described("[vibration]\nscale = 19.6\n")
    });
}

fn input(bytes: &[u8]) -> Input {
    Box::new(Cursor::new(bytes.to_vec()))
}

fn described(more: &str) -> Files {
    let text = Traverse::EXAMPLE.to_owned() + more;
    Files {
        description: Some(input(text.as_bytes())),
        ..Files::default()
    }
}

/// Whatever is read of a recording can be believed, and time goes on.
fn recording(files: Files) {
    let Ok(mut recording) = Recording::open("traverse", files) else {
        return;
    };
    let mut last_ns = 0;
    for _ in 0..EVENTS_MAX {
        let Ok(Some(event)) = recording.next_event() else {
            return;
        };
        let (header, verdict) = match event {
            Event::Wheel(sample) => (sample.header, sample.check()),
            Event::Sinkage(sample) => (sample.header, sample.check()),
            Event::Vibration(piece) => (piece.header, piece.check()),
        };
        assert_eq!(verdict, Ok(()), "{event:?}");
        assert!(header.taken_ns >= last_ns, "{event:?}");
        last_ns = header.taken_ns;
    }
}

/// A model of the vibration classifier: one that is admitted can be used and written again.
pub fn vibration_model(bytes: &[u8]) {
    let Ok(model) = Model::parse_bytes(bytes) else { return };
    let text = model.to_text().expect("an admitted model can be written");
    assert_eq!(Model::parse(&text).map(|_| ()), Ok(()), "what was written can be read");
    let mut piece = Vibration::new_box_zeroed().expect("memory for a piece");
    piece.channel_count = model.channels.len() as u32;
    for (target, name) in piece.channels.iter_mut().zip(&model.channels) {
        *target = label(name);
    }
    piece.period_ns = (1e9 / model.rate_hz) as u64;
    piece.count = SAMPLES_MAX as u32;
    for (index, value) in piece.samples.iter_mut().flatten().enumerate() {
        *value = (index as f32 * 0.7).sin() + (index as f32).sqrt().fract();
    }
    let mut classifier = VibrationClassifier::new(&vibration::Config::default(), model);
    for number in 0..PIECES {
        piece.start_ns = number.saturating_mul(piece.period_ns.saturating_mul(SAMPLES_MAX as u64));
        piece.header = Header {
            taken_ns: piece.start_ns,
            sequence: number,
            status: Status::OK,
            ..Header::default()
        };
        let class = classifier.step(&piece);
        assert_eq!(class.check(), Ok(()), "{class:?}");
    }
}
