//! `terrasense conformance`: drives any program through the replacement contract, and says which of its rules hold.

mod play;
mod rules;
mod stand;
mod trial;

use crate::commands::{find, listen};
use clap::{Args, ValueEnum};
use messages::{Frame, Sinkage, Soil, Terrain, TerrainClass, Vibration};
use rules::{Finding, RULES};
use serde_json::json;
use shell::{Error, Port, SystemFile};
use stand::Stand;
use std::path::Path;
use std::process::ExitCode;
use trial::{Evidence, Trial};

/// `terrasense conformance`
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ConformanceArguments {
    /// The stage whose place the program takes.
    #[arg(value_name = "STAGE")]
    stage: Stage,
    /// The stage's configuration, as the system file has it; see the examples.
    #[arg(long, value_name = "TOML", conflicts_with = "system")]
    config: Option<String>,
    /// A system file that has the stage, with its configuration.
    #[arg(long, value_name = "ROVER.TOML")]
    system: Option<String>,
    /// Time to open all wires, from the start of the process [ms].
    #[arg(long, value_name = "MS", default_value_t = 5000, value_parser = clap::value_parser!(u64).range(1..=600_000))]
    start_timeout_ms: u64,
    /// Cycles over which memory and latency are looked at.
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u64).range(10..=1_000_000))]
    cycles: u64,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// The program and its first arguments, as in `exec`; the system file and the service's name follow.
    #[arg(last = true, required = true, value_name = "PROGRAM")]
    program: Vec<String>,
}

const EXAMPLES: &str = "It makes a system of its own, which nothing else sees and of which nothing is left, plays a simulated \
rover's samples on the stage's input wires, bad ones too, and looks at what the program answers. The contract is in the README, \
\"Replacing a service\".

Examples:
  terrasense conformance sinkage -- terrasense-sinkage
  terrasense conformance sinkage --config 'radius_m = 0.2' -- python3 tests/peers/sinkage.py

Exit codes: 0 every rule holds, 1 some do not, 64 usage, 78 configuration.";

/// A stage of the graph: what triggers it, what it takes in beside that, what it answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Stage {
    /// Frames in, sinkage out.
    Sinkage,
    /// Sinkage and wheel readings in, soil out.
    Terramechanics,
    /// Pieces of vibration in, the terrain's class out.
    Vibration,
    /// Soil, sinkage and class in, terrain out.
    Terrain,
}

impl Stage {
    /// The port whose samples trigger the stage.
    pub const fn trigger(self) -> Port {
        match self {
            Self::Sinkage => Port::Frames,
            Self::Terramechanics => Port::Sinkage,
            Self::Vibration => Port::Vibration,
            Self::Terrain => Port::Soil,
        }
    }

    /// The ports that it takes in when it is triggered.
    pub const fn observed(self) -> &'static [Port] {
        match self {
            Self::Sinkage | Self::Vibration => &[],
            Self::Terramechanics => &[Port::Wheel],
            Self::Terrain => &[Port::Sinkage, Port::Class],
        }
    }

    /// The port of its answers.
    pub const fn answers(self) -> Port {
        match self {
            Self::Sinkage => Port::Sinkage,
            Self::Terramechanics => Port::Soil,
            Self::Vibration => Port::Class,
            Self::Terrain => Port::Terrain,
        }
    }

    /// Its usual name in a system file.
    fn name(self) -> &'static str {
        match self {
            Self::Sinkage => "sinkage",
            Self::Terramechanics => "terramechanics",
            Self::Vibration => "vibration",
            Self::Terrain => "terrain",
        }
    }
}

/// Tries a program, and prints which rules hold.
pub fn run(arguments: &ConformanceArguments) -> Result<ExitCode, Error> {
    let stage = arguments.stage;
    let (program, rest) = arguments
        .program
        .split_first()
        .unwrap_or_else(|| unreachable!("it is required"));
    let Some(path) = find(program, Some(Path::new(""))) else {
        return Err(Error::usage(format!(
            "executable `{program}` is neither beside `terrasense` nor on PATH; write its path"
        )));
    };
    let config = config(arguments)?;
    let termination = listen()?;
    let stand = Stand::new(stage, (path, rest), &config, arguments.start_timeout_ms, termination)?;
    let evidence = match stage {
        Stage::Sinkage => Trial::<Frame, Sinkage>::run(&stand, arguments.cycles),
        Stage::Terramechanics => Trial::<Sinkage, Soil>::run(&stand, arguments.cycles),
        Stage::Vibration => Trial::<Vibration, TerrainClass>::run(&stand, arguments.cycles),
        Stage::Terrain => Trial::<Soil, Terrain>::run(&stand, arguments.cycles),
    }?;
    drop(stand);
    let findings: Vec<Finding> = RULES.iter().map(|rule| rule.judge(&evidence)).collect();
    if arguments.json {
        println!("{}", as_json(arguments, &findings, &evidence)?);
    } else {
        print_table(&findings, &evidence);
    }
    let conforms = findings.iter().all(|finding| finding.holds);
    Ok(if conforms { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// The stage's configuration as the text of a TOML table.
fn config(arguments: &ConformanceArguments) -> Result<String, Error> {
    let stage = arguments.stage;
    if let Some(path) = &arguments.system {
        let file = SystemFile::read(path)?;
        let writes = |table: &shell::ServiceTable| table.outputs.contains_key(stage.answers().name());
        let Some((_, table)) = file.services.iter().find(|(_, table)| writes(table)) else {
            return Err(Error::config(format!(
                "{path}:1: no service has an output `{}`: nothing is said of {}",
                stage.answers().name(),
                stage.name()
            )));
        };
        let config = table.config.as_ref().map(toml::Spanned::get_ref);
        return Ok(config.map(ToString::to_string).unwrap_or_default());
    }
    let text = arguments.config.as_deref().unwrap_or_default().trim();
    let text = text
        .strip_prefix('{')
        .and_then(|text| text.strip_suffix('}'))
        .unwrap_or(text);
    let table = format!("config = {{ {text} }}");
    toml::from_str::<toml::Table>(&table).map_err(|error| {
        Error::config(format!(
            "--config: {}; write e.g. --config 'radius_m = 0.2'",
            error.message()
        ))
    })?;
    Ok(format!("{{ {text} }}"))
}

fn print_table(findings: &[Finding], evidence: &Evidence) {
    for finding in findings {
        let mark = if finding.holds { "holds" } else { "FAILS" };
        println!("{mark}  {:<13} {:<68} {}", finding.rule, finding.promise, finding.seen);
    }
    let failed = findings.iter().filter(|finding| !finding.holds).count();
    if let Some((p50_us, p99_us)) = evidence.latency_us() {
        println!(
            "\nlatency, from the trigger to the answer: {p50_us:.0} µs (median), {p99_us:.0} µs (99 %); not judged"
        );
    }
    let statuses = evidence.statuses();
    let statuses: Vec<String> = statuses.iter().map(|(word, count)| format!("{count} {word}")).collect();
    if !statuses.is_empty() {
        println!("statuses of the answers: {}; not judged", statuses.join(", "));
    }
    match failed {
        0 => println!("all {} rules hold", findings.len()),
        _ => println!(
            "{failed} of {} rules do not hold; README, \"Replacing a service\", has the contract",
            findings.len()
        ),
    }
    if failed > 0 && !evidence.said.is_empty() {
        println!("\nthe program's last words:\n{}", evidence.said);
    }
}

fn as_json(arguments: &ConformanceArguments, findings: &[Finding], evidence: &Evidence) -> Result<String, Error> {
    let (p50_us, p99_us) = evidence.latency_us().unzip();
    let rules: Vec<_> = findings
        .iter()
        .map(|finding| {
            json!({
                "rule": finding.rule,
                "promise": finding.promise,
                "holds": finding.holds,
                "seen": finding.seen,
            })
        })
        .collect();
    serde_json::to_string_pretty(&json!({
        "stage": arguments.stage.name(),
        "program": arguments.program,
        "conforms": findings.iter().all(|finding| finding.holds),
        "rules": rules,
        "statuses": evidence.statuses(),
        "latency_p50_us": p50_us,
        "latency_p99_us": p99_us,
    }))
    .map_err(|error| Error::internal(error.to_string()))
}
