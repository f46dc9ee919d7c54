//! Tells the tests which optional parts are there, so that the others are reported as ignored.

use std::path::Path;

fn main() {
    let python = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/peer/bin/python3");
    println!("cargo::rustc-check-cfg=cfg(python_peer)");
    println!("cargo::rerun-if-changed={}", python.display());
    if python.exists() {
        println!("cargo::rustc-cfg=python_peer");
    }
}
