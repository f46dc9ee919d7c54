//! The windows that a model is trained on and judged by, and how they are left out in turn.

use crate::decision::Opinion;
use crate::discriminant::Discriminant;
use crate::features::Features;
use crate::model::Speed;
use crate::recording::{Recording, Window};
use crate::train::Setup;
use crate::window::Quality;
use nalgebra::DMatrix;

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
        let classes: Vec<usize> = good.iter().map(|window| recordings[window.run].class).collect();
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
            runs: good.iter().map(|window| window.run).collect(),
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

    /// Weight of each window: classes count alike, and a recording by the square root of its length, for its windows
    /// resemble each other.
    #[must_use]
    pub fn weights(&self) -> Vec<f64> {
        let count = |of: &[usize], index: usize| of.iter().filter(|other| **other == index).count() as f64;
        let runs = self.runs.iter().max().map_or(0, |last| last + 1);
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

/// Which windows are left out together: whole recordings, for windows of one recording resemble each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Folds {
    /// How many times windows are left out.
    pub count: usize,
    /// When each window is.
    pub of_window: Vec<usize>,
}

impl Folds {
    /// Deals the recordings of each class out. The only recording of a class is cut into parts.
    #[must_use]
    pub fn new(set: &TrainingSet) -> Self {
        let mut groups: Vec<Vec<Vec<usize>>> = Vec::new();
        for class in 0..set.class_count {
            let windows: Vec<usize> = (0..set.classes.len())
                .filter(|window| set.classes[*window] == class)
                .collect();
            let mut parts: Vec<Vec<usize>> = windows
                .chunk_by(|a, b| set.runs[*a] == set.runs[*b])
                .map(<[usize]>::to_vec)
                .collect();
            if parts.len() == 1 {
                parts = windows
                    .chunks(windows.len().div_ceil(PARTS))
                    .map(<[usize]>::to_vec)
                    .collect();
            }
            groups.push(parts);
        }
        let most = groups.iter().map(Vec::len).max().unwrap_or(0);
        let count = most.clamp(2, FOLDS_MAX);
        let mut of_window = vec![0; set.classes.len()];
        for (class, parts) in groups.iter().enumerate() {
            for (index, part) in parts.iter().enumerate() {
                for window in part {
                    of_window[*window] = (index + class) % count;
                }
            }
        }
        Self { count, of_window }
    }
}
