//! The conformance kit: the services of this project keep every rule, and a program that breaks one is told which.

use crate::rover::{program, told, traces};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// A fault of `peers/broken.py`, and the rule that it breaks.
const FAULTS: [(&str, &str); 21] = [
    ("late", "start"),
    ("two_answers", "one_answer"),
    ("skips", "one_answer"),
    ("reversed", "order"),
    ("own_sequence", "identity"),
    ("own_instant", "identity"),
    ("no_generation", "generation"),
    ("no_stamp", "published"),
    ("silent_bell", "bell"),
    ("infinite", "values"),
    ("silence", "bad_input"),
    ("believes", "bad_input"),
    ("leaks", "memory"),
    ("amnesia", "restart"),
    ("never_ends", "end"),
    ("deaf", "sigterm"),
    ("wrong_code", "sigterm"),
    ("any_layout", "layout"),
    ("ignores_layout", "layout"),
    ("any_name", "unknown_name"),
    ("any_key", "unknown_key"),
];

/// The rules that a program does not keep, and the exit code. Nothing may be left behind.
fn broken_rules(stage: &str, program_and_arguments: &[&str]) -> (i32, Vec<String>) {
    let kit = Command::new(program("terrasense"))
        .args(["conformance", stage, "--json", "--cycles", "100", "--"])
        .args(program_and_arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let name = format!("trial_{}", kit.id());
    let output = kit.wait_with_output().unwrap();
    assert_eq!(traces(&name), [""; 0]);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let rules = report["rules"].as_array().unwrap();
    let broken = rules.iter().filter(|rule| rule["holds"] == false);
    let broken: Vec<String> = broken
        .map(|rule| format!("{}: {}", rule["rule"], rule["seen"]))
        .collect();
    assert_eq!(report["conforms"], broken.is_empty());
    assert!(report["latency_p99_us"].as_f64() > Some(0.0), "{report}");
    (output.status.code().unwrap(), broken)
}

fn peer(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("peers").join(file)
}

fn python() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/peer/bin/python3")
}

#[test]
fn the_built_in_stages_keep_every_rule() {
    for stage in ["sinkage", "terramechanics", "vibration", "terrain"] {
        let broken = broken_rules(stage, &[&format!("terrasense-{stage}")]);
        assert_eq!(broken, (0, vec![]), "{stage}");
    }
}

#[test]
fn a_program_that_is_no_service_is_told_so() {
    let (code, broken) = broken_rules_of_a_stranger(&["sh", "-c", "exit 3"]);
    assert_eq!(code, 1);
    assert!(broken.contains("its wires were never all open"), "{broken}");
}

fn broken_rules_of_a_stranger(program_and_arguments: &[&str]) -> (i32, String) {
    told(
        &[
            &["conformance", "sinkage", "--start-timeout-ms", "200", "--"],
            program_and_arguments,
        ]
        .concat(),
    )
}

#[test]
fn a_missing_program_or_a_wrong_configuration_is_refused() {
    let (code, text) = told(&["conformance", "sinkage", "--", "/nowhere/sinkage"]);
    assert_eq!(
        (code, text.contains("executable `/nowhere/sinkage`")),
        (64, true),
        "{text}"
    );
    let (code, text) = told(&[
        "conformance",
        "sinkage",
        "--config",
        "radius_m = ",
        "--",
        "terrasense-sinkage",
    ]);
    assert_eq!((code, text.contains("--config: ")), (78, true), "{text}");
    let (code, text) = told(&["conformance", "wheel", "--", "terrasense-sinkage"]);
    assert_eq!((code, text.contains("terramechanics")), (64, true), "{text}");
    let (code, text) = told(&["conformance", "sinkage"]);
    assert_eq!((code, text.contains("PROGRAM")), (64, true), "{text}");
}

#[test]
fn a_stage_is_configured_as_it_would_be_in_its_system() {
    let folder = tempfile::tempdir().unwrap();
    let system = folder.path().join("rover.toml");
    let text = told(&["default-system"])
        .1
        .replace("config = { radius_m = 0.15 }", "config = { radius_m = 0.2 }");
    std::fs::write(&system, text).unwrap();
    for choice in [
        ["--system", system.to_str().unwrap()],
        ["--config", "radius_m = 0.2, rolls = \"left\""],
    ] {
        let words = [
            &["conformance", "sinkage", "--cycles", "10"],
            &choice[..],
            &["--", "terrasense-sinkage"],
        ]
        .concat();
        let (code, text) = told(&words);
        assert_eq!((code, text.contains("all 16 rules hold")), (0, true), "{text}");
    }
}

#[test]
#[cfg_attr(
    not(python_peer),
    ignore = "needs iceoryx2 for Python: python3 -m venv target/peer && target/peer/bin/pip install -r tests/peers/requirements.txt"
)]
fn the_python_peer_keeps_every_rule() {
    let (python, peer) = (python(), peer("sinkage.py"));
    let broken = broken_rules("sinkage", &[python.to_str().unwrap(), peer.to_str().unwrap()]);
    assert_eq!(broken, (0, vec![]));
}

#[test]
#[cfg_attr(
    not(python_peer),
    ignore = "needs iceoryx2 for Python: python3 -m venv target/peer && target/peer/bin/pip install -r tests/peers/requirements.txt"
)]
fn a_program_that_breaks_one_rule_is_told_this_rule_and_no_other() {
    let (python, peer) = (python(), peer("broken.py"));
    let with = |fault: &str| broken_rules("sinkage", &[python.to_str().unwrap(), peer.to_str().unwrap(), fault]);
    assert_eq!(with("none"), (0, vec![]));
    let try_all = |faults: &[(&str, &str)]| {
        for (fault, rule) in faults {
            let (code, broken) = with(fault);
            let told = broken.len() == 1 && broken[0].starts_with(&format!("\"{rule}\""));
            assert!(code == 1 && told, "{fault}, which breaks {rule}: {code} {broken:#?}");
        }
    };
    // Mostly they wait.
    std::thread::scope(|scope| {
        FAULTS
            .chunks(5)
            .for_each(|faults| drop(scope.spawn(|| try_all(faults))));
    });
}
