//! A wheel that is not seen square on: the homography of its face, from the rim's inner and the wheel's outer edge.
//!
//! Each edge of the rim is a circle of the face. Where it is seen next to where a homography puts it is linear in a small
//! change of that homography; a few least-squares steps with Tukey's weights find it. The two circles together tell the
//! wheel's centre from the perspective. How the face is turned about its axle cannot be seen: the pitch is given.

use image::GrayImage;
use messages::Frame;
use nalgebra::{SMatrix, SVector};
use std::f64::consts::TAU;

/// Rays on which either edge is looked for; those nearer to straight down than this may end in soil.
const RAYS: usize = 240;
const COSINE_MAX: f64 = 0.6;
/// How far from its expected place an edge is looked for at first and at last, in outer radii.
const REACH: (f64, f64) = (0.04, 0.015);
const ITERATIONS: usize = 14;
/// Samples along a ray, and those on either side of a place that are compared.
const SAMPLES: usize = 61;
const WINDOW: usize = 4;
/// Gray values of a step below which a ray says nothing.
const STEP_MIN: f64 = 5.0;
/// Rays that an edge must be seen on.
const RAYS_MIN: usize = RAYS / 6;
/// What is fitted: the centre (right, down), the growth of the inner and the outer circle, the two parts of the stretch,
/// and the perspective (right, down).
const UNKNOWNS: usize = 8;
/// What each is about, in outer radii; and what an edge is known to.
const SIZES: [f64; UNKNOWNS] = [0.05, 0.05, 0.05, 0.05, 0.2, 0.2, 0.1, 0.1];
const EDGE: f64 = 0.004;
/// How far centre and radii may be from where they were looked for, relative to the outer radius, and the greatest
/// perspective: the slope of the face times its radius over its distance. What is beyond is another edge than the rim's.
const MOVED_MAX: f64 = 0.06;
const PERSPECTIVE_MAX: f64 = 0.12;
/// Distance from the nearest circle, in outer radii, from which on the rim is visibly none.
const VISIBLE: f64 = 0.006;

/// A wheel's face as the picture shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// The face (X to the right, Z downwards in the picture, outer radius 1) to pixels, row by row.
    pub homography: [f64; 9],
    /// Radius of the rim's inner edge, in outer radii.
    pub rim: f64,
}

impl Face {
    /// Starts at two circles about one centre [px]; `None` where the edges are seen on too few rays, or are such circles.
    pub fn find(picture: &GrayImage, center: (f64, f64), rim_px: f64, outer_px: f64) -> Option<Self> {
        let mut face = Self {
            homography: Frame::circle_homography(center.0, center.1, outer_px, 0.0),
            rim: rim_px / outer_px,
        };
        for iteration in 0..ITERATIONS {
            let left = 1.0 - (iteration as f64 / (ITERATIONS / 2) as f64).min(1.0);
            let reach = REACH.1 + left * (REACH.0 - REACH.1);
            face = face.improved(picture, reach)?;
        }
        let found = |angle: f64| face.pixel(angle.sin(), angle.cos());
        let (x, y) = face.pixel(0.0, 0.0);
        let distances: Vec<f64> = (0..36)
            .map(|k| TAU * f64::from(k) / 36.0)
            .map(|angle| (found(angle).0 - x).hypot(found(angle).1 - y))
            .collect();
        let mean = distances.iter().sum::<f64>() / distances.len() as f64;
        let most = distances
            .iter()
            .map(|distance| (distance / mean - 1.0).abs())
            .fold(0.0, f64::max);
        let moved = (x - center.0).hypot(y - center.1) / outer_px;
        let h = &face.homography;
        let sound = mean.is_finite()
            && moved <= MOVED_MAX
            && (mean / outer_px - 1.0).abs() <= MOVED_MAX
            && (face.rim * outer_px / rim_px - 1.0).abs() <= MOVED_MAX
            && (h[6] / h[8]).hypot(h[7] / h[8]) <= PERSPECTIVE_MAX;
        (sound && most > VISIBLE).then_some(face)
    }

    /// The mean radius of the outer edge in the picture.
    pub fn outer_px(&self) -> f64 {
        let (x, y) = self.pixel(0.0, 0.0);
        let distance = |k: i32| {
            let (sin, cos) = (TAU * f64::from(k) / 36.0).sin_cos();
            let (column, row) = self.pixel(sin, cos);
            (column - x).hypot(row - y)
        };
        (0..36).map(distance).sum::<f64>() / 36.0
    }

    /// The homography of a face whose Z runs along `(sin pitch, cos pitch)` in the picture.
    pub fn pitched(&self, pitch_rad: f64) -> [f64; 9] {
        let (sin, cos) = pitch_rad.sin_cos();
        product(&self.homography, &[cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0])
    }

    /// The pixel of a point of the face.
    pub fn pixel(&self, x: f64, z: f64) -> (f64, f64) {
        let h = &self.homography;
        let w = h[6] * x + h[7] * z + h[8];
        ((h[0] * x + h[1] * z + h[2]) / w, (h[3] * x + h[4] * z + h[5]) / w)
    }

    fn improved(&self, picture: &GrayImage, reach: f64) -> Option<Self> {
        let mut normal = [[0.0; UNKNOWNS]; UNKNOWNS];
        let mut right_side = [0.0; UNKNOWNS];
        for (inner, radius) in [(true, self.rim), (false, 1.0)] {
            let mut seen = 0;
            // The rim is brighter than what it encloses; around it there is sky and ground.
            let brighter = inner;
            for ray in 0..RAYS {
                let Some(place) = self.edge(picture, ray, radius, reach, brighter) else {
                    continue;
                };
                seen += 1;
                let (sin, cos) = (TAU * ray as f64 / RAYS as f64).sin_cos();
                let growths = [f64::from(u8::from(inner)), f64::from(u8::from(!inner))];
                let row = [
                    sin,
                    cos,
                    radius * growths[0],
                    growths[1],
                    radius * (sin * sin - cos * cos),
                    radius * 2.0 * sin * cos,
                    radius * radius * sin,
                    radius * radius * cos,
                ];
                let weight = (1.0 - (place / reach).powi(2)).max(0.0).powi(2);
                for i in 0..UNKNOWNS {
                    for k in 0..UNKNOWNS {
                        normal[i][k] += weight * row[i] * row[k];
                    }
                    right_side[i] += weight * row[i] * place;
                }
            }
            if seen < RAYS_MIN {
                return None;
            }
        }
        for k in 0..UNKNOWNS {
            normal[k][k] += (EDGE / SIZES[k]).powi(2);
        }
        let [right, down, inner, outer, along, across, tilt_right, tilt_down] = solve(normal, right_side)?;
        let step = [
            1.0 + outer + along,
            across,
            right,
            across,
            1.0 + outer - along,
            down,
            -tilt_right,
            -tilt_down,
            1.0,
        ];
        Some(Self {
            homography: product(&self.homography, &step),
            rim: self.rim * (1.0 + inner) / (1.0 + outer),
        })
    }

    /// How much further out than `radius` a ray has its largest step, or its largest rise.
    fn edge(&self, picture: &GrayImage, ray: usize, radius: f64, reach: f64, rise_only: bool) -> Option<f64> {
        let (sin, cos) = (TAU * ray as f64 / RAYS as f64).sin_cos();
        if cos > COSINE_MAX {
            return None;
        }
        let step = 2.0 * reach / (SAMPLES - 1) as f64;
        let mut sums = [0.0; SAMPLES + 1];
        for k in 0..SAMPLES {
            let place = radius - reach + k as f64 * step;
            let (column, row) = self.pixel(place * sin, place * cos);
            sums[k + 1] = sums[k] + gray(picture, column, row)?;
        }
        let rise = |k: usize| ((sums[k + WINDOW] - sums[k]) - (sums[k] - sums[k - WINDOW])) / WINDOW as f64;
        let size = |k: usize| if rise_only { rise(k) } else { rise(k).abs() };
        let best = (WINDOW..=SAMPLES - WINDOW).max_by(|a, b| size(*a).total_cmp(&size(*b)))?;
        // Between samples `best - 1` and `best`.
        let place = (best as f64 - 0.5) * step - reach;
        (size(best) >= STEP_MIN).then_some(place)
    }
}

/// The gray value between four pixels.
fn gray(picture: &GrayImage, column: f64, row: f64) -> Option<f64> {
    if !(column >= 0.0 && row >= 0.0) {
        return None;
    }
    let (x, y) = (column as u32, row as u32);
    let at = |x: u32, y: u32| picture.get_pixel_checked(x, y).map(|pixel| f64::from(pixel.0[0]));
    let (u, v) = (column - f64::from(x), row - f64::from(y));
    let (right, down) = (x.saturating_add(1), y.saturating_add(1));
    let above = (1.0 - u) * at(x, y)? + u * at(right, y)?;
    let below = (1.0 - u) * at(x, down)? + u * at(right, down)?;
    Some((1.0 - v) * above + v * below)
}

fn product(a: &[f64; 9], b: &[f64; 9]) -> [f64; 9] {
    std::array::from_fn(|k| (0..3).map(|j| a[k / 3 * 3 + j] * b[3 * j + k % 3]).sum())
}

/// The solution of a symmetric, positive definite system.
fn solve(a: [[f64; UNKNOWNS]; UNKNOWNS], b: [f64; UNKNOWNS]) -> Option<[f64; UNKNOWNS]> {
    let solution: [f64; UNKNOWNS] = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from(a)
        .cholesky()?
        .solve(&SVector::from(b))
        .into();
    solution.iter().all(|value| value.is_finite()).then_some(solution)
}
