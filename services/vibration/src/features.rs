//! The features of a window: log spectra, and how the channels move together.

use crate::spectrum::Spectrum;
use messages::CHANNELS_MAX;
use serde::{Deserialize, Serialize};

/// Share of a band's mean power that is added to each channel before the channels are told apart.
const FLOOR: f64 = 1e-3;
/// Partial coherences are kept this far from 1.
const COHERENCE_MARGIN: f64 = 1e-3;
/// Features of a window at the most, where the number of bands is free.
const FEATURES_MAX: usize = 700;
/// Bands of each channel at the most, where their number is free.
const BANDS_MAX: usize = 25;

/// What is computed of each band of frequencies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// log10 of each channel's PSD.
    Power,
    /// Besides: log10 of each channel's PSD given the other channels, and the partial coherences of all pairs of
    /// channels, as Fisher's z in decades. They come from the inverse of the matrix of co-spectra.
    Partial,
}

/// How a window becomes numbers: kind by kind (power, power given the rest, coherence), channel by channel (or pair of
/// channels), band by band.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Features {
    /// What is computed.
    pub kind: Kind,
    /// Sine tapers of the spectrum.
    pub tapers: usize,
    /// Neighbouring frequency bins of one band; bins above the last whole band are left out.
    pub band_bins: usize,
    /// What each channel is divided by: its usual standard deviation.
    pub scale: Vec<f64>,
}

impl Features {
    /// The paper's: every bin of every channel's log PSD.
    #[must_use]
    pub fn every_bin(channels: usize, tapers: usize) -> Self {
        Self {
            kind: Kind::Power,
            tapers,
            band_bins: 1,
            scale: vec![1.0; channels],
        }
    }

    /// Bands wide enough that the co-spectra of all channels can be inverted, and not too many of them.
    #[must_use]
    pub fn banded(kind: Kind, scale: Vec<f64>, window_samples: usize, tapers: usize) -> Self {
        let bins = window_samples / 2;
        let single = Self {
            kind,
            tapers,
            band_bins: bins,
            scale,
        };
        let bands = (FEATURES_MAX / single.count(window_samples).max(1)).clamp(1, BANDS_MAX);
        let widest = bins.div_ceil(bands);
        let full_rank = (3 * single.scale.len()).div_ceil(2 * tapers.max(1));
        Self {
            band_bins: widest.max(full_rank).clamp(1, bins.max(1)),
            ..single
        }
    }

    /// Bands of a window.
    #[must_use]
    pub fn bands(&self, window_samples: usize) -> usize {
        window_samples / 2 / self.band_bins.max(1)
    }

    /// Features of a window.
    #[must_use]
    pub fn count(&self, window_samples: usize) -> usize {
        let channels = self.scale.len();
        let each = match self.kind {
            Kind::Power => channels,
            Kind::Partial => 2 * channels + channels * (channels - 1) / 2,
        };
        each * self.bands(window_samples)
    }
}

/// Computes the features of windows of one length; all buffers prepared.
pub struct Extractor {
    features: Features,
    spectrum: Spectrum,
    bands: usize,
    count: usize,
}

/// A band's matrix of co-spectra.
type Matrix = [[f64; CHANNELS_MAX]; CHANNELS_MAX];

impl Extractor {
    /// For windows of `window_samples` at `rate_hz`.
    #[must_use]
    pub fn new(features: Features, window_samples: usize, rate_hz: f64) -> Self {
        Self {
            spectrum: Spectrum::new(features.scale.len(), window_samples, rate_hz, features.tapers),
            bands: features.bands(window_samples),
            count: features.count(window_samples),
            features,
        }
    }

    /// Features of a window.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Writes a window's features; `channel` gives its samples. Outputs of another length than [`Extractor::count`] are
    /// left alone.
    pub fn extract<'a>(&mut self, channel: impl Fn(usize) -> &'a [f64], out: &mut [f64]) {
        if out.len() != self.count {
            return;
        }
        let channels = self.features.scale.len();
        for index in 0..channels {
            self.spectrum.take(index, channel(index));
        }
        for band in 0..self.bands {
            match self.features.kind {
                Kind::Power => {
                    for index in 0..channels {
                        out[index * self.bands + band] = decades(self.density(index, index, band));
                    }
                }
                Kind::Partial => self.partial(band, out),
            }
        }
    }

    /// Mean level of a window: log10 of the PSD of all channels and bands.
    #[must_use]
    pub fn level(&self, features: &[f64]) -> f64 {
        let power = &features[..(self.features.scale.len() * self.bands).min(features.len())];
        power.iter().sum::<f64>() / power.len().max(1) as f64
    }

    fn density(&self, a: usize, b: usize, band: usize) -> f64 {
        let width = self.features.band_bins;
        let density = self.spectrum.density(a, b, band * width..(band + 1) * width);
        density / (self.features.scale[a] * self.features.scale[b])
    }

    fn partial(&self, band: usize, out: &mut [f64]) {
        let channels = self.features.scale.len().min(CHANNELS_MAX);
        let mut matrix: Matrix = [[0.0; CHANNELS_MAX]; CHANNELS_MAX];
        for (a, row) in matrix.iter_mut().enumerate().take(channels) {
            for (b, value) in row.iter_mut().enumerate().take(a + 1) {
                *value = self.density(a, b, band);
            }
        }
        let mean = (0..channels).map(|a| matrix[a][a]).sum::<f64>() / channels as f64;
        for (a, row) in matrix.iter_mut().enumerate().take(channels) {
            row[a] += FLOOR * mean + f64::MIN_POSITIVE;
        }
        let powers: [f64; CHANNELS_MAX] = std::array::from_fn(|a| matrix[a][a]);
        let inverse = invert(matrix, channels);
        let mut row = 0;
        let mut put = |value: f64| {
            out[row * self.bands + band] = value;
            row += 1;
        };
        powers[..channels].iter().for_each(|power| put(decades(*power)));
        (0..channels).for_each(|a| put(-decades(inverse[a][a])));
        for a in 0..channels {
            for b in a + 1..channels {
                let coherence = inverse[b][a] / (inverse[a][a] * inverse[b][b]).sqrt();
                put(fisher_decades(coherence));
            }
        }
    }
}

fn decades(value: f64) -> f64 {
    value.max(f64::MIN_POSITIVE).log10()
}

/// Fisher's z: half the ratio of (1 + r) to (1 - r), in decades.
fn fisher_decades(coherence: f64) -> f64 {
    let limit = 1.0 - COHERENCE_MARGIN;
    let r = if coherence.is_finite() {
        coherence.clamp(-limit, limit)
    } else {
        0.0
    };
    ((1.0 + r) / (1.0 - r)).log10() / 2.0
}

/// The inverse of a symmetric positive definite matrix of which the lower half is given; its lower half.
fn invert(mut matrix: Matrix, size: usize) -> Matrix {
    // Cholesky's factor L, in place.
    for a in 0..size {
        for b in 0..=a {
            let sum: f64 = (0..b).map(|k| matrix[a][k] * matrix[b][k]).sum();
            let rest = matrix[a][b] - sum;
            matrix[a][b] = if a == b {
                rest.max(f64::MIN_POSITIVE).sqrt()
            } else {
                rest / matrix[b][b]
            };
        }
    }
    // The inverse of L, in place; then its square.
    for a in 0..size {
        matrix[a][a] = 1.0 / matrix[a][a];
        for b in 0..a {
            let sum: f64 = (b..a).map(|k| matrix[a][k] * matrix[k][b]).sum();
            matrix[a][b] = -sum * matrix[a][a];
        }
    }
    let mut inverse: Matrix = [[0.0; CHANNELS_MAX]; CHANNELS_MAX];
    for a in 0..size {
        for b in 0..=a {
            inverse[a][b] = (a..size).map(|k| matrix[k][a] * matrix[k][b]).sum();
        }
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    #[test]
    fn a_matrix_times_its_inverse_is_one() {
        let factor = DMatrix::from_fn(6, 6, |a, b| ((a * 7 + b * b * 3) % 11) as f64 - 4.0);
        let symmetric = &factor * factor.transpose() + DMatrix::identity(6, 6);
        let mut matrix: Matrix = [[0.0; CHANNELS_MAX]; CHANNELS_MAX];
        for (a, row) in matrix.iter_mut().enumerate().take(6) {
            for (b, value) in row.iter_mut().enumerate().take(a + 1) {
                *value = symmetric[(a, b)];
            }
        }
        let lower = invert(matrix, 6);
        let inverse = DMatrix::from_fn(6, 6, |a, b| lower[a.max(b)][a.min(b)]);
        assert!((symmetric * inverse - DMatrix::identity(6, 6)).abs().max() < 1e-9);
    }

    #[test]
    fn channels_that_have_nothing_in_common_have_no_coherence_and_a_copy_has() {
        let noise = |seed: u64| -> Vec<f64> {
            let mut state = seed;
            let mut next = || {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
            };
            (0..4000).map(|_| next()).collect()
        };
        let (first, second) = (noise(1), noise(2));
        let mixed: Vec<f64> = first.iter().zip(&second).map(|(a, b)| a + b).collect();
        let features = Features {
            kind: Kind::Partial,
            tapers: 5,
            band_bins: 2000,
            scale: vec![1.0; 2],
        };
        let mut extractor = Extractor::new(features, 4000, 100.0);
        let mut out = [0.0; 5];
        extractor.extract(|channel| if channel == 0 { &first } else { &second }, &mut out);
        assert!(out[4].abs() < 0.02 && (out[0] - out[2]).abs() < 0.01, "{out:?}");
        // The sum of two equal noises: squared coherence 1/2, power given the other one half of its own.
        extractor.extract(|channel| if channel == 0 { &first } else { &mixed }, &mut out);
        assert!((out[4].abs() - fisher_decades(0.5_f64.sqrt())).abs() < 0.02, "{out:?}");
        assert!((out[0] - out[2] - 2.0_f64.log10()).abs() < 0.02, "{out:?}");
    }

    #[test]
    fn bands_fit_any_rate_window_and_number_of_channels() {
        for channels in 1..=CHANNELS_MAX {
            for samples in [4, 25, 50, 100, 200, 5000, 44100] {
                for kind in [Kind::Power, Kind::Partial] {
                    let features = Features::banded(kind, vec![1.0; channels], samples, 5);
                    assert!(features.bands(samples) >= 1 && features.bands(samples) <= BANDS_MAX);
                    assert!(features.count(samples) <= FEATURES_MAX);
                    assert!(kind == Kind::Power || samples < 10 || features.band_bins * 5 >= channels);
                }
            }
        }
    }
}
