//! What cross-validation by recording chooses: features, signal spaces, and whether speed is taken out.

use crate::calibrate::{best_exponent, mean_probability};
use crate::decision::Opinion;
use crate::discriminant::{Directions, Discriminant, Moments, dot, principal_axes};
use crate::features::{Features, Kind};
use crate::model::class_pairs;
use crate::training_set::{Folds, TrainingSet};
use nalgebra::{DMatrix, DVector};

/// Dimensions in which the classes are compared: the first principal axes of all windows.
const DIMENSIONS: usize = 100;
/// Numbers of principal components whose discriminants are averaged: the candidates.
const COMPONENTS: [&[usize]; 4] = [
    &[8, 12, 16, 20, 25, 30, 40],
    &[8, 12, 20, 30, 45, 60],
    &[6, 8, 10, 12, 16],
    &[6],
];
/// How much better than the candidates before it one must be.
const MERIT_STEP: f64 = 0.002;

/// What was chosen.
#[derive(Clone, Debug)]
pub struct Selection {
    /// How a window becomes numbers.
    pub features: Features,
    /// Trained on all windows.
    pub pairs: Vec<Discriminant>,
    /// What pairs that were trained without a window's recording say of it, for each scored window.
    pub opinions: Vec<(usize, Opinion)>,
    /// The choice in words.
    pub choice: String,
}

struct Candidate {
    space: Space,
    components: &'static [usize],
    opinions: Vec<(usize, Opinion)>,
    merit: f64,
}

/// Tries all candidates and trains the best one on all windows.
///
/// # Errors
/// Where there are no windows to choose by.
pub fn select(
    set: &TrainingSet,
    folds: &Folds,
    progress: &mut dyn FnMut(&'static str, f64),
) -> Result<Selection, String> {
    let spaces = spaces(set);
    let mut best: Option<Candidate> = None;
    for (index, space) in spaces.iter().enumerate() {
        let mut opinions = vec![Vec::new(); COMPONENTS.len()];
        for fold in 0..folds.count {
            progress(
                "cross-validation",
                (index * folds.count + fold) as f64 / (spaces.len() * folds.count) as f64,
            );
            let trained = space.pairs(set, |window| folds.of_window[window] != fold);
            for (pairs, opinions) in trained.iter().zip(&mut opinions) {
                opinions.extend(set.opinions(pairs, &space.scores, |window| folds.of_window[window] == fold));
            }
        }
        for (components, mut opinions) in COMPONENTS.into_iter().zip(opinions) {
            opinions.sort_by_key(|(window, _)| *window);
            let merit = mean_probability(set, &opinions, best_exponent(set, &opinions));
            if best.as_ref().is_none_or(|other| merit > other.merit + MERIT_STEP) {
                let space = space.clone();
                best = Some(Candidate {
                    space,
                    components,
                    opinions,
                    merit,
                });
            }
        }
    }
    let best = best.ok_or("there are no windows to choose by")?;
    Ok(best.finish(set))
}

impl Candidate {
    fn finish(self, set: &TrainingSet) -> Selection {
        let index = COMPONENTS.iter().position(|components| *components == self.components);
        let trained = self.space.pairs(set, |_| true);
        let pairs = trained.into_iter().nth(index.unwrap_or(0)).unwrap_or_default();
        let what = match self.space.features.kind {
            Kind::Power => "power",
            Kind::Partial => "power and partial coherence",
        };
        let speed = if self.space.speed_slope.is_some() {
            ", without what goes with the speed"
        } else {
            ""
        };
        let components: Vec<String> = self.components.iter().map(ToString::to_string).collect();
        Selection {
            choice: format!(
                "{what} in {} bands{speed}; discriminants in {} principal components",
                self.space.features.bands(set.window_samples),
                components.join(", ")
            ),
            pairs: pairs.iter().map(|pair| self.space.of_features(pair)).collect(),
            features: self.space.features,
            opinions: self.opinions,
        }
    }
}

/// The first principal axes of all windows.
#[derive(Clone)]
struct Space {
    features: Features,
    mean: DVector<f64>,
    /// One column an axis.
    basis: DMatrix<f64>,
    /// One column a window.
    scores: DMatrix<f64>,
    /// Change of the scores with log10 of the speed, which has been taken out of them.
    speed_slope: Option<DVector<f64>>,
}

fn spaces(set: &TrainingSet) -> Vec<Space> {
    let kinds: &[Kind] = match set.features.kind {
        Kind::Partial => &[Kind::Partial, Kind::Power],
        Kind::Power => &[Kind::Power],
    };
    let speed_varies = set.speed_known && set.log_speeds.iter().any(|ratio| *ratio != 0.0);
    let mut spaces = Vec::new();
    for kind in kinds {
        let space = Space::new(set, *kind);
        let without_speed = speed_varies.then(|| space.without_speed(set));
        spaces.push(space);
        spaces.extend(without_speed);
    }
    spaces
}

impl Space {
    fn new(set: &TrainingSet, kind: Kind) -> Self {
        let features = Features {
            kind,
            ..set.features.clone()
        };
        // The features of power come first.
        let rows = features.count(set.window_samples);
        let weights = set.weights();
        let total: f64 = weights.iter().sum();
        let mut centred = set.columns.rows(0, rows).into_owned();
        let mean = &centred * DVector::from_iterator(weights.len(), weights.iter().map(|weight| weight / total));
        for mut column in centred.column_iter_mut() {
            column -= &mean;
        }
        let mut scaled = centred.clone();
        for (mut column, weight) in scaled.column_iter_mut().zip(&weights) {
            column *= (weight / total).sqrt();
        }
        let (_, axes) = principal_axes(&scaled * scaled.transpose());
        let basis = axes.columns(0, DIMENSIONS.min(axes.ncols())).into_owned();
        let scores = basis.tr_mul(&centred);
        Self {
            features,
            mean,
            basis,
            scores,
            speed_slope: None,
        }
    }

    /// The same, with what goes with the speed within the classes taken out.
    fn without_speed(&self, set: &TrainingSet) -> Self {
        let weights = set.weights();
        let mut slope = DVector::zeros(self.scores.nrows());
        let mut spread = 0.0;
        for class in 0..set.class_count {
            let members: Vec<usize> = (0..weights.len())
                .filter(|window| set.classes[*window] == class)
                .collect();
            let mean: f64 = members
                .iter()
                .map(|window| weights[*window] * set.log_speeds[*window])
                .sum();
            for window in members {
                let excess = weights[window] * (set.log_speeds[window] - mean);
                slope.axpy(excess, &self.scores.column(window), 1.0);
                spread += excess * (set.log_speeds[window] - mean);
            }
        }
        slope /= spread.max(f64::MIN_POSITIVE);
        let mut space = self.clone();
        for (mut column, log_speed) in space.scores.column_iter_mut().zip(&set.log_speeds) {
            column.axpy(-log_speed, &slope, 1.0);
        }
        space.speed_slope = Some(slope);
        space
    }

    /// The discriminants of all pairs of classes, for each of [`COMPONENTS`], trained on the chosen windows.
    fn pairs(&self, set: &TrainingSet, chosen: impl Fn(usize) -> bool) -> Vec<Vec<Discriminant>> {
        let weights = set.weights();
        let mut moments = Vec::new();
        for class in 0..set.class_count {
            let members: Vec<usize> = (0..weights.len())
                .filter(|window| set.classes[*window] == class && chosen(*window))
                .collect();
            moments.push(self.moments(&members, &weights));
        }
        let mut all: Vec<usize> = COMPONENTS.concat();
        all.sort_unstable();
        all.dedup();
        let mut trained = vec![Vec::new(); COMPONENTS.len()];
        for (a, b) in class_pairs(set.class_count) {
            let (Some(first), Some(second)) = (&moments[a], &moments[b]) else {
                trained
                    .iter_mut()
                    .for_each(|pairs| pairs.push(Discriminant::neutral(self.scores.nrows())));
                continue;
            };
            let directions = Directions::new(first, second, &all);
            for (components, pairs) in COMPONENTS.iter().zip(&mut trained) {
                pairs.push(directions.mean(components, first, second));
            }
        }
        trained
    }

    /// Weighted mean and covariance of some windows' scores; `None` where there are not two.
    fn moments(&self, members: &[usize], weights: &[f64]) -> Option<Moments> {
        if members.len() < 2 {
            return None;
        }
        let total: f64 = members.iter().map(|window| weights[*window]).sum();
        let mut columns = self.scores.select_columns(members);
        let shares = DVector::from_iterator(members.len(), members.iter().map(|window| weights[*window] / total));
        let mean = &columns * &shares;
        for (mut column, share) in columns.column_iter_mut().zip(shares.iter()) {
            column -= &mean;
            column *= share.sqrt();
        }
        Some(Moments {
            mean,
            covariance: &columns * columns.transpose(),
        })
    }

    /// A discriminant of scores as one of features.
    fn of_features(&self, pair: &Discriminant) -> Discriminant {
        let direction = DVector::from_column_slice(&pair.weights);
        let weights: Vec<f64> = (&self.basis * &direction).iter().copied().collect();
        Discriminant {
            class_mean: pair.class_mean,
            class_sigma: pair.class_sigma,
            offset: dot(&weights, self.mean.as_slice()),
            speed_weight: self.speed_slope.as_ref().map_or(0.0, |slope| -slope.dot(&direction)),
            weights,
        }
    }
}
