//! What a window's features say of the class.

use crate::coupling::couple;
use crate::model::Model;
use messages::CLASSES_MAX;

/// Standard deviations about its mean within which the paper accepts a class.
const BAND: f64 = 1.0;

/// What was decided of one window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// The most probable class, also where it is rejected.
    pub class: usize,
    /// True where no class is accepted.
    pub unknown: bool,
    /// The discriminant d of Eq. (23) of the two most probable classes.
    pub metric: f64,
    /// Probability of each class.
    pub probability: [f64; CLASSES_MAX],
}

impl Model {
    /// Decides on a window by its features: each pair of classes votes for the one whose mean is nearer to the metric,
    /// in its standard deviations. The terrain is unknown unless all pairs of the chosen class have it in their band.
    #[must_use]
    pub fn decide(&self, features: &[f64]) -> Decision {
        let classes = self.labels.len().min(CLASSES_MAX);
        let mut metrics = [[0.0; CLASSES_MAX]; CLASSES_MAX];
        let mut pairwise = [[0.0; CLASSES_MAX]; CLASSES_MAX];
        let mut votes = [0_usize; CLASSES_MAX];
        let mut accepted = [true; CLASSES_MAX];
        for (pair, (a, b)) in self.pairs.iter().zip(self.class_pairs()) {
            let metric = pair.metric(features);
            let distances = pair.distances(metric);
            metrics[a][b] = metric;
            metrics[b][a] = metric;
            votes[if distances[0] <= distances[1] { a } else { b }] += 1;
            accepted[a] &= distances[0] <= BAND;
            accepted[b] &= distances[1] <= BAND;
            let odds = (distances[0].powi(2) - distances[1].powi(2)) / 2.0;
            let of_first = 1.0 / (1.0 + odds.exp() * pair.class_sigma[0] / pair.class_sigma[1]);
            pairwise[a][b] = of_first;
            pairwise[b][a] = 1.0 - of_first;
        }
        let probability = couple(&pairwise, classes);
        let better = |a: usize, b: usize| (votes[a], probability[a]) > (votes[b], probability[b]);
        let class = (1..classes).fold(0, |best, next| if better(next, best) { next } else { best });
        let second = (0..classes)
            .filter(|other| *other != class)
            .reduce(|best, next| if better(next, best) { next } else { best });
        Decision {
            class,
            unknown: !accepted[class],
            metric: second.map_or(f64::NAN, |second| metrics[class][second]),
            probability,
        }
    }
}
