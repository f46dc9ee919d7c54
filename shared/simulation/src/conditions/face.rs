//! The wheel's face: rim, spokes, hub, grousers, and what light makes of them.

use super::ground::Ground;
use super::light::{Light, Surface};
use super::{Condition, Vector, norm};
use crate::noise::{Dice, fractal, value_noise};
use std::f64::consts::TAU;

#[derive(Clone, Debug)]
pub(super) struct Face {
    /// Inner radius of the rim, in outer radii.
    pub(super) inner: f64,
    spokes: usize,
    spoke_width: f64,
    hub: f64,
    grousers: usize,
    grouser_height: f64,
    bolts: usize,
    pub(super) albedo: f64,
    spoke_albedo: f64,
    hollow: f64,
    rings: f64,
    shine: f64,
    speckle: f64,
    dust: f64,
    /// How conical the rim is.
    bevel: f64,
    seed: u64,
}

impl Face {
    pub(super) fn new(condition: Condition, dice: &mut Dice) -> Self {
        let albedo = match condition {
            Condition::Bentonite => dice.range(0.4, 0.9),
            Condition::Strobe => dice.range(0.35, 0.9),
            _ => dice.range(0.15, 0.9),
        };
        let inner = if dice.chance(0.6) {
            dice.range(0.78, 0.87)
        } else {
            dice.range(0.70, 0.93)
        };
        Self {
            inner,
            spokes: dice.range(3.0, 10.0) as usize,
            spoke_width: dice.range(0.03, 0.11),
            hub: dice.range(0.12, 0.26),
            grousers: if dice.chance(0.3) {
                0
            } else {
                dice.range(10.0, 30.0) as usize
            },
            grouser_height: dice.range(0.02, 0.07),
            bolts: if dice.chance(0.5) {
                dice.range(6.0, 20.0) as usize
            } else {
                0
            },
            albedo,
            spoke_albedo: albedo * dice.range(0.5, 1.0),
            hollow: dice.range(0.02, 0.1),
            rings: dice.range(0.0, 0.05),
            shine: if dice.chance(0.6) { dice.range(0.1, 0.8) } else { 0.0 },
            speckle: dice.range(0.0, 0.3),
            dust: if dice.chance(0.35) { dice.range(0.0, 0.3) } else { 0.0 },
            bevel: dice.range(0.0, 0.3),
            seed: dice.bits(),
        }
    }

    /// Whether the wheel is at a point of its face's plane, `radius` from the hub; `turn` is the angle from a spoke.
    pub(super) fn covers(&self, radius: f64, turn: f64) -> bool {
        let grouser = (turn / TAU * self.grousers as f64).rem_euclid(1.0) < 0.10;
        radius <= 1.0 || (self.grousers > 0 && radius < 1.0 + self.grouser_height && grouser)
    }

    /// Light that a point of the face sends to the eye.
    pub(super) fn shade(&self, spot: &Spot, light: &Light, ground: &Ground) -> f64 {
        let Spot {
            point, radius, turn, ..
        } = *spot;
        let out = norm([point[0], 0.0, point[2]]);
        let flat = |albedo: f64, shine: f64| Surface {
            point,
            normal: [0.0, -1.0, 0.0],
            albedo,
            shine,
            on_wheel: true,
        };
        let surface = if radius >= self.inner {
            let width = (radius - self.inner) / (1.0 - self.inner);
            let slant = if radius > 0.985 {
                0.6
            } else {
                0.1 + self.bevel * (width - 0.5)
            };
            Surface {
                normal: norm([slant * out[0], -1.0, slant * out[2]]),
                ..flat(self.rim_albedo(point, radius, turn, ground), self.shine)
            }
        } else if radius < self.hub {
            let grain = value_noise(self.seed ^ 7, point[0] * 20.0, point[2] * 20.0);
            flat(self.spoke_albedo * (1.0 + 0.1 * grain), 0.3 * self.shine)
        } else {
            let across = ((turn / TAU * self.spokes as f64).rem_euclid(1.0) - 0.5) * TAU / self.spokes as f64;
            let spoke = across.abs() < 1.2 && (radius * across.sin()).abs() < self.spoke_width;
            if !spoke || radius >= self.inner - 0.002 {
                return self.hollow * light.inside();
            }
            flat(self.spoke_albedo, 0.0)
        };
        light.shade(&surface, spot.view, spot.eye, ground)
    }

    fn rim_albedo(&self, point: Vector, radius: f64, turn: f64, ground: &Ground) -> f64 {
        let (x, z) = (radius * turn.cos(), radius * turn.sin());
        let mut albedo = self.albedo * (1.0 + self.rings * value_noise(self.seed, radius * 220.0, 0.5));
        if self.speckle > 0.0 && fractal(self.seed ^ 3, x * 6.0, z * 6.0, 2, 0.5) > 0.75 {
            albedo *= 1.0 - self.speckle * value_noise(self.seed ^ 5, x * 90.0, z * 90.0).max(0.0);
        }
        if self.bolts > 0 {
            let between = (turn / TAU * self.bolts as f64).rem_euclid(1.0) - 0.5;
            let along = between * TAU / self.bolts as f64 * radius;
            if along.hypot(radius - 0.5 * (1.0 + self.inner)) < 0.022 {
                albedo *= 0.4;
            }
        }
        if self.dust > 0.0 {
            let share = self.dust * (0.5 + 0.5 * fractal(self.seed ^ 9, x * 4.0, z * 4.0, 3, 0.6)).clamp(0.0, 1.0);
            albedo += share * (ground.albedo(point[0], -0.1) - albedo);
        }
        albedo
    }
}

/// A point of the face's plane, and who looks at it.
pub(super) struct Spot {
    pub(super) point: Vector,
    pub(super) radius: f64,
    pub(super) turn: f64,
    pub(super) view: Vector,
    pub(super) eye: Vector,
}
