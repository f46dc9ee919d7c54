//! What a window's features say of the class.

use crate::coupling::{PairTable, couple};
use crate::discriminant::Discriminant;
use crate::model::{Method, Model, class_pairs};
use messages::CLASSES_MAX;

/// One number a class.
pub type PerClass = [f64; CLASSES_MAX];

/// What all pairs of classes say of one window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opinion {
    /// The metric of each pair, in both orders.
    pub metric: PairTable,
    /// How many pairs have the metric nearer to the class, in its standard deviations, than to the other.
    pub votes: [usize; CLASSES_MAX],
    /// Distance of the metric from the class, in its standard deviations, in the pair in which it is greatest.
    pub distance: PerClass,
    /// Probability, as the pairs' coupled.
    pub probability: PerClass,
}

impl Opinion {
    /// Asks the pairs of `classes` classes, in their order.
    #[must_use]
    pub fn of(pairs: &[Discriminant], classes: usize, features: &[f64], log_speed: f64) -> Self {
        let mut opinion = Self {
            metric: [[0.0; CLASSES_MAX]; CLASSES_MAX],
            votes: [0; CLASSES_MAX],
            distance: [0.0; CLASSES_MAX],
            probability: [0.0; CLASSES_MAX],
        };
        let mut pairwise: PairTable = [[0.0; CLASSES_MAX]; CLASSES_MAX];
        for (pair, (a, b)) in pairs.iter().zip(class_pairs(classes)) {
            let metric = pair.metric(features, log_speed);
            let distances = pair.distances(metric);
            opinion.metric[a][b] = metric;
            opinion.metric[b][a] = metric;
            opinion.votes[if distances[0] <= distances[1] { a } else { b }] += 1;
            opinion.distance[a] = opinion.distance[a].max(distances[0]);
            opinion.distance[b] = opinion.distance[b].max(distances[1]);
            pairwise[a][b] = 1.0 / (1.0 + (-pair.log_odds(metric)).exp());
            pairwise[b][a] = 1.0 - pairwise[a][b];
        }
        opinion.probability = couple(&pairwise, classes);
        opinion
    }
}

/// What was decided of one window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// The chosen class, also where it is rejected.
    pub class: usize,
    /// True where the chosen class is rejected.
    pub unknown: bool,
    /// The discriminant d of Eq. (23) of the chosen class and the next probable one.
    pub metric: f64,
    /// Probability of each class.
    pub probability: PerClass,
}

impl Model {
    /// What the pairs say of a window, the probabilities calibrated.
    #[must_use]
    pub fn consult(&self, features: &[f64], log_speed: f64) -> Opinion {
        let mut opinion = Opinion::of(&self.pairs, self.labels.len(), features, log_speed);
        opinion.probability = calibrated(&opinion.probability, self.probability_exponent);
        opinion
    }

    /// Decides on a window by what the pairs say of it. The paper's method lets the pairs vote; the other takes the most
    /// probable class.
    #[must_use]
    pub fn decide(&self, opinion: &Opinion) -> Decision {
        let votes = |class: usize| {
            if self.method == Method::Paper {
                opinion.votes[class]
            } else {
                0
            }
        };
        self.choose(opinion, &opinion.probability, self.reject.confidence_min, votes)
    }

    /// Decides by probabilities that take the windows before into account.
    #[must_use]
    pub fn decide_filtered(&self, opinion: &Opinion, probability: &PerClass) -> Decision {
        self.choose(opinion, probability, self.filter.confidence_min, |_| 0)
    }

    fn choose(
        &self,
        opinion: &Opinion,
        probability: &PerClass,
        confidence_min: f64,
        votes: impl Fn(usize) -> usize,
    ) -> Decision {
        let classes = self.labels.len().min(CLASSES_MAX);
        let better = |a: usize, b: usize| (votes(a), probability[a]) > (votes(b), probability[b]);
        let best_of = |best: usize, next: usize| if better(next, best) { next } else { best };
        let class = (1..classes).fold(0, best_of);
        let second = (0..classes).filter(|other| *other != class).reduce(best_of);
        Decision {
            class,
            unknown: probability[class] < confidence_min || opinion.distance[class] > self.reject.distance_max,
            metric: second.map_or(f64::NAN, |second| opinion.metric[class][second]),
            probability: *probability,
        }
    }
}

/// Probabilities raised to a power, and their sum to 1 again: below 1 they become more modest.
#[must_use]
pub fn calibrated(probability: &PerClass, exponent: f64) -> PerClass {
    let mut powers = probability.map(|p| p.powf(exponent));
    let sum: f64 = powers.iter().sum();
    if sum > 0.0 {
        powers.iter_mut().for_each(|p| *p /= sum);
    }
    powers
}
