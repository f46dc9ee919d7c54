//! A stage's state after one of its last cycles, in memory that outlives the stage: its successor goes on from there.

use crate::Error;
use crate::journal::repeats;
use crate::memory::{self, Memory, WORD};
use messages::{Header, Resumable, Status};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering, fence};

const MAGIC: u64 = u64::from_le_bytes(*b"TERRAC01");
/// Observed wires of one stage at the most.
pub(crate) const OBSERVED_MAX: usize = 4;
/// Two: the one that is being written is worth nothing if its writer dies.
const PLACES: usize = 2;
const IDENTITY: usize = 1;
const HEADER_WORDS: usize = 2;
/// Number (0 while it is written) and digest; then the cut and the state.
const STAMP_WORDS: usize = 2;
const CUT_WORDS: usize = 2 * (1 + OBSERVED_MAX);

/// How far a stage has come on each of its inputs: the instants and numbers of the last samples it has taken in.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cut {
    pub(crate) trigger: Header,
    pub(crate) observed: [Header; OBSERVED_MAX],
}

/// The checkpoints of one stage.
#[derive(Debug)]
pub(crate) struct Checkpoint {
    memory: Memory,
    number: u64,
    state: Box<[u8]>,
}

impl Checkpoint {
    /// Opens or makes the file for a stage. What another program or another configuration has left there is forgotten.
    ///
    /// # Errors
    /// There is no space.
    pub(crate) fn open<S: Resumable>(path: &Path, stage: &S, config: &str) -> Result<Self, Error> {
        let state = vec![0; stage.state_bytes()].into_boxed_slice();
        let place_words = STAMP_WORDS + CUT_WORDS + state.len().div_ceil(WORD);
        let memory = Memory::create(path, HEADER_WORDS + PLACES * place_words)?;
        let about = format!("{} {} {config}", std::any::type_name::<S>(), state.len());
        let identity = digest(about.bytes().map(u64::from));
        let words = memory.words();
        if words[0].load(Ordering::Relaxed) != MAGIC || words[IDENTITY].load(Ordering::Relaxed) != identity {
            words.iter().for_each(|word| word.store(0, Ordering::Relaxed));
            words[IDENTITY].store(identity, Ordering::Relaxed);
            words[0].store(MAGIC, Ordering::Release);
        }
        let mut checkpoint = Self {
            memory,
            number: 0,
            state,
        };
        checkpoint.number = (0..PLACES)
            .map(|index| checkpoint.place(index)[0].load(Ordering::Acquire))
            .max()
            .unwrap_or(0);
        Ok(checkpoint)
    }

    /// Lets `stage` go on from the newest state that lies before `answered`: what comes after it can be had again.
    pub(crate) fn restore<S: Resumable>(&mut self, stage: &mut S, answered: &Header) -> Option<Cut> {
        let mut numbers: Vec<(u64, usize)> = (0..PLACES)
            .map(|index| (self.place(index)[0].load(Ordering::Acquire), index))
            .filter(|(number, _)| *number > 0)
            .collect();
        numbers.sort_unstable();
        numbers.into_iter().rev().find_map(|(_, index)| {
            let place = self.place(index);
            if place[1].load(Ordering::Relaxed) != digest_of(&place[STAMP_WORDS..]) {
                return None;
            }
            let header = |at: usize| Header {
                sequence: place[STAMP_WORDS + 2 * at].load(Ordering::Relaxed),
                taken_ns: place[STAMP_WORDS + 2 * at + 1].load(Ordering::Relaxed),
                status: Status::OK,
                ..Header::default()
            };
            let cut = Cut {
                trigger: header(0),
                observed: std::array::from_fn(|index| header(1 + index)),
            };
            let mut state = vec![0; self.state.len()];
            memory::load(&place[STAMP_WORDS + CUT_WORDS..], &mut state);
            if !repeats(&cut.trigger, answered) {
                return None;
            }
            stage.restore(&state).ok().map(|()| cut)
        })
    }

    /// Keeps the state of `stage` after it has taken in everything up to `cut`.
    pub(crate) fn keep<S: Resumable>(&mut self, stage: &S, cut: &Cut) {
        stage.save(&mut self.state);
        self.number += 1;
        let place = self.place(usize::try_from(self.number).unwrap_or(0) % PLACES);
        place[0].store(0, Ordering::Relaxed);
        fence(Ordering::Release);
        let headers = std::iter::once(&cut.trigger).chain(&cut.observed);
        for (words, header) in place[STAMP_WORDS..].chunks_exact(2).zip(headers) {
            words[0].store(header.sequence, Ordering::Relaxed);
            words[1].store(header.taken_ns, Ordering::Relaxed);
        }
        memory::store(&place[STAMP_WORDS + CUT_WORDS..], &self.state);
        place[1].store(digest_of(&place[STAMP_WORDS..]), Ordering::Relaxed);
        place[0].store(self.number, Ordering::Release);
    }

    fn place(&self, index: usize) -> &[AtomicU64] {
        let words = &self.memory.words()[HEADER_WORDS..];
        let length = words.len() / PLACES;
        &words[index * length..(index + 1) * length]
    }
}

fn digest_of(words: &[AtomicU64]) -> u64 {
    digest(words.iter().map(|word| word.load(Ordering::Relaxed)))
}

/// FNV-1a over words: against damage, not against intent.
fn digest(words: impl Iterator<Item = u64>) -> u64 {
    words.fold(0xcbf2_9ce4_8422_2325, |digest, word| {
        (digest ^ word).wrapping_mul(0x0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Counter(u64);

    impl Resumable for Counter {
        fn state_bytes(&self) -> usize {
            9
        }

        fn save(&self, state: &mut [u8]) {
            state[..8].copy_from_slice(&self.0.to_ne_bytes());
            state[8] = 1;
        }

        fn restore(&mut self, state: &[u8]) -> Result<(), &'static str> {
            assert_eq!(state[8], 1);
            let (count, _) = state.split_first_chunk().ok_or("is too short")?;
            self.0 = u64::from_ne_bytes(*count);
            Ok(())
        }
    }

    fn cut(sequence: u64) -> Cut {
        let mut cut = Cut::default();
        cut.trigger.sequence = sequence;
        cut.trigger.taken_ns = sequence;
        cut.observed[1].sequence = 3 * sequence;
        cut
    }

    #[test]
    fn a_successor_goes_on_from_the_last_state_whose_answer_is_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.checkpoint");
        let mut first = Checkpoint::open(&path, &Counter(0), "").unwrap();
        for count in 1..=7 {
            first.keep(&Counter(count), &cut(count));
        }
        let restored = |answered: u64, config: &str| {
            let mut stage = Counter(0);
            let mut checkpoint = Checkpoint::open(&path, &stage, config).unwrap();
            let restored = checkpoint.restore(&mut stage, &cut(answered).trigger);
            (
                stage.0,
                restored.map(|cut| (cut.trigger.sequence, cut.observed[1].sequence)),
            )
        };
        assert_eq!(restored(7, ""), (7, Some((7, 21))));
        assert_eq!(restored(6, ""), (6, Some((6, 18))));
        assert_eq!(restored(5, ""), (0, None));
        assert_eq!(restored(7, "gain = 2"), (0, None));
    }

    #[test]
    fn a_state_that_its_writer_died_over_is_not_used() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.checkpoint");
        let mut checkpoint = Checkpoint::open(&path, &Counter(0), "").unwrap();
        checkpoint.keep(&Counter(1), &cut(1));
        checkpoint.keep(&Counter(2), &cut(2));
        let torn = checkpoint.place(0);
        torn[STAMP_WORDS + CUT_WORDS].store(99, Ordering::Relaxed);
        let mut stage = Counter(0);
        let restored = checkpoint.restore(&mut stage, &cut(9).trigger).unwrap();
        assert_eq!((stage.0, restored.trigger.sequence), (1, 1));
    }
}
