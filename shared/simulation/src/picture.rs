//! The camera's picture: a wheel, seen from the side, standing in the soil.
//!
//! Every edge that an estimator looks for is where the scene says, to a fraction of a pixel: the outer circle, the rim's inner edge, and the soil
//! line, which crosses the outer circle at the two contact angles. What lies around it (terrain, texture, noise) is there to be looked past.

use crate::noise::hash;
use messages::{Frame, PIXELS_MAX};
use std::f64::consts::TAU;
use std::ops::Range;

/// Draws the wheel standing in the soil: a pure function of (seed, scene).
pub(crate) struct Painter {
    seed: u64,
    width: u32,
    height: u32,
    /// Sensor noise, gray levels, a row longer than `NOISE_STARTS`: every row of every frame begins elsewhere in it.
    noise: Vec<f32>,
    /// Texture of the soil, a tile of `TILE_ROWS` x `TILE_COLUMNS` that repeats, in 1/`TEXTURE_STEPS` of its standard deviation.
    /// Each row is longer by its first columns once more, so that a strip of it lies in one piece.
    texture: Vec<i8>,
    /// Height of the terrain's undulation over one tile's columns, -1 to 1.
    undulation: Vec<f32>,
}

/// What is to be seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Scene {
    /// Instant [ms]: chooses the noise and the camera's shake.
    pub time_ms: u64,
    /// Where the soil line meets the outer circle on the left, from `v_down`, positive to the left.
    pub left_rad: f64,
    /// The same on the right, positive to the right.
    pub right_rad: f64,
    /// `v_down = (sin pitch, cos pitch)` in the picture.
    pub pitch_rad: f64,
    /// How far the wheel has turned, positive when it rolls to the right.
    pub wheel_angle_rad: f64,
    /// How far the rover has come: the soil passes by to the left.
    pub travelled_m: f64,
    /// Radius of the wheel, the scale of `travelled_m` in the picture.
    pub radius_m: f64,
    /// Mean gray level of the soil, 0 to 255.
    pub soil_brightness: f64,
    /// Standard deviation of the soil's texture, gray levels.
    pub soil_grain: f64,
}

const TILE_COLUMNS: usize = 1024;
const TILE_ROWS: usize = 256;
const TEXTURE_STEPS: f32 = 32.0;
const NOISE_STARTS: u64 = 1 << 16;
/// Standard deviation of a normal sensor's noise, gray levels.
const NOISE_GRAY: f64 = 2.5;
/// Columns painted together: what depends on the column alone is worked out once for all their rows.
const STRIP_COLUMNS: usize = 128;
/// Columns of a row of the texture, with those that stand there twice.
const TEXTURE_COLUMNS: usize = TILE_COLUMNS + STRIP_COLUMNS + 1;

/// Width of the ramp that stands for the lens's blur of a sharp edge.
const EDGE_PX: f32 = 1.4;
/// Radius of the rim's inner edge over the outer radius.
const RIM: f64 = 0.8;
const LUG_COUNT: f32 = 18.0;
const SPOKE_LINES: usize = 3;

const SKY_GRAY: f32 = 226.0;
const TIRE_GRAY: f32 = 66.0;
const RIM_GRAY: f32 = 205.0;
const SPOKE_GRAY: f32 = 128.0;
const HOLLOW_GRAY: f32 = 26.0;
const LUG_GRAY: f32 = 84.0;

impl Painter {
    /// A painter of pictures of `width` x `height` pixels (rows beyond what a frame holds are left off); `noise` 1 is a normal sensor's, 0 none.
    pub(crate) fn new(seed: u64, width: u32, height: u32, noise: f64) -> Self {
        let width = width.min(PIXELS_MAX as u32);
        let height = height.min(PIXELS_MAX as u32 / width.max(1));
        Self {
            seed,
            width,
            height,
            noise: (0..u64::from(width) + NOISE_STARTS)
                .map(|k| (NOISE_GRAY * noise * gaussian(seed, k)) as f32)
                .collect(),
            texture: soil_texture(seed),
            undulation: terrain_undulation(seed),
        }
    }

    /// Fills the picture and the wheel's pose in it; the header is left as it is.
    pub(crate) fn paint(&self, scene: &Scene, frame: &mut Frame) {
        let wheel = self.wheel(scene);
        frame.width = self.width;
        frame.height = self.height;
        frame.crop_x_px = 0;
        frame.crop_y_px = 0;
        frame.center_x_px = wheel.center.0;
        frame.center_y_px = wheel.center.1;
        frame.rim_radius_px = RIM * wheel.radius_px;
        frame.wheel_radius_px = wheel.radius_px;
        frame.pitch_rad = scene.pitch_rad;
        frame.homography = Frame::circle_homography(wheel.center.0, wheel.center.1, wheel.radius_px, scene.pitch_rad);

        let soil = SoilLine::new(scene, &wheel);
        let face = Face::new(scene, &wheel);
        let shift_px = scene.travelled_m / scene.radius_m * wheel.radius_px;
        let ground = Ground {
            texture: &self.texture,
            shift: Shift::new(shift_px),
            brightness: scene.soil_brightness as f32,
            grain: scene.soil_grain as f32 / TEXTURE_STEPS,
            middle_row: 0.75 * self.height as f32,
            fall_per_row: 0.25 / self.height as f32,
        };
        let width = self.width as usize;
        for first in (0..width).step_by(STRIP_COLUMNS) {
            let columns = first..(first + STRIP_COLUMNS).min(width);
            let mut soil_y = [0.0; STRIP_COLUMNS];
            let mut hills_y = [0.0; STRIP_COLUMNS];
            for (k, x) in columns.clone().enumerate() {
                let near = Shift::new(shift_px + x as f64).blend(&self.undulation);
                // Far away, the terrain passes by slowly and looks stretched.
                let far = Shift::new(0.1 * shift_px + 0.6 * x as f64).blend(&self.undulation);
                soil_y[k] = soil.y_px(x as f64, 0.03 * wheel.radius_px * near) as f32;
                let level = wheel.center.1 + soil.level * (x as f64 - wheel.center.0);
                hills_y[k] = (level + wheel.radius_px * (0.1 + 0.12 * far)) as f32;
            }
            for (y, row) in frame
                .pixels
                .chunks_exact_mut(width)
                .take(self.height as usize)
                .enumerate()
            {
                let strip = Strip {
                    first,
                    y,
                    soil_y: &soil_y,
                    hills_y: &hills_y,
                };
                let noise = &self.noise[self.row_noise(scene.time_ms, y) + first..];
                strip.paint(&mut row[columns.clone()], noise, &ground, &face, &soil);
            }
        }
    }

    /// Where the wheel is in the picture: the camera shakes a little, smoothly.
    fn wheel(&self, scene: &Scene) -> WheelPose {
        let (width, height) = (f64::from(self.width), f64::from(self.height));
        let time_s = 1e-3 * scene.time_ms as f64;
        let phase = TAU * uniform(self.seed, u64::MAX);
        let shake_x = (3.9 * time_s + phase).sin() + 0.5 * (9.3 * time_s + 2.0 * phase).sin();
        let shake_y = (5.1 * time_s + 3.0 * phase).sin() + 0.5 * (11.1 * time_s).cos();
        WheelPose {
            center: (
                width * 0.5 + 0.003 * height * shake_x,
                height * (0.42 + 0.003 * shake_y),
            ),
            radius_px: 0.34 * height,
        }
    }

    /// Where a row's noise begins in the table.
    fn row_noise(&self, time_ms: u64, y: usize) -> usize {
        (hash(hash(self.seed ^ time_ms).wrapping_add(y as u64)) % NOISE_STARTS) as usize
    }
}

struct WheelPose {
    center: (f64, f64),
    radius_px: f64,
}

/// The line between soil and what is above it.
struct SoilLine {
    /// Where it meets the outer circle.
    left: (f64, f64),
    right: (f64, f64),
    /// Rows per column of the chord between the two.
    slope: f64,
    /// Rows per column of level ground, far from the wheel.
    level: f64,
    /// Distance over which the line goes from the chord's slope to level ground's.
    reach_px: f64,
    /// Unit normal of the chord, into the soil.
    normal: (f32, f32),
    /// What the normal's product with a point on the chord is.
    offset: f32,
}

impl SoilLine {
    fn new(scene: &Scene, wheel: &WheelPose) -> Self {
        let (sin_pitch, cos_pitch) = scene.pitch_rad.sin_cos();
        let contact = |angle_rad: f64| {
            let (right, down) = angle_rad.sin_cos();
            (
                wheel.center.0 + wheel.radius_px * (right * cos_pitch + down * sin_pitch),
                wheel.center.1 + wheel.radius_px * (down * cos_pitch - right * sin_pitch),
            )
        };
        let (left, right) = (contact(-scene.left_rad), contact(scene.right_rad));
        let (run, drop) = (right.0 - left.0, right.1 - left.1);
        let length = run.hypot(drop).max(f64::MIN_POSITIVE);
        let normal = (-drop / length, run / length);
        Self {
            left,
            right,
            slope: drop / run.max(1e-3),
            level: -sin_pitch / cos_pitch,
            reach_px: 0.5 * wheel.radius_px,
            normal: (normal.0 as f32, normal.1 as f32),
            offset: (normal.0 * left.0 + normal.1 * left.1) as f32,
        }
    }

    /// Row of the line in a column: the chord under the wheel, and outside it the terrain, which begins as the chord's continuation.
    fn y_px(&self, x: f64, undulation_px: f64) -> f64 {
        let (contact, away) = if x < self.left.0 {
            (self.left, x - self.left.0)
        } else if x > self.right.0 {
            (self.right, x - self.right.0)
        } else {
            return self.left.1 + self.slope * (x - self.left.0);
        };
        let terrain = 1.0 - (-away.abs() / self.reach_px).exp();
        let bend = (self.slope - self.level) * self.reach_px * terrain.copysign(away);
        contact.1 + self.level * away + bend + undulation_px * terrain * terrain
    }

    /// How much of a pixel of the wheel the soil in front of it hides.
    fn hides(&self, x: f32, y: f32) -> f32 {
        ramp(self.normal.0 * x + self.normal.1 * y - self.offset)
    }
}

/// The wheel's face, in shades of gray.
struct Face {
    center: (f32, f32),
    radius_px: f32,
    angle_rad: f32,
    /// Unit vectors along the spokes.
    spokes: [(f32, f32); SPOKE_LINES],
}

impl Face {
    /// Radius of the lugs' tips over the outer radius.
    const LUG_TIP: f32 = 1.04;

    fn new(scene: &Scene, wheel: &WheelPose) -> Self {
        let spoke = |k: usize| {
            let (sin, cos) = (scene.wheel_angle_rad + TAU * k as f64 / (2 * SPOKE_LINES) as f64).sin_cos();
            (cos as f32, sin as f32)
        };
        Self {
            center: (wheel.center.0 as f32, wheel.center.1 as f32),
            radius_px: wheel.radius_px as f32,
            angle_rad: scene.wheel_angle_rad.rem_euclid(TAU) as f32,
            spokes: std::array::from_fn(spoke),
        }
    }

    /// Radius up to which something of the wheel is to be seen.
    fn tip_px(&self) -> f32 {
        Self::LUG_TIP * self.radius_px + EDGE_PX
    }

    /// Radius up to which there is nothing of the rim.
    fn hollow_px(&self) -> f32 {
        RIM as f32 * self.radius_px - EDGE_PX
    }

    /// Gray level between the spokes, and of them.
    fn hollow(&self, dx: f32, dy: f32) -> f32 {
        let side = |spoke: &(f32, f32)| (spoke.0 * dy - spoke.1 * dx).abs();
        let side = self.spokes.iter().map(side).fold(f32::MAX, f32::min);
        let hub = 0.2 * self.radius_px - (dx * dx + dy * dy).sqrt();
        mix(HOLLOW_GRAY, SPOKE_GRAY, ramp((0.05 * self.radius_px - side).max(hub)))
    }

    /// Gray level of the rim, `radius` from the centre.
    fn rim(&self, dx: f32, dy: f32, radius: f32) -> f32 {
        let rim_px = RIM as f32 * self.radius_px;
        // Light from above left, weak: the band is to look uniform.
        let shading = 1.0 - 0.06 * (0.4 * dx + 0.9 * dy) / radius.max(1.0);
        let mut band = TIRE_GRAY * shading;
        if radius > 0.95 * self.radius_px {
            band = mix(band, LUG_GRAY, self.lug(dx, dy, radius));
        }
        let lip = mix(RIM_GRAY * shading, band, ramp(radius - 1.025 * rim_px));
        mix(HOLLOW_GRAY, lip, ramp(radius - rim_px))
    }

    /// How much of a pixel near the outer circle belongs to a lug.
    fn lug(&self, dx: f32, dy: f32, radius: f32) -> f32 {
        let turn = (dy.atan2(dx) - self.angle_rad) * (LUG_COUNT / TAU as f32);
        let off_px = (turn - turn.round()).abs() * radius * (TAU as f32 / LUG_COUNT);
        ramp(0.02 * self.radius_px - off_px) * ramp(Self::LUG_TIP * self.radius_px - radius)
    }
}

/// The soil's look.
struct Ground<'a> {
    texture: &'a [i8],
    shift: Shift,
    brightness: f32,
    grain: f32,
    /// Row at which the soil has its mean brightness.
    middle_row: f32,
    fall_per_row: f32,
}

impl Ground<'_> {
    /// Gray levels of the columns of row `y` from `first` on.
    fn gray(&self, first: usize, y: usize) -> [f32; STRIP_COLUMNS] {
        let start = (y % TILE_ROWS) * TEXTURE_COLUMNS + (first + self.shift.whole) % TILE_COLUMNS;
        let texture = &self.texture[start..=start + STRIP_COLUMNS];
        let level = self.brightness * (1.0 - self.fall_per_row * (y as f32 - self.middle_row));
        let mut gray = [level; STRIP_COLUMNS];
        for (gray, near) in gray.iter_mut().zip(texture.windows(2)) {
            *gray += self.grain * mix(f32::from(near[0]), f32::from(near[1]), self.shift.part);
        }
        gray
    }
}

/// A row's pixels in a strip of columns.
struct Strip<'a> {
    first: usize,
    y: usize,
    soil_y: &'a [f32; STRIP_COLUMNS],
    hills_y: &'a [f32; STRIP_COLUMNS],
}

impl Strip<'_> {
    /// Fills the strip's pixels: those beside the wheel, those of its rim, and those between its spokes.
    fn paint(&self, pixels: &mut [u8], noise: &[f32], ground: &Ground, face: &Face, soil: &SoilLine) {
        let dy = self.y as f32 - face.center.1;
        let earth = ground.gray(self.first, self.y);
        let mut gray = self.landscape(&earth, ground.brightness);
        let wheel = self.within(face, dy, face.tip_px());
        let hollow = self.within(face, dy, face.hollow_px());
        let rims = if hollow.is_empty() {
            [wheel, 0..0]
        } else {
            [wheel.start..hollow.start, hollow.end..wheel.end]
        };
        for k in rims.into_iter().flatten() {
            gray[k] = self.rim(k, dy, gray[k], earth[k], face, soil);
        }
        for k in hollow {
            let x = (self.first + k) as f32;
            let face = face.hollow(x - face.center.0, dy);
            gray[k] = mix(face, earth[k], soil.hides(x, self.y as f32));
        }
        for ((pixel, gray), noise) in pixels.iter_mut().zip(gray).zip(noise) {
            *pixel = (gray + noise + 0.5) as u8;
        }
    }

    /// Sky, hills and soil.
    fn landscape(&self, earth: &[f32; STRIP_COLUMNS], hills_gray: f32) -> [f32; STRIP_COLUMNS] {
        let y = self.y as f32;
        let mut gray = [0.0; STRIP_COLUMNS];
        for (k, gray) in gray.iter_mut().enumerate() {
            let far = mix(SKY_GRAY, hills_gray, 0.4 * ramp(y - self.hills_y[k]));
            *gray = mix(far, earth[k], ramp(y - self.soil_y[k]));
        }
        gray
    }

    /// The strip's columns whose pixels are nearer to the centre than `radius_px`.
    fn within(&self, face: &Face, dy: f32, radius_px: f32) -> Range<usize> {
        let square = radius_px * radius_px - dy * dy;
        if square <= 0.0 {
            return 0..0;
        }
        let column = |x: f32| ((x - self.first as f32).ceil().max(0.0) as usize).min(STRIP_COLUMNS);
        let half_px = square.sqrt();
        column(face.center.0 - half_px)..column(face.center.0 + half_px)
    }

    /// Gray level of a pixel at or near the rim.
    fn rim(&self, k: usize, dy: f32, landscape: f32, earth: f32, face: &Face, soil: &SoilLine) -> f32 {
        let (x, y) = ((self.first + k) as f32, self.y as f32);
        let dx = x - face.center.0;
        let radius = (dx * dx + dy * dy).sqrt();
        let mut around = landscape;
        let inside = ramp(face.radius_px - radius);
        if inside < 1.0 {
            let covered = ramp(y - self.soil_y[k]);
            around = mix(around, LUG_GRAY, face.lug(dx, dy, radius) * (1.0 - covered));
        }
        if inside > 0.0 {
            // The chord alone hides the wheel, so the contact angles hold whatever the terrain does outside.
            let hidden = soil.hides(x, y);
            let wheel = if hidden < 1.0 { face.rim(dx, dy, radius) } else { earth };
            around = mix(around, mix(wheel, earth, hidden), inside);
        }
        around
    }
}

/// A place in a tile that repeats: whole columns, and the part of a column beyond.
struct Shift {
    whole: usize,
    part: f32,
}

impl Shift {
    fn new(columns: f64) -> Self {
        let columns = columns.rem_euclid(TILE_COLUMNS as f64);
        Self {
            whole: columns as usize,
            part: columns.fract() as f32,
        }
    }

    fn blend(&self, values: &[f32]) -> f64 {
        f64::from(mix(
            values[self.whole % TILE_COLUMNS],
            values[(self.whole + 1) % TILE_COLUMNS],
            self.part,
        ))
    }
}

/// 0 on one side of an edge, 1 on the other.
fn ramp(distance_px: f32) -> f32 {
    (distance_px / EDGE_PX + 0.5).clamp(0.0, 1.0)
}

fn mix(a: f32, b: f32, part: f32) -> f32 {
    a + part * (b - a)
}

/// Grains of three sizes, scaled to a standard deviation of 1.
fn soil_texture(seed: u64) -> Vec<i8> {
    let mut sum = vec![0.0; TILE_ROWS * TILE_COLUMNS];
    for (layer, reach, weight) in [(1, 0, 0.5), (2, 1, 0.7), (3, 6, 0.5)] {
        let mut grains: Vec<f32> = (0..sum.len() as u64)
            .map(|k| gaussian(seed ^ (layer << 40), k) as f32)
            .collect();
        // Twice, so that no square grains are seen.
        for _ in 0..2 {
            grains = average(&grains, TILE_COLUMNS, 2 * reach);
            grains = average(&grains, TILE_ROWS, reach);
        }
        let scale = weight / deviation(&grains);
        sum.iter_mut()
            .zip(&grains)
            .for_each(|(sum, grain)| *sum += scale * grain);
    }
    let scale = TEXTURE_STEPS / deviation(&sum);
    let tile: Vec<i8> = sum.iter().map(|value| (scale * value).round() as i8).collect();
    tile.chunks_exact(TILE_COLUMNS)
        .flat_map(|row| row.iter().cycle().take(TEXTURE_COLUMNS).copied())
        .collect()
}

/// Mean over `2 reach + 1` neighbours along rows of `length` that close on themselves; the result is transposed.
fn average(values: &[f32], length: usize, reach: usize) -> Vec<f32> {
    let rows = values.len() / length;
    let mut means = vec![0.0; values.len()];
    for (r, row) in values.chunks_exact(length).enumerate() {
        for c in 0..length {
            let sum: f32 = (0..=2 * reach).map(|k| row[(c + length + k - reach) % length]).sum();
            means[c * rows + r] = sum / (2 * reach + 1) as f32;
        }
    }
    means
}

fn deviation(values: &[f32]) -> f32 {
    let square: f64 = values.iter().map(|value| f64::from(value * value)).sum();
    ((square / values.len() as f64).sqrt() as f32).max(f32::MIN_POSITIVE)
}

/// Some waves with whole numbers of periods in a tile.
fn terrain_undulation(seed: u64) -> Vec<f32> {
    let waves: [(f64, f64); 6] =
        std::array::from_fn(|k| ((2 * k + 3) as f64, TAU * uniform(seed ^ (7 << 40), k as u64)));
    let height = |x: usize| {
        let turn = TAU * x as f64 / TILE_COLUMNS as f64;
        waves
            .iter()
            .map(|(periods, phase)| (periods * turn + phase).sin() / periods.sqrt())
            .sum::<f64>()
            / 2.2
    };
    (0..TILE_COLUMNS).map(|x| height(x) as f32).collect()
}

/// The sum of four uniform numbers, scaled to a standard deviation of 1: near enough to a Gaussian for a sensor.
fn gaussian(seed: u64, index: u64) -> f64 {
    let sum: f64 = (0..4).map(|k| uniform(seed, 4 * index + k) - 0.5).sum();
    sum * 3.0_f64.sqrt()
}

/// Uniform in [0, 1).
fn uniform(seed: u64, index: u64) -> f64 {
    (hash(hash(seed).wrapping_add(index)) >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::Message;

    const SCENE: Scene = Scene {
        time_ms: 0,
        left_rad: 0.5,
        right_rad: 0.6,
        pitch_rad: 0.0,
        wheel_angle_rad: 0.0,
        travelled_m: 0.0,
        radius_m: 0.15,
        soil_brightness: 160.0,
        soil_grain: 5.0,
    };

    fn zeroed<M: Message>() -> Box<M> {
        M::new_box_zeroed().unwrap()
    }

    fn bytes<M: Message>(message: &M) -> &[u8] {
        message.as_bytes()
    }

    fn painted(painter: &Painter, scene: &Scene) -> Box<Frame> {
        let mut frame = zeroed();
        painter.paint(scene, &mut frame);
        frame
    }

    /// Gray level between pixels, on a circle around the wheel's centre, `angle_rad` to the right of `v_down`.
    fn gray_at(frame: &Frame, radius_px: f64, angle_rad: f64) -> f64 {
        let (sin, cos) = (angle_rad + frame.pitch_rad).sin_cos();
        let (x, y) = (frame.center_x_px + radius_px * sin, frame.center_y_px + radius_px * cos);
        let at = |x: f64, y: f64| f64::from(frame.pixels[y as usize * frame.width as usize + x as usize]);
        let (u, v) = (x.fract(), y.fract());
        (1.0 - v) * ((1.0 - u) * at(x, y) + u * at(x + 1.0, y))
            + v * ((1.0 - u) * at(x, y + 1.0) + u * at(x + 1.0, y + 1.0))
    }

    /// Where the chord between the contacts crosses a circle of radius `part` (outer radius 1), left (negative) and right of `v_down`.
    fn crossings(left_rad: f64, right_rad: f64, part: f64) -> [f64; 2] {
        // The chord is at the distance cos((l + r) / 2) from the centre, in the direction (r - l) / 2.
        let half = ((0.5 * (left_rad + right_rad)).cos() / part).acos();
        let middle = 0.5 * (right_rad - left_rad);
        [middle - half, middle + half]
    }

    #[test]
    fn the_soil_line_crosses_the_band_where_the_contact_angles_say() {
        let painter = Painter::new(1, 640, 480, 0.0);
        let angles = [
            (0.5, 0.6),
            (0.55, 0.55),
            (0.9, 0.3),
            (0.25, 0.8),
            (1.1, 0.9),
            (0.45, 0.7),
        ];
        for (index, (left_rad, right_rad)) in angles.into_iter().enumerate() {
            for pitch_rad in [-0.2, -0.03, 0.0, 0.1] {
                let time_ms = 17 * index as u64;
                let travelled_m = 0.123 * index as f64;
                let scene = Scene {
                    time_ms,
                    left_rad,
                    right_rad,
                    pitch_rad,
                    travelled_m,
                    ..SCENE
                };
                let frame = painted(&painter, &scene);
                let radius_px = 0.93 * frame.wheel_radius_px;
                for (side, expected) in [-1.0, 1.0].into_iter().zip(crossings(left_rad, right_rad, 0.93)) {
                    let is_soil = |step: i32| {
                        gray_at(
                            &frame,
                            radius_px,
                            expected + side * f64::from(step) / (20.0 * radius_px),
                        ) > 113.0
                    };
                    // From 4 px below the line to 40 px above it.
                    let found = (-80..800).find(|&step| !is_soil(step)).unwrap();
                    assert!(found.abs() < 10, "{scene:?}: {} px off", f64::from(found) / 20.0);
                    assert!((found + 20..800).all(|step| !is_soil(step)));
                }
            }
        }
    }

    #[test]
    fn the_rim_and_the_outer_edge_have_their_radii() {
        let frame = painted(
            &Painter::new(2, 640, 480, 0.0),
            &Scene {
                wheel_angle_rad: 0.26,
                ..SCENE
            },
        );
        for (radius_px, level) in [
            (frame.rim_radius_px, 0.5 * (26.0 + 205.0)),
            (frame.wheel_radius_px, 140.0),
        ] {
            // Between spokes and between lugs, in the upper half.
            let angle_rad = std::f64::consts::PI + 0.08;
            let outside =
                (-80_i32..80).find(|&step| gray_at(&frame, radius_px + f64::from(step) / 20.0, angle_rad) > level);
            assert!(outside.unwrap().abs() < 10);
        }
    }

    #[test]
    fn the_same_scene_gives_the_same_bytes_and_another_frame_others() {
        let painter = Painter::new(3, 640, 480, 1.0);
        let first = painted(&painter, &SCENE);
        let again = painted(&Painter::new(3, 640, 480, 1.0), &SCENE);
        assert!(bytes(&*first) == bytes(&*again));
        let next = painted(&painter, &Scene { time_ms: 1, ..SCENE });
        assert!(first.image() != next.image());
    }

    #[test]
    fn noise_has_the_deviation_asked_for() {
        let silent = painted(&Painter::new(4, 640, 480, 0.0), &SCENE);
        let noisy = painted(&Painter::new(4, 640, 480, 1.0), &SCENE);
        let square = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)).powi(2);
        let mean = silent.image().iter().zip(noisy.image()).map(square).sum::<f64>() / silent.image().len() as f64;
        // Rounding to gray levels twice adds 1/12 each time.
        assert!((mean - 2.5 * 2.5 - 1.0 / 6.0).abs() < 0.2, "{mean}");
    }

    #[test]
    fn no_scene_and_no_size_panics() {
        for (width, height) in [(0, 0), (0, 5), (5, 0), (1, 1), (3, u32::MAX), (u32::MAX, 3), (129, 2)] {
            let painter = Painter::new(5, width, height, f64::NAN);
            for wild in [f64::NAN, f64::INFINITY, -1e300, 0.0, 1e300] {
                let scene = Scene {
                    time_ms: u64::MAX,
                    left_rad: wild,
                    right_rad: wild,
                    pitch_rad: wild,
                    wheel_angle_rad: wild,
                    travelled_m: wild,
                    radius_m: wild,
                    soil_brightness: wild,
                    soil_grain: wild,
                };
                painted(&painter, &scene);
            }
        }
    }
}
