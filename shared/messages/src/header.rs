//! What every sample starts with: when, which, from which start of the writer, and how far to trust it.

use crate::ZeroCopySend;
use crate::{Field, Kind};
use std::mem::offset_of;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The first 32 bytes of every sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout, ZeroCopySend)]
#[repr(C)]
#[type_name("terrasense/Header/1")]
pub struct Header {
    /// Sensor instant [ns]: `CLOCK_MONOTONIC` on board, the recording's own clock in a replay. Copied from the
    /// triggering input by every stage.
    pub taken_ns: u64,
    /// `CLOCK_MONOTONIC` [ns] when the writer sent this sample. Written by the shell.
    pub published_ns: u64,
    /// Number of the cycle. Copied from the triggering input by every stage.
    pub sequence: u64,
    /// Starts of the writer so far: a change tells the reader of a restart or a swap. Written by the shell.
    pub generation: u32,
    /// How far to trust the sample.
    pub status: Status,
}

const _: () = assert!(size_of::<Header>() == 32);

impl Header {
    /// Names, types and offsets of the fields.
    pub const FIELDS: &[Field] = &[
        Field::new("taken_ns", offset_of!(Self, taken_ns), Kind::U64),
        Field::new("published_ns", offset_of!(Self, published_ns), Kind::U64),
        Field::new("sequence", offset_of!(Self, sequence), Kind::U64),
        Field::new("generation", offset_of!(Self, generation), Kind::U32),
        Field::new("status", offset_of!(Self, status), Kind::Status),
    ];

    /// The header of the answer to a triggering input: its instant and its number, with the answer's own status.
    #[must_use]
    pub fn answer(&self, status: Status) -> Self {
        Self {
            taken_ns: self.taken_ns,
            published_ns: 0,
            sequence: self.sequence,
            generation: 0,
            status,
        }
    }
}

/// What a sample says of itself. An open enum: a number that is not listed here marks a sample as bad.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, FromBytes, IntoBytes, Immutable, KnownLayout, ZeroCopySend,
)]
#[repr(C)]
#[type_name("terrasense/Status/1")]
pub struct Status(pub u32);

impl Status {
    /// The values answer the question.
    pub const OK: Self = Self(0);
    /// Too little data so far for an answer.
    pub const WARMING_UP: Self = Self(1);
    /// A best guess whose sigma is large.
    pub const UNCERTAIN: Self = Self(2);
    /// The wheel, or its contact with the ground, cannot be seen.
    pub const NOT_VISIBLE: Self = Self(3);
    /// The geometry given with the picture contradicts itself or the picture.
    pub const BAD_GEOMETRY: Self = Self(4);
    /// Cohesion and friction angle cannot be told apart from this data; the strength still holds.
    pub const NOT_OBSERVABLE: Self = Self(5);
    /// The data do not follow the model.
    pub const LACK_OF_FIT: Self = Self(6);
    /// This stage could not use the input; the answer repeats what was known before, or is NaN.
    pub const INPUT_REJECTED: Self = Self(7);
    /// The input's bytes made no valid sample (not finite, out of range, unknown status). Written by the shell.
    pub const BAD_SAMPLE: Self = Self(8);
    /// The sensor delivered nothing for this interval.
    pub const NO_DATA: Self = Self(9);
    /// Some of the measured values are missing (NaN).
    pub const INCOMPLETE: Self = Self(10);
    /// The rover stands still.
    pub const STANDING_STILL: Self = Self(11);
    /// No known class of terrain.
    pub const UNKNOWN_TERRAIN: Self = Self(12);
    /// A channel is saturated or dead.
    pub const SENSOR_FAULT: Self = Self(13);
    /// The recording is over; nothing follows on this wire.
    pub const ENDED: Self = Self(14);

    const WORDS: [&str; 15] = [
        "ok",
        "warming_up",
        "uncertain",
        "not_visible",
        "bad_geometry",
        "not_observable",
        "lack_of_fit",
        "input_rejected",
        "bad_sample",
        "no_data",
        "incomplete",
        "standing_still",
        "unknown_terrain",
        "sensor_fault",
        "ended",
    ];

    /// The status as a word, `None` for a number that has no meaning.
    #[must_use]
    pub fn word(self) -> Option<&'static str> {
        Self::WORDS.get(self.0 as usize).copied()
    }

    /// True where the values are an answer: `OK`, or the best guess of `UNCERTAIN`.
    #[must_use]
    pub fn is_answer(self) -> bool {
        self == Self::OK || self == Self::UNCERTAIN
    }
}
