//! The wires of a running system: held by the launcher, and seen by it.

use super::{POLLS_MAX, Seen};
use crate::deadline::Cycles;
use crate::system::System;
use crate::watch::Watch;
use shell::{AnyTap, Domain, Error, HeldWire, Mode, Port};

/// A wire, held, and seen by the launcher.
pub(super) struct WatchedWire {
    pub(super) watch: Watch,
    name: String,
    port: Port,
    writer: String,
    tap: AnyTap,
    pub(super) held: HeldWire,
    /// The place of the wire whose samples trigger those of this one.
    trigger: Option<usize>,
    /// The place of the wire with which its chain begins.
    first: usize,
}

/// All wires, in the graph's order: an answer finds its trigger already counted.
pub(super) struct Wires {
    wires: Vec<WatchedWire>,
    /// The cycles of the chain that begins with each wire, where cycles have a deadline.
    chains: Vec<Cycles>,
    deadline_ms: f64,
}

impl Wires {
    /// Makes the wires of a system.
    pub(super) fn make(system: &System, domain: &Domain) -> Result<Self, Error> {
        let mut names: Vec<&String> = system.wires.keys().collect();
        names.sort_by_key(|name| system.wires[*name].port);
        let mut wires: Vec<WatchedWire> = Vec::with_capacity(names.len());
        for (place, name) in names.into_iter().enumerate() {
            let about = &system.wires[name];
            let trigger = system.trigger_of(name);
            let trigger = trigger.and_then(|trigger| wires.iter().position(|wire| wire.name == trigger));
            wires.push(WatchedWire {
                watch: Watch::default(),
                name: name.clone(),
                port: about.port,
                writer: about.writer.clone(),
                held: domain.create(name, about.port)?,
                tap: domain.tap(name, about.port)?,
                trigger,
                first: trigger.map_or(place, |trigger| wires[trigger].first),
            });
        }
        // A recording is played as fast as it goes: its cycles queue, and have no deadline.
        let deadline_ms = system.file.system.cycle_deadline_ms.as_ref();
        let deadline_ms = deadline_ms.filter(|_| system.file.system.mode == Mode::Live);
        let deadline_ms = deadline_ms.map(|deadline| *deadline.get_ref());
        let chain = |deadline_ms: f64| wires.iter().map(move |_| Cycles::new((deadline_ms * 1e6) as u64));
        Ok(Self {
            chains: deadline_ms.into_iter().flat_map(chain).collect(),
            deadline_ms: deadline_ms.unwrap_or_default(),
            wires,
        })
    }

    /// The wire of this name, which the graph has.
    pub(super) fn of(&self, name: &str) -> &WatchedWire {
        self.get(name)
            .unwrap_or_else(|| unreachable!("the names are the graph's"))
    }

    /// The wire of this name, if the graph has it.
    pub(super) fn get(&self, name: &str) -> Option<&WatchedWire> {
        self.wires.iter().find(|wire| wire.name == name)
    }

    /// The counters of the wire whose samples trigger those of the wire of this name.
    pub(super) fn trigger_of(&self, name: &str) -> Option<&Watch> {
        self.of(name).trigger.map(|trigger| &self.wires[trigger].watch)
    }

    /// The counters of the wires that a service writes.
    pub(super) fn written_by<'a>(&'a self, service: &'a str) -> impl Iterator<Item = &'a Watch> {
        let written = self.wires.iter().filter(move |wire| wire.writer == service);
        written.map(|wire| &wire.watch)
    }

    /// Takes in what is on the wires; how much that was. What is to be said of it goes to `say`.
    pub(super) fn drain(
        &mut self,
        say: &mut impl FnMut(String),
        on_sample: &mut impl FnMut(Seen<'_>),
    ) -> Result<usize, Error> {
        let mut seen = 0;
        for place in 0..self.wires.len() {
            let (before, rest) = self.wires.split_at_mut(place);
            let wire = &mut rest[0];
            let trigger = wire.trigger.map(|trigger| &before[trigger].watch);
            let mut cycles = self.chains.get_mut(wire.first);
            for _ in 0..POLLS_MAX {
                let watch = &mut wire.watch;
                let more = wire.tap.poll(&mut |header, bytes| {
                    watch.see(header, trigger);
                    match &mut cycles {
                        Some(cycles) if trigger.is_none() => cycles.begin(header),
                        Some(cycles) => {
                            if let Some(age_ns) = cycles.miss(header) {
                                watch.missed += 1;
                                tell(
                                    &wire.writer,
                                    header.sequence,
                                    age_ns,
                                    watch.missed,
                                    self.deadline_ms,
                                    say,
                                );
                            }
                        }
                        None => {}
                    }
                    on_sample((&wire.name, wire.port, header, bytes));
                })?;
                if !more {
                    break;
                }
                seen += 1;
            }
        }
        Ok(seen)
    }
}

/// Not every miss is told of: the first, and then ever fewer.
fn tell(service: &str, cycle: u64, age_ns: u64, missed: u64, deadline_ms: f64, say: &mut impl FnMut(String)) {
    if missed.is_power_of_two() {
        say(format!(
            "{service}: cycle {cycle} was {:.1} ms old when it was answered, its deadline is {deadline_ms} ms; {missed} missed so \
             far",
            age_ns as f64 * 1e-6
        ));
    }
}
