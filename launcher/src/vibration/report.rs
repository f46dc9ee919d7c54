//! How good a model is, for people and for programs.

use super::recordings::Recordings;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::{self, Display, Write};
use vibration::Model;
use vibration::evaluate::Judged;
use vibration::score::{Scored, balanced, balanced_accuracy, calibration_error, confusion};

/// Width of a column of the confusion matrix.
const WIDTH: usize = 11;

/// The figures of decisions on windows whose class is known.
pub struct Report {
    labels: Vec<String>,
    windows: usize,
    /// Truth in the rows; the chosen classes in the columns, the last one for the unknown.
    confusion: Vec<Vec<usize>>,
    balanced_accuracy: f64,
    unknown_share: f64,
    wrong_share: f64,
    calibration_error: f64,
    /// Of terrains that the model does not know: windows, and the share of them that was rejected.
    foreign: Option<(usize, f64)>,
}

impl Report {
    /// Of decisions among the labelled classes.
    pub fn new(labels: &[String], scored: &[Scored]) -> Self {
        Self::of_known(labels, labels.len(), scored)
    }

    /// Of decisions among the first `known` of the labelled classes: the others are terrains that the model has not seen.
    pub fn of_known(labels: &[String], known: usize, scored: &[Scored]) -> Self {
        let (own, foreign): (Vec<Scored>, Vec<Scored>) = scored.iter().partition(|window| window.truth < known);
        let rejected = foreign.iter().filter(|window| window.unknown).count() as f64;
        Self {
            labels: labels[..known].to_vec(),
            windows: own.len(),
            confusion: confusion(&own, known),
            balanced_accuracy: balanced_accuracy(&own, known),
            unknown_share: balanced(&own, known, |window| window.unknown),
            wrong_share: balanced(&own, known, |window| !window.unknown && window.class != window.truth),
            calibration_error: calibration_error(&own),
            foreign: (!foreign.is_empty()).then(|| (foreign.len(), rejected / foreign.len() as f64)),
        }
    }

    /// For programs.
    pub fn to_json(&self) -> Value {
        json!({
            "windows": self.windows,
            "labels": self.labels,
            "confusion": self.confusion,
            "balanced_accuracy": self.balanced_accuracy,
            "unknown_share": self.unknown_share,
            "wrong_share": self.wrong_share,
            "calibration_error": self.calibration_error,
            "foreign_windows": self.foreign.map_or(0, |foreign| foreign.0),
            "foreign_rejected_share": self.foreign.map(|foreign| foreign.1),
        })
    }

    /// The confusion that costs most: true class, chosen class, and its share of the true one's windows.
    fn worst(&self) -> Option<(usize, usize, f64)> {
        let mut worst: Option<(usize, usize, f64)> = None;
        for (truth, counts) in self.confusion.iter().enumerate() {
            let all = counts.iter().sum::<usize>() as f64;
            for (chosen, count) in counts[..self.labels.len()].iter().enumerate() {
                let share = *count as f64 / all.max(1.0);
                if chosen != truth && share > worst.map_or(0.0, |worst| worst.2) {
                    worst = Some((truth, chosen, share));
                }
            }
        }
        worst
    }
}

impl Display for Report {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let short = |name: &str| name.chars().take(WIDTH - 1).collect::<String>();
        write!(out, "{:WIDTH$}", "")?;
        for label in &self.labels {
            write!(out, "{:>WIDTH$}", short(label))?;
        }
        writeln!(out, "{:>WIDTH$}", "unknown")?;
        for (label, counts) in self.labels.iter().zip(&self.confusion) {
            write!(out, "{:WIDTH$}", short(label))?;
            for count in counts {
                write!(out, "{count:>WIDTH$}")?;
            }
            writeln!(out)?;
        }
        writeln!(
            out,
            "{} windows; balanced accuracy {:.3} if none is rejected; {:.1} % unknown, {:.1} % wrong; calibration error {:.3}",
            self.windows,
            self.balanced_accuracy,
            100.0 * self.unknown_share,
            100.0 * self.wrong_share,
            self.calibration_error
        )?;
        if let Some((truth, chosen, share)) = self.worst() {
            writeln!(
                out,
                "what limits it most: {:.0} % of {} is taken for {}",
                100.0 * share,
                self.labels[truth],
                self.labels[chosen]
            )?;
        }
        if let Some((windows, share)) = self.foreign {
            writeln!(
                out,
                "{windows} windows of terrains that the model does not know: {:.1} % rejected",
                100.0 * share
            )?;
        }
        Ok(())
    }
}

/// The table of all windows: of those on which nothing was decided, the reason stands in the place of the class.
pub fn predictions(model: &Model, read: &Recordings, judged: &[Judged]) -> String {
    let mut table = String::from("run,start_s,class,predicted");
    for label in &model.labels {
        table += &format!(",probability_{label}");
    }
    table += ",metric\n";
    for Judged { window, decision } in judged {
        let recording = &read.all[window.recording];
        let start_s = window.start_ns as f64 / 1e9;
        let _ = write!(table, "{},{start_s},{},", recording.run, read.labels[recording.class]);
        match decision {
            Ok(decision) => {
                table += match decision.unknown {
                    true => "unknown",
                    false => &model.labels[decision.class],
                };
                for probability in &decision.probability[..model.labels.len()] {
                    let _ = write!(table, ",{probability:.6}");
                }
                let _ = writeln!(table, ",{:.6}", decision.metric);
            }
            Err(status) => {
                table += status.word().unwrap_or("");
                let _ = writeln!(table, "{}", ",".repeat(model.labels.len() + 1));
            }
        }
    }
    table
}

/// Why windows were not scored, and how many.
pub fn left_out(judged: &[Judged]) -> BTreeMap<&'static str, usize> {
    let mut counts = BTreeMap::new();
    for status in judged.iter().filter_map(|window| window.decision.err()) {
        *counts.entry(status.word().unwrap_or("")).or_default() += 1;
    }
    counts
}
