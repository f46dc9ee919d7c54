//! The estimation cycle over what users would pick instead: the same pictures, the same wheel readings, the same stage libs
//! and the same stamps over each of them, against the same calls in one process.

use bench::compare::{Pace, Part, SPANS, Stamps, play};
use bench::{Options, Outcome, Report, ScratchSystem, Series};
use clap::Parser;
use processes::{Bench, Cpus, Load, Variant, WARM_UP, allowed_cpus, built, fifo_is_allowed};
use shell::Termination;
use std::path::PathBuf;
use std::process::ExitCode;

mod direct;
mod figure;
mod forms;
mod processes;
mod sockets;
mod terrasense;
mod textbook;

/// Cycles that count in a run.
const CYCLES: usize = 300;

#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
    /// Runs of each variant, by turns.
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    /// Cycles that count in a run.
    #[arg(long)]
    cycles: Option<u64>,
    /// When the next frame is sent.
    #[arg(long, value_enum, default_value_t = Paces::Both)]
    pace: Paces,
    /// Keeps every processor busy with other work.
    #[arg(long)]
    loaded: bool,
    /// Runs all processes of all variants under `SCHED_FIFO` with this priority.
    #[arg(long, value_name = "PRIORITY", value_parser = clap::value_parser!(u8).range(1..=99))]
    fifo: Option<u8>,
    /// Which processors the processes of every variant run on; otherwise Terrasense, or the kernel, decides.
    #[arg(long, value_enum)]
    cpus: Option<Cpus>,
    /// Nothing but these, and the direct calls.
    #[arg(long, value_enum, value_delimiter = ',')]
    only: Vec<Variant>,
    /// The program of `bench/peers/over_zenoh`, where it is not in `target/peers`.
    #[arg(long, value_name = "PROGRAM")]
    zenoh: Option<PathBuf>,
    /// The Python that has dora, where it is not `target/peers/dora/bin/python3`.
    #[arg(long, value_name = "PYTHON")]
    dora: Option<PathBuf>,
    /// Draws the whole cycle of every variant into this file.
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Paces {
    /// A frame each 33 ms.
    Paced,
    /// A frame once the terrain of the last one has come back.
    Fast,
    /// First the one, then the other.
    Both,
}

/// This program as one process of a variant.
#[derive(Parser)]
struct Child {
    #[arg(value_enum)]
    variant: Variant,
    /// Name in shared memory.
    #[arg(long, default_value = "")]
    system: String,
    #[command(flatten)]
    part: Part,
}

fn main() -> ExitCode {
    let first = std::env::args().nth(1).unwrap_or_default();
    let outcome = match first.as_str() {
        "spin" => loop {
            std::hint::spin_loop();
        },
        "child" => be_child(&Child::parse_from(std::env::args().skip(1))),
        _ if first.ends_with(".toml") => return terrasense::serve(),
        _ => compare(&Arguments::parse()),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("compare: {error}");
            ExitCode::FAILURE
        }
    }
}

fn be_child(child: &Child) -> Outcome<()> {
    let part = &child.part;
    match child.variant {
        Variant::Direct => direct::play(part),
        Variant::Sockets => play(part, &sockets::Sockets(part.folder.clone())),
        Variant::Iceoryx2 => play(part, &textbook::Textbook::enter(&ScratchSystem::named(&child.system)?)?),
        Variant::Terrasense | Variant::Unplaced | Variant::Zenoh | Variant::Dora => {
            Err("is run by another program".into())
        }
    }
}

fn compare(arguments: &Arguments) -> Outcome<()> {
    let mut report = Report::begin("compare", &arguments.options);
    let cycles = arguments.cycles.unwrap_or(arguments.options.amount(CYCLES) as u64);
    let mut bench = Bench::new(cycles, Termination::listen()?)?;
    let peers = bench::programs()?.join("../peers");
    let peer = |given: &Option<PathBuf>, path: &str| given.clone().or_else(|| built(&peers.join(path)));
    bench.zenoh = peer(&arguments.zenoh, "release/over_zenoh");
    let module = built(&peers.join("release/libover_dora.so"));
    bench.dora = peer(&arguments.dora, "dora/bin/python3").filter(|_| module.is_some() || arguments.dora.is_some());
    bench.cpus = arguments.cpus;
    bench.fifo = arguments.fifo.filter(|priority| fifo_is_allowed(*priority));
    let variants = variants(arguments, &bench);
    report.note(conditions(arguments, &bench, &variants));
    let load = arguments.loaded.then(Load::start).transpose()?;
    let mut figures = Vec::new();
    for (pace, title) in [(Pace::Paced, "at 30 Hz"), (Pace::Fast, "as fast as possible")] {
        if matches!(
            (arguments.pace, pace),
            (Paces::Paced, Pace::Fast) | (Paces::Fast, Pace::Paced)
        ) {
            continue;
        }
        let spans = measure(&bench, &variants, pace, arguments.rounds, &mut report)?;
        for ((name, ..), series) in SPANS.iter().zip(&spans) {
            report.table(&format!("{name}, {title}"), series);
        }
        let rounds: Vec<Series> = spans[0].iter().flat_map(Series::each_round).collect();
        report.table(&format!("{}, {title}, every run", SPANS[0].0), &rounds);
        report.note(format!(
            "\nBeyond the direct calls, {title}: median of the rounds, lowest–highest"
        ));
        for line in ratios(&spans[0]) {
            report.note(line);
        }
        figures.push((title.to_owned(), spans[0].clone()));
    }
    drop(load);
    if let Some(path) = &arguments.svg {
        std::fs::write(path, figure::draw(&figures)).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    report.end()
}

/// Those that are asked for and there: the direct calls first.
fn variants(arguments: &Arguments, bench: &Bench) -> Vec<Variant> {
    use Variant::{Direct, Dora, Iceoryx2, Sockets, Terrasense, Unplaced, Zenoh};
    let all = [Direct, Terrasense, Unplaced, Sockets, Iceoryx2, Zenoh, Dora];
    let wanted = |variant: &Variant| match (arguments.only.as_slice(), variant) {
        (_, Direct) => true,
        ([], Unplaced) => arguments.cpus.is_none(),
        ([], Zenoh) => bench.zenoh.is_some(),
        ([], Dora) => bench.dora.is_some(),
        (only, variant) => only.is_empty() || only.contains(variant),
    };
    all.into_iter().filter(wanted).collect()
}

/// What the figures were measured under.
fn conditions(arguments: &Arguments, bench: &Bench, variants: &[Variant]) -> String {
    let scheduling = match (arguments.fifo, bench.fifo) {
        (Some(_), Some(priority)) => format!("SCHED_FIFO {priority}"),
        (Some(priority), None) => format!("ordinary scheduling, for SCHED_FIFO {priority} is refused here"),
        (None, _) => "ordinary scheduling".into(),
    };
    let load = if arguments.loaded {
        format!("{} processes that spin", allowed_cpus().len())
    } else {
        "no load by the bench".into()
    };
    let place = match arguments.cpus {
        Some(Cpus::Together) => "all processes on one processor",
        Some(Cpus::Spread) => "each process on the next processor",
        None => "the kernel places the processes, but for Terrasense's own",
    };
    let mut text = format!(
        "{} rounds of {} cycles; before them {WARM_UP} of warm-up a run, not counted. {scheduling}; {load}; {place}.",
        arguments.rounds, bench.cycles
    );
    for (variant, how) in [
        (Variant::Zenoh, "bench/peers/over_zenoh"),
        (Variant::Dora, "bench/peers/over_dora"),
    ] {
        if !variants.contains(&variant) && arguments.only.is_empty() {
            text += &format!(" Without {}: see {how}.", variant.name());
        }
    }
    text
}

/// For each span the times of each variant. A run that fails is told of, and its cycles are lost.
fn measure(
    bench: &Bench,
    variants: &[Variant],
    pace: Pace,
    rounds: usize,
    report: &mut Report,
) -> Outcome<[Vec<Series>; 4]> {
    let begin = |variant: &Variant| match variant {
        Variant::Direct => Series::new(variant.name()),
        _ => Series::new(variant.name()).over(Variant::Direct.name()),
    };
    let mut spans: [Vec<Series>; 4] = std::array::from_fn(|_| variants.iter().map(begin).collect());
    for round in 0..rounds {
        for index in 0..variants.len() {
            // Each round begins with another one.
            let index = (index + round) % variants.len();
            let variant = variants[index];
            let stamps = bench.run(variant, pace);
            if bench.termination.requested() {
                return Err("told to end".into());
            }
            if let Err(error) = &stamps {
                report.note(format!("{}, round {}, failed: {error}", variant.name(), round + 1));
            }
            take_in(&mut spans, index, &stamps.unwrap_or_default(), bench.cycles);
        }
        eprintln!("compare, {}: round {} of {rounds}", pace.name(), round + 1);
    }
    Ok(spans)
}

fn take_in(spans: &mut [Vec<Series>; 4], index: usize, stamps: &Stamps, cycles: u64) {
    for ((_, from, to), series) in SPANS.iter().zip(spans.iter_mut()) {
        series[index].begin_round();
        stamps
            .times_ns(*from, *to)
            .for_each(|time_ns| series[index].record(time_ns));
    }
    let unsent = cycles.saturating_sub(stamps.cycles() as u64);
    spans[0][index].lose(unsent + stamps.lost() as u64);
}

/// (variant - floor) / (other - floor), round by round.
fn ratios(series: &[Series]) -> Vec<String> {
    let Some((floor, others)) = series.split_first() else {
        return Vec::new();
    };
    let floor = floor.p50_of_rounds_us();
    let beyond = |series: &Series| -> Vec<Option<f64>> {
        let rounds = series.p50_of_rounds_us().into_iter().zip(&floor);
        rounds.map(|(above, floor)| Some(above? - (*floor)?)).collect()
    };
    let mut lines = Vec::new();
    for ours in others {
        for theirs in others.iter().filter(|theirs| theirs.name() != ours.name()) {
            let pairs = beyond(ours).into_iter().zip(beyond(theirs));
            let mut ratios: Vec<f64> = pairs.filter_map(|(ours, theirs)| Some(ours? / theirs?)).collect();
            ratios.sort_by(f64::total_cmp);
            let (Some(low), Some(high)) = (ratios.first(), ratios.last()) else {
                continue;
            };
            lines.push(format!(
                "- {} to {}: {:.2} ({low:.2}–{high:.2})",
                ours.name(),
                theirs.name(),
                f64::midpoint(ratios[(ratios.len() - 1) / 2], ratios[ratios.len() / 2])
            ));
        }
    }
    lines
}
