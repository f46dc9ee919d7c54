//! Where a side's interface is, as a probability over the height at which it meets the outer circle.

use crate::contrast::{Contrast, TILTS};
use crate::interface::Interface;
use crate::rows::ROWS;
use crate::weights::Weights;

/// Bins of the height, from the wheel's centre to its lowest point.
pub const BINS: usize = 320;
/// Bins on either side of an answer that are the same answer: 0.0225 outer radii.
const NEAR: usize = 7;
/// Scores this far below the best have no probability.
const SCORE_SPAN: f32 = 20.0;

/// Bins that the two sides are compared by.
const GROUP: usize = 4;
const GROUPS: usize = BINS / GROUP;
/// Standard deviation of the difference of the two sides' heights, in outer radii.
const LEVEL: f32 = 0.1;
/// What the greatest difference costs, in the logarithm of the probability: there are steep grounds.
const LEVEL_COST_MAX: f32 = 4.0;

/// Probability of each bin.
#[derive(Clone, Debug, PartialEq)]
pub struct Posterior {
    /// Sums up to 1, or is 0 everywhere where no line is a candidate.
    pub mass: [f32; BINS],
}

impl Posterior {
    /// The softmax of the scores over all lines, summed up by the height at which they meet the circle.
    #[must_use]
    pub fn new(contrast: &Contrast, weights: &Weights) -> Self {
        let mut mass = [0.0; BINS];
        let mut scores = [[f32::NEG_INFINITY; ROWS]; TILTS.len()];
        let mut best = f32::NEG_INFINITY;
        for (tilt, scores) in scores.iter_mut().enumerate() {
            let mut sums = [0.0; ROWS];
            for (feature, weight) in contrast.features[tilt].iter().zip(weights.features) {
                for (sum, value) in sums.iter_mut().zip(feature) {
                    *sum += weight * value;
                }
            }
            for ((score, sum), known) in scores.iter_mut().zip(sums).zip(contrast.known[tilt]) {
                if known {
                    *score = sum;
                    best = best.max(sum);
                }
            }
        }
        let mut total = 0.0;
        for (score, height) in scores.as_flattened().iter().zip(contrast.heights.as_flattened()) {
            let below = score - best;
            if below > -SCORE_SPAN {
                let probability = below.exp();
                mass[((height * BINS as f32) as usize).min(BINS - 1)] += probability;
                total += probability;
            }
        }
        if total > 0.0 {
            for bin in &mut mass {
                *bin /= total;
            }
        }
        Self { mass }
    }

    /// What either side says of the other: soil lies about level, so that its heights differ by [`LEVEL`].
    pub fn couple(sides: &mut [Self; 2]) {
        let coarse = sides.each_ref().map(|side| {
            let mut groups = [0.0; GROUPS];
            for (bin, mass) in side.mass.iter().enumerate() {
                groups[bin / GROUP] += mass;
            }
            groups
        });
        let likelihood: [f32; GROUPS] = std::array::from_fn(|apart| {
            let apart = (apart * GROUP) as f32 / BINS as f32 / LEVEL;
            (-(0.5 * apart * apart).min(LEVEL_COST_MAX)).exp()
        });
        for (side, other) in sides.iter_mut().zip([coarse[1], coarse[0]]) {
            let mut total = 0.0;
            for (group, masses) in side.mass.chunks_exact_mut(GROUP).enumerate() {
                let message: f32 = other
                    .iter()
                    .enumerate()
                    .map(|(k, mass)| mass * likelihood[k.abs_diff(group)])
                    .sum();
                for mass in masses {
                    *mass *= message;
                    total += *mass;
                }
            }
            if total > 0.0 {
                for mass in &mut side.mass {
                    *mass /= total;
                }
            }
        }
    }

    /// The window of the largest probability: its mean, its mass as the confidence, and a sigma that covers the rest.
    #[must_use]
    pub fn interface(&self, weights: &Weights) -> Option<Interface> {
        let window = |middle: usize| &self.mass[middle.saturating_sub(NEAR)..(middle + NEAR + 1).min(BINS)];
        let inside = |middle: usize| window(middle).iter().sum::<f32>();
        let mean = |middle: usize| {
            let first = middle.saturating_sub(NEAR);
            let sum: f32 = window(middle)
                .iter()
                .enumerate()
                .map(|(k, mass)| mass * ((first + k) as f32 + 0.5))
                .sum();
            sum / inside(middle) / BINS as f32
        };
        let mut best = (0, 0.0);
        for middle in 0..BINS {
            let mass = inside(middle);
            if mass > best.1 {
                best = (middle, mass);
            }
        }
        if best.1 <= 0.0 {
            return None;
        }
        // Once more about the mean, so that the window lies evenly about the answer.
        let middle = ((mean(best.0) * BINS as f32) as usize).min(BINS - 1);
        let (height, confidence) = (mean(middle), inside(middle));
        let square = |k: usize, mass: f32| mass * ((k as f32 + 0.5) / BINS as f32 - height).powi(2);
        let variance: f32 = self.mass.iter().enumerate().map(|(k, mass)| square(k, *mass)).sum();
        Some(Interface {
            cosine: f64::from(height - weights.bias),
            sigma: f64::from(weights.sigma).hypot(f64::from(variance).sqrt()),
            confidence: f64::from(confidence.min(1.0)),
        })
    }
}
