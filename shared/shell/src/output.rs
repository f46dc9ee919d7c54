//! A wire that this service writes: in its journal first, then to its readers, then the bells.

use crate::bell::Ringer;
use crate::journal::{Journal, repeats};
use crate::termination::Termination;
use crate::wire::Domain;
use crate::{Error, Mode, now_ns, sleep_until};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::{BackpressureAction, BackpressureInfo};
use iceoryx2::prelude::{BackpressureStrategy, ipc};
use messages::{Header, Message, Status};
use std::cell::{Cell, RefCell};
use std::path::PathBuf;

/// Between two looks for the release of a replay [ns].
const RELEASE_POLL_NS: u64 = 1_000_000;

/// A wire that this service writes.
#[derive(Debug)]
pub struct Output<T: Message> {
    wire: Writer<T>,
    /// Where answers go until this writer's turn on the wire comes.
    rehearsal: Option<Writer<T>>,
    /// Whether that is still ahead.
    rehearses: Cell<bool>,
    /// The newest sample that others have written: it is not answered again.
    answered: Cell<Option<Header>>,
    generation: u32,
    /// What the first sample waits for.
    release: RefCell<Option<PathBuf>>,
    termination: Termination,
}

impl<T: Message> Output<T> {
    /// `rehearsal` is the wire for answers before this writer's turn, of one that is to take the place of another.
    pub(crate) fn open(
        domain: &Domain,
        wire: &str,
        rehearsal: Option<&str>,
        generation: u32,
        termination: &Termination,
    ) -> Result<Self, Error> {
        let writer = |wire| Writer::open(domain, wire, termination);
        let output = Self {
            wire: writer(wire)?,
            rehearsal: rehearsal.map(writer).transpose()?,
            rehearses: Cell::new(rehearsal.is_some()),
            answered: Cell::new(None),
            generation,
            release: RefCell::new(None),
            termination: termination.clone(),
        };
        output.answered.set(output.wire.newest());
        if output.rehearsal.is_none() {
            output.wire.send_unsent()?;
        }
        Ok(output)
    }

    /// Lets the first sample wait until this file is there.
    pub(crate) fn wait_for(&self, release: Option<PathBuf>) {
        self.release.replace(release);
    }

    /// The newest sample that this writer's predecessors have sent: what comes after it is to be answered.
    pub(crate) fn answered(&self) -> Option<Header> {
        self.answered.get()
    }

    /// Whether another writer answers this trigger, and all later ones.
    pub(crate) fn is_over(&self, trigger: &Header) -> bool {
        !self.rehearses.get() && self.turn_is_after(self.generation, trigger)
    }

    /// Sends a sample: stamps it, hands it over and rings. What a predecessor has sent already is left out.
    ///
    /// # Errors
    /// The wire is broken.
    pub fn send(&self, sample: T) -> Result<(), Error> {
        let header = *sample.header();
        let write = |place: &mut T| {
            *place = sample;
            Ok(())
        };
        if let (Some(rehearsal), true) = (&self.rehearsal, self.rehearses.get()) {
            if !self.turn_is_after(self.generation.saturating_sub(1), &header) {
                return self.send_on(rehearsal, write);
            }
            self.rehearses.set(false);
            // The one before may have gone on for a moment longer.
            self.answered.set(self.wire.newest());
        }
        match self.answered.get() {
            Some(before) if repeats(&header, &before) => Ok(()),
            _ => self.send_on(&self.wire, write),
        }
    }

    /// Sends a sample that `fill` writes in place. It finds there what an earlier sample left, or zeros; only the header
    /// is cleared. What `fill` fails with, nothing is sent.
    ///
    /// # Errors
    /// The wire is broken, or `fill` failed.
    pub fn send_with(&self, fill: impl FnOnce(&mut T) -> Result<(), Error>) -> Result<(), Error> {
        self.send_on(&self.wire, fill)
    }

    fn send_on(&self, writer: &Writer<T>, fill: impl FnOnce(&mut T) -> Result<(), Error>) -> Result<(), Error> {
        self.wait_for_readers();
        writer.publish(|sample| {
            *sample.header_mut() = Header::default();
            fill(sample)?;
            let header = sample.header_mut();
            header.generation = self.generation;
            header.published_ns = now_ns();
            Ok(())
        })
    }

    /// Whether a writer of a later generation than this one answers the trigger of this header.
    fn turn_is_after(&self, generation: u32, header: &Header) -> bool {
        self.wire.journal.as_ref().is_some_and(|journal| {
            let (turn, sequence) = journal.turn();
            turn > generation && header.sequence >= sequence
        })
    }

    /// Says that nothing follows on this wire: an `ENDED` sample of this instant and number.
    ///
    /// # Errors
    /// The wire is broken.
    pub fn end(&self, taken_ns: u64, sequence: u64) -> Result<(), Error> {
        self.send_with(|sample| {
            sample.zero();
            *sample.header_mut() = Header {
                taken_ns,
                sequence,
                status: Status::ENDED,
                ..Header::default()
            };
            Ok(())
        })
    }

    /// In a replay nothing may be lost, but what is sent while a reader is not connected and its queue is full is. So the
    /// first sample waits until the launcher has seen all services ready: each has then connected to those before it.
    fn wait_for_readers(&self) {
        let Some(release) = self.release.take() else { return };
        while !release.exists() && !self.termination.requested() {
            sleep_until(now_ns() + RELEASE_POLL_NS);
        }
    }
}

/// One wire's publisher, bells and journal.
#[derive(Debug)]
struct Writer<T: Message> {
    publisher: Publisher<ipc::Service, T, ()>,
    ringer: Ringer,
    journal: Option<Journal>,
    wire: String,
}

impl<T: Message> Writer<T> {
    fn open(domain: &Domain, wire: &str, termination: &Termination) -> Result<Self, Error> {
        let opened = domain.open::<T>(wire)?;
        let failed = |what: &dyn std::fmt::Debug| Error::unavailable(format!("cannot write wire {wire}: {what:?}"));
        let builder = opened.samples.publisher_builder().max_loaned_samples(1);
        let told = termination.clone();
        let builder = match domain.mode() {
            Mode::Live => builder.backpressure_strategy(BackpressureStrategy::DiscardData),
            // A full queue stops the writer, but not one that is to end: its reader may have gone.
            Mode::Replay => builder.set_backpressure_handler(move |_: &BackpressureInfo| {
                if told.requested() {
                    return BackpressureAction::DiscardData;
                }
                BackpressureAction::Retry
            }),
        };
        let publisher = builder.create().map_err(|error| failed(&error))?;
        let ringer = Ringer::new(opened.bell, &opened.event).map_err(|error| failed(&error))?;
        Ok(Self {
            publisher,
            ringer,
            journal: opened.journal,
            wire: wire.into(),
        })
    }

    fn newest(&self) -> Option<Header> {
        self.journal.as_ref()?.newest()
    }

    /// Sends what a predecessor died over: it is in the journal, and perhaps on the wire.
    fn send_unsent(&self) -> Result<(), Error> {
        let Some(journal) = &self.journal else { return Ok(()) };
        for sample in journal.unsent().filter_map(|number| journal.read::<T>(number)) {
            self.hand_over(|place| {
                place.as_mut_bytes().copy_from_slice(sample.as_bytes());
                Ok(())
            })?;
        }
        Ok(())
    }

    /// Publishes what `fill` writes. The order is what makes a sample neither lost nor doubled: see [`crate::journal`].
    fn publish(&self, fill: impl FnOnce(&mut T) -> Result<(), Error>) -> Result<(), Error> {
        self.hand_over(|sample| {
            fill(sample)?;
            self.journal.iter().for_each(|journal| journal.append(sample));
            Ok(())
        })
    }

    fn hand_over(&self, fill: impl FnOnce(&mut T) -> Result<(), Error>) -> Result<(), Error> {
        let mut loan = self.publisher.loan_uninit().map_err(|error| self.failed(&error))?;
        let bytes: *mut T = loan.payload_mut().as_mut_ptr();
        // SAFETY: the payload is memory of a mapped file: it is initialised (zeros at first, then what was sent before), and
        // any bytes are a valid `T` (zerocopy::FromBytes). The loan is exclusive, aligned and as long as `T`.
        #[allow(unsafe_code)]
        fill(unsafe { &mut *bytes })?;
        // SAFETY: as above: the payload is a valid `T`.
        #[allow(unsafe_code)]
        let loan = unsafe { loan.assume_init() };
        loan.send().map_err(|error| self.failed(&error))?;
        self.journal.iter().for_each(Journal::note_sent);
        self.ringer.ring().map_err(|error| self.failed(&error))
    }

    fn failed(&self, what: &dyn std::fmt::Debug) -> Error {
        Error::internal(format!("cannot write wire {}: {what:?}", self.wire))
    }
}
