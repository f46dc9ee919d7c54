//! Recorded traverses to test with: small ones made here, in the documented format.

use crate::rover::told;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A traverse folder of its own, gone when the test is over.
pub struct Traverse {
    pub folder: TempDir,
}

const DESCRIPTION: &str = "[wheel]\nradius_m = 0.15\nwidth_m = 0.16\n\n[soil]\nshear_modulus_m = 0.025\n\n\
                           [sensors]\nload_sigma = 0.03\ntorque_sigma = 0.03\nentry_sigma_rad = 0.0175\nslip_sigma = 0.02\n";

impl Traverse {
    /// Wheel telemetry, measured angles and two channels of vibration over ten seconds.
    pub fn without_pictures() -> Self {
        let traverse = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        traverse.write("traverse.toml", DESCRIPTION.as_bytes());
        let mut wheel = String::from("taken_s,load_n,torque_nm,angular_velocity_rad_s,linear_velocity_m_s\n");
        let mut sinkage = String::from("taken_s,entry_rad,exit_rad\n");
        let mut vibration = String::from("taken_s,acceleration_z_m_s2,angular_rate_x_rad_s\n");
        for row in 0..1000 {
            let taken_s = f64::from(row) * 0.01;
            let sway = (f64::from(row) * 0.13).sin();
            writeln!(wheel, "{taken_s:.2},90,{:.4},0.4,{:.5}", 3.0 + sway, 0.04 - 0.01 * sway).unwrap();
            writeln!(vibration, "{taken_s:.2},{:.5},{:.6}", 9.81 + 0.3 * sway, 0.01 * sway).unwrap();
            if row % 5 == 0 {
                writeln!(sinkage, "{taken_s:.2},{:.5},{:.5}", 0.4 + 0.02 * sway, -0.1).unwrap();
            }
        }
        traverse.write("wheel.csv", wheel.as_bytes());
        traverse.write("sinkage.csv", sinkage.as_bytes());
        traverse.write("vibration.csv", vibration.as_bytes());
        traverse
    }

    /// The same with pictures of the simulated rover instead of measured angles.
    pub fn with_pictures(seconds: u32) -> Self {
        let traverse = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        let folder = traverse.folder.path().display().to_string();
        let seconds = seconds.to_string();
        let (code, text) = told(&[
            "simulate",
            "--out",
            &folder,
            "--seconds",
            &seconds,
            "--rate-hz",
            "5",
            "--force",
        ]);
        assert_eq!(code, 0, "{text}");
        traverse
    }

    pub fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    pub fn write(&self, file: &str, bytes: &[u8]) {
        std::fs::write(self.path(file), bytes).unwrap();
    }

    pub fn remove(&self, file: &str) {
        std::fs::remove_file(self.path(file)).unwrap();
    }

    pub fn edit(&self, file: &str, edit: impl Fn(String) -> String) {
        let text = std::fs::read_to_string(self.path(file)).unwrap();
        self.write(file, edit(text).as_bytes());
    }

    /// Replays into a folder beside the recording; the exit code and what was printed.
    pub fn replay(&self, out: &str) -> (i32, String) {
        let out = self.path(out).display().to_string();
        told(&["replay", &self.folder.path().display().to_string(), "--out", &out])
    }
}

/// Whether a folder is not there or empty.
pub fn is_clean(folder: &Path) -> bool {
    std::fs::read_dir(folder).map_or(true, |entries| entries.count() == 0)
}
