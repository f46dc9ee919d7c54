//! Camera ingest: frames from a simulated rover or a recorded traverse.

mod decode;
mod picture;
mod recorded;

pub use picture::PictureReader;
pub use recorded::RecordedCamera;

use messages::{Frame, Header, Status};
use serde::Deserialize;
use simulation::Rover;

/// Where the frames come from.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "source", rename_all = "lowercase", deny_unknown_fields)]
pub enum Config {
    /// A simulated rover, in real time.
    Simulated {
        /// Frames a second.
        #[serde(default = "default_rate_hz")]
        rate_hz: f64,
        /// The rover; `telemetry` must be given the same.
        #[serde(default)]
        rover: simulation::Config,
    },
    /// A traverse, as fast as its readers go.
    Recorded {
        /// The traverse folder.
        folder: String,
    },
}

fn default_rate_hz() -> f64 {
    30.0
}

impl Config {
    /// Checks what the types leave open.
    ///
    /// # Errors
    /// The key, and what is wrong with its value.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        match self {
            Self::Simulated { rate_hz, .. } if !(0.1..=1000.0).contains(rate_hz) => {
                Err(("rate_hz", format!("must be 0.1 to 1000, is {rate_hz}")))
            }
            Self::Simulated { rover, .. } => rover
                .validate()
                .map_err(|(key, what)| ("rover", format!("{key} {what}"))),
            Self::Recorded { .. } => Ok(()),
        }
    }
}

/// The camera of a simulated rover.
pub struct SimulatedCamera {
    rover: Rover,
    period_ns: u64,
    started_ns: u64,
}

impl SimulatedCamera {
    /// The camera of a rover in a system that started at `started_ns`.
    #[must_use]
    pub fn new(rover: simulation::Config, rate_hz: f64, started_ns: u64) -> Self {
        Self {
            rover: Rover::new(rover),
            period_ns: (1e9 / rate_hz).round() as u64,
            started_ns,
        }
    }

    /// Time from one frame to the next.
    #[must_use]
    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// Fills a frame, the first of all being number 0.
    pub fn fill(&self, number: u64, frame: &mut Frame) {
        let elapsed_ns = number.saturating_mul(self.period_ns);
        self.rover.render(elapsed_ns as f64 / 1e9, frame);
        frame.header = Header {
            taken_ns: self.started_ns.saturating_add(elapsed_ns),
            sequence: number,
            status: Status::OK,
            ..Header::default()
        };
    }
}
