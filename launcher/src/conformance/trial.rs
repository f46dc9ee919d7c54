//! The trial of one program: what is done with it, in order, and what it answers.

use super::play::{self, Observed, Played, Spoiled, place_in_time};
use super::stand::{Candidate, Refusal, Stand, own_memory, wire};
use crate::watch::LATENCY_MAX_NS;
use hdrhistogram::Histogram;
use messages::{Header, Message, Sinkage, Status, TerrainClass, Wheel};
use rustix::process::Signal;
use shell::{Error, Output, Port, Tap, now_ns};
use simulation::Rover;
use std::collections::BTreeMap;
use std::process::ExitStatus;

/// Triggers that are sent one by one, and then so many at once.
const SINGLES: u64 = 60;
const BURSTS: u64 = 20;
const BURST: u64 = 3;
/// An answer takes no longer [ns]; and, once this many have not come, not that long.
const PATIENCE_NS: u64 = 2_000_000_000;
const MISSED_MAX: u64 = 3;
const PATIENCE_LOST_NS: u64 = 100_000_000;
/// Answers that nobody has asked for are waited for [ns].
const QUIET_NS: u64 = 150_000_000;
/// A wait for a bell that ended before this was ended by the bell [ns]: it lasts 20 ms otherwise.
const RUNG_NS: u64 = 19_000_000;
/// Time that a process has to end after SIGTERM [ns].
pub const TERM_MAX_NS: u64 = 1_000_000_000;
/// Sensor time from one cycle to the next [ns]: of frames, and of pieces of vibration.
const PERIOD_NS: u64 = 33_333_333;
const PIECE_NS: u64 = 100_000_000;

/// What was sent and what came back.
#[derive(Default)]
pub struct Exchange {
    /// What was sent, in order.
    pub sent: Vec<Sent>,
    /// What came back, in order.
    pub answers: Vec<Answer>,
}

/// A trigger.
#[derive(Clone, Copy)]
pub struct Sent {
    /// Its number.
    pub sequence: u64,
    /// Its instant.
    pub taken_ns: u64,
    /// When it was sent.
    pub sent_ns: u64,
}

/// An answer.
#[derive(Clone, Copy)]
pub struct Answer {
    /// Its header.
    pub header: Header,
    /// When it was seen.
    pub seen_ns: u64,
    /// Whether the bell was rung for it.
    pub rung: bool,
    /// What its own check says.
    pub check: Result<(), &'static str>,
}

/// A trigger that could not be believed.
pub struct Bad {
    /// What was wrong with it.
    pub what: Spoiled,
    /// True if an answer must not claim to know anything.
    pub hopeless: bool,
    /// What came back.
    pub answers: Vec<Answer>,
}

/// All that was seen.
#[derive(Default)]
pub struct Evidence {
    /// Time to open all wires, at the first start and after the kill [ns].
    pub opened_ns: [Option<u64>; 2],
    /// The same, at the most [ms].
    pub start_timeout_ms: u64,
    /// A simulated rover's cycles.
    pub good: Exchange,
    /// What cannot be believed.
    pub bad: Vec<Bad>,
    /// More cycles, for memory and latency.
    pub long: Exchange,
    /// The program's own memory, before the last three quarters of these cycles and after them [bytes].
    pub memory: Option<(u64, u64)>,
    /// After kill -9 and a new start.
    pub restarted: Exchange,
    /// The end of the recording, and what came back.
    pub end: (Option<Sent>, Vec<Answer>),
    /// How it ended after SIGTERM, and how long that took [ns].
    pub term: (Option<ExitStatus>, u64),
    /// Wires of another layout.
    pub layouts: Vec<Refusal>,
    /// A service that its file does not have.
    pub unknown_name: Option<Refusal>,
    /// A key of the configuration that it cannot know.
    pub unknown_key: Option<Refusal>,
    /// What the program said before it ended by itself, while it was to answer.
    pub said: String,
}

impl Evidence {
    /// From the triggers to their answers: median and 99th percentile [µs].
    pub fn latency_us(&self) -> Option<(f64, f64)> {
        let mut histogram = Histogram::<u64>::new_with_bounds(1, LATENCY_MAX_NS, 3).ok()?;
        for exchange in [&self.good, &self.long] {
            for answer in &exchange.answers {
                if let Some(sent) = exchange.trigger_of(&answer.header) {
                    histogram.saturating_record(answer.header.published_ns.saturating_sub(sent.sent_ns).max(1));
                }
            }
        }
        let quantile = |share| histogram.value_at_quantile(share) as f64 / 1e3;
        (!histogram.is_empty()).then(|| (quantile(0.5), quantile(0.99)))
    }

    /// How often each status was answered to what can be believed.
    pub fn statuses(&self) -> BTreeMap<&'static str, usize> {
        let mut counts = BTreeMap::new();
        for answer in self.good.answers.iter().chain(&self.long.answers) {
            *counts
                .entry(answer.header.status.word().unwrap_or("no known status"))
                .or_default() += 1;
        }
        counts
    }
}

impl Exchange {
    /// The trigger of this sequence.
    pub fn trigger_of(&self, header: &Header) -> Option<&Sent> {
        let at = self
            .sent
            .binary_search_by_key(&header.sequence, |sent| sent.sequence)
            .ok()?;
        Some(&self.sent[at])
    }
}

/// One program's trial: triggers go in, answers come out.
pub struct Trial<'a, I: Message, O: Message> {
    stand: &'a Stand,
    rover: Rover,
    triggers: Output<I>,
    observed: Vec<Observed>,
    answers: Tap<O>,
    begin_ns: u64,
    period_ns: u64,
    next: u64,
    missed: u64,
}

impl<'a, I: Played, O: Message> Trial<'a, I, O> {
    /// Does everything there is to do, and tells what was seen.
    pub fn run(stand: &'a Stand, cycles: u64) -> Result<Evidence, Error> {
        let mut trial = Self::new(stand, cycles)?;
        let mut evidence = Evidence {
            start_timeout_ms: stand.start_timeout_ms,
            ..Evidence::default()
        };
        trial.first_life(&mut evidence, cycles)?;
        trial.second_life(&mut evidence)?;
        trial.third_life(&mut evidence)?;
        evidence.layouts = vec![
            stand.refused("an input", "odd_inputs.toml", None)?,
            stand.refused("an output", "odd_outputs.toml", None)?,
        ];
        evidence.unknown_name = Some(stand.refused("a service", "plain.toml", Some("no_such_service"))?);
        evidence.unknown_key = Some(stand.refused("a key", "unknown_key.toml", None)?);
        Ok(evidence)
    }

    fn new(stand: &'a Stand, cycles: u64) -> Result<Self, Error> {
        let (domain, stage) = (&stand.domain, stand.stage);
        let open = |port: &Port| match port {
            Port::Wheel => play::observed::<Wheel>(domain, &wire(*port), &stand.termination),
            Port::Class => play::observed::<TerrainClass>(domain, &wire(*port), &stand.termination),
            _ => play::observed::<Sinkage>(domain, &wire(*port), &stand.termination),
        };
        // Cycles are played faster than they would come, so they begin in the past: no instant lies in the future.
        let nominal_ns = if stage.trigger() == Port::Vibration {
            PIECE_NS
        } else {
            PERIOD_NS
        };
        let all = cycles + 4 * (SINGLES + BURSTS * BURST);
        let period_ns = nominal_ns.min(now_ns() / (all + 1));
        Ok(Self {
            stand,
            rover: Rover::new(simulation::Config::default()),
            triggers: domain.output(&wire(stage.trigger()), &stand.termination)?,
            observed: stage.observed().iter().map(open).collect::<Result<_, _>>()?,
            answers: Tap::open(domain, &wire(stage.answers()))?,
            begin_ns: now_ns() - all * period_ns,
            period_ns,
            next: 1,
            missed: 0,
        })
    }

    /// Cycles one by one and in bursts, bad ones, and many: until kill -9.
    fn first_life(&mut self, evidence: &mut Evidence, cycles: u64) -> Result<(), Error> {
        let (mut candidate, opened_ns) = self.stand.start(1)?;
        evidence.opened_ns[0] = opened_ns;
        if opened_ns.is_some() {
            for _ in 0..SINGLES {
                self.cycle(&mut evidence.good, 1)?;
            }
            for _ in 0..BURSTS {
                self.cycle(&mut evidence.good, BURST)?;
            }
            self.collect(&mut evidence.good.answers, usize::MAX, QUIET_NS)?;
            for what in Spoiled::ALL {
                evidence.bad.push(self.bad(what)?);
            }
            let writer = self.stand.writer(&candidate);
            let memory = || writer.and_then(own_memory);
            let mut before = None;
            for cycle in 0..cycles {
                if cycle == cycles / 4 {
                    before = memory();
                }
                self.cycle(&mut evidence.long, 1)?;
            }
            evidence.memory = before.zip(memory());
        }
        self.note_end(&mut candidate, evidence)?;
        self.stand.kill(candidate)
    }

    /// After the kill: it goes on, until the recording ends.
    fn second_life(&mut self, evidence: &mut Evidence) -> Result<(), Error> {
        let (candidate, opened_ns) = self.stand.start(2)?;
        self.forget()?;
        evidence.opened_ns[1] = opened_ns;
        if opened_ns.is_some() {
            self.missed = 0;
            for _ in 0..SINGLES / 2 {
                self.cycle(&mut evidence.restarted, 1)?;
            }
            let header = self.header();
            self.triggers.end(header.taken_ns, header.sequence)?;
            evidence.end.0 = Some(sent(&header));
            self.collect(&mut evidence.end.1, 1, PATIENCE_NS)?;
        }
        self.stand.kill(candidate)
    }

    /// A start, a few cycles, and SIGTERM.
    fn third_life(&mut self, evidence: &mut Evidence) -> Result<(), Error> {
        let (mut candidate, _) = self.stand.start(3)?;
        self.forget()?;
        for _ in 0..BURST {
            self.cycle(&mut Exchange::default(), 1)?;
        }
        let told_ns = now_ns();
        candidate.signal(Signal::TERM);
        let status = self.stand.wait_for_end(&mut candidate, TERM_MAX_NS)?;
        evidence.term = (status, now_ns() - told_ns);
        self.stand.kill(candidate)
    }

    /// Sends so many triggers at once, and takes in what comes back.
    fn cycle(&mut self, exchange: &mut Exchange, count: u64) -> Result<(), Error> {
        let expected = exchange.answers.len() + count as usize;
        for _ in 0..count {
            let sent = self.send(|_| ())?;
            exchange.sent.push(sent);
        }
        let patience_ns = if self.missed < MISSED_MAX {
            PATIENCE_NS
        } else {
            PATIENCE_LOST_NS
        };
        self.collect(&mut exchange.answers, expected, patience_ns)?;
        self.missed += u64::from(exchange.answers.len() < expected);
        self.stand.go_on()
    }

    /// Sends what cannot be believed, and then waits for whatever comes back.
    fn bad(&mut self, what: Spoiled) -> Result<Bad, Error> {
        let mut hopeless = false;
        self.send(|sample| hopeless = what.spoil(sample))?;
        let mut answers = Vec::new();
        self.collect(&mut answers, 1, PATIENCE_NS)?;
        self.collect(&mut answers, usize::MAX, QUIET_NS)?;
        Ok(Bad {
            what,
            hopeless,
            answers,
        })
    }

    /// Sends what the stage takes in, and then a trigger.
    fn send(&mut self, spoil: impl FnOnce(&mut I)) -> Result<Sent, Error> {
        let header = self.header();
        let time_s = (header.sequence * self.period_ns) as f64 * 1e-9;
        for observed in &self.observed {
            observed(&self.rover, time_s, &header)?;
        }
        let mut sent = sent(&header);
        self.triggers.send_with(|sample| {
            sample.play(&self.rover, time_s);
            *sample.header_mut() = header;
            place_in_time(sample.as_mut_bytes(), I::FIELDS, &header);
            spoil(sample);
            sent.sent_ns = now_ns();
            Ok(())
        })?;
        Ok(sent)
    }

    /// The next trigger's.
    fn header(&mut self) -> Header {
        let sequence = self.next;
        self.next += 1;
        Header {
            taken_ns: self.begin_ns + sequence * self.period_ns,
            sequence,
            status: Status::OK,
            ..Header::default()
        }
    }

    /// Takes in answers until so many are there, or so long has passed [ns].
    fn collect(&self, answers: &mut Vec<Answer>, expected: usize, longest_ns: u64) -> Result<(), Error> {
        let last_ns = now_ns() + longest_ns;
        while answers.len() < expected && now_ns() < last_ns {
            let began_ns = now_ns();
            self.answers.wait()?;
            let rung = now_ns() - began_ns < RUNG_NS;
            let look = |sample: &O| Answer {
                header: *sample.header(),
                seen_ns: now_ns(),
                rung,
                check: sample.check(),
            };
            while let Some(answer) = self.answers.poll(look)? {
                answers.push(answer);
            }
        }
        Ok(())
    }

    /// Leaves aside what an earlier process has said late.
    fn forget(&self) -> Result<(), Error> {
        while self.answers.poll(|_| ())?.is_some() {}
        Ok(())
    }

    /// Notes why the program is not there any more, if it is not.
    fn note_end(&self, candidate: &mut Candidate, evidence: &mut Evidence) -> Result<(), Error> {
        if candidate.ended()?.is_some() && evidence.said.is_empty() {
            evidence.said = candidate.said();
        }
        Ok(())
    }
}

fn sent(header: &Header) -> Sent {
    Sent {
        sequence: header.sequence,
        taken_ns: header.taken_ns,
        sent_ns: now_ns(),
    }
}
