//! `swap` and `apply`: another program, or another configuration, for a stage of a system that runs.

use crate::commands::{self, check_configs, find};
use crate::control::{Rehearsed, Reply, SwapRequest, ask};
use crate::root;
use crate::system::System;
use clap::Args;
use serde_json::json;
use shell::{Error, ServiceTable, SystemFile};
use std::path::Path;
use std::process::ExitCode;

/// `terrasense swap`
#[derive(Debug, Args)]
#[command(
    after_help = "The replacement is started beside the running service, on the same inputs, and its answers are compared \
    with the service's over some cycles. Then it takes over, with a certain cycle: none is lost, none comes twice, and \
    the old process ends. Where that is refused, the old one goes on and has noticed nothing.\n\n\
    Example: terrasense swap sinkage -- python3 my_sinkage.py"
)]
pub struct SwapArguments {
    /// The stage: sinkage, terramechanics, vibration, terrain, by its name in the system file.
    service: String,
    #[command(flatten)]
    trial: Trial,
    /// The system's name.
    #[arg(long, default_value = "rover")]
    name: String,
    /// The new program and its arguments; the system file and the service's name follow when it is started.
    #[arg(last = true, required = true, value_name = "PROGRAM")]
    exec: Vec<String>,
}

/// `terrasense apply`
#[derive(Debug, Args)]
#[command(
    after_help = "Every stage whose `exec` or `config` differs from what runs is swapped as by `terrasense swap`, one \
    after the other. Wires, sources and the number of services cannot change while the system runs."
)]
pub struct ApplyArguments {
    /// The edited system file. Its name says which system is meant.
    #[arg(value_name = "ROVER.TOML")]
    system: String,
    #[command(flatten)]
    trial: Trial,
}

/// How a candidate is tried.
#[derive(Clone, Debug, Args)]
struct Trial {
    /// Cycles to compare.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    cycles: u64,
    /// Stop after the comparison: the old one stays.
    #[arg(long)]
    dry_run: bool,
    /// Refuse where a field of the answers differs by more (root mean square), e.g. `entry_rad=0.05`.
    #[arg(long, value_name = "FIELD=LARGEST", value_parser = requirement)]
    require: Vec<(String, f64)>,
    /// If the new one dies within this time [s], the old one is started again.
    #[arg(long, default_value_t = 10.0, value_name = "SECONDS", value_parser = seconds)]
    probation_s: f64,
    /// Print JSON, a line a report.
    #[arg(long)]
    json: bool,
}

fn requirement(text: &str) -> Result<(String, f64), String> {
    let (field, largest) = text.split_once('=').ok_or("must be a field, =, and a number")?;
    match largest.parse() {
        Ok(largest) if largest >= 0.0 => Ok((field.to_owned(), largest)),
        _ => Err(format!("`{largest}` is no number from 0 on")),
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.0..=86_400.0).contains(&seconds) => Ok(seconds),
        _ => Err("must be a number of seconds from 0 to 86400".into()),
    }
}

/// Swaps one stage.
pub fn swap(arguments: &SwapArguments) -> Result<ExitCode, Error> {
    let request = SwapRequest {
        service: arguments.service.clone(),
        exec: from_here(&arguments.exec)?,
        config: None,
        cycles: arguments.trial.cycles,
        dry_run: arguments.trial.dry_run,
        probation_ms: (arguments.trial.probation_s * 1000.0) as u64,
        require: arguments.trial.require.clone(),
    };
    carry_out(&arguments.name, &request, arguments.trial.json)
}

/// Swaps every stage that an edited system file changes.
pub fn apply(arguments: &ApplyArguments) -> Result<ExitCode, Error> {
    let wanted = commands::load(Some(&arguments.system))?;
    check_configs(&wanted, Some(&arguments.system))?;
    let name = wanted.file.system.name.get_ref();
    if !root::stands(name) {
        return Err(Error::unavailable(format!(
            "no system `{name}` runs; start it with `terrasense up {}`",
            arguments.system
        )));
    }
    let running = SystemFile::read(&format!("/dev/shm/terrasense-{name}/system.toml"))?;
    let folder = Path::new(&arguments.system).parent();
    let changed = changes(&wanted, &running, folder)?;
    if changed.is_empty() {
        println!("{}: nothing differs from what runs", arguments.system);
    }
    for service in changed {
        let table = &wanted.file.services[service];
        let mut exec = table.exec.get_ref().clone();
        exec[0] = wanted.programs[service].display().to_string();
        let request = SwapRequest {
            service: service.to_owned(),
            exec,
            config: Some(config_of(table)),
            cycles: arguments.trial.cycles,
            dry_run: arguments.trial.dry_run,
            probation_ms: (arguments.trial.probation_s * 1000.0) as u64,
            require: arguments.trial.require.clone(),
        };
        let code = carry_out(name, &request, arguments.trial.json)?;
        if code != ExitCode::SUCCESS {
            return Ok(code);
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The stages whose program or configuration differs.
fn changes<'a>(wanted: &'a System, running: &SystemFile, folder: Option<&Path>) -> Result<Vec<&'a str>, Error> {
    let fixed = |file: &SystemFile| {
        let wires = |table: &ServiceTable| {
            let all = table.inputs.iter().chain(&table.outputs);
            all.map(|(port, wire)| (port.clone(), wire.get_ref().clone()))
                .collect::<Vec<_>>()
        };
        let services = file.services.iter();
        services
            .map(|(name, table)| (name.clone(), wires(table)))
            .collect::<Vec<_>>()
    };
    if fixed(&wanted.file) != fixed(running) {
        return Err(Error::usage(format!(
            "{}: services and wires cannot change while the system runs; restart it: terrasense up {0}",
            wanted.file.path
        )));
    }
    let differs = |name: &&String| {
        let (new, old) = (&wanted.file.services[*name], &running.services[*name]);
        let program = find(&old.exec.get_ref()[0], folder);
        let same_program = program.as_ref() == Some(&wanted.programs[*name]);
        !same_program || new.exec.get_ref()[1..] != old.exec.get_ref()[1..] || config_of(new) != config_of(old)
    };
    Ok(wanted.order.iter().filter(differs).map(String::as_str).collect())
}

fn config_of(table: &ServiceTable) -> String {
    let config = table.config.as_ref().map(|config| toml::to_string(config.get_ref()));
    config.and_then(Result::ok).unwrap_or_default()
}

/// Program and files as seen from here: the launcher may have been started elsewhere.
fn from_here(exec: &[String]) -> Result<Vec<String>, Error> {
    let mut seen = Vec::new();
    for (index, word) in exec.iter().enumerate() {
        let is_path = if index == 0 {
            word.contains('/')
        } else {
            Path::new(word).is_file()
        };
        seen.push(if is_path {
            commands::absolute(word)?
        } else {
            word.clone()
        });
    }
    if find(&seen[0], None).is_none() {
        return Err(Error::usage(format!(
            "cannot find the program `{}`; name it by its path",
            seen[0]
        )));
    }
    Ok(seen)
}

/// Asks the launcher, and tells what it says: 0 promoted or, if so asked, compared; 1 refused.
fn carry_out(name: &str, request: &SwapRequest, as_json: bool) -> Result<ExitCode, Error> {
    let mut refused = false;
    ask(name, request, |reply| {
        if as_json {
            println!("{}", json!(reply));
        }
        match reply {
            Reply::Refused(why) => {
                refused = true;
                shell::tell(format_args!("{}: refused: {why}; the old one goes on", request.service));
            }
            _ if as_json => {}
            Reply::Progress(text) => shell::tell(format_args!("{}: {text}", request.service)),
            Reply::Rehearsed(rehearsed) => println!("{}", table(&rehearsed)),
            Reply::Promoted(sequence) => println!("{}: the new one answers from cycle {sequence} on", request.service),
            Reply::Stays => println!("{}: a rehearsal only; the old one stays", request.service),
        }
    })?;
    Ok(ExitCode::from(u8::from(refused)))
}

fn table(rehearsed: &Rehearsed) -> String {
    let counts = &rehearsed.counts;
    let mut text = format!(
        "{:<36} {:>13} {:>13} {:>13} {:>13}",
        rehearsed.service, "old", "new", "RMS differ.", "largest"
    );
    for (name, difference) in rehearsed.fields.iter().filter(|(_, difference)| difference.cycles > 0) {
        text += &format!(
            "\n{name:<36} {:>13.5} {:>13.5} {:>13.5} {:>13.5}",
            difference.incumbent_mean, difference.candidate_mean, difference.rms, difference.largest
        );
    }
    let [old, new] = [rehearsed.incumbent_latency_us, rehearsed.candidate_latency_us];
    text += &format!("\n{:<36} {:>13.0} {:>13.0}", "latency p50 [µs]", old[0], new[0]);
    text += &format!("\n{:<36} {:>13.0} {:>13.0}", "latency p99 [µs]", old[1], new[1]);
    text += &format!(
        "\n{} cycles compared, the same status in {}; {} left out, {} out of order",
        counts.cycles, counts.same_status, counts.missed, counts.unordered
    );
    text
}
