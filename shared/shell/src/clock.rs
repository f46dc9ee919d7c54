//! The one clock: `CLOCK_MONOTONIC`, the same for every process of the machine, in every language.

use rustix::time::{ClockId, Timespec, clock_gettime};

/// Now [ns].
#[must_use]
pub fn now_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    u64::try_from(now.tv_sec).unwrap_or(0) * 1_000_000_000 + u64::try_from(now.tv_nsec).unwrap_or(0)
}

/// Sleeps until the instant [ns], or until a signal comes.
pub fn sleep_until(instant_ns: u64) {
    let until = Timespec {
        tv_sec: i64::try_from(instant_ns / 1_000_000_000).unwrap_or(i64::MAX),
        tv_nsec: i64::try_from(instant_ns % 1_000_000_000).unwrap_or(0),
    };
    // A signal ends the sleep: the caller looks at why it woke.
    let _ = rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &until);
}
