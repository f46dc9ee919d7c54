//! The paper's pair classifier against values computed by another program from real recordings; see `golden/ORIGIN.md`.

#![allow(clippy::unwrap_used)]

use nalgebra::DMatrix;
use serde_json::Value;
use std::path::{Path, PathBuf};
use vibration::discriminant::{Discriminant, PairFit, fit_pair};
use vibration::features::{Extractor, Features};

const TOLERANCE: f64 = 1e-9;
const SAMPLES: usize = 100;
const CHANNELS: usize = 6;

fn golden() -> Value {
    serde_json::from_str(include_str!("../golden/vibration_pair.json")).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|number| number.as_f64().unwrap())
        .collect()
}

fn assert_close(name: &str, found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len(), "{name}");
    for (index, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() <= TOLERANCE, "{name}[{index}]: {a} instead of {b}");
    }
}

/// The recordings, where they are present.
fn recordings() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/borealtc/runs");
    folder.is_dir().then_some(folder)
}

/// Log PSDs of a run's windows in which the vehicle moves.
fn features_of(folder: &Path, run: &str) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(folder.join(format!("{run}.csv"))).unwrap();
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    let mut extractor = Extractor::new(Features::every_bin(CHANNELS, 5), SAMPLES, 100.0);
    let mut windows = Vec::new();
    for window in rows.chunks_exact(SAMPLES) {
        let column = |index: usize| -> Vec<f64> { window.iter().map(|row| row[index]).collect() };
        if column(CHANNELS + 1).iter().sum::<f64>().abs() < 0.05 * SAMPLES as f64 {
            continue;
        }
        let channels: Vec<Vec<f64>> = (1..=CHANNELS).map(column).collect();
        let mut features = vec![0.0; extractor.count()];
        extractor.extract(|channel| &channels[channel], &mut features);
        windows.push(features);
    }
    windows
}

fn class_features(folder: &Path, golden: &Value, runs: &str, class: &str) -> Vec<Vec<f64>> {
    let runs = golden[runs].as_array().unwrap().iter().map(|run| run.as_str().unwrap());
    runs.filter(|run| run.starts_with(class))
        .flat_map(|run| features_of(folder, run))
        .collect()
}

fn matrix(windows: &[Vec<f64>]) -> DMatrix<f64> {
    DMatrix::from_iterator(windows[0].len(), windows.len(), windows.iter().flatten().copied())
}

fn assert_training_is_golden(golden: &Value, fit: &PairFit) {
    let singular_values = numbers(&golden["singular_values"]);
    for (a, b) in fit.singular_values.iter().zip(&singular_values) {
        assert!((a - b).abs() <= TOLERANCE * b, "singular values: {a} instead of {b}");
    }
    assert_close("w", &fit.discriminant.weights, &numbers(&golden["w"]));
    assert_close("mu", fit.mean.as_slice(), &numbers(&golden["mu"]));
    assert_close(
        "class_mean",
        &fit.discriminant.class_mean,
        &numbers(&golden["class_mean"]),
    );
    assert_close(
        "class_sigma",
        &fit.discriminant.class_sigma,
        &numbers(&golden["class_sigma"]),
    );
}

#[test]
fn the_pair_of_the_golden_file_is_found_again() {
    let Some(folder) = recordings() else {
        println!("ignored: put BorealTC into shared/data/borealtc beside the repository (golden/ORIGIN.md)");
        return;
    };
    let golden = golden();
    let train = ["asphalt", "sandy_loam"].map(|class| class_features(&folder, &golden, "train_runs", class));
    let test = ["asphalt", "sandy_loam"].map(|class| class_features(&folder, &golden, "test_runs", class));
    assert_eq!(golden["n_train"], serde_json::json!([train[0].len(), train[1].len()]));
    assert_eq!(golden["n_test"], serde_json::json!([test[0].len(), test[1].len()]));
    assert_close(
        "features",
        &train[0][0],
        &numbers(&golden["first_feature_of_first_train_run"]),
    );

    let fit = fit_pair(&matrix(&train[0]), &matrix(&train[1]), 6).unwrap();
    assert_training_is_golden(&golden, &fit);
    let metrics = test.map(|windows| {
        windows
            .iter()
            .map(|window| fit.discriminant.metric(window, 0.0))
            .collect::<Vec<_>>()
    });
    assert_close("d of a", &metrics[0][..10], &numbers(&golden["d_first10_test_a"]));
    assert_close("d of b", &metrics[1][..10], &numbers(&golden["d_first10_test_b"]));
    assert_accuracy_is_golden(&golden, &fit.discriminant, &metrics);
}

/// Forced decisions, and decisions within one standard deviation of one class or the other.
fn assert_accuracy_is_golden(golden: &Value, pair: &Discriminant, metrics: &[Vec<f64>; 2]) {
    let count = (metrics[0].len() + metrics[1].len()) as f64;
    let (mut forced, mut correct, mut wrong, mut unknown) = (0.0, 0.0, 0.0, 0.0);
    for (class, metric) in metrics
        .iter()
        .enumerate()
        .flat_map(|(class, all)| all.iter().map(move |d| (class, *d)))
    {
        let distances = pair.distances(metric);
        let nearer = usize::from(distances[1] < distances[0]);
        forced += f64::from(u8::from(nearer == class)) / count;
        let share = if distances[nearer] > 1.0 {
            &mut unknown
        } else if nearer == class {
            &mut correct
        } else {
            &mut wrong
        };
        *share += 1.0 / count;
    }
    let band = &golden["test_one_sigma_band"];
    let expected = [
        &golden["test_forced_accuracy"],
        &band["correct"],
        &band["wrong"],
        &band["unknown"],
    ];
    assert_close(
        "shares",
        &[forced, correct, wrong, unknown],
        &expected.map(|share| share.as_f64().unwrap()),
    );
}

#[test]
fn the_golden_file_agrees_with_itself() {
    let golden = golden();
    let (weights, mean) = (numbers(&golden["w"]), numbers(&golden["mu"]));
    let class_mean = numbers(&golden["class_mean"]);
    let counts = numbers(&golden["n_train"]);
    // The metric of the mean of all training windows is 0.
    let centre = (class_mean[0] * counts[0] + class_mean[1] * counts[1]) / (counts[0] + counts[1]);
    assert!(centre.abs() < TOLERANCE, "{centre}");
    // A window at the mean has the metric 0, wherever the offset is kept.
    let pair = Discriminant {
        class_mean: [class_mean[0], class_mean[1]],
        class_sigma: [1.0, 1.0],
        offset: weights.iter().zip(&mean).map(|(w, mu)| w * mu).sum(),
        speed_weight: 0.0,
        weights,
    };
    assert!(pair.metric(&mean, 0.0).abs() < TOLERANCE);
    // The first training window is asphalt and lies nearer to it than to sandy loam.
    let first = pair.metric(&numbers(&golden["first_feature_of_first_train_run"]), 0.0);
    assert!((first - class_mean[0]).abs() < (first - class_mean[1]).abs());
}
