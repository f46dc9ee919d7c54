//! `terrasense vibration` on small recordings of made-up terrains, and on real ones where they are present.

#![allow(clippy::unwrap_used)]

use serde_json::Value;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

const RATE_HZ: f64 = 50.0;
const SECONDS: usize = 30;

fn vibration(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_terrasense"))
        .current_dir(folder)
        .arg("vibration")
        .args(arguments)
        .output()
        .expect("terrasense runs")
}

fn succeed(folder: &Path, arguments: &[&str]) -> String {
    let output = vibration(folder, arguments);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}

/// What is printed to standard error, after ending with code 65.
fn refused(folder: &Path, arguments: &[&str]) -> String {
    let output = vibration(folder, arguments);
    assert_eq!(output.status.code(), Some(65), "{arguments:?}");
    String::from_utf8(output.stderr).unwrap()
}

fn summary(folder: &Path, arguments: &[&str]) -> Value {
    serde_json::from_str(&succeed(folder, &[arguments, &["--json"]].concat())).unwrap()
}

/// Samples of a made-up terrain: two channels, smooth on one class and rough on the next, and the speed.
fn samples(class: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut state = seed;
    let mut noise = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    let memory = [0.9, 0.2, -0.6][class];
    let mut now = [0.0; 2];
    let mut next = || {
        now = now.map(|value| memory * value + noise());
        [now[0], now[1], 0.2]
    };
    (0..SECONDS * RATE_HZ as usize).map(|_| next()).collect()
}

fn table(samples: &[[f64; 3]], rate_hz: f64) -> String {
    let mut text = String::from("taken_s,acceleration_z_m_s2,angular_rate_y_rad_s,linear_velocity_m_s\n");
    for (index, [a, b, speed]) in samples.iter().enumerate() {
        writeln!(text, "{:.4},{a:.5},{b:.5},{speed}", index as f64 / rate_hz).unwrap();
    }
    text
}

/// A folder `train` with three runs of each class, and a folder `test` with one.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, seeds) in [("train", 1..4), ("test", 9..10)] {
        let place = folder.path().join(name);
        fs::create_dir(&place).unwrap();
        let mut list = String::from("file,class,run,remark\n");
        for (class, label) in ["loam", "gravel", "rock"].iter().enumerate() {
            for seed in seeds.clone() {
                fs::write(
                    place.join(format!("{label}_{seed}.csv")),
                    table(&samples(class, seed), RATE_HZ),
                )
                .unwrap();
                writeln!(list, "{label}_{seed}.csv,{label},{label}_{seed},made up").unwrap();
            }
        }
        fs::write(place.join("recordings.csv"), list).unwrap();
    }
    folder
}

/// The rows of a table, cell by cell.
fn rows(path: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(path).unwrap();
    text.lines()
        .map(|line| line.split(',').map(str::to_owned).collect())
        .collect()
}

fn number(cell: &str) -> f64 {
    cell.parse().unwrap()
}

#[test]
fn a_model_recognises_runs_that_it_has_not_seen() {
    let folder = folder();
    let trained = summary(folder.path(), &["train", "train", "--out", "model.toml"]);
    assert!(
        trained["left_out"]["balanced_accuracy"].as_f64().unwrap() > 0.9,
        "{trained}"
    );
    assert_eq!(trained["warnings"].as_array().unwrap().len(), 0, "{trained}");
    let tried = summary(
        folder.path(),
        &[
            "evaluate",
            "model.toml",
            "test",
            "--out",
            "p.csv",
            "--filter",
            "none",
            "--plots",
            "plots",
        ],
    );
    assert!(tried["scored"]["balanced_accuracy"].as_f64().unwrap() > 0.9, "{tried}");

    for file in [
        "figure_12_components.svg",
        "figure_13_metric.svg",
        "figure_14_transition.svg",
    ] {
        let drawn = fs::read_to_string(folder.path().join("plots").join(file)).unwrap();
        assert!(
            drawn.starts_with("<svg") && drawn.matches("<circle").count() > 50,
            "{file}"
        );
    }
    let rows = rows(&folder.path().join("p.csv"));
    let header = "run,start_s,class,predicted,probability_gravel,probability_loam,probability_rock,metric";
    assert_eq!(rows[0].join(","), header);
    assert_eq!(rows.len(), 1 + 3 * SECONDS);
    assert_eq!(rows[1][..3], ["loam_9", "0", "loam"]);
    for row in &rows[1..] {
        let probabilities: Vec<f64> = row[4..7].iter().map(|cell| number(cell)).collect();
        assert!((probabilities.iter().sum::<f64>() - 1.0).abs() < 1e-5, "{row:?}");
        let best = probabilities.iter().copied().fold(0.0, f64::max);
        let chosen = ["gravel", "loam", "rock"].iter().position(|label| *label == row[3]);
        assert!(row[3] == "unknown" || probabilities[chosen.unwrap()] == best, "{row:?}");
        assert!(number(&row[7]).is_finite());
    }
}

#[test]
fn the_same_recordings_give_the_same_bytes() {
    let folder = folder();
    for name in ["a.toml", "b.toml"] {
        succeed(folder.path(), &["train", "train", "--out", name]);
    }
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    assert!(read("a.toml") == read("b.toml"));
    for name in ["a.csv", "b.csv"] {
        succeed(folder.path(), &["evaluate", "a.toml", "test", "--out", name]);
    }
    assert!(read("a.csv") == read("b.csv"));
}

#[test]
fn sound_files_are_recordings_too() {
    let folder = folder();
    let spec = hound::WavSpec {
        channels: 1,
        sample_rate: RATE_HZ as u32,
        bits_per_sample: 32,
        sample_format: hound::SampleFormat::Float,
    };
    let mut list = String::from("file,class,run,scale\n");
    for (class, label) in ["loam", "gravel"].iter().enumerate() {
        for seed in 1..4 {
            let name = format!("{label}_{seed}.wav");
            let mut writer = hound::WavWriter::create(folder.path().join("test").join(&name), spec).unwrap();
            for [sample, _, _] in samples(class, seed) {
                writer.write_sample(sample as f32 / 10.0).unwrap();
            }
            writer.finalize().unwrap();
            writeln!(list, "{name},{label},{label}_{seed},10").unwrap();
        }
    }
    fs::write(folder.path().join("test/recordings.csv"), list).unwrap();
    let trained = summary(
        folder.path(),
        &["train", "test", "--out", "model.toml", "--filter", "none"],
    );
    assert!(
        trained["left_out"]["balanced_accuracy"].as_f64().unwrap() > 0.9,
        "{trained}"
    );
    let model = fs::read_to_string(folder.path().join("model.toml")).unwrap();
    assert!(
        model.contains("channels = [\"acceleration_z_m_s2\"]") && model.contains("rate_hz = 50.0"),
        "{model}"
    );
    // The table of the same drive, one of whose channels the sound file holds.
    let tried = summary(folder.path(), &["evaluate", "model.toml", "train", "--out", "p.csv"]);
    assert_eq!(tried["scored"]["foreign_windows"], 3 * SECONDS, "{tried}");
    assert!(tried["scored"]["balanced_accuracy"].as_f64().unwrap() > 0.9, "{tried}");
}

#[test]
fn a_model_that_does_not_fit_is_refused_with_what_differs() {
    let folder = folder();
    let path = folder.path();
    succeed(
        path,
        &[
            "train",
            "train",
            "--out",
            "m.toml",
            "--channels",
            "acceleration_*",
            "--window-s",
            "2",
        ],
    );
    let evaluate = |more: &[&str]| {
        refused(
            path,
            &[&["evaluate", "m.toml", "test", "--out", "p.csv"], more].concat(),
        )
    };
    assert!(evaluate(&["--window-s", "1"]).contains("windows of 2 s, not 1 s"));
    assert!(evaluate(&["--method", "paper"]).contains("the method coupled"));
    assert!(evaluate(&["--channels", "angular_rate_y_rad_s"]).contains("the channels acceleration_z_m_s2"));
    succeed(
        path,
        &[
            "evaluate",
            "m.toml",
            "test",
            "--out",
            "p.csv",
            "--channels",
            "acceleration_z_m_s2",
        ],
    );

    fs::write(path.join("test/loam_9.csv"), table(&samples(0, 9), 2.0 * RATE_HZ)).unwrap();
    assert!(evaluate(&[]).contains("loam_9.csv was sampled at 100.000 Hz, other recordings at 50.000 Hz"));
    fs::write(
        path.join("test/recordings.csv"),
        "file,class,run\nloam_9.csv,loam,loam_9\n",
    )
    .unwrap();
    assert!(evaluate(&[]).contains("sampled at 100 Hz; the model was trained at 50 Hz"));
    let other = table(&samples(0, 9), RATE_HZ).replace("acceleration_z", "acceleration_x");
    fs::write(path.join("test/loam_9.csv"), other).unwrap();
    assert!(evaluate(&[]).contains("no channel acceleration_z_m_s2"));
    fs::write(path.join("m.toml"), "format = 1\n").unwrap();
    assert!(evaluate(&[]).contains("m.toml"));
}

#[test]
fn mistakes_in_recordings_are_named() {
    let folder = folder();
    let path = folder.path();
    let train = |more: &[&str]| refused(path, &[&["train", "train", "--out", "m.toml"], more].concat());
    assert!(refused(path, &["train", "nowhere", "--out", "m.toml"]).contains("recordings.csv"));
    assert!(train(&["--channels", "magnetic_field_x_t"]).contains("no channel magnetic_field_x_t; there are"));
    for (list, complaint) in [
        ("file,run\na.csv,a\n", "column \"class\" is missing"),
        ("file,class,run\na.csv,loam,\n", "run is empty"),
        ("file,class,run\na.csv,loam,a\n", "a.csv"),
        (
            "file,class,run\nloam_1.csv,loam,loam_1\n",
            "2 to 16 classes (labels), there are 1",
        ),
    ] {
        fs::write(path.join("train/recordings.csv"), list).unwrap();
        assert!(train(&[]).contains(complaint), "{}", train(&[]));
    }
    assert!(!path.join("m.toml").exists());
}

#[test]
fn what_limits_the_recordings_is_said() {
    let folder = folder();
    let place = folder.path().join("train");
    let mut fast = samples(0, 1);
    for sample in &mut fast {
        sample[2] = 0.9;
    }
    // One run of loam, faster than all others; gravel clipped; rock standing still for half of its time.
    fs::write(place.join("loam_1.csv"), table(&fast, RATE_HZ)).unwrap();
    for seed in 1..4 {
        let clip = |[a, b, speed]: [f64; 3]| [a.clamp(-0.3, 0.3), b, speed];
        let clipped: Vec<[f64; 3]> = samples(1, seed).into_iter().map(clip).collect();
        let some = [clipped[..500].to_vec(), samples(1, seed)[500..].to_vec()].concat();
        fs::write(place.join(format!("gravel_{seed}.csv")), table(&some, RATE_HZ)).unwrap();
        let mut still = samples(2, seed);
        for sample in &mut still[..750] {
            *sample = [0.01 * sample[0], 0.01 * sample[1], 0.0];
        }
        fs::write(place.join(format!("rock_{seed}.csv")), table(&still, RATE_HZ)).unwrap();
    }
    let list = fs::read_to_string(place.join("recordings.csv")).unwrap();
    let kept = list
        .lines()
        .filter(|line| !line.starts_with("loam_2") && !line.starts_with("loam_3"));
    let kept: Vec<&str> = kept.collect();
    fs::write(place.join("recordings.csv"), kept.join("\n")).unwrap();
    let said = succeed(folder.path(), &["train", "train", "--out", "m.toml"]);
    for warning in [
        "loam has one run",
        "rock: the vehicle stands still",
        "have a dead or saturated channel",
        "do not overlap",
    ] {
        assert!(said.contains(warning), "{warning} is missing:\n{said}");
    }
    succeed(folder.path(), &["evaluate", "m.toml", "train", "--out", "p.csv"]);
    let marked = |word: &str| {
        rows(&folder.path().join("p.csv"))
            .iter()
            .filter(|row| row[3] == word)
            .count()
    };
    assert!(marked("standing_still") >= 40 && marked("sensor_fault") >= 20);
}

#[test]
fn the_papers_method_is_there_with_its_band() {
    let folder = folder();
    let trained = summary(
        folder.path(),
        &[
            "train", "train", "--out", "m.toml", "--method", "paper", "--filter", "none",
        ],
    );
    let left_out = &trained["left_out"];
    assert!(left_out["balanced_accuracy"].as_f64().unwrap() > 0.9, "{trained}");
    assert!(
        (0.1..0.8).contains(&left_out["unknown_share"].as_f64().unwrap()),
        "{trained}"
    );
}

/// The recordings of BorealTC, where they are present.
fn borealtc() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/borealtc");
    if !folder.is_dir() {
        println!("ignored: put BorealTC into shared/data/borealtc beside the repository");
    }
    folder.is_dir().then_some(folder)
}

#[test]
fn real_terrain_is_told_apart_on_runs_left_out() {
    let Some(recordings) = borealtc() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let recordings = recordings.display().to_string();
    let channels = ["--channels", "acceleration_*,angular_rate_*"];
    let train = [&["train", &recordings, "--out", "m.toml"], &channels[..]].concat();
    let filtered = &summary(scratch.path(), &train)["left_out"];
    let alone = &summary(scratch.path(), &[&train[..], &["--filter", "none"]].concat())["left_out"];
    let figure = |report: &Value, name: &str| report[name].as_f64().unwrap();
    assert!(figure(alone, "balanced_accuracy") > 0.78, "{alone}");
    assert!(figure(filtered, "balanced_accuracy") > 0.84, "{filtered}");
    assert!(
        figure(filtered, "unknown_share") < 0.1 && figure(filtered, "wrong_share") < 0.13,
        "{filtered}"
    );
    assert!(figure(alone, "calibration_error") < 0.08, "{alone}");
}
