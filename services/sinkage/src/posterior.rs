//! Where a side's interface is, as a probability over the height at which it meets the outer circle.

use crate::contrast::Contrast;
use crate::interface::Interface;
use crate::lines::{PART, PARTS, TILTS};
use crate::weights::{FEATURES, Weights};

/// Bins of the height, from the wheel's centre to its lowest point.
pub const BINS: usize = 320;
/// Bins on either side of an answer that are the same answer: 0.0225 outer radii.
const NEAR: usize = 7;
/// Scores this far below the best have no probability.
const SCORE_SPAN: f32 = 12.0;

/// Bins that the two sides are compared by.
const GROUP: usize = 4;
const GROUPS: usize = BINS / GROUP;
/// Standard deviation of the difference of the two sides' heights, in outer radii.
const LEVEL: f32 = 0.1;
/// What the greatest difference costs, in the logarithm of the probability: there are steep grounds.
const LEVEL_COST_MAX: f32 = 2.0;

/// Probability of each bin.
#[derive(Clone, Debug, PartialEq)]
pub struct Posterior {
    /// Sums up to 1, or is 0 everywhere where no line is a candidate.
    pub mass: [f32; BINS],
    /// How many pictures' worth of evidence it holds.
    pub pictures: f32,
}

impl Posterior {
    /// The softmax of the scores over all lines, summed up by the height at which they meet the circle.
    #[must_use]
    #[inline(always)]
    pub fn new(contrast: &Contrast, weights: &Weights) -> Self {
        let mut scores = contrast.scores(&weights.features);
        let mut highest = [[0.0; PARTS]; TILTS.len()];
        for (highest, scores) in highest.as_flattened_mut().iter_mut().zip(scores.as_flattened()) {
            *highest = largest(scores);
        }
        let floor = highest.as_flattened().iter().copied().fold(f32::NEG_INFINITY, f32::max) - SCORE_SPAN;
        for (tilt, (scores, highest)) in scores.iter_mut().zip(&mut highest).enumerate() {
            for (part, (scores, highest)) in scores.iter_mut().zip(highest).enumerate() {
                if *highest > floor {
                    refine(scores, &contrast.features(tilt, part), floor, weights);
                    *highest = largest(scores);
                }
            }
        }
        let best = highest.as_flattened().iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let mut mass = [0.0; BINS];
        let parts = scores.as_flattened().iter().zip(contrast.heights.as_flattened());
        for ((scores, heights), highest) in parts.zip(highest.as_flattened()) {
            if highest - best > -SCORE_SPAN {
                for (score, height) in scores
                    .iter()
                    .zip(heights)
                    .filter(|(score, _)| *score - best > -SCORE_SPAN)
                {
                    mass[((height * BINS as f32) as usize).min(BINS - 1)] += (weights.temper * (score - best)).exp();
                }
            }
        }
        let mut posterior = Self { mass, pictures: 1.0 };
        posterior.normalize();
        posterior
    }

    /// Probability of about this height.
    #[must_use]
    pub fn near(&self, height: f32) -> f32 {
        let middle = ((height * BINS as f32) as usize).min(BINS - 1);
        self.mass[middle.saturating_sub(NEAR)..(middle + NEAR + 1).min(BINS)]
            .iter()
            .sum()
    }

    /// Makes the probabilities sum up to 1.
    #[inline(always)]
    pub fn normalize(&mut self) {
        // Several sums side by side, whatever the processor.
        let mut sums = [0.0; PART];
        for masses in self.mass.as_chunks::<PART>().0 {
            for (sum, mass) in sums.iter_mut().zip(masses) {
                *sum += mass;
            }
        }
        let total: f32 = sums.iter().sum();
        if total > 0.0 {
            let scale = 1.0 / total;
            for mass in &mut self.mass {
                *mass *= scale;
            }
        }
    }

    /// Probability of each group of bins.
    #[inline(always)]
    fn groups(&self) -> [f32; GROUPS] {
        let mut groups = [0.0; GROUPS];
        for (group, masses) in groups.iter_mut().zip(self.mass.as_chunks::<GROUP>().0) {
            *group = masses.iter().sum();
        }
        groups
    }

    /// The same with one picture's worth of evidence: the pictures of one scene err alike.
    #[must_use]
    pub fn of_one_picture(&self) -> Self {
        let power = 1.0 / self.pictures.max(1.0);
        let calm = |mass: f32| if mass > 0.0 { mass.powf(power) } else { 0.0 };
        let mut posterior = Self {
            mass: self.mass.map(calm),
            pictures: 1.0,
        };
        posterior.normalize();
        posterior
    }

    /// The window of the largest probability: its mean, its mass as the confidence, and a sigma that covers the rest.
    #[must_use]
    #[inline(always)]
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
        // A window is the one before with one bin more and one less.
        let mut mass: f32 = self.mass[..NEAR].iter().sum();
        for middle in 0..BINS {
            mass += self.mass.get(middle + NEAR).unwrap_or(&0.0);
            if mass > best.1 {
                best = (middle, mass);
            }
            mass -= middle.checked_sub(NEAR).map_or(0.0, |first| self.mass[first]);
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

/// What either side says of the other: soil lies about level, so that its heights differ by [`LEVEL`].
#[derive(Clone, Debug)]
pub struct Coupling {
    /// Likelihood of a group for the one so many before or after it.
    likelihood: [f32; 2 * GROUPS - 1],
}

impl Coupling {
    /// Prepares the likelihoods.
    #[must_use]
    pub fn new() -> Self {
        Self {
            likelihood: std::array::from_fn(|k| {
                let apart = (k.abs_diff(GROUPS - 1) * GROUP) as f32 / BINS as f32 / LEVEL;
                (-(0.5 * apart * apart).min(LEVEL_COST_MAX)).exp()
            }),
        }
    }

    /// Weighs each side by what the other one lets expect.
    #[inline(always)]
    pub fn couple(&self, left: &mut Posterior, right: &mut Posterior) {
        let (left_groups, right_groups) = (left.groups(), right.groups());
        for (side, other) in [(left, right_groups), (right, left_groups)] {
            let mut messages = [0.0; GROUPS];
            for (group, mass) in other.into_iter().enumerate().filter(|(_, mass)| *mass > 0.0) {
                for (message, likelihood) in messages.iter_mut().zip(&self.likelihood[GROUPS - 1 - group..]) {
                    *message += mass * likelihood;
                }
            }
            for (masses, message) in side.mass.chunks_exact_mut(GROUP).zip(messages) {
                for mass in masses {
                    *mass *= message;
                }
            }
            side.normalize();
        }
    }
}

impl Default for Coupling {
    fn default() -> Self {
        Self::new()
    }
}

/// The largest of some scores, two halves side by side.
#[inline(always)]
fn largest(scores: &[f32; PART]) -> f32 {
    let halves: [f32; PART / 2] = std::array::from_fn(|k| scores[k].max(scores[k + PART / 2]));
    halves.into_iter().fold(f32::NEG_INFINITY, f32::max)
}

/// Adds the hidden layer to the scores of some lines; those at or below `floor` are no candidates.
#[inline(always)]
fn refine(scores: &mut [f32; PART], features: &[[f32; PART]; FEATURES], floor: f32, weights: &Weights) {
    let mut sums = [0.0; PART];
    for unit in &weights.units {
        let mut inputs = [unit.bias; PART];
        for (feature, weight) in features.iter().zip(unit.weights) {
            for (input, value) in inputs.iter_mut().zip(feature) {
                *input += weight * value;
            }
        }
        for (sum, input) in sums.iter_mut().zip(inputs) {
            *sum += unit.out * input.max(0.0);
        }
    }
    for (score, sum) in scores.iter_mut().zip(sums) {
        *score = if *score > floor {
            *score + sum
        } else {
            f32::NEG_INFINITY
        };
    }
}
