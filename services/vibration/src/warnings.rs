//! What limits a trained model, for the person who made the recordings.

use crate::calibrate::Validated;
use crate::recording::Recording;
use crate::train::{Setup, Trained, quantile};
use crate::window::Quality;

/// Windows of a class below which it is called small.
const WINDOWS_FEW: usize = 60;
/// Share of a class's windows that may stand still, or be unusable, without a word.
const STILL_SHARE: f64 = 0.25;
/// Share of all windows that may be unusable without a word.
const FAULTY_SHARE: f64 = 0.01;
/// Share of right decisions below which a recording is named.
const RIGHT_FEW: f64 = 0.5;
/// Recordings that are named at the most.
const NAMED_MAX: usize = 5;

/// All warnings, the recordings' first.
#[must_use]
pub fn warnings(setup: &Setup, recordings: &[Recording], trained: &Trained) -> Vec<String> {
    let mut found = Vec::new();
    for class in 0..setup.labels.len() {
        of_class(setup, recordings, trained, class, &mut found);
    }
    let windows = trained.windows.iter().filter(|window| window.scored);
    let count = windows.clone().count();
    for (quality, what) in [
        (Quality::Faulty, "have a dead or saturated channel"),
        (Quality::Incomplete, "miss too many samples"),
        (Quality::WrongRate, "hold more samples than the rate allows"),
    ] {
        let bad = windows.clone().filter(|window| window.quality == quality).count();
        if bad as f64 > FAULTY_SHARE * count as f64 {
            found.push(format!("{bad} of {count} windows {what}; they are left out"));
        }
    }
    if trained.windows.iter().all(|window| window.speed_m_s.is_nan()) {
        found.push("no speed (linear_velocity_m_s): windows of a vehicle that stands cannot be left out".into());
    }
    speeds_apart(setup, recordings, trained, &mut found);
    weak_recordings(recordings, &trained.validated, &mut found);
    found
}

fn of_class(setup: &Setup, recordings: &[Recording], trained: &Trained, class: usize, found: &mut Vec<String>) {
    let label = &setup.labels[class];
    let mut runs: Vec<&str> = Vec::new();
    for recording in recordings.iter().filter(|recording| recording.class == class) {
        if !runs.contains(&recording.run.as_str()) {
            runs.push(&recording.run);
        }
    }
    if runs.len() == 1 {
        found.push(format!(
            "{label} has one run: cross-validation cuts it into parts and flatters the model; record it again, at \
             another place and speed"
        ));
    }
    let windows = trained
        .windows
        .iter()
        .filter(|window| window.scored && recordings[window.recording].class == class);
    let (count, still) = windows.fold((0, 0), |(count, still), window| {
        (count + 1, still + usize::from(trained.model.speed.stands_still(window)))
    });
    if count - still < WINDOWS_FEW {
        found.push(format!(
            "{label} has {} windows of a moving vehicle; 100 or more are better",
            count - still
        ));
    }
    if still as f64 > STILL_SHARE * count as f64 {
        found.push(format!(
            "{label}: the vehicle stands still in {still} of {count} windows; they are left out"
        ));
    }
}

/// Speeds of two classes that do not overlap: the model may tell speeds apart where it should tell terrains.
fn speeds_apart(setup: &Setup, recordings: &[Recording], trained: &Trained, found: &mut Vec<String>) {
    let range = |class: usize| {
        let moving = trained.windows.iter().filter(|window| {
            recordings[window.recording].class == class && window.speed_m_s.abs() >= trained.model.speed.still_m_s
        });
        let speeds: Vec<f64> = moving.map(|window| window.speed_m_s.abs()).collect();
        Some((quantile(speeds.clone(), 0.1)?, quantile(speeds, 0.9)?))
    };
    for (a, b) in crate::model::class_pairs(setup.labels.len()) {
        let (Some(first), Some(second)) = (range(a), range(b)) else {
            continue;
        };
        if first.1 < second.0 || second.1 < first.0 {
            found.push(format!(
                "the speeds of {} ({:.2} to {:.2} m/s) and {} ({:.2} to {:.2} m/s) do not overlap: the model may tell the \
                 speeds apart, not the terrains",
                setup.labels[a], first.0, first.1, setup.labels[b], second.0, second.1
            ));
        }
    }
}

/// Recordings that the models trained without them mostly get wrong: nothing else in the data resembles them.
fn weak_recordings(recordings: &[Recording], validated: &[Validated], found: &mut Vec<String>) {
    let mut weak: Vec<(usize, usize, &str)> = Vec::new();
    for (index, recording) in recordings.iter().enumerate() {
        let own = validated.iter().filter(|window| window.recording == index);
        let (count, right) = own.fold((0, 0), |(count, right), window| {
            (count + 1, right + usize::from(window.alone.class == window.alone.truth))
        });
        if (right as f64) < RIGHT_FEW * f64::from(count) {
            weak.push((count as usize - right, count as usize, &recording.run));
        }
    }
    weak.sort_by_key(|(wrong, _, _)| std::cmp::Reverse(*wrong));
    for (wrong, count, name) in weak.into_iter().take(NAMED_MAX) {
        found.push(format!(
            "{name}: {wrong} of {count} windows are taken for another class when it is left out; no other recording of its \
             class is like it"
        ));
    }
}
