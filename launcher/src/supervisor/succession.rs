//! A live swap: the candidate rehearses beside the incumbent on the same inputs, is compared with it, and takes its turn
//! with a certain cycle. Until that cycle the incumbent notices nothing; after it, it answers nothing.

use super::{HANG_GRACE_NS, MS_NS, POLLS_MAX, SYSTEM_FILE, Seen, Supervisor};
use crate::commands;
use crate::control::{Caller, Rehearsed, Reply, SwapRequest};
use crate::process::Process;
use crate::rehearsal::Comparison;
use crate::watch::Watch;
use messages::ServiceState;
use shell::{AnyTap, Error, HeldWire, Mode, Port, REHEARSAL_CHECKPOINT, Role, SystemFile, now_ns};
use std::path::PathBuf;
use toml_edit::{Array, DocumentMut, Item, Table, Value, value};

/// The candidate takes its turn so many cycles ahead at least, and so much time: both must see it coming.
const CYCLES_AHEAD_MIN: u64 = 3;
const AHEAD_S: f64 = 0.1;
/// Time for the first answer after the turn [ns].
const HAND_OVER_MAX_NS: u64 = 2000 * MS_NS;
/// Time for the comparison, beyond what the cycles take at the incumbent's rate [ns].
const PATIENCE_NS: u64 = 10_000 * MS_NS;
/// A wire that is slower is waited for as if this were its rate [Hz].
const RATE_MIN_HZ: f64 = 0.1;
/// The system file that a candidate reads.
const REHEARSAL_FILE: &str = "rehearsal.toml";

/// A swap under way.
pub(super) struct Succession {
    request: SwapRequest,
    caller: Caller,
    port: Port,
    /// The incumbent's wire, and the candidate's until its turn.
    wire: String,
    rehearsal: HeldWire,
    tap: AnyTap,
    watch: Watch,
    process: Process,
    program: PathBuf,
    generation: u32,
    started_ns: u64,
    comparison: Comparison,
    phase: Phase,
}

/// How far a swap has come.
#[derive(Clone, Copy)]
enum Phase {
    Starting,
    Comparing {
        since_ns: u64,
    },
    /// The candidate writes from a certain cycle on, and is to have begun by a certain instant.
    HandingOver {
        sequence: u64,
        until_ns: u64,
    },
}

/// The incumbent that a promoted candidate has replaced, for as long as that one is on probation.
pub(super) struct Former {
    /// Its table of the system file. Other services' tables may have changed since.
    table: Item,
    program: PathBuf,
    until_ns: u64,
}

impl Succession {
    /// Takes in what the launcher saw on the incumbent's wire.
    pub(super) fn see(&mut self, seen: &Seen<'_>) {
        let (wire, _, header, bytes) = seen;
        if *wire == self.wire {
            self.comparison.see_incumbent(header, bytes);
        }
    }
}

impl Supervisor {
    /// Takes up the next request, and brings the one that is under way a step on.
    pub(super) fn look_at_succession(&mut self) -> Result<(), Error> {
        if let Some(succession) = self.succession.take() {
            self.succession = self.go_on(succession)?;
            return Ok(());
        }
        let Some((request, mut caller)) = self.ear.next() else {
            return Ok(());
        };
        let service = request.service.clone();
        match self.begin(request) {
            Ok(begin) => self.succession = Some(begin(caller)),
            Err(error) => {
                self.say(format!("{service}: swap refused: {error}"));
                caller.tell(&Reply::Refused(error.to_string()));
            }
        }
        Ok(())
    }

    /// Starts the candidate beside the incumbent.
    fn begin(&mut self, request: SwapRequest) -> Result<impl FnOnce(Caller) -> Succession + use<>, Error> {
        let name = request.service.clone();
        let (port, wire) = self.swappable(&name)?;
        let program = request
            .exec
            .first()
            .and_then(|program| commands::find(program, None))
            .ok_or_else(|| {
                Error::usage(format!(
                    "cannot find the program {:?}; name it by its path",
                    request.exec.first()
                ))
            })?;
        let generation = self.services[&name].generation + 1;
        // No two have the same: the last candidate may still be on its way out.
        let rehearsal_wire = format!("rehearsal/{}/{wire}", now_ns());
        let rehearsal_text = self.rehearsal_text(&request, port, &wire, &rehearsal_wire)?;
        // A wire has room for so many readers: none for killed ones from outside.
        let _ = self.domain.clean();
        let rehearsal = self.domain.create(&rehearsal_wire, port)?;
        let tap = self.domain.tap(&rehearsal_wire, port)?;
        let file = self.root.write(REHEARSAL_FILE, &rehearsal_text)?;
        self.root
            .write(&format!("{name}.generation"), &generation.to_string())?;
        // The candidate may go on from what the incumbent knows, if it is of the same kind.
        self.root
            .copy(&format!("{name}.checkpoint"), &format!("{name}.{REHEARSAL_CHECKPOINT}"));
        let process = Process::start(&program, &request.exec[1..], &file, &name)?;
        self.say(format!(
            "{name}: {} (pid {}, start {generation}) rehearses beside it",
            program.display(),
            process.pid()
        ));
        let comparison = Comparison::new(port);
        Ok(move |caller| Succession {
            request,
            caller,
            port,
            wire,
            rehearsal,
            tap,
            watch: Watch::default(),
            process,
            program,
            generation,
            started_ns: now_ns(),
            comparison,
            phase: Phase::Starting,
        })
    }

    /// The one wire of a stage that runs.
    fn swappable(&self, name: &str) -> Result<(Port, String), Error> {
        let file = &self.system.file;
        let Some(table) = file.services.get(name) else {
            let known: Vec<&str> = file.services.keys().map(String::as_str).collect();
            return Err(Error::usage(format!(
                "there is no service `{name}`; there are: {}",
                known.join(", ")
            )));
        };
        let wires: Vec<&String> = table.outputs.values().map(toml::Spanned::get_ref).collect();
        let [wire] = wires.as_slice() else {
            return Err(Error::usage(format!(
                "`{name}` is a source; only stages can be swapped while the system runs"
            )));
        };
        let port = self.system.wires[*wire].port;
        if port.trigger().is_none() || file.system.mode != Mode::Live {
            return Err(Error::usage(format!(
                "`{name}` cannot be swapped: it is a source, or this is a replay"
            )));
        }
        if self.services[name].state != ServiceState::RUNNING {
            return Err(Error::unavailable(format!(
                "`{name}` does not run now; try again when it does"
            )));
        }
        Ok((port, (*wire).clone()))
    }

    /// The system file as it is now.
    fn document(&self) -> Result<DocumentMut, Error> {
        let text = &self.system.file.text;
        text.parse()
            .map_err(|error| Error::config(format!("{}: {error}", self.system.file.path)))
    }

    /// The same with the candidate in the incumbent's place.
    fn document_with(&self, request: &SwapRequest) -> Result<DocumentMut, Error> {
        let mut document = self.document()?;
        let table = &mut document["service"][&request.service];
        table["exec"] = value(request.exec.iter().collect::<Array>());
        if let Some(config) = &request.config {
            let config: Result<DocumentMut, _> = config.parse();
            let config = config.map_err(|error| Error::config(format!("`{}`: {error}", request.service)))?;
            table["config"] = value(config.as_table().clone().into_inline_table());
        }
        Ok(document)
    }

    /// The system file that the candidate reads.
    fn rehearsal_text(
        &self,
        request: &SwapRequest,
        port: Port,
        wire: &str,
        rehearsal_wire: &str,
    ) -> Result<String, Error> {
        let mut document = self.document_with(request)?;
        let one = |wire: &str| {
            let mut wires = Table::new().into_inline_table();
            wires.insert(port.name(), Value::from(wire));
            value(wires)
        };
        let table = &mut document["service"][&request.service];
        table["outputs"] = one(rehearsal_wire);
        table["takes_over"] = one(wire);
        let text = document.to_string();
        SystemFile::parse(REHEARSAL_FILE, &text)?;
        Ok(text)
    }

    /// Lets a system file count from now on. Where it cannot be written (the memory is full), the system goes on with the
    /// one before in its folder, until the next that counts.
    fn adopt(&mut self, document: &DocumentMut) -> Result<(), Error> {
        let text = document.to_string();
        self.system.file = SystemFile::parse(&self.system.file.path, &text)?;
        if let Err(error) = self.root.write(SYSTEM_FILE, &text) {
            self.say(format!(
                "{error}; a service that starts before the next swap finds the configuration of before this one"
            ));
        }
        Ok(())
    }

    fn go_on(&mut self, mut succession: Succession) -> Result<Option<Succession>, Error> {
        let asking = self.wires.trigger_of(&succession.wire);
        for _ in 0..POLLS_MAX {
            let (watch, comparison) = (&mut succession.watch, &mut succession.comparison);
            let more = succession.tap.poll(&mut |header, bytes| {
                watch.see(header, asking);
                comparison.see_candidate(header, bytes);
            })?;
            if !more {
                break;
            }
        }
        if let Some(ending) = succession.process.ended()? {
            return self.refuse(succession, &format!("the candidate {ending}"));
        }
        if self.services[&succession.request.service].generation + 1 != succession.generation
            || self.services[&succession.request.service].state != ServiceState::RUNNING
        {
            return self.refuse(succession, "the incumbent has ended meanwhile; try again");
        }
        match succession.phase {
            Phase::Starting => self.await_start(succession),
            Phase::Comparing { since_ns } => self.compare(succession, since_ns),
            Phase::HandingOver { sequence, until_ns } => self.await_turn(succession, sequence, until_ns),
        }
    }

    fn await_start(&mut self, mut succession: Succession) -> Result<Option<Succession>, Error> {
        let table = &self.system.file.services[&succession.request.service];
        let timeout_ms = *table.start_timeout_ms.get_ref();
        let has = |held: &HeldWire, role| {
            let peers = held.peers();
            peers
                .iter()
                .any(|(other, pid)| *other == role && succession.process.owns(*pid))
        };
        let reads = table
            .inputs
            .values()
            .all(|wire| has(&self.wires.of(wire.get_ref()).held, Role::Reader));
        if reads && has(&succession.rehearsal, Role::Writer) {
            succession.phase = Phase::Comparing { since_ns: now_ns() };
            let said = format!("ready after {} ms", (now_ns() - succession.started_ns) / MS_NS);
            succession.caller.tell(&Reply::Progress(said));
        } else if now_ns() - succession.started_ns > timeout_ms * MS_NS {
            return self.refuse(
                succession,
                &format!("it has not opened its wires within {timeout_ms} ms"),
            );
        }
        Ok(Some(succession))
    }

    fn compare(&mut self, mut succession: Succession, since_ns: u64) -> Result<Option<Succession>, Error> {
        let counts = succession.comparison.counts();
        let wanted = succession.request.cycles;
        if counts.cycles < wanted {
            let rate_hz = self.wires.of(&succession.wire).watch.rate_hz(now_ns()).max(RATE_MIN_HZ);
            let longest_ns = PATIENCE_NS + (2e9 * wanted as f64 / rate_hz) as u64;
            if now_ns() - since_ns > longest_ns {
                let said = format!("only {} of {wanted} cycles could be compared", counts.cycles);
                return self.refuse(succession, &said);
            }
            return Ok(Some(succession));
        }
        let rehearsed = self.rehearsed(&succession);
        let problem = self.objection(&succession, &rehearsed);
        let is_heard = succession.caller.tell(&Reply::Rehearsed(rehearsed));
        match problem {
            Some(why) => return self.refuse(succession, &why),
            None if !is_heard => return self.refuse(succession, "whoever asked for it has gone"),
            None if succession.request.dry_run => {
                self.say(format!(
                    "{}: rehearsal over, the incumbent stays",
                    succession.request.service
                ));
                succession.caller.tell(&Reply::Stays);
                self.dismiss(succession.process);
                return Ok(None);
            }
            None => {}
        }
        Ok(Some(self.hand_over(succession)))
    }

    /// Gives the candidate its turn.
    fn hand_over(&self, mut succession: Succession) -> Succession {
        let wire = self.wires.of(&succession.wire);
        let trigger = self.wires.trigger_of(&succession.wire).unwrap_or(&wire.watch);
        let (sequence, longest_ns) = turn(wire.watch.newest(), trigger.newest(), trigger.rate_hz(now_ns()));
        let _ = wire.held.give_turn(succession.generation, sequence);
        succession.phase = Phase::HandingOver {
            sequence,
            until_ns: now_ns() + longest_ns,
        };
        succession
    }

    /// Why the candidate must not be promoted, if there is a reason.
    fn objection(&self, succession: &Succession, rehearsed: &Rehearsed) -> Option<String> {
        let counts = rehearsed.counts;
        if counts.missed + counts.unordered + counts.bad > 0 {
            return Some(format!(
                "it left out {} cycles, answered {} twice or out of order, and sent {} statuses that have no meaning",
                counts.missed, counts.unordered, counts.bad
            ));
        }
        for (name, largest) in &succession.request.require {
            match rehearsed.fields.iter().find(|(field, _)| field == name) {
                None => return Some(format!("`{}` has no number `{name}`", succession.port.name())),
                Some((_, difference)) if difference.cycles == 0 || difference.rms > *largest => {
                    return Some(format!(
                        "{name} differs by {:.6} (RMS over {} cycles), more than {largest}",
                        difference.rms, difference.cycles
                    ));
                }
                Some(_) => {}
            }
        }
        let peers = self.wires.of(&succession.wire).held.peers();
        let opens = peers
            .iter()
            .any(|(role, pid)| *role == Role::Writer && succession.process.owns(*pid));
        (!opens && !succession.request.dry_run).then(|| {
            "it does not open the wire named in takes_over, so it cannot take a turn on it (README: How to replace a service)"
                .into()
        })
    }

    fn rehearsed(&self, succession: &Succession) -> Rehearsed {
        let latency_us = |watch: &Watch| {
            let latencies = watch.latencies();
            [0.5, 0.99].map(|quantile| latencies.value_at_quantile(quantile) as f64 / 1000.0)
        };
        Rehearsed {
            service: succession.request.service.clone(),
            counts: succession.comparison.counts(),
            incumbent_latency_us: latency_us(&self.wires.of(&succession.wire).watch),
            candidate_latency_us: latency_us(&succession.watch),
            fields: succession.comparison.differences(),
        }
    }

    fn await_turn(
        &mut self,
        succession: Succession,
        sequence: u64,
        until_ns: u64,
    ) -> Result<Option<Succession>, Error> {
        let watch = &self.wires.of(&succession.wire).watch;
        if watch.generation == succession.generation {
            return self.promote(succession, sequence).map(|()| None);
        }
        if now_ns() > until_ns {
            return self.refuse(succession, "its turn came, and it said nothing");
        }
        Ok(Some(succession))
    }

    /// The candidate is the service from here on.
    fn promote(&mut self, mut succession: Succession, sequence: u64) -> Result<(), Error> {
        let name = succession.request.service.clone();
        let table = self.document()?["service"][&name].clone();
        // Not from the file as it was when the candidate was started: another service may have been rolled back since.
        self.adopt(&self.document_with(&succession.request)?)?;
        self.root
            .rename(&format!("{name}.checkpoint"), &format!("{name}.former.checkpoint"));
        self.root
            .rename(&format!("{name}.{REHEARSAL_CHECKPOINT}"), &format!("{name}.checkpoint"));
        if let Some(program) = self.system.programs.insert(name.clone(), succession.program) {
            let former = Former {
                table,
                program,
                until_ns: now_ns() + succession.request.probation_ms * MS_NS,
            };
            self.former.insert(name.clone(), former);
        }
        let service = self.service(&name);
        service.generation = succession.generation;
        service.started_ns = succession.started_ns;
        service.ready_ns = now_ns();
        // It was the incumbent that hung, if one did.
        service.kill_at_ns = None;
        let incumbent = service.process.replace(succession.process);
        self.say(format!(
            "{name}: start {} answers from cycle {sequence} on",
            succession.generation
        ));
        incumbent.into_iter().for_each(|process| self.dismiss(process));
        succession.caller.tell(&Reply::Promoted(sequence));
        Ok(())
    }

    /// The incumbent stays, and the candidate goes.
    fn refuse(&mut self, mut succession: Succession, why: &str) -> Result<Option<Succession>, Error> {
        let name = succession.request.service.clone();
        self.say(format!("{name}: swap refused: {why}"));
        succession.caller.tell(&Reply::Refused(why.to_owned()));
        let handing_over = matches!(succession.phase, Phase::HandingOver { .. });
        self.dismiss(succession.process);
        if handing_over {
            // The incumbent may have stopped for good at the candidate's turn: another start takes the turn back.
            let _ = self.wires.of(&succession.wire).held.give_turn(0, 0);
            self.service(&name).process.iter().for_each(Process::kill);
        }
        Ok(None)
    }

    /// Lets a process end that is no service any more.
    pub(super) fn dismiss(&mut self, process: Process) {
        process.terminate();
        self.leaving.push((process, now_ns() + 10 * HANG_GRACE_NS));
    }

    /// Sees off those that are to end.
    pub(super) fn look_at_leaving(&mut self) -> Result<(), Error> {
        let mut gone = false;
        for (mut process, kill_at_ns) in std::mem::take(&mut self.leaving) {
            if process.ended()?.is_some() {
                gone = true;
                continue;
            }
            if now_ns() > kill_at_ns {
                process.kill();
            }
            self.leaving.push((process, kill_at_ns));
        }
        if gone {
            self.root.sweep();
            let _ = self.domain.clean();
        }
        Ok(())
    }

    /// If the service that has just ended is on probation, its predecessor is to be started in its place.
    pub(super) fn roll_back(&mut self, name: &str) -> Result<bool, Error> {
        let former = self.former.remove(name);
        let Some(former) = former.filter(|former| now_ns() < former.until_ns) else {
            return Ok(false);
        };
        let mut document = self.document()?;
        document["service"][name] = former.table;
        self.adopt(&document)?;
        self.system.programs.insert(name.to_owned(), former.program);
        self.root
            .rename(&format!("{name}.former.checkpoint"), &format!("{name}.checkpoint"));
        Ok(true)
    }
}

/// The cycle with which a candidate takes its turn, and the time by the end of which it is to have answered it [ns]. An
/// incumbent that lags has not answered all that has come, and the candidate has: the turn is ahead of both.
fn turn(answered: Option<u64>, triggered: Option<u64>, rate_hz: f64) -> (u64, u64) {
    let ahead = CYCLES_AHEAD_MIN.max((rate_hz * AHEAD_S).ceil() as u64);
    let sequence = answered.max(triggered).unwrap_or(0).saturating_add(ahead);
    // The cycles until then may come at half the rate.
    let coming_ns = (2e9 * ahead as f64 / rate_hz.max(RATE_MIN_HZ)) as u64;
    (sequence, coming_ns + HAND_OVER_MAX_NS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_is_ahead_of_what_a_lagging_incumbent_has_still_to_answer() {
        assert_eq!(turn(Some(100), Some(101), 30.0).0, 104);
        assert_eq!(turn(Some(100), Some(140), 30.0).0, 143);
        assert_eq!(turn(Some(100), Some(101), 400.0).0, 141);
        assert_eq!(turn(Some(u64::MAX - 1), None, 30.0).0, u64::MAX, "as far as numbers go");
    }

    #[test]
    fn a_turn_is_waited_for_until_it_has_come() {
        for rate_hz in [0.2, 1.0, 30.0, 400.0] {
            let (ahead, longest_ns) = turn(Some(0), Some(0), rate_hz);
            let coming_ns = (1e9 * ahead as f64 / rate_hz) as u64;
            assert!(longest_ns >= coming_ns + HAND_OVER_MAX_NS, "{rate_hz} Hz");
        }
        assert!(
            turn(None, None, 0.0).1 < 120_000 * MS_NS,
            "not for ever where nothing comes"
        );
    }
}
