//! A model tried on recordings, by the same code as on board.

use crate::decision::{Decider, Decision};
use crate::discriminant::principal_axes;
use crate::features::Extractor;
use crate::filter::before_change;
use crate::model::{Filtering, Model, Rejecting};
use crate::recording::{Cutter, Recording, Window};
use crate::score::Scored;
use messages::Status;
use nalgebra::DMatrix;

/// A window, and what the model says of it.
#[derive(Clone, Debug)]
pub struct Judged {
    /// The window; its `recording` is an index into those that were evaluated.
    pub window: Window,
    /// The decision, or why there is none.
    pub decision: Result<Decision, Status>,
}

impl Judged {
    /// The decision beside the truth; `None` where nothing was decided.
    #[must_use]
    pub fn scored(&self, recordings: &[Recording]) -> Option<Scored> {
        let decision = self.decision.ok()?;
        Some(Scored {
            truth: recordings.get(self.window.recording)?.class,
            class: decision.class,
            unknown: decision.unknown,
            probability: decision.probability,
        })
    }
}

/// Decides on the windows of all recordings, which do not overlap. The recordings' classes are indices into the model's
/// labels; beyond them, the terrain is one that the model does not know. The filter enters each recording as after a
/// change of terrain, nearly sure of a class that it is not: its lag counts.
pub fn evaluate(
    model: &Model,
    recordings: &[Recording],
    filtering: Option<Filtering>,
    rejecting: Option<Rejecting>,
    progress: &mut dyn FnMut(f64),
) -> Vec<Judged> {
    let cutter = Cutter {
        window_samples: model.window_samples,
        rate_hz: model.rate_hz,
        channels: model.channels.clone(),
    };
    let classes = model.labels.len();
    let mut extractor = Extractor::new(model.features.clone(), model.window_samples, model.rate_hz);
    let mut decider = Decider::new(model.clone(), filtering, rejecting);
    let mut judged = Vec::new();
    for (index, recording) in recordings.iter().enumerate() {
        progress(index as f64 / recordings.len() as f64);
        decider.enter(before_change(recording.class % classes, index, classes));
        for window in cutter.cut(index, recording, &mut extractor, false) {
            let decision = decider.decide(&window);
            judged.push(Judged { window, decision });
        }
    }
    judged
}

/// The first two principal components of windows' features, window by window.
#[must_use]
pub fn principal_components(windows: &[&[f64]]) -> Vec<[f64; 2]> {
    let rows = windows.first().map_or(0, |window| window.len());
    if rows == 0 || windows.iter().any(|window| window.len() != rows) {
        return vec![[0.0; 2]; windows.len()];
    }
    let values = windows.iter().flat_map(|window| window.iter().copied());
    let mut columns = DMatrix::from_iterator(rows, windows.len(), values);
    let mean = columns.column_mean();
    for mut column in columns.column_iter_mut() {
        column -= &mean;
    }
    let (_, axes) = principal_axes(&columns * columns.transpose());
    let along = |axis: usize, column: usize| {
        let both = axis < axes.ncols();
        if both {
            axes.column(axis).dot(&columns.column(column))
        } else {
            0.0
        }
    };
    (0..windows.len())
        .map(|window| [along(0, window), along(1, window)])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_component_lies_along_the_greatest_spread() {
        // Points on an ellipse whose long axis is the diagonal.
        let points: Vec<[f64; 2]> = (0..40)
            .map(|index| {
                let (sin, cos) = (f64::from(index) * std::f64::consts::TAU / 40.0).sin_cos();
                [7.0 + 5.0 * cos - sin, 5.0 * cos + sin]
            })
            .collect();
        let windows: Vec<&[f64]> = points.iter().map(<[f64; 2]>::as_slice).collect();
        for (index, [first, second]) in principal_components(&windows).into_iter().enumerate() {
            let (sin, cos) = (index as f64 * std::f64::consts::TAU / 40.0).sin_cos();
            let root = 2.0_f64.sqrt();
            assert!((first.abs() - (5.0 * root * cos).abs()).abs() < 1e-9);
            assert!((second.abs() - (root * sin).abs()).abs() < 1e-9);
        }
    }

    #[test]
    fn windows_without_features_have_no_components() {
        assert_eq!(principal_components(&[&[], &[]]), [[0.0; 2]; 2]);
        assert_eq!(principal_components(&[&[3.0]]), [[0.0; 2]]);
    }
}
