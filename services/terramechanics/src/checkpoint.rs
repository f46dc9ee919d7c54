//! The whole state of the estimator as plain bytes, so that another process continues where this one stopped.

use crate::Config;
use crate::full::FullEstimator;
use crate::paper::PaperEstimator;
use crate::row::Wheels;
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

/// Counts up with every change of the state's layout or meaning.
const VERSION: u64 = 1;

/// Everything that changes from step to step.
#[derive(Clone, Copy, Debug, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct State {
    pub(crate) wheels: Wheels,
    pub(crate) paper: PaperEstimator,
    pub(crate) full: FullEstimator,
}

/// A state with what proves that it is one: any bytes may be read as a checkpoint, and only a good one is restored.
#[derive(Clone, Copy, Debug, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Checkpoint {
    version: u64,
    /// Of the configuration: another wheel or other sensors make the state meaningless.
    config_digest: u64,
    state: State,
    state_digest: u64,
}

const _: () = assert!(size_of::<Checkpoint>().is_multiple_of(8));

impl Checkpoint {
    pub(crate) fn of(state: &State, config_digest: u64) -> Self {
        Self {
            version: VERSION,
            config_digest,
            state: *state,
            state_digest: digest(state.as_bytes()),
        }
    }

    /// The state, if it is one of this estimator and of this configuration.
    pub(crate) fn state(&self, config_digest: u64) -> Result<&State, &'static str> {
        if self.version != VERSION {
            return Err("is of another version of the estimator");
        }
        if self.config_digest != config_digest {
            return Err("is of another configuration");
        }
        if self.state_digest != digest(self.state.as_bytes()) {
            return Err("is damaged");
        }
        if !self.state.full.is_sound() {
            return Err("holds a state that cannot be");
        }
        Ok(&self.state)
    }
}

impl State {
    /// Nothing is known yet.
    pub(crate) fn new_boxed() -> Box<Self> {
        // Never fails but for want of memory, and then nothing helps; a state on the stack would be moved.
        Self::new_box_zeroed().unwrap_or_else(|_| Box::new(Self::new_zeroed()))
    }
}

/// What tells one configuration from another.
pub(crate) fn config_digest(config: &Config) -> u64 {
    digest(format!("{config:?}").as_bytes())
}

/// FNV-1a over words of eight bytes: against damage, not against intent.
fn digest(bytes: &[u8]) -> u64 {
    let (words, rest) = bytes.as_chunks::<8>();
    let rest = rest.iter().map(|byte| u64::from(*byte));
    words
        .iter()
        .map(|word| u64::from_le_bytes(*word))
        .chain(rest)
        .fold(0xcbf2_9ce4_8422_2325, |digest, word| {
            (digest ^ word).wrapping_mul(0x0100_0000_01b3)
        })
}
