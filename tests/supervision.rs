//! Services die, hang and come back; the others never stop, and nothing is left behind.

use crate::replacement::python_sinkage;
use crate::rover::{Rover, end_of, lives, pid, signal, wait_until};
use rustix::process::Signal;
use serde_json::Value;
use std::path::Path;

const SERVICES: [&str; 6] = [
    "camera",
    "telemetry",
    "sinkage",
    "terramechanics",
    "vibration",
    "terrain",
];

#[test]
fn a_killed_service_is_back_and_the_others_never_stop() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    for victim in SERVICES {
        let before = rover.rows();
        let old = pid(&rover.row(victim));
        signal(old, Signal::KILL);
        let after = rover.until(&format!("{victim} is back"), |rows| {
            rows.iter()
                .any(|row| row["service"] == victim && row["state"] == "running" && pid(row) != old)
        });
        for (before, after) in before.iter().zip(&after).filter(|(row, _)| row["service"] != victim) {
            assert_eq!(
                before["pid"],
                after["pid"],
                "{victim} took another one with it: {}",
                rover.log()
            );
        }
    }
    let cycles = rover.row("terrain")["published"].as_u64();
    rover.until("cycles go on", |rows| {
        rows.iter()
            .any(|row| row["service"] == "terrain" && row["published"].as_u64() > cycles)
    });
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
    assert_eq!(rover.traces(), [""; 0]);
}

#[test]
fn nothing_survives_a_killed_launcher_and_the_next_start_works() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let pids = rover.pids();
    assert_eq!(pids.len(), SERVICES.len());
    let mut launcher = rover.launcher.take().unwrap();
    signal(launcher.id(), Signal::KILL);
    end_of(&mut launcher);
    wait_until("no orphan", || !pids.iter().any(|pid| lives(*pid)));
    rover.up();
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
    assert_eq!(rover.traces(), [""; 0]);
}

#[test]
fn a_stopped_service_is_noticed_by_its_silence_and_replaced() {
    let mut rover = Rover::new(|text| text.replace("deadline_ms = 10000", "deadline_ms = 1500"));
    rover.up();
    for victim in ["sinkage", "telemetry", "terramechanics"] {
        let running = |rows: &[Value]| rows.iter().all(|row| row["state"] == "running");
        let row = rover
            .until("all run", running)
            .into_iter()
            .find(|row| row["service"] == victim);
        let old = pid(&row.unwrap());
        signal(old, Signal::STOP);
        rover.until(&format!("{victim} is replaced"), |rows| {
            rows.iter()
                .any(|row| row["service"] == victim && row["state"] == "running" && pid(row) != old)
        });
        rover.until_said(&format!("{victim}: has been silent on "));
    }
}

#[test]
#[cfg_attr(
    not(python_peer),
    ignore = "needs iceoryx2 for Python: python3 -m venv target/peer && target/peer/bin/pip install -r tests/peers/requirements.txt"
)]
fn a_stage_slower_than_its_input_leaves_out_what_is_old_and_that_is_counted() {
    let exec = format!("exec = {:?}", python_sinkage());
    let mut rover = Rover::new(|text| {
        text.replace("exec = [\"terrasense-sinkage\"]", &exec)
            .replace("rate_hz = 30", "rate_hz = 400")
    });
    rover.up();
    let count = |rows: &[Value], service: &str, what: &str| {
        let row = rows.iter().find(|row| row["service"] == service).unwrap();
        row[what].as_u64().unwrap()
    };
    let rows = rover.until("much is left out", |rows| count(rows, "terrain", "lost") > 500);
    // What is published and what is left out make up what the camera has sent, but for what is on its way: the newest win.
    let behind = |rows: &[Value]| {
        let numbers = |service: &str| count(rows, service, "published") + count(rows, service, "lost");
        numbers("camera").saturating_sub(numbers("terrain"))
    };
    assert!(behind(&rows) < 400, "{rows:#?}");
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
}

#[test]
fn a_restart_that_shared_memory_has_no_room_for_is_tried_again_and_the_others_go_on() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let before = rover.rows();
    // What is written into the system's folder begins as this file.
    let folder = format!("/dev/shm/terrasense-{}", rover.name);
    let obstacle = format!("{folder}/new");
    std::fs::create_dir(&obstacle).unwrap();
    signal(pid(&rover.row("sinkage")), Signal::KILL);
    let log = rover.folder.path().join("log");
    wait_until("it is tried more than once", || {
        let log = std::fs::read_to_string(&log).unwrap();
        log.matches(&format!("sinkage: {folder}/sinkage.generation: ")).count() > 1
    });
    std::fs::remove_dir(&obstacle).unwrap();
    let after = rover.until("sinkage is back", |rows| {
        rows.iter().all(|row| row["state"] == "running")
    });
    for (before, after) in before.iter().zip(&after).filter(|(row, _)| row["service"] != "sinkage") {
        assert_eq!(before["pid"], after["pid"], "{}", rover.log());
    }
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
}

#[test]
fn a_log_that_nobody_can_take_ends_nothing() {
    let mut rover = Rover::new(|text| text);
    rover.start_telling(Path::new("/dev/full"));
    rover.until("all run", |rows| rows.iter().all(|row| row["state"] == "running"));
    let old = pid(&rover.row("sinkage"));
    signal(old, Signal::KILL);
    rover.until("sinkage is back", |rows| {
        rows.iter()
            .any(|row| row["service"] == "sinkage" && row["state"] == "running" && pid(row) != old)
    });
    assert_eq!(rover.down(), Some(0));
}

#[test]
fn a_terminal_that_is_closed_ends_a_system_in_order() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let mut launcher = rover.launcher.take().unwrap();
    signal(launcher.id(), Signal::HUP);
    assert_eq!(end_of(&mut launcher).code(), Some(0), "{}", rover.log());
    assert_eq!(rover.traces(), [""; 0]);
}

/// How many cycles each service is charged with.
fn missed(rows: &[Value]) -> Vec<(&str, u64)> {
    let charged = rows
        .iter()
        .map(|row| (row["service"].as_str().unwrap(), row["missed"].as_u64().unwrap()));
    charged.filter(|(_, missed)| *missed > 0).collect()
}

#[test]
fn a_cycle_that_is_late_from_the_first_answer_on_is_charged_to_the_first_stage_of_its_chain() {
    // Nobody answers within a microsecond.
    let mut rover = Rover::new(|text| text.replace("cycle_deadline_ms = 50", "cycle_deadline_ms = 0.001"));
    rover.up();
    let rows = rover.until("many cycles are late", |rows| {
        rows.iter()
            .any(|row| row["service"] == "terrain" && row["published"].as_u64() > Some(50))
    });
    let charged = missed(&rows);
    let names: Vec<&str> = charged.iter().map(|(service, _)| *service).collect();
    assert_eq!(names, ["sinkage", "vibration"], "{rows:#?}");
    assert!(charged[0].1 >= 50, "{rows:#?}");
    rover.until_said("its deadline is 0.001 ms; 32 missed so far");
}

#[test]
fn a_stage_that_stops_for_a_while_is_charged_with_the_cycles_it_makes_late_and_no_other_is() {
    // Two frames a second: between two cycles there is time enough for the stages behind the slow one.
    let mut rover = Rover::new(|text| {
        text.replace("cycle_deadline_ms = 50", "cycle_deadline_ms = 1000")
            .replace("rate_hz = 30", "rate_hz = 2")
    });
    rover.up();
    rover.until("cycles come", |rows| {
        rows.iter()
            .any(|row| row["service"] == "terrain" && row["published"].as_u64() > Some(2))
    });
    assert_eq!(missed(&rover.rows()), [], "{}", rover.log());
    let slow = pid(&rover.row("terramechanics"));
    signal(slow, Signal::STOP);
    std::thread::sleep(std::time::Duration::from_millis(3500));
    signal(slow, Signal::CONT);
    let before = rover.row("terrain")["published"].as_u64().unwrap();
    let rows = rover.until("the backlog is done", |rows| {
        rows.iter()
            .any(|row| row["service"] == "terrain" && row["published"].as_u64() > Some(before + 10))
    });
    let charged = missed(&rows);
    assert!(matches!(charged[..], [("terramechanics", 3..)]), "{rows:#?}");
    rover.until_said("terramechanics: cycle ");
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
}

#[test]
#[cfg_attr(
    not(python_peer),
    ignore = "needs iceoryx2 for Python: python3 -m venv target/peer && target/peer/bin/pip install -r tests/peers/requirements.txt"
)]
fn a_slow_replacement_is_charged_with_every_cycle_and_no_other_stage_is() {
    // The Python stage, and a nap with each answer.
    let script = format!(
        "import sys, time; sys.path.insert(0, '{}'); import sinkage; answer = sinkage.answer; sinkage.answer = lambda *about: \
         (time.sleep(0.7), answer(*about))[1]; sinkage.terrasense_shell.main(sinkage.service)",
        Path::new(env!("CARGO_MANIFEST_DIR")).join("peers").display()
    );
    let [python, _] = python_sinkage();
    let exec = format!("exec = {:?}", [&python, "-B", "-c", &script]);
    let mut rover = Rover::new(|text| {
        text.replace("exec = [\"terrasense-sinkage\"]", &exec)
            .replace("cycle_deadline_ms = 50", "cycle_deadline_ms = 500")
            .replace("rate_hz = 30", "rate_hz = 1")
    });
    rover.up();
    let rows = rover.until("some cycles are late", |rows| {
        rows.iter()
            .any(|row| row["service"] == "terrain" && row["published"].as_u64() > Some(4))
    });
    assert!(matches!(missed(&rows)[..], [("sinkage", 4..)]), "{rows:#?}");
    rover.until_said("sinkage: cycle ");
}

#[test]
fn a_service_that_keeps_dying_is_given_up_and_the_rest_goes_on() {
    let mut rover = Rover::new(|text| {
        text.replace(
            "exec = [\"terrasense-vibration\"]",
            "exec = [\"sh\", \"-c\", \"exit 3\"]\nintensity = 2",
        )
    });
    rover.start();
    let rows = rover.until("given up, and cycles", |rows| {
        let given_up = rows
            .iter()
            .any(|row| row["service"] == "vibration" && row["state"] == "given_up");
        given_up
            && rows
                .iter()
                .any(|row| row["service"] == "terrain" && row["published"].as_u64() > Some(10))
    });
    let others = rows.iter().filter(|row| row["service"] != "vibration");
    for row in others {
        assert_eq!(
            (&row["state"], &row["restarts"]),
            (&"running".into(), &0.into()),
            "{row}"
        );
    }
    rover.until_said("vibration: ended with code 3; given up: 2 restarts within 10 s");
}

#[test]
fn a_service_that_never_opens_its_wires_is_ended() {
    let mut rover = Rover::new(|text| {
        let asleep = "exec = [\"sleep\", \"1000\", \"#\"]\nstart_timeout_ms = 100\nintensity = 1";
        text.replace("exec = [\"terrasense-terrain\"]", asleep)
    });
    rover.start();
    rover.until("given up", |rows| {
        rows.iter()
            .any(|row| row["service"] == "terrain" && row["state"] == "given_up")
    });
}

#[test]
fn a_second_launcher_of_the_same_system_is_refused() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let (code, text) = crate::rover::told(&["up", &rover.file()]);
    assert_eq!(code, 69, "{text}");
    assert!(text.contains("runs already"), "{text}");
    assert_eq!(rover.row("camera")["restarts"], 0);
}
