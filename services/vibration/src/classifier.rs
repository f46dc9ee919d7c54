//! Vibration in, the class of the terrain out: the stage.

use crate::decision::{Belief, Decider};
use crate::features::Extractor;
use crate::model::{Filtering, Model, Rejecting};
use crate::recording::Window;
use crate::window::{Collector, Progress};
use messages::{CHANNELS_MAX, Header, Message, Resumable, SAMPLES_MAX, Status};
use messages::{TerrainClass, Vibration, label, label_text};
use serde::Deserialize;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The channel that tells whether the vehicle moves.
pub const SPEED_CHANNEL: &str = "linear_velocity_m_s";
/// How far a piece's sampling period may lie from the model's, relative to it.
const PERIOD_TOLERANCE: f64 = 0.02;

/// What the system file sets.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Path of a model file; none: the built-in model of the simulated rover.
    pub model: Option<String>,
    /// Whether the windows before count; none: as the model says.
    pub filter: Option<Filtering>,
    /// Whether a class may be rejected; none: as the model says.
    pub reject: Option<Rejecting>,
}

impl Config {
    /// Checks the ranges.
    ///
    /// # Errors
    /// The key, and what is wrong with its value.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        match &self.model {
            Some(path) if path.is_empty() => Err(("model", "must be the path of a model file, is empty".into())),
            _ => Ok(()),
        }
    }
}

/// Collects pieces of vibration into windows and classifies each of them.
pub struct VibrationClassifier {
    decider: Decider,
    collector: Collector,
    extractor: Extractor,
    window: Window,
    /// Where the model's channels, then the speed, stand in a piece.
    places: [Option<usize>; CHANNELS_MAX + 1],
    decided: TerrainClass,
}

impl VibrationClassifier {
    /// For a validated configuration and model.
    #[must_use]
    pub fn new(config: &Config, model: Model) -> Self {
        let mut decided = TerrainClass::undecided(Header {
            status: Status::WARMING_UP,
            ..Header::default()
        });
        decided.class_count = model.labels.len() as u32;
        decided.window_ns = (model.window_s() * 1e9).round() as u64;
        for (name, text) in decided.labels.iter_mut().zip(&model.labels) {
            *name = label(text);
        }
        let extractor = Extractor::new(model.features.clone(), model.window_samples, model.rate_hz);
        Self {
            collector: Collector::new(model.channels.len() + 1, model.window_samples, 1e9 / model.rate_hz),
            window: Window::prepared(&extractor),
            extractor,
            places: [None; CHANNELS_MAX + 1],
            decided,
            decider: Decider::new(model, config.filter, config.reject),
        }
    }

    /// Answers one piece: with the decision on the last full window, or why there is none.
    pub fn step(&mut self, piece: &Vibration) -> TerrainClass {
        let status = match piece.header.status {
            Status::BAD_SAMPLE => Some(Status::INPUT_REJECTED),
            _ if piece.count == 0 => Some(Status::NO_DATA),
            _ if !self.fits(piece) => Some(Status::INPUT_REJECTED),
            _ => None,
        };
        if let Some(status) = status {
            self.collector.clear();
            self.forget(status);
        } else {
            self.collect(piece);
        }
        TerrainClass {
            header: piece.header.answer(self.decided.header.status),
            ..self.decided
        }
    }

    /// What of a piece does not fit the model, as text for a person.
    ///
    /// # Errors
    /// Says what differs, and what the model was trained with.
    pub fn check_fit(&self, piece: &Vibration) -> Result<(), String> {
        let period_ns = 1e9 / self.decider.model().rate_hz;
        if (piece.period_ns as f64 - period_ns).abs() > PERIOD_TOLERANCE * period_ns {
            return Err(format!(
                "the model was trained at {} Hz, the vibration comes at {:.3} Hz",
                self.decider.model().rate_hz,
                1e9 / piece.period_ns.max(1) as f64
            ));
        }
        let offered = &piece.channels[..channel_count(piece)];
        for name in &self.decider.model().channels {
            if !offered.iter().any(|label| label_text(label) == name) {
                let names: Vec<&str> = offered.iter().map(|label| label_text(label)).collect();
                return Err(format!(
                    "the model needs the channel {name}, the vibration has {}",
                    names.join(", ")
                ));
            }
        }
        Ok(())
    }

    /// Finds the model's channels in the piece; false where one is missing or the rate differs.
    fn fits(&mut self, piece: &Vibration) -> bool {
        let period_ns = 1e9 / self.decider.model().rate_hz;
        if (piece.period_ns as f64 - period_ns).abs() > PERIOD_TOLERANCE * period_ns {
            return false;
        }
        let offered = &piece.channels[..channel_count(piece)];
        let channels = &self.decider.model().channels;
        let names = channels.iter().map(String::as_str).chain([SPEED_CHANNEL]);
        for (place, name) in self.places.iter_mut().zip(names) {
            *place = offered.iter().position(|label| label_text(label) == name);
        }
        self.places[..channels.len()].iter().all(Option::is_some)
    }

    fn collect(&mut self, piece: &Vibration) {
        let places = self.places;
        for index in 0..(piece.count as usize).min(SAMPLES_MAX) {
            let taken_ns = piece.start_ns.saturating_add(u64::from(piece.offset_ns[index]));
            let slots = self.collector.advance(taken_ns);
            for slot in 0..slots {
                let measured = slot + 1 == slots;
                let full = self.collector.place(taken_ns, |channel| match places[channel] {
                    Some(place) if measured => f64::from(piece.samples[place][index]),
                    _ => f64::NAN,
                });
                if full {
                    self.classify();
                }
            }
        }
    }

    /// Decides on the full window.
    fn classify(&mut self) {
        self.decided.windows = self.decided.windows.saturating_add(1);
        let channels = &self.decider.model().channels;
        self.window.measure(&mut self.collector, &mut self.extractor, channels);
        self.decided.start_ns = self.window.start_ns;
        let decision = match self.decider.decide(&self.window) {
            Ok(decision) => decision,
            Err(status) => return self.forget(status),
        };
        self.decided.class = decision.class as u32;
        self.decided.unknown = u32::from(decision.unknown);
        self.decided.metric = decision.metric;
        self.decided.probability = decision.probability;
        self.decided.header.status = if decision.unknown {
            Status::UNKNOWN_TERRAIN
        } else {
            Status::OK
        };
    }

    /// Leaves nothing decided.
    fn forget(&mut self, status: Status) {
        self.decided.header.status = status;
        self.decided.class = 0;
        self.decided.unknown = 1;
        self.decided.metric = f64::NAN;
        self.decided.probability.fill(f64::NAN);
    }
}

/// What goes from step to step, as plain bytes; the values collected so far follow.
#[derive(FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct State {
    decided: TerrainClass,
    belief: Belief,
    progress: Progress,
}

impl Resumable for VibrationClassifier {
    fn state_bytes(&self) -> usize {
        size_of::<State>() + size_of_val(self.collector.progress().1)
    }

    fn save(&self, state: &mut [u8]) {
        let (progress, values) = self.collector.progress();
        let head = State {
            decided: self.decided,
            belief: self.decider.belief(),
            progress,
        };
        let (start, end) = state.split_at_mut(size_of::<State>());
        start.copy_from_slice(head.as_bytes());
        end.copy_from_slice(values.as_bytes());
    }

    fn restore(&mut self, state: &[u8]) -> Result<(), &'static str> {
        let (head, values) = State::read_from_prefix(state).map_err(|_| "is of another length")?;
        let (values, rest) = values.as_chunks();
        let values: Vec<f64> = values.iter().map(|value| f64::from_ne_bytes(*value)).collect();
        head.decided.check()?;
        if !rest.is_empty() || head.decided.labels != self.decided.labels || !head.belief.is_sound() {
            return Err("is of another model");
        }
        self.collector.set(&head.progress, &values)?;
        self.decider.believe(&head.belief);
        self.decided = head.decided;
        Ok(())
    }
}

fn channel_count(piece: &Vibration) -> usize {
    (piece.channel_count as usize).min(CHANNELS_MAX)
}
