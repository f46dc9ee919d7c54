//! On which processors a service runs, before whom, and whether its memory stays: what its table of the system file says.

use crate::{Error, Mode, Port, SystemFile, tell};
use rustix::mm::MlockAllFlags;
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CapabilitySet, CpuSet, capabilities, sched_getaffinity, sched_setaffinity};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::ops::Range;
use toml::Spanned;

/// Processors of a machine at the most.
const CPUS_MAX: u32 = CpuSet::MAX_CPU as u32;

/// Where services run whose tables name no processors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Places {
    /// Each camera and the stages after it on one processor, another for each camera; the other services where the kernel
    /// sees fit. The stages of a cycle run one after the other: on one processor none waits for another to wake, and the
    /// picture is in its cache.
    #[default]
    Chains,
    /// All where the kernel sees fit.
    Kernel,
}

/// The processors that a service may run on.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "Vec<u32>")]
pub struct Cpus(Vec<u32>);

impl TryFrom<Vec<u32>> for Cpus {
    type Error = String;

    fn try_from(cpus: Vec<u32>) -> Result<Self, String> {
        match cpus.iter().find(|cpu| **cpu >= CPUS_MAX) {
            Some(cpu) => Err(format!("processors are numbered from 0 to {}, not {cpu}", CPUS_MAX - 1)),
            None if cpus.is_empty() => Err("names no processor: leave it out to run on any".into()),
            None => Ok(Self(cpus)),
        }
    }
}

/// How the kernel chooses among processes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sched {
    /// `SCHED_FIFO` with this priority: before all ordinary processes, and those of a lower one.
    Fifo(Priority),
}

/// A priority of `SCHED_FIFO`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "i64")]
pub struct Priority(u8);

impl TryFrom<i64> for Priority {
    type Error = String;

    fn try_from(priority: i64) -> Result<Self, String> {
        match u8::try_from(priority) {
            Ok(priority @ 1..=99) => Ok(Self(priority)),
            _ => Err(format!("a priority is from 1 to 99, not {priority}")),
        }
    }
}

/// What to do where the machine refuses what a service asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OnRefusal {
    /// Say so, and go on without.
    #[default]
    Warn,
    /// End with exit code 78: the launcher does not try again.
    Refuse,
}

/// Asks the machine for what the service's table says.
///
/// # Errors
/// The machine refuses, and the table says that this is to end the service.
pub(crate) fn apply(system: &SystemFile, name: &str) -> Result<(), Error> {
    let Some(table) = system.services.get(name) else {
        return Ok(());
    };
    let judge = |span: Range<usize>, outcome: Result<(), String>| match (outcome, table.on_refusal) {
        (Ok(()), _) => Ok(()),
        (Err(why), OnRefusal::Refuse) => Err(system.error_at(span, &why)),
        (Err(why), OnRefusal::Warn) => {
            let warning = system.error_at(span, &why);
            tell(format_args!(
                "service {name}: {warning}; it goes on without (on_refusal = \"warn\")"
            ));
            Ok(())
        }
    };
    if let Some(cpus) = &table.cpus {
        judge(cpus.span(), run_on(cpus.get_ref()))?;
    } else if let Err(why) = keep_chains_together(system, name) {
        tell(format_args!(
            "service {name}: {why}; it goes on where the kernel sees fit"
        ));
    }
    if let Some(sched) = &table.sched {
        judge(sched.span(), schedule(*sched.get_ref()))?;
    }
    match &table.lock_memory {
        Some(lock) if *lock.get_ref() => judge(lock.span(), lock_memory()),
        _ => Ok(()),
    }
}

/// Runs a service where [`Places`] says. In a replay the stages of several cycles run side by side.
fn keep_chains_together(system: &SystemFile, name: &str) -> Result<(), String> {
    if system.system.placement == Places::Kernel || system.system.mode == Mode::Replay {
        return Ok(());
    }
    let Some(chain) = chain_of(system, name) else {
        return Ok(());
    };
    let processors = fastest(&allowed()?, speed);
    if processors.len() < 2 {
        return Ok(());
    }
    // From the last on: the first ones are busy with interrupts.
    let processor = processors[processors.len() - 1 - chain % processors.len()];
    run_on(&Cpus(vec![processor]))
}

/// Which of the system's chains a service belongs to, counted from 0; `None` where no camera stands at its beginning.
fn chain_of(system: &SystemFile, name: &str) -> Option<usize> {
    let frames = Port::Frames.name();
    let table = system.services.get(name)?;
    let triggers = table.outputs.keys().find_map(|port| table.trigger_of(port));
    let head = match table.outputs.get(frames) {
        Some(wire) => wire.get_ref().clone(),
        None => system.head_of(triggers?),
    };
    let heads = system.services.values().filter_map(|table| table.outputs.get(frames));
    let heads: BTreeSet<&String> = heads.map(Spanned::get_ref).collect();
    heads.into_iter().position(|wire| *wire == head)
}

/// The processors that this process may run on.
fn allowed() -> Result<Vec<u32>, String> {
    let set = sched_getaffinity(None).map_err(|error| format!("cannot ask for the processors: {error}"))?;
    Ok((0..CPUS_MAX).filter(|cpu| set.is_set(*cpu as usize)).collect())
}

/// Those that are not slower than the others by more than a tenth: some machines have slow ones beside fast ones.
fn fastest(cpus: &[u32], speed: impl Fn(u32) -> u64) -> Vec<u32> {
    let best = cpus.iter().map(|cpu| speed(*cpu)).max().unwrap_or(0);
    let is_fast = |cpu: &u32| 10 * speed(*cpu) >= 9 * best;
    cpus.iter().copied().filter(is_fast).collect()
}

/// A processor's speed beside the others' of the machine; 0 where the kernel does not say.
fn speed(cpu: u32) -> u64 {
    let number = |file: &str| {
        let text = std::fs::read_to_string(format!("/sys/devices/system/cpu/cpu{cpu}/{file}")).ok()?;
        text.trim().parse::<u32>().ok().map(u64::from)
    };
    number("cpu_capacity")
        .or_else(|| number("cpufreq/cpuinfo_max_freq"))
        .unwrap_or(0)
}

fn run_on(Cpus(cpus): &Cpus) -> Result<(), String> {
    let failed = |error| format!("cannot run on processors {cpus:?}: {error}");
    let allowed = sched_getaffinity(None).map_err(failed)?;
    let mut wanted = CpuSet::new();
    for cpu in cpus {
        let cpu = *cpu as usize;
        if !allowed.is_set(cpu) {
            return Err(format!("processor {cpu} is not there, or not for this process"));
        }
        wanted.set(cpu);
    }
    sched_setaffinity(None, &wanted).map_err(failed)
}

fn schedule(Sched::Fifo(Priority(priority)): Sched) -> Result<(), String> {
    let parameters = libc::sched_param {
        sched_priority: priority.into(),
    };
    // SAFETY: the call reads one structure, which outlives it, and changes nothing in this process's memory.
    #[allow(unsafe_code)]
    let outcome = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
    if outcome == 0 {
        return Ok(());
    }
    Err(format!(
        "SCHED_FIFO {priority}: {}; it needs CAP_SYS_NICE, or a limit of `ulimit -r` of {priority} or more",
        std::io::Error::last_os_error()
    ))
}

/// Keeps what has been touched from being paged out. Pages that nobody touches are not fetched: a wire reserves room for
/// frames of the largest size.
fn lock_memory() -> Result<(), String> {
    let is_capable = capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    if let (Some(limit), false) = (getrlimit(Resource::Memlock).current, is_capable) {
        return Err(format!(
            "cannot lock memory: no more than {} KiB may be; it needs CAP_IPC_LOCK, or `ulimit -l unlimited`",
            limit >> 10
        ));
    }
    rustix::mm::mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT)
        .map_err(|error| format!("cannot lock memory: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors(line: &str) -> String {
        let text = format!("[system]\nname = \"rover\"\n[service.sinkage]\nexec = [\"sinkage\"]\n{line}\n");
        SystemFile::parse("rover.toml", &text)
            .map(|_| String::new())
            .unwrap_or_else(|error| error.to_string())
    }

    #[test]
    fn each_camera_and_its_stages_are_a_chain() {
        let mut text = String::from("[system]\nname = \"rover\"\n");
        for (name, inputs, outputs) in [
            ("front_camera", "", "frames = \"front/frames\""),
            (
                "front_sinkage",
                "frames = \"front/frames\"",
                "sinkage = \"front/sinkage\"",
            ),
            (
                "front_soil",
                "sinkage = \"front/sinkage\", wheel = \"wheel\"",
                "soil = \"front/soil\"",
            ),
            ("rear_camera", "", "frames = \"rear/frames\""),
            ("rear_sinkage", "frames = \"rear/frames\"", "sinkage = \"rear/sinkage\""),
            ("telemetry", "", "wheel = \"wheel\", vibration = \"vibration\""),
            ("vibration", "vibration = \"vibration\"", "class = \"class\""),
        ] {
            let table = format!("exec = [\"x\"]\ninputs = {{ {inputs} }}\noutputs = {{ {outputs} }}\n");
            text += &format!("[service.{name}]\n{table}");
        }
        let system = SystemFile::parse("rover.toml", &text).unwrap();
        for (name, chain) in [
            ("front_camera", Some(0)),
            ("front_sinkage", Some(0)),
            ("front_soil", Some(0)),
            ("rear_camera", Some(1)),
            ("rear_sinkage", Some(1)),
            ("telemetry", None),
            ("vibration", None),
            ("nobody", None),
        ] {
            assert_eq!(chain_of(&system, name), chain, "{name}");
        }
    }

    #[test]
    fn slow_processors_are_left_out() {
        let speeds = [5200, 5000, 3900, 3900];
        assert_eq!(fastest(&[0, 1, 2, 3], |cpu| speeds[cpu as usize]), [0, 1]);
        assert_eq!(fastest(&[2, 3], |cpu| speeds[cpu as usize]), [2, 3]);
        assert_eq!(fastest(&[0, 2], |_| 0), [0, 2]);
        assert_eq!(fastest(&[], |_| 0), [0; 0]);
    }

    #[test]
    fn what_no_machine_can_do_is_refused_with_its_line() {
        assert_eq!(errors("cpus = [0, 3]\nsched = { fifo = 99 }\nlock_memory = true"), "");
        for (line, said) in [
            ("cpus = []", "names no processor"),
            ("cpus = [0, 70000]", "70000"),
            ("cpus = [-1]", "-1"),
            ("sched = { fifo = 0 }", "from 1 to 99"),
            ("sched = { fifo = 100 }", "from 1 to 99"),
            ("sched = { rr = 5 }", "rr"),
            ("on_refusal = \"ignore\"", "ignore"),
        ] {
            let error = errors(line);
            assert!(
                error.contains("rover.toml:5") && error.contains(said),
                "{line}: {error}"
            );
        }
    }
}
