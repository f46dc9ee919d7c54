//! Power and co-spectral densities of a window by sine multitaper.

use realfft::num_complex::Complex;
use realfft::{RealFftPlanner, RealToComplex};
use std::f64::consts::PI;
use std::ops::Range;
use std::sync::Arc;

/// Spectra of windows of one length, channel by channel; all buffers prepared.
pub struct Spectrum {
    /// Taper by taper, one value a sample, unit energy.
    tapers: Vec<f64>,
    taper_count: usize,
    /// From a product of two transforms to a density.
    scale: f64,
    /// Channel by channel, bin by bin, taper by taper: the transforms.
    transforms: Vec<Complex<f64>>,
    detrended: Vec<f64>,
    fft: Arc<dyn RealToComplex<f64>>,
    input: Vec<f64>,
    output: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
}

impl Spectrum {
    /// For windows of `samples` of `channels` channels at `rate_hz`, averaged over `tapers` sine tapers.
    #[must_use]
    pub fn new(channels: usize, samples: usize, rate_hz: f64, tapers: usize) -> Self {
        let fft = RealFftPlanner::new().plan_fft_forward(samples);
        Self {
            tapers: (1..=tapers).flat_map(|order| sine_taper(samples, order)).collect(),
            taper_count: tapers,
            scale: 1.0 / (tapers as f64 * rate_hz),
            transforms: vec![Complex::default(); channels * (samples / 2) * tapers],
            detrended: vec![0.0; samples],
            input: fft.make_input_vec(),
            output: fft.make_output_vec(),
            scratch: fft.make_scratch_vec(),
            fft,
        }
    }

    /// Frequency bins of one channel: 1 to half the window's samples; bin 0 goes with the trend.
    #[must_use]
    pub fn bins(&self) -> usize {
        self.detrended.len() / 2
    }

    /// Takes in one channel of a window. Windows of another length than the prepared one are left alone.
    pub fn take(&mut self, channel: usize, window: &[f64]) {
        let (samples, tapers) = (self.detrended.len(), self.taper_count);
        let size = self.bins() * tapers;
        if window.len() != samples || (channel + 1) * size > self.transforms.len() {
            return;
        }
        detrend(window, &mut self.detrended);
        let transforms = &mut self.transforms[channel * size..(channel + 1) * size];
        for (index, taper) in self.tapers.chunks_exact(samples).enumerate() {
            for ((input, sample), weight) in self.input.iter_mut().zip(&self.detrended).zip(taper) {
                *input = sample * weight;
            }
            // Fails only for buffers of a wrong length, which were made by the same plan.
            let _ = self
                .fft
                .process_with_scratch(&mut self.input, &mut self.output, &mut self.scratch);
            for (bin, value) in transforms.chunks_exact_mut(tapers).zip(&self.output[1..]) {
                bin[index] = *value;
            }
        }
    }

    /// Mean over some bins (0 is the first above the trend) of the co-spectral density of two channels that were taken
    /// in, in the product of their units per hertz; of a channel with itself, its power spectral density.
    #[must_use]
    pub fn density(&self, a: usize, b: usize, bins: Range<usize>) -> f64 {
        let size = self.bins() * self.taper_count;
        let part = |channel: usize| {
            let start = channel * size;
            &self.transforms[start + bins.start * self.taper_count..start + bins.end * self.taper_count]
        };
        let sum: f64 = part(a)
            .iter()
            .zip(part(b))
            .map(|(x, y)| x.re * y.re + x.im * y.im)
            .sum();
        sum * self.scale / bins.len() as f64
    }
}

/// Riedel and Sidorenko's minimum-bias taper of one order, unit energy.
fn sine_taper(samples: usize, order: usize) -> impl Iterator<Item = f64> {
    let length = (samples + 1) as f64;
    (1..=samples).map(move |index| (2.0 / length).sqrt() * (PI * order as f64 * index as f64 / length).sin())
}

/// Takes the least-squares line out of `window`.
fn detrend(window: &[f64], detrended: &mut [f64]) {
    let count = window.len() as f64;
    let centre = (count - 1.0) / 2.0;
    let mean = window.iter().sum::<f64>() / count;
    let moment: f64 = window.iter().enumerate().map(|(i, x)| (i as f64 - centre) * x).sum();
    let spread: f64 = (0..window.len()).map(|i| (i as f64 - centre).powi(2)).sum();
    let slope = if spread > 0.0 { moment / spread } else { 0.0 };
    for (index, (out, sample)) in detrended.iter_mut().zip(window).enumerate() {
        *out = sample - mean - slope * (index as f64 - centre);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(samples: usize, step: usize) -> Vec<f64> {
        (0..samples)
            .map(|i| (i as f64 * 0.7).sin() + ((i * i * step) % 17) as f64)
            .collect()
    }

    /// The definition, term by term.
    fn slow_density(windows: [&[f64]; 2], rate_hz: f64, tapers: usize, bin: usize) -> f64 {
        let mut density = 0.0;
        for order in 1..=tapers {
            let transforms = windows.map(|window| {
                let mut detrended = window.to_vec();
                detrend(window, &mut detrended);
                let mut sum = Complex::new(0.0, 0.0);
                for (index, (x, w)) in detrended.iter().zip(sine_taper(window.len(), order)).enumerate() {
                    let phase = 2.0 * PI * (bin * index) as f64 / window.len() as f64;
                    sum += x * w * Complex::new(phase.cos(), -phase.sin());
                }
                sum
            });
            density += (transforms[0] * transforms[1].conj()).re / rate_hz / tapers as f64;
        }
        density
    }

    #[test]
    fn a_density_is_the_slow_sum_of_its_definition() {
        for samples in [25, 64, 100] {
            let windows = [wave(samples, 1), wave(samples, 3)];
            let mut spectrum = Spectrum::new(2, samples, 50.0, 5);
            spectrum.take(0, &windows[0]);
            spectrum.take(1, &windows[1]);
            for bin in 0..samples / 2 {
                for (a, b) in [(0, 0), (1, 1), (0, 1)] {
                    let expected = slow_density([&windows[a], &windows[b]], 50.0, 5, bin + 1);
                    let found = spectrum.density(a, b, bin..bin + 1);
                    assert!((found - expected).abs() < 1e-10 * (1.0 + expected.abs()));
                }
            }
            let mean = (spectrum.density(0, 1, 2..3) + spectrum.density(0, 1, 3..4)) / 2.0;
            assert!((spectrum.density(0, 1, 2..4) - mean).abs() < 1e-12);
        }
    }

    #[test]
    fn a_line_leaves_nothing() {
        let window: Vec<f64> = (0..50).map(|i| 3.0 - 0.25 * f64::from(i)).collect();
        let mut detrended = vec![1.0; 50];
        detrend(&window, &mut detrended);
        assert!(detrended.iter().all(|x| x.abs() < 1e-12));
    }

    #[test]
    fn tapers_are_orthonormal() {
        for (a, b) in [(1, 1), (1, 2), (3, 3), (2, 5)] {
            let dot: f64 = sine_taper(40, a).zip(sine_taper(40, b)).map(|(x, y)| x * y).sum();
            assert!((dot - f64::from(u8::from(a == b))).abs() < 1e-12);
        }
    }
}
