//! Log power spectral density of a window by sine multitaper.

use realfft::{RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex;
use std::f64::consts::PI;
use std::sync::Arc;

/// One-sided log PSD of windows of one length; all buffers prepared.
pub struct Spectrum {
    /// Taper by taper, one value a sample, unit energy.
    tapers: Vec<f64>,
    rate_hz: f64,
    detrended: Vec<f64>,
    power: Vec<f64>,
    fft: Arc<dyn RealToComplex<f64>>,
    input: Vec<f64>,
    output: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
}

impl Spectrum {
    /// For windows of `samples` at `rate_hz`, averaged over `tapers` sine tapers.
    #[must_use]
    pub fn new(samples: usize, rate_hz: f64, tapers: usize) -> Self {
        let fft = RealFftPlanner::new().plan_fft_forward(samples);
        Self {
            tapers: (1..=tapers).flat_map(|order| sine_taper(samples, order)).collect(),
            rate_hz,
            detrended: vec![0.0; samples],
            power: vec![0.0; samples / 2],
            input: fft.make_input_vec(),
            output: fft.make_output_vec(),
            scratch: fft.make_scratch_vec(),
            fft,
        }
    }

    /// Frequency bins of one channel: 1 to half the window's samples; bin 0 goes with the trend.
    #[must_use]
    pub fn bins(&self) -> usize {
        self.power.len()
    }

    /// Writes log10 of the PSD [unit²/Hz] of one channel's window into `log_psd`, one value a bin.
    /// Windows or outputs of another length than the prepared one are left alone.
    pub fn log_psd(&mut self, window: &[f64], log_psd: &mut [f64]) {
        if window.len() != self.detrended.len() || log_psd.len() != self.power.len() {
            return;
        }
        detrend(window, &mut self.detrended);
        self.power.fill(0.0);
        for taper in self.tapers.chunks_exact(window.len()) {
            for ((input, sample), weight) in self.input.iter_mut().zip(&self.detrended).zip(taper) {
                *input = sample * weight;
            }
            // Fails only for buffers of a wrong length, which were made by the same plan.
            let _ = self
                .fft
                .process_with_scratch(&mut self.input, &mut self.output, &mut self.scratch);
            for (power, bin) in self.power.iter_mut().zip(&self.output[1..]) {
                *power += bin.norm_sqr();
            }
        }
        let tapers = (self.tapers.len() / window.len()) as f64;
        for (log, power) in log_psd.iter_mut().zip(&self.power) {
            *log = (power / tapers / self.rate_hz).max(f64::MIN_POSITIVE).log10();
        }
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

    /// The definition, term by term.
    fn slow_log_psd(window: &[f64], rate_hz: f64, tapers: usize, bin: usize) -> f64 {
        let mut detrended = window.to_vec();
        detrend(window, &mut detrended);
        let mut power = 0.0;
        for order in 1..=tapers {
            let (mut re, mut im) = (0.0, 0.0);
            for (index, (x, w)) in detrended.iter().zip(sine_taper(window.len(), order)).enumerate() {
                let phase = 2.0 * PI * (bin * index) as f64 / window.len() as f64;
                re += x * w * phase.cos();
                im -= x * w * phase.sin();
            }
            power += (re * re + im * im) / rate_hz / tapers as f64;
        }
        power.log10()
    }

    #[test]
    fn the_spectrum_is_the_slow_sum_of_its_definition() {
        for samples in [25, 64, 100] {
            let window: Vec<f64> = (0..samples)
                .map(|i| (i as f64 * 0.7).sin() + ((i * i) % 17) as f64)
                .collect();
            let mut spectrum = Spectrum::new(samples, 50.0, 5);
            let mut log_psd = vec![0.0; samples / 2];
            spectrum.log_psd(&window, &mut log_psd);
            for (index, value) in log_psd.iter().enumerate() {
                assert!((value - slow_log_psd(&window, 50.0, 5, index + 1)).abs() < 1e-10);
            }
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
