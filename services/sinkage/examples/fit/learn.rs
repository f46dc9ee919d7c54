//! Conditional logit over lines, then a small hidden layer over the lines that it leaves: both by Adam.

use sinkage::contrast::Contrast;
use sinkage::lines::PART;
use sinkage::posterior::{BINS, Posterior};
use sinkage::weights::{FEATURES, UNITS, Unit, Weights};
use std::ops::Range;
use std::thread;

/// Distance from the truth at which a line counts e^-½, in outer radii.
const NEAR: f32 = 0.006;
/// Lines that score this much less than the best are left out of the second fit, as they are of the posterior.
const SPAN: f32 = 12.0;
/// What no side's likelihood falls below, so that a hopeless one does not lead the fit.
const HOPELESS: f32 = 1e-3;

/// One side of one frame.
pub struct Side {
    /// Cosine of the true angle.
    pub truth: f32,
    /// Features of each line.
    pub lines: Vec<[f32; FEATURES]>,
    /// Height at which each line meets the outer circle.
    pub heights: Vec<f32>,
}

impl Side {
    /// All lines that `contrast` has measured.
    pub fn of(contrast: &Contrast, truth: f32) -> Self {
        let mut side = Self {
            truth,
            lines: Vec::new(),
            heights: Vec::new(),
        };
        for (tilt, parts) in contrast.known.iter().enumerate() {
            for (part, known) in parts.iter().enumerate() {
                let features = contrast.features(tilt, part);
                for line in (0..PART).filter(|line| known[*line] > 0.0) {
                    side.lines.push(features.map(|values| values[line]));
                    side.heights.push(contrast.heights[tilt][part][line]);
                }
            }
        }
        side
    }

    /// Without the lines that the linear score rules out.
    fn reduced(&self, weights: &Weights) -> Self {
        let scores: Vec<f32> = self.lines.iter().map(|line| linear(weights, line)).collect();
        let best = scores.iter().copied().fold(f32::MIN, f32::max);
        let kept = |k: &usize| scores[*k] > best - SPAN;
        Self {
            truth: self.truth,
            lines: (0..scores.len()).filter(kept).map(|k| self.lines[k]).collect(),
            heights: (0..scores.len()).filter(kept).map(|k| self.heights[k]).collect(),
        }
    }
}

fn linear(weights: &Weights, line: &[f32; FEATURES]) -> f32 {
    weights
        .features
        .iter()
        .zip(line)
        .map(|(weight, value)| weight * value)
        .sum()
}

/// What the tracker makes of a side, line by line.
pub fn posterior(side: &Side, weights: &Weights) -> Posterior {
    let first: Vec<f32> = side.lines.iter().map(|line| linear(weights, line)).collect();
    let floor = first.iter().copied().fold(f32::MIN, f32::max) - SPAN;
    let unit = |unit: &Unit, line: &[f32; FEATURES]| {
        let input: f32 = unit
            .weights
            .iter()
            .zip(line)
            .map(|(weight, value)| weight * value)
            .sum();
        unit.out * (unit.bias + input).max(0.0)
    };
    let hidden = |line: &[f32; FEATURES]| weights.units.iter().map(|it| unit(it, line)).sum::<f32>();
    let lines = side
        .lines
        .iter()
        .zip(&side.heights)
        .zip(&first)
        .filter(|(_, score)| **score > floor);
    let scores: Vec<(f32, f32)> = lines
        .map(|((line, height), score)| (*height, score + hidden(line)))
        .collect();
    let best = scores.iter().map(|(_, score)| *score).fold(f32::MIN, f32::max);
    let mut posterior = Posterior {
        mass: [0.0; BINS],
        pictures: 1.0,
    };
    for (height, score) in scores {
        posterior.mass[((height * BINS as f32) as usize).min(BINS - 1)] += (weights.temper * (score - best)).exp();
    }
    posterior.normalize();
    posterior
}

/// Features of a line, and zeros up to whole vectors.
type Line = [f32; LANES * FEATURES.div_ceil(LANES)];
const LANES: usize = 8;
const LENGTH: usize = size_of::<Line>() / size_of::<f32>();
/// The weights of all features, then of each unit: what it counts for, what it begins at, and its weights.
const PARAMETERS: usize = LENGTH + UNITS * (LENGTH + 2);

/// Mean log probability of what is about the truth.
pub fn likelihood(sides: &[Side], weights: &Weights) -> f32 {
    let of_one = |side: &Side| posterior(side, weights).near(side.truth).max(HOPELESS).ln();
    sides.iter().map(of_one).sum::<f32>() / sides.len() as f32
}

/// Fits weights to sides, from several beginnings; the best is the one that makes the unseen sides the most likely.
pub fn fit(sides: &[Side], unseen: &[Side], seeds: Range<u64>) -> Option<Weights> {
    let scale = scale(sides);
    let mut parameters = [0.0; PARAMETERS];
    let linear = Descent {
        hidden: false,
        seed: seeds.start,
        epochs: 30,
        rate: 0.05,
        ridge: 1e-3,
    };
    linear.run(sides, &scale, &mut parameters);
    let weights = unpack(&parameters, &scale);
    let reduced: Vec<Side> = sides.iter().map(|side| side.reduced(&weights)).collect();
    let begin = |seed: u64| {
        let mut random = Random(seed);
        let mut parameters = parameters;
        for (k, parameter) in parameters.iter_mut().enumerate().skip(LENGTH) {
            let within = (k - LENGTH) % (LENGTH + 2);
            *parameter = if within == 0 { 0.0 } else { 0.6 * random.symmetric() };
        }
        let whole = Descent {
            hidden: true,
            seed,
            epochs: 60,
            rate: 0.01,
            ridge: 3e-4,
        };
        whole.run(&reduced, &scale, &mut parameters);
        let weights = unpack(&parameters, &scale);
        (likelihood(unseen, &weights), weights)
    };
    thread::scope(|scope| {
        let begin = &begin;
        let workers: Vec<_> = seeds.map(|seed| scope.spawn(move || begin(seed))).collect();
        let fits = workers.into_iter().filter_map(|worker| worker.join().ok());
        fits.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, weights)| weights)
    })
}

/// Root mean square of each feature.
fn scale(sides: &[Side]) -> [f32; FEATURES] {
    let mut scale = [1e-6_f32; FEATURES];
    let count: usize = sides.iter().map(|side| side.lines.len()).sum();
    for line in sides.iter().flat_map(|side| &side.lines) {
        for (scale, value) in scale.iter_mut().zip(line) {
            *scale += value * value / count as f32;
        }
    }
    scale.map(f32::sqrt)
}

fn unpack(parameters: &[f32; PARAMETERS], scale: &[f32; FEATURES]) -> Weights {
    let (features, units) = parameters.split_at(LENGTH);
    Weights {
        features: std::array::from_fn(|k| features[k] / scale[k]),
        units: std::array::from_fn(|unit| {
            let unit = &units[unit * (LENGTH + 2)..];
            Unit {
                out: unit[0],
                bias: unit[1],
                weights: std::array::from_fn(|k| unit[2 + k] / scale[k]),
            }
        }),
        bias: 0.0,
        sigma: 0.006,
        temper: 1.0,
    }
}

/// Adam over batches of sides.
struct Descent {
    /// Whether the units count, and are fitted.
    hidden: bool,
    seed: u64,
    epochs: usize,
    /// What the steps begin at; they fall to nothing.
    rate: f32,
    /// Pull to nothing.
    ridge: f32,
}

impl Descent {
    fn run(&self, sides: &[Side], scale: &[f32; FEATURES], parameters: &mut [f32; PARAMETERS]) {
        const BATCH: usize = 16;
        let inverse = scale.map(f32::recip);
        let lines: Vec<Vec<Line>> = sides
            .iter()
            .map(|side| side.lines.iter().map(|line| scaled(line, &inverse)).collect())
            .collect();
        let mut random = Random(self.seed ^ 0x5eed);
        let (mut mean, mut square) = ([0.0_f32; PARAMETERS], [0.0_f32; PARAMETERS]);
        let mut order: Vec<usize> = (0..sides.len()).collect();
        let (mut step, steps) = (0, self.epochs * sides.len().div_ceil(BATCH));
        for _ in 0..self.epochs {
            for k in (1..order.len()).rev() {
                order.swap(k, random.below(k + 1));
            }
            for batch in order.chunks(BATCH) {
                let mut gradient = [0.0; PARAMETERS];
                for side in batch {
                    accumulate(&sides[*side], &lines[*side], parameters, self.hidden, &mut gradient);
                }
                step += 1;
                let rate = self.rate * (1.0 - step as f32 / (steps as f32 + 1.0));
                let (first, second) = (1.0 - 0.9_f32.powi(step), 1.0 - 0.99_f32.powi(step));
                for k in 0..PARAMETERS {
                    let slope = gradient[k] / batch.len() as f32 + 2.0 * self.ridge * parameters[k];
                    mean[k] += 0.1 * (slope - mean[k]);
                    square[k] += 0.01 * (slope * slope - square[k]);
                    if self.hidden || k < LENGTH {
                        parameters[k] -= rate * (mean[k] / first) / ((square[k] / second).sqrt() + 1e-8);
                    }
                }
            }
        }
    }
}

/// Adds the gradient of -ln(mass near the truth) of one side.
fn accumulate(
    side: &Side,
    lines: &[Line],
    parameters: &[f32; PARAMETERS],
    hidden: bool,
    gradient: &mut [f32; PARAMETERS],
) {
    let near: Vec<f32> = side
        .heights
        .iter()
        .map(|height| (-0.5 * ((height - side.truth) / NEAR).powi(2)).exp())
        .collect();
    if !near.iter().any(|near| *near > 0.1) {
        return;
    }
    let units = if hidden { UNITS } else { 0 };
    let unit = |k: usize| &parameters[LENGTH + k * (LENGTH + 2)..][..LENGTH + 2];
    let mut active = vec![[0.0_f32; UNITS]; lines.len()];
    let mut scores = vec![0.0_f32; lines.len()];
    for ((line, active), score) in lines.iter().zip(&mut active).zip(&mut scores) {
        *score = dot(&parameters[..LENGTH], line);
        for (k, active) in active.iter_mut().enumerate().take(units) {
            let unit = unit(k);
            *active = (unit[1] + dot(&unit[2..], line)).max(0.0);
            *score += unit[0] * *active;
        }
    }
    let best = scores.iter().copied().fold(f32::MIN, f32::max);
    let mut total = 0.0;
    for score in &mut scores {
        *score = (*score - best).exp();
        total += *score;
    }
    let mass: f32 = scores.iter().zip(&near).map(|(p, near)| p / total * near).sum();
    for (((line, active), score), near) in lines.iter().zip(&active).zip(&scores).zip(&near) {
        let p = score / total;
        let slope = -p * (near - mass) / (mass + HOPELESS);
        if slope.abs() < 1e-7 {
            continue;
        }
        for (gradient, value) in gradient.iter_mut().zip(line) {
            *gradient += slope * value;
        }
        for k in 0..units {
            let gradient = &mut gradient[LENGTH + k * (LENGTH + 2)..][..LENGTH + 2];
            gradient[0] += slope * active[k];
            if active[k] > 0.0 {
                let slope = slope * unit(k)[0];
                gradient[1] += slope;
                for (gradient, value) in gradient[2..].iter_mut().zip(line) {
                    *gradient += slope * value;
                }
            }
        }
    }
}

fn scaled(line: &[f32; FEATURES], inverse: &[f32; FEATURES]) -> Line {
    std::array::from_fn(|k| line.get(k).map_or(0.0, |value| value * inverse[k]))
}

/// The product of two vectors, in several sums at once.
fn dot(a: &[f32], b: &Line) -> f32 {
    let mut sums = [0.0; LANES];
    for (a, b) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    sums.iter().sum()
}

/// `SplitMix64`.
pub struct Random(pub u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    fn below(&mut self, end: usize) -> usize {
        (self.bits() % end.max(1) as u64) as usize
    }

    /// Uniform in -1..1.
    pub fn symmetric(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
}
