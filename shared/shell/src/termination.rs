//! SIGTERM, SIGINT and SIGHUP, as a flag that every wait looks at.

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// True once one of these signals has come.
#[derive(Clone, Debug)]
pub struct Termination(Arc<AtomicBool>);

impl Termination {
    /// Takes over SIGTERM and SIGINT, and SIGHUP where it is not ignored (`nohup`); from here on they set the flag instead of
    /// ending the process.
    ///
    /// # Errors
    /// The system refuses to take a handler.
    pub fn listen() -> std::io::Result<Self> {
        let flag = Arc::new(AtomicBool::new(false));
        for signal in [SIGTERM, SIGINT, SIGHUP] {
            if signal != SIGHUP || !ignores_hangup() {
                signal_hook::flag::register(signal, flag.clone())?;
            }
        }
        Ok(Self(flag))
    }

    /// Whether the process is to end.
    #[must_use]
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Whether whoever started this process had it go on without a terminal.
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    ignored.is_some_and(|mask| mask >> (SIGHUP - 1) & 1 == 1)
}
