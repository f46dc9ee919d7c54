//! The command line, as a newcomer meets it. (Also: cargo builds the `terrasense` program for the tests of the whole system.)

use std::process::{Command, Output};

fn terrasense(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_terrasense"))
        .args(arguments)
        .output()
        .expect("terrasense runs")
}

#[test]
fn help_names_every_command_and_the_exit_codes() {
    let help = String::from_utf8(terrasense(&["--help"]).stdout).unwrap();
    for word in [
        "demo",
        "up",
        "replay",
        "simulate",
        "annotate",
        "vibration",
        "status",
        "validate",
        "conformance",
        "doctor",
        "clean",
        "completions",
        "Exit codes",
    ] {
        assert!(help.contains(word), "{word} is missing:\n{help}");
    }
}

#[test]
fn a_wrong_word_is_a_usage_error() {
    assert_eq!(terrasense(&["drive"]).status.code(), Some(64));
    assert_eq!(terrasense(&["replay"]).status.code(), Some(64));
}

#[test]
fn the_status_of_what_does_not_run_is_an_error_of_its_own() {
    let output = terrasense(&["status", "--name", "never_started"]);
    assert_eq!(output.status.code(), Some(69));
    assert!(String::from_utf8_lossy(&output.stderr).contains("terrasense up"));
}

#[test]
fn completions_are_printed_for_the_usual_shells() {
    for shell in ["bash", "zsh", "fish"] {
        assert!(terrasense(&["completions", shell]).stdout.len() > 1000, "{shell}");
    }
}
