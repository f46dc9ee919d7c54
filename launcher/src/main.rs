//! The `terrasense` command.

mod annotate;
mod commands;
mod conformance;
mod control;
mod deadline;
mod demo;
mod doctor;
mod figures;
mod overlay;
mod perspective;
mod placement;
mod plots;
mod policy;
mod privacy;
mod process;
mod record;
mod rehearsal;
mod replay;
mod root;
mod simulate;
mod status;
mod supervisor;
mod swap;
mod system;
mod vibration;
mod watch;

use clap::{CommandFactory, Parser, Subcommand};
use shell::Error;
use std::process::ExitCode;

/// Terrain analysis for planetary rovers: what ground the rover drives on, from what its wheel shows, feels and sounds like.
///
/// Separate processes exchange fixed-layout samples over shared memory; this command starts, watches and restarts them.
#[derive(Debug, Parser)]
#[command(name = "terrasense", version, after_help = EXIT_CODES)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

const EXIT_CODES: &str = "Exit codes: 0 success, 1 a check found something, 64 usage, 65 input data, 69 not running or in \
                          the way, 70 internal, 78 configuration.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Runs the whole system on a simulated rover for a while, in a live table against the truth.
    Demo(demo::DemoArguments),
    /// Runs a system until it is told to end (SIGTERM, SIGINT).
    Up(commands::UpArguments),
    /// Runs the system over a recorded traverse, without loss, and writes one CSV a wire. Two replays give the same bytes.
    Replay(replay::ReplayArguments),
    /// Finds the wheel in a folder of one's own pictures and writes their frames.csv, with overlays to check.
    Annotate(annotate::AnnotateArguments),
    /// Writes a traverse folder of the simulated rover, with the truth beside it.
    Simulate(simulate::SimulateArguments),
    /// Trains and tries the terrain classifier on recordings of one's own vehicle.
    #[command(subcommand)]
    Vibration(vibration::VibrationCommand),
    /// Shows how a running system is doing.
    Status(status::StatusArguments),
    /// Replaces a stage of a running system by another program, without losing a cycle.
    Swap(swap::SwapArguments),
    /// Brings a running system to an edited system file, stage by stage, without losing a cycle.
    Apply(swap::ApplyArguments),
    /// Checks a system file without starting anything.
    Validate(commands::ValidateArguments),
    /// Tries any program in the place of a stage: which rules of the replacement contract hold.
    Conformance(conformance::ConformanceArguments),
    /// Prints the built-in system file, to start one's own from.
    DefaultSystem,
    /// Checks the machine: shared memory, limits, programs, leftovers.
    Doctor(doctor::DoctorArguments),
    /// Removes what killed launchers left in shared memory. Running systems are not touched.
    Clean(doctor::CleanArguments),
    /// Prints a completion script for a shell.
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 64 } else { 0 });
        }
    };
    match run(arguments.command) {
        Ok(code) => code,
        Err(error) => error.exit("terrasense"),
    }
}

fn run(command: Command) -> Result<ExitCode, Error> {
    match command {
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Up(arguments) => commands::up(&arguments),
        Command::Replay(arguments) => replay::run(&arguments),
        Command::Annotate(arguments) => annotate::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Vibration(command) => vibration::run(&command),
        Command::Status(arguments) => status::run(&arguments),
        Command::Swap(arguments) => swap::swap(&arguments),
        Command::Apply(arguments) => swap::apply(&arguments),
        Command::Validate(arguments) => commands::validate(&arguments),
        Command::Conformance(arguments) => conformance::run(&arguments),
        Command::DefaultSystem => {
            print!("{}", commands::DEFAULT_SYSTEM);
            Ok(ExitCode::SUCCESS)
        }
        Command::Doctor(arguments) => doctor::run(&arguments),
        Command::Clean(arguments) => doctor::clean(&arguments),
        Command::Completions { shell } => {
            clap_complete::generate(shell, &mut Arguments::command(), "terrasense", &mut std::io::stdout());
            Ok(ExitCode::SUCCESS)
        }
    }
}
