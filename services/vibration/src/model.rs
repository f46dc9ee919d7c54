//! What training leaves and a classifier needs, as one readable file.

use crate::discriminant::Discriminant;
use messages::{CHANNELS_MAX, CLASSES_MAX, LABEL_BYTES};
use serde::{Deserialize, Serialize};

/// Name and version of the format; another layout gets another number.
pub const FORMAT: &str = "terrasense/vibration-model/1";

/// Samples of a window at the most.
pub const WINDOW_SAMPLES_MAX: usize = 1 << 16;
/// Sine tapers at the most.
pub const TAPERS_MAX: usize = 32;

/// How a window is decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// The paper's: one discriminant a pair of classes, votes, bands of one standard deviation.
    Paper,
}

/// A trained classifier. The features of a window are its channels' log PSDs (bins 1 to half the samples, log10 of
/// unit²/Hz), one after the other in the order of `channels`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// [`FORMAT`].
    pub format: String,
    /// How a window is decided.
    pub method: Method,
    /// The classes' names.
    pub labels: Vec<String>,
    /// The channels' names, as they stand in a piece of vibration.
    pub channels: Vec<String>,
    /// Sampling rate.
    pub rate_hz: f64,
    /// Samples of a window.
    pub window_samples: usize,
    /// Sine tapers of the spectrum.
    pub tapers: usize,
    /// A window whose mean speed is lower stands still.
    pub still_m_s: f64,
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

    /// Features of a window.
    #[must_use]
    pub fn features(&self) -> usize {
        self.channels.len() * (self.window_samples / 2)
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
        let classes = self.labels.len();
        check(self.format == FORMAT, || {
            format!("format must be {FORMAT:?}, is {:?}", self.format)
        })?;
        check((2..=CLASSES_MAX).contains(&classes), || {
            format!("labels must name 2 to {CLASSES_MAX} classes, names {classes}")
        })?;
        check((1..=CHANNELS_MAX).contains(&self.channels.len()), || {
            format!("channels must name 1 to {CHANNELS_MAX}, names {}", self.channels.len())
        })?;
        for names in [&self.labels, &self.channels] {
            for (index, name) in names.iter().enumerate() {
                check(!name.is_empty() && name.len() <= LABEL_BYTES, || {
                    format!("the name {name:?} must have 1 to {LABEL_BYTES} bytes")
                })?;
                check(!names[..index].contains(name), || {
                    format!("the name {name:?} stands twice")
                })?;
            }
        }
        check(self.rate_hz > 0.0 && self.rate_hz <= 1e6, || {
            format!("rate_hz must be above 0 and at most 1e6, is {}", self.rate_hz)
        })?;
        check((4..=WINDOW_SAMPLES_MAX).contains(&self.window_samples), || {
            format!(
                "window_samples must be 4 to {WINDOW_SAMPLES_MAX}, is {}",
                self.window_samples
            )
        })?;
        check((1..=TAPERS_MAX).contains(&self.tapers), || {
            format!("tapers must be 1 to {TAPERS_MAX}, is {}", self.tapers)
        })?;
        check(self.still_m_s >= 0.0, || {
            format!("still_m_s must not be negative, is {}", self.still_m_s)
        })?;
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
            check(pair.weights.len() == self.features(), || {
                format!(
                    "{} must have {} weights, has {}",
                    name(),
                    self.features(),
                    pair.weights.len()
                )
            })?;
            let numbers = pair
                .weights
                .iter()
                .chain(&pair.class_mean)
                .chain(&pair.class_sigma)
                .chain([&pair.offset]);
            check(numbers.into_iter().all(|number| number.is_finite()), || {
                format!("{} holds a number that is not finite", name())
            })?;
            check(pair.class_sigma.iter().all(|sigma| *sigma > 0.0), || {
                format!("{} must have class_sigma above 0", name())
            })?;
        }
        Ok(())
    }
}

/// All pairs of `classes` classes, in order.
pub(crate) fn class_pairs(classes: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
    (0..classes).flat_map(move |a| (a + 1..classes).map(move |b| (a, b)))
}

fn check(good: bool, complaint: impl FnOnce() -> String) -> Result<(), String> {
    if good { Ok(()) } else { Err(complaint()) }
}
