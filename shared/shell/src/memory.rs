//! Memory that outlives a process: a file in the system's folder, mapped as words that several processes use at once.

use crate::Error;
use rustix::fs::{FallocateFlags, Mode, OFlags};
use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags};
use std::path::Path;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

/// Bytes of a word.
pub(crate) const WORD: usize = size_of::<u64>();

/// A mapped file. Every access is to whole words, and atomic: whatever another process does at the same time, a word is
/// what somebody wrote.
#[derive(Debug)]
pub(crate) struct Memory {
    start: NonNull<AtomicU64>,
    count: usize,
}

impl Memory {
    /// Maps the file, which is made, all zeros, where it is not there or has another length.
    ///
    /// # Errors
    /// There is no space, or the folder is not ours.
    pub(crate) fn create(path: &Path, count: usize) -> Result<Self, Error> {
        let failed = |error: Errno| Error::unavailable(format!("{}: {error}", path.display()));
        let bytes = (count * WORD) as u64;
        let file = rustix::fs::open(
            path,
            OFlags::RDWR | OFlags::CREATE | OFlags::CLOEXEC,
            Mode::RUSR | Mode::WUSR,
        )
        .map_err(failed)?;
        if rustix::fs::fstat(&file).map_err(failed)?.st_size.unsigned_abs() != bytes {
            rustix::fs::ftruncate(&file, 0).map_err(failed)?;
            // Takes the space now: memory that is not there later would end the process that touches it.
            rustix::fs::fallocate(&file, FallocateFlags::empty(), 0, bytes).map_err(failed)?;
        }
        Self::map(&file, count).map_err(failed)
    }

    /// Maps the file as it is; `None` where there is none.
    ///
    /// # Errors
    /// The file cannot be mapped.
    pub(crate) fn open(path: &Path) -> Result<Option<Self>, Error> {
        let failed = |error: Errno| Error::unavailable(format!("{}: {error}", path.display()));
        let file = match rustix::fs::open(path, OFlags::RDWR | OFlags::CLOEXEC, Mode::empty()) {
            Ok(file) => file,
            Err(Errno::NOENT) => return Ok(None),
            Err(error) => return Err(failed(error)),
        };
        let bytes = rustix::fs::fstat(&file).map_err(failed)?.st_size.unsigned_abs();
        let count = usize::try_from(bytes).unwrap_or(0) / WORD;
        Self::map(&file, count).map(Some).map_err(failed)
    }

    fn map(file: &impl std::os::fd::AsFd, count: usize) -> Result<Self, Errno> {
        let bytes = count.checked_mul(WORD).filter(|bytes| *bytes > 0).ok_or(Errno::INVAL)?;
        // SAFETY: a new mapping at an address of the kernel's choice. It is `bytes` long, as the file is; it is unmapped only
        // when this value is dropped, and lent only for as long as the value is borrowed.
        #[allow(unsafe_code)]
        let start = unsafe {
            rustix::mm::mmap(
                std::ptr::null_mut(),
                bytes,
                ProtFlags::READ | ProtFlags::WRITE,
                MapFlags::SHARED | MapFlags::POPULATE,
                file,
                0,
            )
        }?;
        let start = NonNull::new(start.cast()).ok_or(Errno::NOMEM)?;
        Ok(Self { start, count })
    }

    /// All words.
    pub(crate) fn words(&self) -> &[AtomicU64] {
        // SAFETY: the mapping holds `count` words, page-aligned, for as long as `self` lives; any bytes are a valid word, and
        // all processes use them as atomics.
        #[allow(unsafe_code)]
        unsafe {
            std::slice::from_raw_parts(self.start.as_ptr(), self.count)
        }
    }

    /// The first four bytes of a word, which is then never used as a whole: the kernel sleeps on four bytes.
    pub(crate) fn half_word(&self, index: usize) -> &AtomicU32 {
        let word: *const AtomicU64 = &raw const self.words()[index];
        // SAFETY: the first half of a word is aligned, stays mapped for as long as `self` is borrowed, and any bytes are valid.
        #[allow(unsafe_code)]
        unsafe {
            &*word.cast()
        }
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        // SAFETY: the mapping is ours, and nobody borrows it any more.
        #[allow(unsafe_code)]
        let _ = unsafe { rustix::mm::munmap(self.start.as_ptr().cast(), self.count * WORD) };
    }
}

/// Writes bytes, word by word. What is missing in the last word is zero.
pub(crate) fn store(words: &[AtomicU64], bytes: &[u8]) {
    let (whole, rest) = bytes.as_chunks::<WORD>();
    for (word, bytes) in words.iter().zip(whole) {
        word.store(u64::from_ne_bytes(*bytes), Ordering::Relaxed);
    }
    if let (Some(word), false) = (words.get(whole.len()), rest.is_empty()) {
        let mut last = [0; WORD];
        last[..rest.len()].copy_from_slice(rest);
        word.store(u64::from_ne_bytes(last), Ordering::Relaxed);
    }
}

/// Reads bytes, word by word.
pub(crate) fn load(words: &[AtomicU64], bytes: &mut [u8]) {
    for (word, bytes) in words.iter().zip(bytes.chunks_mut(WORD)) {
        let word = word.load(Ordering::Relaxed).to_ne_bytes();
        bytes.copy_from_slice(&word[..bytes.len()]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_mappings_of_a_file_are_one_memory() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("memory");
        assert!(Memory::open(&path).unwrap().is_none());
        let here = Memory::create(&path, 16).unwrap();
        let there = Memory::open(&path).unwrap().unwrap();
        store(&here.words()[2..], b"thirteen bytes"[..13].as_ref());
        let mut bytes = [0; 13];
        load(&there.words()[2..], &mut bytes);
        assert_eq!(&bytes, b"thirteen byte");
        assert_eq!(there.words().len(), 16);
        drop(here);
        assert_eq!(
            Memory::create(&path, 16).unwrap().words()[2].load(Ordering::Relaxed),
            u64::from_ne_bytes(*b"thirteen")
        );
    }

    #[test]
    fn an_empty_file_is_no_memory() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("empty"), "").unwrap();
        assert!(Memory::open(&folder.path().join("empty")).is_err());
    }
}
