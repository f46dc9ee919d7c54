//! Pieces of vibration collected into windows: gaps, jitter, missing values and faults of the sensor.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Missing share of a channel up to which a window is repaired.
const MISSING_MAX: f64 = 0.05;
/// Share of a window's samples at the end of the scale from which a channel may be saturated ...
const SATURATED_SHARE: f64 = 0.04;
/// ... where they are this many times the samples at the next value: a sensor of coarse resolution repeats values too.
const SATURATED_RATIO: f64 = 3.0;
/// Periods that a sample may come late before one counts as missing.
const LATE_MAX: f64 = 0.75;
/// Periods that a sample may come early before it counts as one too many.
const EARLY_MAX: f64 = 1.5;
/// How fast the expected instants follow the measured ones.
const PHASE_GAIN: f64 = 0.1;

/// What can be said of a collected window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// Complete, or repaired where a few samples were missing.
    Good,
    /// More is missing than can be repaired.
    Incomplete,
    /// More samples came than fit the rate.
    WrongRate,
    /// A channel does not change, or stays at the end of its scale.
    Faulty,
}

impl Quality {
    /// What such windows are or have, as words that follow their number.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Good => "are good",
            Self::Incomplete => "miss too many samples",
            Self::WrongRate => "hold more samples than the rate allows",
            Self::Faulty => "have a dead or saturated channel",
        }
    }
}

/// Collects equally spaced samples of several channels.
pub struct Collector {
    period_ns: f64,
    length: usize,
    /// Channel by channel, `length` values each; NaN where missing.
    values: Vec<f64>,
    filled: usize,
    surplus: usize,
    start_ns: u64,
    last_ns: Option<u64>,
    /// From the last sample's instant to where the next one is expected.
    ahead_ns: f64,
}

impl Collector {
    /// For windows of `length` samples of `channels` channels, one each `period_ns`.
    #[must_use]
    pub fn new(channels: usize, length: usize, period_ns: f64) -> Self {
        Self {
            period_ns,
            length,
            values: vec![f64::NAN; channels * length],
            filled: 0,
            surplus: 0,
            start_ns: 0,
            last_ns: None,
            ahead_ns: period_ns,
        }
    }

    /// Forgets what has been collected.
    pub fn clear(&mut self) {
        self.filled = 0;
        self.surplus = 0;
        self.last_ns = None;
    }

    /// How many places the sample taken at `taken_ns` needs: 1, and 1 more for each one missing before it; 0 where it
    /// comes too early to be one of its own. Starts a new window after a gap too long to repair, or where time runs
    /// backwards. Samples of one batch may carry the same instant.
    pub fn advance(&mut self, taken_ns: u64) -> usize {
        let Some(last_ns) = self.last_ns.replace(taken_ns) else {
            self.ahead_ns = self.period_ns;
            return 1;
        };
        let step_ns = taken_ns as f64 - last_ns as f64;
        if step_ns == 0.0 {
            self.ahead_ns += self.period_ns;
            return 1;
        }
        let late_ns = step_ns - self.ahead_ns;
        let skipped = (late_ns / self.period_ns - LATE_MAX).ceil().max(0.0);
        if step_ns < 0.0 || skipped > MISSING_MAX * self.length as f64 {
            self.clear();
            self.last_ns = Some(taken_ns);
            self.ahead_ns = self.period_ns;
            return 1;
        }
        if late_ns < -EARLY_MAX * self.period_ns {
            self.surplus += 1;
            self.ahead_ns -= step_ns;
            return 0;
        }
        let residual_ns = late_ns - skipped * self.period_ns;
        self.ahead_ns = self.period_ns - (1.0 - PHASE_GAIN) * residual_ns;
        skipped as usize + 1
    }

    /// Puts one instant's values, one a channel, in the next place; true when the window is then full.
    pub fn place(&mut self, taken_ns: u64, value: impl Fn(usize) -> f64) -> bool {
        if self.filled >= self.length {
            self.filled = 0;
            self.surplus = 0;
        }
        if self.filled == 0 {
            self.start_ns = taken_ns;
        }
        for (channel, values) in self.values.chunks_exact_mut(self.length).enumerate() {
            values[self.filled] = value(channel);
        }
        self.filled += 1;
        self.filled == self.length
    }

    /// Sensor instant of the window's first sample.
    #[must_use]
    pub fn start_ns(&self) -> u64 {
        self.start_ns
    }

    /// One channel of the full window; empty where there is no such channel.
    #[must_use]
    pub fn channel(&self, index: usize) -> &[f64] {
        self.values.chunks_exact(self.length).nth(index).unwrap_or(&[])
    }

    /// Fills the missing values of the first `channels` channels of the full window and says what it is worth.
    pub fn repair(&mut self, channels: usize) -> Quality {
        let allowed = MISSING_MAX * self.length as f64;
        if self.surplus as f64 > allowed {
            return Quality::WrongRate;
        }
        let mut quality = Quality::Good;
        for values in self.values.chunks_exact_mut(self.length).take(channels) {
            let missing = values.iter().filter(|value| !value.is_finite()).count();
            if missing as f64 > allowed {
                return Quality::Incomplete;
            }
            interpolate(values);
            if is_faulty(values) {
                quality = Quality::Faulty;
            }
        }
        quality
    }
}

/// Where a collector stands, as plain bytes; its values follow.
#[derive(FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct Progress {
    filled: u64,
    surplus: u64,
    start_ns: u64,
    last_ns: u64,
    has_last: u64,
    ahead_ns: f64,
}

impl Collector {
    pub(crate) fn progress(&self) -> (Progress, &[f64]) {
        let progress = Progress {
            filled: self.filled as u64,
            surplus: self.surplus as u64,
            start_ns: self.start_ns,
            last_ns: self.last_ns.unwrap_or(0),
            has_last: u64::from(self.last_ns.is_some()),
            ahead_ns: self.ahead_ns,
        };
        (progress, &self.values)
    }

    /// # Errors
    /// Why this can be no progress.
    pub(crate) fn set(&mut self, progress: &Progress, values: &[f64]) -> Result<(), &'static str> {
        let filled = usize::try_from(progress.filled).unwrap_or(usize::MAX);
        let surplus = usize::try_from(progress.surplus).unwrap_or(usize::MAX);
        if filled > self.length || surplus > self.length || !progress.ahead_ns.is_finite() {
            return Err("holds counts that cannot be");
        }
        if values.len() != self.values.len() {
            return Err("is of another length");
        }
        self.values.copy_from_slice(values);
        (self.filled, self.surplus, self.start_ns) = (filled, surplus, progress.start_ns);
        self.last_ns = (progress.has_last != 0).then_some(progress.last_ns);
        self.ahead_ns = progress.ahead_ns;
        Ok(())
    }
}

/// Replaces what is not finite by the line between its neighbours; at the ends, by the nearest value.
pub fn interpolate(values: &mut [f64]) {
    let mut known: Option<usize> = None;
    for index in 0..values.len() {
        if !values[index].is_finite() {
            continue;
        }
        let from = known.map_or(0, |before| before + 1);
        let left = known.map_or(values[index], |before| values[before]);
        let steps = (index + 1 - from) as f64;
        for gap in from..index {
            values[gap] = left + (values[index] - left) * (gap + 1 - from) as f64 / steps;
        }
        known = Some(index);
    }
    if let Some(last) = known {
        let value = values[last];
        values[last + 1..].fill(value);
    }
}

/// True where a channel is dead, or sits at an end of its scale for more than chance allows.
#[must_use]
pub fn is_faulty(values: &[f64]) -> bool {
    let constant = values.iter().all(|value| *value == values[0]);
    constant || is_clipped(values, 1.0) || is_clipped(values, -1.0)
}

/// True where the highest value stands often, and far more often than the one below it; the lowest where `sign` is -1.
fn is_clipped(values: &[f64], sign: f64) -> bool {
    let signed = || values.iter().map(|value| sign * value);
    let highest = |below: f64| {
        signed()
            .filter(|value| *value < below)
            .fold(f64::NEG_INFINITY, f64::max)
    };
    let times = |wanted: f64| signed().filter(|value| *value == wanted).count() as f64;
    let top = highest(f64::INFINITY);
    let at_top = times(top);
    at_top > (SATURATED_SHARE * values.len() as f64).max(3.0) && at_top > SATURATED_RATIO * times(highest(top))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clipped_channel_is_faulty_and_a_coarse_one_is_not() {
        let wave: Vec<f64> = (0..100)
            .map(|i| (f64::from(i) * 0.37).sin() + (f64::from(i) * 1.1).cos())
            .collect();
        assert!(!is_faulty(&wave));
        let clipped: Vec<f64> = wave.iter().map(|x| x.clamp(-1.2, 1.2)).collect();
        assert!(is_faulty(&clipped));
        let coarse: Vec<f64> = wave.iter().map(|x| x.round()).collect();
        assert!(!is_faulty(&coarse));
        assert!(is_faulty(&[0.5; 100]) && is_faulty(&[]));
    }

    #[test]
    fn missing_values_lie_on_the_line_between_their_neighbours() {
        let mut values = [f64::NAN, 1.0, f64::NAN, f64::NAN, 4.0, f64::INFINITY];
        interpolate(&mut values);
        assert_eq!(values, [1.0, 1.0, 2.0, 3.0, 4.0, 4.0]);
    }

    #[test]
    fn a_missing_sample_leaves_its_place_empty() {
        let mut collector = Collector::new(1, 40, 10.0);
        let places = [100, 110, 130, 139, 151, 160, 181].map(|t| collector.advance(t));
        assert_eq!(places, [1, 1, 2, 1, 1, 1, 2]);
    }

    #[test]
    fn rounded_instants_and_batches_are_taken_as_they_come() {
        let mut collector = Collector::new(1, 40, 7.8125);
        assert!((0..1000_u64).all(|k| collector.advance((k as f64 * 0.78125).round() as u64 * 10) == 1));
        let mut collector = Collector::new(1, 40, 10.0);
        assert!((0..1000_u64).all(|k| collector.advance(k / 10 * 100) == 1));
    }

    #[test]
    fn of_twice_as_many_samples_many_are_too_many() {
        let mut collector = Collector::new(1, 40, 10.0);
        let taken: usize = (0..1000_u64).map(|k| collector.advance(k * 5)).sum();
        assert!((500..700).contains(&taken), "{taken}");
    }
}
