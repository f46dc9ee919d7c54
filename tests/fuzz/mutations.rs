//! Every target over its corpus, and over mutations of it: the same ones each time.
#![allow(clippy::unwrap_used)] // A test that cannot go on ends here, with the reason and the line.

use fuzz::TARGETS;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};

/// Length of a mutation at the most.
const BYTES_MAX: usize = 1 << 16;
/// What numbers and texts are mutated into.
const WORDS: [&str; 24] = [
    "nan",
    "inf",
    "-inf",
    "1e999",
    "-1",
    "0",
    "1e-320",
    "18446744073709551616",
    "9e15",
    "\"",
    "\"\"",
    ",",
    "\n",
    "\r\n",
    "[",
    "]",
    "=",
    "..",
    "/",
    "\u{feff}",
    "é",
    "#",
    "[[",
    "'''",
];
/// The same for binary files: the bytes of numbers that are seldom thought of.
const NUMBERS: [f64; 10] = [
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    0.0,
    -0.0,
    f64::MAX,
    f64::MIN_POSITIVE,
    5e-324,
    1.0,
    -1.0,
];

#[test]
fn no_target_panics_on_its_corpus_or_on_what_it_is_mutated_into() {
    let share = |target: &fuzz::Target| {
        let corpus = corpus(target.name);
        assert!(!corpus.is_empty(), "tests/fuzz/corpus/{} is empty", target.name);
        corpus.iter().for_each(|bytes| try_out(target, bytes));
        let mut dice = Dice(0x9e37_79b9_7f4a_7c15);
        for _ in 0..target.mutations {
            let mut bytes = dice.one_of(&corpus).clone();
            for _ in 0..=dice.below(4) {
                mutate(&mut bytes, &mut dice, &corpus);
            }
            bytes.truncate(BYTES_MAX);
            repair(&mut bytes);
            try_out(target, &bytes);
        }
    };
    // Two at a time: the small targets beside the large ones.
    let (some, others) = TARGETS.split_at(TARGETS.len() / 2);
    std::thread::scope(|scope| {
        scope.spawn(|| some.iter().for_each(share));
        others.iter().for_each(share);
    });
}

/// Runs a target; what makes it panic is kept in a file.
fn try_out(target: &fuzz::Target, bytes: &[u8]) {
    if catch_unwind(|| (target.run)(bytes)).is_err() {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{}.bytes", target.name));
        std::fs::write(&path, bytes).unwrap();
        panic!(
            "target {} panics on {}; once mended, add the file to tests/fuzz/corpus/{}",
            target.name,
            path.display(),
            target.name
        );
    }
}

/// The committed inputs of a target, in the order of their names.
fn corpus(target: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    paths.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

fn mutate(bytes: &mut Vec<u8>, dice: &mut Dice, corpus: &[Vec<u8>]) {
    let at = dice.below(bytes.len() + 1);
    let until = (at + 1 + dice.below(16)).min(bytes.len());
    let until = until.max(at);
    match dice.below(9) {
        0 if at < bytes.len() => bytes[at] ^= 1 << dice.below(8),
        1 if at < bytes.len() => bytes[at] = dice.below(256) as u8,
        2 => drop(bytes.drain(at..until)),
        3 => {
            let copied = bytes[at..until].to_vec();
            let to = dice.below(bytes.len() + 1);
            drop(bytes.splice(to..to, copied));
        }
        4 => bytes.truncate(at),
        5 => {
            let word = dice.one_of(&WORDS).bytes();
            let end = if dice.below(2) == 0 { at } else { until };
            drop(bytes.splice(at..end, word));
        }
        6 => {
            // Aligned, as the fields of samples are, with the byte before a sample left out or not.
            let number = dice.one_of(&NUMBERS).to_le_bytes();
            let at = at / 8 * 8 + dice.below(2);
            if let Some(target) = bytes.get_mut(at..at + 8) {
                target.copy_from_slice(&number);
            }
        }
        7 => {
            let other = dice.one_of(corpus);
            let from = dice.below(other.len() + 1);
            bytes.truncate(at);
            bytes.extend(&other[from..]);
        }
        _ => {
            let value = if dice.below(2) == 0 { 0 } else { 255 };
            bytes[at..until].fill(value);
        }
    }
}

/// Makes a PNG's checksums right again: what is behind them is to be tried, too.
fn repair(bytes: &mut [u8]) {
    if !bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        return;
    }
    let mut at = 8;
    while let Some(length) = bytes.get(at..at + 4).and_then(|length| length.try_into().ok()) {
        let end = at + 8 + u32::from_be_bytes(length) as usize;
        if bytes.len() < end + 4 {
            return;
        }
        let checksum = crc_32(&bytes[at + 4..end]);
        bytes[end..end + 4].copy_from_slice(&checksum.to_be_bytes());
        at = end + 4;
    }
}

fn crc_32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 }
        })
    };
    !bytes.iter().fold(!0, step)
}

/// Throws the same numbers each time.
struct Dice(u64);

impl Dice {
    fn below(&mut self, count: usize) -> usize {
        // SplitMix64
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((mixed ^ mixed >> 31) % count.max(1) as u64) as usize
    }

    fn one_of<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }
}
