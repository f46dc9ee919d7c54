//! Tells the tests which optional parts are there, so that the others are reported as ignored.

use std::path::Path;

fn main() {
    let peer = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/peer");
    println!("cargo::rustc-check-cfg=cfg(python_peer)");
    println!("cargo::rerun-if-changed={}/pyvenv.cfg", peer.display());
    if peer.join("bin/python3").exists() {
        println!("cargo::rustc-cfg=python_peer");
    }
}
