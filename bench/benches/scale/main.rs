//! What more wheels, more frames and larger frames cost: processor time of the services and latency of the cycle, with the
//! growth fitted to them.

mod sources;
mod together;

use bench::{Day, Options, Outcome, Processes, Report, Series, cpu_ns, exponent};
use clap::Parser;
use messages::{Frame, Header, Message, Terrain};
use shell::{Domain, Error, Tap, Termination, now_ns, sleep_until};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;
use zerocopy::IntoBytes;

/// Rounds, in each of which every variant has its turn.
const ROUNDS: usize = 3;
/// Time for which a variant is measured in a round [ms].
const MEASURED_MS: usize = 4000;
/// Frames before that: each place of the wires has then been used.
const WARM_UP_FRAMES: f64 = 110.0;
const WARM_UP_MIN_S: f64 = 1.5;
const WARM_UP_MAX_S: f64 = 6.0;
/// Between two looks at the wires [ns].
const LOOK_NS: u64 = 2_000_000;
/// Time for the last cycles to arrive [ns].
const DRAIN_NS: u64 = 500_000_000;

const WHEELS: [usize; 4] = [1, 2, 4, 6];
const RATES_HZ: [f64; 6] = [10.0, 30.0, 100.0, 200.0, 500.0, 1000.0];
const SIZES_PX: [(u32, u32); 4] = [(640, 480), (800, 600), (1024, 768), (1024, 1024)];
const USUAL: Variant = Variant {
    wheels: 1,
    rate_hz: 30.0,
    size_px: SIZES_PX[0],
    together: false,
};

#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
}

fn main() -> ExitCode {
    // The launcher starts this program as a source, or as the one process for all wheels.
    if let Some(system) = std::env::args().find(|argument| argument.ends_with(".toml")) {
        return shell::main(|shell| match shell.writes("terrain") {
            true => together::stages(shell, &system),
            false => sources::source(shell),
        });
    }
    match bench(&Arguments::parse().options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("scale: {error}");
            ExitCode::FAILURE
        }
    }
}

/// A system of some size.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Variant {
    wheels: usize,
    rate_hz: f64,
    size_px: (u32, u32),
    /// Whether one process serves all wheels.
    together: bool,
}

/// What is varied in a table: its name, the name of each variant, and how large it is.
struct Axis {
    title: &'static str,
    of: &'static str,
    variants: Vec<(String, f64, Variant)>,
}

fn axes() -> [Axis; 4] {
    let [wheels, together] = [false, true].map(|together| {
        WHEELS.map(|wheels| {
            let name = format!("{wheels} wheel{}", if wheels == 1 { "" } else { "s" });
            let variant = Variant {
                wheels,
                together,
                ..USUAL
            };
            (name, wheels as f64, variant)
        })
    });
    let rates = RATES_HZ.map(|rate_hz| (format!("{rate_hz} Hz"), rate_hz, Variant { rate_hz, ..USUAL }));
    let sizes = SIZES_PX.map(|size_px| {
        let (width, height) = size_px;
        let name = format!("{width}×{height}");
        (name, f64::from(width) * f64::from(height), Variant { size_px, ..USUAL })
    });
    [
        Axis {
            title: "wheels, each with its own services, at 30 Hz, 640×480",
            of: "wheels",
            variants: wheels.into(),
        },
        Axis {
            title: "wheels, one process for the stages of all, at 30 Hz, 640×480",
            of: "wheels",
            variants: together.into(),
        },
        Axis {
            title: "frames a second, one wheel, 640×480",
            of: "rate",
            variants: rates.into(),
        },
        Axis {
            title: "pixels, one wheel that fills the picture, at 30 Hz",
            of: "pixels",
            variants: sizes.into(),
        },
    ]
}

fn bench(options: &Options) -> Outcome<()> {
    let termination = Termination::listen()?;
    let mut report = Report::begin("scale", options);
    let measured_ns = options.amount(MEASURED_MS) as u64 * 1_000_000;
    let axes = axes();
    // The simulated rover costs more than the stages: what its sensors deliver is made before.
    let folder = tempfile::tempdir()?;
    let day = Day::new();
    std::fs::write(folder.path().join("wheel"), day.wheel.as_bytes())?;
    std::fs::write(folder.path().join("vibration"), day.vibration.as_bytes())?;
    drop(day);
    // A variant that stands in two tables is measured once.
    let mut all: Vec<Variant> = Vec::new();
    for (_, _, variant) in axes.iter().flat_map(|axis| &axis.variants) {
        if !all.contains(variant) {
            all.push(*variant);
        }
    }
    let mut rounds: Vec<Vec<Seen>> = all.iter().map(|_| Vec::new()).collect();
    for _ in 0..ROUNDS {
        for (variant, rounds) in all.iter().zip(&mut rounds) {
            rounds.push(measure(variant, folder.path(), measured_ns, &termination)?);
        }
    }
    for axis in &axes {
        let rounds_of = |variant: &Variant| {
            let index = all.iter().position(|other| other == variant);
            index.map_or(&[][..], |index| &rounds[index])
        };
        tell(&mut report, axis, rounds_of);
    }
    report.end()
}

/// Prints the tables of an axis.
fn tell<'a>(report: &mut Report, axis: &Axis, rounds_of: impl Fn(&Variant) -> &'a [Seen]) {
    let floor = &axis.variants[0].0;
    let series = |record: fn(&Seen, &mut Series)| {
        let of_variant = |(name, _, variant): &(String, f64, Variant)| {
            let mut series = Series::new(name).over(floor);
            for seen in rounds_of(variant) {
                series.begin_round();
                record(seen, &mut series);
            }
            series
        };
        axis.variants.iter().map(of_variant).collect::<Vec<_>>()
    };
    let cost = series(|seen, series| series.record(seen.cost_ns()));
    report.table(
        &format!("Processor time of all services a cycle: {}", axis.title),
        &cost,
    );
    let latency = series(|seen, series| seen.latency_ns.iter().for_each(|time_ns| series.record(*time_ns)));
    report.table(&format!("Frame to terrain: {}", axis.title), &latency);
    let fitted = |of: &str, value: fn(&Seen) -> f64| {
        let of_round = |round: usize| {
            let points = axis.variants.iter().filter_map(|(_, size, variant)| {
                let seen = rounds_of(variant).get(round)?;
                Some((*size, value(seen)))
            });
            exponent(&points.collect::<Vec<_>>())
        };
        let mut exponents: Vec<f64> = (0..ROUNDS).filter_map(of_round).collect();
        exponents.sort_by(f64::total_cmp);
        let words: Vec<String> = exponents.iter().map(|exponent| format!("{exponent:.2}")).collect();
        format!("{of} grows as {}^e, e = {} (by round)", axis.of, words.join(", "))
    };
    report.note(fitted("\nProcessor time a cycle", |seen| seen.cost_ns() as f64));
    report.note(fitted("Median latency", Seen::median_ns));
    for (name, _, variant) in &axis.variants {
        report.note(shares(name, rounds_of(variant)));
    }
}

/// Where the processor time of a variant goes, and what became of its cycles.
fn shares(name: &str, rounds: &[Seen]) -> String {
    let mut roles: BTreeMap<&str, f64> = BTreeMap::new();
    let (mut due, mut lost) = (0, 0);
    for seen in rounds {
        due += seen.due;
        lost += seen.lost;
        for (role, time_ns) in &seen.cpu_ns {
            *roles.entry(role).or_default() += *time_ns as f64 / seen.periods / rounds.len() as f64 / 1e3;
        }
    }
    let mut text = format!("{name}: {due} cycles, {lost} without a terrain; µs a cycle:");
    for (role, time_us) in roles {
        let _ = write!(text, " {role} {time_us:.0},");
    }
    text.trim_end_matches(',').to_owned() + "."
}

/// What a round of a variant has shown.
#[derive(Default)]
struct Seen {
    /// Time on a processor, by role.
    cpu_ns: BTreeMap<String, u64>,
    /// Frame periods in which that was.
    periods: f64,
    latency_ns: Vec<u64>,
    due: u64,
    lost: u64,
}

impl Seen {
    /// Time that the services of all wheels spend for a cycle.
    fn cost_ns(&self) -> u64 {
        let services = self.cpu_ns.iter().filter(|(role, _)| *role != LAUNCHER);
        (services.map(|(_, time_ns)| *time_ns as f64).sum::<f64>() / self.periods) as u64
    }

    fn median_ns(&self) -> f64 {
        let mut sorted = self.latency_ns.clone();
        sorted.sort_unstable();
        sorted.get(sorted.len() / 2).map_or(f64::NAN, |time_ns| *time_ns as f64)
    }
}

const LAUNCHER: &str = "launcher";

/// Runs a system of this size for a while.
fn measure(variant: &Variant, folder: &Path, measured_ns: u64, termination: &Termination) -> Outcome<Seen> {
    let system = Processes::start(&system_file(variant, folder)?, termination)?;
    let warm_up_s = (WARM_UP_FRAMES / variant.rate_hz).clamp(WARM_UP_MIN_S, WARM_UP_MAX_S);
    sleep_until(now_ns() + (warm_up_s * 1e9) as u64);
    let domain = system.enter()?;
    let wires = (0..variant.wheels).map(|wheel| Ends::open(&domain, wheel, variant));
    let mut wheels = wires.collect::<Outcome<Vec<_>>>()?;
    let (before, begun_ns) = (used(&system)?, now_ns());
    look_until(&mut wheels, begun_ns + measured_ns, termination)?;
    let (after, ended_ns) = (used(&system)?, now_ns());
    // Of the frames that were seen by now, the cycles are due.
    let frames: Vec<BTreeMap<u64, u64>> = wheels.iter().map(|wheel| wheel.frames_ns.clone()).collect();
    look_until(&mut wheels, ended_ns + DRAIN_NS, termination)?;
    let mut seen = Seen {
        periods: (ended_ns - begun_ns) as f64 / 1e9 * variant.rate_hz,
        ..Seen::default()
    };
    for ((role, before_ns), (_, after_ns)) in before.into_iter().zip(after) {
        *seen.cpu_ns.entry(role).or_default() += after_ns - before_ns;
    }
    for (frames, wheel) in frames.iter().zip(&wheels) {
        let (Some((first, _)), Some((last, _))) = (frames.first_key_value(), frames.last_key_value()) else {
            return Err("a source sends nothing".into());
        };
        let answered: BTreeSet<u64> = wheel.terrain_ns.range(first..=last).map(|(cycle, _)| *cycle).collect();
        seen.due += last - first + 1;
        seen.lost += last - first + 1 - answered.len() as u64;
        let ends = |(cycle, begin_ns): (&u64, &u64)| Some(wheel.terrain_ns.get(cycle)?.saturating_sub(*begin_ns));
        seen.latency_ns.extend(frames.iter().filter_map(ends));
    }
    drop((wheels, domain));
    system.end()?;
    Ok(seen)
}

/// The processor time of each process so far, by role, in the same order each time.
fn used(system: &Processes) -> Outcome<Vec<(String, u64)>> {
    let services = system.services().iter().map(|(name, pid)| (name.as_str(), *pid));
    let mut used = Vec::new();
    for (name, pid) in services.chain([(LAUNCHER, system.launcher())]) {
        let role = name.trim_end_matches(|end: char| end.is_ascii_digit());
        used.push((role.to_owned(), cpu_ns(pid)?));
    }
    Ok(used)
}

/// The two ends of one wheel's cycles.
struct Ends {
    frames: Tap<Frame>,
    terrain: Tap<Terrain>,
    /// The terrain's cycles that are this wheel's: the first of them, and how many lie between one and the next.
    cycles: (u64, u64),
    frames_ns: BTreeMap<u64, u64>,
    terrain_ns: BTreeMap<u64, u64>,
}

impl Ends {
    fn open(domain: &Domain, wheel: usize, variant: &Variant) -> Outcome<Self> {
        let (terrain, cycles) = if variant.together {
            (together::WIRE.to_owned(), (wheel as u64, variant.wheels as u64))
        } else {
            (format!("wheel{wheel}/terrain"), (0, 1))
        };
        Ok(Self {
            terrain: Tap::open(domain, &terrain)?,
            cycles,
            // Last: of every frame that is seen, what follows is seen too.
            frames: Tap::open(domain, &format!("wheel{wheel}/frames"))?,
            frames_ns: BTreeMap::new(),
            terrain_ns: BTreeMap::new(),
        })
    }
}

fn look_until(wheels: &mut [Ends], until_ns: u64, termination: &Termination) -> Outcome<()> {
    while now_ns() < until_ns {
        if termination.requested() {
            return Err("told to end".into());
        }
        for wheel in &mut *wheels {
            drain(&wheel.frames, (0, 1), &mut wheel.frames_ns)?;
            drain(&wheel.terrain, wheel.cycles, &mut wheel.terrain_ns)?;
        }
        sleep_until(now_ns() + LOOK_NS);
    }
    Ok(())
}

/// Notes when each sample that is there was published, of those that are this wheel's.
fn drain<T: Message>(tap: &Tap<T>, (first, apart): (u64, u64), seen: &mut BTreeMap<u64, u64>) -> Result<(), Error> {
    while let Some(Header {
        sequence, published_ns, ..
    }) = tap.poll(|sample| *sample.header())?
    {
        if sequence % apart == first {
            seen.insert(sequence / apart, published_ns);
        }
    }
    Ok(())
}

/// The rover of this size: for each wheel a source of frames, and all stages; what shakes the body is there once.
fn system_file(variant: &Variant, folder: &Path) -> Outcome<String> {
    let program = std::env::current_exe()?;
    let (width, height) = variant.size_px;
    let rate_hz = variant.rate_hz;
    let (readings, pieces) = (folder.join("wheel"), folder.join("vibration"));
    let mut text = format!("[system]\nname = \"bench{}\"\n", std::process::id());
    for n in 0..variant.wheels {
        write!(
            text,
            r#"
[service.source{n}]
exec = [{program:?}]
outputs = {{ frames = "wheel{n}/frames" }}
config = {{ rate_hz = {rate_hz:?}, width_px = {width}, height_px = {height} }}
[service.readings{n}]
exec = [{program:?}]
outputs = {{ wheel = "wheel{n}/wheel" }}
config = {{ file = {readings:?} }}
"#
        )?;
    }
    if variant.together {
        text += &together::table(variant.wheels)?;
    }
    for n in (0..variant.wheels).filter(|_| !variant.together) {
        write!(
            text,
            r#"
[service.sinkage{n}]
exec = ["terrasense-sinkage"]
inputs = {{ frames = "wheel{n}/frames" }}
outputs = {{ sinkage = "wheel{n}/sinkage" }}
[service.terramechanics{n}]
exec = ["terrasense-terramechanics"]
inputs = {{ sinkage = "wheel{n}/sinkage", wheel = "wheel{n}/wheel" }}
outputs = {{ soil = "wheel{n}/soil" }}
[service.terrain{n}]
exec = ["terrasense-terrain"]
inputs = {{ soil = "wheel{n}/soil", sinkage = "wheel{n}/sinkage", class = "body/class" }}
outputs = {{ terrain = "wheel{n}/terrain" }}
"#
        )?;
    }
    write!(
        text,
        r#"
[service.body]
exec = [{program:?}]
outputs = {{ vibration = "body/vibration" }}
config = {{ file = {pieces:?} }}
[service.vibration]
exec = ["terrasense-vibration"]
inputs = {{ vibration = "body/vibration" }}
outputs = {{ class = "body/class" }}
"#
    )?;
    Ok(text)
}
