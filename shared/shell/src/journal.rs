//! The last samples of a wire in memory that outlives its writer: what makes a restart and a swap lose nothing.
//!
//! A cycle is answered once its sample is in the journal: one atomic store. Before that store its successor answers it, for
//! the cycle's trigger is still in the journal of the wire before (a frame: in the camera's history). After it nobody
//! answers it again, and every reader finds it here, however the sending was interrupted. Lost can only be: what the
//! camera itself has not sent; what is older than the journal or the camera's history is long; and what a stage has
//! skipped because it cannot keep up.
//!
//! The file, in words of eight bytes: magic, words of a sample, number of places, samples appended, samples sent, the
//! sequence from which a successor writes, its generation, 0; then the places, each a stamp (number of the sample in it,
//! from 1; 0 while it is written) and the sample.

use crate::Error;
use crate::memory::{self, Memory, WORD};
use messages::{Header, Message, Status};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering, fence};
use zerocopy::FromBytes;

const MAGIC: u64 = u64::from_le_bytes(*b"TERRAJ01");
const SAMPLE_WORDS: usize = 1;
const PLACES: usize = 2;
const APPENDED: usize = 3;
const SENT: usize = 4;
const TURN_SEQUENCE: usize = 5;
const TURN_GENERATION: usize = 6;
const HEADER_WORDS: usize = 8;

/// A wire's journal. One process appends at a time, any number read.
#[derive(Debug)]
pub(crate) struct Journal {
    memory: Memory,
    sample_words: usize,
    places: u64,
    /// The file, where this process has made it: it goes with this value.
    made: Option<PathBuf>,
}

impl Journal {
    /// Makes a journal for samples of `sample_bytes`. Only the launcher does.
    ///
    /// # Errors
    /// There is no space.
    pub(crate) fn create(path: &Path, sample_bytes: usize, places: usize) -> Result<Self, Error> {
        let sample_words = sample_bytes.div_ceil(WORD);
        let memory = Memory::create(path, HEADER_WORDS + places * (1 + sample_words))?;
        let words = memory.words();
        words[SAMPLE_WORDS].store(sample_words as u64, Ordering::Relaxed);
        words[PLACES].store(places as u64, Ordering::Relaxed);
        words[0].store(MAGIC, Ordering::Release);
        Ok(Self {
            memory,
            sample_words,
            places: places as u64,
            made: Some(path.into()),
        })
    }

    /// Opens the journal of a wire of `T`; `None` where the wire has none.
    ///
    /// # Errors
    /// The file is no journal of such samples.
    pub(crate) fn open<T: Message>(path: &Path) -> Result<Option<Self>, Error> {
        let Some(memory) = Memory::open(path)? else {
            return Ok(None);
        };
        let sample_words = size_of::<T>().div_ceil(WORD);
        let head = |index: usize| memory.words().get(index).map_or(0, |word| word.load(Ordering::Acquire));
        let places = head(PLACES);
        let is_whole =
            HEADER_WORDS as u64 + places.saturating_mul(1 + sample_words as u64) == memory.words().len() as u64;
        if head(0) != MAGIC || head(SAMPLE_WORDS) != sample_words as u64 || places == 0 || !is_whole {
            return Err(Error::unavailable(format!(
                "{}: no journal of {}",
                path.display(),
                T::NAME
            )));
        }
        Ok(Some(Self {
            memory,
            sample_words,
            places,
            made: None,
        }))
    }

    /// The file of a wire's journal.
    pub(crate) fn path(root: &str, wire: &str) -> PathBuf {
        Path::new(root).join(format!("journal.{}", wire.replace('/', ".")))
    }

    /// Adds a sample: from here on it is published, whatever happens to its writer.
    pub(crate) fn append<T: Message>(&self, sample: &T) {
        let number = self.head(APPENDED).load(Ordering::Relaxed);
        let (stamp, place) = self.place(number);
        stamp.store(0, Ordering::Relaxed);
        fence(Ordering::Release);
        memory::store(place, sample.as_bytes());
        stamp.store(number + 1, Ordering::Release);
        self.head(APPENDED).store(number + 1, Ordering::Release);
    }

    /// Notes that all that has been appended has been sent.
    pub(crate) fn note_sent(&self) {
        let appended = self.head(APPENDED).load(Ordering::Relaxed);
        self.head(SENT).store(appended, Ordering::Release);
    }

    /// The numbers of the samples that can be read.
    pub(crate) fn numbers(&self) -> Range<u64> {
        let appended = self.head(APPENDED).load(Ordering::Acquire);
        appended.saturating_sub(self.places)..appended
    }

    /// The numbers of the samples that were appended and, for all that is known, not sent.
    pub(crate) fn unsent(&self) -> Range<u64> {
        let numbers = self.numbers();
        let sent = self.head(SENT).load(Ordering::Acquire);
        sent.clamp(numbers.start, numbers.end)..numbers.end
    }

    /// The sample of this number; `None` where it has been overwritten.
    pub(crate) fn read<T: Message>(&self, number: u64) -> Option<Box<T>> {
        let mut sample = T::new_box_zeroed().ok()?;
        self.read_into(number, sample.as_mut()).then_some(sample)
    }

    /// The same, into memory that is there. Whether it could be read: `sample` means nothing where not.
    pub(crate) fn read_into<T: Message>(&self, number: u64, sample: &mut T) -> bool {
        self.copy(number, sample.as_mut_bytes())
    }

    /// The header of the sample of this number; `None` where it has been overwritten.
    pub(crate) fn header(&self, number: u64) -> Option<Header> {
        let mut bytes = [0; size_of::<Header>()];
        self.copy(number, &mut bytes)
            .then(|| Header::read_from_bytes(&bytes).ok())?
    }

    /// The header of the newest sample.
    pub(crate) fn newest(&self) -> Option<Header> {
        self.numbers().next_back().and_then(|number| self.header(number))
    }

    /// The number of the first sample that does not repeat one of `header`.
    pub(crate) fn first_after(&self, header: &Header) -> u64 {
        let numbers = self.numbers();
        let later = |number: &u64| self.header(*number).is_some_and(|other| !repeats(&other, header));
        // From the newest on: what is missing is little.
        let missing = numbers.clone().rev().take_while(later).count() as u64;
        numbers.end - missing
    }

    /// Lets the writer of `generation` write from `sequence` on, and those before it no longer.
    pub(crate) fn give_turn(&self, generation: u32, sequence: u64) {
        self.head(TURN_SEQUENCE).store(sequence, Ordering::Relaxed);
        self.head(TURN_GENERATION).store(generation.into(), Ordering::Release);
    }

    /// The generation whose turn begins, and with which sequence. The generation 0 where no turn has been given.
    pub(crate) fn turn(&self) -> (u32, u64) {
        let generation = self.head(TURN_GENERATION).load(Ordering::Acquire);
        let sequence = self.head(TURN_SEQUENCE).load(Ordering::Relaxed);
        (u32::try_from(generation).unwrap_or(u32::MAX), sequence)
    }

    fn copy(&self, number: u64, bytes: &mut [u8]) -> bool {
        let (stamp, place) = self.place(number);
        if stamp.load(Ordering::Acquire) != number + 1 {
            return false;
        }
        memory::load(place, bytes);
        fence(Ordering::Acquire);
        stamp.load(Ordering::Relaxed) == number + 1
    }

    fn head(&self, index: usize) -> &AtomicU64 {
        &self.memory.words()[index]
    }

    fn place(&self, number: u64) -> (&AtomicU64, &[AtomicU64]) {
        let length = 1 + self.sample_words;
        let start = HEADER_WORDS + usize::try_from(number % self.places).unwrap_or(0) * length;
        let place = &self.memory.words()[start..start + length];
        (&place[0], &place[1..])
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        self.made.iter().for_each(|path| {
            let _ = std::fs::remove_file(path);
        });
    }
}

/// Whether a sample says again what one that came before has said: neither its number nor its instant is newer. (A source
/// that numbers anew goes on in time.)
pub(crate) fn repeats(sample: &Header, before: &Header) -> bool {
    sample.sequence <= before.sequence && sample.taken_ns <= before.taken_ns && sample.status != Status::ENDED
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::Wheel;
    use zerocopy::FromZeros;

    fn wheel(sequence: u64) -> Wheel {
        let mut wheel = Wheel::new_zeroed();
        wheel.header.sequence = sequence;
        wheel.header.taken_ns = 1000 * sequence;
        wheel.load_n = sequence as f64;
        wheel
    }

    fn journal(places: usize) -> (tempfile::TempDir, Journal) {
        let folder = tempfile::tempdir().unwrap();
        let path = Journal::path(&folder.path().display().to_string(), "front/wheel");
        let journal = Journal::create(&path, size_of::<Wheel>(), places).unwrap();
        (folder, journal)
    }

    #[test]
    fn what_was_appended_is_found_by_whoever_opens_the_journal_later() {
        let (folder, journal) = journal(4);
        for sequence in 1..=6 {
            journal.append(&wheel(sequence));
        }
        let journal = Journal::open::<Wheel>(&folder.path().join("journal.front.wheel"))
            .unwrap()
            .unwrap();
        let sequences: Vec<f64> = journal
            .numbers()
            .map(|number| journal.read::<Wheel>(number).unwrap().load_n)
            .collect();
        assert_eq!(sequences, [3.0, 4.0, 5.0, 6.0]);
        assert!(journal.read::<Wheel>(1).is_none(), "overwritten");
        assert_eq!(journal.newest().unwrap().sequence, 6);
    }

    #[test]
    fn a_reader_goes_on_after_the_last_sample_it_has_taken() {
        let (_folder, journal) = journal(8);
        for sequence in [1, 2, 5, 6] {
            journal.append(&wheel(sequence));
        }
        assert_eq!(journal.first_after(&wheel(2).header), 2);
        assert_eq!(journal.first_after(&wheel(3).header), 2);
        assert_eq!(journal.first_after(&wheel(9).header), 4);
        assert_eq!(journal.first_after(&Header::default()), 0);
    }

    #[test]
    fn what_its_writer_died_over_is_known_as_unsent() {
        let (_folder, journal) = journal(4);
        journal.append(&wheel(1));
        journal.note_sent();
        assert!(journal.unsent().is_empty());
        journal.append(&wheel(2));
        assert_eq!(journal.unsent(), 1..2);
    }

    #[test]
    fn a_journal_of_other_samples_is_refused() {
        let (folder, _journal) = journal(4);
        let path = folder.path().join("journal.front.wheel");
        assert!(Journal::open::<messages::Soil>(&path).is_err());
        std::fs::write(&path, [7; 4096]).unwrap();
        assert!(Journal::open::<Wheel>(&path).is_err());
    }

    #[test]
    fn a_sample_that_is_overwritten_while_it_is_read_is_not_handed_out_torn() {
        let (folder, journal) = journal(2);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let path = folder.path().join("journal.front.wheel");
                let writer = Journal::open::<Wheel>(&path).unwrap().unwrap();
                for sequence in 1..200_000 {
                    writer.append(&wheel(sequence));
                }
            });
            for _ in 0..200_000 {
                let number = journal.numbers().start;
                if let Some(sample) = journal.read::<Wheel>(number) {
                    assert_eq!(sample.load_n, sample.header.sequence as f64);
                    assert_eq!(sample.header.taken_ns, 1000 * sample.header.sequence);
                }
            }
        });
    }
}
