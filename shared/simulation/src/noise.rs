//! Randomness without a state: the same (seed, stream, index) always gives the same number.

/// What a random number is for: numbers of different streams have nothing to do with each other.
#[derive(Clone, Copy, Debug)]
#[repr(u64)]
pub(crate) enum Stream {
    Load = 1,
    Torque,
    Angular,
    Linear,
    VibrationPhase,
    VibrationLevel,
    VibrationFloor,
}

/// Uniform in 0..1, never 0.
pub(crate) fn uniform(seed: u64, stream: Stream, index: u64) -> f64 {
    let bits = hash(hash(seed ^ (stream as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)) ^ index);
    ((bits >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
}

/// Normal, of mean 0 and variance 1 (Box and Muller).
pub(crate) fn normal(seed: u64, stream: Stream, index: u64) -> f64 {
    let radius = (-2.0 * uniform(seed, stream, index.wrapping_mul(2)).ln()).sqrt();
    let turn = uniform(seed, stream, index.wrapping_mul(2).wrapping_add(1));
    radius * (std::f64::consts::TAU * turn).cos()
}

/// The finalizer of `SplitMix64` (Steele, Lea, Flood 2014): every bit of the input reaches every bit of the output.
pub(crate) fn hash(value: u64) -> u64 {
    let value = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let value = (value ^ value >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ value >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ value >> 31
}

/// A sequence of random numbers, where one depends on how many were drawn before.
#[derive(Clone, Debug)]
pub(crate) struct Dice(u64);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self(hash(seed))
    }

    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        hash(self.0)
    }

    /// Uniform in 0..1.
    pub(crate) fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(crate) fn range(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.unit()
    }

    /// Uniform in -most..most.
    pub(crate) fn sym(&mut self, most: f64) -> f64 {
        self.range(-most, most)
    }

    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// Normal, of mean 0 and variance 1.
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}

/// Random values at whole coordinates, smoothly joined: -1 to 1.
pub(crate) fn value_noise(seed: u64, x: f64, y: f64) -> f64 {
    let corner = |i: f64, j: f64| {
        let place = (i as i64 as u64).wrapping_mul(0x8da6_b343) ^ (j as i64 as u64).wrapping_mul(0xd816_3841_0000_0001);
        (hash(seed ^ place) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    };
    let ease = |part: f64| part * part * (3.0 - 2.0 * part);
    let (i, j) = (x.floor(), y.floor());
    let (u, v) = (ease(x - i), ease(y - j));
    let row = |j: f64| corner(i, j) * (1.0 - u) + corner(i + 1.0, j) * u;
    row(j) * (1.0 - v) + row(j + 1.0) * v
}

/// Octaves of value noise, each at about twice the frequency and `gain` times the height of the one before.
pub(crate) fn fractal(seed: u64, x: f64, y: f64, octaves: u32, gain: f64) -> f64 {
    let (mut sum, mut height, mut frequency) = (0.0, 1.0, 1.0);
    for octave in 0..octaves {
        sum += height
            * value_noise(
                seed.wrapping_add(u64::from(octave) * 7919),
                x * frequency,
                y * frequency,
            );
        height *= gain;
        frequency *= 2.03;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_mean_0_and_variance_1() {
        let count = 100_000;
        let numbers: Vec<f64> = (0..count).map(|index| normal(7, Stream::Load, index)).collect();
        let mean = numbers.iter().sum::<f64>() / count as f64;
        let variance = numbers.iter().map(|number| number * number).sum::<f64>() / count as f64;
        // Four standard errors of each.
        assert!(
            mean.abs() < 0.013 && (variance - 1.0).abs() < 0.018,
            "{mean} {variance}"
        );
    }

    #[test]
    fn neighbouring_numbers_and_streams_are_not_correlated() {
        let count = 100_000;
        let product =
            |a: fn(u64) -> f64, b: fn(u64) -> f64| (0..count).map(|i| a(i) * b(i)).sum::<f64>() / count as f64;
        assert!(product(|i| normal(7, Stream::Load, i), |i| normal(7, Stream::Load, i + 1)).abs() < 0.013);
        assert!(product(|i| normal(7, Stream::Load, i), |i| normal(7, Stream::Torque, i)).abs() < 0.013);
        assert!(product(|i| normal(7, Stream::Load, i), |i| normal(8, Stream::Load, i)).abs() < 0.013);
    }
}
