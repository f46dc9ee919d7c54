//! A service is replaced by one line of the system file, in any language.

use crate::recording::Traverse;
use crate::rover::{Rover, pid, signal, told};
use rustix::process::Signal;
use std::path::Path;

/// What runs the Python peer.
pub fn python_sinkage() -> [String; 2] {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    ["../target/peer/bin/python3", "peers/sinkage.py"].map(|path| here.join(path).display().to_string())
}

/// The line that replaces sinkage by the Python peer.
fn with_python_sinkage(text: &str) -> String {
    let line = format!("exec = {:?}", python_sinkage());
    let replaced = text.replace("exec = [\"terrasense-sinkage\"]", &line);
    assert_ne!(replaced, text);
    replaced
}

#[test]
#[cfg_attr(
    not(python_peer),
    ignore = "needs iceoryx2 for Python: python3 -m venv target/peer && target/peer/bin/pip install -r tests/peers/requirements.txt"
)]
fn a_sinkage_service_in_python_takes_its_place_in_the_chain() {
    let mut rover = Rover::new(|text| with_python_sinkage(&text));
    rover.up();
    let answered = |count: u64| {
        move |rows: &[serde_json::Value]| {
            rows.iter().any(|row| {
                row["service"] == "terrain"
                    && row["published"].as_u64() > Some(count)
                    && row["rejected"].as_u64() < row["published"].as_u64()
            })
        }
    };
    rover.until("cycles over the Python service", answered(30));
    let old = pid(&rover.row("sinkage"));
    signal(old, Signal::KILL);
    rover.until("the Python service is back", |rows| {
        rows.iter()
            .any(|row| row["service"] == "sinkage" && row["state"] == "running" && pid(row) != old)
    });
    let cycles = rover.row("terrain")["published"].as_u64().unwrap();
    rover.until("cycles go on", answered(cycles + 30));
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
    assert_eq!(rover.traces(), [""; 0]);
}

#[test]
#[cfg_attr(
    not(python_peer),
    ignore = "needs iceoryx2 for Python: python3 -m venv target/peer && target/peer/bin/pip install -r tests/peers/requirements.txt"
)]
fn a_replay_over_a_python_service_is_as_reproducible_as_any() {
    let traverse = Traverse::with_pictures(2);
    let system = with_python_sinkage(&told(&["default-system"]).1);
    traverse.write("system.toml", system.as_bytes());
    for out in ["first", "second"] {
        let [folder, out, system] = [traverse.path(""), traverse.path(out), traverse.path("system.toml")];
        let (code, text) = told(&[
            "replay",
            folder.to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
            "--system",
            system.to_str().unwrap(),
        ]);
        assert_eq!(code, 0, "{text}");
    }
    let read = |out: &str| std::fs::read_to_string(traverse.path(out).join("terrain.csv")).unwrap();
    assert_eq!(read("first"), read("second"));
    assert_eq!(read("first").lines().count(), 11);
}
