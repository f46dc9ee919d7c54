//! Every sample that crosses a process boundary: `repr(C)`, no padding, any bytes a valid value.
//!
//! One file a message. Units end the names: `_m`, `_rad`, `_n`, `_nm`, `_pa`, `_m_s`, `_rad_s`, `_m_s2`, `_ns`, `_px`.
//! The Python and C++ twins stand in `python/` and `cpp/`; `tests/layout.rs` compares them with these, offset by offset.

mod frame;
mod header;
mod layout;
mod resumable;
mod sinkage;
mod soil;
mod supervision;
mod terrain;
mod terrain_class;
mod vibration;
mod wheel;

pub use frame::{Frame, PIXELS_MAX};
pub use header::{Header, Status};
pub use layout::{Field, Kind, covers, difference, fingerprint};
pub use resumable::Resumable;
pub use sinkage::Sinkage;
pub use soil::Soil;
pub use supervision::{SERVICES_MAX, ServiceState, Supervision};
pub use terrain::Terrain;
pub use terrain_class::{CLASSES_MAX, TerrainClass};
pub use vibration::{CHANNELS_MAX, SAMPLES_MAX, Vibration};
pub use wheel::Wheel;

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The trait and its derive, both named `ZeroCopySend`.
pub use iceoryx2_bb_derive_macros::ZeroCopySend;
pub use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// A name of at most this many bytes: a class, a channel, a service.
pub const LABEL_BYTES: usize = 24;

/// A short name, filled up with zeros.
pub type Label = [u8; LABEL_BYTES];

/// The name as a [`Label`]; what is longer than [`LABEL_BYTES`] is cut at a character's end.
#[must_use]
pub fn label(name: &str) -> Label {
    let mut bytes = [0; LABEL_BYTES];
    let mut end = name.len().min(LABEL_BYTES);
    while !name.is_char_boundary(end) {
        end -= 1;
    }
    bytes[..end].copy_from_slice(&name.as_bytes()[..end]);
    bytes
}

/// The text of a [`Label`] up to its first zero; empty where the bytes are not UTF-8.
#[must_use]
pub fn label_text(label: &[u8]) -> &str {
    let end = label.iter().position(|byte| *byte == 0).unwrap_or(label.len());
    std::str::from_utf8(&label[..end]).unwrap_or("")
}

/// What a type must be to travel on a wire.
pub trait Message:
    Sized + ZeroCopySend + FromBytes + IntoBytes + Immutable + KnownLayout + std::fmt::Debug + Send + Sync + 'static
{
    /// Name and version: `Wheel/1`. Another layout gets another number.
    const NAME: &'static str;
    /// Names, types and offsets of all fields, in order.
    const FIELDS: &'static [Field];

    /// The sample's header.
    fn header(&self) -> &Header;

    /// The sample's header, to be stamped.
    fn header_mut(&mut self) -> &mut Header;

    /// The values that must be finite and in range wherever the status says so.
    ///
    /// # Errors
    /// Says which value is impossible.
    fn check_values(&self) -> Result<(), &'static str>;

    /// Whether this sample can be believed as far as its status goes.
    ///
    /// # Errors
    /// Says what is impossible in it: an unknown status, or a value that is not finite or out of range.
    fn check(&self) -> Result<(), &'static str> {
        if self.header().status.word().is_none() {
            return Err("unknown status");
        }
        self.check_values()
    }

    /// The layout as text; see [`fingerprint`].
    #[must_use]
    fn fingerprint() -> String {
        fingerprint(Self::NAME, size_of::<Self>(), Self::FIELDS)
    }
}

/// True if `value` is finite and `low ..= high` holds it.
pub(crate) fn within(value: f64, low: f64, high: f64) -> bool {
    value >= low && value <= high
}

/// True if `value` is missing (NaN) or `low ..= high` holds it. Infinite is never right.
pub(crate) fn within_or_missing(value: f64, low: f64, high: f64) -> bool {
    value.is_nan() || within(value, low, high)
}
