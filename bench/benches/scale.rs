//! What more wheels, more frames and larger frames cost: processor time of the services and latency of the cycle, with the
//! growth fitted to them.

use bench::{Day, Options, Outcome, Processes, Report, Series, cpu_ns, exponent};
use clap::Parser;
use messages::{Frame, Header, Message, Status, Terrain, Vibration, Wheel};
use serde::Deserialize;
use shell::{Domain, Error, Shell, Tap, Termination, now_ns, sleep_until};
use simulation::Rover;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;
use zerocopy::{FromZeros, IntoBytes};

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
/// Pictures that a source has, made beforehand, from all over the route.
const PICTURES: usize = 64;
/// Between two readings of the wheel, and between two pieces of vibration [ns].
const READING_NS: u64 = 10_000_000;
const PIECE_NS: u64 = 100_000_000;

const WHEELS: [usize; 4] = [1, 2, 4, 6];
const RATES_HZ: [f64; 6] = [10.0, 30.0, 100.0, 200.0, 500.0, 1000.0];
const SIZES_PX: [(u32, u32); 4] = [(640, 480), (800, 600), (1024, 768), (1024, 1024)];
const USUAL: Variant = Variant {
    wheels: 1,
    rate_hz: 30.0,
    size_px: SIZES_PX[0],
};

#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
}

fn main() -> ExitCode {
    // The launcher starts this program as a source.
    if std::env::args().any(|argument| argument.ends_with(".toml")) {
        return shell::main(source);
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
}

/// What is varied in a table: its name, the name of each variant, and how large it is.
struct Axis {
    title: &'static str,
    of: &'static str,
    variants: Vec<(String, f64, Variant)>,
}

fn axes() -> [Axis; 3] {
    let wheels = WHEELS.map(|wheels| {
        let name = format!("{wheels} wheel{}", if wheels == 1 { "" } else { "s" });
        (name, wheels as f64, Variant { wheels, ..USUAL })
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
    let wires = (0..variant.wheels).map(|wheel| Ends::open(&domain, wheel));
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
    frames_ns: BTreeMap<u64, u64>,
    terrain_ns: BTreeMap<u64, u64>,
}

impl Ends {
    fn open(domain: &Domain, wheel: usize) -> Outcome<Self> {
        Ok(Self {
            terrain: Tap::open(domain, &format!("wheel{wheel}/terrain"))?,
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
            drain(&wheel.frames, &mut wheel.frames_ns)?;
            drain(&wheel.terrain, &mut wheel.terrain_ns)?;
        }
        sleep_until(now_ns() + LOOK_NS);
    }
    Ok(())
}

/// Notes when each sample that is there was published.
fn drain<T: Message>(tap: &Tap<T>, seen: &mut BTreeMap<u64, u64>) -> Result<(), Error> {
    while let Some(header) = tap.poll(|sample| *sample.header())? {
        seen.insert(header.sequence, header.published_ns);
    }
    Ok(())
}

/// The rover of this size: for each wheel a source of frames and all stages; what shakes the body is there once.
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

/// What a source is told.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Pictures {
    rate_hz: f64,
    width_px: u32,
    height_px: u32,
}

/// The same, of one that plays samples.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Samples {
    file: String,
}

/// A source whose samples have been made before: what it costs is that they are handed over.
fn source(shell: &mut Shell) -> Result<(), Error> {
    if shell.writes("frames") {
        return camera(shell);
    }
    let samples: Samples = shell.config(|_| Ok(()))?;
    if shell.writes("wheel") {
        return play::<Wheel>(shell, "wheel", &samples.file, READING_NS, |_, _| ());
    }
    play::<Vibration>(shell, "vibration", &samples.file, PIECE_NS, |piece, later_ns| {
        piece.start_ns = piece.start_ns.wrapping_add(later_ns);
    })
}

/// Sends the samples of a file one after the other, and again; `move_later` does so with instants beyond the header's.
fn play<T: Message + Clone>(
    shell: &mut Shell,
    port: &str,
    file: &str,
    period_ns: u64,
    move_later: fn(&mut T, u64),
) -> Result<(), Error> {
    let output = shell.output::<T>(port)?;
    let bytes = shell.read(file)?;
    let samples = bytes.chunks_exact(size_of::<T>()).map(T::read_from_bytes);
    let samples: Vec<T> = samples.collect::<Result<_, _>>().map_err(|_| Error::data(file))?;
    shell.on_tick(period_ns, |number, instant_ns| {
        let mut sample = samples[number as usize % samples.len()].clone();
        let later_ns = instant_ns.wrapping_sub(sample.header().taken_ns);
        move_later(&mut sample, later_ns);
        (sample.header_mut().taken_ns, sample.header_mut().sequence) = (instant_ns, number);
        output.send(sample)
    })
}

/// Sends pictures of the route over and over.
fn camera(shell: &mut Shell) -> Result<(), Error> {
    let config: Pictures = shell.config(|_| Ok(()))?;
    let frames = shell.output::<Frame>("frames")?;
    let about = simulation::Config {
        picture_width_px: config.width_px,
        picture_height_px: config.height_px,
        ..simulation::Config::default()
    };
    let route_ns = about.route_s * 1e9;
    let rover = Rover::new(about);
    let mut pictures = Vec::with_capacity(PICTURES);
    for index in 0..PICTURES {
        let mut picture = Frame::new_box_zeroed().map_err(|_| Error::internal("no memory for a picture"))?;
        rover.render(route_ns * 1e-9 * index as f64 / PICTURES as f64, &mut picture);
        pictures.push(picture);
    }
    let period_ns = (1e9 / config.rate_hz).round() as u64;
    shell.on_tick(period_ns, |number, instant_ns| {
        let share = ((number * period_ns) as f64 % route_ns) / route_ns;
        let picture = &pictures[(share * PICTURES as f64) as usize % PICTURES];
        frames.send_with(|frame| {
            copy(picture, frame);
            frame.header = Header {
                taken_ns: instant_ns,
                sequence: number,
                status: Status::OK,
                ..Header::default()
            };
            Ok(())
        })
    })
}

/// Copies what has a meaning.
fn copy(picture: &Frame, frame: &mut Frame) {
    (frame.width, frame.height) = (picture.width, picture.height);
    (frame.crop_x_px, frame.crop_y_px) = (picture.crop_x_px, picture.crop_y_px);
    (frame.center_x_px, frame.center_y_px) = (picture.center_x_px, picture.center_y_px);
    (frame.rim_radius_px, frame.wheel_radius_px) = (picture.rim_radius_px, picture.wheel_radius_px);
    frame.pitch_rad = picture.pitch_rad;
    frame.homography = picture.homography;
    let image = picture.image();
    frame.pixels[..image.len()].copy_from_slice(image);
}
