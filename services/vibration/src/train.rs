//! Training: labelled windows in, a model out. The same windows give the same bytes.

use crate::discriminant::{Discriminant, PairFit, fit_pair};
use crate::model::{FORMAT, Method, Model, class_pairs};
use nalgebra::DMatrix;

/// What training is told about the windows.
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
    /// Sine tapers of the spectrum.
    pub tapers: usize,
    /// A window whose mean speed is lower stands still.
    pub still_m_s: f64,
    /// Principal components kept.
    pub components: usize,
}

/// Trains the paper's classifier on `features` (one row a window); `classes` holds each window's index into the labels.
///
/// # Errors
/// Says which pair of classes cannot be trained, and why.
pub fn train(setup: &Setup, features: &DMatrix<f64>, classes: &[usize]) -> Result<Model, String> {
    if classes.len() != features.nrows() {
        return Err(format!("{} windows have {} classes", features.nrows(), classes.len()));
    }
    let by_class: Vec<DMatrix<f64>> = (0..setup.labels.len())
        .map(|class| {
            let rows: Vec<usize> = (0..classes.len()).filter(|row| classes[*row] == class).collect();
            features.select_rows(&rows)
        })
        .collect();
    let mut pairs = Vec::new();
    for (a, b) in class_pairs(setup.labels.len()) {
        let fit = fit_pair(&by_class[a], &by_class[b], setup.components)
            .map_err(|why| format!("{} and {}: {why}", setup.labels[a], setup.labels[b]))?;
        pairs.push(rounded(fit));
    }
    let model = Model {
        format: FORMAT.into(),
        method: Method::Paper,
        labels: setup.labels.clone(),
        channels: setup.channels.clone(),
        rate_hz: setup.rate_hz,
        window_samples: setup.window_samples,
        tapers: setup.tapers,
        still_m_s: setup.still_m_s,
        pairs,
    };
    model.validate()?;
    Ok(model)
}

/// The discriminant with 9 digits a number: a small file, and equal bytes from processors that round the last bit
/// differently.
fn rounded(fit: PairFit) -> Discriminant {
    let pair = fit.discriminant;
    Discriminant {
        class_mean: pair.class_mean.map(nine_digits),
        class_sigma: pair.class_sigma.map(nine_digits),
        offset: nine_digits(pair.offset),
        weights: pair.weights.into_iter().map(nine_digits).collect(),
    }
}

fn nine_digits(value: f64) -> f64 {
    format!("{value:.8e}").parse().unwrap_or(value)
}
