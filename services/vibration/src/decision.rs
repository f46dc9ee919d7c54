//! What a window's features say of the class.

use crate::coupling::{PairTable, couple};
use crate::discriminant::Discriminant;
use crate::filter::even;
use crate::model::{Filtering, Method, Model, Rejecting, class_pairs};
use crate::recording::Window;
use crate::window::Quality;
use messages::{CLASSES_MAX, Status};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

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

/// What the windows so far let believe, as plain bytes.
#[derive(Clone, Copy, Debug, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct Belief {
    probability: PerClass,
    believed_ns: u64,
    /// 0 where it rests on no window.
    rests: u64,
}

impl Belief {
    pub(crate) fn is_sound(&self) -> bool {
        self.probability.iter().all(|p| (0.0..=1.001).contains(p))
    }
}

/// Decides on one window after the other.
pub struct Decider {
    model: Model,
    filtering: Filtering,
    rejecting: Rejecting,
    belief: PerClass,
    /// Start of the last window that the belief rests on.
    believed_ns: Option<u64>,
}

impl Decider {
    /// By a validated model, filtering and rejecting as it says or as it is told.
    #[must_use]
    pub fn new(model: Model, filtering: Option<Filtering>, rejecting: Option<Rejecting>) -> Self {
        Self {
            filtering: filtering.unwrap_or(model.filtering),
            rejecting: rejecting.unwrap_or(model.rejecting),
            belief: even(model.labels.len()),
            believed_ns: None,
            model,
        }
    }

    /// The model.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Starts another drive, with a belief about its terrain.
    pub fn enter(&mut self, belief: PerClass) {
        self.belief = belief;
        self.believed_ns = None;
    }

    pub(crate) fn belief(&self) -> Belief {
        Belief {
            probability: self.belief,
            believed_ns: self.believed_ns.unwrap_or(0),
            rests: u64::from(self.believed_ns.is_some()),
        }
    }

    pub(crate) fn believe(&mut self, belief: &Belief) {
        self.belief = belief.probability;
        self.believed_ns = (belief.rests != 0).then_some(belief.believed_ns);
    }

    /// Decides on the next window.
    ///
    /// # Errors
    /// Says why there is nothing to decide: bad data, or a vehicle that stands still.
    pub fn decide(&mut self, window: &Window) -> Result<Decision, Status> {
        match window.quality {
            Quality::Incomplete => return Err(Status::INCOMPLETE),
            Quality::WrongRate => return Err(Status::INPUT_REJECTED),
            Quality::Faulty | Quality::Good => {}
        }
        if self.model.speed.stands_still(window) {
            return Err(Status::STANDING_STILL);
        }
        if window.quality == Quality::Faulty {
            return Err(Status::SENSOR_FAULT);
        }
        let log_speed = self.model.speed.log_ratio(window.speed_m_s);
        let opinion = self.model.consult(&window.features, log_speed);
        let mut decision = match self.filtering {
            Filtering::None => self.model.decide(&opinion),
            Filtering::Hmm => self.filtered(window.start_ns, &opinion),
        };
        decision.unknown &= self.rejecting == Rejecting::Calibrated;
        Ok(decision)
    }

    /// Decides with the windows before.
    fn filtered(&mut self, start_ns: u64, opinion: &Opinion) -> Decision {
        let elapsed_s = match self.believed_ns.replace(start_ns) {
            Some(last_ns) => start_ns.saturating_sub(last_ns) as f64 / 1e9,
            None => self.model.window_s(),
        };
        let classes = self.model.labels.len();
        let filter = &self.model.filter;
        self.belief = filter.update(&self.belief, &opinion.probability, classes, elapsed_s);
        self.model.decide_filtered(opinion, &self.belief)
    }
}

impl Model {
    /// What the pairs say of a window, the probabilities calibrated.
    #[must_use]
    pub fn consult(&self, features: &[f64], log_speed: f64) -> Opinion {
        let mut opinion = Opinion::of(&self.pairs, self.labels.len(), features, log_speed);
        opinion.probability = calibrated(&opinion.probability, self.probability_exponent);
        opinion
    }

    /// Decides on a window by what the pairs say of it. The paper's method lets the pairs vote, the first of equal classes
    /// winning; the other takes the most probable class.
    #[must_use]
    pub fn decide(&self, opinion: &Opinion) -> Decision {
        let confidence_min = self.reject.confidence_min;
        match self.method {
            Method::Paper => self.choose(opinion, &opinion.probability, confidence_min, |class| {
                opinion.votes[class]
            }),
            Method::Coupled => self.decide_by(opinion, &opinion.probability, confidence_min),
        }
    }

    /// Decides by probabilities that take the windows before into account.
    #[must_use]
    pub fn decide_filtered(&self, opinion: &Opinion, probability: &PerClass) -> Decision {
        self.decide_by(opinion, probability, self.filter.confidence_min)
    }

    fn decide_by(&self, opinion: &Opinion, probability: &PerClass, confidence_min: f64) -> Decision {
        self.choose(opinion, probability, confidence_min, |class| probability[class])
    }

    fn choose<T: PartialOrd>(
        &self,
        opinion: &Opinion,
        probability: &PerClass,
        confidence_min: f64,
        merit: impl Fn(usize) -> T,
    ) -> Decision {
        let classes = self.labels.len().min(CLASSES_MAX);
        let best_of = |best: usize, next: usize| if merit(next) > merit(best) { next } else { best };
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
