//! The windows that a model is trained on and judged by, and how they are left out in turn.

use crate::decision::Opinion;
use crate::discriminant::Discriminant;
use crate::features::Features;
use crate::model::Speed;
use crate::recording::{Recording, Window};
use crate::train::Setup;
use crate::window::Quality;
use nalgebra::DMatrix;
use std::collections::{BTreeMap, BTreeSet};

/// Usable windows that each class must have.
const WINDOWS_MIN: usize = 10;
/// Windows at the most; beyond, those that overlap others are left out, then every second one, and so on.
const WINDOWS_MAX: usize = 20_000;
/// Folds at the most.
const FOLDS_MAX: usize = 8;
/// Parts into which the only recording of a class is cut, to be left out in turn.
const PARTS: usize = 3;

/// Complete windows of a vehicle that moves.
#[derive(Clone, Debug)]
pub struct TrainingSet {
    /// How the windows became numbers.
    pub features: Features,
    /// One column a window.
    pub columns: DMatrix<f64>,
    /// Class of each.
    pub classes: Vec<usize>,
    /// Recording of each.
    pub recordings: Vec<usize>,
    /// Run of each: the index of its first recording.
    pub runs: Vec<usize>,
    /// Sensor instant of each one's first sample.
    pub starts_ns: Vec<u64>,
    /// log10 of each one's speed over the usual one; 0 where it is not known, or the vehicle turns in place.
    pub log_speeds: Vec<f64>,
    /// True where the speed of every window is known.
    pub speed_known: bool,
    /// False for the windows that overlap others.
    pub scored: Vec<bool>,
    /// Samples of a window.
    pub window_samples: usize,
    /// Length of a window [s].
    pub window_s: f64,
    /// Number of classes.
    pub class_count: usize,
}

impl TrainingSet {
    /// Picks the usable windows.
    ///
    /// # Errors
    /// Names the class that has too few of them.
    pub fn new(
        setup: &Setup,
        recordings: &[Recording],
        windows: &[Window],
        speed: &Speed,
        features: Features,
    ) -> Result<Self, String> {
        let usable = |window: &&Window| window.quality == Quality::Good && !speed.stands_still(window);
        let mut good: Vec<&Window> = windows.iter().filter(usable).collect();
        if good.len() > WINDOWS_MAX {
            good.retain(|window| window.scored);
        }
        let step = good.len().div_ceil(WINDOWS_MAX).max(1);
        let good: Vec<&Window> = good.into_iter().step_by(step).collect();
        let classes: Vec<usize> = good.iter().map(|window| recordings[window.recording].class).collect();
        for (class, label) in setup.labels.iter().enumerate() {
            let count = classes.iter().filter(|other| **other == class).count();
            if count < WINDOWS_MIN {
                return Err(format!(
                    "class {label} has {count} usable windows of {:.2} s; record at least {WINDOWS_MIN}, better 100",
                    setup.window_samples as f64 / setup.rate_hz
                ));
            }
        }
        let rows = features.count(setup.window_samples);
        Ok(Self {
            columns: DMatrix::from_iterator(rows, good.len(), good.iter().flat_map(|window| window.features.clone())),
            features,
            classes,
            recordings: good.iter().map(|window| window.recording).collect(),
            runs: good.iter().map(|window| run_of(recordings, window.recording)).collect(),
            starts_ns: good.iter().map(|window| window.start_ns).collect(),
            log_speeds: good.iter().map(|window| speed.log_ratio(window.speed_m_s)).collect(),
            speed_known: good.iter().all(|window| window.speed_m_s.is_finite()),
            scored: good.iter().map(|window| window.scored).collect(),
            window_samples: setup.window_samples,
            window_s: setup.window_samples as f64 / setup.rate_hz,
            class_count: setup.labels.len(),
        })
    }

    /// What the pairs say of the scored windows among the chosen ones; `columns` are these windows' features.
    #[must_use]
    pub fn opinions(
        &self,
        pairs: &[Discriminant],
        columns: &DMatrix<f64>,
        chosen: impl Fn(usize) -> bool,
    ) -> Vec<(usize, Opinion)> {
        (0..self.classes.len())
            .filter(|window| self.scored[*window] && chosen(*window))
            .map(|window| {
                let features = columns.column(window);
                let log_speed = self.log_speeds[window];
                (
                    window,
                    Opinion::of(pairs, self.class_count, features.as_slice(), log_speed),
                )
            })
            .collect()
    }

    /// Of each class, which share of its windows is among the chosen ones.
    fn class_shares(&self, chosen: impl Fn(usize) -> bool) -> Vec<f64> {
        let mut counts = vec![(0.0, 0.0); self.class_count];
        for (window, class) in self.classes.iter().enumerate() {
            counts[*class].0 += f64::from(u8::from(chosen(window)));
            counts[*class].1 += 1.0;
        }
        counts
            .into_iter()
            .map(|(hits, all)| hits / f64::max(all, 1.0))
            .collect()
    }

    /// Weight of each window: classes count alike, and a run by the square root of its length, for its windows
    /// resemble each other.
    #[must_use]
    pub fn weights(&self) -> Vec<f64> {
        let count = |of: &[usize], index: usize| of.iter().filter(|other| **other == index).count() as f64;
        let runs = self.recordings.iter().max().map_or(0, |last| last + 1);
        let lengths: Vec<f64> = (0..runs).map(|run| count(&self.runs, run)).collect();
        let mut weights: Vec<f64> = self.runs.iter().map(|run| lengths[*run].sqrt().recip()).collect();
        for class in 0..self.class_count {
            let members = || (0..weights.len()).filter(|window| self.classes[*window] == class);
            let sum: f64 = members().map(|window| weights[window]).sum();
            for window in members().collect::<Vec<usize>>() {
                weights[window] /= sum;
            }
        }
        weights
    }
}

impl Speed {
    /// True for a window in which the vehicle hardly moves, does not turn and is quiet.
    #[must_use]
    pub fn stands_still(&self, window: &Window) -> bool {
        self.is_still(window.speed_m_s, window.turning, window.level)
    }

    /// True for a vehicle that hardly moves, does not turn and is quiet; false where the speed is not known.
    #[must_use]
    pub fn is_still(&self, speed_m_s: f64, turning: bool, level: f64) -> bool {
        speed_m_s.abs() < self.still_m_s && !turning && level < self.quiet_level
    }

    /// log10 of a speed over the usual one; 0 where it is not known or there is none.
    #[must_use]
    pub fn log_ratio(&self, speed_m_s: f64) -> f64 {
        if speed_m_s.abs() >= self.still_m_s.max(1e-9) {
            (speed_m_s.abs() / self.usual_m_s).log10()
        } else {
            0.0
        }
    }
}

/// The run of a recording: the index of the first recording of its run.
pub(crate) fn run_of(recordings: &[Recording], index: usize) -> usize {
    let same = |other: &Recording| other.run == recordings[index].run;
    recordings.iter().position(same).unwrap_or(index)
}

/// Which windows are left out together: whole runs, for windows of one run resemble each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Folds {
    /// How many times windows are left out.
    pub count: usize,
    /// When each window is.
    pub of_window: Vec<usize>,
}

impl Folds {
    /// Deals the runs out so that each class is spread evenly. The only run of a class is cut into parts.
    #[must_use]
    pub fn new(set: &TrainingSet) -> Self {
        let windows = set.classes.len();
        // Groups that stay together: runs, and parts of a class's only run.
        let mut of_window: Vec<(usize, usize)> = set.runs.iter().map(|run| (*run, 0)).collect();
        for class in 0..set.class_count {
            let own: Vec<usize> = (0..windows).filter(|window| set.classes[*window] == class).collect();
            if own.windows(2).all(|pair| set.runs[pair[0]] == set.runs[pair[1]]) {
                for (place, window) in own.iter().enumerate() {
                    of_window[*window].1 = 1 + class * PARTS + place * PARTS / own.len();
                }
            }
        }
        let groups: BTreeSet<(usize, usize)> = of_window.iter().copied().collect();
        let mut shares: Vec<((usize, usize), Vec<f64>)> = groups
            .into_iter()
            .map(|group| (group, set.class_shares(|window| of_window[window] == group)))
            .collect();
        // The largest first: the small ones then fill up.
        shares.sort_by(|a, b| sum(&b.1).total_cmp(&sum(&a.1)));
        let count = shares.len().clamp(2, FOLDS_MAX);
        let mut loads = vec![vec![0.0; set.class_count]; count];
        let mut fold_of = BTreeMap::new();
        for (group, share) in shares {
            // More of the same class weighs first, more of anything second.
            let cost = |load: &Vec<f64>| load.iter().zip(&share).map(|(a, b)| a * b).sum::<f64>() + 1e-6 * sum(load);
            let fold = (1..count).fold(0, |best, fold| {
                if cost(&loads[fold]) < cost(&loads[best]) {
                    fold
                } else {
                    best
                }
            });
            loads[fold]
                .iter_mut()
                .zip(&share)
                .for_each(|(load, share)| *load += share);
            fold_of.insert(group, fold);
        }
        Self {
            count,
            of_window: of_window.iter().map(|group| fold_of[group]).collect(),
        }
    }
}

fn sum(values: &[f64]) -> f64 {
    values.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::Kind;

    /// Windows of the given (run, class).
    fn set(windows: &[(usize, usize)]) -> TrainingSet {
        let count = windows.len();
        TrainingSet {
            features: Features::banded(Kind::Power, vec![1.0], 100, 5),
            columns: DMatrix::zeros(1, count),
            classes: windows.iter().map(|window| window.1).collect(),
            recordings: windows.iter().map(|window| window.0).collect(),
            runs: windows.iter().map(|window| window.0).collect(),
            starts_ns: vec![0; count],
            log_speeds: vec![0.0; count],
            speed_known: false,
            scored: vec![true; count],
            window_samples: 100,
            window_s: 1.0,
            class_count: windows.iter().map(|window| window.1 + 1).max().unwrap_or(0),
        }
    }

    #[test]
    fn a_run_is_left_out_as_a_whole_even_where_it_holds_several_classes() {
        let windows: Vec<(usize, usize)> = (0..300).map(|index| (index / 30, index % 3)).collect();
        let folds = Folds::new(&set(&windows));
        for (first, a) in windows.iter().enumerate() {
            for (second, b) in windows.iter().enumerate() {
                assert!(a.0 != b.0 || folds.of_window[first] == folds.of_window[second]);
            }
        }
        let mut used = folds.of_window.clone();
        used.sort_unstable();
        used.dedup();
        assert_eq!(used.len(), folds.count);
    }

    #[test]
    fn the_only_run_of_a_class_is_cut_into_parts_in_time() {
        let windows: Vec<(usize, usize)> = (0..90)
            .map(|index| (usize::from(index >= 30) + index / 60, usize::from(index >= 30)))
            .collect();
        let folds = Folds::new(&set(&windows));
        let parts: BTreeSet<usize> = folds.of_window[..30].iter().copied().collect();
        assert_eq!(parts.len(), PARTS);
        assert!(folds.of_window[..30].chunk_by(|a, b| a == b).count() == PARTS);
    }
}
