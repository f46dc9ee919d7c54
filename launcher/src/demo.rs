//! `demo`: the whole system on the simulated rover, in a live table against the truth.

use crate::commands::{self, DEFAULT_SYSTEM, find, listen};
use crate::status;
use crate::supervisor::{Seen, Supervisor};
use crate::system::System;
use crate::watch::LATENCY_MAX_NS;
use clap::Args;
use hdrhistogram::Histogram;
use messages::{Header, ServiceState, Sinkage, Terrain};
use shell::{Error, Port, SystemFile, now_ns};
use simulation::{Rover, State};
use std::collections::{BTreeMap, VecDeque};
use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use toml_edit::{DocumentMut, value};
use zerocopy::FromBytes;

/// Between two pictures of the table on a terminal [ns].
const DRAW_NS: u64 = 200_000_000;
/// Between two lines where there is no terminal [ns].
const LINE_NS: u64 = 1_000_000_000;
/// Frames whose instants are remembered until their cycle is complete.
const FRAMES_REMEMBERED: usize = 256;
/// Lines of the log under the table.
const LOG_LINES: usize = 4;

/// `terrasense demo`
#[derive(Debug, Args)]
pub struct DemoArguments {
    /// How long to drive [s].
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    seconds: u64,
    /// The traverse: another seed, another rover and route.
    #[arg(long, default_value_t = 1)]
    seed: u32,
}

/// A change of soil may take so many cycles to be found; what is said until then is of the soil before.
const CHANGE_CYCLES: u64 = 60;

/// What the demo remembers of its cycles.
struct Tally {
    rover: Rover,
    started_ns: u64,
    frames: VecDeque<(u64, u64)>,
    latencies: Histogram<u64>,
    cycles: u64,
    first_sequence: Option<u64>,
    last_sequence: u64,
    sinkage_squares: f64,
    sinkages: u64,
    classes_right: u64,
    classes: u64,
    latest: Option<Terrain>,
    /// The soil driven on, and cycles since it changed.
    on_soil: (usize, u64),
    /// Per soil: cohesion and friction angle with their sigmas, as last estimated on it.
    soils: BTreeMap<usize, Terrain>,
}

/// Runs the demo.
pub fn run(arguments: &DemoArguments) -> Result<ExitCode, Error> {
    let system = system(arguments.seed)?;
    commands::check_configs(&system, None)?;
    let termination = listen()?;
    let mut supervisor = Supervisor::new(system, termination.clone())?;
    let rover = simulation::Config {
        seed: u64::from(arguments.seed),
        ..simulation::Config::default()
    };
    let mut tally = Tally::new(Rover::new(rover), supervisor.started_ns());
    shell::tell(format_args!(
        "terrasense: a simulated rover drives for {} s; every service is a process of its own",
        arguments.seconds
    ));
    supervisor.start(|seen| tally.see(seen))?;
    let mut screen = Screen::new();
    let until_ns = now_ns() + arguments.seconds * 1_000_000_000;
    while now_ns() < until_ns && !termination.requested() {
        supervisor.tick(|seen| tally.see(seen))?;
        screen.draw(&mut supervisor, &tally);
    }
    let report = status::rows(&supervisor.report());
    let deadline_ms = supervisor.system().file.system.cycle_deadline_ms.as_ref();
    let missed = deadline_ms.map(|deadline_ms| missed(*deadline_ms.get_ref(), &report));
    let given_up = supervisor
        .services()
        .values()
        .any(|service| service.state == ServiceState::GIVEN_UP);
    supervisor.stop(|_| ())?;
    screen.close(&mut supervisor);
    println!("{}\n\n{}", status::table(&report), tally.summary());
    missed.iter().for_each(|missed| println!("{missed}"));
    if given_up || tally.cycles == 0 {
        return Err(Error::internal(
            "a service has ended, or no cycle was completed; see above",
        ));
    }
    Ok(ExitCode::SUCCESS)
}

/// Which stages cycles have been too late at.
fn missed(deadline_ms: f64, report: &[status::Row]) -> String {
    let stages = report.iter().filter(|row| row.missed > 0);
    let stages: Vec<String> = stages.map(|row| format!("{} at {}", row.missed, row.service)).collect();
    if stages.is_empty() {
        return format!("deadline of {deadline_ms} ms: missed by no cycle");
    }
    format!("deadline of {deadline_ms} ms: cycles late first: {}", stages.join(", "))
}

fn system(seed: u32) -> Result<System, Error> {
    let mut document: DocumentMut = DEFAULT_SYSTEM
        .parse()
        .map_err(|error| Error::internal(format!("the built-in rover.toml: {error}")))?;
    // Several demos can run at once.
    document["system"]["name"] = value(format!("demo_{}", std::process::id()));
    for source in ["camera", "telemetry"] {
        document["service"][source]["config"]["rover"]["seed"] = value(i64::from(seed));
    }
    let file = SystemFile::parse("the built-in rover.toml", &document.to_string())?;
    System::check(file, |program| find(program, None))
}

impl Tally {
    fn new(rover: Rover, started_ns: u64) -> Self {
        Self {
            rover,
            started_ns,
            frames: VecDeque::with_capacity(FRAMES_REMEMBERED),
            latencies: Histogram::new_with_bounds(1, LATENCY_MAX_NS, 3)
                .unwrap_or_else(|_| unreachable!("the bounds are right")),
            cycles: 0,
            first_sequence: None,
            last_sequence: 0,
            sinkage_squares: 0.0,
            sinkages: 0,
            classes_right: 0,
            classes: 0,
            latest: None,
            on_soil: (0, 0),
            soils: BTreeMap::new(),
        }
    }

    fn see(&mut self, (_, port, header, bytes): Seen<'_>) {
        match port {
            Port::Frames => {
                if self.frames.len() == FRAMES_REMEMBERED {
                    self.frames.pop_front();
                }
                self.frames.push_back((header.sequence, header.published_ns));
            }
            Port::Sinkage => {
                if let Ok(sample) = Sinkage::read_from_bytes(bytes) {
                    self.see_sinkage(&sample);
                }
            }
            Port::Terrain => {
                if let Ok(sample) = Terrain::read_from_bytes(bytes) {
                    self.see_terrain(&sample);
                }
            }
            _ => {}
        }
    }

    fn see_sinkage(&mut self, sample: &Sinkage) {
        if sample.header.status.is_answer() {
            let error_m = sample.sinkage_m - self.truth(&sample.header).sinkage_m;
            self.sinkage_squares += error_m * error_m;
            self.sinkages += 1;
        }
    }

    fn see_terrain(&mut self, sample: &Terrain) {
        self.cycles += 1;
        self.first_sequence.get_or_insert(sample.header.sequence);
        self.last_sequence = sample.header.sequence;
        let sent = self
            .frames
            .iter()
            .find(|(sequence, _)| *sequence == sample.header.sequence);
        if let Some((_, sent_ns)) = sent {
            self.latencies
                .saturating_record(sample.header.published_ns.saturating_sub(*sent_ns).max(1));
        }
        let truth = self.truth(&sample.header);
        if sample.valid & Terrain::CLASS != 0 {
            self.classes += 1;
            self.classes_right += u64::from(sample.class_text() == self.rover.soils()[truth.soil].name);
        }
        self.on_soil = match self.on_soil {
            (soil, cycles) if soil == truth.soil => (soil, cycles + 1),
            _ => (truth.soil, 0),
        };
        if sample.valid & Terrain::SOIL != 0 && self.on_soil.1 >= CHANGE_CYCLES {
            self.soils.insert(truth.soil, *sample);
        }
        self.latest = Some(*sample);
    }

    fn truth(&self, header: &Header) -> State {
        self.rover
            .state(header.taken_ns.saturating_sub(self.started_ns) as f64 * 1e-9)
    }

    /// The latest cycle against the truth, a line a quantity.
    fn cycle(&self) -> Vec<String> {
        let Some(cycle) = &self.latest else {
            return vec!["no cycle yet".into()];
        };
        let truth = self.truth(&cycle.header);
        let soil = &self.rover.soils()[truth.soil];
        let unknown = if cycle.unknown != 0 { " (unknown)" } else { "" };
        let status = cycle.header.status.word().unwrap_or("?");
        vec![
            format!(
                "cycle {:<8} {status:<12}          estimate              truth",
                cycle.header.sequence
            ),
            format!(
                "  sinkage          mm {:>10.1} ± {:<8.1} {:>10.1}",
                1e3 * cycle.sinkage_m,
                1e3 * cycle.sinkage_sigma_m,
                1e3 * truth.sinkage_m
            ),
            format!(
                "  cohesion c       Pa {:>10.0} ± {:<8.0} {:>10.0}",
                cycle.cohesion_pa, cycle.cohesion_sigma_pa, soil.cohesion_pa
            ),
            format!(
                "  friction angle φ  ° {:>10.1} ± {:<8.1} {:>10.1}",
                cycle.friction_rad.to_degrees(),
                cycle.friction_sigma_rad.to_degrees(),
                soil.friction_rad.to_degrees()
            ),
            format!(
                "  strength S       Pa {:>10.0} ± {:<8.0} {:>10.0}",
                cycle.strength_pa,
                cycle.strength_sigma_pa,
                soil.cohesion_pa + cycle.pressure_pa * soil.friction_rad.tan()
            ),
            format!(
                "  class               {:>10} p={:<8.2} {:>10}{unknown}",
                cycle.class_text(),
                cycle.class_probability,
                soil.name
            ),
        ]
    }

    fn summary(&self) -> String {
        let expected = self.first_sequence.map_or(0, |first| self.last_sequence - first + 1);
        let lost = expected.saturating_sub(self.cycles);
        let ms = |ns: u64| ns as f64 * 1e-6;
        let mut text = format!(
            "{} cycles, {lost} lost; frame to terrain: p50 {:.2} ms, p99 {:.2} ms, max {:.2} ms (n = {})",
            self.cycles,
            ms(self.latencies.value_at_quantile(0.5)),
            ms(self.latencies.value_at_quantile(0.99)),
            ms(self.latencies.max()),
            self.latencies.len()
        );
        if self.sinkages > 0 {
            let rms_mm = 1e3 * (self.sinkage_squares / self.sinkages as f64).sqrt();
            text += &format!("\nsinkage: RMS error {rms_mm:.1} mm over {} frames", self.sinkages);
        }
        if self.classes > 0 {
            let share = 100.0 * self.classes_right as f64 / self.classes as f64;
            text += &format!("\nclass: right in {share:.0} % of {} cycles", self.classes);
        }
        for (soil, cycle) in &self.soils {
            let soil = &self.rover.soils()[*soil];
            text += &format!(
                "\n{:<12} c {:>6.0} ± {:<5.0} Pa (true {:>5.0}), φ {:>5.1} ± {:<4.1}° (true {:>4.1})",
                soil.name,
                cycle.cohesion_pa,
                cycle.cohesion_sigma_pa,
                soil.cohesion_pa,
                cycle.friction_rad.to_degrees(),
                cycle.friction_sigma_rad.to_degrees(),
                soil.friction_rad.to_degrees()
            );
        }
        text
    }
}

/// The live table on a terminal; a line a second elsewhere.
struct Screen {
    terminal: bool,
    drawn_ns: u64,
    lines: usize,
    log: VecDeque<String>,
}

impl Screen {
    fn new() -> Self {
        Self {
            terminal: std::io::stdout().is_terminal(),
            drawn_ns: 0,
            lines: 0,
            log: VecDeque::new(),
        }
    }

    fn draw(&mut self, supervisor: &mut Supervisor, tally: &Tally) {
        self.take_log(supervisor);
        let pause_ns = if self.terminal { DRAW_NS } else { LINE_NS };
        if now_ns() - self.drawn_ns < pause_ns {
            return;
        }
        self.drawn_ns = now_ns();
        if !self.terminal {
            println!("{}", tally.line());
            return;
        }
        let mut lines = tally.cycle();
        lines.push(String::new());
        lines.extend(
            status::table(&status::rows(&supervisor.report()))
                .lines()
                .map(str::to_owned),
        );
        lines.push(String::new());
        lines.extend(self.log.iter().cloned());
        self.erase();
        self.lines = lines.len();
        println!("{}", lines.join("\n"));
    }

    fn close(&mut self, supervisor: &mut Supervisor) {
        self.take_log(supervisor);
        self.erase();
    }

    fn take_log(&mut self, supervisor: &mut Supervisor) {
        for line in supervisor.take_log() {
            if !self.terminal {
                shell::tell(format_args!("terrasense: {line}"));
            }
            if self.log.len() == LOG_LINES {
                self.log.pop_front();
            }
            self.log.push_back(line);
        }
    }

    /// Goes back to the table's first line and clears what follows.
    fn erase(&mut self) {
        if self.terminal && self.lines > 0 {
            print!("\x1b[{}A\x1b[J", self.lines);
            // A terminal that has gone is not the demo's concern.
            let _ = std::io::stdout().flush();
        }
        self.lines = 0;
    }
}

impl Tally {
    /// The latest cycle on one line.
    fn line(&self) -> String {
        let Some(cycle) = &self.latest else {
            return "no cycle yet".into();
        };
        let soil = &self.rover.soils()[self.truth(&cycle.header).soil];
        format!(
            "cycle {:>6}  z {:>5.1} mm  c {:>6.0} ± {:<5.0} Pa (true {:>5.0})  φ {:>5.1} ± {:<4.1}° (true {:>4.1})  {} (true {})",
            cycle.header.sequence,
            1e3 * cycle.sinkage_m,
            cycle.cohesion_pa,
            cycle.cohesion_sigma_pa,
            soil.cohesion_pa,
            cycle.friction_rad.to_degrees(),
            cycle.friction_sigma_rad.to_degrees(),
            soil.friction_rad.to_degrees(),
            if cycle.unknown != 0 {
                "unknown"
            } else {
                cycle.class_text()
            },
            soil.name
        )
    }
}
