//! How a reader that sleeps learns of a sample.
//!
//! Two bells hang on a wire. A futex, in a file of the system's folder, wakes a reader in a third of the time that
//! iceoryx2's event takes where processors idle (bench `hop`); but only this shell rings it. The event, of the wire's name,
//! is rung by every writer. So a reader waits for the futex. Once a sample has come that the futex was not rung for, it
//! waits for the event, until the futex is rung again: the first sample of another kind of writer is late by one wait at
//! the most. A bell can be missed, a sample never: every wait ends, and then its caller looks.
//!
//! The file, in words of eight bytes: magic; strokes so far (four bytes, 0); 1 where somebody may be asleep.

use crate::Error;
use crate::memory::Memory;
use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::{EventId, ipc};
use iceoryx2::service::port_factory::event;
use rustix::io::Errno;
use rustix::thread::futex;
use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

/// The event that a writer rings after each sample.
pub(crate) const RING: usize = 0;
const MAGIC: u64 = u64::from_le_bytes(*b"TERRAB01");
const STROKES: usize = 1;
const ASLEEP: usize = 2;
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

    /// Wakes whoever is asleep: a system call only where somebody may be.
    fn ring(&self) {
        self.strokes().fetch_add(1, Ordering::SeqCst);
        if self.asleep().swap(0, Ordering::SeqCst) != 0 {
            let _ = futex::wake(self.strokes(), futex::Flags::empty(), i32::MAX.cast_unsigned());
        }
    }

    /// Sleeps until the bell has been rung more often than `heard`, a signal comes, or `longest` is over.
    fn sleep(&self, heard: u32, longest: Duration) -> Result<(), Errno> {
        // Before the kernel compares: who rings afterwards has either changed what it compares, or sees this.
        self.asleep().store(1, Ordering::SeqCst);
        let longest = longest.try_into().map_err(|_| Errno::INVAL)?;
        match futex::wait(self.strokes(), futex::Flags::empty(), heard, Some(&longest)) {
            Ok(()) | Err(Errno::AGAIN | Errno::INTR | Errno::TIMEDOUT) => Ok(()),
            Err(error) => Err(error),
        }
    }

    fn strokes(&self) -> &AtomicU32 {
        self.memory.half_word(STROKES)
    }

    fn asleep(&self) -> &AtomicU64 {
        &self.memory.words()[ASLEEP]
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
}

impl Ringer {
    pub(crate) fn new(bell: Bell, event: &EventService) -> Result<Self, impl std::fmt::Debug> {
        event
            .notifier_builder()
            .default_event_id(EventId::new(RING))
            .create()
            .map(|event| Self { bell, event })
    }

    /// Tells all readers of a sample.
    pub(crate) fn ring(&self) -> Result<(), impl std::fmt::Debug> {
        self.bell.ring();
        self.event.notify().map(|_| ())
    }
}

/// A reader's end of a wire's bells.
#[derive(Debug)]
pub(crate) struct Ear {
    bell: Bell,
    event: EventService,
    /// Strokes before the last look at the wire.
    heard: Cell<u32>,
    /// Whether a look has found a sample since the last wait.
    found: Cell<bool>,
    /// Strokes at the last wait.
    waited: Cell<Option<u32>>,
    /// While samples come that the futex is not rung for.
    listener: RefCell<Option<Listener<ipc::Service>>>,
}

impl Ear {
    pub(crate) fn new(bell: Bell, event: EventService) -> Self {
        Self {
            bell,
            event,
            heard: Cell::new(0),
            found: Cell::new(false),
            waited: Cell::new(None),
            listener: RefCell::new(None),
        }
    }

    /// To be called before each look at the wire: what is rung from here on ends the next wait.
    pub(crate) fn prick(&self) {
        self.heard.set(self.bell.strokes().load(Ordering::SeqCst));
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
            None => self
                .bell
                .sleep(self.heard.get(), longest)
                .map_err(|error| error.to_string()),
            Some(listener) => match listener.timed_wait(|_| (), longest) {
                // A signal ends the wait: the caller looks at why it woke.
                Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
                Err(error) => Err(format!("{error:?}")),
            },
        }
    }

    /// Which bell to wait for.
    fn choose(&self) -> Result<(), String> {
        let strokes = self.bell.strokes().load(Ordering::SeqCst);
        let rung = self
            .waited
            .replace(Some(strokes))
            .is_none_or(|before| before != strokes);
        let mut listener = self.listener.borrow_mut();
        match (self.found.take() && !rung, rung, &*listener) {
            (true, _, None) => {
                let made = self.event.listener_builder().create();
                *listener = Some(made.map_err(|error| format!("{error:?}"))?);
            }
            (_, true, Some(_)) => *listener = None,
            _ => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_never_sleeps_over_a_stroke() {
        let folder = tempfile::tempdir().unwrap();
        let path = Bell::path(&folder.path().display().to_string(), "front/wheel");
        let bell = Bell::create(&path).unwrap();
        let said = AtomicU64::new(0);
        let last = 20_000;
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let bell = Bell::open(&path).unwrap();
                for number in 1..=last {
                    said.store(number, Ordering::Release);
                    bell.ring();
                }
            });
            loop {
                let heard = bell.strokes().load(Ordering::SeqCst);
                if said.load(Ordering::Acquire) == last {
                    break;
                }
                // Whoever sleeps over the last stroke sleeps for ever.
                bell.sleep(heard, Duration::from_secs(1 << 20)).unwrap();
            }
        });
    }

    #[test]
    fn what_is_no_bell_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bell.front.wheel");
        assert!(Bell::open(&path).is_err());
        std::fs::write(&path, [7; 24]).unwrap();
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
