//! Fits the weights of the contrast method on rendered scenes, calibrates them on others, and prints the weights file:
//!
//! ```text
//! cargo run --release -p sinkage --example fit > weights.txt && mv weights.txt services/sinkage/src/
//! ```
//!
//! The scenes are of both of the simulation's renderers, and drawings, so that what the weights rely on is not how one of
//! them paints.

mod drawing;
mod learn;

use learn::Side;
use messages::Frame;
use simulation::Rover;
use simulation::conditions::{Clip, Condition};
use sinkage::annulus::Annulus;
use sinkage::cells::{Cells, log_table};
use sinkage::center::Shift;
use sinkage::contrast::Contrast;
use sinkage::interface::Interface;
use sinkage::rim::Rim;
use sinkage::weights::{NAMES, Unit, Weights};
use std::ops::Range;
use std::thread;
use zerocopy::FromZeros;

/// Seeds of the clips of each condition.
const FITTED: Range<u64> = 1000..2000;
const CALIBRATED: Range<u64> = 100_000..100_060;
/// Seeds of the rovers, and the times at which each of them is looked at.
const ROVERS: Range<u64> = 3000..3060;
const TIMES_S: [f64; 10] = [2.0, 13.0, 24.0, 35.0, 46.0, 57.0, 68.0, 79.0, 90.0, 101.0];
/// Seeds of the drawings.
const DRAWINGS: Range<u64> = 5000..5300;
/// Seeds of the fits.
const BEGINNINGS: Range<u64> = 1..5;

/// What one frame is drawn of.
#[derive(Clone, Copy)]
enum Scene {
    Clip(Condition, u64),
    Rover(u64, f64),
    Drawing(u64),
}

fn main() {
    let clips = |seeds: Range<u64>| seeds.flat_map(|seed| Condition::ALL.map(|condition| Scene::Clip(condition, seed)));
    let rovers = ROVERS.flat_map(|seed| TIMES_S.map(|time_s| Scene::Rover(seed, time_s)));
    let fitted: Vec<Scene> = clips(FITTED)
        .chain(rovers)
        .chain(DRAWINGS.map(Scene::Drawing))
        .collect();
    let unseen: Vec<Scene> = clips(CALIBRATED).collect();
    eprintln!(
        "painting {} frames: on two cores ten minutes",
        fitted.len() + unseen.len()
    );
    let (fitted, unseen) = (sides(&fitted), sides(&unseen));
    eprintln!(
        "fitting {} sides, {} times: four minutes",
        fitted.len(),
        BEGINNINGS.count()
    );
    if let Some(weights) = learn::fit(&fitted, &unseen, BEGINNINGS) {
        print!("{}", text(&calibrated(weights, &unseen)));
    }
}

/// Both sides of one frame of each scene.
fn sides(scenes: &[Scene]) -> Vec<Side> {
    let threads = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        let parts = scenes.chunks(scenes.len().div_ceil(threads).max(1));
        let workers: Vec<_> = parts.map(|part| scope.spawn(|| measure(part))).collect();
        workers
            .into_iter()
            .flat_map(|worker| worker.join().unwrap_or_default())
            .collect()
    })
}

fn measure(scenes: &[Scene]) -> Vec<Side> {
    let table = log_table();
    let mut contrast = Contrast::new();
    let mut annulus = Annulus::new();
    let mut cells = Box::new([Cells::EMPTY, Cells::EMPTY]);
    let mut rings = [[0.0; sinkage::rows::ROWS]; 2];
    let mut sides = Vec::new();
    let Ok(mut frame) = Frame::new_box_zeroed() else {
        return sides;
    };
    for scene in scenes {
        let angles = match *scene {
            Scene::Clip(condition, seed) => {
                let truth = Clip::new(condition, seed).paint(0.0, &mut frame);
                [truth.left_rad, truth.right_rad]
            }
            Scene::Rover(seed, time_s) => {
                let rover = Rover::new(simulation::Config {
                    seed,
                    ..simulation::Config::default()
                });
                rover.render(time_s, &mut frame);
                let state = rover.state(time_s);
                [-state.exit_rad, state.entry_rad]
            }
            Scene::Drawing(seed) => drawing::draw(seed, &mut frame),
        };
        let (width, height) = (frame.width as usize, frame.height as usize);
        let Ok(rim) = Rim::locate(&frame, width, height) else {
            continue;
        };
        let shift = Shift::find(frame.image(), width, &frame).unwrap_or(Shift::NONE);
        annulus.follow(&rim, shift, width, height);
        annulus.measure(frame.image(), &table, &mut cells, &mut rings);
        for (side, angle) in angles.into_iter().enumerate() {
            contrast.measure(&cells[side], &rings[side]);
            annulus.mark(side, &mut contrast);
            sides.push(Side::of(&contrast, angle.cos() as f32));
        }
    }
    sides
}

/// Chooses how sharp the probabilities are, and what error remains, from scenes that were not fitted.
fn calibrated(fitted: Weights, sides: &[Side]) -> Weights {
    let mut weights = fitted;
    let likelihood = |temper: f32| {
        let mut weights = fitted;
        weights.temper = temper;
        learn::likelihood(sides, &weights)
    };
    let tempers = (8..=24).map(|step| 0.05 * step as f32);
    let best = tempers
        .map(|temper| (likelihood(temper), temper))
        .max_by(|a, b| a.0.total_cmp(&b.0));
    weights.temper = best.map_or(1.0, |(_, temper)| temper);
    let error = |side: &Side| {
        let Interface { cosine, .. } = learn::posterior(side, &weights).interface(&weights)?;
        Some(cosine as f32 - side.truth)
    };
    let mut errors: Vec<f32> = sides
        .iter()
        .filter_map(error)
        .filter(|error| error.abs() < 0.02)
        .collect();
    errors.sort_by(f32::total_cmp);
    weights.bias = errors.get(errors.len() / 2).copied().unwrap_or(0.0);
    // Of the errors that are none of taking something else for the soil, 95 % lie within two sigma.
    let mut sizes: Vec<f32> = errors.iter().map(|error| (error - weights.bias).abs()).collect();
    sizes.sort_by(f32::total_cmp);
    weights.sigma = 0.5 * sizes.get(sizes.len() * 95 / 100).copied().unwrap_or(0.02);
    weights
}

fn text(weights: &Weights) -> String {
    let numbers = |values: Vec<f32>| values.iter().map(|value| format!(" {value:.4e}")).collect::<String>();
    let units = |of: fn(&Unit) -> f32| numbers(weights.units.iter().map(of).collect());
    let mut text = format!(
        "# Weights of the contrast method, printed by `cargo run --release -p sinkage --example fit` from one frame of each of the\n\
         # scenes {FITTED:?} of the six conditions in shared/simulation and {} frames of each of its rovers {ROVERS:?}, and the\n\
         # drawings {DRAWINGS:?}; bias, sigma, temper and which of the fits {BEGINNINGS:?}: from the scenes {CALIBRATED:?}.\n\
         # A feature's line: its weight in the score, then in each unit of the hidden layer.\n",
        TIMES_S.len()
    );
    for (k, name) in NAMES.iter().enumerate() {
        let values = [weights.features[k]]
            .into_iter()
            .chain(weights.units.iter().map(|unit| unit.weights[k]));
        text += &format!("{name}{}\n", numbers(values.collect()));
    }
    text += &format!(
        "units_out{}\nunits_bias{}\n",
        units(|unit| unit.out),
        units(|unit| unit.bias)
    );
    text + &format!(
        "bias {:.4}\nsigma {:.4}\ntemper {:.2}\n",
        weights.bias, weights.sigma, weights.temper
    )
}
