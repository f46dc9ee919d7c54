//! Wheel and vibration ingest: from a simulated rover or a recorded traverse.

mod recording;
mod sinkage;
mod vibration;
mod wheel;

pub use recording::{Files, Recording};
pub use sinkage::SINKAGE_COLUMNS;
pub use wheel::WHEEL_COLUMNS;

use messages::{Sinkage, Vibration, Wheel};

/// A piece of vibration covers this long at the most [ns].
pub const PIECE_NS: u64 = 100_000_000;

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
