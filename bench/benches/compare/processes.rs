//! A run of one variant: its processes, from the start to their stamps.

use crate::terrasense;
use bench::compare::{Pace, Part, Role, Stamps};
use bench::{Outcome, ScratchSystem};
use rustix::thread::sched_getaffinity;
use shell::{Termination, now_ns, sleep_until};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use tempfile::TempDir;

/// Cycles before those that count: memory is touched, the estimators have data, everyone has gone over every buffer.
pub const WARM_UP: u64 = 70;
/// What a run may take beyond its cycles [ns], and the longest cycle that it allows for.
const RUN_MORE_NS: u64 = 60_000_000_000;
const CYCLE_MAX_NS: u64 = 200_000_000;
/// Between two looks for the end of a process [ns].
const LOOK_NS: u64 = 20_000_000;

const ROLES: [Role; 4] = [Role::Terrain, Role::Terramechanics, Role::Sinkage, Role::Source];

/// What carries the cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Variant {
    /// One process, direct calls.
    Direct,
    /// The services under `terrasense up`.
    Terrasense,
    /// The same with `placement = "kernel"`.
    Unplaced,
    /// Unix sockets and postcard.
    Sockets,
    /// iceoryx2 with a `WaitSet`.
    Iceoryx2,
    /// zenoh with shared memory.
    Zenoh,
    /// dora with Python nodes.
    Dora,
}

impl Variant {
    /// The variant's name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Direct => "direct calls",
            Self::Terrasense => "Terrasense",
            Self::Unplaced => "Terrasense, kernel's place",
            Self::Sockets => "Unix sockets, postcard",
            Self::Iceoryx2 => "iceoryx2, WaitSet",
            Self::Zenoh => "zenoh, shared memory",
            Self::Dora => "dora, Python nodes",
        }
    }
}

/// Which processors the processes of a cycle run on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Cpus {
    /// All on the last one.
    Together,
    /// One after the other each on the next.
    Spread,
}

/// What is the same for all runs.
pub struct Bench {
    folder: TempDir,
    pub cycles: u64,
    pub cpus: Option<Cpus>,
    pub fifo: Option<u8>,
    /// The program of `bench/peers/over_zenoh`.
    pub zenoh: Option<PathBuf>,
    /// The Python that has dora; the module of `bench/peers/over_dora` is where cargo puts it beside.
    pub dora: Option<PathBuf>,
    pub termination: Termination,
}

impl Bench {
    /// Makes the input.
    pub fn new(cycles: u64, termination: Termination) -> Outcome<Self> {
        let folder = tempfile::tempdir()?;
        bench::compare::Feed::write(&folder.path().join("feed"))?;
        Ok(Self {
            folder,
            cycles,
            cpus: None,
            fifo: None,
            zenoh: None,
            dora: None,
            termination,
        })
    }

    /// Runs a variant once.
    pub fn run(&self, variant: Variant, pace: Pace) -> Outcome<Stamps> {
        let folder = tempfile::tempdir_in(self.folder.path())?;
        std::os::unix::fs::symlink(self.folder.path().join("feed"), folder.path().join("feed"))?;
        let part = |role| Part {
            role,
            folder: folder.path().into(),
            pace,
            cycles: self.cycles,
            warm_up: WARM_UP,
            cpu: cpu(role, self.cpus),
        };
        let last_ns = now_ns() + RUN_MORE_NS + (self.cycles + WARM_UP) * CYCLE_MAX_NS;
        let mut stamps = Stamps::default();
        let leave = match variant {
            Variant::Direct => {
                self.wait(vec![self.start(&own("direct")?, &part(Role::Source))?], last_ns)?;
                &[Role::Source][..]
            }
            Variant::Terrasense | Variant::Unplaced => {
                let system = match variant {
                    Variant::Unplaced => "placement = \"kernel\"\n",
                    _ => "",
                };
                let place = |role| self.place(role);
                terrasense::run(&part(Role::Source), system, place, last_ns, &self.termination)?;
                &[Role::Source, Role::Terrain]
            }
            Variant::Iceoryx2 => {
                let system = ScratchSystem::make()?;
                let mut words = own("iceoryx2")?;
                words.extend(["--system".into(), system.name().into()]);
                self.run_each(&words, part, last_ns)?
            }
            Variant::Sockets => self.run_each(&own("sockets")?, part, last_ns)?,
            Variant::Zenoh => {
                let program = self
                    .zenoh
                    .as_ref()
                    .ok_or("build bench/peers/over_zenoh, or give --zenoh")?;
                self.run_each(&[program.into()], part, last_ns)?
            }
            Variant::Dora => {
                let words = self.dora_words()?;
                self.wait(vec![self.start(&words, &part(Role::Source))?], last_ns)?;
                &[Role::Source, Role::Terrain]
            }
        };
        for role in leave {
            stamps.read(&Part::stamps(folder.path(), *role))?;
        }
        Ok(stamps)
    }

    /// Starts a process for each role, and waits until they have ended.
    fn run_each(&self, words: &[OsString], part: impl Fn(Role) -> Part, last_ns: u64) -> Outcome<&'static [Role]> {
        let processes = ROLES.map(|role| self.start(words, &part(role)));
        let processes = processes.into_iter().collect::<Outcome<Vec<_>>>()?;
        self.wait(processes, last_ns)?;
        Ok(&[Role::Source, Role::Terrain])
    }

    fn start(&self, words: &[OsString], part: &Part) -> Outcome<Process> {
        let fifo: Vec<OsString> = self.fifo.map_or_else(Vec::new, |priority| {
            ["chrt", "--fifo", &priority.to_string()].map(OsString::from).into()
        });
        let mut words = fifo.iter().chain(words);
        let mut command = Command::new(words.next().ok_or("no program")?);
        command
            .args(words)
            .args(["--role", part.role.name(), "--pace", part.pace.name()])
            .arg("--folder")
            .arg(&part.folder)
            .args([
                "--cycles",
                &part.cycles.to_string(),
                "--warm-up",
                &part.warm_up.to_string(),
            ])
            .stdin(Stdio::null());
        if let Some(cpu) = part.cpu {
            command.args(["--cpu", &cpu.to_string()]);
        }
        shell::bind_to_parent(&mut command);
        let child = command
            .spawn()
            .map_err(|error| format!("{}: {error}", command.get_program().display()))?;
        Ok(Process(part.role, child))
    }

    /// Waits until all have ended well.
    fn wait(&self, mut processes: Vec<Process>, last_ns: u64) -> Outcome<()> {
        while !processes.is_empty() {
            if self.termination.requested() {
                return Err("told to end".into());
            }
            if now_ns() > last_ns {
                return Err("a process does not come to its end".into());
            }
            let mut failed = Ok(());
            processes.retain_mut(|Process(role, child)| match child.try_wait() {
                Ok(None) => true,
                Ok(Some(status)) if status.success() => false,
                other => {
                    failed = Err(format!("the process {} failed: {other:?}", role.name()));
                    false
                }
            });
            failed?;
            sleep_until(now_ns() + LOOK_NS);
        }
        Ok(())
    }

    /// dora starts its nodes itself.
    fn dora_words(&self) -> Outcome<Vec<OsString>> {
        let python = self
            .dora
            .as_ref()
            .ok_or("build bench/peers/over_dora, or give --dora")?;
        let peers = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/over_dora");
        let module = python
            .ancestors()
            .nth(3)
            .unwrap_or(python)
            .join("release/libover_dora.so");
        let roles = [Role::Source, Role::Sinkage, Role::Terramechanics, Role::Terrain];
        let cpus = roles.map(|role| cpu(role, self.cpus).map_or_else(String::new, |cpu| cpu.to_string()));
        let words: [OsString; 6] = [
            python.into(),
            peers.join("run.py").into(),
            "--module".into(),
            module.into(),
            "--cpus".into(),
            cpus.join(",").into(),
        ];
        Ok(words.into())
    }

    /// Where and how a service runs, in the system file's words.
    fn place(&self, role: Role) -> String {
        let cpu = cpu(role, self.cpus).map(|cpu| format!("cpus = [{cpu}]\n"));
        let fifo = self.fifo.map(|priority| format!("sched = {{ fifo = {priority} }}\n"));
        cpu.unwrap_or_default() + &fifo.unwrap_or_default()
    }
}

/// This program, as a process of a variant.
fn own(variant: &str) -> Outcome<Vec<OsString>> {
    Ok(vec![std::env::current_exe()?.into(), "child".into(), variant.into()])
}

/// The processor of a process.
fn cpu(role: Role, cpus: Option<Cpus>) -> Option<usize> {
    let allowed = allowed_cpus();
    let last = allowed.len().checked_sub(1)?;
    let index = match (cpus?, role) {
        (Cpus::Together, _) => last,
        (Cpus::Spread, role) => (role as usize) % allowed.len(),
    };
    allowed.get(index).copied()
}

/// The processors that this process may use.
pub fn allowed_cpus() -> Vec<usize> {
    let Ok(set) = sched_getaffinity(None) else {
        return Vec::new();
    };
    (0..rustix::thread::CpuSet::MAX_CPU)
        .filter(|cpu| set.is_set(*cpu))
        .collect()
}

/// Whether processes may be started with this real-time priority.
pub fn fifo_is_allowed(priority: u8) -> bool {
    let mut command = Command::new("chrt");
    command
        .args(["--fifo", &priority.to_string(), "true"])
        .stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

/// A process of a run. It ends with this value.
struct Process(Role, Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.1.kill();
        let _ = self.1.wait();
    }
}

/// Other work on every processor. It ends with this value.
pub struct Load(Vec<Child>);

impl Load {
    /// Starts it.
    pub fn start() -> Outcome<Self> {
        let mut load = Self(Vec::new());
        for _ in allowed_cpus() {
            let mut command = Command::new(std::env::current_exe()?);
            command.arg("spin").stdin(Stdio::null());
            shell::bind_to_parent(&mut command);
            load.0.push(command.spawn()?);
        }
        Ok(load)
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Whether a peer has been built where its instructions say.
pub fn built(path: &Path) -> Option<PathBuf> {
    path.is_file().then(|| path.into())
}
