//! `doctor` and `clean`: what stands in the way of a system on this machine, and what killed ones have left.

use crate::commands::find;
use crate::root::{self, Trace};
use clap::Args;
use serde::Serialize;
use shell::Error;
use std::process::ExitCode;

/// Shared memory below this is little [bytes]: one system with VGA frames takes about a tenth of it.
const SPACE_MIN_BYTES: u64 = 256 << 20;

/// `terrasense doctor`
#[derive(Debug, Args)]
pub struct DoctorArguments {
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// `terrasense clean`
#[derive(Debug, Args)]
pub struct CleanArguments {
    /// Only the system of this name.
    #[arg(long)]
    name: Option<String>,
}

/// One thing that was looked at.
#[derive(Debug, Serialize)]
struct Finding {
    what: &'static str,
    fine: bool,
    /// Whether the system cannot run without it.
    needed: bool,
    found: String,
}

/// Looks at the machine; exit code 1 where something needed is missing.
pub fn run(arguments: &DoctorArguments) -> Result<ExitCode, Error> {
    let findings = [
        shared_memory(),
        programs(),
        leftovers(),
        locked_memory(),
        priority(),
        cores(),
    ];
    if arguments.json {
        let text = serde_json::to_string_pretty(&findings).map_err(|error| Error::internal(error.to_string()))?;
        println!("{text}");
    } else {
        for finding in &findings {
            let mark = match (finding.fine, finding.needed) {
                (true, _) => "ok  ",
                (false, true) => "BAD ",
                (false, false) => "note",
            };
            println!("{mark}  {:<16} {}", finding.what, finding.found);
        }
    }
    let healthy = findings.iter().all(|finding| finding.fine || !finding.needed);
    Ok(if healthy { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// Removes what killed launchers left.
pub fn clean(arguments: &CleanArguments) -> Result<ExitCode, Error> {
    let wanted = |trace: &Trace| arguments.name.as_ref().is_none_or(|name| *name == trace.name);
    let traces: Vec<Trace> = root::traces().into_iter().filter(wanted).collect();
    if traces.is_empty() {
        println!("nothing to clean");
    }
    for trace in traces {
        if !trace.runs && root::clean(&trace.name)? {
            println!(
                "removed what system `{}` had left ({} files in shared memory)",
                trace.name, trace.files
            );
        } else {
            println!("system `{}` runs; left as it is", trace.name);
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn shared_memory() -> Finding {
    let (fine, found) = match rustix::fs::statvfs("/dev/shm") {
        Ok(about) => {
            let free = about.f_bavail * about.f_frsize;
            let remedy = if free < SPACE_MIN_BYTES {
                "; enlarge it: mount -o remount,size=512M /dev/shm"
            } else {
                ""
            };
            (
                free >= SPACE_MIN_BYTES,
                format!("{} MiB free in /dev/shm{remedy}", free >> 20),
            )
        }
        Err(error) => (false, format!("/dev/shm: {error}; mount a tmpfs there")),
    };
    Finding {
        what: "shared memory",
        fine,
        needed: true,
        found,
    }
}

fn programs() -> Finding {
    let services = [
        "camera",
        "telemetry",
        "sinkage",
        "terramechanics",
        "vibration",
        "terrain",
    ];
    let missing: Vec<String> = services
        .iter()
        .map(|service| format!("terrasense-{service}"))
        .filter(|program| find(program, None).is_none())
        .collect();
    let found = if missing.is_empty() {
        "all services are installed".to_owned()
    } else {
        format!(
            "missing beside `terrasense` and on PATH: {}; build them: cargo build --release",
            missing.join(", ")
        )
    };
    Finding {
        what: "programs",
        fine: missing.is_empty(),
        needed: true,
        found,
    }
}

fn leftovers() -> Finding {
    let dead: Vec<Trace> = root::traces().into_iter().filter(|trace| !trace.runs).collect();
    let names: Vec<&str> = dead.iter().map(|trace| trace.name.as_str()).collect();
    let found = if dead.is_empty() {
        "none".to_owned()
    } else {
        format!(
            "killed systems left files in /dev/shm: {}; remove them: terrasense clean",
            names.join(", ")
        )
    };
    Finding {
        what: "leftovers",
        fine: dead.is_empty(),
        needed: false,
        found,
    }
}

fn locked_memory() -> Finding {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Memlock).current;
    let enough = limit.is_none_or(|bytes| bytes >= 64 << 20);
    let found = match limit {
        None => "unlimited".to_owned(),
        Some(bytes) => format!("{} KiB may be locked", bytes >> 10),
    };
    Finding {
        what: "locked memory",
        fine: enough,
        needed: false,
        found,
    }
}

fn priority() -> Finding {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Rtprio).current;
    let root = rustix::process::geteuid().is_root();
    let fine = root || limit.is_none_or(|most| most > 0);
    let found = if fine {
        "real-time priorities are allowed"
    } else {
        "no real-time priorities (ulimit -r)"
    };
    Finding {
        what: "priority",
        fine,
        needed: false,
        found: found.into(),
    }
}

fn cores() -> Finding {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    Finding {
        what: "cores",
        fine: cores >= 2,
        needed: false,
        found: format!("{cores}"),
    }
}
