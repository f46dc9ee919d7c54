//! The traverse folder, recorded input anyone can make: its tables and its description.
//!
//! `camera` reads the frames, `telemetry` the rest, `terrasense simulate` writes one. Nothing here opens a file: readers
//! are handed in, with the name that errors give.

mod description;
mod frames;
mod sampling;
mod table;

pub use description::{Rolls, Sensors, Soil, Traverse, Vibration, Wheel};
pub use frames::{FRAME_COLUMNS, FrameRow, FrameRows};
pub use sampling::{SOUND_CHANNELS, sampling_period_ns};
pub use table::{GAP_MAX_S, Table};

use std::fmt;

/// The columns of `wheel.csv`. The last one, the slip, may be absent.
pub const WHEEL_COLUMNS: [&str; 6] = [
    "taken_s",
    "load_n",
    "torque_nm",
    "angular_velocity_rad_s",
    "linear_velocity_m_s",
    "slip",
];

/// The columns of `sinkage.csv`.
pub const SINKAGE_COLUMNS: [&str; 3] = ["taken_s", "entry_rad", "exit_rad"];

/// An open file of the folder.
pub type Input = Box<dyn std::io::Read + Send>;

/// What is wrong in a file of the folder, where, and what to write instead.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputError {
    /// The file, as the caller named it.
    pub file: String,
    /// The line, counted from 1; 0 where the whole file is meant.
    pub line: u64,
    /// What is wrong, and the remedy.
    pub what: String,
}

impl InputError {
    /// An error at a line of a file; line 0 means the whole file.
    #[must_use]
    pub fn new(file: &str, line: u64, what: impl Into<String>) -> Self {
        Self {
            file: file.into(),
            line,
            what: what.into(),
        }
    }
}

impl fmt::Display for InputError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => write!(out, "{}: {}", self.file, self.what),
            line => write!(out, "{}:{line}: {}", self.file, self.what),
        }
    }
}

impl std::error::Error for InputError {}

impl From<InputError> for String {
    fn from(error: InputError) -> Self {
        error.to_string()
    }
}
