//! Where a service runs is asked for in its table, and shown by `status`.

use crate::replacement::python_sinkage;
use crate::rover::Rover;
use serde_json::Value;

/// The processors that this process may run on.
fn processors() -> Vec<usize> {
    let allowed = rustix::thread::sched_getaffinity(None).unwrap();
    let all = 0..rustix::thread::CpuSet::MAX_CPU;
    all.filter(|cpu| allowed.is_set(*cpu)).collect()
}

fn processor() -> usize {
    processors()[0]
}

/// Services of the built-in system that do not belong to the camera's chain.
const BESIDE: [&str; 2] = ["telemetry", "vibration"];

/// The built-in system with more lines in sinkage's table.
fn sinkage_with(text: &str, lines: &str) -> String {
    text.replace("[service.sinkage]\n", &format!("[service.sinkage]\n{lines}\n"))
}

fn cpus(row: &Value) -> &Value {
    &row["placement"]["cpus"]
}

#[test]
fn a_service_runs_on_the_processors_of_its_table() {
    let processor = processor();
    let mut rover = Rover::new(|text| {
        let text = text.replace("[system]\n", "[system]\nplacement = \"kernel\"\n");
        sinkage_with(&text, &format!("cpus = [{processor}]"))
    });
    rover.up();
    let rows = rover.rows();
    let all = cpus(rows.iter().find(|row| row["service"] == "camera").unwrap());
    for row in &rows {
        let alone = row["service"] == "sinkage";
        let expected = if alone {
            &Value::from(processor.to_string())
        } else {
            all
        };
        assert_eq!(cpus(row), expected, "{row:#}");
    }
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
}

#[test]
fn the_stages_of_a_cycle_run_on_one_processor_unless_told_otherwise() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let rows = rover.rows();
    let placed = |row: &Value| (row["service"].clone(), cpus(row).as_str().unwrap().to_owned());
    let (beside, chain): (Vec<_>, Vec<_>) = rows
        .iter()
        .map(placed)
        .partition(|(name, _)| BESIDE.iter().any(|beside| name == beside));
    assert!(chain.iter().all(|(_, cpus)| *cpus == chain[0].1), "{chain:?}");
    assert!(beside.iter().all(|(_, cpus)| *cpus == beside[0].1), "{beside:?}");
    let is_one = chain[0].1.parse::<usize>().is_ok_and(|cpu| processors().contains(&cpu));
    assert!(is_one || chain[0].1 == beside[0].1, "{chain:?} {beside:?}");
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
}

#[test]
fn what_the_machine_refuses_is_said_with_its_line_and_the_service_goes_on() {
    let mut rover = Rover::new(|text| sinkage_with(&text, "cpus = [1023]"));
    rover.up();
    let text = std::fs::read_to_string(rover.file()).unwrap();
    let line = 1 + text.lines().position(|line| line.contains("cpus = [1023]")).unwrap();
    rover.until_said(&format!(".toml:{line}: processor 1023"));
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
}

#[test]
fn what_the_machine_refuses_ends_a_service_that_insists_and_is_not_tried_again() {
    let mut rover = Rover::new(|text| sinkage_with(&text, "cpus = [1023]\non_refusal = \"refuse\""));
    rover.start();
    rover.until("sinkage is given up", |rows| {
        rows.iter()
            .any(|row| row["service"] == "sinkage" && row["state"] == "given_up" && row["restarts"] == 0)
    });
    rover.until_said("processor 1023");
    rover.down();
    assert_eq!(rover.traces(), [""; 0]);
}

#[test]
#[cfg_attr(
    not(python_peer),
    ignore = "needs iceoryx2 for Python: python3 -m venv target/peer && target/peer/bin/pip install -r tests/peers/requirements.txt"
)]
fn a_service_in_python_runs_where_it_is_told_too() {
    let processor = processor();
    let exec = format!("exec = {:?}", python_sinkage());
    let mut rover = Rover::new(|text| {
        let text = sinkage_with(&text, &format!("cpus = [{processor}]\nsched = {{ fifo = 5 }}"));
        text.replace("exec = [\"terrasense-sinkage\"]", &exec)
    });
    rover.up();
    let row = rover.row("sinkage");
    assert_eq!(cpus(&row), &Value::from(processor.to_string()), "{row:#}");
    // A machine may forbid priorities: then it is said.
    if row["placement"]["sched"] != "fifo 5" {
        rover.until_said("sched");
    }
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
}
