//! `status`: how a running system is doing.

use crate::commands::listen;
use crate::placement::Placement;
use crate::root;
use clap::Args;
use messages::{Message, SERVICES_MAX, ServiceState, Supervision, label_text};
use serde::Serialize;
use shell::{Domain, Error, SUPERVISION_WIRE, SystemFile, Tap, now_ns};
use std::process::ExitCode;

/// The longest wait for the launcher's table [ns]; it comes every 200 ms.
const WAIT_MAX_NS: u64 = 2_000_000_000;

/// `terrasense status`
#[derive(Debug, Args)]
pub struct StatusArguments {
    /// The system's name.
    #[arg(long, default_value = "rover")]
    name: String,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Go on until told to end, a table a second.
    #[arg(long)]
    watch: bool,
}

/// A row of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The service's name.
    pub service: String,
    /// Its process number, 0 where none runs.
    pub pid: u32,
    /// What it is doing.
    pub state: String,
    /// Restarts so far.
    pub restarts: u32,
    /// Samples a second, over all its outputs.
    pub rate_hz: f64,
    /// Samples published so far.
    pub published: u64,
    /// Cycles missing in its outputs.
    pub lost: u64,
    /// Answers to inputs that could not be used.
    pub rejected: u64,
    /// Cycles that were later than the system's `cycle_deadline_ms` with an answer of this service, and not before.
    pub missed: u64,
    /// From the triggering sample to the answer, median [µs]; 0 for a source.
    pub latency_p50_us: f64,
    /// The same, 99th percentile [µs].
    pub latency_p99_us: f64,
    /// Where and how it runs; `null` where it does not.
    pub placement: Option<Placement>,
}

/// Prints the table of a running system.
pub fn run(arguments: &StatusArguments) -> Result<ExitCode, Error> {
    let not_running = || {
        Error::unavailable(format!(
            "no system `{0}` runs; start it with `terrasense up` (names: --name)",
            arguments.name
        ))
    };
    if !root::stands(&arguments.name) {
        return Err(not_running());
    }
    let text = format!("[system]\nname = {:?}\n", arguments.name);
    let system = SystemFile::parse("--name", &text)?;
    let termination = listen()?;
    let domain = Domain::enter(&system, "status")?;
    let tap = Tap::<Supervision>::open(&domain, SUPERVISION_WIRE)?;
    loop {
        let until_ns = now_ns() + if arguments.watch { 1_000_000_000 } else { WAIT_MAX_NS };
        let mut latest = None;
        while now_ns() < until_ns && !termination.requested() && (arguments.watch || latest.is_none()) {
            tap.wait()?;
            while let Some(Ok(table)) = tap.poll(|table| table.check().map(|()| rows(table)))? {
                latest = Some(table);
            }
        }
        match latest {
            Some(rows) if arguments.json => println!("{}", json(&rows)?),
            Some(rows) => println!("{}", table(&rows)),
            None if termination.requested() => return Ok(ExitCode::SUCCESS),
            None => return Err(not_running()),
        }
        if !arguments.watch || termination.requested() {
            return Ok(ExitCode::SUCCESS);
        }
    }
}

/// The rows of a supervision sample.
#[must_use]
pub fn rows(table: &Supervision) -> Vec<Row> {
    let count = (table.service_count as usize).min(SERVICES_MAX);
    let row = |index: usize| Row {
        service: label_text(&table.name[index]).to_owned(),
        pid: table.pid[index],
        state: ServiceState(table.state[index]).word().unwrap_or("unknown").to_owned(),
        restarts: table.restarts[index],
        rate_hz: table.rate_hz[index],
        published: table.published[index],
        lost: table.lost[index],
        rejected: table.bad[index],
        missed: table.missed[index],
        latency_p50_us: table.latency_p50_ns[index] as f64 / 1000.0,
        latency_p99_us: table.latency_p99_ns[index] as f64 / 1000.0,
        placement: Placement::of(table.pid[index]),
    };
    (0..count).map(row).collect()
}

/// The rows as text.
#[must_use]
pub fn table(rows: &[Row]) -> String {
    let mut text = format!(
        "{:<16} {:>8} {:<9} {:>8} {:>9} {:>9} {:>6} {:>8} {:>6} {:>16}  {}",
        "service",
        "pid",
        "state",
        "restarts",
        "rate Hz",
        "published",
        "lost",
        "rejected",
        "missed",
        "p50/p99 µs",
        "runs on"
    );
    for row in rows {
        let latency = format!("{:.0}/{:.0}", row.latency_p50_us, row.latency_p99_us);
        text += &format!(
            "\n{:<16} {:>8} {:<9} {:>8} {:>9.1} {:>9} {:>6} {:>8} {:>6} {:>16}  {}",
            row.service,
            row.pid,
            row.state,
            row.restarts,
            row.rate_hz,
            row.published,
            row.lost,
            row.rejected,
            row.missed,
            if row.latency_p50_us > 0.0 { latency } else { "-".into() },
            row.placement.as_ref().map_or("-".into(), ToString::to_string)
        );
    }
    text
}

fn json(rows: &[Row]) -> Result<String, Error> {
    serde_json::to_string_pretty(rows).map_err(|error| Error::internal(error.to_string()))
}
