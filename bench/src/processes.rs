//! A system of real processes, which ends with the value that stands for it.

use crate::{Outcome, programs};
use messages::{SERVICES_MAX, ServiceState, Supervision, label_text};
use rustix::process::{Pid, Signal, kill_process};
use shell::{Domain, SUPERVISION_WIRE, SystemFile, Tap, Termination, now_ns, sleep_until};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// How long the processes may take to start [ns].
const START_MAX_NS: u64 = 60_000_000_000;
/// Between two looks at whether they have [ns].
const LOOK_NS: u64 = 50_000_000;

/// A launcher and its services.
#[derive(Debug)]
pub struct Processes {
    launcher: Child,
    folder: tempfile::TempDir,
    system: SystemFile,
    /// Service and process number, in the services' order.
    services: Vec<(String, u32)>,
}

impl Processes {
    /// Starts the system of a file, and waits until all its services run.
    ///
    /// # Errors
    /// It does not start, with what it said; or the bench was told to end.
    pub fn start(text: &str, termination: &Termination) -> Outcome<Self> {
        let mut processes = Self::launch(text)?;
        processes.wait_until(now_ns() + START_MAX_NS, termination, Self::all_run)?;
        Ok(processes)
    }

    /// Starts the system of a file.
    ///
    /// # Errors
    /// The launcher is not there, or the file is wrong.
    pub fn launch(text: &str) -> Outcome<Self> {
        let folder = tempfile::tempdir()?;
        let (file, log) = (folder.path().join("system.toml"), folder.path().join("log"));
        std::fs::write(&file, text)?;
        let mut command = Command::new(programs()?.join("terrasense"));
        command
            .arg("up")
            .arg(&file)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(log)?);
        shell::bind_to_parent(&mut command);
        Ok(Self {
            system: SystemFile::parse("the bench's system", text)?,
            launcher: command.spawn()?,
            folder,
            services: Vec::new(),
        })
    }

    /// Waits until something is `so`.
    ///
    /// # Errors
    /// The launcher ends before, with what it said; it is not so by `last_ns`; or the bench was told to end.
    pub fn wait_until(
        &mut self,
        last_ns: u64,
        termination: &Termination,
        mut so: impl FnMut(&mut Self) -> bool,
    ) -> Outcome<()> {
        while !so(self) {
            let ended = self.launcher.try_wait()?.is_some();
            if ended || now_ns() > last_ns || termination.requested() {
                return Err(format!("the system ends too early, or too late:\n{}", self.log()).into());
            }
            sleep_until(now_ns() + LOOK_NS);
        }
        Ok(())
    }

    /// A place in the system.
    ///
    /// # Errors
    /// There is none.
    pub fn enter(&self) -> Outcome<Domain> {
        Ok(Domain::enter(&self.system, "bench")?)
    }

    /// The services, each with its process number.
    #[must_use]
    pub fn services(&self) -> &[(String, u32)] {
        &self.services
    }

    /// The launcher's process number.
    #[must_use]
    pub fn launcher(&self) -> u32 {
        self.launcher.id()
    }

    /// Ends the system as a person would.
    ///
    /// # Errors
    /// It does not end well, with what it said.
    pub fn end(mut self) -> Outcome<()> {
        self.terminate();
        let status = self.launcher.wait()?;
        if status.success() {
            Ok(())
        } else {
            Err(format!("{status}:\n{}", self.log()).into())
        }
    }

    /// Whether the launcher says that all services run; then it is known which they are.
    fn all_run(&mut self) -> bool {
        // Before the launcher has made its folder there is nothing to enter.
        if !Path::new(&self.system.root()).join("started_ns").exists() {
            return false;
        }
        let Ok(domain) = self.enter() else { return false };
        let Ok(tap) = Tap::<Supervision>::open(&domain, SUPERVISION_WIRE) else {
            return false;
        };
        let last_ns = now_ns() + 20 * LOOK_NS;
        while now_ns() < last_ns {
            if let Ok(Some(services)) = tap.poll(running) {
                self.services = services;
                return self.services.len() == self.system.services.len();
            }
            sleep_until(now_ns() + LOOK_NS);
        }
        false
    }

    fn terminate(&self) {
        let _ = kill_process(Pid::from_child(&self.launcher), Signal::TERM);
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }
}

impl Drop for Processes {
    fn drop(&mut self) {
        if let Ok(None) = self.launcher.try_wait() {
            self.terminate();
            let _ = self.launcher.wait();
        }
        let name = self.system.system.name.get_ref();
        drop(programs().map(|folder| {
            let mut clean = Command::new(folder.join("terrasense"));
            clean.args(["clean", "--name", name]).output()
        }));
    }
}

/// The services that run.
fn running(table: &Supervision) -> Vec<(String, u32)> {
    let rows = 0..(table.service_count as usize).min(SERVICES_MAX);
    let running = rows.filter(|row| ServiceState(table.state[*row]) == ServiceState::RUNNING);
    running
        .map(|row| (label_text(&table.name[row]).to_owned(), table.pid[row]))
        .collect()
}

/// The time for which a process has been on a processor so far [ns], all its threads together.
///
/// # Errors
/// It has ended, or the kernel does not tell.
pub fn cpu_ns(pid: u32) -> Outcome<u64> {
    let mut sum_ns = 0;
    for thread in std::fs::read_dir(format!("/proc/{pid}/task"))? {
        let text = std::fs::read_to_string(thread?.path().join("schedstat"))?;
        let time_ns = text.split(' ').next().unwrap_or_default();
        sum_ns += time_ns
            .parse::<u64>()
            .map_err(|error| format!("/proc/{pid}/task/*/schedstat: {error}"))?;
    }
    Ok(sum_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The time on the processor [ns] of a program after a tenth of a second.
    fn spent_ns(words: &[&str]) -> u64 {
        let mut child = Command::new(words[0]).args(&words[1..]).spawn().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(100));
        let spent_ns = cpu_ns(child.id()).unwrap();
        child.kill().unwrap();
        child.wait().unwrap();
        spent_ns
    }

    #[test]
    fn time_on_the_processor_is_that_of_work_and_not_of_sleep() {
        let (asleep_ns, awake_ns) = (
            spent_ns(&["sleep", "60"]),
            spent_ns(&["sh", "-c", "while :; do :; done"]),
        );
        assert!(awake_ns > 2 * asleep_ns, "{awake_ns} {asleep_ns}");
    }
}
