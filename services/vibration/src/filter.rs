//! A hidden Markov model's forward filter: the terrain seldom changes from one window to the next.

use crate::decision::PerClass;
use messages::CLASSES_MAX;
use serde::{Deserialize, Serialize};

/// How much the windows before count.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Filter {
    /// Probability that the terrain is still the same after a second.
    pub stay_per_s: f64,
    /// Exponent of a window's probabilities: below 1, for windows that follow each other err together.
    pub weight: f64,
    /// The most probable class is rejected where it is less probable than this.
    pub confidence_min: f64,
    /// How long after a change of terrain the new class is named [s]: the median over the recordings left out.
    pub lag_s: f64,
}

impl Filter {
    /// The belief after a window: `belief` was held `elapsed_s` before, `probability` is what the window alone says.
    #[must_use]
    pub fn update(&self, belief: &PerClass, probability: &PerClass, classes: usize, elapsed_s: f64) -> PerClass {
        let classes = classes.clamp(1, CLASSES_MAX);
        let even = 1.0 / classes as f64;
        // Of the excess over even odds, this much is left after a second, and less the longer it takes.
        let left = ((self.stay_per_s - even) / (1.0 - even).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        let memory = left.powf(elapsed_s.max(0.0));
        let mut updated = [0.0; CLASSES_MAX];
        for ((new, old), p) in updated.iter_mut().zip(belief).zip(probability).take(classes) {
            *new = (even + memory * (old - even)) * p.max(f64::MIN_POSITIVE).powf(self.weight);
        }
        let sum: f64 = updated.iter().sum();
        if sum.is_finite() && sum > 0.0 {
            updated.iter_mut().for_each(|p| *p /= sum);
            updated
        } else {
            *probability
        }
    }
}

/// Even odds.
#[must_use]
pub fn even(classes: usize) -> PerClass {
    let classes = classes.clamp(1, CLASSES_MAX);
    std::array::from_fn(|class| if class < classes { 1.0 / classes as f64 } else { 0.0 })
}

/// Belief in another class just before a change of terrain.
const BELIEF_BEFORE: f64 = 0.95;

/// What is believed just before the terrain changes to `class`: nearly surely another one; which, goes round with `turn`.
#[must_use]
pub fn before_change(class: usize, turn: usize, classes: usize) -> PerClass {
    let classes = classes.clamp(1, CLASSES_MAX);
    if classes == 1 {
        return even(classes);
    }
    let other = (class + 1 + turn % (classes - 1)) % classes;
    std::array::from_fn(|index| match index {
        _ if index == other => BELIEF_BEFORE,
        _ if index < classes => (1.0 - BELIEF_BEFORE) / (classes - 1) as f64,
        _ => 0.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILTER: Filter = Filter {
        stay_per_s: 0.9,
        weight: 1.0,
        confidence_min: 0.0,
        lag_s: 0.0,
    };

    fn two(first: f64) -> PerClass {
        std::array::from_fn(|class| [first, 1.0 - first].get(class).copied().unwrap_or(0.0))
    }

    #[test]
    fn one_window_is_bayes_rule_after_one_step_of_the_chain() {
        let updated = FILTER.update(&two(0.7), &two(0.6), 2, 1.0);
        let prior = 0.7 * 0.9 + 0.3 * 0.1;
        let expected = prior * 0.6 / (prior * 0.6 + (1.0 - prior) * 0.4);
        assert!((updated[0] - expected).abs() < 1e-12);
    }

    #[test]
    fn two_seconds_are_two_steps_of_one() {
        let nothing = even(3);
        let once = FILTER.update(&two(1.0), &nothing, 3, 1.0);
        let twice = FILTER.update(&once, &nothing, 3, 1.0);
        let long = FILTER.update(&two(1.0), &nothing, 3, 2.0);
        for class in 0..3 {
            assert!((twice[class] - long[class]).abs() < 1e-12);
        }
    }

    #[test]
    fn a_single_contrary_window_changes_nothing_and_several_do() {
        let mut belief = two(0.5);
        for _ in 0..10 {
            belief = FILTER.update(&belief, &two(0.8), 2, 1.0);
        }
        belief = FILTER.update(&belief, &two(0.3), 2, 1.0);
        assert!(belief[0] > 0.5);
        for _ in 0..4 {
            belief = FILTER.update(&belief, &two(0.2), 2, 1.0);
        }
        assert!(belief[0] < 0.5);
    }

    #[test]
    fn what_is_believed_before_a_change_is_never_the_class_after_it() {
        for classes in 2..=CLASSES_MAX {
            for class in 0..classes {
                for turn in 0..40 {
                    let belief = before_change(class, turn, classes);
                    assert!((belief.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                    assert!(belief[class] < 0.06 && belief[..classes].contains(&BELIEF_BEFORE));
                }
            }
        }
    }

    #[test]
    fn after_a_long_silence_the_window_alone_decides() {
        let updated = FILTER.update(&two(1.0), &two(0.2), 2, 1e9);
        assert!((updated[0] - 0.2).abs() < 1e-12);
    }
}
