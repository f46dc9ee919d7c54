//! The tracker on rendered traverses with known truth, on drawn wheels, and on frames no camera would send.

#![allow(clippy::unwrap_used)]

use messages::{Frame, Sinkage};
use sinkage::{Config, SinkageTracker};
use std::path::{Path, PathBuf};
use zerocopy::FromZeros;

fn clip(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("golden/sinkage_sample")
        .join(name)
}

/// The lines of a table after its heading, in cells.
fn table(path: &Path) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines()
        .skip(1)
        .map(|line| line.split(',').map(str::to_owned).collect())
        .collect()
}

fn load(clip: &Path, row: &[String]) -> Box<Frame> {
    let picture = image::open(clip.join(&row[0])).unwrap().into_luma8();
    let numbers: Vec<f64> = row[1..].iter().map(|cell| cell.parse().unwrap()).collect();
    let mut frame = Frame::new_box_zeroed().unwrap();
    (frame.width, frame.height) = picture.dimensions();
    frame.pixels[..picture.len()].copy_from_slice(&picture);
    (frame.center_x_px, frame.center_y_px) = (numbers[1], numbers[2]);
    (frame.rim_radius_px, frame.wheel_radius_px, frame.pitch_rad) = (numbers[3], numbers[4], numbers[5]);
    frame.homography.copy_from_slice(&numbers[6..15]);
    frame
}

/// Every side of a clip: error of 1 - cos θ, its sigma by the way of the angle, and the answer.
fn errors(name: &str) -> Vec<(f64, f64, Sinkage)> {
    let clip = clip(name);
    let mut tracker = SinkageTracker::new(Config::default());
    let mut errors = Vec::new();
    for (row, truth) in table(&clip.join("frames.csv"))
        .iter()
        .zip(table(&clip.join("truth.csv")))
    {
        let answer = tracker.step(&load(&clip, row));
        let sides = [
            (answer.left_rad, answer.left_sigma_rad),
            (answer.right_rad, answer.right_sigma_rad),
        ];
        for ((angle, sigma), truth) in sides.into_iter().zip(&truth[1..3]) {
            errors.push((
                truth.parse::<f64>().unwrap().cos() - angle.cos(),
                sigma * angle.sin(),
                answer,
            ));
        }
    }
    errors
}

#[test]
fn report() {
    for name in ["c1_a", "c2_a", "c3_a", "c4_a", "c5_a", "c6_a"] {
        for (error, sigma, answer) in errors(name) {
            println!(
                "{name} {:+.4} ± {:.4} {:.3} {:?}",
                error,
                sigma,
                answer.confidence,
                answer.header.status.word()
            );
        }
    }
}
