//! Starts the services, watches them, starts them again, and stops them. It never waits for what it supervises.

mod succession;
mod wires;

use crate::control::Ear;
use crate::policy::{Decision, Ending, Policy};
use crate::privacy;
use crate::process::Process;
use crate::root::Root;
use crate::system::System;
use crate::watch::Watch;
use messages::{Header, ServiceState, Status, Supervision, label};
use shell::{
    Domain, Error, HeldWire, Mode, Output, Port, RELEASE, Role, SUPERVISION_WIRE, Termination, now_ns, sleep_until,
};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use succession::{Former, Succession};
use wires::Wires;
use zerocopy::FromZeros;

const MS_NS: u64 = 1_000_000;
/// The pause between two looks at everything while something is going on [ns].
const TICK_NS: u64 = 5 * MS_NS;
/// The same while all services run: the end of one ends the pause, and every wire holds more than comes meanwhile [ns].
const CALM_TICK_NS: u64 = 20 * MS_NS;
/// Samples taken from one wire at one look at the most.
const POLLS_MAX: usize = 1024;
/// Time a service has to end after SIGTERM when the system stops [ns].
const STOP_GRACE_NS: u64 = 1000 * MS_NS;
/// The same for a service that hangs [ns]: whoever does not answer for its deadline will not now.
const HANG_GRACE_NS: u64 = 50 * MS_NS;
/// Between two samples of the supervision wire [ns].
const REPORT_NS: u64 = 200 * MS_NS;
/// The system file that services read, in the system's folder.
const SYSTEM_FILE: &str = "system.toml";
/// Lines of the log that are kept until they are fetched.
const LOG_MAX: usize = 1000;

/// A running system.
pub struct Supervisor {
    system: System,
    system_path: String,
    ear: Ear,
    succession: Option<Succession>,
    /// The predecessors of the services on probation, by their names.
    former: BTreeMap<String, Former>,
    /// Processes that are to end, and when they are made to.
    leaving: Vec<(Process, u64)>,
    services: BTreeMap<String, Service>,
    wires: Wires,
    report: Output<Supervision>,
    reported_ns: u64,
    log: Vec<String>,
    /// Whether a child has ended since the last look began.
    child_ended: Arc<AtomicBool>,
    domain: Domain,
    _supervision: HeldWire,
    termination: Termination,
    // Dropped last: it takes the folder with it.
    root: Root,
}

/// A service as the launcher sees it.
#[derive(Debug)]
pub struct Service {
    /// What it is doing.
    pub state: ServiceState,
    /// Restarts so far.
    pub restarts: u32,
    /// How it ended last.
    pub ending: Option<Ending>,
    process: Option<Process>,
    policy: Policy,
    generation: u32,
    started_ns: u64,
    ready_ns: u64,
    restart_at_ns: u64,
    /// SIGTERM has been sent; SIGKILL follows at this instant.
    kill_at_ns: Option<u64>,
}

impl Service {
    /// The process number; 0 where none runs.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.process.as_ref().map_or(0, Process::pid)
    }
}

/// A sample that the launcher saw: on which wire, what it carries, its header and its bytes.
pub type Seen<'a> = (&'a str, Port, &'a Header, &'a [u8]);

impl Supervisor {
    /// Makes the wires of a system.
    ///
    /// # Errors
    /// A system of this name runs already, or shared memory cannot be had.
    pub fn new(system: System, termination: Termination) -> Result<Self, Error> {
        let root = Root::take(&system.file)?;
        // A copy: what a person edits in the file counts from `terrasense apply` on, not from a service's next restart.
        let system_path = root.write(SYSTEM_FILE, &system.file.text)?;
        let child_ended = shell::wake_when_children_end().map_err(|error| Error::internal(error.to_string()))?;
        let domain = Domain::enter(&system.file, "launcher")?;
        let wires = Wires::make(&system, &domain)?;
        let supervision = domain.create_supervision()?;
        privacy::close(&system.file)?;
        let report = domain.output(SUPERVISION_WIRE, &termination)?;
        let services = system.file.services.iter().map(|(name, table)| {
            let service = Service {
                state: ServiceState::STOPPED,
                restarts: 0,
                ending: None,
                process: None,
                policy: Policy::new(table),
                generation: 0,
                started_ns: 0,
                ready_ns: 0,
                restart_at_ns: 0,
                kill_at_ns: None,
            };
            (name.clone(), service)
        });
        let services = services.collect();
        Ok(Self {
            services,
            system,
            system_path,
            ear: Ear::open(&root.folder)?,
            succession: None,
            former: BTreeMap::new(),
            leaving: Vec::new(),
            wires,
            report,
            reported_ns: 0,
            log: Vec::new(),
            child_ended,
            domain,
            _supervision: supervision,
            termination,
            root,
        })
    }

    /// Starts all services, writers before readers, each once the one before is ready. A replay's first samples wait until
    /// all are, and the launcher itself is connected.
    ///
    /// # Errors
    /// Shared memory is broken. A service that does not start is the policy's business.
    pub fn start(&mut self, mut on_sample: impl FnMut(Seen<'_>)) -> Result<(), Error> {
        for name in self.system.order.clone() {
            self.launch(&name)?;
            while self.services[&name].state == ServiceState::STARTING && !self.termination.requested() {
                self.look(&mut on_sample)?;
                sleep_until(now_ns() + MS_NS);
            }
        }
        self.drain(&mut on_sample)?;
        self.root.write(RELEASE, "").map(|_| ())
    }

    /// Looks once at every process and every wire, acts, and sleeps until the next look or the next signal. Every sample
    /// that was seen goes to `on_sample`.
    ///
    /// # Errors
    /// Shared memory is broken.
    pub fn tick(&mut self, mut on_sample: impl FnMut(Seen<'_>)) -> Result<(), Error> {
        let seen = self.look(&mut on_sample)?;
        let hurried = self.system.file.system.mode == Mode::Replay;
        // A replay goes as fast as it is recorded.
        if seen == 0 || !hurried {
            let pause_ns = match (hurried, self.is_calm()) {
                (true, _) => MS_NS / 2,
                (false, true) => CALM_TICK_NS,
                (false, false) => TICK_NS,
            };
            // Who ends between its look and the sleep is not slept over.
            if !self.child_ended.load(Ordering::Relaxed) {
                sleep_until(now_ns() + pause_ns);
            }
        }
        Ok(())
    }

    /// Whether every service runs and none is to be replaced or ended.
    fn is_calm(&self) -> bool {
        let runs = |service: &Service| service.state == ServiceState::RUNNING && service.kill_at_ns.is_none();
        self.succession.is_none() && self.leaving.is_empty() && self.services.values().all(runs)
    }

    /// Stops all services in reverse order, and takes in what they still send.
    ///
    /// # Errors
    /// Shared memory is broken.
    pub fn stop(&mut self, mut on_sample: impl FnMut(Seen<'_>)) -> Result<(), Error> {
        self.succession = None;
        self.leaving.clear();
        for name in self.system.order.clone().iter().rev() {
            let deadline_ns = now_ns() + STOP_GRACE_NS;
            self.services[name].process.iter().for_each(Process::terminate);
            while let Some(process) = self.service(name).process.as_mut() {
                if process.ended()?.is_some() {
                    self.service(name).process = None;
                } else if now_ns() > deadline_ns {
                    process.kill();
                }
                self.drain(&mut on_sample)?;
                sleep_until(now_ns() + MS_NS / 2);
            }
            self.service(name).state = ServiceState::STOPPED;
        }
        let _ = self.domain.clean();
        Ok(())
    }

    /// The system's file and graph.
    #[must_use]
    pub fn system(&self) -> &System {
        &self.system
    }

    /// `CLOCK_MONOTONIC` [ns] at the start of the system: where a simulated rover's time begins.
    #[must_use]
    pub fn started_ns(&self) -> u64 {
        self.root.started_ns
    }

    /// The services, by name.
    #[must_use]
    pub fn services(&self) -> &BTreeMap<String, Service> {
        &self.services
    }

    /// The counters of a wire.
    #[must_use]
    pub fn watch(&self, wire: &str) -> Option<&Watch> {
        self.wires.get(wire).map(|wire| &wire.watch)
    }

    /// What has happened since the last call, a line each.
    pub fn take_log(&mut self) -> Vec<String> {
        std::mem::take(&mut self.log)
    }

    /// A table row a service, as `terrasense status` shows them.
    #[must_use]
    pub fn report(&self) -> Box<Supervision> {
        let mut table = Supervision::new_box_zeroed().unwrap_or_else(|_| unreachable!("a few kilobytes"));
        let now_ns = now_ns();
        table.header = Header {
            taken_ns: now_ns,
            status: Status::OK,
            ..Header::default()
        };
        table.launcher_pid = std::process::id();
        table.service_count = u32::try_from(self.services.len()).unwrap_or(0);
        for (row, (name, service)) in self.services.iter().enumerate() {
            table.name[row] = label(name);
            table.pid[row] = service.pid();
            table.state[row] = service.state.0;
            table.generation[row] = service.generation;
            table.restarts[row] = service.restarts;
            for watch in self.wires.written_by(name) {
                table.published[row] += watch.published;
                table.lost[row] += watch.lost;
                table.bad[row] += watch.bad;
                table.missed[row] += watch.missed;
                table.rate_hz[row] += watch.rate_hz(now_ns);
                let latencies = watch.latencies();
                table.latency_p50_ns[row] = table.latency_p50_ns[row].max(latencies.value_at_quantile(0.5));
                table.latency_p99_ns[row] = table.latency_p99_ns[row].max(latencies.value_at_quantile(0.99));
            }
        }
        table
    }

    fn service(&mut self, name: &str) -> &mut Service {
        self.services
            .get_mut(name)
            .unwrap_or_else(|| unreachable!("the names are the system's"))
    }

    fn say(&mut self, text: String) {
        note(&mut self.log, text);
    }

    fn look(&mut self, on_sample: &mut impl FnMut(Seen<'_>)) -> Result<usize, Error> {
        self.child_ended.store(false, Ordering::Relaxed);
        let mut succession = self.succession.take();
        let seen = self.drain(&mut |seen| {
            succession.iter_mut().for_each(|succession| succession.see(&seen));
            on_sample(seen);
        })?;
        self.succession = succession;
        for name in self.system.order.clone() {
            self.look_at(&name)?;
        }
        self.look_at_succession()?;
        self.look_at_leaving()?;
        if now_ns() - self.reported_ns >= REPORT_NS {
            self.reported_ns = now_ns();
            let report = self.report();
            self.report.send_with(|table| {
                table.clone_from(&report);
                Ok(())
            })?;
        }
        Ok(seen)
    }

    /// Takes in what is on the wires.
    fn drain(&mut self, on_sample: &mut impl FnMut(Seen<'_>)) -> Result<usize, Error> {
        let Self { wires, log, .. } = self;
        wires.drain(&mut |text| note(log, text), on_sample)
    }

    fn look_at(&mut self, name: &str) -> Result<(), Error> {
        let now = now_ns();
        let service = self.service(name);
        if let Some(process) = service.process.as_mut() {
            if let Some(ending) = process.ended()? {
                let was_ended = service.kill_at_ns.is_some();
                return self.on_end(name, if was_ended { Ending::Hung } else { ending });
            }
            if let Some(kill_at_ns) = service.kill_at_ns {
                if now >= kill_at_ns {
                    process.kill();
                }
                return Ok(());
            }
        }
        match service.state {
            ServiceState::BACKOFF | ServiceState::GIVEN_UP if now >= service.restart_at_ns => self.launch(name),
            ServiceState::STARTING => {
                self.look_at_start(name);
                Ok(())
            }
            ServiceState::RUNNING => {
                self.look_for_silence(name);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn launch(&mut self, name: &str) -> Result<(), Error> {
        let table = &self.system.file.services[name];
        let arguments = table.exec.get_ref()[1..].to_vec();
        let program = self.system.programs[name].clone();
        let generation = self.services[name].generation + 1;
        // Where shared memory is full it is tried again, as the policy has it, and the others go on.
        let noted = self.root.write(&format!("{name}.generation"), &generation.to_string());
        let process = noted.and_then(|_| Process::start(&program, &arguments, &self.system_path, name));
        let service = self.service(name);
        service.generation = generation;
        service.started_ns = now_ns();
        service.kill_at_ns = None;
        match process {
            Ok(process) => {
                service.process = Some(process);
                service.state = ServiceState::STARTING;
            }
            Err(error) => {
                self.say(format!("{name}: {error}"));
                self.on_end(name, Ending::Code(i32::from(error.code())))?;
            }
        }
        Ok(())
    }

    /// A service is ready once it has all its wires open, whatever language it is written in.
    fn look_at_start(&mut self, name: &str) {
        let service = &self.services[name];
        let table = &self.system.file.services[name];
        let has = |wire: &str, role: Role| {
            let peers = self.wires.of(wire).held.peers();
            let owns = |pid: u32| service.process.as_ref().is_some_and(|process| process.owns(pid));
            peers.iter().any(|(other, pid)| *other == role && owns(*pid))
        };
        let reads = table.inputs.values().all(|wire| has(wire.get_ref(), Role::Reader));
        let writes = table.outputs.values().all(|wire| has(wire.get_ref(), Role::Writer));
        let timeout_ms = *table.start_timeout_ms.get_ref();
        let waited_ns = now_ns() - service.started_ns;
        if reads && writes {
            let service = self.service(name);
            service.state = ServiceState::RUNNING;
            service.ready_ns = now_ns();
            let (pid, generation) = (service.pid(), service.generation);
            self.say(format!(
                "{name}: ready after {} ms (pid {pid}, start {generation})",
                waited_ns / MS_NS
            ));
        } else if waited_ns > timeout_ms * MS_NS {
            self.end_hung(name, &format!("has not opened its wires within {timeout_ms} ms"));
        }
    }

    /// A service hangs if an answer has been due for longer than its deadline; a source's next sample always is.
    fn look_for_silence(&mut self, name: &str) {
        let table = &self.system.file.services[name];
        let Some(deadline_ms) = table.deadline_ms.as_ref().map(|deadline| *deadline.get_ref()) else {
            return;
        };
        let ready_ns = self.services[name].ready_ns;
        let silent = table.outputs.values().find_map(|wire| {
            let wire = wire.get_ref();
            let watch = &self.wires.of(wire).watch;
            let last_ns = watch.last_ns.max(ready_ns);
            let due_ns = match self.wires.trigger_of(wire) {
                Some(trigger) => trigger.first_after(last_ns)?,
                None => last_ns,
            };
            let hangs = !watch.ended && now_ns().saturating_sub(due_ns) > deadline_ms * MS_NS;
            hangs.then(|| wire.clone())
        });
        if let Some(wire) = silent {
            self.end_hung(
                name,
                &format!("has been silent on {wire} for more than {deadline_ms} ms"),
            );
        }
    }

    fn end_hung(&mut self, name: &str, what: &str) {
        self.say(format!("{name}: {what}; ending it"));
        let service = self.service(name);
        service.process.iter().for_each(Process::terminate);
        service.kill_at_ns = Some(now_ns() + HANG_GRACE_NS);
    }

    fn on_end(&mut self, name: &str, ending: Ending) -> Result<(), Error> {
        // The others must find no port of the dead when the service is back.
        self.root.sweep();
        let _ = self.domain.clean();
        let service = self.service(name);
        service.process = None;
        service.kill_at_ns = None;
        service.ending = Some(ending);
        let how = ending.to_string();
        if self.roll_back(name)? {
            self.service(name).restarts += 1;
            self.say(format!("{name}: {how} on probation; rolled back to the one before"));
            return self.launch(name);
        }
        let now = now_ns();
        let service = self.service(name);
        match service.policy.on_end(ending, service.started_ns, now) {
            Decision::RestartAt(at_ns) => {
                service.state = ServiceState::BACKOFF;
                service.restart_at_ns = at_ns;
                service.restarts += 1;
                let pause_ms = (at_ns - now) / MS_NS;
                let count = service.restarts;
                self.say(format!("{name}: {how}; restart {count} in {pause_ms} ms"));
                if pause_ms == 0 {
                    self.launch(name)?;
                }
            }
            Decision::HoldUntil(at_ns, why) => {
                service.state = ServiceState::GIVEN_UP;
                service.restart_at_ns = at_ns;
                let pause_s = (at_ns - now) / (1000 * MS_NS);
                self.say(format!(
                    "{name}: {how}; given up: {why}; the other services go on; next try in {pause_s} s"
                ));
            }
            Decision::GiveUp(why) => {
                service.state = ServiceState::GIVEN_UP;
                service.restart_at_ns = u64::MAX;
                self.say(format!("{name}: {how}; given up: {why}; the other services go on"));
            }
            Decision::Rest => {
                service.state = ServiceState::STOPPED;
                self.say(format!("{name}: {how}, as it should"));
            }
        }
        Ok(())
    }
}

/// Keeps a line of the log, if there is room for it.
fn note(log: &mut Vec<String>, text: String) {
    if log.len() < LOG_MAX {
        log.push(text);
    }
}
