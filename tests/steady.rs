//! A system that has warmed up asks the kernel for nothing but to be woken: no cycle costs a page fault, and no heap grows.

use crate::rover::{Rover, pid};
use serde_json::Value;
use std::fmt;

/// Frames after which every place of every wire has been used.
const WARM_UP_CYCLES: u64 = 200;
/// Frames that are looked at.
const CYCLES: u64 = 300;
/// So often, until they have asked for nothing. What is done for the first time (another soil is found, a stage is late on a
/// busy machine) may fetch a page of the program; what a cycle costs shows every time.
const LOOKS_MAX: usize = 10;

/// What a process has asked of the kernel so far.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Demand {
    service: String,
    pid: u32,
    minor_faults: u64,
    major_faults: u64,
    /// Memory of its own that it can write: heap and stack [KiB].
    data_kib: u64,
}

impl Demand {
    fn of(row: &Value) -> Self {
        let pid = pid(row);
        let read = |file: &str| std::fs::read_to_string(format!("/proc/{pid}/{file}")).unwrap();
        let stat = read("stat");
        // The name, in brackets, may hold blanks; the third field follows it.
        let fields: Vec<&str> = stat.rsplit_once(") ").unwrap().1.split(' ').collect();
        let status = read("status");
        let data = status.lines().find_map(|line| line.strip_prefix("VmData:")).unwrap();
        Self {
            service: row["service"].as_str().unwrap().into(),
            pid,
            minor_faults: fields[7].parse().unwrap(),
            major_faults: fields[9].parse().unwrap(),
            data_kib: data.trim().trim_end_matches(" kB").parse().unwrap(),
        }
    }
}

impl fmt::Display for Demand {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            service,
            minor_faults,
            major_faults,
            data_kib,
            ..
        } = self;
        write!(
            formatter,
            "{service}: {minor_faults} minor and {major_faults} major faults, {data_kib} KiB"
        )
    }
}

/// Waits for so many frames more, and returns what each process has asked for by then.
fn demands_after(rover: &mut Rover, cycles: u64) -> Vec<Demand> {
    let answered = |rows: &[Value]| rows.iter().find(|row| row["service"] == "terrain")?["published"].as_u64();
    let before = answered(&rover.rows()).unwrap();
    let rows = rover.until("cycles go on", |rows| answered(rows) > Some(before + cycles));
    rows.iter().map(Demand::of).collect()
}

#[test]
fn once_it_is_warm_no_cycle_costs_a_page_fault_or_memory() {
    let mut rover = Rover::new(|text| text.replace("rate_hz = 30", "rate_hz = 100"));
    rover.up();
    let mut demands = vec![demands_after(&mut rover, WARM_UP_CYCLES)];
    for _ in 0..LOOKS_MAX {
        demands.push(demands_after(&mut rover, CYCLES));
        if let [.., before, after] = demands.as_slice()
            && before == after
        {
            assert_eq!(rover.down(), Some(0), "{}", rover.log());
            return;
        }
    }
    let told = demands
        .iter()
        .map(|demands| demands.iter().map(Demand::to_string).collect::<Vec<_>>().join("\n"));
    panic!("every {CYCLES} cycles\n{}", told.collect::<Vec<_>>().join("\n\n"));
}
