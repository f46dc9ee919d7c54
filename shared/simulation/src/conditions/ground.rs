//! The terrain around a wheel as a height field: slope, undulation, berm, rut, grains, stones and rocks.

use super::Condition;
use crate::noise::{Dice, fractal, value_noise};

/// Side of a cell, in wheel radii.
const CELL: f64 = 0.008;
const X: (f64, f64) = (-1.7, 1.7);
/// From the camera's side to behind the wheel, whose face is at 0.
pub(super) const Y: (f64, f64) = (-4.6, 0.8);
const COLUMNS: usize = ((X.1 - X.0) / CELL) as usize + 2;
const ROWS: usize = ((Y.1 - Y.0) / CELL) as usize + 2;

/// What a clip's terrain is like; lengths in wheel radii, x to the right, y away from the camera, heights upwards.
#[derive(Clone, Debug)]
pub(super) struct Terrain {
    seed: u64,
    base: f64,
    sweep: f64,
    sweep_phase: f64,
    slope: f64,
    slope_away: f64,
    undulation: f64,
    berm: f64,
    berm_side: f64,
    rut: f64,
    fine: f64,
    fine_scale: f64,
    albedo: f64,
    grain: f64,
    grain_scale: f64,
    cracks: f64,
    stones: usize,
    stone_size: f64,
    stone_contrast: f64,
    rocks: usize,
}

impl Terrain {
    pub(super) fn new(condition: Condition, dice: &mut Dice) -> Self {
        let part = dice.unit();
        // One wheel in fifty is deeper in the soil than a rover should ever let it be.
        let base = 0.03 + 0.25 * part.powf(1.2) + 18.0 * (part - 0.98).max(0.0);
        let (slope, undulation) = match condition {
            Condition::Uneven => (dice.sym(0.28), dice.range(0.01, 0.07)),
            Condition::Gravel => (dice.sym(0.06), dice.range(0.0, 0.03)),
            Condition::Flat => (dice.sym(0.03), dice.range(0.0, 0.012)),
            Condition::Bentonite => (dice.sym(0.07), dice.range(0.0, 0.03)),
            Condition::Sun | Condition::Strobe => (dice.sym(0.09), dice.range(0.0, 0.04)),
        };
        let fine = match condition {
            Condition::Gravel => 0.006,
            Condition::Sun => dice.range(0.003, 0.014),
            Condition::Strobe => dice.range(0.002, 0.01),
            Condition::Bentonite => dice.range(0.002, 0.008),
            Condition::Flat | Condition::Uneven => dice.range(0.001, 0.006),
        };
        let albedo = match condition {
            Condition::Bentonite => dice.range(0.62, 0.88),
            Condition::Gravel => dice.range(0.18, 0.45),
            Condition::Strobe => dice.range(0.10, 0.45),
            Condition::Sun => dice.range(0.3, 0.8),
            Condition::Flat | Condition::Uneven => dice.range(0.2, 0.85),
        };
        let grain = match condition {
            Condition::Gravel => dice.range(0.08, 0.25),
            Condition::Bentonite => dice.range(0.02, 0.08),
            Condition::Flat => dice.range(0.03, 0.12),
            _ => dice.range(0.04, 0.18),
        };
        let stony = match condition {
            Condition::Gravel => true,
            Condition::Strobe => dice.chance(0.5),
            Condition::Uneven => dice.chance(0.15),
            _ => false,
        };
        let rocks = match condition {
            Condition::Gravel => dice.range(3.0, 16.0),
            Condition::Strobe => dice.range(0.0, 7.0),
            Condition::Uneven | Condition::Sun if dice.chance(0.4) => dice.range(0.0, 6.0),
            _ => 0.0,
        };
        Self {
            seed: dice.bits(),
            base,
            sweep: dice.sym(0.10),
            sweep_phase: dice.range(0.0, std::f64::consts::TAU),
            slope,
            slope_away: dice.sym(0.03),
            undulation,
            berm: if dice.chance(0.6) { dice.range(0.0, 0.06) } else { 0.0 },
            berm_side: if dice.chance(0.5) { 1.0 } else { -1.0 },
            rut: if dice.chance(0.4) { dice.range(0.0, 0.04) } else { 0.0 },
            fine,
            fine_scale: dice.range(8.0, 25.0),
            albedo,
            grain,
            grain_scale: dice.range(6.0, 40.0),
            cracks: if condition == Condition::Bentonite && dice.chance(0.6) {
                dice.range(0.05, 0.2)
            } else {
                0.0
            },
            stones: if stony { dice.range(4000.0, 16000.0) as usize } else { 0 },
            stone_size: dice.range(0.012, 0.035),
            stone_contrast: dice.range(0.15, 0.5),
            rocks: rocks as usize,
        }
    }

    /// The ground when the wheel has come `travel` radii, `sway` radians into the slow change of its sinkage.
    pub(super) fn ground(&self, travel: f64, sway: f64) -> Ground {
        let depth = (self.base + self.sweep * (sway + self.sweep_phase).sin()).clamp(0.02, 0.75);
        let mut ground = Ground {
            height: vec![0.0; COLUMNS * ROWS],
            soil_height: Vec::new(),
            albedo: vec![0.0; COLUMNS * ROWS],
            fine: self.fine,
            seed: self.seed ^ 77,
        };
        let reach = (1.0 - depth).acos().sin();
        for j in 0..ROWS {
            let y = Y.0 + j as f64 * CELL;
            let near = (-(y.min(0.0) / 0.35).powi(2)).exp();
            for i in 0..COLUMNS {
                let x = X.0 + i as f64 * CELL;
                let edge = (-((x - self.berm_side * (reach + 0.12)) / 0.16).powi(2)).exp();
                let behind = smooth((-self.berm_side * x - 0.3 * reach) / 0.3);
                let shape = self.slope * x + self.slope_away * y + near * (self.berm * edge - self.rut * behind);
                let (grains, albedo) = self.surface(x + travel, y);
                ground.height[j * COLUMNS + i] = (depth - 1.0 + shape + grains) as f32;
                ground.albedo[j * COLUMNS + i] = albedo as f32;
            }
        }
        self.strew(&mut ground, travel);
        ground
    }

    /// Height and albedo of the surface itself.
    fn surface(&self, x: f64, y: f64) -> (f64, f64) {
        let seed = self.seed;
        let waves = self.undulation * fractal(seed, x * 1.3, y * 0.7, 2, 0.5);
        let fine = self.fine * fractal(seed ^ 11, x * self.fine_scale, y * self.fine_scale * 0.8, 3, 0.55);
        let grain = self.grain * fractal(seed ^ 23, x * self.grain_scale, y * self.grain_scale, 3, 0.7);
        let albedo = self.albedo * (1.0 + grain + 0.08 * value_noise(seed ^ 29, x * 1.5, y * 0.8));
        let cracked = self.cracks > 0.0 && fractal(seed ^ 37, x * 7.0, y * 7.0, 2, 0.5).abs() < 0.05;
        let (depth, dark) = if cracked {
            (0.004, 1.0 - self.cracks)
        } else {
            (0.0, 1.0)
        };
        (waves + fine - depth, (albedo * dark).max(0.02))
    }

    /// Stones that belong to the soil, then loose rocks in front of the wheel that do not.
    fn strew(&self, ground: &mut Ground, travel: f64) {
        let mut dice = Dice::new(self.seed ^ 0x6007);
        for _ in 0..self.stones {
            let radius = self.stone_size * (0.45 * dice.normal()).exp();
            let (x, y) = (dice.range(X.0, X.1), dice.range(Y.0, Y.1));
            let albedo = self.albedo * (1.0 + self.stone_contrast * dice.normal()).clamp(0.3, 2.2);
            ground.place(&Stone {
                x: wrap(x - travel),
                y,
                radii: [dice.range(0.7, 1.4), dice.range(0.7, 1.4), dice.range(0.3, 0.7)].map(|share| share * radius),
                albedo,
                lift: dice.range(0.3, 0.6),
            });
        }
        ground.soil_height.clone_from(&ground.height);
        for _ in 0..self.rocks {
            let radius = dice.range(0.04, 0.17);
            let (x, y) = (dice.range(X.0, X.1), dice.range(Y.0 + 0.1, -0.15 - radius));
            let albedo = self.albedo * dice.range(0.5, 1.9);
            ground.place(&Stone {
                x: wrap(x - travel),
                y,
                radii: [dice.range(0.8, 1.5), dice.range(0.6, 1.2), dice.range(0.5, 0.8)].map(|share| share * radius),
                albedo: albedo.clamp(0.05, 0.95),
                lift: dice.range(0.4, 0.9),
            });
        }
    }
}

/// An ellipsoid of which the part above the ground is seen.
struct Stone {
    x: f64,
    y: f64,
    radii: [f64; 3],
    albedo: f64,
    /// Share of its height that stands out.
    lift: f64,
}

/// Heights and albedos over a grid.
pub(super) struct Ground {
    height: Vec<f32>,
    /// Without loose rocks.
    soil_height: Vec<f32>,
    albedo: Vec<f32>,
    pub(super) fine: f64,
    pub(super) seed: u64,
}

impl Ground {
    pub(super) fn height(&self, x: f64, y: f64) -> f64 {
        bilinear(&self.height, x, y)
    }

    /// Height of the soil, without loose rocks.
    pub(super) fn soil_height(&self, x: f64, y: f64) -> f64 {
        bilinear(&self.soil_height, x, y)
    }

    pub(super) fn albedo(&self, x: f64, y: f64) -> f64 {
        bilinear(&self.albedo, x, y)
    }

    /// Upward slopes along x and y.
    pub(super) fn slopes(&self, x: f64, y: f64) -> (f64, f64) {
        let e = 0.6 * CELL;
        (
            (self.height(x + e, y) - self.height(x - e, y)) / (2.0 * e),
            (self.height(x, y + e) - self.height(x, y - e)) / (2.0 * e),
        )
    }

    fn place(&mut self, stone: &Stone) {
        let [rx, ry, rz] = stone.radii;
        let cell = |value: f64, from: f64, count: usize| (((value - from) / CELL).max(0.0) as usize).min(count - 1);
        let middle = cell(stone.y, Y.0, ROWS) * COLUMNS + cell(stone.x, X.0, COLUMNS);
        let base = f64::from(self.height[middle]) - (1.0 - stone.lift) * rz;
        for j in cell(stone.y - ry, Y.0, ROWS)..=cell(stone.y + ry + CELL, Y.0, ROWS) {
            for i in cell(stone.x - rx, X.0, COLUMNS)..=cell(stone.x + rx + CELL, X.0, COLUMNS) {
                let u = (X.0 + i as f64 * CELL - stone.x) / rx;
                let v = (Y.0 + j as f64 * CELL - stone.y) / ry;
                let square = 1.0 - u * u - v * v;
                let top = (base + rz * square.max(0.0).sqrt()) as f32;
                let k = j * COLUMNS + i;
                if square > 0.0 && top > self.height[k] {
                    self.height[k] = top;
                    self.albedo[k] = stone.albedo as f32;
                }
            }
        }
    }
}

fn bilinear(grid: &[f32], x: f64, y: f64) -> f64 {
    let column = ((x - X.0) / CELL).clamp(0.0, COLUMNS as f64 - 1.001);
    let row = ((y - Y.0) / CELL).clamp(0.0, ROWS as f64 - 1.001);
    let (u, v) = (column.fract() as f32, row.fract() as f32);
    let k = row as usize * COLUMNS + column as usize;
    let near = grid[k] + u * (grid[k + 1] - grid[k]);
    let far = grid[k + COLUMNS] + u * (grid[k + COLUMNS + 1] - grid[k + COLUMNS]);
    f64::from(near + v * (far - near))
}

fn wrap(x: f64) -> f64 {
    (x - X.0).rem_euclid(X.1 - X.0) + X.0
}

fn smooth(part: f64) -> f64 {
    let part = part.clamp(0.0, 1.0);
    part * part * (3.0 - 2.0 * part)
}
