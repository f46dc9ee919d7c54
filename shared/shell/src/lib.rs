//! What a service process does around its algorithm: it reads its own table of the system file, opens its wires, waits,
//! hands samples over, and ends when it is told to.
//!
//! ```no_run
//! # use messages::{Frame, Resumable, Sinkage};
//! # struct SinkageTracker;
//! # impl SinkageTracker {
//! #     fn new(_: ()) -> Self { Self }
//! #     fn step(&mut self, _: &Frame) -> Sinkage { todo!() }
//! # }
//! # impl Resumable for SinkageTracker {
//! #     fn state_bytes(&self) -> usize { 0 }
//! #     fn save(&self, _: &mut [u8]) {}
//! #     fn restore(&mut self, _: &[u8]) -> Result<(), &'static str> { Ok(()) }
//! # }
//! fn main() -> std::process::ExitCode {
//!     shell::main(|shell| {
//!         let mut tracker = SinkageTracker::new(shell.config(|_| Ok(()))?);
//!         let mut frames = shell.input::<Frame>("frames")?;
//!         let sinkage = shell.output::<Sinkage>("sinkage")?;
//!         shell.on_each(&mut tracker, &mut frames, &sinkage, |tracker, frame| Ok(tracker.step(frame)))
//!     })
//! }
//! ```

mod bell;
mod checkpoint;
mod clock;
mod error;
mod input;
mod journal;
mod memory;
mod output;
mod placement;
mod process;
mod system_file;
mod termination;
mod wire;

pub use clock::{now_ns, sleep_until};
pub use error::{Error, tell};
pub use input::{Input, Observation, Tap};
pub use output::Output;
pub use placement::{Cpus, OnRefusal, Priority, Sched};
pub use process::{bind_to_parent, harden_descriptors, wake_when_children_end};
pub use system_file::{Mode, Restart, ServiceTable, SystemFile, SystemTable};
pub use termination::Termination;
pub use wire::{AnyTap, Domain, HeldWire, Port, RELEASE, Role, SUPERVISION_WIRE};

use checkpoint::{Checkpoint, Cut};
use clap::Parser;
use input::Attention;
use messages::{Header, Message, Resumable, Status};
use serde::de::DeserializeOwned;
use std::io::Read;
use std::path::PathBuf;
use std::process::ExitCode;
use std::rc::Rc;

/// A stage's state is kept after every so many triggers: its successor steps through those since then again, unheard.
const CHECKPOINT_TRIGGERS: u64 = 8;
/// Bytes of a file that is read as a whole, at the most.
const FILE_MAX: u64 = 256 << 20;
/// Ticks that a source makes good at the most: a stage behind it has room for as many.
const CATCH_UP_TICKS: u64 = 32;
/// What the checkpoint of a process is called that is to take the place of another.
pub const REHEARSAL_CHECKPOINT: &str = "rehearsal.checkpoint";

/// One service of a Terrasense system. It is started by `terrasense up`, or by hand with the same words.
#[derive(Debug, Parser)]
struct Arguments {
    /// Check the service's configuration and end: exit code 0 where it is right, 78 where it is not.
    #[arg(long)]
    check: bool,
    /// The system file; print one with `terrasense default-system`.
    #[arg(value_name = "SYSTEM.TOML")]
    system: String,
    /// The service's name in it.
    #[arg(value_name = "SERVICE")]
    name: String,
}

/// A service process: what the system file says of it, and its place in shared memory.
#[derive(Debug)]
pub struct Shell {
    system: SystemFile,
    name: String,
    check_only: bool,
    attention: Rc<Attention>,
    domain: Option<Domain>,
}

/// Runs a service: parses the command line, and turns the outcome into an exit code.
pub fn main(service: impl FnOnce(&mut Shell) -> Result<(), Error>) -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 64 } else { 0 });
        }
    };
    let name = format!("service {}", arguments.name);
    match Shell::new(arguments).and_then(|mut shell| service(&mut shell)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => error.exit(&name),
    }
}

impl Shell {
    fn new(arguments: Arguments) -> Result<Self, Error> {
        let system = SystemFile::read(&arguments.system)?;
        if !system.services.contains_key(&arguments.name) {
            let known: Vec<&str> = system.services.keys().map(String::as_str).collect();
            return Err(Error::usage(format!(
                "{} has no [service.{}]; it has: {}",
                arguments.system,
                arguments.name,
                known.join(", ")
            )));
        }
        let termination = Termination::listen().map_err(|error| Error::internal(error.to_string()))?;
        let attention = Rc::new(Attention::new(termination));
        Ok(Self {
            system,
            name: arguments.name,
            check_only: arguments.check,
            attention,
            domain: None,
        })
    }

    /// This service's `config`, as its own type, checked by `validate`, which returns a key and what is wrong with its
    /// value.
    ///
    /// # Errors
    /// Names the line of what is unknown, missing, of another type or out of range.
    pub fn config<C: DeserializeOwned>(
        &self,
        validate: impl Fn(&C) -> Result<(), (&'static str, String)>,
    ) -> Result<C, Error> {
        self.system.config(&self.name, validate)
    }

    /// Whether this service writes a port of this name: what a source does not write it need not make.
    #[must_use]
    pub fn writes(&self, port: &str) -> bool {
        self.table().outputs.contains_key(port)
    }

    /// Opens the wire whose samples trigger this service.
    ///
    /// # Errors
    /// The system file names no wire for the port, the wire is not there, or its samples have another layout.
    pub fn input<T: Message>(&mut self, port: &str) -> Result<Input<T>, Error> {
        let wire = self.wire(port, true)?;
        let attention = self.attention.clone();
        let head = self.system.head_of(&wire);
        Input::open(self.domain()?, &wire, &head, attention)
    }

    /// Opens a wire that this service takes in when it is triggered. A port without a wire observes nothing.
    ///
    /// # Errors
    /// The wire is not there, or its samples have another layout.
    pub fn observation<T: Message>(&mut self, port: &str) -> Result<Observation<T>, Error> {
        let wire = self.table().inputs.get(port).map(|wire| wire.get_ref().clone());
        let attention = self.attention.clone();
        Observation::open(self.domain()?, wire.as_deref(), attention)
    }

    /// Opens a wire that this service writes.
    ///
    /// # Errors
    /// The system file names no wire for the port, the wire is not there, or its samples have another layout.
    pub fn output<T: Message>(&mut self, port: &str) -> Result<Output<T>, Error> {
        let wire = self.wire(port, false)?;
        let succeeded = self.table().takes_over.get(port).map(|wire| wire.get_ref().clone());
        let termination = self.attention.termination.clone();
        let generation = self.generation();
        let domain = self.domain()?;
        let output = match &succeeded {
            Some(succeeded) => Output::open(domain, succeeded, Some(&wire), generation, &termination),
            None => Output::open(domain, &wire, None, generation, &termination),
        }?;
        output.wait_for(domain.release());
        Ok(output)
    }

    /// Opens a wire that this service writes, if the system file names one: a source may have more to say than is asked.
    ///
    /// # Errors
    /// The wire is not there, or its samples have another layout.
    pub fn output_if_wired<T: Message>(&mut self, port: &str) -> Result<Option<Output<T>>, Error> {
        self.writes(port).then(|| self.output(port)).transpose()
    }

    /// Answers every sample of `input` with exactly one of `output`, until the process is to end, another process has taken
    /// its place, or the recording is over. Inside, `step` may first take in observations. The stage goes on where its
    /// predecessor stopped.
    ///
    /// # Errors
    /// A wire is broken, or `step` failed.
    pub fn on_each<S: Resumable, I: Message, O: Message>(
        &self,
        stage: &mut S,
        input: &mut Input<I>,
        output: &Output<O>,
        mut step: impl FnMut(&mut S, &I) -> Result<O, Error>,
    ) -> Result<(), Error> {
        let mut checkpoint = self.resume(stage, input, output)?;
        for count in 1_u64.. {
            let mut trigger = Header::default();
            let answer = input.next(|sample| {
                trigger = *sample.header();
                if trigger.status == Status::ENDED || output.is_over(&trigger) {
                    return None;
                }
                Some(step(stage, sample))
            })?;
            match answer {
                Some(Some(sample)) => output.send(sample?)?,
                Some(None) if trigger.status == Status::ENDED => {
                    output.end(trigger.taken_ns, trigger.sequence)?;
                    // The other wires go on: take them in to their ends, so that their writers can end too.
                    let end = Header {
                        taken_ns: u64::MAX,
                        ..trigger
                    };
                    step(stage, input.substitute(end))?;
                    break;
                }
                Some(None) | None => break,
            }
            if let Some(checkpoint) = checkpoint
                .as_mut()
                .filter(|_| count.is_multiple_of(CHECKPOINT_TRIGGERS))
            {
                let observed = self.attention.cut();
                checkpoint.keep(stage, &Cut { trigger, observed });
            }
        }
        self.until_told();
        Ok(())
    }

    /// Lets the stage and its inputs go on where its predecessor stopped; what the stage is to keep its state in. A replay
    /// neither restarts nor swaps.
    fn resume<S: Resumable, I: Message, O: Message>(
        &self,
        stage: &mut S,
        input: &mut Input<I>,
        output: &Output<O>,
    ) -> Result<Option<Checkpoint>, Error> {
        if self.mode() == Mode::Replay {
            return Ok(None);
        }
        let table = self.table();
        let file = if table.takes_over.is_empty() {
            "checkpoint"
        } else {
            REHEARSAL_CHECKPOINT
        };
        let path = PathBuf::from(self.system.root()).join(format!("{}.{file}", self.name));
        let config = table.config.as_ref().map(|config| config.get_ref().to_string());
        let mut checkpoint = Checkpoint::open(&path, stage, &config.unwrap_or_default())?;
        if let Some(answered) = output.answered() {
            let cut = checkpoint.restore(stage, &answered);
            input.resume_after(&cut.map_or(answered, |cut| cut.trigger));
            cut.iter().for_each(|cut| self.attention.resume_after(&cut.observed));
        }
        Ok(Some(checkpoint))
    }

    /// Waits until the process is to end. What it has sent stays readable for as long.
    pub fn until_told(&self) {
        while self.running() {
            sleep_until(now_ns() + 20_000_000);
        }
    }

    /// Calls `act` for every tick `k` at `start + k * period`, until the process is to end. Who comes late catches up, but does
    /// not make good more than a few ticks.
    ///
    /// # Errors
    /// `act` failed.
    pub fn on_tick(&self, period_ns: u64, mut act: impl FnMut(u64, u64) -> Result<(), Error>) -> Result<(), Error> {
        let period_ns = period_ns.max(1);
        let started_ns = self.started_ns();
        let mut next = now_ns().saturating_sub(started_ns) / period_ns + 1;
        while !self.attention.termination.requested() {
            let instant_ns = started_ns + next * period_ns;
            if now_ns() < instant_ns {
                sleep_until(instant_ns);
                continue;
            }
            act(next, instant_ns)?;
            let due = now_ns().saturating_sub(started_ns) / period_ns;
            next = (next + 1).max(due.saturating_sub(CATCH_UP_TICKS));
        }
        Ok(())
    }

    /// Whether samples may be overtaken by newer ones.
    #[must_use]
    pub fn mode(&self) -> Mode {
        self.system.system.mode
    }

    /// Whether the process is to go on.
    #[must_use]
    pub fn running(&self) -> bool {
        !self.attention.termination.requested()
    }

    /// `CLOCK_MONOTONIC` [ns] at the start of the system: where a simulated rover's time begins.
    #[must_use]
    pub fn started_ns(&self) -> u64 {
        self.birth("started_ns").unwrap_or(0)
    }

    /// Reads a file that the configuration names.
    ///
    /// # Errors
    /// Names the file that cannot be read, is no file, or is too large.
    pub fn read(&self, path: &str) -> Result<Vec<u8>, Error> {
        let mut bytes = Vec::new();
        let mut file = self
            .open(path)?
            .ok_or_else(|| Error::data(format!("{path}: No such file or directory")))?;
        let failed = |error: std::io::Error| Error::data(format!("{path}: {error}"));
        file.by_ref()
            .take(FILE_MAX + 1)
            .read_to_end(&mut bytes)
            .map_err(failed)?;
        if bytes.len() as u64 > FILE_MAX {
            return Err(Error::data(format!("{path}: larger than {} MiB", FILE_MAX >> 20)));
        }
        Ok(bytes)
    }

    /// Opens a file that the configuration names, to be read piece by piece. `None` where there is no such file.
    ///
    /// # Errors
    /// Names the file that cannot be read, or is no file: a pipe would be waited for, a device has no end.
    pub fn open(&self, path: &str) -> Result<Option<std::io::BufReader<std::fs::File>>, Error> {
        let failed = |error: std::io::Error| Error::data(format!("{path}: {error}"));
        match std::fs::metadata(path) {
            Ok(about) if about.is_file() => {}
            Ok(_) => return Err(Error::data(format!("{path}: is no regular file"))),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(failed(error)),
        }
        std::fs::File::open(path)
            .map(|file| Some(std::io::BufReader::new(file)))
            .map_err(failed)
    }

    fn table(&self) -> &ServiceTable {
        // `new` has seen that the table is there.
        &self.system.services[&self.name]
    }

    fn wire(&self, port: &str, input: bool) -> Result<String, Error> {
        let (table, word) = if input {
            (&self.table().inputs, "inputs")
        } else {
            (&self.table().outputs, "outputs")
        };
        table.get(port).map(|wire| wire.get_ref().clone()).ok_or_else(|| {
            let line = self.system.service_line(&self.name);
            Error::config(format!(
                "{}:{line}: service `{}` needs a wire for its port `{port}`: {word} = {{ {port} = \"…\" }}",
                self.system.path, self.name
            ))
        })
    }

    /// Enters the system at the first wire: the configuration has been parsed by then.
    fn domain(&mut self) -> Result<&Domain, Error> {
        if self.check_only {
            return Err(Error::checked());
        }
        if self.domain.is_none() {
            placement::apply(&self.system, &self.name)?;
            self.domain = Some(Domain::enter(&self.system, &self.name)?);
        }
        self.domain.as_ref().ok_or_else(|| Error::internal("no domain"))
    }

    /// How often this service has been started, as the launcher counts.
    fn generation(&self) -> u32 {
        self.birth(&format!("{}.generation", self.name))
            .and_then(|count| u32::try_from(count).ok())
            .unwrap_or(0)
    }

    /// A number that the launcher wrote into the system's folder before it started this process.
    fn birth(&self, file: &str) -> Option<u64> {
        std::fs::read_to_string(format!("{}/{file}", self.system.root()))
            .ok()?
            .trim()
            .parse()
            .ok()
    }
}
