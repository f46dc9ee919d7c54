//! Wheel and vibration ingest: from a simulated rover or a recorded traverse.

mod recording;
mod simulated;
mod sinkage;
mod vibration;
mod wheel;

pub use recording::{Files, Recording};
pub use simulated::SimulatedTelemetry;

use messages::{Sinkage, Vibration, Wheel};
use serde::Deserialize;

/// A piece of vibration covers this long at the most [ns].
pub const PIECE_NS: u64 = 100_000_000;

/// Where the samples come from.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "source", rename_all = "lowercase", deny_unknown_fields)]
pub enum Config {
    /// A simulated rover, in real time.
    Simulated {
        /// The rover; `camera` must be given the same.
        #[serde(default)]
        rover: simulation::Config,
    },
    /// A traverse, as fast as its readers go.
    Recorded {
        /// The traverse folder.
        folder: String,
    },
}

/// A sample, and so the wire on which it travels.
#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// What the wheel feels.
    Wheel(Wheel),
    /// Sinkage that was measured without a camera.
    Sinkage(Sinkage),
    /// A piece of vibration.
    Vibration(&'a Vibration),
}

impl Config {
    /// Checks what the types leave open.
    ///
    /// # Errors
    /// The key, and what is wrong with its value.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        match self {
            Self::Simulated { rover } => rover
                .validate()
                .map_err(|(key, what)| ("rover", format!("{key} {what}"))),
            Self::Recorded { .. } => Ok(()),
        }
    }
}
