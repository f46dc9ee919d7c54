//! A model tried on recordings, by the same code as on board.

use crate::decision::{Decider, Decision};
use crate::features::Extractor;
use crate::filter::before_change;
use crate::model::{Filtering, Model, Rejecting};
use crate::recording::{Cutter, Recording, Window};
use crate::score::Scored;
use messages::Status;

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
