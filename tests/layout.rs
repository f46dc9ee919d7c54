//! The Python and C++ twins of the messages have Rust's layouts, offset by offset, and Rust's constants.

use messages::{Frame, Header, Message, Sinkage, Soil, Supervision, Terrain, TerrainClass, Vibration, Wheel};
use messages::{ServiceState, Status, difference, fingerprint};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

#[test]
fn the_python_twin_has_the_layouts_and_constants_of_rust() {
    let Some(printed) = python_table(&twins().join("python")) else {
        return;
    };
    assert_same(&printed, &[layouts(), constants()].concat());
}

#[test]
fn the_cpp_twin_has_the_layouts_and_constants_of_rust() {
    let Some(printed) = cpp_table(&twins().join("cpp")) else {
        return;
    };
    assert_same(&printed, &layouts());
}

#[test]
fn two_swapped_fields_of_a_twin_are_told_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let twin = std::fs::read_to_string(twins().join("python/terrasense_messages.py")).unwrap();
    let swapped = twin
        .replace("(\"load_n\"", "(\"x\"")
        .replace("(\"torque_nm\"", "(\"load_n\"");
    std::fs::write(
        folder.path().join("terrasense_messages.py"),
        swapped.replace("(\"x\"", "(\"torque_nm\""),
    )
    .unwrap();

    let Some(printed) = python_table(folder.path()) else {
        return;
    };
    let expected = [layouts(), constants()].concat();
    let told: Vec<String> = expected
        .iter()
        .zip(&printed)
        .map(|(ours, theirs)| difference(ours, theirs))
        .collect();
    let swap = "  - load_n:f64@32\n  - torque_nm:f64@40\n  + torque_nm:f64@32\n  + load_n:f64@40";
    assert_eq!(told.concat(), swap);
}

fn twins() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/messages")
}

/// The fingerprint of each type that crosses a process boundary.
fn layouts() -> Vec<String> {
    vec![
        fingerprint("Header/1", size_of::<Header>(), Header::FIELDS),
        Frame::fingerprint(),
        Wheel::fingerprint(),
        Vibration::fingerprint(),
        Sinkage::fingerprint(),
        Soil::fingerprint(),
        TerrainClass::fingerprint(),
        Terrain::fingerprint(),
        Supervision::fingerprint(),
    ]
}

/// Each constant: `Status::OK 0`.
fn constants() -> Vec<String> {
    let words = |kind: &'static str, word: fn(u32) -> Option<&'static str>| {
        let named = (0..).map_while(move |number| Some((word(number)?, number)));
        named.map(move |(word, number)| format!("{kind}::{} {number}", word.to_uppercase()))
    };
    let parts = [
        ("SINKAGE", Terrain::SINKAGE),
        ("SOIL", Terrain::SOIL),
        ("STRENGTH", Terrain::STRENGTH),
        ("CLASS", Terrain::CLASS),
    ];
    words("Status", |number| Status(number).word())
        .chain(words("Reason", Soil::reason_word))
        .chain(parts.map(|(name, bit)| format!("Part::{name} {bit}")))
        .chain(words("ServiceState", |number| ServiceState(number).word()))
        .collect()
}

fn python_table(folder: &Path) -> Option<Vec<String>> {
    let script = "
import terrasense_messages as twin
print(twin.layout(twin.Header, 'Header/1'))
for message in twin.MESSAGES:
    print(message.fingerprint())
for kind in (twin.Status, twin.Reason, twin.Part, twin.ServiceState):
    for constant in kind:
        print(f'{kind.__name__}::{constant.name} {constant.value}')
";
    let output = run(Command::new("python3")
        .args(["-B", "-c", script])
        .env("PYTHONPATH", folder))?;
    Some(lines(&output))
}

/// The compiler itself compares the constants: C++ cannot list them.
fn cpp_table(folder: &Path) -> Option<Vec<String>> {
    let names = layouts()
        .iter()
        .map(|layout| layout.split('/').next().unwrap_or("").to_string())
        .collect::<Vec<_>>();
    let prints = names
        .iter()
        .map(|name| format!("std::puts(fingerprint<{name}>().c_str());\n"))
        .collect::<String>();
    let asserts = constants()
        .iter()
        .filter_map(|constant| constant.split_once(' '))
        .map(|(name, number)| format!("static_assert(static_cast<unsigned>({name}) == {number});\n"))
        .collect::<String>();
    let program = format!(
        "#include \"terrasense_messages.hpp\"\n#include <cstdio>\nusing namespace terrasense;\n{asserts}int main() {{\n{prints}}}\n"
    );
    let build = tempfile::tempdir().expect("a folder for what is compiled");
    let (source, binary) = (build.path().join("table.cpp"), build.path().join("table"));
    std::fs::write(&source, program).expect("a written source file");
    let mut compiler = Command::new("c++");
    compiler
        .args(["-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
        .arg(folder);
    lines(&run(compiler.arg(&source).arg("-o").arg(&binary))?);
    Some(lines(&run(&mut Command::new(binary))?))
}

/// `None`, and a word about it, where the program is not installed.
fn run(command: &mut Command) -> Option<Output> {
    match command.output() {
        Ok(output) => Some(output),
        Err(error) if error.kind() == ErrorKind::NotFound => {
            println!("not compared: {} is not installed", command.get_program().display());
            None
        }
        Err(error) => panic!("{}: {error}", command.get_program().display()),
    }
}

fn lines(output: &Output) -> Vec<String> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .map(str::to_string)
        .collect()
}

fn assert_same(printed: &[String], expected: &[String]) {
    for (theirs, ours) in printed.iter().zip(expected) {
        assert!(
            ours == theirs,
            "a twin differs from Rust (- Rust, + twin):\n{}",
            difference(ours, theirs)
        );
    }
    assert_eq!(
        printed.len(),
        expected.len(),
        "a twin has another number of messages or constants"
    );
}
