//! What bytes from outside go into: a target each, which must neither panic nor take without end, whatever the bytes are.
//!
//! `cargo test` runs each target over its corpus and over seeded mutations of it; `libfuzzer/` hands the same functions to
//! cargo-fuzz:
//!
//! ```text
//! cargo +nightly fuzz run --fuzz-dir tests/fuzz/libfuzzer --target-dir target/fuzz wheel_csv tests/fuzz/corpus/wheel_csv
//! ```

mod files;
mod pictures;
mod samples;
/// The launcher is a program without a lib; its graph check needs nothing of the rest of it.
#[path = "../../launcher/src/system.rs"]
pub mod system;

/// A function into which untrusted bytes go.
pub struct Target {
    /// Its name: that of its corpus folder, and of its program in `libfuzzer/`.
    pub name: &'static str,
    /// Takes the bytes in. Panics where a promise is broken.
    pub run: fn(&[u8]),
    /// Mutations that `cargo test` tries: so many take about a second at the most.
    pub mutations: u64,
}

/// All targets.
pub const TARGETS: [Target; 15] = [
    target("system_toml", files::system_toml, 3_000),
    target("description_toml", files::description_toml, 10_000),
    target("frames_csv", files::frames_csv, 10_000),
    target("wheel_csv", files::wheel_csv, 8_000),
    target("sinkage_csv", files::sinkage_csv, 8_000),
    target("vibration_csv", files::vibration_csv, 8_000),
    target("vibration_wav", files::vibration_wav, 8_000),
    target("vibration_model", files::vibration_model, 300),
    target("picture", pictures::picture, 1_000),
    target("frame_sample", pictures::frame_sample, 700),
    target("samples", samples::samples, 20_000),
    target("soil_stage", samples::soil_stage, 800),
    target("soil_checkpoint", samples::soil_checkpoint, 100),
    target("class_stage", samples::class_stage, 1_500),
    target("terrain_stage", samples::terrain_stage, 10_000),
];

const fn target(name: &'static str, run: fn(&[u8]), mutations: u64) -> Target {
    Target { name, run, mutations }
}

/// Runs the target of this name.
///
/// # Panics
/// There is none, or a promise is broken.
pub fn run(name: &str, bytes: &[u8]) {
    let found = TARGETS.iter().find(|target| target.name == name);
    (found.expect("a target of this name").run)(bytes);
}
