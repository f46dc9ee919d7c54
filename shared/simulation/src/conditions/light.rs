//! Light and shadow: a sun or none, the sky, a flash beside the camera, and what stands in their way.

use super::ground::Ground;
use super::{Condition, Vector, add, dot, norm, scale};
use crate::noise::Dice;
use std::f64::consts::{PI, TAU};

/// Depth of the wheel behind its face, in radii.
const WHEEL_DEPTH: f64 = 1.07;

#[derive(Clone, Debug)]
pub(super) struct Light {
    /// Towards the sun.
    sun: Vector,
    sun_power: f64,
    pub(super) ambient: f64,
    flash: f64,
    /// Where the flash is, from the camera.
    flash_offset: Vector,
    /// A slab of shadow across the light: its direction, where it begins, how wide it is.
    body: Option<([f64; 2], f64, f64)>,
    pub(super) arm: Option<Arm>,
}

/// The wheel's strut, in a plane in front of the face, from the hub upwards.
#[derive(Clone, Debug)]
pub(super) struct Arm {
    angle: f64,
    half_width: f64,
    pub(super) front: f64,
}

impl Arm {
    /// Whether the strut is at a point of its plane.
    pub(super) fn covers(&self, x: f64, z: f64, below_hub: f64) -> bool {
        let (sin, cos) = self.angle.sin_cos();
        x * sin + z * cos > -below_hub && (x * cos - z * sin).abs() < self.half_width
    }
}

/// A point that is lit.
pub(super) struct Surface {
    pub(super) point: Vector,
    pub(super) normal: Vector,
    pub(super) albedo: f64,
    pub(super) shine: f64,
    pub(super) on_wheel: bool,
}

impl Light {
    pub(super) fn new(condition: Condition, dice: &mut Dice) -> Self {
        let sun = condition == Condition::Sun;
        let hazy =
            matches!(condition, Condition::Uneven | Condition::Bentonite | Condition::Gravel) && dice.chance(0.75);
        let azimuth = dice.range(0.0, TAU);
        let elevation = if sun {
            dice.range(0.2, 0.75)
        } else {
            dice.range(0.35, 1.1)
        };
        let (sun_power, ambient, flash) = match condition {
            Condition::Sun => (dice.range(0.9, 1.3), dice.range(0.12, 0.35), 0.0),
            Condition::Strobe => {
                let rest = if dice.chance(0.3) { dice.range(0.0, 0.15) } else { 0.0 };
                (rest, dice.range(0.03, 0.12), dice.range(0.6, 1.1))
            }
            _ if hazy => (dice.range(0.3, 0.8), dice.range(0.4, 0.8), 0.0),
            _ => (0.0, dice.range(0.7, 1.0), 0.0),
        };
        let shaded = if sun { 0.7 } else { 0.5 };
        let body = (sun_power + flash > 0.0 && dice.chance(shaded)).then(|| {
            let turn = dice.range(0.0, PI);
            ([turn.cos(), turn.sin()], dice.sym(1.4), dice.range(0.3, 2.5))
        });
        let arm = dice.chance(0.75).then(|| Arm {
            angle: dice.sym(0.5),
            half_width: dice.range(0.04, 0.11),
            front: dice.range(0.05, 0.3),
        });
        Self {
            sun: [
                azimuth.cos() * elevation.cos(),
                azimuth.sin() * elevation.cos(),
                elevation.sin(),
            ],
            sun_power,
            ambient,
            flash,
            flash_offset: [dice.sym(1.0), 0.0, dice.range(0.3, 1.0)],
            body,
            arm,
        }
    }

    /// Light that a surface sends to the eye; `view` points away from it.
    pub(super) fn shade(&self, surface: &Surface, view: Vector, eye: Vector, ground: &Ground) -> f64 {
        let Surface {
            point,
            normal,
            albedo,
            shine,
            on_wheel,
        } = *surface;
        let mut light = self.ambient * (0.75 + 0.25 * normal[2]);
        let mut highlight = 0.0;
        let gloss = |towards: Vector| dot(normal, norm(add(towards, scale(view, -1.0)))).max(0.0);
        let facing = dot(normal, self.sun);
        if self.sun_power > 0.0 && facing > 0.0 && self.lit(point, self.sun, on_wheel, ground) {
            light += self.sun_power * facing;
            highlight += shine * self.sun_power * gloss(self.sun).powi(40);
        }
        if self.flash > 0.0 {
            let to = add(add(eye, self.flash_offset), scale(point, -1.0));
            let towards = norm(to);
            // Light from elsewhere on the rover reaches the flash's shadow.
            let share = if self.lit(point, towards, on_wheel, ground) {
                1.0
            } else {
                0.3
            };
            let falloff = dot(eye, eye) / dot(to, to);
            light += self.flash * share * dot(normal, towards).max(0.0) * falloff;
            highlight += 0.7 * shine * self.flash * share * gloss(towards).powi(60);
        }
        albedo * light + highlight
    }

    /// What the wheel's hollow sends back.
    pub(super) fn inside(&self) -> f64 {
        self.ambient + 0.2 * self.sun_power + 0.5 * self.flash
    }

    /// Whether nothing stands between a point and the light.
    fn lit(&self, point: Vector, towards: Vector, on_wheel: bool, ground: &Ground) -> bool {
        let l = towards;
        if let Some((direction, from, width)) = self.body {
            let u = norm([l[1], -l[0], 1e-9]);
            let v = [
                u[1] * l[2] - u[2] * l[1],
                u[2] * l[0] - u[0] * l[2],
                u[0] * l[1] - u[1] * l[0],
            ];
            let across = dot(point, u) * direction[0] + dot(point, v) * direction[1] - from;
            if across > 0.0 && across < width {
                return false;
            }
        }
        if let Some(arm) = &self.arm {
            let t = (-arm.front - point[1]) / l[1];
            if t > 1e-6 && t.is_finite() && arm.covers(point[0] + t * l[0], point[2] + t * l[2], 0.0) {
                return false;
            }
        }
        on_wheel || !(behind_wheel(point, l) || behind_ground(point, l, ground))
    }
}

/// Whether the wheel, a cylinder behind its face, stands in the light.
fn behind_wheel(point: Vector, l: Vector) -> bool {
    let (a, b) = (l[0] * l[0] + l[2] * l[2], point[0] * l[0] + point[2] * l[2]);
    let c = point[0] * point[0] + point[2] * point[2] - 1.0;
    let square = b * b - a * c;
    if square <= 0.0 {
        return false;
    }
    let (near, far) = ((-b - square.sqrt()) / a, (-b + square.sqrt()) / a);
    let (from, to) = (point[1] + near.max(0.0) * l[1], point[1] + far * l[1]);
    far > 1e-3 && from.min(to) < WHEEL_DEPTH && from.max(to) > 0.0
}

fn behind_ground(point: Vector, l: Vector, ground: &Ground) -> bool {
    let mut t = 0.02;
    while t < 1.2 {
        let q = add(point, scale(l, t));
        if ground.height(q[0], q[1]) > q[2] + 0.004 {
            return true;
        }
        t *= 1.35;
    }
    false
}
