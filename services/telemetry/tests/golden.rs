//! A recorded traverse becomes one stream: in order, without loss, without silences, and bad files are refused in words.

#![allow(clippy::unwrap_used)]

use hound::{SampleFormat, WavSpec, WavWriter};
use messages::{Message, Sinkage, Status, Vibration, Wheel, label_text};
use std::fmt::Write;
use std::io::Cursor;
use telemetry::{Config, Event, Files, Recording, SimulatedTelemetry};
use traverse::{Input, InputError};
use zerocopy::IntoBytes;

const TOML: &str = "[wheel]\nradius_m = 0.15\nwidth_m = 0.16\n";

/// The files of a traverse folder, as text; empty where one is not there.
#[derive(Clone, Default)]
struct Folder {
    toml: String,
    frames: String,
    wheel: String,
    sinkage: String,
    vibration: String,
    sound: Vec<u8>,
}

impl Folder {
    fn new() -> Self {
        Self {
            toml: TOML.into(),
            ..Self::default()
        }
    }

    fn open(&self) -> Result<Recording, InputError> {
        let input = |bytes: &[u8]| (!bytes.is_empty()).then(|| Box::new(Cursor::new(bytes.to_vec())) as Input);
        let files = Files {
            description: Some(Box::new(Cursor::new(self.toml.clone().into_bytes()))),
            frames: input(self.frames.as_bytes()),
            wheel: input(self.wheel.as_bytes()),
            sinkage: input(self.sinkage.as_bytes()),
            vibration: input(self.vibration.as_bytes()),
            sound: input(&self.sound),
        };
        Recording::open("t", files)
    }

    /// Hands every event, `limit` of them at the most, to `act`.
    fn run(&self, limit: usize, mut act: impl FnMut(&Event)) -> Result<(), InputError> {
        let (mut recording, mut ended) = (self.open()?, 0);
        for _ in 0..limit {
            match recording.next_event()? {
                Some(Event::Wheel(Wheel { header, .. }) | Event::Sinkage(Sinkage { header, .. }))
                    if header.status == Status::ENDED =>
                {
                    ended += 1;
                }
                Some(Event::Vibration(piece)) if piece.header.status == Status::ENDED => ended += 1,
                Some(event) => act(&event),
                None => {
                    assert_eq!(ended, 3, "each wire is told that the recording is over");
                    break;
                }
            }
        }
        Ok(())
    }

    /// One line an event: instant, wire, number, status, and the values that matter.
    fn listing(&self) -> Result<String, InputError> {
        let mut text = String::new();
        self.run(1_000_000, |event| {
            let (wire, header, values) = match event {
                Event::Wheel(wheel) => ("wheel", wheel.header, format!("{} {}", wheel.load_n, wheel.slip)),
                Event::Sinkage(sinkage) => {
                    let values = format!(
                        "{:.3} {:.3} {:.5}",
                        sinkage.left_rad, sinkage.right_rad, sinkage.sinkage_m
                    );
                    ("sinkage", sinkage.header, values)
                }
                Event::Vibration(piece) => ("vibration", piece.header, format!("{:?}", piece.channel(0))),
            };
            let (instant_s, word) = (header.taken_ns as f64 / 1e9, header.status.word().unwrap());
            writeln!(text, "{instant_s} {wire} {} {word} {values}", header.sequence).unwrap();
        })?;
        Ok(text)
    }

    fn error(&self) -> String {
        self.run(1_000_000, |_| ()).expect_err("an error").to_string()
    }
}

#[test]
fn a_small_traverse_becomes_this_stream() {
    let folder = Folder {
        frames: "file,taken_s,center_x_px,center_y_px,rim_radius_px,wheel_radius_px,pitch_rad\na.png,0.55,1,1,1,1,0\n"
            .into(),
        wheel: "slip,taken_s,load_n,torque_nm,angular_velocity_rad_s,linear_velocity_m_s\n\
                0.2,0.05,90,3,0.5,0.06\n0.2,0.15,,3,0.5,0.06\n,0.4,92,3,0.5,0.06\n"
            .into(),
        sinkage: "taken_s,entry_rad,exit_rad\n0.15,0.5,-0.1\n0.5,0.6,\n".into(),
        vibration: "taken_s,acceleration_z_m_s2\n0.00,1\n0.05,2\n0.10,\n0.10,4\n0.32,5\n".into(),
        ..Folder::new()
    };
    let expected = "\
0.05 wheel 0 ok 90 0.2
0.1 vibration 0 ok [1.0, 2.0]
0.15 wheel 1 incomplete NaN 0.2
0.15 sinkage 0 ok 0.100 0.500 0.01836
0.2 vibration 1 incomplete [NaN, 4.0]
0.25 wheel 2 no_data NaN NaN
0.3 vibration 2 no_data []
0.35 wheel 2 no_data NaN NaN
0.4 vibration 3 ok [5.0]
0.4 wheel 2 ok 92 NaN
0.5 vibration 4 no_data []
0.5 sinkage 1 incomplete NaN 0.600 0.02620
0.5 wheel 3 no_data NaN NaN
";
    assert_eq!(folder.listing().unwrap(), expected);
}

#[test]
fn a_piece_is_a_tenth_of_a_second_and_its_header_tells_all() {
    let mut folder = Folder::new();
    folder.vibration = "taken_s,acceleration_x_m_s2,linear_velocity_m_s\n".into();
    for index in 0..100 {
        writeln!(
            folder.vibration,
            "{:.2},{index},{}",
            7.0 + f64::from(index) / 100.0,
            0.06
        )
        .unwrap();
    }
    let mut next = 0;
    folder
        .run(100, |event| {
            let Event::Vibration(piece) = event else {
                panic!("{event:?}")
            };
            assert_eq!(piece.header.sequence, next);
            assert_eq!((piece.count, piece.channel_count), (10, 2));
            assert_eq!(
                (piece.start_ns, piece.period_ns),
                (7_000_000_000 + next * 100_000_000, 10_000_000)
            );
            // The last piece ends with its last sample, for nothing says that there was time after it.
            let length_ns = if next == 9 { 90_000_000 } else { 100_000_000 };
            assert_eq!(piece.header.taken_ns - piece.start_ns, length_ns);
            let offsets: Vec<u32> = (0..10).map(|index| index * 10_000_000).collect();
            assert_eq!(piece.offset_ns[..10], offsets);
            let values: Vec<f32> = (0..10).map(|index| (next * 10 + index) as f32).collect();
            assert_eq!(piece.channel(0), values);
            assert_eq!(piece.channel(1), [0.06_f32; 10]);
            assert_eq!(label_text(&piece.channels[0]), "acceleration_x_m_s2");
            assert_eq!(label_text(&piece.channels[1]), "linear_velocity_m_s");
            assert_eq!(piece.check(), Ok(()));
            next += 1;
        })
        .unwrap();
    assert_eq!(next, 10);
}

#[test]
fn a_wheel_that_rolls_left_is_entered_on_the_left() {
    let mut folder = Folder::new();
    folder.toml += "rolls = \"left\"\n[sensors]\nentry_sigma_rad = 0.01\n";
    folder.sinkage = "taken_s,entry_rad,exit_rad\n1,0.5,-0.1\n".into();
    folder
        .run(10, |event| {
            let Event::Sinkage(sinkage) = event else {
                panic!("{event:?}")
            };
            assert_eq!((sinkage.entry_rad, sinkage.exit_rad), (0.5, -0.1));
            assert_eq!((sinkage.left_rad, sinkage.right_rad), (0.5, 0.1));
            assert_eq!((sinkage.left_sigma_rad, sinkage.exit_sigma_rad), (0.01, 0.01));
            assert!((sinkage.sinkage_m - 0.15 * (1.0 - 0.5_f64.cos())).abs() < 1e-15);
            assert!((sinkage.sinkage_sigma_m - 0.15 * 0.5_f64.sin() * 0.01).abs() < 1e-7);
            assert_eq!((sinkage.confidence, sinkage.check()), (1.0, Ok(())));
        })
        .unwrap();
}

#[test]
fn a_sensor_that_fails_on_the_way_is_a_status_and_not_the_end() {
    let mut folder = Folder::new();
    folder.sinkage = "taken_s,entry_rad,exit_rad\n1,0.5,0\n2,5,0\n3,-0.02,0\n4,nan,0\n5,0.1,-7\n".into();
    let mut statuses = Vec::new();
    folder
        .run(10, |event| {
            let Event::Sinkage(sinkage) = event else {
                panic!("{event:?}")
            };
            assert_eq!(sinkage.check(), Ok(()));
            statuses.push(sinkage.header.status);
        })
        .unwrap();
    let fault = Status::SENSOR_FAULT;
    assert_eq!(statuses, [Status::OK, fault, fault, Status::INCOMPLETE, fault]);
}

fn sound(spec: WavSpec, samples: &[i32]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = WavWriter::new(&mut bytes, spec).unwrap();
    for sample in samples {
        match spec.sample_format {
            SampleFormat::Int => writer.write_sample(*sample).unwrap(),
            SampleFormat::Float => writer.write_sample(*sample as f32 / 128.0).unwrap(),
        }
    }
    writer.finalize().unwrap();
    bytes.into_inner()
}

fn spec(channels: u16, sample_rate: u32, bits_per_sample: u16) -> WavSpec {
    let sample_format = if bits_per_sample == 32 {
        SampleFormat::Float
    } else {
        SampleFormat::Int
    };
    WavSpec {
        channels,
        sample_rate,
        bits_per_sample,
        sample_format,
    }
}

fn pieces(folder: &Folder) -> Vec<Vec<u8>> {
    let mut pieces = Vec::new();
    let keep = |event: &Event| {
        if let Event::Vibration(piece) = event {
            // What lies behind the samples has no meaning.
            let mut clean = Vibration::clone(piece);
            let end = clean.count as usize;
            clean.offset_ns[end..].fill(0);
            clean.samples.iter_mut().for_each(|channel| channel[end..].fill(0.0));
            pieces.push(clean.as_bytes().to_vec());
        }
    };
    folder.run(1_000_000, keep).unwrap();
    pieces
}

#[test]
fn a_sound_file_and_a_table_of_the_same_samples_are_the_same_stream() {
    for (channels, rate, bits, unit) in [
        (3, 1000, 8, 1),
        (1, 4000, 16, 256),
        (6, 200, 24, 65_536),
        (1, 8000, 32, 1),
    ] {
        let instants = 2 * rate as usize / 3;
        let values: Vec<i32> = (0..instants * usize::from(channels))
            .map(|index| (index * 37 % 255) as i32 - 127)
            .collect();
        let names: Vec<String> = (0..channels)
            .map(|index| format!("acceleration_{index}_m_s2"))
            .collect();
        let mut with_sound = Folder::new();
        write!(
            with_sound.toml,
            "[vibration]\nstart_s = 2.5\nscale = 32.0\nchannels = {names:?}\n"
        )
        .unwrap();
        let mut with_table = with_sound.clone();
        let raw: Vec<i32> = values.iter().map(|value| value * unit).collect();
        with_sound.sound = sound(spec(channels, rate, bits), &raw);
        with_table.vibration = format!("taken_s,{}\n", names.join(","));
        for (index, instant) in values.chunks(usize::from(channels)).enumerate() {
            write!(with_table.vibration, "{}", 2.5 + index as f64 / f64::from(rate)).unwrap();
            for value in instant {
                write!(with_table.vibration, ",{}", f64::from(*value) / 128.0 * 32.0).unwrap();
            }
            with_table.vibration.push('\n');
        }
        let (left, right) = (pieces(&with_sound), pieces(&with_table));
        assert!(
            left.len() > 6 && left == right,
            "{channels} channels, {rate} Hz, {bits} bits"
        );
    }
}

/// A traverse made by chance, and what its rows are: instants and first values.
struct Chance {
    folder: Folder,
    wheel: Vec<(u64, f64)>,
    sinkage: Vec<(u64, f64)>,
    vibration: Vec<(u64, f64)>,
    last_ns: u64,
}

/// xorshift64
fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

/// Rows at about `rate_hz`, with pauses and repeated instants, and some values missing.
fn rows(state: &mut u64, rate_hz: u64, header: &str, tail: &str) -> (String, Vec<(u64, f64)>) {
    let (mut text, mut rows) = (format!("{header}\n"), Vec::new());
    let mut instant_us = 5_000_000 + random(state) % 500_000;
    for _ in 0..(3 * rate_hz).clamp(1, 4000) {
        let value = if random(state).is_multiple_of(9) {
            f64::NAN
        } else {
            (random(state) % 1000) as f64 / 1000.0
        };
        let cell = if value.is_nan() {
            String::new()
        } else {
            value.to_string()
        };
        writeln!(
            text,
            "{}.{:06},{cell}{tail}",
            instant_us / 1_000_000,
            instant_us % 1_000_000
        )
        .unwrap();
        rows.push((instant_us * 1000, value));
        instant_us += match random(state) % 40 {
            0 => 0,
            1 => 700_000,
            _ => 1_000_000 / rate_hz + random(state) % 300,
        };
    }
    (text, rows)
}

fn chance(seed: u64) -> Chance {
    let state = &mut (seed * 7_919 + 88_172_645_463_325_252);
    let mut rate = || [1, 3, 10, 30, 100, 1000, 3000][random(state) as usize % 7];
    let rates = [rate(), rate(), rate()];
    let mut folder = Folder::new();
    let header = "taken_s,load_n,torque_nm,angular_velocity_rad_s,linear_velocity_m_s";
    let (wheel, wheel_rows) = rows(state, rates[0], header, ",1,2,3");
    let (sinkage, sinkage_rows) = rows(state, rates[1], "taken_s,entry_rad,exit_rad", ",-0.1");
    let (vibration, vibration_rows) = rows(state, rates[2], "taken_s,a_m_s2", "");
    let frame_us = 5_000_000 + random(state) % 4_000_000;
    folder.frames = format!(
        "file,taken_s,center_x_px,center_y_px,rim_radius_px,wheel_radius_px,pitch_rad\n\
         a.png,{}.{:06},1,1,1,1,0\n",
        frame_us / 1_000_000,
        frame_us % 1_000_000
    );
    (folder.wheel, folder.sinkage, folder.vibration) = (wheel, sinkage, vibration);
    let last = |rows: &[(u64, f64)]| rows[rows.len() - 1].0;
    let last_ns = [
        last(&wheel_rows),
        last(&sinkage_rows),
        last(&vibration_rows),
        frame_us * 1000,
    ];
    Chance {
        folder,
        wheel: wheel_rows,
        sinkage: sinkage_rows,
        vibration: vibration_rows,
        last_ns: last_ns.into_iter().max().unwrap(),
    }
}

fn same(left: &[(u64, f64)], right: &[(u64, f64)]) -> bool {
    let equal = |pair: (&(u64, f64), &(u64, f64))| {
        pair.0.0 == pair.1.0 && (pair.0.1 == pair.1.1 || (pair.0.1.is_nan() && pair.1.1.is_nan()))
    };
    left.len() == right.len() && left.iter().zip(right).all(equal)
}

#[test]
fn the_stream_is_in_order_and_loses_nothing() {
    for seed in 0..60 {
        let chance = chance(seed);
        let (mut wheel, mut sinkage, mut vibration) = (Vec::new(), Vec::new(), Vec::new());
        let (mut last_ns, mut pieces) = (0, 0);
        let act = |event: &Event| {
            let (header, check) = match event {
                Event::Wheel(sample) => (sample.header, sample.check()),
                Event::Sinkage(sample) => (sample.header, sample.check()),
                Event::Vibration(piece) => (piece.header, piece.check()),
            };
            assert_eq!(check, Ok(()));
            assert!(header.taken_ns >= last_ns, "seed {seed}");
            last_ns = header.taken_ns;
            match event {
                Event::Vibration(piece) => {
                    assert_eq!(header.sequence, pieces);
                    pieces += 1;
                    for (offset_ns, value) in piece.offset_ns.iter().zip(piece.channel(0)) {
                        vibration.push((piece.start_ns + u64::from(*offset_ns), f64::from(*value)));
                        assert!(vibration[vibration.len() - 1].0 <= header.taken_ns);
                    }
                }
                Event::Wheel(sample) => {
                    assert_eq!(header.sequence, wheel.len() as u64);
                    if header.status != Status::NO_DATA {
                        wheel.push((header.taken_ns, sample.load_n));
                    }
                }
                Event::Sinkage(sample) => {
                    assert_eq!(header.sequence, sinkage.len() as u64);
                    sinkage.push((header.taken_ns, sample.entry_rad));
                }
            }
        };
        chance.folder.run(usize::MAX, act).unwrap();
        assert!(same(&wheel, &chance.wheel), "wheel, seed {seed}");
        assert!(same(&sinkage, &chance.sinkage), "sinkage, seed {seed}");
        let single: Vec<(u64, f64)> = chance
            .vibration
            .iter()
            .map(|(t, v)| (*t, f64::from(*v as f32)))
            .collect();
        assert!(same(&vibration, &single), "vibration, seed {seed}");
    }
}

#[test]
fn no_observation_is_silent_for_long_nor_behind_by_many_samples() {
    for seed in 0..60 {
        let chance = chance(seed);
        let begin_ns = [&chance.wheel, &chance.sinkage, &chance.vibration]
            .map(|rows| rows[0].0)
            .into_iter()
            .min()
            .unwrap();
        let frame = chance.folder.frames.split(',').nth(7).unwrap();
        let begin_ns = begin_ns.min((frame.parse::<f64>().unwrap() * 1e9).round() as u64);
        let (mut last_ns, mut others) = ([begin_ns; 3], [0; 3]);
        let act = |event: &Event| {
            let (wire, taken_ns) = match event {
                Event::Wheel(sample) => (0, sample.header.taken_ns),
                Event::Sinkage(sample) => (1, sample.header.taken_ns),
                Event::Vibration(piece) => (2, piece.header.taken_ns),
            };
            assert!(
                wire == 1 || taken_ns - last_ns[wire] <= 100_000_000,
                "seed {seed}, wire {wire}"
            );
            others.iter_mut().for_each(|count| *count += 1);
            (last_ns[wire], others[wire]) = (taken_ns, 0);
            assert!(
                [0, 2].iter().all(|wire| others[*wire] <= 256),
                "seed {seed}: {others:?}"
            );
        };
        chance.folder.run(usize::MAX, act).unwrap();
        for wire in [0, 2] {
            assert!(
                chance.last_ns - last_ns[wire] <= 100_000_000,
                "seed {seed}, wire {wire}"
            );
        }
    }
}

/// What is in a file (`|` ends a line, `W` is the header of wheel.csv), and how the error begins.
const BAD_FILES: &str = r#"
wheel     W|0,1,2,3,abc                        => t/wheel.csv:2: linear_velocity_m_s: "abc" is not a number; write one
wheel     W|0,1,2,3,4|1,inf,2,3,4              => t/wheel.csv:3: load_n: "inf" is not a number
wheel     W|                                   => t/wheel.csv:2: there is no row; leave the file out
wheel     |                                    => t/wheel.csv:2: the file is empty
wheel     taken_s,load_n|0,1                   => t/wheel.csv:1: column "torque_nm" is missing; the columns are taken_s,
wheel     taken_s,load_kg|0,1                  => t/wheel.csv:1: unknown column "load_kg"; the columns are taken_s,
wheel     W|1,1,2,3,4|0,1,2,3,4                => t/wheel.csv:3: taken_s: "0" lies 1.000000000 s before the row above
wheel     W|1,1,2,3,4|-2,1,2,3,4               => t/wheel.csv:3: taken_s: "-2" is out of range
sinkage   taken_s,entry_rad,exit_rad|0,25,-5   => t/sinkage.csv:2: entry_rad: "25" is out of range
sinkage   taken_s,entry_rad,exit_rad|0,.2,.5   => t/sinkage.csv:2: exit_rad: ".5" lies in front of entry_rad
vibration taken_s|0                            => t/vibration.csv:1: 0 channels; there must be 1 to 8
vibration time,a_m_s2|0,1                      => t/vibration.csv:1: column "taken_s" is missing
vibration taken_s,az|0,1                       => t/vibration.csv:1: channel "az": write at most 24 of a-z
vibration taken_s,a_m_s2|0,1e39                => t/vibration.csv:2: a_m_s2: "1e39" is out of range
frames    x|                                   => t/frames.csv:1: unknown column "x"; the columns are file,taken_s,
sound     RIFF                                 => t/vibration.wav: needs [vibration] start_s and scale
"#;

#[test]
fn bad_files_are_refused_with_file_line_and_remedy() {
    let wheel = "taken_s,load_n,torque_nm,angular_velocity_rad_s,linear_velocity_m_s";
    for case in BAD_FILES.trim().lines() {
        let (file, words) = case.split_once(" => ").unwrap();
        let (name, text) = file.split_once(' ').unwrap();
        let text = text.trim().replace('W', wheel).replace('|', "\n");
        let mut folder = Folder::new();
        match name {
            "wheel" => folder.wheel = text,
            "sinkage" => folder.sinkage = text,
            "vibration" => folder.vibration = text,
            "sound" => folder.sound = text.into_bytes(),
            _ => folder.frames = text,
        }
        let error = folder.error();
        assert!(error.starts_with(words), "{error}");
    }
}

#[test]
fn what_does_not_fit_together_is_refused() {
    let mut folder = Folder::new();
    folder.vibration = "taken_s,a_m_s2\n0,1\n".into();
    folder.sinkage = "taken_s,entry_rad,exit_rad\n1.7e9,0.5,-0.1\n".into();
    assert_eq!(
        folder.error(),
        "t/sinkage.csv: starts 1700000000 s after t/vibration.csv; all files of a traverse must have the same clock"
    );
    folder.toml = String::new();
    assert!(
        folder
            .error()
            .starts_with("t/sinkage.csv: needs [wheel] radius_m and width_m in traverse.toml")
    );
    folder.sinkage = String::new();
    folder.sound = b"RIFF".to_vec();
    assert!(
        folder
            .error()
            .starts_with("t/vibration.wav: there is also a vibration.csv")
    );
}

#[test]
fn a_sound_file_that_is_broken_or_does_not_fit_is_refused() {
    let mut folder = Folder::new();
    folder.toml += "[vibration]\nscale = 10.0\n";
    let whole = sound(spec(1, 1000, 16), &[1; 400]);
    for length in [1, 12, 30, 44, 50, whole.len() - 1] {
        folder.sound = whole[..length].to_vec();
        let error = folder.error();
        assert!(
            error.starts_with("t/vibration.wav: not a sound WAV") || error.contains("is cut off"),
            "{length}: {error}"
        );
    }
    folder.sound = sound(spec(2, 1000, 16), &[1; 400]);
    assert!(folder.error().contains("has 2 channels; name each in traverse.toml"));
    folder.sound = sound(spec(1, 1000, 16), &[]);
    assert!(folder.error().contains("0 samples at 1000 Hz"));
}

#[test]
fn no_bytes_make_it_panic_and_what_it_sends_is_sound() {
    let state = &mut 88_172_645_463_325_252;
    let mut whole = chance(3).folder;
    let short = |text: &str| {
        text.lines()
            .take(40)
            .map(|line| format!("{line}\n"))
            .collect::<String>()
    };
    (whole.wheel, whole.sinkage, whole.vibration) =
        (short(&whole.wheel), short(&whole.sinkage), short(&whole.vibration));
    whole.toml += "[vibration]\nscale = 10.0\n";
    let wav = sound(spec(3, 1000, 16), &[7; 300]);
    for round in 0..3000 {
        let mut folder = whole.clone();
        let mut change = |bytes: &mut Vec<u8>| {
            for _ in 0..1 + random(state) % 5 {
                let at = random(state) as usize % bytes.len();
                match random(state) % 4 {
                    0 => bytes.truncate(at.max(1)),
                    1 => bytes[at] = random(state) as u8,
                    _ => bytes[at] = b"0123456789.,-e\n\r\"; "[random(state) as usize % 19],
                }
            }
        };
        let text = match round % 5 {
            0 => Some(&mut folder.wheel),
            1 => Some(&mut folder.sinkage),
            2 => Some(&mut folder.vibration),
            3 => Some(&mut folder.frames),
            _ => None,
        };
        if let Some(text) = text {
            let mut bytes = std::mem::take(text).into_bytes();
            change(&mut bytes);
            *text = String::from_utf8_lossy(&bytes).into_owned();
        } else {
            folder.vibration.clear();
            folder.sound = wav.clone();
            change(&mut folder.sound);
        }
        let check = |event: &Event| match event {
            Event::Wheel(sample) => assert_eq!(sample.check(), Ok(())),
            Event::Sinkage(sample) => assert_eq!(sample.check(), Ok(())),
            Event::Vibration(piece) => assert_eq!(piece.check(), Ok(())),
        };
        let _ = folder.run(2000, check);
    }
}

#[test]
fn a_simulated_rover_is_sampled_on_a_fixed_grid_whenever_the_process_runs() {
    let started_ns = 7_000_000_000;
    let rover = simulation::Rover::new(simulation::Config::default());
    let mut telemetry = SimulatedTelemetry::new(simulation::Config::default(), started_ns);
    let mut pieces = Vec::new();
    // Starts late, misses some ticks, and is stopped for two seconds.
    for tick in (1234..1300).chain(1327..1400).chain(1600..1650) {
        let mut wheels = 0;
        let sent: Result<(), ()> = telemetry.at(tick, |event| {
            match event {
                Event::Wheel(wheel) => {
                    wheels += 1;
                    let load_n = rover.wheel((tick * 10_000_000) as f64 / 1e9).load_n;
                    assert_eq!(
                        (wheel.header.taken_ns, wheel.load_n),
                        (started_ns + tick * 10_000_000, load_n)
                    );
                    assert_eq!((wheel.header.sequence, wheel.check()), (tick, Ok(())));
                }
                Event::Vibration(piece) => {
                    assert_eq!((piece.count, piece.period_ns, piece.check()), (10, 10_000_000, Ok(())));
                    let number = piece.header.sequence;
                    assert_eq!(piece.start_ns, started_ns + number * 100_000_000);
                    assert_eq!(piece.header.taken_ns, piece.start_ns + 100_000_000);
                    assert!(piece.header.taken_ns <= started_ns + tick * 10_000_000);
                    let seventh = rover.vibration((number * 100_000_000 + 70_000_000) as f64 / 1e9);
                    let values: Vec<f32> = (0..7).map(|channel| piece.channel(channel)[7]).collect();
                    assert_eq!(values, seventh);
                    pieces.push(number);
                }
                Event::Sinkage(_) => panic!("the camera sees the sinkage"),
            }
            Ok(())
        });
        assert_eq!((sent, wheels), (Ok(()), 1));
    }
    let expected: Vec<u64> = (123..139).chain(155..164).collect();
    assert_eq!(pieces, expected);
}

#[test]
fn a_config_is_one_of_the_two_sources_and_nothing_else() {
    let parse = |text: &str| toml::from_str::<Config>(text).map_err(|error| error.message().to_owned());
    assert_eq!(
        parse("source = \"simulated\"\nrover = { seed = 3 }").unwrap(),
        Config::Simulated {
            rover: simulation::Config {
                seed: 3,
                ..simulation::Config::default()
            }
        }
    );
    let recorded = parse("source = \"recorded\"\nfolder = \"/t\"").unwrap();
    assert_eq!(recorded, Config::Recorded { folder: "/t".into() });
    assert_eq!(recorded.validate(), Ok(()));
    for bad in [
        "",
        "source = \"device\"",
        "source = \"recorded\"",
        "source = \"simulated\"\nfolder = \"/t\"",
        "source = \"simulated\"\nrover = { sed = 3 }",
    ] {
        assert!(parse(bad).is_err(), "{bad}");
    }
    let noisy = parse("source = \"simulated\"\nrover = { noise = -1 }").unwrap();
    assert_eq!(noisy.validate().unwrap_err().0, "rover");
}
