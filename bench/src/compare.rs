//! One estimation cycle over any middleware: the same input, the same stage libs and the same stamps; only what lies between
//! the processes differs. What differs, a [`Transport`] supplies.

mod feed;
mod part;
mod stamps;

pub use feed::{CYCLE_NS, FRAME_BYTES, Feed, write_frame};
pub use part::{Pace, Part, Role, play, play_source};
pub use stamps::{Point, SPANS, Stamps};

use crate::Outcome;
use messages::{Frame, Header, Sinkage, Soil, Terrain, Wheel};
use std::time::Duration;

/// The longest wait for a sample: then who waits looks at what else there is to do.
pub const WAIT_MAX: Duration = Duration::from_secs(1);

/// A wire that a process reads.
pub trait Read<T> {
    /// Hands every sample, once it is there, to `act`, until that returns false; `None` after [`WAIT_MAX`] without one.
    ///
    /// # Errors
    /// The wire is broken, or `act` failed.
    fn each(&mut self, act: &mut dyn FnMut(Option<&T>) -> Outcome<bool>) -> Outcome<()>;

    /// Hands the next sample to `act`, if there is one. False where there is none.
    ///
    /// # Errors
    /// The wire is broken.
    fn poll(&mut self, act: &mut dyn FnMut(&T)) -> Outcome<bool>;
}

/// A wire that a process writes.
pub trait Write<T> {
    /// Sends a sample to every reader.
    ///
    /// # Errors
    /// The wire is broken.
    fn send(&mut self, sample: &T) -> Outcome<()>;
}

/// The wire that the source writes pictures to.
pub trait WriteFrames {
    /// Writes a picture where the middleware sends from, takes the instant at which it is complete there [ns], sends it,
    /// and returns that instant.
    ///
    /// # Errors
    /// The wire is broken.
    fn send(&mut self, header: Header, picture: &[u8]) -> Outcome<u64>;
}

/// The source's ends of the wires. It reads the terrain, as a rover's control would.
pub struct SourceEnds {
    /// Wheel readings out.
    pub wheel: Box<dyn Write<Wheel>>,
    /// Pictures out.
    pub frames: Box<dyn WriteFrames>,
    /// What is known after each cycle.
    pub terrain: Box<dyn Read<Terrain>>,
}

/// The ends of the sinkage stage.
pub struct SinkageEnds {
    /// What triggers it.
    pub frames: Box<dyn Read<Frame>>,
    /// Its answer.
    pub sinkage: Box<dyn Write<Sinkage>>,
}

/// The ends of the terramechanics stage.
pub struct TerramechanicsEnds {
    /// What triggers it.
    pub sinkage: Box<dyn Read<Sinkage>>,
    /// What it observes.
    pub wheel: Box<dyn Read<Wheel>>,
    /// Its answer.
    pub soil: Box<dyn Write<Soil>>,
}

/// The ends of the terrain stage.
pub struct TerrainEnds {
    /// What triggers it.
    pub soil: Box<dyn Read<Soil>>,
    /// What it observes.
    pub sinkage: Box<dyn Read<Sinkage>>,
    /// Its answer.
    pub terrain: Box<dyn Write<Terrain>>,
}

/// A middleware, as one process of the cycle uses it.
pub trait Transport {
    /// Opens the source's ends.
    ///
    /// # Errors
    /// A wire cannot be had.
    fn source(&self) -> Outcome<SourceEnds>;

    /// Opens those of the sinkage stage.
    ///
    /// # Errors
    /// A wire cannot be had.
    fn sinkage(&self) -> Outcome<SinkageEnds>;

    /// Opens those of the terramechanics stage.
    ///
    /// # Errors
    /// A wire cannot be had.
    fn terramechanics(&self) -> Outcome<TerramechanicsEnds>;

    /// Opens those of the terrain stage.
    ///
    /// # Errors
    /// A wire cannot be had.
    fn terrain(&self) -> Outcome<TerrainEnds>;
}
