//! How the process set is doing: a row a service, from the launcher.

use crate::ZeroCopySend;
use crate::{Field, Header, Kind, LABEL_BYTES, Label, Message};
use std::mem::offset_of;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Services of a system at the most.
pub const SERVICES_MAX: usize = 32;

/// The launcher's table of services.
#[derive(Clone, Debug, FromBytes, IntoBytes, Immutable, KnownLayout, ZeroCopySend)]
#[repr(C)]
#[type_name("terrasense/Supervision/1")]
pub struct Supervision {
    /// What every sample starts with.
    pub header: Header,
    /// The launcher's process.
    pub launcher_pid: u32,
    /// Rows that have a meaning, at most [`SERVICES_MAX`].
    pub service_count: u32,
    /// Names.
    pub name: [Label; SERVICES_MAX],
    /// Process numbers; 0 where none runs.
    pub pid: [u32; SERVICES_MAX],
    /// States; see [`ServiceState`].
    pub state: [u32; SERVICES_MAX],
    /// Starts so far, the first included.
    pub generation: [u32; SERVICES_MAX],
    /// Restarts so far.
    pub restarts: [u32; SERVICES_MAX],
    /// Samples published on all outputs so far, as their sequences tell.
    pub published: [u64; SERVICES_MAX],
    /// Cycles that are missing between the first and the last output, as their sequences tell.
    pub lost: [u64; SERVICES_MAX],
    /// Outputs that answer an input that made no valid sample.
    pub bad: [u64; SERVICES_MAX],
    /// Cycles that were later than the system's deadline for the first time at an output of this service.
    pub missed: [u64; SERVICES_MAX],
    /// Outputs per second over the last seconds.
    pub rate_hz: [f64; SERVICES_MAX],
    /// From the triggering input to the output, median of the last cycles.
    pub latency_p50_ns: [u64; SERVICES_MAX],
    /// The same, 99th percentile.
    pub latency_p99_ns: [u64; SERVICES_MAX],
}

const _: () = assert!(size_of::<Supervision>() == 40 + 32 * (24 + 4 * 4 + 8 * 7));
const _: () = assert!(crate::covers(Supervision::FIELDS, size_of::<Supervision>()));

/// What a service is doing. An open enum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ServiceState(pub u32);

impl ServiceState {
    /// Started, and its wires not all open yet.
    pub const STARTING: Self = Self(0);
    /// All its wires are open.
    pub const RUNNING: Self = Self(1);
    /// Ended; a restart is due after a pause.
    pub const BACKOFF: Self = Self(2);
    /// Ended too often; the launcher has given it up.
    pub const GIVEN_UP: Self = Self(3);
    /// Ended as it should.
    pub const STOPPED: Self = Self(4);

    const WORDS: [&str; 5] = ["starting", "running", "backoff", "given_up", "stopped"];

    /// The state as a word, `None` for a number that has no meaning.
    #[must_use]
    pub fn word(self) -> Option<&'static str> {
        Self::WORDS.get(self.0 as usize).copied()
    }
}

impl Message for Supervision {
    const NAME: &'static str = "Supervision/1";
    const FIELDS: &'static [Field] = &[
        Field::new("header", offset_of!(Self, header), Kind::Header),
        Field::new("launcher_pid", offset_of!(Self, launcher_pid), Kind::U32),
        Field::new("service_count", offset_of!(Self, service_count), Kind::U32),
        Field::array("name", offset_of!(Self, name), Kind::Text(LABEL_BYTES), SERVICES_MAX),
        Field::array("pid", offset_of!(Self, pid), Kind::U32, SERVICES_MAX),
        Field::array("state", offset_of!(Self, state), Kind::U32, SERVICES_MAX),
        Field::array("generation", offset_of!(Self, generation), Kind::U32, SERVICES_MAX),
        Field::array("restarts", offset_of!(Self, restarts), Kind::U32, SERVICES_MAX),
        Field::array("published", offset_of!(Self, published), Kind::U64, SERVICES_MAX),
        Field::array("lost", offset_of!(Self, lost), Kind::U64, SERVICES_MAX),
        Field::array("bad", offset_of!(Self, bad), Kind::U64, SERVICES_MAX),
        Field::array("missed", offset_of!(Self, missed), Kind::U64, SERVICES_MAX),
        Field::array("rate_hz", offset_of!(Self, rate_hz), Kind::F64, SERVICES_MAX),
        Field::array(
            "latency_p50_ns",
            offset_of!(Self, latency_p50_ns),
            Kind::U64,
            SERVICES_MAX,
        ),
        Field::array(
            "latency_p99_ns",
            offset_of!(Self, latency_p99_ns),
            Kind::U64,
            SERVICES_MAX,
        ),
    ];

    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn check_values(&self) -> Result<(), &'static str> {
        if self.service_count as usize > SERVICES_MAX {
            return Err("more services than the table holds");
        }
        Ok(())
    }
}
