//! On which processors a process runs, and before whom, as the kernel has it.

use serde::Serialize;
use std::fmt;
use std::fs::read_to_string;

/// Of `/proc/PID/stat`, counted from the process's state on: its priority among real-time processes, and the policy.
const PRIORITY: usize = 37;
const POLICY: usize = 38;

/// Where and how a process runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Placement {
    /// The processors it may run on, as `0-3,6`.
    pub cpus: String,
    /// `other`, `fifo 50`, …
    pub sched: String,
    /// Memory that is not paged out [KiB].
    pub locked_kib: u64,
}

impl Placement {
    /// That of a process; `None` where it is not there.
    #[must_use]
    pub fn of(pid: u32) -> Option<Self> {
        let status = read_to_string(format!("/proc/{pid}/status")).ok()?;
        let stat = read_to_string(format!("/proc/{pid}/stat")).ok()?;
        Self::parse(&status, &stat)
    }

    fn parse(status: &str, stat: &str) -> Option<Self> {
        let field = |name: &str| {
            status
                .lines()
                .find_map(|line| line.strip_prefix(name)?.strip_prefix(":\t"))
        };
        // The program's name stands in brackets, and may hold spaces and brackets.
        let numbers: Vec<&str> = stat.rsplit_once(')')?.1.split_ascii_whitespace().collect();
        let priority = numbers.get(PRIORITY)?;
        let sched = match *numbers.get(POLICY)? {
            "0" => "other".into(),
            "1" => format!("fifo {priority}"),
            "2" => format!("rr {priority}"),
            "3" => "batch".into(),
            "5" => "idle".into(),
            "6" => "deadline".into(),
            policy => format!("policy {policy}"),
        };
        Some(Self {
            cpus: field("Cpus_allowed_list")?.into(),
            sched,
            locked_kib: field("VmLck")
                .and_then(|size| size.trim().strip_suffix(" kB")?.parse().ok())
                .unwrap_or(0),
        })
    }
}

impl fmt::Display for Placement {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} {}", self.cpus, self.sched)?;
        if self.locked_kib > 0 {
            formatter.write_str(" locked")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_is_told_as_the_kernel_has_it() {
        let status = "Name:\tx\nVmLck:\t    1024 kB\nCpus_allowed:\t2\nCpus_allowed_list:\t1\n";
        let stat = format!("7 (a ) b) S{} 50 1 0", " 3".repeat(36));
        let placement = Placement::parse(status, &stat).unwrap();
        assert_eq!(placement.to_string(), "1 fifo 50 locked");
        assert_eq!(placement.locked_kib, 1024);
        assert_eq!(Placement::parse("", ""), None);
    }

    #[test]
    fn this_process_is_an_ordinary_one() {
        let placement = Placement::of(std::process::id()).unwrap();
        assert!(!placement.cpus.is_empty());
        assert_eq!(Placement::of(u32::MAX), None);
    }
}
