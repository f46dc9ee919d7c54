//! Kills, hangs and swaps at random instants, and a table of what became of each cycle.

use bench::chaos::{Fault, Plan, run};
use bench::{Options, Outcome, Report};
use clap::Parser;
use shell::Termination;

#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
    /// Faults at each rate.
    #[arg(long, default_value_t = 100)]
    faults: usize,
    /// Frames per second; may be given more than once.
    #[arg(long, default_values_t = [30])]
    rate_hz: Vec<u32>,
    /// Decides what happens to whom and when.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Nothing but this fault; may be given more than once.
    #[arg(long, value_enum)]
    only: Vec<Fault>,
}

fn main() -> Outcome<()> {
    let arguments = Arguments::parse();
    let termination = Termination::listen()?;
    let mut report = Report::begin("chaos", &arguments.options);
    for rate_hz in &arguments.rate_hz {
        let faults = arguments.options.amount(arguments.faults);
        let plan = Plan {
            programs: bench::programs()?,
            seed: arguments.seed,
            faults,
            rate_hz: *rate_hz,
            kinds: match arguments.only.as_slice() {
                [] => Fault::ALL.to_vec(),
                only => only.to_vec(),
            },
        };
        let verdict = run(&plan, &termination, |number| {
            if number % 50 == 0 {
                eprintln!("chaos at {rate_hz} Hz: {number} of {faults}");
            }
        })?;
        report.note(format!(
            "\n## {rate_hz} Hz, {faults} faults, seed {}\n\n{}",
            plan.seed,
            verdict.table()
        ));
    }
    report.end()
}
