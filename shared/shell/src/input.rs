//! Wires that this service reads: the one whose samples trigger it, and those that it observes.

use crate::bell::Ear;
use crate::checkpoint::OBSERVED_MAX;
use crate::journal::{Journal, repeats};
use crate::termination::Termination;
use crate::wire::Domain;
use crate::{Error, Mode, now_ns, tell};
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::ipc;
use iceoryx2::service::port_factory::subscriber::PortFactorySubscriber;
use messages::{Header, Message, Status};
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::ops::Deref;
use std::rc::Rc;
use std::time::Duration;

/// The longest wait for a bell. Bells can be missed (never samples), so every wait ends, and then looks.
const WAIT_MAX: Duration = Duration::from_millis(20);
/// The same in a replay, where a wire that is waited for stops others.
const REPLAY_WAIT_MAX: Duration = Duration::from_millis(2);
/// Samples of up to so many bytes are copied out of shared memory.
const COPIED_MAX: usize = 16 << 10;
/// A sensor instant further in the future than this [ns] is impossible.
const FUTURE_MAX_NS: u64 = 1_000_000_000;
/// Observations that wait for their trigger at the most. A replay's sources run ahead by as much; beyond, they are stopped.
const OBSERVATIONS_MAX: usize = 1_000_000;
/// The same on board, where the oldest give way: ten seconds between two triggers at a kilohertz, and more.
const OBSERVATIONS_LIVE_MAX: usize = 16 << 10;
/// Time for which samples may come later and later before a stage skips to the newest [ns]. A burst is over sooner.
const FALLING_BEHIND_MAX_NS: u64 = 250_000_000;
/// Observations that can wait without memory being asked for.
const OBSERVATIONS_PREPARED: usize = 1024;

type Sample<T> = iceoryx2::sample::Sample<ipc::Service, T, ()>;

/// A wire that this process reads, every sample once: what the wire does not bring, because it was sent while nobody
/// listened or its writer died over it, comes from the journal.
#[derive(Debug)]
struct Reader<T: Message> {
    subscriber: Subscriber<ipc::Service, T, ()>,
    ear: Ear,
    journal: Option<Journal>,
    /// Memory for a sample of the journal, where there is one: it is free again once who was handed the last has let it go.
    room: Option<Rc<T>>,
    /// Number, in the journal, of the sample that comes next.
    next: u64,
    /// What the wire has brought while samples before it are still to be read from the journal.
    held: Option<Sample<T>>,
    /// The newest sample that was handed out and could be believed.
    last: Option<Header>,
    wire: String,
    mode: Mode,
    bad: u64,
}

/// A sample: in shared memory, or a copy from the journal.
enum Received<T: Message> {
    Lent(Sample<T>),
    Kept(Rc<T>),
}

impl<T: Message> Deref for Received<T> {
    type Target = T;

    fn deref(&self) -> &T {
        match self {
            Self::Lent(sample) => sample.payload(),
            Self::Kept(sample) => sample,
        }
    }
}

impl<T: Message> Reader<T> {
    /// A stage's reader: what was sent before it came is there too.
    fn open(domain: &Domain, wire: &str) -> Result<Self, Error> {
        Self::open_with(domain, wire, |builder| builder)
    }

    fn open_with(
        domain: &Domain,
        wire: &str,
        set: impl FnOnce(PortFactorySubscriber<ipc::Service, T, ()>) -> PortFactorySubscriber<ipc::Service, T, ()>,
    ) -> Result<Self, Error> {
        let opened = domain.open::<T>(wire)?;
        let failed = |what: &dyn std::fmt::Debug| Error::unavailable(format!("cannot read wire {wire}: {what:?}"));
        let subscriber = set(opened.samples.subscriber_builder())
            .create()
            .map_err(|error| failed(&error))?;
        let room = opened.journal.is_some().then(|| zeroed(wire)).transpose()?;
        Ok(Self {
            subscriber,
            ear: Ear::new(opened.bell, opened.event),
            journal: opened.journal,
            room: room.map(Rc::from),
            next: 0,
            held: None,
            last: None,
            wire: wire.into(),
            mode: domain.mode(),
            bad: 0,
        })
    }

    /// Goes on after a sample that has been taken in already.
    fn resume_after(&mut self, header: &Header) {
        self.last = Some(*header);
        self.next = self.journal.as_ref().map_or(0, |journal| journal.first_after(header));
    }

    /// The next sample, each once and in order; `None` where there is none yet.
    fn receive(&mut self) -> Result<Option<Received<T>>, Error> {
        loop {
            let lent = match self.held.take() {
                Some(sample) => Some(sample),
                None => self.take()?,
            };
            let brought = lent.as_ref().map(|sample| *sample.payload().header());
            if let Some(kept) = self.missed(brought.as_ref()) {
                self.held = lent;
                return Ok(Some(Received::Kept(kept)));
            }
            match (lent, brought) {
                (Some(_), Some(header)) if self.is_repeat(&header) => {}
                (lent, _) => return Ok(lent.map(Received::Lent)),
            }
        }
    }

    /// What the wire itself brings.
    fn take(&self) -> Result<Option<Sample<T>>, Error> {
        self.ear.prick();
        let sample = self
            .subscriber
            .receive()
            .map_err(|error| Error::internal(format!("cannot read wire {}: {error:?}", self.wire)))?;
        if sample.is_some() {
            self.ear.note_found();
        }
        Ok(sample)
    }

    /// The next sample of the journal, unless it is the one that the wire has `brought`.
    fn missed(&mut self, brought: Option<&Header>) -> Option<Rc<T>> {
        let journal = self.journal.as_ref()?;
        let numbers = journal.numbers();
        self.next = self.next.max(numbers.start);
        while self.next < numbers.end {
            let number = self.next;
            self.next += 1;
            let Some(header) = journal.header(number) else { continue };
            if brought == Some(&header) {
                return None;
            }
            if self.is_repeat(&header) {
                continue;
            }
            let kept = match self.room.as_mut().and_then(Rc::get_mut) {
                Some(room) => journal.read_into(number, room).then(|| self.room.clone()).flatten(),
                None => journal.read(number).map(Rc::from),
            };
            if kept.is_some() {
                return kept;
            }
        }
        None
    }

    fn is_repeat(&self, header: &Header) -> bool {
        self.mode == Mode::Live && self.last.is_some_and(|last| repeats(header, &last))
    }

    /// Whether another sample is there already.
    fn has_more(&self) -> bool {
        let kept = self
            .journal
            .as_ref()
            .is_some_and(|journal| self.next < journal.numbers().end);
        kept || self.held.is_some() || self.subscriber.has_samples().unwrap_or(false)
    }

    /// Leaves out everything but the newest sample that is there; how many samples that were.
    fn skip_to_newest(&mut self) -> Result<u64, Error> {
        let mut skipped = 0;
        if let Some(journal) = &self.journal {
            let newest = journal.numbers().end.saturating_sub(1);
            skipped = newest.saturating_sub(self.next);
            self.next = self.next.max(newest);
        }
        while let Some(sample) = self.take()? {
            skipped += u64::from(self.journal.is_none() && self.held.is_some());
            self.held = Some(sample);
        }
        Ok(skipped)
    }

    fn wait(&self) -> Result<(), Error> {
        let longest = if self.mode == Mode::Live {
            WAIT_MAX
        } else {
            REPLAY_WAIT_MAX
        };
        self.ear
            .wait(longest)
            .map_err(|error| Error::internal(format!("cannot wait for wire {}: {error}", self.wire)))
    }

    /// Whether the sample can be believed as far as its status goes; the first one that cannot is told of.
    fn admits(&mut self, sample: &T) -> bool {
        let verdict = if self.instant_is_possible(sample.header()) {
            sample.check()
        } else {
            Err("impossible instant")
        };
        if verdict.is_ok() {
            self.last = Some(*sample.header());
        }
        if let Err(why) = verdict {
            if self.bad.is_power_of_two() || self.bad == 0 {
                tell(format_args!("wire {}: bad sample {}: {why}", self.wire, self.bad + 1));
            }
            self.bad += 1;
        }
        verdict.is_ok()
    }

    fn instant_is_possible(&self, header: &Header) -> bool {
        self.mode == Mode::Replay || header.taken_ns <= now_ns() + FUTURE_MAX_NS
    }
}

/// What every wait of a service looks at besides the bell it waits for.
#[derive(Debug)]
pub(crate) struct Attention {
    pub(crate) termination: Termination,
    observed: RefCell<Vec<Rc<dyn Queue>>>,
}

impl Attention {
    pub(crate) fn new(termination: Termination) -> Self {
        Self {
            termination,
            observed: RefCell::new(Vec::new()),
        }
    }

    /// Takes in what is there on the observed wires, while nothing else is to be done: the trigger then finds it there. In a
    /// replay, where a full queue stops its writer, a stage that waits for one wire must keep the others from filling up:
    /// writers that wait for each other through it would wait for ever.
    fn fill(&self) -> Result<(), Error> {
        self.observed.borrow().iter().try_for_each(|queue| queue.fill())
    }

    /// How far each observed wire has been taken in, in the order in which they were opened.
    pub(crate) fn cut(&self) -> [Header; OBSERVED_MAX] {
        let observed = self.observed.borrow();
        std::array::from_fn(|index| observed.get(index).map_or_else(Header::default, |queue| queue.taken()))
    }

    /// Goes on after what has been taken in already.
    pub(crate) fn resume_after(&self, cut: &[Header; OBSERVED_MAX]) {
        for (queue, header) in self.observed.borrow().iter().zip(cut) {
            queue.resume_after(header);
        }
    }
}

/// An observed wire, whatever it carries.
trait Queue: std::fmt::Debug {
    /// Takes in what is there, up to [`OBSERVATIONS_MAX`].
    fn fill(&self) -> Result<(), Error>;
    /// The newest sample that was observed.
    fn taken(&self) -> Header;
    /// Goes on after a sample that has been observed already.
    fn resume_after(&self, header: &Header);
}

/// The wire whose samples trigger this service.
#[derive(Debug)]
pub struct Input<T: Message> {
    reader: Reader<T>,
    attention: Rc<Attention>,
    /// Stands in for a sample that cannot be believed: its header, marked, and zeros.
    substitute: Box<T>,
    last: Header,
    age_ns: u64,
    /// Since when each sample was older, when it was taken, than the one before; 0 where it was not [ns].
    behind_since_ns: u64,
    skipped: u64,
}

impl<T: Message> Input<T> {
    /// `head` is the wire with which the chain begins.
    pub(crate) fn open(domain: &Domain, wire: &str, head: &str, attention: Rc<Attention>) -> Result<Self, Error> {
        let substitute = zeroed(wire)?;
        let reader = Reader::open(domain, wire)?;
        if domain.mode() == Mode::Live {
            reader.ear.mind(domain.bell(head)?);
        }
        Ok(Self {
            reader,
            attention,
            substitute,
            last: Header::default(),
            age_ns: 0,
            behind_since_ns: 0,
            skipped: 0,
        })
    }

    /// Goes on after a sample that has been answered already.
    pub(crate) fn resume_after(&mut self, header: &Header) {
        self.last = *header;
        self.reader.resume_after(header);
    }

    /// Hands the next sample, once it is there, to `act`. A sample that cannot be believed is replaced by one that says
    /// so (`BAD_SAMPLE`). `None` once the process is to end.
    pub(crate) fn next<R>(&mut self, act: impl FnOnce(&T) -> R) -> Result<Option<R>, Error> {
        while !self.attention.termination.requested() {
            let Some(sample) = self.reader.receive()? else {
                self.attention.fill()?;
                self.reader.wait()?;
                continue;
            };
            if self.falls_behind(sample.header().published_ns) {
                // Only so many samples can be held at a time.
                drop(sample);
                self.skip_to_newest()?;
                continue;
            }
            // What is looked at twice is copied first: a hostile writer could change it in between. Bulk is not copied; who
            // works on it must not trust it to stay.
            let copy = (size_of::<T>() <= COPIED_MAX)
                .then(|| T::read_from_bytes(sample.as_bytes()).ok())
                .flatten();
            let sample: &T = copy.as_ref().unwrap_or(&sample);
            let header = *sample.header();
            if self.reader.admits(sample) {
                self.last = header;
                return Ok(Some(act(sample)));
            }
            let header = if self.reader.instant_is_possible(&header) {
                header
            } else {
                self.last
            };
            return Ok(Some(act(self.substitute(Header {
                status: Status::BAD_SAMPLE,
                ..header
            }))));
        }
        Ok(None)
    }

    /// Whether this stage is slower than its input: one sample after the other comes later. What a restart or a pause has
    /// piled up comes earlier and earlier, and is answered.
    fn falls_behind(&mut self, published_ns: u64) -> bool {
        let now_ns = now_ns();
        let age_ns = now_ns.saturating_sub(published_ns);
        let later = self.reader.mode == Mode::Live && age_ns > self.age_ns && self.reader.has_more();
        self.age_ns = age_ns;
        match (later, self.behind_since_ns) {
            (false, _) => self.behind_since_ns = 0,
            (true, 0) => self.behind_since_ns = now_ns,
            (true, _) => {}
        }
        later && now_ns - self.behind_since_ns > FALLING_BEHIND_MAX_NS
    }

    /// The newest data win.
    fn skip_to_newest(&mut self) -> Result<(), Error> {
        self.behind_since_ns = 0;
        let before = self.skipped;
        // The one at hand is left out as well.
        self.skipped += 1 + self.reader.skip_to_newest()?;
        if before.checked_ilog2() != self.skipped.checked_ilog2() {
            let (wire, skipped) = (&self.reader.wire, self.skipped);
            tell(format_args!(
                "wire {wire}: slower than its samples come; {skipped} left out so far for newer ones"
            ));
        }
        Ok(())
    }

    /// A sample of nothing but a header.
    pub(crate) fn substitute(&mut self, header: Header) -> &T {
        *self.substitute.header_mut() = header;
        &self.substitute
    }
}

/// A wire that this service takes in when it is triggered.
#[derive(Debug)]
pub struct Observation<T: Message> {
    queue: Option<Rc<Observed<T>>>,
    attention: Rc<Attention>,
}

#[derive(Debug)]
struct Observed<T: Message> {
    reader: RefCell<Reader<T>>,
    pending: RefCell<VecDeque<T>>,
    /// Observations that were left out for newer ones.
    left_out: Cell<u64>,
    ended: Cell<bool>,
    taken: Cell<Header>,
}

impl<T: Message> Observed<T> {
    fn note_left_out(&self, wire: &str) {
        let count = self.left_out.get() + 1;
        self.left_out.set(count);
        if count.is_power_of_two() {
            tell(format_args!(
                "wire {wire}: no trigger asks for its samples; {count} left out so far for newer ones"
            ));
        }
    }
}

impl<T: Message> Queue for Observed<T> {
    fn fill(&self) -> Result<(), Error> {
        let (mut reader, mut pending) = (self.reader.borrow_mut(), self.pending.borrow_mut());
        while pending.len() < OBSERVATIONS_MAX {
            let Some(sample) = reader.receive()? else { return Ok(()) };
            if sample.header().status == Status::ENDED {
                self.ended.set(true);
            } else if reader.admits(&sample) {
                if reader.mode == Mode::Live && pending.len() >= OBSERVATIONS_LIVE_MAX {
                    pending.pop_front();
                    self.note_left_out(&reader.wire);
                }
                // Any bytes of this length are a valid sample.
                pending.extend(T::read_from_bytes(sample.as_bytes()));
            }
        }
        Ok(())
    }

    fn taken(&self) -> Header {
        self.taken.get()
    }

    fn resume_after(&self, header: &Header) {
        self.taken.set(*header);
        self.reader.borrow_mut().resume_after(header);
    }
}

impl<T: Message> Observation<T> {
    pub(crate) fn open(domain: &Domain, wire: Option<&str>, attention: Rc<Attention>) -> Result<Self, Error> {
        let queue = wire
            .map(|wire| {
                let reader = RefCell::new(Reader::open(domain, wire)?);
                let pending = RefCell::new(prepared());
                Ok(Rc::new(Observed {
                    reader,
                    pending,
                    left_out: Cell::new(0),
                    ended: Cell::new(false),
                    taken: Cell::new(Header::default()),
                }))
            })
            .transpose()?;
        attention
            .observed
            .borrow_mut()
            .extend(queue.clone().map(|queue| queue as Rc<dyn Queue>));
        Ok(Self { queue, attention })
    }

    /// Hands every sample taken until `taken_ns` that is new to `observe`, in order. On board these are the samples that
    /// are there; in a replay it waits until a later one shows that there are no more. Samples that cannot be believed
    /// are left out.
    ///
    /// # Errors
    /// The wire is broken.
    pub fn until(&self, taken_ns: u64, mut observe: impl FnMut(&T)) -> Result<(), Error> {
        let Some(queue) = &self.queue else { return Ok(()) };
        loop {
            queue.fill()?;
            let mut pending = queue.pending.borrow_mut();
            while let Some(sample) = pending.pop_front_if(|sample| sample.header().taken_ns <= taken_ns) {
                observe(&sample);
                queue.taken.set(*sample.header());
            }
            let later_is_there = !pending.is_empty();
            drop(pending);
            let live = queue.reader.borrow().mode == Mode::Live;
            if live || later_is_there || queue.ended.get() || self.attention.termination.requested() {
                return Ok(());
            }
            self.attention.fill()?;
            queue.reader.borrow().wait()?;
        }
    }
}

/// A sample of nothing but zeros.
fn zeroed<T: Message>(wire: &str) -> Result<Box<T>, Error> {
    T::new_box_zeroed().map_err(|_| Error::internal(format!("no memory for a sample of wire {wire}")))
}

/// An empty queue whose memory is there already: no page has to be fetched for it later.
fn prepared<T: Message>() -> VecDeque<T> {
    let mut pending = VecDeque::new();
    pending.resize_with(OBSERVATIONS_PREPARED, T::new_zeroed);
    pending.clear();
    pending
}

/// A wire that is read as it comes, without a stage behind it: by the launcher and by tests.
#[derive(Debug)]
pub struct Tap<T: Message>(Reader<T>);

impl<T: Message> Tap<T> {
    /// Opens the wire for reading, from now on.
    ///
    /// # Errors
    /// The wire is not there, or its samples have another layout.
    pub fn open(domain: &Domain, wire: &str) -> Result<Self, Error> {
        Ok(Self(Reader::open_with(domain, wire, |builder| {
            builder.history_request(0)
        })?))
    }

    /// Hands the next sample, if there is one, to `act`, whether it can be believed or not.
    ///
    /// # Errors
    /// The wire is broken.
    pub fn poll<R>(&self, act: impl FnOnce(&T) -> R) -> Result<Option<R>, Error> {
        Ok(self.0.take()?.map(|sample| act(&sample)))
    }

    /// Waits for the bell, 20 ms at the most.
    ///
    /// # Errors
    /// The wire is broken.
    pub fn wait(&self) -> Result<(), Error> {
        self.0.wait()
    }
}
