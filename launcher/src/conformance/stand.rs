//! A private system for one program: wires that nobody else sees, and a place to start it in. Nothing of it is left.

use super::Stage;
use crate::privacy;
use crate::root::Root;
use rustix::process::{Pid, Signal};
use shell::{Domain, Error, HeldWire, Port, Role, SystemFile, Termination, now_ns, sleep_until};
use std::fs::File;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};

/// The service's name in the system file.
const SERVICE: &str = "candidate";
/// Wires that have another layout than their ports.
const ODD: &str = "odd/";
/// Between two looks at a process [ns].
const LOOK_NS: u64 = 2_000_000;
/// A program that is late is waited for so many times as long as it may take: that it is late is all that shall be said.
const LATE: u64 = 2;
/// What a program has said is remembered up to this length.
const SAID_BYTES_MAX: usize = 2000;

/// The system.
pub struct Stand {
    /// The stage that is tried.
    pub stage: Stage,
    /// Its place in shared memory.
    pub domain: Domain,
    /// True once the trial is to end.
    pub termination: Termination,
    /// Time to open all wires [ms].
    pub start_timeout_ms: u64,
    program: PathBuf,
    arguments: Vec<String>,
    wires: Vec<(String, Role, HeldWire)>,
    _odd: Vec<HeldWire>,
    // Dropped last: it takes the folder with it.
    root: Root,
}

/// How a process has ended that should not have started.
pub struct Refusal {
    /// What was wrong, for a person.
    pub what: &'static str,
    /// How it ended; `None` where it had to be killed.
    pub status: Option<ExitStatus>,
    /// What it said on standard error.
    pub said: String,
}

impl Stand {
    /// Makes the system and its wires.
    pub fn new(
        stage: Stage,
        (program, arguments): (PathBuf, &[String]),
        config: &str,
        start_timeout_ms: u64,
        termination: Termination,
    ) -> Result<Self, Error> {
        let name = format!("trial_{}", std::process::id());
        let text = |inputs: &str, outputs: &str, config: &str| {
            format!(
                "[system]\nname = \"{name}\"\n\n[service.{SERVICE}]\nexec = [{:?}]\n{}{}start_timeout_ms = {start_timeout_ms}\n\
                 config = {config}\n",
                program.display().to_string(),
                table("inputs", [stage.trigger()].iter().chain(stage.observed()), inputs),
                table("outputs", [stage.answers()].iter(), outputs),
            )
        };
        let config = if config.is_empty() { "{}" } else { config };
        let plain = text("", "", config);
        let file = SystemFile::parse("the trial's system file", &plain)?;
        let root = Root::take(&file)?;
        root.write("plain.toml", &plain)?;
        root.write("odd_inputs.toml", &text(ODD, "", config))?;
        root.write("odd_outputs.toml", &text("", ODD, config))?;
        root.write("unknown_key.toml", &text("", "", &with_unknown_key(config)))?;
        let domain = Domain::enter(&file, "launcher")?;
        privacy::close(&file)?;
        let read = [stage.trigger()].into_iter().chain(stage.observed().iter().copied());
        let mut wires = Vec::new();
        for (port, role) in read
            .map(|port| (port, Role::Reader))
            .chain([(stage.answers(), Role::Writer)])
        {
            wires.push((wire(port), role, domain.create(&wire(port), port)?));
        }
        let odd =
            [stage.trigger(), stage.answers()].map(|port| domain.create_odd(&format!("{ODD}{}", wire(port)), port));
        let odd: Result<Vec<HeldWire>, Error> = odd.into_iter().collect();
        Ok(Self {
            stage,
            domain,
            termination,
            start_timeout_ms,
            program,
            arguments: arguments.to_vec(),
            wires,
            _odd: odd?,
            root,
        })
    }

    /// Starts the program for the n-th time, and waits until it has all its wires open; how long that took [ns]. Late is
    /// late, but no reason to stop.
    pub fn start(&self, generation: u32) -> Result<(Candidate, Option<u64>), Error> {
        self.root
            .write(&format!("{SERVICE}.generation"), &generation.to_string())?;
        let mut candidate = self.spawn("plain.toml", SERVICE)?;
        let started_ns = now_ns();
        let last_ns = started_ns + LATE * self.start_timeout_ms * 1_000_000;
        while now_ns() < last_ns && candidate.ended()?.is_none() {
            self.go_on()?;
            if self.is_ready(&candidate) {
                return Ok((candidate, Some(now_ns() - started_ns)));
            }
            sleep_until(now_ns() + LOOK_NS);
        }
        Ok((candidate, None))
    }

    /// Starts the program with something that it must refuse, and sees how it ends.
    pub fn refused(&self, what: &'static str, file: &str, service: Option<&str>) -> Result<Refusal, Error> {
        let mut candidate = self.spawn(file, service.unwrap_or(SERVICE))?;
        let status = self.wait_for_end(&mut candidate, LATE * self.start_timeout_ms * 1_000_000)?;
        let said = candidate.said();
        self.kill(candidate)?;
        Ok(Refusal { what, status, said })
    }

    /// Ends a process for good, and removes what it leaves: the next one must not meet it.
    pub fn kill(&self, candidate: Candidate) -> Result<(), Error> {
        drop(candidate);
        let _ = self.domain.clean();
        self.go_on()
    }

    /// How a process ends, `None` where it has not after so long [ns].
    pub fn wait_for_end(&self, candidate: &mut Candidate, longest_ns: u64) -> Result<Option<ExitStatus>, Error> {
        let last_ns = now_ns() + longest_ns;
        loop {
            if let Some(status) = candidate.ended()? {
                return Ok(Some(status));
            }
            if now_ns() > last_ns {
                return Ok(None);
            }
            self.go_on()?;
            sleep_until(now_ns() + LOOK_NS);
        }
    }

    /// An error once the trial is to end.
    pub fn go_on(&self) -> Result<(), Error> {
        if self.termination.requested() {
            return Err(Error::internal("interrupted"));
        }
        Ok(())
    }

    /// The process of the candidate that writes the answers: a program may run behind a wrapper.
    pub fn writer(&self, candidate: &Candidate) -> Option<u32> {
        let (_, _, held) = self.wires.iter().find(|(_, role, _)| *role == Role::Writer)?;
        let mut peers = held.peers().into_iter();
        peers.find_map(|(role, pid)| (role == Role::Writer && candidate.owns(pid)).then_some(pid))
    }

    fn is_ready(&self, candidate: &Candidate) -> bool {
        self.wires.iter().all(|(_, role, held)| {
            let mut peers = held.peers().into_iter();
            peers.any(|(other, pid)| other == *role && candidate.owns(pid))
        })
    }

    fn spawn(&self, file: &str, service: &str) -> Result<Candidate, Error> {
        let folder = PathBuf::from(self.root.write("said", "")?);
        let failed =
            |error: std::io::Error| Error::unavailable(format!("cannot start {}: {error}", self.program.display()));
        let mut command = Command::new(&self.program);
        command
            .args(&self.arguments)
            .arg(folder.with_file_name(file))
            .arg(service)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(File::create(&folder).map_err(failed)?);
        shell::bind_to_parent(&mut command);
        shell::harden_descriptors();
        Ok(Candidate {
            child: command.spawn().map_err(failed)?,
            said: folder,
        })
    }
}

/// The wire of a port.
pub fn wire(port: Port) -> String {
    format!("trial/{}", port.name())
}

fn table<'a>(word: &str, ports: impl Iterator<Item = &'a Port>, prefix: &str) -> String {
    let entries: Vec<String> = ports
        .map(|port| format!("{} = \"{prefix}{}\"", port.name(), wire(*port)))
        .collect();
    format!("{word} = {{ {} }}\n", entries.join(", "))
}

fn with_unknown_key(config: &str) -> String {
    let inner = config
        .trim()
        .trim_start_matches('{')
        .trim_end_matches('}')
        .trim()
        .trim_end_matches(',');
    let comma = if inner.is_empty() { "" } else { ", " };
    format!("{{ {inner}{comma}no_such_key = 1 }}")
}

/// The program that is tried: it leads a process group of its own, which ends with it.
pub struct Candidate {
    child: Child,
    said: PathBuf,
}

impl Candidate {
    /// How it has ended, `None` while it runs.
    pub fn ended(&mut self) -> Result<Option<ExitStatus>, Error> {
        let status = self.child.try_wait();
        status.map_err(|error| Error::internal(format!("cannot wait for a child: {error}")))
    }

    /// Sends a signal to it and to whatever it has started.
    pub fn signal(&self, signal: Signal) {
        if let Some(group) = raw(self.child.id()) {
            // It may have ended by itself.
            let _ = rustix::process::kill_process_group(group, signal);
        }
    }

    /// What it has said on standard error: the end of it.
    pub fn said(&self) -> String {
        let bytes = std::fs::read(&self.said).unwrap_or_default();
        let begin = bytes.len().saturating_sub(SAID_BYTES_MAX);
        String::from_utf8_lossy(&bytes[begin..]).trim().to_owned()
    }

    fn owns(&self, pid: u32) -> bool {
        let leader = self.child.id();
        pid == leader || raw(pid).and_then(|pid| rustix::process::getpgid(Some(pid)).ok()) == raw(leader)
    }
}

impl Drop for Candidate {
    fn drop(&mut self) {
        self.signal(Signal::KILL);
        let _ = self.child.wait();
    }
}

fn raw(pid: u32) -> Option<Pid> {
    i32::try_from(pid).ok().and_then(Pid::from_raw)
}

/// How a process ended, for a person.
pub fn ending(status: Option<ExitStatus>) -> String {
    match status.map(|status| (status.code(), status.signal())) {
        None => "did not end".into(),
        Some((Some(code), _)) => format!("ended with code {code}"),
        Some((_, signal)) => format!("ended by signal {}", signal.unwrap_or(0)),
    }
}

/// Memory that a process has for itself alone [bytes].
pub fn own_memory(pid: u32) -> Option<u64> {
    let status = std::fs::read_to_string(Path::new("/proc").join(pid.to_string()).join("status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib << 10)
}
