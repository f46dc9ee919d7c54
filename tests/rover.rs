//! A system under test: its own name, so its own root and prefix; gone without a trace when the test is over.

use serde_json::Value;
use shell::{Domain, Port, SystemFile};
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Longer than anything takes on a slow machine: a test that waits this long has failed.
const PATIENCE: Duration = Duration::from_secs(60);
/// The same for a command that is run to its end, a replay for one.
const COMMAND_PATIENCE: Duration = Duration::from_secs(600);

static SYSTEMS: AtomicU32 = AtomicU32::new(0);

/// One live system at a time: six processes that must keep their deadlines fill a small machine.
static LIVE: Mutex<()> = Mutex::new(());

/// The launcher of a system of its own.
pub struct Rover {
    _alone: MutexGuard<'static, ()>,
    pub name: String,
    pub folder: TempDir,
    pub launcher: Option<Child>,
}

/// The right to be the one live system.
pub fn alone() -> MutexGuard<'static, ()> {
    LIVE.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Rover {
    /// The built-in system under a name of its own, its file edited by `edit`. Its deadlines are those of a machine that is
    /// busy with other things.
    pub fn new(edit: impl Fn(String) -> String) -> Self {
        let alone = alone();
        let name = format!("t{}_{}", std::process::id(), SYSTEMS.fetch_add(1, Ordering::Relaxed));
        let folder = tempfile::tempdir().unwrap();
        let text = String::from_utf8(terrasense(&["default-system"]).stdout).unwrap();
        let text = text.replace("name = \"rover\"", &format!("name = \"{name}\""));
        let text = text.replace("deadline_ms = 1000", "deadline_ms = 10000");
        std::fs::write(folder.path().join("rover.toml"), edit(text)).unwrap();
        Self {
            _alone: alone,
            name,
            folder,
            launcher: None,
        }
    }

    /// The system's file.
    pub fn file(&self) -> String {
        self.folder.path().join("rover.toml").display().to_string()
    }

    /// Starts the system and waits until all its services run.
    pub fn up(&mut self) {
        self.start();
        self.until("all services run", |rows| {
            rows.iter().all(|row| row["state"] == "running")
        });
    }

    /// Starts the launcher.
    pub fn start(&mut self) {
        self.start_telling(&self.folder.path().join("log"));
    }

    /// The same, with another file as its log.
    pub fn start_telling(&mut self, log: &Path) {
        let log = File::create(log).unwrap();
        let child = Command::new(program("terrasense"))
            .args(["up", &self.file()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn();
        self.launcher = Some(child.unwrap());
    }

    /// What the launcher and its services have said.
    pub fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }

    /// Waits until it has been said: a line may come a moment after what it is about.
    pub fn until_said(&self, text: &str) {
        let start = Instant::now();
        while !self.log().contains(text) {
            assert!(start.elapsed() < PATIENCE, "not said: {text}\n{}", self.log());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// The rows of `terrasense status`; none while the system does not answer.
    pub fn rows(&self) -> Vec<Value> {
        let output = terrasense(&["status", "--json", "--name", &self.name]);
        serde_json::from_slice(&output.stdout).unwrap_or_default()
    }

    /// Waits until the status fulfils a condition, and returns it.
    pub fn until(&mut self, what: &str, fulfils: impl Fn(&[Value]) -> bool) -> Vec<Value> {
        let start = Instant::now();
        loop {
            let rows = self.rows();
            if !rows.is_empty() && fulfils(&rows) {
                return rows;
            }
            let ended = self.launcher.as_mut().and_then(|launcher| launcher.try_wait().unwrap());
            assert!(
                ended.is_none(),
                "the launcher ended while waiting until {what}:\n{}",
                self.log()
            );
            assert!(start.elapsed() < PATIENCE, "not yet: {what}\n{rows:#?}\n{}", self.log());
        }
    }

    /// Lets `act` happen, and makes sure that no cycle is missing on the terrain wire meanwhile, and none comes twice.
    pub fn without_losing_a_cycle<R: Send>(&self, act: impl FnOnce() -> R + Send) -> R {
        let text = format!("[system]\nname = \"{}\"\n", self.name);
        let domain = Domain::enter(&SystemFile::parse("test", &text).unwrap(), "test").unwrap();
        let frames = domain.tap("front/frames", Port::Frames).unwrap();
        let terrain = domain.tap("front/terrain", Port::Terrain).unwrap();
        let (mut taken, mut answered) = (Vec::new(), Vec::new());
        let mut look = || {
            while terrain.poll(&mut |header, _| answered.push(header.sequence)).unwrap() {}
            while frames.poll(&mut |header, _| taken.push(header.sequence)).unwrap() {}
            std::thread::sleep(Duration::from_millis(5));
        };
        let outcome = std::thread::scope(|scope| {
            let acting = scope.spawn(act);
            while !acting.is_finished() {
                look();
            }
            acting.join().unwrap()
        });
        let end = Instant::now() + Duration::from_secs(2);
        while Instant::now() < end {
            look();
        }
        let [first, last] = [answered[0], answered[answered.len() - 1]];
        taken.retain(|sequence| (first..=last).contains(sequence));
        answered.retain(|sequence| *sequence >= taken[0]);
        assert_eq!(answered, taken, "{}", self.log());
        outcome
    }

    /// The row of one service.
    pub fn row(&self, service: &str) -> Value {
        let rows = self.rows();
        rows.into_iter()
            .find(|row| row["service"] == service)
            .unwrap_or_else(|| panic!("no {service}: {}", self.log()))
    }

    /// The process numbers of all services.
    pub fn pids(&self) -> Vec<u32> {
        self.rows().iter().map(pid).collect()
    }

    /// Tells the launcher to end, as a person would with ^C, and returns its exit code.
    pub fn down(&mut self) -> Option<i32> {
        let mut launcher = self.launcher.take()?;
        // It may have ended by itself.
        let launcher_pid = rustix::process::Pid::from_child(&launcher);
        let _ = rustix::process::kill_process(launcher_pid, rustix::process::Signal::TERM);
        end_of(&mut launcher).code()
    }

    /// What the system has in shared memory.
    pub fn traces(&self) -> Vec<String> {
        traces(&self.name)
    }
}

impl Drop for Rover {
    fn drop(&mut self) {
        self.down();
        terrasense(&["clean", "--name", &self.name]);
    }
}

/// What the system of a name has in shared memory.
pub fn traces(name: &str) -> Vec<String> {
    let begin = format!("terrasense-{name}");
    let entries = std::fs::read_dir("/dev/shm").unwrap().filter_map(Result::ok);
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let belongs = |name: &String| {
        name.strip_prefix(&begin)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with(['-', '.']))
    };
    names.filter(belongs).collect()
}

/// The process number in a row of the status.
pub fn pid(row: &Value) -> u32 {
    u32::try_from(row["pid"].as_u64().unwrap()).unwrap()
}

/// Sends a signal to a process.
pub fn signal(pid: u32, signal: rustix::process::Signal) {
    let pid = rustix::process::Pid::from_raw(i32::try_from(pid).unwrap()).unwrap();
    rustix::process::kill_process(pid, signal).unwrap();
}

/// Whether a process of this number is there, and no zombie.
pub fn lives(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit_once(") ").is_some_and(|(_, rest)| !rest.starts_with('Z'))
}

/// Waits until a condition holds.
pub fn wait_until(what: &str, holds: impl Fn() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < PATIENCE, "not yet: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// A program of this workspace: cargo builds them next to the tests.
pub fn program(name: &str) -> PathBuf {
    let here = std::env::current_exe().unwrap();
    let path = here.ancestors().nth(2).unwrap().join(name);
    assert!(
        path.is_file(),
        "{} is missing; run all tests: cargo test --workspace",
        path.display()
    );
    path
}

/// Waits until a process has ended, and not for ever: a test that hangs says nothing.
pub fn end_of(process: &mut Child) -> ExitStatus {
    let start = Instant::now();
    loop {
        if let Some(status) = process.try_wait().unwrap() {
            return status;
        }
        if start.elapsed() > COMMAND_PATIENCE {
            let _ = process.kill();
            panic!("process {} does not end", process.id());
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Runs `terrasense` to its end.
pub fn terrasense(arguments: &[&str]) -> Output {
    let [stdout, stderr] = [(); 2].map(|()| tempfile::tempfile().unwrap());
    let mut process = Command::new(program("terrasense"))
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(stdout.try_clone().unwrap())
        .stderr(stderr.try_clone().unwrap())
        .spawn()
        .unwrap();
    let status = end_of(&mut process);
    let [stdout, stderr] = [stdout, stderr].map(written);
    Output { status, stdout, stderr }
}

fn written(mut file: File) -> Vec<u8> {
    let mut bytes = Vec::new();
    file.rewind().unwrap();
    file.read_to_end(&mut bytes).unwrap();
    bytes
}

/// Runs `terrasense` to its end and returns its exit code and what it printed on both.
pub fn told(arguments: &[&str]) -> (i32, String) {
    let output = terrasense(arguments);
    let text = [output.stdout, output.stderr].concat();
    (
        output.status.code().unwrap_or(-1),
        String::from_utf8_lossy(&text).into_owned(),
    )
}

/// All files of a folder with their bytes.
pub fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<(String, Vec<u8>)> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| {
            let path = entry.unwrap().path();
            let mut bytes = Vec::new();
            File::open(&path).unwrap().read_to_end(&mut bytes).unwrap();
            (path.file_name().unwrap().to_string_lossy().into_owned(), bytes)
        })
        .collect();
    files.sort();
    files
}
