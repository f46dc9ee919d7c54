//! A wire that this service writes.

use crate::termination::Termination;
use crate::wire::{Domain, ring};
use crate::{Error, Mode, now_ns, sleep_until};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::{BackpressureAction, BackpressureInfo};
use iceoryx2::prelude::{BackpressureStrategy, ipc};
use messages::{Header, Message, Status};
use std::cell::RefCell;
use std::path::PathBuf;

/// Between two looks for the release of a replay [ns].
const RELEASE_POLL_NS: u64 = 1_000_000;

/// A wire that this service writes.
#[derive(Debug)]
pub struct Output<T: Message> {
    publisher: Publisher<ipc::Service, T, ()>,
    bell: Notifier<ipc::Service>,
    wire: String,
    generation: u32,
    /// What the first sample waits for.
    release: RefCell<Option<PathBuf>>,
    termination: Termination,
}

impl<T: Message> Output<T> {
    pub(crate) fn open(
        domain: &Domain,
        wire: &str,
        generation: u32,
        release: Option<PathBuf>,
        termination: Termination,
    ) -> Result<Self, Error> {
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
        let bell = opened
            .bell
            .notifier_builder()
            .default_event_id(ring())
            .create()
            .map_err(|error| failed(&error))?;
        Ok(Self {
            publisher,
            bell,
            wire: wire.into(),
            generation,
            release: RefCell::new(release),
            termination,
        })
    }

    /// Sends a sample: stamps it, hands it over and rings.
    ///
    /// # Errors
    /// The wire is broken.
    pub fn send(&self, mut sample: T) -> Result<(), Error> {
        self.wait_for_readers();
        self.stamp(sample.header_mut());
        let loan = self.publisher.loan_uninit().map_err(|error| self.failed(&error))?;
        loan.write_payload(sample).send().map_err(|error| self.failed(&error))?;
        self.ring()
    }

    /// Sends a sample that `fill` writes in place. It finds there what an earlier sample left, or zeros; only the header
    /// is cleared. What `fill` fails with, nothing is sent.
    ///
    /// # Errors
    /// The wire is broken, or `fill` failed.
    pub fn send_with(&self, fill: impl FnOnce(&mut T) -> Result<(), Error>) -> Result<(), Error> {
        self.wait_for_readers();
        let mut loan = self.publisher.loan_uninit().map_err(|error| self.failed(&error))?;
        let bytes: *mut T = loan.payload_mut().as_mut_ptr();
        // SAFETY: the payload is memory of a mapped file: it is initialised (zeros at first, then what was sent before), and
        // any bytes are a valid `T` (zerocopy::FromBytes). The loan is exclusive, aligned and as long as `T`.
        #[allow(unsafe_code)]
        let sample = unsafe { &mut *bytes };
        *sample.header_mut() = Header::default();
        fill(sample)?;
        self.stamp(sample.header_mut());
        // SAFETY: as above: the payload is a valid `T`.
        #[allow(unsafe_code)]
        let loan = unsafe { loan.assume_init() };
        loan.send().map_err(|error| self.failed(&error))?;
        self.ring()
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

    fn stamp(&self, header: &mut Header) {
        header.generation = self.generation;
        header.published_ns = now_ns();
    }

    fn ring(&self) -> Result<(), Error> {
        self.bell.notify().map(|_| ()).map_err(|error| self.failed(&error))
    }

    fn failed(&self, what: &dyn std::fmt::Debug) -> Error {
        Error::internal(format!("cannot write wire {}: {what:?}", self.wire))
    }
}
