//! Numbers found from windows left out of the training: how far to believe, and what to reject.

use crate::decision::{Decision, Opinion, PerClass, calibrated};
use crate::filter::{Filter, before_change};
use crate::model::{Method, Model};
use crate::score::Scored;
use crate::train::quantile;
use crate::training_set::TrainingSet;
use messages::CLASSES_MAX;
use std::collections::BTreeMap;

/// Share of the windows, the same of each class, that is to be rejected.
const UNKNOWN_SHARE: f64 = 0.08;
/// Share of them that is rejected for being far from its class.
const FAR_SHARE: f64 = 0.01;
/// A class more probable than this is never rejected ...
const CONFIDENCE_MAX: f64 = 0.7;
/// ... and none for a metric nearer than this, in its standard deviations.
const DISTANCE_MIN: f64 = 3.0;
/// Exponents of probabilities tried: 1 is to believe them as they are.
const EXPONENTS: [f64; 12] = [0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.3];
/// Probabilities are taken to be at least this.
const PROBABILITY_MIN: f64 = 1e-6;

/// A window that was left out of the training, and what was decided of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Validated {
    /// Index of the recording.
    pub recording: usize,
    /// Sensor instant of the window's first sample.
    pub start_ns: u64,
    /// By itself.
    pub alone: Scored,
    /// With the windows before it, after a change of terrain at the start of the recording.
    pub filtered: Scored,
}

/// Sets the model's calibrated numbers by what was said of windows left out, and decides on these.
pub fn calibrate(model: &mut Model, set: &TrainingSet, opinions: &[(usize, Opinion)]) -> Vec<Validated> {
    model.probability_exponent = best_exponent(set, opinions);
    let opinions: Vec<(usize, Opinion)> = opinions
        .iter()
        .map(|(window, opinion)| {
            let probability = calibrated(&opinion.probability, model.probability_exponent);
            (
                *window,
                Opinion {
                    probability,
                    ..*opinion
                },
            )
        })
        .collect();
    let weights = EXPONENTS.map(|weight| {
        let filter = Filter { weight, ..model.filter };
        let filtered = filter_all(&filter, set, &opinions);
        (
            log_loss(set, opinions.iter().map(|(window, _)| *window).zip(filtered)),
            weight,
        )
    });
    model.filter.weight = weights
        .into_iter()
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or(1.0, |best| best.1);
    let filtered = filter_all(&model.filter, set, &opinions);
    if model.method == Method::Coupled {
        model.reject.distance_max = f64::INFINITY;
        let near = |model: &Model, opinion: &Opinion| -opinion.distance[model.decide(opinion).class];
        let far = opinions.iter().map(|(window, opinion)| (*window, near(model, opinion)));
        let far: Vec<(usize, f64)> = far.collect();
        model.reject.distance_max = DISTANCE_MIN.max(-floor(set, &far, FAR_SHARE));
        let sure = |(window, opinion): &(usize, Opinion)| (*window, confidence(&model.decide(opinion)));
        let sure: Vec<(usize, f64)> = opinions.iter().map(sure).collect();
        model.reject.confidence_min = CONFIDENCE_MAX.min(floor(set, &sure, UNKNOWN_SHARE));
    }
    let sure: Vec<(usize, f64)> = opinions
        .iter()
        .zip(&filtered)
        .map(|((window, opinion), probability)| (*window, confidence(&model.decide_filtered(opinion, probability))))
        .collect();
    model.filter.confidence_min = CONFIDENCE_MAX.min(floor(set, &sure, UNKNOWN_SHARE));
    let validated: Vec<Validated> = opinions
        .iter()
        .zip(&filtered)
        .map(|((window, opinion), probability)| Validated {
            recording: set.recordings[*window],
            start_ns: set.starts_ns[*window],
            alone: scored(set, *window, &model.decide(opinion)),
            filtered: scored(set, *window, &model.decide_filtered(opinion, probability)),
        })
        .collect();
    model.filter.lag_s = lag_s(&validated, set.window_s);
    validated
}

/// How long it takes until the class after a change of terrain is named: the median over the recordings, one in which it
/// never is counting with its length.
fn lag_s(validated: &[Validated], window_s: f64) -> f64 {
    let mut lags: BTreeMap<usize, (f64, bool)> = BTreeMap::new();
    for window in validated {
        let (lag, named) = lags.entry(window.recording).or_default();
        if !*named {
            *lag += window_s;
            *named = window.filtered.class == window.filtered.truth;
        }
    }
    quantile(lags.into_values().map(|lag| lag.0).collect(), 0.5).unwrap_or(0.0)
}

fn scored(set: &TrainingSet, window: usize, decision: &Decision) -> Scored {
    Scored {
        truth: set.classes[window],
        class: decision.class,
        unknown: decision.unknown,
        probability: decision.probability,
    }
}

/// Probability of the chosen class; 0 for what is rejected already.
fn confidence(decision: &Decision) -> f64 {
    if decision.unknown {
        0.0
    } else {
        decision.probability[decision.class]
    }
}

/// The value below which a share of the windows lies, the mean of what each class says.
fn floor(set: &TrainingSet, values: &[(usize, f64)], share: f64) -> f64 {
    let of_class = |class: usize| {
        let own = values.iter().filter(|(window, _)| set.classes[*window] == class);
        quantile(own.map(|(_, value)| *value).collect(), share)
    };
    let floors: Vec<f64> = (0..set.class_count).filter_map(of_class).collect();
    let mut low = floors.iter().copied().fold(f64::INFINITY, f64::min);
    let mut high = floors.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let share_below = |limit: f64| -> f64 {
        let below = |class: usize| {
            let own = values.iter().filter(|(window, _)| set.classes[*window] == class);
            let (count, hits) = own.fold((0.0, 0.0), |(count, hits), (_, value)| {
                (count + 1.0, hits + f64::from(u8::from(*value < limit)))
            });
            hits / f64::max(count, 1.0)
        };
        (0..set.class_count).map(below).sum::<f64>() / set.class_count as f64
    };
    // The share grows with the limit: halve the interval until it is narrow.
    for _ in 0..40 {
        let middle = (low + high) / 2.0;
        if share_below(middle) <= share {
            low = middle;
        } else {
            high = middle;
        }
    }
    if low.is_finite() { low } else { 0.0 }
}

/// What the filter makes of the windows, recording by recording, each entered from another class.
fn filter_all(filter: &Filter, set: &TrainingSet, opinions: &[(usize, Opinion)]) -> Vec<PerClass> {
    let classes = set.class_count;
    let mut filtered = vec![[0.0; CLASSES_MAX]; opinions.len()];
    // The belief of each recording, and when it was last changed.
    let mut states: BTreeMap<usize, (PerClass, u64)> = BTreeMap::new();
    for ((window, opinion), filtered) in opinions.iter().zip(&mut filtered) {
        let (recording, start_ns) = (set.recordings[*window], set.starts_ns[*window]);
        let (belief, elapsed_s) = match states.get(&recording) {
            Some((belief, last_ns)) => (*belief, start_ns.saturating_sub(*last_ns) as f64 / 1e9),
            None => (before_change(set.classes[*window], recording, classes), set.window_s),
        };
        *filtered = filter.update(&belief, &opinion.probability, classes, elapsed_s);
        states.insert(recording, (*filtered, start_ns));
    }
    filtered
}

/// The exponent with which probabilities lose least against the truth.
pub(crate) fn best_exponent(set: &TrainingSet, opinions: &[(usize, Opinion)]) -> f64 {
    let losses = EXPONENTS.map(|exponent| {
        let changed = opinions
            .iter()
            .map(|(window, opinion)| (*window, calibrated(&opinion.probability, exponent)));
        (log_loss(set, changed), exponent)
    });
    losses
        .into_iter()
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or(1.0, |best| best.1)
}

/// Mean of -ln of the true class's probability; classes count alike.
fn log_loss(set: &TrainingSet, windows: impl Iterator<Item = (usize, PerClass)>) -> f64 {
    class_mean(
        set,
        windows.map(|(window, probability)| (window, -probability[set.classes[window]].max(PROBABILITY_MIN).ln())),
    )
}

/// Mean probability of the true class; classes count alike.
pub(crate) fn mean_probability(set: &TrainingSet, opinions: &[(usize, Opinion)], exponent: f64) -> f64 {
    let of_truth = |(window, opinion): &(usize, Opinion)| {
        (
            *window,
            calibrated(&opinion.probability, exponent)[set.classes[*window]],
        )
    };
    class_mean(set, opinions.iter().map(of_truth))
}

fn class_mean(set: &TrainingSet, values: impl Iterator<Item = (usize, f64)>) -> f64 {
    let mut sums = vec![(0.0, 0.0); set.class_count];
    for (window, value) in values {
        let sum = &mut sums[set.classes[window]];
        sum.0 += value;
        sum.1 += 1.0;
    }
    sums.iter().map(|(sum, count)| sum / f64::max(*count, 1.0)).sum::<f64>() / set.class_count.max(1) as f64
}
