//! What training leaves and a classifier needs, as one readable file.

use crate::discriminant::Discriminant;
use crate::features::Features;
use crate::filter::Filter;
use messages::{CHANNELS_MAX, CLASSES_MAX, LABEL_BYTES};
use serde::{Deserialize, Serialize};

/// Name and version of the format; another layout gets another number.
pub const FORMAT: &str = "terrasense/vibration-model/1";

/// Samples of a window at the most.
pub const WINDOW_SAMPLES_MAX: usize = 1 << 17;
/// Sine tapers at the most.
pub const TAPERS_MAX: usize = 32;

/// How a window is decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// The paper's: every bin of the log PSDs, each pair of classes in its first six principal components, votes, bands of
    /// one standard deviation.
    Paper,
    /// Bands of power and partial coherence, each pair of classes averaged over signal spaces, coupled to probabilities.
    Coupled,
}

/// Whether the windows before count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Filtering {
    /// Each window is decided by itself.
    None,
    /// A hidden Markov model's forward filter.
    Hmm,
}

/// Whether a class may be rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rejecting {
    /// The most probable class always stands.
    None,
    /// By the limits that training found.
    Calibrated,
}

/// When the chosen class is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reject {
    /// Where it is less probable than this.
    pub confidence_min: f64,
    /// Where the metric of any of its pairs is farther from its mean than this, in its standard deviations.
    pub distance_max: f64,
}

/// What the speed, where it is known, has to say.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Speed {
    /// A vehicle that is slower, does not turn and is quiet stands still.
    pub still_m_s: f64,
    /// log10 of the PSD, mean over channels and bands, below which the vehicle is quiet.
    pub quiet_level: f64,
    /// The speed for which the discriminants hold as they are.
    pub usual_m_s: f64,
}

/// A trained classifier.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// [`FORMAT`].
    pub format: String,
    /// How a window is decided.
    pub method: Method,
    /// Whether the windows before count, where nothing else is said.
    pub filtering: Filtering,
    /// Whether a class may be rejected, where nothing else is said.
    pub rejecting: Rejecting,
    /// The classes' names.
    pub labels: Vec<String>,
    /// The channels' names, as they stand in a piece of vibration.
    pub channels: Vec<String>,
    /// Sampling rate.
    pub rate_hz: f64,
    /// Samples of a window.
    pub window_samples: usize,
    /// Exponent that turns what the pairs say into probabilities that can be believed.
    pub probability_exponent: f64,
    /// What it was trained on, and how it did on recordings left out of the training: for people.
    #[serde(default)]
    pub training: String,
    /// How a window becomes numbers.
    pub features: Features,
    /// What the speed has to say.
    pub speed: Speed,
    /// When the chosen class is rejected.
    pub reject: Reject,
    /// How much the windows before count.
    pub filter: Filter,
    /// One discriminant a pair of classes: first with second, first with third, ..., second with third, ...
    pub pairs: Vec<Discriminant>,
}

impl Model {
    /// The model of the simulated rover.
    ///
    /// # Panics
    /// Never: a test reads the file.
    #[must_use]
    pub fn built_in() -> Self {
        Self::parse(include_str!("built_in.toml")).expect("the built-in model is valid")
    }

    /// Reads the bytes of a model file.
    ///
    /// # Errors
    /// Says what is wrong in it, and where.
    pub fn parse_bytes(bytes: &[u8]) -> Result<Self, String> {
        Self::parse(str::from_utf8(bytes).map_err(|error| format!("no UTF-8 text: {error}"))?)
    }

    /// Reads a model file.
    ///
    /// # Errors
    /// Says what is wrong in it, and where.
    pub fn parse(text: &str) -> Result<Self, String> {
        let model: Self = toml::from_str(text).map_err(|error| error.to_string())?;
        model.validate()?;
        Ok(model)
    }

    /// The model as text: [`Model::parse`] gives the same model back.
    ///
    /// # Errors
    /// Says what cannot be written; a validated model always can.
    pub fn to_text(&self) -> Result<String, String> {
        toml::to_string(self).map_err(|error| error.to_string())
    }

    /// Length of a window [s].
    #[must_use]
    pub fn window_s(&self) -> f64 {
        self.window_samples as f64 / self.rate_hz
    }

    /// The pairs of classes in the order of `pairs`.
    pub fn class_pairs(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        class_pairs(self.labels.len())
    }

    /// Checks that the parts fit each other.
    ///
    /// # Errors
    /// Says what does not.
    pub fn validate(&self) -> Result<(), String> {
        check(self.format == FORMAT, || {
            format!("format must be {FORMAT:?}, is {:?}", self.format)
        })?;
        check_names(&self.labels, &self.channels)?;
        let within = |name: &str, value: f64, low: f64, high: f64| {
            check((low..=high).contains(&value), || {
                format!("{name} must be {low} to {high}, is {value}")
            })
        };
        within("rate_hz", self.rate_hz, 1e-3, 1e6)?;
        within(
            "window_samples",
            self.window_samples as f64,
            4.0,
            WINDOW_SAMPLES_MAX as f64,
        )?;
        within("probability_exponent", self.probability_exponent, 1e-3, 1e3)?;
        within("features.tapers", self.features.tapers as f64, 1.0, TAPERS_MAX as f64)?;
        let bins = (self.window_samples / 2) as f64;
        within("features.band_bins", self.features.band_bins as f64, 1.0, bins)?;
        check(self.features.scale.len() == self.channels.len(), || {
            format!("features.scale must have {} values, one a channel", self.channels.len())
        })?;
        for scale in &self.features.scale {
            within("features.scale", *scale, 1e-30, 1e30)?;
        }
        within("speed.still_m_s", self.speed.still_m_s, 0.0, 1e3)?;
        within("speed.usual_m_s", self.speed.usual_m_s, 1e-9, 1e3)?;
        check(!self.speed.quiet_level.is_nan(), || {
            "speed.quiet_level must be a number".into()
        })?;
        within("reject.confidence_min", self.reject.confidence_min, 0.0, 1.0)?;
        check(self.reject.distance_max > 0.0, || {
            "reject.distance_max must be above 0".into()
        })?;
        within("filter.stay_per_s", self.filter.stay_per_s, 0.0, 1.0)?;
        within("filter.weight", self.filter.weight, 1e-3, 1e3)?;
        within("filter.confidence_min", self.filter.confidence_min, 0.0, 1.0)?;
        within("filter.lag_s", self.filter.lag_s, 0.0, 1e9)?;
        self.validate_pairs()
    }

    fn validate_pairs(&self) -> Result<(), String> {
        let expected = self.class_pairs().count();
        check(self.pairs.len() == expected, || {
            format!(
                "{} classes have {expected} pairs, there are {}",
                self.labels.len(),
                self.pairs.len()
            )
        })?;
        for (pair, (a, b)) in self.pairs.iter().zip(self.class_pairs()) {
            let name = || format!("the pair of {} and {}", self.labels[a], self.labels[b]);
            let features = self.features.count(self.window_samples);
            check(pair.weights.len() == features, || {
                format!("{} must have {features} weights, has {}", name(), pair.weights.len())
            })?;
            let rest = [&pair.offset, &pair.speed_weight];
            let numbers = pair.weights.iter().chain(&pair.class_mean).chain(&pair.class_sigma);
            let mut numbers = numbers.chain(rest);
            check(numbers.all(|number| number.is_finite()), || {
                format!("{} holds a number that is not finite", name())
            })?;
            check(pair.class_sigma.iter().all(|sigma| *sigma > 0.0), || {
                format!("{} must have class_sigma above 0", name())
            })?;
        }
        Ok(())
    }
}

/// Checks that the names fit into samples: how many there are, how long they are, and that none stands twice.
///
/// # Errors
/// Says what does not.
pub fn check_names(labels: &[String], channels: &[String]) -> Result<(), String> {
    check((2..=CLASSES_MAX).contains(&labels.len()), || {
        format!(
            "there must be 2 to {CLASSES_MAX} classes (labels), there are {}",
            labels.len()
        )
    })?;
    check((1..=CHANNELS_MAX).contains(&channels.len()), || {
        format!(
            "there must be 1 to {CHANNELS_MAX} channels, there are {}: {}",
            channels.len(),
            channels.join(", ")
        )
    })?;
    for names in [labels, channels] {
        for (index, name) in names.iter().enumerate() {
            check(!name.is_empty() && name.len() <= LABEL_BYTES, || {
                format!("the name {name:?} must have 1 to {LABEL_BYTES} bytes")
            })?;
            check(!names[..index].contains(name), || {
                format!("the name {name:?} stands twice")
            })?;
        }
    }
    Ok(())
}

/// All pairs of `classes` classes, in order.
pub(crate) fn class_pairs(classes: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
    (0..classes).flat_map(move |a| (a + 1..classes).map(move |b| (a, b)))
}

fn check(good: bool, complaint: impl FnOnce() -> String) -> Result<(), String> {
    if good { Ok(()) } else { Err(complaint()) }
}
