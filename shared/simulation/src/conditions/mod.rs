//! Pictures of a wheel under six conditions of ground and light, ray-cast, with the soil line that is seen in them.
//!
//! Where [`crate::Rover`] draws pictures fast enough for a live system, these are made to be hard: they are what the
//! weights of visual sinkage are fitted on, and what its accuracy is measured on.

mod face;
mod ground;
mod light;

use crate::noise::Dice;
use face::{Face, Spot};
use ground::{Ground, Terrain};
use light::{Light, Surface};
use messages::{Frame, PIXELS_MAX};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Ground and light of a clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Condition {
    /// Level ground in uniform light.
    Flat,
    /// Slopes, undulation and a pitched camera.
    Uneven,
    /// Pale, dry bentonite.
    Bentonite,
    /// Gravel, with rocks in front of the wheel.
    Gravel,
    /// A low sun: hard shadows, some of the rover itself, and highlights.
    Sun,
    /// A flash in the dark.
    Strobe,
}

impl Condition {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Flat,
        Self::Uneven,
        Self::Bentonite,
        Self::Gravel,
        Self::Sun,
        Self::Strobe,
    ];
}

/// One wheel on one terrain in one light, before one camera: a pure function of condition and seed.
#[derive(Clone, Debug)]
pub struct Clip {
    seed: u64,
    terrain: Terrain,
    face: Face,
    light: Light,
    camera: Camera,
    /// Wheel radii and radians of the sinkage's slow change per second.
    speed: f64,
    sway: f64,
    phase: f64,
}

/// What a picture truly shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Angle from straight down at which the soil is seen to meet the wheel on the picture's left, positive.
    pub left_rad: f64,
    /// The same on the right.
    pub right_rad: f64,
    /// Wheel centre, column.
    pub center_x_px: f64,
    /// Wheel centre, row.
    pub center_y_px: f64,
}

impl Clip {
    /// The clip of this condition and seed.
    #[must_use]
    pub fn new(condition: Condition, seed: u64) -> Self {
        let mut dice = Dice::new(seed ^ (condition as u64) << 56);
        Self {
            seed,
            terrain: Terrain::new(condition, &mut dice),
            face: Face::new(condition, &mut dice),
            light: Light::new(condition, &mut dice),
            camera: Camera::new(condition, &mut dice),
            speed: dice.range(0.0, 0.4),
            sway: dice.sym(1.2),
            phase: dice.range(0.0, TAU),
        }
    }

    /// Paints the wheel's surroundings as they are at this time, with the wheel's pose in the picture as it is
    /// known: a pixel, 0.4 % and 0.4° off at the most. The header is left as it is, and what is far from the rim black.
    pub fn paint(&self, time_s: f64, frame: &mut Frame) -> Truth {
        let view = View {
            ground: self.terrain.ground(self.speed * time_s, self.sway * time_s),
            face: &self.face,
            light: &self.light,
            turn: self.phase + self.speed * time_s,
            eye: self.camera.eye(),
            sky: self.camera.sky,
        };
        let homography = self.camera.homography();
        let mut dice = Dice::new(self.seed ^ time_s.to_bits().rotate_left(17));
        let light = self.expose(&view, &homography);
        frame.width = self.camera.width as u32;
        frame.height = self.camera.height as u32;
        (frame.crop_x_px, frame.crop_y_px) = (0, 0);
        self.camera.develop(&light, &mut frame.pixels, &mut dice);
        self.pose(&homography, &mut dice, frame);
        let [left_rad, right_rad] = view.contact();
        Truth {
            left_rad,
            right_rad,
            center_x_px: homography[2],
            center_y_px: homography[5],
        }
    }

    /// The light of each pixel about the rim: four rays in the lower half, one elsewhere.
    fn expose(&self, view: &View, homography: &[f64; 9]) -> Vec<f32> {
        let camera = &self.camera;
        let mut light = vec![0.0; camera.width * camera.height];
        for (k, light) in light.iter_mut().enumerate() {
            let (column, row) = ((k % camera.width) as f64, (k / camera.width) as f64);
            let (right, down) = (column - homography[2], row - homography[5]);
            let radius = right.hypot(down) / camera.wheel_px;
            let low = down > -0.05 * camera.wheel_px;
            let outer = if low { 1.08 } else { self.face.inner + 0.05 };
            if radius < self.face.inner - 0.07 || radius > outer {
                continue;
            }
            let rays: &[(f64, f64)] = if low {
                &[(-0.25, -0.125), (0.25, 0.125), (-0.125, 0.375), (0.125, -0.375)]
            } else {
                &[(0.0, 0.0)]
            };
            let sum: f64 = rays
                .iter()
                .map(|ray| view.trace(camera.direction(column + ray.0, row + ray.1)).min(3.0))
                .sum();
            *light = (sum / rays.len() as f64) as f32;
        }
        light
    }

    /// Writes the pose as it is known.
    fn pose(&self, homography: &[f64; 9], dice: &mut Dice, frame: &mut Frame) {
        let (away, around) = (1.2 * dice.unit().sqrt(), dice.range(0.0, TAU));
        let growth = 1.0 + self.camera.radius_error;
        let (sin, cos) = dice.sym(0.4_f64.to_radians()).sin_cos();
        let h = &mut frame.homography;
        for row in 0..3 {
            let (x, z) = (homography[3 * row], homography[3 * row + 1]);
            h[3 * row] = growth * (x * cos - z * sin);
            h[3 * row + 1] = growth * (x * sin + z * cos);
            h[3 * row + 2] = homography[3 * row + 2];
        }
        for column in 0..3 {
            h[column] += away * around.cos() * h[6 + column];
            h[3 + column] += away * around.sin() * h[6 + column];
        }
        (frame.center_x_px, frame.center_y_px) = (h[2], h[5]);
        frame.wheel_radius_px = growth * self.camera.wheel_px;
        frame.rim_radius_px = self.face.inner * frame.wheel_radius_px;
        frame.pitch_rad = h[1].atan2(h[4]);
    }
}

/// Lens, sensor and place of the camera; its distance is in wheel radii.
#[derive(Clone, Debug)]
struct Camera {
    distance: f64,
    focal_px: f64,
    pitch: f64,
    yaw: f64,
    roll: f64,
    middle: (f64, f64),
    width: usize,
    height: usize,
    /// Outer radius of the wheel, about.
    wheel_px: f64,
    exposure: f64,
    gamma: f64,
    read_noise: f64,
    shot_noise: f64,
    blur_px: f64,
    sky: f64,
    radius_error: f64,
}

impl Camera {
    fn new(condition: Condition, dice: &mut Dice) -> Self {
        let wheel_px = match dice.unit() {
            part if part < 0.6 => dice.range(140.0, 180.0),
            _ => 60.0 * (dice.unit() * (400.0_f64 / 60.0).ln()).exp(),
        };
        let distance = dice.range(5.0, 12.0);
        let width = ((3.9 * wheel_px) as usize).min(1180);
        let height = ((2.9 * wheel_px) as usize).min(PIXELS_MAX / width);
        Self {
            distance,
            focal_px: wheel_px * distance,
            pitch: dice.range(0.03, 0.2),
            yaw: dice.sym(0.05),
            roll: if condition == Condition::Uneven {
                dice.sym(0.22)
            } else {
                dice.sym(0.05)
            },
            middle: (0.5 * width as f64 + dice.sym(8.0), 0.5 * height as f64),
            width,
            height,
            wheel_px,
            exposure: dice.range(0.75, 1.2),
            gamma: if dice.chance(0.4) { dice.range(0.6, 1.1) } else { 1.0 },
            read_noise: dice.range(0.8, 3.5),
            shot_noise: dice.range(0.0, 0.22),
            blur_px: dice.range(0.45, 1.2),
            sky: if condition == Condition::Strobe {
                dice.range(0.0, 0.08)
            } else {
                dice.range(0.1, 1.1)
            },
            radius_error: dice.sym(0.004),
        }
    }

    /// Right, down and forward, in x to the right, y away and z upwards.
    fn axes(&self) -> [Vector; 3] {
        let ((sp, cp), (sy, cy), (sr, cr)) = (self.pitch.sin_cos(), self.yaw.sin_cos(), self.roll.sin_cos());
        let (right, down) = ([cy, -sy, 0.0], [-sy * sp, -cy * sp, -cp]);
        [
            add(scale(right, cr), scale(down, -sr)),
            add(scale(right, sr), scale(down, cr)),
            [sy * cp, cy * cp, -sp],
        ]
    }

    /// Where the camera is: the hub is seen a quarter of a radius above the picture's middle.
    fn eye(&self) -> Vector {
        let [_, down, forward] = self.axes();
        add(scale(forward, -self.distance), scale(down, 0.25))
    }

    fn direction(&self, column: f64, row: f64) -> Vector {
        let [right, down, forward] = self.axes();
        let (u, v) = (
            (column - self.middle.0) / self.focal_px,
            (row - self.middle.1) / self.focal_px,
        );
        norm(add(forward, add(scale(right, u), scale(down, v))))
    }

    /// The wheel-face plane to pixels.
    fn homography(&self) -> [f64; 9] {
        let [right, down, forward] = self.axes();
        let image = |point: Vector| {
            let depth = dot(forward, point);
            [
                self.focal_px * dot(right, point) + self.middle.0 * depth,
                self.focal_px * dot(down, point) + self.middle.1 * depth,
                depth,
            ]
        };
        let [x, z, hub] = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], scale(self.eye(), -1.0)].map(image);
        std::array::from_fn(|k| [x, z, hub][k % 3][k / 3] / hub[2])
    }

    /// Light to gray values: exposure after what is seen near the rim, blur, gamma, noise.
    fn develop(&self, light: &[f32], pixels: &mut [u8], dice: &mut Dice) {
        let mut seen: Vec<f32> = light.iter().copied().filter(|light| *light > 0.0).collect();
        seen.sort_unstable_by(f32::total_cmp);
        let bright = f64::from(seen.get(seen.len() * 92 / 100).copied().unwrap_or(1.0)).max(0.05);
        let gain = 0.76 * self.exposure / bright;
        let blurred = blur(light, self.width, self.blur_px);
        for (pixel, light) in pixels.iter_mut().zip(&blurred) {
            let gray = 255.0 * (f64::from(*light) * gain).powf(self.gamma);
            let noise = (self.read_noise * self.read_noise + self.shot_noise * gray).sqrt();
            *pixel = (gray + noise * dice.normal() + 0.5) as u8;
        }
    }
}

/// What rays meet at one time.
struct View<'a> {
    ground: Ground,
    face: &'a Face,
    light: &'a Light,
    turn: f64,
    eye: Vector,
    sky: f64,
}

impl View<'_> {
    /// Light along a ray.
    fn trace(&self, view: Vector) -> f64 {
        let at = |t: f64| add(self.eye, scale(view, t));
        if let Some(arm) = &self.light.arm {
            let point = at((-arm.front - self.eye[1]) / view[1]);
            if arm.covers(point[0], point[2], 0.03) {
                let surface = Surface {
                    point,
                    normal: [0.0, -1.0, 0.0],
                    albedo: 0.5 * self.face.albedo,
                    shine: 0.0,
                    on_wheel: true,
                };
                return self.light.shade(&surface, view, self.eye, &self.ground);
            }
        }
        let reaches_face = -self.eye[1] / view[1];
        let point = at(reaches_face);
        let spot = Spot {
            point,
            radius: point[0].hypot(point[2]),
            turn: point[2].atan2(point[0]) - self.turn,
            view,
            eye: self.eye,
        };
        let wheel = self.face.covers(spot.radius, spot.turn);
        let end = if wheel {
            reaches_face
        } else {
            (ground::Y.1 - 0.05 - self.eye[1]) / view[1]
        };
        match self.meets_ground(view, end) {
            Some(t) => self.shade_ground(at(t), &spot),
            None if wheel => self.face.shade(&spot, self.light, &self.ground),
            None => self.sky,
        }
    }

    /// How far along a ray the ground is, if it is nearer than `end`.
    fn meets_ground(&self, view: Vector, end: f64) -> Option<f64> {
        let gap = |t: f64| {
            let point = add(self.eye, scale(view, t));
            point[2] - self.ground.height(point[0], point[1])
        };
        let step = 0.03 / view[1];
        let mut last = (ground::Y.0 + 0.05 - self.eye[1]) / view[1];
        let mut t = last;
        loop {
            let above = gap(t);
            if above < 0.0 {
                break;
            }
            if t >= end {
                return None;
            }
            last = t;
            t = (t + if above > 0.25 { step.max(2.0 * above) } else { step }).min(end);
        }
        for _ in 0..6 {
            let middle = 0.5 * (last + t);
            if gap(middle) < 0.0 {
                t = middle;
            } else {
                last = middle;
            }
        }
        Some(last)
    }

    fn shade_ground(&self, point: Vector, spot: &Spot) -> f64 {
        let ground = &self.ground;
        let (along, away) = ground.slopes(point[0], point[1]);
        let fine = 6.0 * ground.fine * crate::noise::value_noise(ground.seed, point[0] * 160.0, point[1] * 90.0);
        // Less sky is seen from beside the wheel.
        let beside = (-(spot.radius - 1.0).abs().min(0.3) / 0.05 - point[1].abs() / 0.12).exp();
        let open = if spot.point[2] < 0.0 && point[1].abs() < 0.5 {
            1.0 - 0.12 * beside
        } else {
            1.0
        };
        let surface = Surface {
            point,
            normal: norm([-along, -away, 1.0]),
            albedo: ground.albedo(point[0], point[1]) * (1.0 + fine) * open,
            shine: 0.0,
            on_wheel: false,
        };
        self.light.shade(&surface, spot.view, spot.eye, ground)
    }

    /// Left and right angle at which the outer circle goes behind the soil; loose rocks in front do not count.
    fn contact(&self) -> [f64; 2] {
        const STEP_RAD: f64 = 0.002;
        const ALONG: usize = 600;
        let free = |x: f64, z: f64| {
            let view = add([x, 0.0, z], scale(self.eye, -1.0));
            let start = (ground::Y.0 - self.eye[1]) / view[1];
            (0..=ALONG).all(|k| {
                let t = start + (1.0 - start) * k as f64 / ALONG as f64;
                let point = add(self.eye, scale(view, t));
                self.ground.soil_height(point[0], point[1]) <= point[2] + 1e-6
            })
        };
        [-1.0, 1.0].map(|side| {
            let mut angle = FRAC_PI_2;
            while angle > 0.0 && free(side * angle.sin(), -angle.cos()) {
                angle -= STEP_RAD;
            }
            angle + 0.5 * STEP_RAD
        })
    }
}

type Vector = [f64; 3];

fn add(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn scale(a: Vector, by: f64) -> Vector {
    a.map(|value| value * by)
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn norm(a: Vector) -> Vector {
    scale(a, 1.0 / dot(a, a).sqrt())
}

/// A Gaussian of seven pixels along rows, then along columns.
fn blur(image: &[f32], width: usize, sigma_px: f64) -> Vec<f32> {
    let bell: [f64; 7] = std::array::from_fn(|k| (-0.5 * ((k as f64 - 3.0) / sigma_px).powi(2)).exp());
    let sum: f64 = bell.iter().sum();
    let bell = bell.map(|weight| (weight / sum) as f32);
    let mut blurred = image.to_vec();
    for step in [1, width] {
        let source = blurred.clone();
        for (k, value) in blurred.iter_mut().enumerate() {
            if let Some(first) = k.checked_sub(3 * step)
                && k + 3 * step < source.len()
            {
                *value = bell
                    .iter()
                    .enumerate()
                    .map(|(j, weight)| weight * source[first + j * step])
                    .sum();
            }
        }
    }
    blurred
}
