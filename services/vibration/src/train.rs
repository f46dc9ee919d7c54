//! Training: labelled recordings in, a model and how far to trust it out. The same recordings give the same bytes.

use crate::calibrate::{Validated, calibrate};
use crate::discriminant::{Discriminant, fit_pair};
use crate::features::{Extractor, Features, Kind};
use crate::filter::Filter;
use crate::model::{FORMAT, Filtering, Method, Model, Reject, Rejecting, Speed, check_names, class_pairs};
use crate::recording::{Cutter, Recording, Window};
use crate::score::balanced_accuracy;
use crate::select::{Selection, select};
use crate::training_set::{Folds, TrainingSet};

/// Principal components of the paper's method.
pub const PAPER_COMPONENTS: usize = 6;
/// Standard deviations about its mean within which the paper accepts a class.
pub const PAPER_BAND: f64 = 1.0;
/// Sine tapers of the spectra.
pub const TAPERS: usize = 5;
/// Probability that the terrain is still the same after a second.
const STAY_PER_S: f64 = 0.9;
/// A vehicle slower than this, or than a fifth of its usual speed, may stand still.
const STILL_M_S: f64 = 0.05;
/// Share of the moving windows that are as quiet as a vehicle that stands.
const QUIET_SHARE: f64 = 0.05;

/// What is to be trained.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// The classes' names.
    pub labels: Vec<String>,
    /// The channels' names.
    pub channels: Vec<String>,
    /// Sampling rate.
    pub rate_hz: f64,
    /// Samples of a window.
    pub window_samples: usize,
    /// How windows are decided.
    pub method: Method,
    /// Whether the windows before count, where nothing else is said.
    pub filtering: Filtering,
    /// Whether a class may be rejected, where nothing else is said.
    pub rejecting: Rejecting,
}

/// A model, and how it was found.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The model.
    pub model: Model,
    /// All windows of all recordings.
    pub windows: Vec<Window>,
    /// Each window decided by a model that was trained without its recording.
    pub validated: Vec<Validated>,
    /// What cross-validation chose.
    pub choice: String,
}

/// Trains a model. `progress` is told what is going on, and which share of it is done.
///
/// # Errors
/// Says what is missing.
pub fn train(
    setup: &Setup,
    recordings: &[Recording],
    progress: &mut dyn FnMut(&'static str, f64),
) -> Result<Trained, String> {
    check_names(&setup.labels, &setup.channels)?;
    let (features, windows) = cut(setup, recordings, progress);
    let speed = find_speed(&windows);
    let set = TrainingSet::new(setup, recordings, &windows, &speed, features)?;
    let folds = Folds::new(&set);
    let selection = match setup.method {
        Method::Paper => paper(setup, &set, &folds, progress)?,
        Method::Coupled => select(&set, &folds, progress)?,
    };
    let mut model = Model {
        format: FORMAT.into(),
        method: setup.method,
        filtering: setup.filtering,
        rejecting: setup.rejecting,
        labels: setup.labels.clone(),
        channels: setup.channels.clone(),
        rate_hz: setup.rate_hz,
        window_samples: setup.window_samples,
        probability_exponent: 1.0,
        training: String::new(),
        features: selection.features,
        speed,
        reject: Reject {
            confidence_min: 0.0,
            distance_max: PAPER_BAND,
        },
        filter: Filter {
            stay_per_s: STAY_PER_S,
            weight: 1.0,
            confidence_min: 0.0,
            lag_s: 0.0,
        },
        pairs: selection.pairs.into_iter().map(rounded).collect(),
    };
    let validated = calibrate(&mut model, &set, &selection.opinions);
    model.training = summary(&model, recordings, &validated);
    model.validate()?;
    Ok(Trained {
        model,
        windows,
        validated,
        choice: selection.choice,
    })
}

fn cut(
    setup: &Setup,
    recordings: &[Recording],
    progress: &mut dyn FnMut(&'static str, f64),
) -> (Features, Vec<Window>) {
    let cutter = Cutter {
        window_samples: setup.window_samples,
        rate_hz: setup.rate_hz,
        channels: setup.channels.clone(),
    };
    let features = match setup.method {
        Method::Paper => Features::every_bin(setup.channels.len(), TAPERS),
        Method::Coupled => {
            let scale = cutter
                .usual_deviations(recordings)
                .into_iter()
                .map(seven_digits)
                .collect();
            let kind = if setup.channels.len() > 1 {
                Kind::Partial
            } else {
                Kind::Power
            };
            Features::banded(kind, scale, setup.window_samples, TAPERS)
        }
    };
    let mut extractor = Extractor::new(features.clone(), setup.window_samples, setup.rate_hz);
    let mut windows = Vec::new();
    for (index, recording) in recordings.iter().enumerate() {
        progress("features", index as f64 / recordings.len() as f64);
        windows.extend(cutter.cut(index, recording, &mut extractor, setup.method == Method::Coupled));
    }
    (features, windows)
}

/// What tells a vehicle that stands still from one that moves.
fn find_speed(windows: &[Window]) -> Speed {
    let known = windows
        .iter()
        .map(|window| window.speed_m_s.abs())
        .filter(|speed_m_s| *speed_m_s > 0.0);
    let fifth = quantile(known.collect(), 0.5).map_or(STILL_M_S, |median| median / 5.0);
    let still_m_s = seven_digits(fifth.min(STILL_M_S));
    let moving = || windows.iter().filter(|window| window.speed_m_s.abs() >= still_m_s);
    let quiet = quantile(moving().map(|window| window.level).collect(), QUIET_SHARE);
    let usual = quantile(moving().map(|window| window.speed_m_s.abs()).collect(), 0.5);
    Speed {
        still_m_s,
        quiet_level: seven_digits(quiet.unwrap_or(f64::INFINITY)),
        usual_m_s: seven_digits(usual.unwrap_or(1.0)),
    }
}

/// The value below which a share of the values lies.
pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let index = (values.len() as f64 * share) as usize;
    values.get(index.min(values.len().saturating_sub(1))).copied()
}

/// The paper's pairs on everything, and what those trained without a fold say of the fold's windows.
fn paper(
    setup: &Setup,
    set: &TrainingSet,
    folds: &Folds,
    progress: &mut dyn FnMut(&'static str, f64),
) -> Result<Selection, String> {
    let mut opinions = Vec::new();
    for fold in 0..folds.count {
        progress("cross-validation", fold as f64 / folds.count as f64);
        let pairs = paper_pairs(setup, set, |window| folds.of_window[window] != fold)?;
        opinions.extend(set.opinions(&pairs, &set.columns, |window| folds.of_window[window] == fold));
    }
    opinions.sort_by_key(|(window, _)| *window);
    Ok(Selection {
        features: set.features.clone(),
        pairs: paper_pairs(setup, set, |_| true)?,
        opinions,
        choice: format!("the paper's {PAPER_COMPONENTS} principal components of every bin"),
    })
}

fn paper_pairs(setup: &Setup, set: &TrainingSet, chosen: impl Fn(usize) -> bool) -> Result<Vec<Discriminant>, String> {
    let windows_of = |class: usize| {
        let columns: Vec<usize> = (0..set.classes.len())
            .filter(|window| set.classes[*window] == class && chosen(*window))
            .collect();
        set.columns.select_columns(&columns)
    };
    class_pairs(setup.labels.len())
        .map(|(a, b)| {
            let fit = fit_pair(&windows_of(a), &windows_of(b), PAPER_COMPONENTS);
            let named = |why| format!("{} and {}: {why}", setup.labels[a], setup.labels[b]);
            fit.map(|fit| fit.discriminant).map_err(named)
        })
        .collect()
}

/// The discriminant with seven digits a number: a small file, and equal bytes from processors that round the last bit
/// differently.
fn rounded(pair: Discriminant) -> Discriminant {
    Discriminant {
        class_mean: pair.class_mean.map(seven_digits),
        class_sigma: pair.class_sigma.map(seven_digits),
        offset: seven_digits(pair.offset),
        speed_weight: seven_digits(pair.speed_weight),
        weights: pair.weights.into_iter().map(seven_digits).collect(),
    }
}

pub(crate) fn seven_digits(value: f64) -> f64 {
    format!("{value:.6e}").parse().unwrap_or(value)
}

fn summary(model: &Model, recordings: &[Recording], validated: &[Validated]) -> String {
    let classes = model.labels.len();
    let samples: usize = recordings.iter().map(|recording| recording.taken_ns.len()).sum();
    let alone: Vec<_> = validated.iter().map(|window| window.alone).collect();
    let filtered: Vec<_> = validated.iter().map(|window| window.filtered).collect();
    format!(
        "{:.1} minutes in {} recordings; balanced accuracy on recordings left out: {:.3}, filtered {:.3}",
        samples as f64 / model.rate_hz / 60.0,
        recordings.len(),
        balanced_accuracy(&alone, classes),
        balanced_accuracy(&filtered, classes),
    )
}
