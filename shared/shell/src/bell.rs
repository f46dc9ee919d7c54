//! How a reader that sleeps learns of a sample.
//!
//! Two bells hang on a wire. A futex, in a file of the system's folder, is the cheapest wake-up that there is, and costs its
//! ringer no system call where nobody sleeps; but only this shell rings it. The event, of the wire's name, is iceoryx2's,
//! costs either side several calls, and is rung by every writer. So a reader waits for the futex. Once two samples have come
//! that the futex was not rung for, it waits for the event, until the futex is rung again: the first two samples of another
//! kind of writer are late by one wait at the most. A bell can be missed, a sample never: every wait ends, and then
//! its caller looks.
//!
//! What takes its writer some time, a frame, is heralded: all stages of its chain wake, look, and sleep again. Their code is
//! in the caches and their processors are awake when it comes: at sensor rates a hop costs more for what is cold than for
//! what it does (bench `compare`: paced against as fast as possible).
//!
//! Where the writer is bound to one processor, the stage that it wakes is most often bound there too and waits until the writer
//! sleeps. So the writer lets it go first: what is to be tidied up after a sample is done when the answer is on its way.
//!
//! The file, in words of eight bytes: magic; for samples, twice the strokes so far, plus 1 where somebody may be asleep
//! (four bytes, and four of 0); the same for heralds.

use crate::memory::Memory;
use crate::{Error, now_ns};
use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::{EventId, ipc};
use iceoryx2::service::port_factory::event;
use rustix::io::Errno;
use rustix::thread::{futex, sched_getaffinity, sched_yield};
use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// The event that a writer rings after each sample.
pub(crate) const RING: usize = 0;
const MAGIC: u64 = u64::from_le_bytes(*b"TERRAB02");
/// Samples without a stroke after which a reader waits for the event. After one, its writer may be about to ring.
const UNRUNG: u32 = 2;
const SAMPLES: usize = 1;
const HERALDS: usize = 2;
const WORDS: usize = 3;

/// The event service of a wire.
pub(crate) type EventService = event::PortFactory<ipc::Service>;

/// A wire's futex.
#[derive(Debug)]
pub(crate) struct Bell {
    memory: Memory,
    /// The file, where this process has made it: it goes with this value.
    made: Option<PathBuf>,
}

impl Bell {
    /// Hangs a bell on a wire. Only the launcher does.
    ///
    /// # Errors
    /// There is no space.
    pub(crate) fn create(path: &Path) -> Result<Self, Error> {
        let memory = Memory::create(path, WORDS)?;
        memory.words()[0].store(MAGIC, Ordering::Release);
        Ok(Self {
            memory,
            made: Some(path.into()),
        })
    }

    /// Opens a wire's bell.
    ///
    /// # Errors
    /// The file is not there, or is no bell.
    pub(crate) fn open(path: &Path) -> Result<Self, Error> {
        match Memory::open(path)? {
            Some(memory) if memory.words().len() == WORDS && memory.words()[0].load(Ordering::Acquire) == MAGIC => {
                Ok(Self { memory, made: None })
            }
            _ => Err(Error::unavailable(format!("{}: no bell of a wire", path.display()))),
        }
    }

    /// The file of a wire's bell.
    pub(crate) fn path(root: &str, wire: &str) -> PathBuf {
        Path::new(root).join(format!("bell.{}", wire.replace('/', ".")))
    }

    /// Rung after each sample.
    fn samples(&self) -> Gong<'_> {
        self.gong(SAMPLES)
    }

    /// Rung before a sample that takes time.
    fn heralds(&self) -> Gong<'_> {
        self.gong(HERALDS)
    }

    fn gong(&self, word: usize) -> Gong<'_> {
        Gong(self.memory.half_word(word))
    }
}

/// What is rung and slept for. Strokes and sleepers share one word: were they two, a stroke could strike out, between the
/// one and the other, a sleeper that has heard it already and sleeps for the next, which would then wake nobody.
struct Gong<'a>(&'a AtomicU32);

/// Added where somebody may be asleep.
const ASLEEP: u32 = 1;
const STROKE: u32 = 2;

impl Gong<'_> {
    /// Wakes whoever is asleep: a system call only where somebody may be. Whether somebody was.
    fn ring(&self) -> bool {
        let rung = |word: u32| Some((word & !ASLEEP).wrapping_add(STROKE));
        let (Ok(before) | Err(before)) = self.0.fetch_update(Ordering::SeqCst, Ordering::SeqCst, rung);
        before & ASLEEP != 0
            && futex::wake(self.0, futex::Flags::empty(), i32::MAX.cast_unsigned()).is_ok_and(|woken| woken > 0)
    }

    /// How often it has been rung: a number that each stroke changes.
    fn heard(&self) -> u32 {
        self.0.load(Ordering::SeqCst) & !ASLEEP
    }

    /// Sleeps until it has been rung more often than `heard`, a signal comes, or `longest` is over.
    fn sleep(&self, heard: u32, longest: Duration) -> Result<(), Errno> {
        let longest = longest.try_into().map_err(|_| Errno::INVAL)?;
        awake(futex::wait(
            self.0,
            futex::Flags::empty(),
            self.lie_down(heard),
            Some(&longest),
        ))
    }

    /// What the kernel is to find, or not to sleep. Where it has been rung meanwhile nothing is written, and the kernel finds
    /// another word.
    fn lie_down(&self, heard: u32) -> u32 {
        let asleep = heard | ASLEEP;
        let _ = self
            .0
            .compare_exchange(heard, asleep, Ordering::SeqCst, Ordering::SeqCst);
        asleep
    }

    fn wait(&self, heard: u32) -> futex::Wait {
        let mut wait = futex::Wait::new();
        wait.val = self.lie_down(heard).into();
        wait.uaddr = futex::WaitPtr::new(self.0.as_ptr().cast());
        wait.flags = futex::WaitFlags::SIZE_U32;
        wait
    }
}

/// Sleeps until either has been rung more often than heard, as [`Gong::sleep`] does for one.
fn sleep_for_either(gongs: [(Gong<'_>, u32); 2], longest: Duration) -> Result<(), Errno> {
    let waits = gongs.map(|(gong, heard)| gong.wait(heard));
    let until_ns = now_ns() + u64::try_from(longest.as_nanos()).unwrap_or(u64::MAX >> 1);
    let until = Duration::from_nanos(until_ns).try_into().map_err(|_| Errno::INVAL)?;
    let outcome = futex::waitv(
        &waits,
        futex::WaitvFlags::empty(),
        Some(&until),
        futex::ClockId::Monotonic,
    );
    awake(outcome.map(|_| ()))
}

/// However a sleep has ended, its sleeper looks.
fn awake(outcome: Result<(), Errno>) -> Result<(), Errno> {
    match outcome {
        Ok(()) | Err(Errno::AGAIN | Errno::INTR | Errno::TIMEDOUT) => Ok(()),
        Err(error) => Err(error),
    }
}

impl Drop for Bell {
    fn drop(&mut self) {
        self.made.iter().for_each(|path| {
            let _ = std::fs::remove_file(path);
        });
    }
}

/// A writer's end of a wire's bells.
#[derive(Debug)]
pub(crate) struct Ringer {
    bell: Bell,
    event: Notifier<ipc::Service>,
    /// Whether this process is bound to one processor.
    bound: bool,
}

impl Ringer {
    pub(crate) fn new(bell: Bell, event: &EventService) -> Result<Self, impl std::fmt::Debug> {
        event
            .notifier_builder()
            .default_event_id(EventId::new(RING))
            .create()
            .map(|event| Self {
                bell,
                event,
                bound: sched_getaffinity(None).is_ok_and(|processors| processors.count() == 1),
            })
    }

    /// Tells the stages of the chain that begins here that a sample will come.
    pub(crate) fn herald(&self) {
        self.bell.heralds().ring();
    }

    /// Tells all readers of a sample.
    pub(crate) fn ring(&self) -> Result<(), impl std::fmt::Debug> {
        if self.bell.samples().ring() && self.bound {
            sched_yield();
        }
        self.event.notify().map(|_| ())
    }
}

/// A reader's end of a wire's bells.
#[derive(Debug)]
pub(crate) struct Ear {
    bell: Bell,
    /// The bell of the wire with which the chain begins, for a stage of it.
    herald: RefCell<Option<Bell>>,
    event: EventService,
    /// Strokes, and heralds, before the last look at the wire.
    heard: Cell<(u32, u32)>,
    /// Whether a look has found a sample since the last wait.
    found: Cell<bool>,
    /// Strokes at the last wait.
    waited: Cell<Option<u32>>,
    /// Waits since the last stroke before which a sample had been found.
    unrung: Cell<u32>,
    /// While samples come that the futex is not rung for.
    listener: RefCell<Option<Listener<ipc::Service>>>,
}

impl Ear {
    pub(crate) fn new(bell: Bell, event: EventService) -> Self {
        Self {
            bell,
            herald: RefCell::new(None),
            event,
            heard: Cell::new((0, 0)),
            found: Cell::new(false),
            waited: Cell::new(None),
            unrung: Cell::new(0),
            listener: RefCell::new(None),
        }
    }

    /// Wakes for the heralds of this bell as well.
    pub(crate) fn mind(&self, herald: Bell) {
        self.herald.replace(Some(herald));
    }

    /// To be called before each look at the wire: what is rung from here on ends the next wait.
    pub(crate) fn prick(&self) {
        let heralds = self
            .herald
            .borrow()
            .as_ref()
            .map_or(0, |herald| herald.heralds().heard());
        self.heard.set((self.bell.samples().heard(), heralds));
    }

    /// To be called when a look has found a sample.
    pub(crate) fn note_found(&self) {
        self.found.set(true);
    }

    /// Waits for a bell, for `longest` at the most.
    ///
    /// # Errors
    /// What iceoryx2 or the kernel says.
    pub(crate) fn wait(&self, longest: Duration) -> Result<(), String> {
        self.choose()?;
        match &*self.listener.borrow() {
            None => self.sleep(longest).map_err(|error| error.to_string()),
            Some(listener) => match listener.timed_wait(|_| (), longest) {
                // A signal ends the wait: the caller looks at why it woke.
                Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
                Err(error) => Err(format!("{error:?}")),
            },
        }
    }

    fn sleep(&self, longest: Duration) -> Result<(), Errno> {
        let (heard, heralds) = self.heard.get();
        let samples = self.bell.samples();
        let outcome = match &*self.herald.borrow() {
            None => return samples.sleep(heard, longest),
            Some(herald) => sleep_for_either([(samples, heard), (herald.heralds(), heralds)], longest),
        };
        match outcome {
            // Linux before 5.16, or a container that forbids it: without heralds, then.
            Err(Errno::NOSYS | Errno::PERM) => {
                self.herald.replace(None);
                Ok(())
            }
            outcome => outcome,
        }
    }

    /// Which bell to wait for.
    fn choose(&self) -> Result<(), String> {
        let strokes = self.bell.samples().heard();
        let rung = self
            .waited
            .replace(Some(strokes))
            .is_none_or(|before| before != strokes);
        let found = u32::from(self.found.take());
        self.unrung.set(if rung {
            0
        } else {
            self.unrung.get().saturating_add(found)
        });
        let mut listener = self.listener.borrow_mut();
        match (self.unrung.get(), &*listener) {
            (0, Some(_)) => *listener = None,
            (UNRUNG.., None) => {
                let made = self.event.listener_builder().create();
                *listener = Some(made.map_err(|error| format!("{error:?}"))?);
            }
            _ => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU64;
    use std::time::Instant;

    /// A sleep that lasts so long was slept over a stroke. It is told, not slept for ever.
    const FOR_EVER: Duration = Duration::from_secs(60);

    fn woken(sleep: impl FnOnce(Duration) -> Result<(), Errno>) {
        let begun = Instant::now();
        sleep(FOR_EVER).unwrap();
        assert!(begun.elapsed() < FOR_EVER, "nobody woke a reader");
    }

    #[test]
    fn no_reader_ever_sleeps_over_a_stroke() {
        let folder = tempfile::tempdir().unwrap();
        let path = Bell::path(&folder.path().display().to_string(), "front/wheel");
        let _hung = Bell::create(&path).unwrap();
        let said = AtomicU64::new(0);
        let last = 1_000_000;
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let bell = Bell::open(&path).unwrap();
                for number in 1..=last {
                    said.store(number, Ordering::Release);
                    bell.samples().ring();
                }
            });
            for _ in 0..2 {
                scope.spawn(|| {
                    let bell = Bell::open(&path).unwrap();
                    loop {
                        let heard = bell.samples().heard();
                        if said.load(Ordering::Acquire) == last {
                            break;
                        }
                        woken(|longest| bell.samples().sleep(heard, longest));
                    }
                });
            }
        });
    }

    #[test]
    fn a_stage_wakes_for_its_own_bell_and_for_heralds() {
        let folder = tempfile::tempdir().unwrap();
        let paths = ["frames", "sinkage"].map(|wire| folder.path().join(wire));
        let [frames, sinkage] = paths.each_ref().map(|path| Bell::create(path).unwrap());
        for ring in [
            (|paths| Bell::open(&paths[0]).unwrap().heralds().ring()) as fn(&[PathBuf; 2]) -> bool,
            |paths| Bell::open(&paths[1]).unwrap().samples().ring(),
        ] {
            let gongs = [
                (sinkage.samples(), sinkage.samples().heard()),
                (frames.heralds(), frames.heralds().heard()),
            ];
            std::thread::scope(|scope| {
                scope.spawn(|| {
                    std::thread::sleep(Duration::from_millis(5));
                    ring(&paths);
                });
                woken(|longest| sleep_for_either(gongs, longest));
            });
        }
    }

    #[test]
    fn a_bell_that_nobody_waits_for_wakes_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let bell = Bell::create(&folder.path().join("bell.front.wheel")).unwrap();
        let heard = bell.samples().heard();
        assert!(!bell.samples().ring());
        assert_ne!(bell.samples().heard(), heard);
    }

    #[test]
    fn what_is_no_bell_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bell.front.wheel");
        assert!(Bell::open(&path).is_err());
        std::fs::write(&path, [7; 40]).unwrap();
        assert!(Bell::open(&path).is_err());
        std::fs::write(&path, [7; 9]).unwrap();
        assert!(Bell::open(&path).is_err());
    }

    #[test]
    fn a_bell_goes_with_the_one_who_hung_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bell.front.wheel");
        let bell = Bell::create(&path).unwrap();
        drop(Bell::open(&path).unwrap());
        assert!(path.exists());
        drop(bell);
        assert!(!path.exists());
    }
}
