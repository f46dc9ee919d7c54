//! The machine that the figures are of: without it they say nothing.

use serde::Serialize;
use std::fmt;
use std::fs::read_to_string;

/// What of a machine decides latencies.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Machine {
    /// The processor's name.
    pub processor: String,
    /// Logical cores that this process may use.
    pub cores: usize,
    /// The kernel's name and version.
    pub kernel: String,
    /// Memory [MiB].
    pub memory_mib: u64,
    /// The first core's frequency governor.
    pub governor: String,
    /// The first core's idle states, by name.
    pub idle_states: String,
}

impl Machine {
    /// This machine.
    #[must_use]
    pub fn here() -> Self {
        let kernel = |file: &str| word(&format!("/proc/sys/kernel/{file}")).unwrap_or_else(unreadable);
        Self {
            processor: field("/proc/cpuinfo", "model name").unwrap_or_else(|| std::env::consts::ARCH.into()),
            cores: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            kernel: format!("{} {}", kernel("ostype"), kernel("osrelease")),
            memory_mib: memory_mib().unwrap_or(0),
            governor: word("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor").unwrap_or_else(unreadable),
            idle_states: idle_states().unwrap_or_else(unreadable),
        }
    }

    /// The average load of the last minute: other work on the machine spoils the figures.
    #[must_use]
    pub fn load() -> String {
        let text = word("/proc/loadavg").unwrap_or_else(unreadable);
        text.split(' ').next().unwrap_or_default().to_owned()
    }
}

impl fmt::Display for Machine {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "{}, {} cores, {}, {} MiB, governor {}, idle states {}",
            self.processor, self.cores, self.kernel, self.memory_mib, self.governor, self.idle_states
        )
    }
}

fn unreadable() -> String {
    "unreadable".into()
}

fn word(path: &str) -> Option<String> {
    read_to_string(path).ok().map(|text| text.trim().to_owned())
}

fn field(path: &str, key: &str) -> Option<String> {
    let text = read_to_string(path).ok()?;
    let line = text.lines().find(|line| line.starts_with(key))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

fn memory_mib() -> Option<u64> {
    let kib: u64 = field("/proc/meminfo", "MemTotal")?
        .strip_suffix(" kB")?
        .trim()
        .parse()
        .ok()?;
    Some(kib / 1024)
}

fn idle_states() -> Option<String> {
    let folder = "/sys/devices/system/cpu/cpu0/cpuidle";
    let names: Vec<String> = (0..)
        .map_while(|state| word(&format!("{folder}/state{state}/name")))
        .collect();
    (!names.is_empty()).then(|| names.join(" "))
}
