//! One child process: start it, signal it, see it end. Nothing here waits.

use crate::policy::Ending;
use rustix::process::{Pid, Signal};
use shell::Error;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A running service. It leads a process group of its own, which ends with it.
#[derive(Debug)]
pub struct Process {
    child: Child,
}

impl Process {
    /// Starts `<program> <arguments…> <system file> <service>`, bound to die with the launcher.
    ///
    /// # Errors
    /// The program cannot be started.
    pub fn start(program: &Path, arguments: &[String], system: &str, service: &str) -> Result<Self, Error> {
        let mut command = Command::new(program);
        command
            .args(arguments)
            .arg(system)
            .arg(service)
            .stdin(Stdio::null())
            .stdout(Stdio::null());
        shell::bind_to_parent(&mut command);
        shell::harden_descriptors();
        let child = command
            .spawn()
            .map_err(|error| Error::unavailable(format!("cannot start {}: {error}", program.display())))?;
        Ok(Self { child })
    }

    /// The process number.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Whether the process of this number belongs to this service: a program may run behind a wrapper.
    #[must_use]
    pub fn owns(&self, pid: u32) -> bool {
        pid == self.pid() || (raw(pid).and_then(|pid| rustix::process::getpgid(Some(pid)).ok()) == raw(self.pid()))
    }

    /// Asks the service to end.
    pub fn terminate(&self) {
        self.signal(Signal::TERM);
    }

    /// Ends the service and whatever it has started.
    pub fn kill(&self) {
        self.signal(Signal::KILL);
    }

    /// How the service has ended, `None` while it runs.
    ///
    /// # Errors
    /// The system has lost the child.
    pub fn ended(&mut self) -> Result<Option<Ending>, Error> {
        let status = self
            .child
            .try_wait()
            .map_err(|error| Error::internal(format!("cannot wait for a child: {error}")))?;
        let Some(status) = status else { return Ok(None) };
        // What the service has started itself must not outlive it.
        self.signal(Signal::KILL);
        Ok(Some(match status.signal() {
            Some(signal) => Ending::Signal(signal),
            None => Ending::Code(status.code().unwrap_or(-1)),
        }))
    }

    fn signal(&self, signal: Signal) {
        // The group may be gone by now, which is what was wanted.
        if let Some(group) = raw(self.pid()) {
            let _ = rustix::process::kill_process_group(group, signal);
        }
    }
}

fn raw(pid: u32) -> Option<Pid> {
    i32::try_from(pid).ok().and_then(Pid::from_raw)
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
        let _ = self.child.wait();
    }
}
