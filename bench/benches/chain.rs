//! A whole estimation cycle, from the camera's frame to the terrain: the real processes, paced by the camera, against the
//! same libs called one after the other in one process at the same pace.

use bench::{Options, Outcome, Processes, Report, Series, programs};
use clap::Parser;
use messages::{Frame, Header, Message, Sinkage, Soil, Status, Terrain, Wheel};
use shell::{Error, Tap, Termination, now_ns, sleep_until};
use simulation::Rover;
use sinkage::SinkageTracker;
use std::collections::BTreeMap;
use std::process::Command;
use telemetry::{Event, SimulatedTelemetry};
use terrain::TerrainFusion;
use terramechanics::SoilEstimator;
use zerocopy::FromZeros;

/// Rounds of the process set, and as many of the one process, by turns.
const ROUNDS: usize = 3;
/// Cycles in a round, at 30 a second.
const CYCLES: usize = 120;
const PERIOD_NS: u64 = 33_333_333;
/// How long the last cycles may take to arrive [ns].
const DRAIN_NS: u64 = 500_000_000;

#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
}

/// What is timed, both in the process set and in one process.
const SPANS: [&str; 4] = [
    "frame to sinkage",
    "sinkage to soil",
    "soil to terrain",
    "frame to terrain",
];

fn main() -> Outcome<()> {
    let options = Arguments::parse().options;
    let termination = Termination::listen()?;
    let mut report = Report::begin("chain", &options);
    let cycles = options.amount(CYCLES);
    let name = |place: &str, span: &str| format!("{place}: {span}");
    let mut alone = SPANS.map(|span| Series::new(name("one process", span)));
    let mut processes = SPANS.map(|span| Series::new(name("processes", span)).over(name("one process", span)));
    let mut count = Count::default();
    for _ in 0..ROUNDS {
        alone.iter_mut().chain(&mut processes).for_each(Series::begin_round);
        one_process(cycles, &mut alone, &termination)?;
        let system = Processes::start(&built_in()?, &termination)?;
        let seen = watch(&system, cycles, &termination)?;
        system.end()?;
        count.add(&seen, &mut processes);
    }
    let all: Vec<Series> = alone.iter().chain(&processes).cloned().collect();
    report.table("One cycle at 30 Hz, from published sample to published sample", &all);
    let [hops, compute] = [&processes, &alone].map(|spans| spans.each_ref().map(Series::p50_us));
    let waits: Vec<String> = (0..3)
        .map(|stage| format!("{:.0}", hops[stage] - compute[stage]))
        .collect();
    report.note(format!(
        "\nOf the median cycle of {:.0} µs, {:.0} µs are compute; transport and wake-up take {} µs before sinkage, \
         terramechanics and terrain.",
        hops[3],
        compute[3],
        waits.join(", ")
    ));
    report.note(count.to_string());
    report.end()
}

/// What a round of the process set has shown: when each sample was published [ns], by cycle.
#[derive(Default)]
struct Seen {
    /// Frames, sinkage, soil, terrain.
    published_ns: [BTreeMap<u64, u64>; 4],
}

/// How many cycles there were and were not.
#[derive(Default)]
struct Count {
    due: u64,
    frames: u64,
    lost: u64,
}

impl Count {
    /// Takes in a round: every cycle whose frame was published, as far as it went.
    fn add(&mut self, seen: &Seen, series: &mut [Series; 4]) {
        let [frames, sinkage, soil, terrain] = &seen.published_ns;
        let (Some((first, _)), Some((last, _))) = (frames.first_key_value(), frames.last_key_value()) else {
            return;
        };
        self.due += last - first + 1;
        self.frames += frames.len() as u64;
        self.lost += frames.keys().filter(|cycle| !terrain.contains_key(cycle)).count() as u64;
        let spans = [(frames, sinkage), (sinkage, soil), (soil, terrain), (frames, terrain)];
        for (series, (from, to)) in series.iter_mut().zip(spans) {
            for (cycle, begin_ns) in from.range(first..=last) {
                if let Some(end_ns) = to.get(cycle) {
                    series.record(end_ns.saturating_sub(*begin_ns));
                }
            }
        }
    }
}

impl std::fmt::Display for Count {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            formatter,
            "Cycles: {} due, {} frames published and seen, {} of them without a terrain.",
            self.due, self.frames, self.lost
        )
    }
}

/// The built-in system under a name of its own.
fn built_in() -> Outcome<String> {
    let text = Command::new(programs()?.join("terrasense"))
        .arg("default-system")
        .output()?;
    let name = format!("name = \"bench{}\"", std::process::id());
    Ok(String::from_utf8(text.stdout)?.replace("name = \"rover\"", &name))
}

/// Looks on for so many frames, and until their cycles are over.
fn watch(system: &Processes, cycles: usize, termination: &Termination) -> Outcome<Seen> {
    let domain = system.enter()?;
    let sinkage = Tap::<Sinkage>::open(&domain, "front/sinkage")?;
    let soil = Tap::<Soil>::open(&domain, "front/soil")?;
    let terrain = Tap::<Terrain>::open(&domain, "front/terrain")?;
    // Last: of every frame that is seen, what follows is seen too.
    let frames = Tap::<Frame>::open(&domain, "front/frames")?;
    let mut seen = Seen::default();
    let mut last_ns = None;
    while last_ns.is_none_or(|last_ns| now_ns() < last_ns) {
        if termination.requested() {
            return Err("told to end".into());
        }
        let [seen_frames, seen_sinkage, seen_soil, seen_terrain] = &mut seen.published_ns;
        if last_ns.is_none() {
            drain(&frames, seen_frames)?;
        }
        drain(&sinkage, seen_sinkage)?;
        drain(&soil, seen_soil)?;
        drain(&terrain, seen_terrain)?;
        if last_ns.is_none() && seen_frames.len() >= cycles {
            last_ns = Some(now_ns() + DRAIN_NS);
        }
        terrain.wait()?;
    }
    Ok(seen)
}

/// Notes when each sample that is there was published.
fn drain<T: Message>(tap: &Tap<T>, seen: &mut BTreeMap<u64, u64>) -> Result<(), Error> {
    while let Some(header) = tap.poll(|sample| *sample.header())? {
        seen.insert(header.sequence, header.published_ns);
    }
    Ok(())
}

/// The same work in one process: the picture is taken, then one lib after the other is called.
fn one_process(cycles: usize, series: &mut [Series; 4], termination: &Termination) -> Outcome<()> {
    let config = simulation::Config::default();
    let rover = Rover::new(config.clone());
    let mut telemetry = SimulatedTelemetry::new(config, 0);
    let mut frame = Frame::new_box_zeroed().map_err(|_| "no memory for a picture")?;
    let mut tracker = SinkageTracker::new(sinkage::Config::default());
    let mut estimator = SoilEstimator::new(terramechanics::Config::default());
    let mut fusion = TerrainFusion::new(terrain::Config::default());
    let started_ns = now_ns();
    let mut ticks = 0..;
    for cycle in 1..=cycles as u64 {
        sleep_until(started_ns + cycle * PERIOD_NS);
        if termination.requested() {
            return Err("told to end".into());
        }
        let taken_ns = cycle * PERIOD_NS;
        rover.render(taken_ns as f64 / 1e9, &mut frame);
        frame.header = Header {
            taken_ns,
            sequence: cycle,
            status: Status::OK,
            ..Header::default()
        };
        let readings = readings(&mut telemetry, &mut ticks, taken_ns);
        let published_ns = now_ns();
        let sinkage = tracker.step(&frame);
        let sinkage_ns = now_ns();
        readings.iter().for_each(|reading| estimator.observe_wheel(reading));
        let soil = estimator.step(&sinkage);
        let soil_ns = now_ns();
        fusion.observe_sinkage(&sinkage);
        let terrain = std::hint::black_box(fusion.step(&soil));
        let terrain_ns = now_ns();
        assert_eq!(terrain.header.sequence, cycle, "each cycle has its terrain");
        let spans = [
            (published_ns, sinkage_ns),
            (sinkage_ns, soil_ns),
            (soil_ns, terrain_ns),
            (published_ns, terrain_ns),
        ];
        for (series, (begin_ns, end_ns)) in series.iter_mut().zip(spans) {
            series.record(end_ns - begin_ns);
        }
    }
    Ok(())
}

/// The wheel readings until `taken_ns` that are new.
fn readings(telemetry: &mut SimulatedTelemetry, ticks: &mut std::ops::RangeFrom<u64>, taken_ns: u64) -> Vec<Wheel> {
    let mut readings = Vec::new();
    while ticks.start * SimulatedTelemetry::PERIOD_NS <= taken_ns {
        let Some(tick) = ticks.next() else { break };
        let Ok(()) = telemetry.at(tick, |event| {
            if let Event::Wheel(reading) = event {
                readings.push(reading);
            }
            Ok::<(), std::convert::Infallible>(())
        });
    }
    readings
}
