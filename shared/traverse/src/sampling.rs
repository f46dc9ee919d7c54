//! The period at which a recording was sampled, from its instants.

/// The channels of a sound file that names none: the accelerations, then the angular rates.
pub const SOUND_CHANNELS: [&str; 6] = [
    "acceleration_x_m_s2",
    "acceleration_y_m_s2",
    "acceleration_z_m_s2",
    "angular_rate_x_rad_s",
    "angular_rate_y_rad_s",
    "angular_rate_z_rad_s",
];
/// A step longer than this, in medians, is a pause.
const PAUSE: u64 = 3;
/// A step up to this, in medians, is one sample long.
const SINGLE: f64 = 1.5;
/// Rounded instants stay near those of an even clock; if they stray farther than this, in medians, samples are missing.
const STRAY_MAX: f64 = 3.0;

/// The sampling period [ns]: the mean step, without the pauses. Rounded or repeated instants do not change it, nor do missing
/// samples. `None` where no two instants differ.
#[must_use]
pub fn sampling_period_ns(taken_ns: &[u64]) -> Option<f64> {
    let steps = || taken_ns.windows(2).map(|pair| pair[1].saturating_sub(pair[0]));
    let mut positive: Vec<u64> = steps().filter(|step| *step > 0).collect();
    positive.sort_unstable();
    let median = *positive.get(positive.len() / 2)?;
    let is_regular = |step: &u64| *step <= median.saturating_mul(PAUSE);
    let mean_ns = mean(steps().filter(is_regular))?;
    let has_repeated = positive.len() + 1 < taken_ns.len();
    if has_repeated || stray_ns(steps().filter(is_regular), mean_ns) <= STRAY_MAX * median as f64 {
        return Some(mean_ns);
    }
    mean(steps().filter(|step| *step as f64 <= SINGLE * median as f64))
}

fn mean(steps: impl Iterator<Item = u64>) -> Option<f64> {
    let (sum, count) = steps.fold((0.0, 0_u64), |(sum, count), step| (sum + step as f64, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// How far the instants stray from those of an even clock.
fn stray_ns(steps: impl Iterator<Item = u64>, mean_ns: f64) -> f64 {
    let (mut sum, mut low, mut high) = (0.0_f64, 0.0_f64, 0.0_f64);
    for step in steps {
        sum += step as f64 - mean_ns;
        (low, high) = (low.min(sum), high.max(sum));
    }
    high - low
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_rate(instants_s: impl Iterator<Item = f64>, expected_hz: f64) {
        let taken_ns: Vec<u64> = instants_s.map(|instant_s| (instant_s * 1e9).round() as u64).collect();
        let found_hz = 1e9 / sampling_period_ns(&taken_ns).unwrap();
        assert!(
            (found_hz / expected_hz - 1.0).abs() < 0.005,
            "{found_hz} instead of {expected_hz}"
        );
    }

    /// An even spread over 0 … 1 that never repeats: multiples of the golden ratio.
    fn chance(index: u32) -> f64 {
        (f64::from(index * index % 7919) * 0.618_033_988_75).fract()
    }

    #[test]
    fn samples_that_are_missing_do_not_slow_the_clock() {
        for share in [0.0, 0.03, 0.2] {
            let kept = (0..6000).filter(|index| chance(*index) >= share);
            assert_rate(kept.map(|index| f64::from(index) / 100.0), 100.0);
        }
    }

    #[test]
    fn rounded_instants_do_not_change_the_rate() {
        for rate_hz in [50.0, 62.5, 80.0, 97.0, 128.0] {
            let rounded = (0..3000).map(|index| (f64::from(index) / rate_hz * 100.0).round() / 100.0);
            assert_rate(rounded, rate_hz);
        }
    }

    #[test]
    fn samples_that_come_in_batches_and_pauses_do_not_change_the_rate() {
        let batches = (0..4000).map(|index| f64::from(index / 10) * 0.1);
        assert_rate(batches, 100.0);
        let paused = (0..4000).map(|index| f64::from(index) / 100.0 + if index > 2000 { 60.0 } else { 0.0 });
        assert_rate(paused, 100.0);
    }

    #[test]
    fn without_two_instants_there_is_no_period() {
        assert_eq!(sampling_period_ns(&[]), None);
        assert_eq!(sampling_period_ns(&[5, 5, 5]), None);
    }
}
