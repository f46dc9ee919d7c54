//! A stage is swapped while the system runs: compared first, then promoted without a gap, or refused without a trace.

use crate::replacement::python_sinkage;
use crate::rover::{Rover, lives, pid, program, signal, told, wait_until};
use rustix::process::Signal;

/// `terrasense swap <options> <stage> -- <exec>`, and what it said.
fn swap(name: &str, options: &[&str], stage: &str, exec: &[&str]) -> (i32, String) {
    let start = ["swap", "--name", name, "--cycles", "20"];
    told(&[&start, options, &[stage, "--"], exec].concat())
}

#[test]
fn every_stage_is_swapped_without_losing_a_cycle() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let before = rover.pids();
    let name = rover.name.clone();
    rover.without_losing_a_cycle(|| {
        for stage in ["sinkage", "terramechanics", "vibration", "terrain"] {
            let own = program(&format!("terrasense-{stage}")).display().to_string();
            let (code, text) = swap(&name, &[], stage, &[&own]);
            assert_eq!(code, 0, "{text}");
            assert!(
                text.contains("20 cycles compared, the same status in 20; 0 left out"),
                "{text}"
            );
        }
    });
    let rows = rover.rows();
    let old = rows.iter().filter(|row| before.contains(&pid(row))).count();
    assert_eq!(old, 2, "only the sources are what they were: {rows:#?}");
    wait_until("the old ones have ended", || {
        before.iter().filter(|pid| lives(**pid)).count() == 2
    });
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
    assert_eq!(rover.traces(), [""; 0]);
}

#[test]
fn a_rehearsal_and_a_refusal_leave_the_old_one_alone() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let sinkage = pid(&rover.row("sinkage"));
    let name = rover.name.clone();
    let own = program("terrasense-sinkage").display().to_string();
    rover.without_losing_a_cycle(|| {
        let (code, text) = swap(&name, &["--dry-run"], "sinkage", &[&own]);
        assert!(code == 0 && text.contains("a rehearsal only"), "{text}");
        let (code, text) = swap(&name, &["--json", "--dry-run"], "sinkage", &[&own]);
        let reports: Vec<serde_json::Value> = text
            .lines()
            .filter_map(|line| serde_json::from_str(line).ok())
            .collect();
        assert_eq!(
            (
                code,
                &reports.iter().find_map(|report| report.get("rehearsed")).unwrap()["cycles"]
            ),
            (0, &20.into())
        );
        for (options, exec, why) in [
            (&[][..], "false", "the candidate ended with code 1"),
            (&[], "/no/such/program", "cannot find the program"),
            (&["--require", "left_rad=-1"], "true", "is no number from 0 on"),
            (&["--require", "left=0.1"], &own, "has no number `left`"),
        ] {
            let (code, text) = swap(&name, options, "sinkage", &[exec]);
            assert!(code != 0 && text.contains(why), "{code} {text}");
        }
        let (code, text) = swap(&name, &[], "camera", &[&own]);
        assert!(code == 1 && text.contains("is a source"), "{code} {text}");
    });
    assert_eq!(pid(&rover.row("sinkage")), sinkage);
}

#[test]
fn a_replacement_that_dies_on_probation_is_rolled_back() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let name = rover.name.clone();
    let own = program("terrasense-terramechanics").display().to_string();
    rover.without_losing_a_cycle(|| {
        let (code, text) = swap(&name, &["--probation-s", "60"], "terramechanics", &["env", &own]);
        assert_eq!(code, 0, "{text}");
    });
    let promoted = pid(&rover.row("terramechanics"));
    signal(promoted, Signal::KILL);
    rover.until("the old program is back", |rows| {
        rows.iter()
            .any(|row| row["service"] == "terramechanics" && row["state"] == "running" && pid(row) != promoted)
    });
    assert!(
        rover
            .log()
            .contains("terramechanics: ended by signal 9 on probation; rolled back"),
        "{}",
        rover.log()
    );
}

#[test]
fn an_edited_system_file_counts_once_it_is_applied() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let (file, name) = (rover.file(), rover.name.clone());
    let text = std::fs::read_to_string(&file).unwrap();
    let edited = text.replace(
        "outputs = { terrain = \"front/terrain\" }",
        "outputs = { terrain = \"front/terrain\" }\nconfig = { class_age_max_s = 9.0 }",
    );
    assert_ne!(edited, text);
    std::fs::write(&file, edited).unwrap();
    let others = |rover: &Rover| {
        let rows = rover.rows();
        rows.iter()
            .filter(|row| row["service"] != "terrain")
            .map(pid)
            .collect::<Vec<_>>()
    };
    let before = others(&rover);
    rover.without_losing_a_cycle(|| {
        let (code, text) = told(&["apply", &file, "--cycles", "20"]);
        assert!(
            code == 0 && text.contains("terrain: the new one answers from cycle"),
            "{text}"
        );
        let (code, text) = told(&["apply", &file]);
        assert!(code == 0 && text.contains("nothing differs"), "{text}");
    });
    assert_eq!(others(&rover), before);
    std::fs::write(
        &file,
        std::fs::read_to_string(&file)
            .unwrap()
            .replace("front/terrain", "front/ground"),
    )
    .unwrap();
    let (code, text) = told(&["apply", &file]);
    assert!(
        code == 64 && text.contains("wires cannot change while the system runs"),
        "{name}: {code} {text}"
    );
}

#[test]
#[cfg_attr(
    not(python_peer),
    ignore = "needs iceoryx2 for Python: python3 -m venv target/peer && target/peer/bin/pip install -r tests/peers/requirements.txt"
)]
fn sinkage_goes_to_python_and_back_without_losing_a_cycle() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let name = rover.name.clone();
    let own = program("terrasense-sinkage").display().to_string();
    let [python, peer] = python_sinkage();
    rover.without_losing_a_cycle(|| {
        for exec in [&[&*python, &*peer][..], &[&*own], &[&*python, &*peer], &[&*own]] {
            let (code, text) = swap(&name, &[], "sinkage", exec);
            assert_eq!(code, 0, "{text}");
        }
    });
}
