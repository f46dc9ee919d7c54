//! Measured times: histograms in which nothing is discarded, an aligned table, and JSON.

use crate::{Machine, Outcome};
use clap::Args;
use hdrhistogram::Histogram;
use serde::Serialize;
use serde_json::{Value, json};
use std::path::PathBuf;

/// What every bench can be told.
#[derive(Clone, Debug, Args)]
pub struct Options {
    /// A tenth of the usual number of measurements.
    #[arg(long)]
    quick: bool,
    /// So many times the usual number of measurements.
    #[arg(long, default_value_t = 1, value_name = "N", conflicts_with = "quick")]
    times: usize,
    /// Also writes the rows to this file; those of other benches of the same machine stay in it.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Also writes what is printed to this file.
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Cargo says so.
    #[arg(long, hide = true)]
    bench: bool,
}

impl Options {
    /// How many measurements to take where `usual` are usual.
    #[must_use]
    pub fn amount(&self, usual: usize) -> usize {
        if self.quick {
            usual.div_ceil(10)
        } else {
            usual * self.times
        }
    }
}

/// The times of one thing, in rounds between which the other things of its table were measured.
#[derive(Clone, Debug)]
pub struct Series {
    name: String,
    floor: Option<String>,
    rounds: Vec<Histogram<u64>>,
    lost: Option<Vec<u64>>,
}

impl Series {
    /// Times of `name`.
    #[must_use]
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            floor: None,
            rounds: Vec::new(),
            lost: None,
        }
    }

    /// The same, to be compared with the series of this name in the same table.
    #[must_use]
    pub fn over(self, floor: impl Into<String>) -> Self {
        Self {
            floor: Some(floor.into()),
            ..self
        }
    }

    /// Begins a round.
    pub fn begin_round(&mut self) {
        self.rounds.push(empty());
        self.lost.iter_mut().for_each(|lost| lost.push(0));
    }

    /// Adds so many that never came to this round. A series is asked before its first round whether it counts them.
    pub fn lose(&mut self, count: u64) {
        let lost = self.lost.get_or_insert_default();
        lost.resize(self.rounds.len().max(1), 0);
        lost.iter_mut().next_back().into_iter().for_each(|last| *last += count);
    }

    /// The name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Each round as a series of its own.
    #[must_use]
    pub fn each_round(&self) -> Vec<Self> {
        let single = |(index, round): (usize, &Histogram<u64>)| Self {
            name: format!("{}, round {}", self.name, index + 1),
            floor: None,
            rounds: vec![round.clone()],
            lost: self.lost.as_ref().map(|lost| vec![lost[index]]),
        };
        self.rounds.iter().enumerate().map(single).collect()
    }

    /// Adds a time to this round.
    pub fn record(&mut self, time_ns: u64) {
        if self.rounds.is_empty() {
            self.begin_round();
        }
        let round = self.rounds.last_mut().expect("a round has begun");
        round.record(time_ns).expect("the histogram grows with its values");
    }

    /// The median of all rounds [µs].
    #[must_use]
    pub fn p50_us(&self) -> f64 {
        self.quantile_us(0.5)
    }

    /// Any quantile of all rounds [µs].
    #[must_use]
    pub fn quantile_us(&self, quantile: f64) -> f64 {
        micro(self.all().value_at_quantile(quantile))
    }

    /// The median of each round [µs]; `None` where nothing came.
    #[must_use]
    pub fn p50_of_rounds_us(&self) -> Vec<Option<f64>> {
        let median = |round: &Histogram<u64>| (!round.is_empty()).then(|| micro(round.value_at_quantile(0.5)));
        self.rounds.iter().map(median).collect()
    }

    fn all(&self) -> Histogram<u64> {
        let mut sum = empty();
        for round in &self.rounds {
            sum.add(round).expect("the histogram grows with its values");
        }
        sum
    }

    fn row(&self, bench: &str, table: &str, among: &[Self]) -> Row {
        let all = self.all();
        let at = |quantile| micro(all.value_at_quantile(quantile));
        let medians: Vec<f64> = filled(&self.rounds)
            .map(|round| micro(round.value_at_quantile(0.5)))
            .collect();
        let floor = among
            .iter()
            .find(|other| Some(&other.name) == self.floor.as_ref() && !medians.is_empty());
        let ratios: Vec<f64> = floor.map_or_else(Vec::new, |floor| {
            let pairs = filled(&self.rounds).zip(filled(&floor.rounds));
            pairs
                .map(|(ours, theirs)| ours.value_at_quantile(0.5) as f64 / theirs.value_at_quantile(0.5).max(1) as f64)
                .collect()
        });
        Row {
            bench: bench.into(),
            table: table.into(),
            name: self.name.clone(),
            unit: "us",
            n: all.len(),
            p50: at(0.5),
            p99: at(0.99),
            p999: at(0.999),
            max: micro(all.max()),
            lost: self.lost.as_ref().map(|lost| lost.iter().sum()),
            rounds: medians.len(),
            p50_of_rounds: range(&medians),
            floor: self.floor.clone(),
            ratio_to_floor: floor.map(|floor| self.p50_us() / floor.p50_us().max(1e-3)),
            ratio_of_rounds: range(&ratios),
        }
    }
}

fn filled(rounds: &[Histogram<u64>]) -> impl Iterator<Item = &Histogram<u64>> {
    rounds.iter().filter(|round| !round.is_empty())
}

fn empty() -> Histogram<u64> {
    Histogram::new(3).expect("three digits are possible")
}

fn micro(time_ns: u64) -> f64 {
    time_ns as f64 / 1e3
}

fn range(values: &[f64]) -> Option<[f64; 2]> {
    let low = values.iter().copied().reduce(f64::min)?;
    Some([low, values.iter().copied().reduce(f64::max)?])
}

/// One line of a table. Times in µs.
#[derive(Clone, Debug, Serialize)]
struct Row {
    bench: String,
    table: String,
    name: String,
    unit: &'static str,
    n: u64,
    p50: f64,
    p99: f64,
    p999: f64,
    max: f64,
    /// What never came.
    #[serde(skip_serializing_if = "Option::is_none")]
    lost: Option<u64>,
    rounds: usize,
    /// Lowest and highest median of a round.
    p50_of_rounds: Option<[f64; 2]>,
    floor: Option<String>,
    /// Median to the floor's median.
    ratio_to_floor: Option<f64>,
    /// Its lowest and highest value in a round.
    ratio_of_rounds: Option<[f64; 2]>,
}

impl Row {
    const HEADS: [&str; 9] = [
        "µs",
        "n",
        "p50",
        "p99",
        "p99.9",
        "max",
        "lost",
        "p50 of rounds",
        "to floor",
    ];

    fn cells(&self) -> [String; 9] {
        let between =
            |range: Option<[f64; 2]>| range.map_or_else(String::new, |[low, high]| format!("{low:.2}–{high:.2}"));
        let ratio = self.ratio_to_floor.map_or_else(String::new, |ratio| {
            format!("{ratio:.2} ({})", between(self.ratio_of_rounds))
        });
        let time = |value: f64| format!("{value:.2}");
        [
            self.name.clone(),
            self.n.to_string(),
            time(self.p50),
            time(self.p99),
            time(self.p999),
            time(self.max),
            self.lost.map_or_else(String::new, |lost| lost.to_string()),
            between(self.p50_of_rounds.filter(|_| self.rounds > 1)),
            ratio,
        ]
    }
}

/// What a bench prints, and writes as JSON.
#[derive(Debug)]
pub struct Report {
    bench: &'static str,
    machine: Machine,
    json: Option<PathBuf>,
    markdown: Option<PathBuf>,
    text: String,
    rows: Vec<Row>,
    notes: Vec<String>,
}

impl Report {
    /// Begins the report of a bench: its first line is the machine.
    #[must_use]
    pub fn begin(bench: &'static str, options: &Options) -> Self {
        let machine = Machine::here();
        let mut report = Self {
            bench,
            json: options.json.clone(),
            markdown: options.markdown.clone(),
            text: String::new(),
            rows: Vec::new(),
            notes: Vec::new(),
            machine,
        };
        report.print(&format!("{bench}: {}", report.machine));
        report.note(format!("Load before: {}.", Machine::load()));
        report
    }

    /// Prints a table.
    pub fn table(&mut self, title: &str, series: &[Series]) {
        let rows: Vec<Row> = series.iter().map(|each| each.row(self.bench, title, series)).collect();
        self.print(&format!("\n{title}\n\n{}", markdown(&rows).trim_end()));
        self.rows.extend(rows);
    }

    /// Prints a sentence.
    pub fn note(&mut self, text: String) {
        self.print(&text);
        self.notes.push(text);
    }

    fn print(&mut self, text: &str) {
        println!("{text}");
        self.text += text;
        self.text.push('\n');
    }

    /// Ends the report: writes the files that are wanted.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn end(self) -> Outcome<()> {
        if let Some(path) = &self.markdown {
            std::fs::write(path, &self.text).map_err(|error| format!("{}: {error}", path.display()))?;
        }
        let Some(path) = &self.json else { return Ok(()) };
        let machine = serde_json::to_value(&self.machine)?;
        let before: Value =
            std::fs::read(path).map_or(Value::Null, |text| serde_json::from_slice(&text).unwrap_or_default());
        let keep = before["machine"] == machine;
        let kept = |key: &str| {
            let all = before[key].as_array().cloned().unwrap_or_default();
            all.into_iter()
                .filter(|each| keep && each["bench"] != self.bench)
                .collect::<Vec<_>>()
        };
        let (mut rows, mut notes) = (kept("rows"), kept("notes"));
        for row in &self.rows {
            rows.push(serde_json::to_value(row)?);
        }
        notes.extend(
            self.notes
                .iter()
                .map(|text| json!({ "bench": self.bench, "text": text })),
        );
        let all = json!({ "machine": machine, "rows": rows, "notes": notes });
        std::fs::write(path, serde_json::to_string_pretty(&all)? + "\n")
            .map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(())
    }
}

/// The rows, the columns aligned, those left out that are empty.
fn markdown(rows: &[Row]) -> String {
    let all: Vec<[String; 9]> = rows.iter().map(Row::cells).collect();
    let used: Vec<usize> = (0..Row::HEADS.len())
        .filter(|column| all.iter().any(|row| !row[*column].is_empty()))
        .collect();
    let heads = Row::HEADS.map(str::to_owned);
    let cells: Vec<Vec<&String>> = std::iter::once(&heads)
        .chain(&all)
        .map(|row| used.iter().map(|column| &row[*column]).collect())
        .collect();
    let width = |column: usize| cells.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..used.len()).map(width).collect();
    let mut text = String::new();
    for (index, row) in cells.iter().enumerate() {
        let padded = row
            .iter()
            .zip(&widths)
            .enumerate()
            .map(|(column, (cell, width))| match column {
                0 => format!("{cell:<width$}"),
                _ => format!("{cell:>width$}"),
            });
        text += &format!("| {} |\n", padded.collect::<Vec<_>>().join(" | "));
        if index == 0 {
            let rule = widths.iter().enumerate().map(|(column, width)| match column {
                0 => "-".repeat(width + 2),
                _ => "-".repeat(width + 1) + ":",
            });
            text += &format!("|{}|\n", rule.collect::<Vec<_>>().join("|"));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(name: &str, rounds: &[&[u64]]) -> Series {
        let mut series = Series::new(name);
        for round in rounds {
            series.begin_round();
            round.iter().for_each(|time_ns| series.record(*time_ns));
        }
        series
    }

    #[test]
    fn a_row_holds_every_time_and_its_ratio_to_the_floor_round_by_round() {
        let floor = series("floor", &[&[100, 100, 100], &[200, 200, 200]]);
        let above = series("above", &[&[300, 300, 1_000_000], &[400, 400, 400]]).over("floor");
        let row = above.row("hop", "table", &[floor, above.clone()]);
        assert_eq!((row.n, row.rounds), (6, 2));
        assert_eq!((row.p50, row.p50_of_rounds), (0.4, Some([0.3, 0.4])));
        assert!((row.max - 1000.0).abs() < 1.0, "{}", row.max);
        assert_eq!((row.ratio_to_floor, row.ratio_of_rounds), (Some(4.0), Some([2.0, 3.0])));
    }

    #[test]
    fn a_table_is_aligned() {
        let rows = [series("a", &[&[1]]), series("much longer", &[&[1_000_000]])];
        let rows: Vec<Row> = rows.iter().map(|each| each.row("hop", "table", &[])).collect();
        let text = markdown(&rows);
        let widths: Vec<usize> = text.lines().map(|line| line.chars().count()).collect();
        assert!(widths.iter().all(|width| *width == widths[0]), "{text}");
    }
}
