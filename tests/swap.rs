//! A stage is swapped while the system runs: compared first, then promoted without a gap, or refused without a trace.

use crate::replacement::python_sinkage;
use crate::rover::{Rover, lives, pid, program, signal, told, wait_until};
use messages::{Header, Sinkage, Status};
use rustix::process::Signal;
use shell::{Domain, SystemFile, Termination, now_ns};

/// `terrasense swap <options> <stage> -- <exec>`, and what it said.
fn swap(name: &str, options: &[&str], stage: &str, exec: &[&str]) -> (i32, String) {
    let start = ["swap", "--name", name, "--cycles", "20"];
    told(&[&start, options, &[stage, "--"], exec].concat())
}

/// The `exec` of a service in the file that services read when they start.
fn exec_of(rover: &Rover, service: &str) -> Vec<String> {
    let file = SystemFile::read(&format!("/dev/shm/terrasense-{}/system.toml", rover.name)).unwrap();
    file.services[service].exec.get_ref().clone()
}

/// Kills a stage that is on probation, and waits until the one before is back.
fn kill_on_probation(rover: &mut Rover, stage: &str) {
    let promoted = pid(&rover.row(stage));
    signal(promoted, Signal::KILL);
    rover.until("the old program is back", |rows| {
        rows.iter()
            .any(|row| row["service"] == stage && row["state"] == "running" && pid(row) != promoted)
    });
    rover.until_said(&format!("{stage}: ended by signal 9 on probation; rolled back"));
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
    kill_on_probation(&mut rover, "terramechanics");
}

#[test]
fn what_is_rolled_back_during_another_rehearsal_stays_so() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let name = rover.name.clone();
    let [terramechanics, sinkage] =
        ["terramechanics", "sinkage"].map(|stage| program(&format!("terrasense-{stage}")).display().to_string());
    let (code, text) = swap(
        &name,
        &["--probation-s", "600"],
        "terramechanics",
        &["env", &terramechanics],
    );
    assert_eq!(code, 0, "{text}");
    assert_eq!(exec_of(&rover, "terramechanics"), ["env", &terramechanics]);
    let (code, text) = std::thread::scope(|scope| {
        let swapping = scope.spawn(|| {
            told(&[
                "swap", "--name", &name, "--cycles", "200", "sinkage", "--", "env", &sinkage,
            ])
        });
        let rehearses = |line: &str| line.contains("sinkage: ") && line.ends_with("rehearses beside it");
        wait_until("the other one rehearses", || rover.log().lines().any(rehearses));
        kill_on_probation(&mut rover, "terramechanics");
        swapping.join().unwrap()
    });
    assert_eq!(code, 0, "{text}");
    assert_eq!(exec_of(&rover, "sinkage"), ["env", &sinkage]);
    assert_eq!(exec_of(&rover, "terramechanics"), ["terrasense-terramechanics"]);
}

#[test]
fn a_swap_ends_the_probation_of_no_other_stage() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let name = rover.name.clone();
    for stage in ["terramechanics", "terrain"] {
        let own = program(&format!("terrasense-{stage}")).display().to_string();
        let (code, text) = swap(&name, &["--probation-s", "600"], stage, &["env", &own]);
        assert_eq!(code, 0, "{text}");
    }
    kill_on_probation(&mut rover, "terramechanics");
    assert_eq!(exec_of(&rover, "terramechanics"), ["terrasense-terramechanics"]);
    assert_eq!(exec_of(&rover, "terrain")[0], "env", "only what died is rolled back");
}

#[test]
fn a_stage_of_one_cycle_a_second_is_swapped() {
    let mut rover = Rover::new(|text| text.replace("rate_hz = 30", "rate_hz = 1"));
    rover.up();
    let before = pid(&rover.row("sinkage"));
    let name = rover.name.clone();
    let own = program("terrasense-sinkage").display().to_string();
    rover.without_losing_a_cycle(|| {
        let (code, text) = told(&["swap", "--name", &name, "--cycles", "2", "sinkage", "--", &own]);
        assert_eq!(code, 0, "{text}");
    });
    let row = rover.row("sinkage");
    assert!(pid(&row) != before && row["restarts"] == 0, "{row}");
}

#[test]
fn a_number_from_nowhere_keeps_no_stage_from_being_swapped() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let domain = Domain::enter(&SystemFile::read(&rover.file()).unwrap(), "intruder").unwrap();
    let intruder = domain
        .output::<Sinkage>("front/sinkage", &Termination::listen().unwrap())
        .unwrap();
    let wild = Sinkage::unknown(Header {
        sequence: u64::MAX - 1,
        taken_ns: now_ns(),
        status: Status::OK,
        ..Header::default()
    });
    intruder.send(wild).unwrap();
    let counted = |rows: &[serde_json::Value], what: &str| {
        let row = rows.iter().find(|row| row["service"] == "sinkage").unwrap();
        row[what].as_u64().unwrap()
    };
    let rows = rover.until("the launcher has seen it", |rows| {
        counted(rows, "lost") >= u64::from(u32::MAX)
    });
    let cycles = counted(&rows, "published");
    rover.until("cycles go on", |rows| counted(rows, "published") > cycles + 20);
    let name = rover.name.clone();
    for stage in ["sinkage", "terramechanics"] {
        let before = pid(&rover.row(stage));
        let own = program(&format!("terrasense-{stage}")).display().to_string();
        let (code, text) = swap(&name, &[], stage, &[&own]);
        assert_eq!(code, 0, "{text}\n{}", rover.log());
        let row = rover.row(stage);
        assert!(pid(&row) != before && row["restarts"] == 0, "{row}");
    }
}

#[test]
fn a_caller_that_says_nothing_keeps_nobody_from_swapping() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let socket = format!("/dev/shm/terrasense-{}/control", rover.name);
    let silent = std::os::unix::net::UnixStream::connect(socket).unwrap();
    let own = program("terrasense-terrain").display().to_string();
    let (code, text) = swap(&rover.name, &[], "terrain", &[&own]);
    assert_eq!(code, 0, "{text}");
    drop(silent);
}

#[test]
fn a_system_file_that_cannot_be_written_ends_nothing() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let name = rover.name.clone();
    let swap = |stage: &str| {
        let own = program(&format!("terrasense-{stage}")).display().to_string();
        let (code, text) = swap(&name, &[], stage, &["env", &own]);
        assert_eq!(code, 0, "{text}");
    };
    // A folder in the file's place: nobody can write there, root neither.
    let file = format!("/dev/shm/terrasense-{name}/system.toml");
    std::fs::remove_file(&file).unwrap();
    std::fs::create_dir(&file).unwrap();
    swap("terramechanics");
    rover.until_said("system.toml: ");
    std::fs::remove_dir(&file).unwrap();
    swap("terrain");
    assert_eq!(
        ["terramechanics", "terrain"].map(|stage| exec_of(&rover, stage)[0].clone()),
        ["env", "env"]
    );
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
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
