//! The wheel's centre and radius, refined on the rim's inner edge: the outer edge lies against soil, grousers and sky.

use crate::rim::{Rim, project};
use messages::Frame;

/// Rays from the wheel's centre on which the edge is looked for.
const RAYS: usize = 108;
/// Samples along a ray, evenly about the edge's expected place.
const SAMPLES: usize = 25;
/// The same, as a multiple of what a processor works on at once.
const LANES: usize = SAMPLES.next_multiple_of(8);
/// Distance of the samples [px].
const SAMPLE_PX: f64 = 0.5;
/// Cosine of the angle from straight down below which soil seldom hides the inner edge.
const COSINE_MAX: f64 = 0.72;
/// Gray values between the rim and its inside, below which a ray says nothing.
const STEP_MIN: f32 = 5.0;
/// Rays that make a circle, by their weights.
const RAYS_MIN: f64 = 24.0;
const ITERATIONS: usize = 10;
/// What the given geometry is known to: centre [px], radius (relative), and one ray's edge [px].
const CENTER_SIGMA_PX: f64 = 1.5;
const RADIUS_SIGMA: f64 = 0.004;
const EDGE_SIGMA_PX: f64 = 0.4;
/// Residuals that the first and the last iteration still count [px].
const RESIDUAL_PX: (f64, f64) = (4.0, 1.2);

/// How far the wheel is from where the frame's geometry puts it, in outer wheel radii.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// To the right of straight down.
    pub right: f64,
    /// Downwards.
    pub down: f64,
    /// Relative change of the radii.
    pub growth: f64,
}

impl Shift {
    /// None at all.
    pub const NONE: Self = Self {
        right: 0.0,
        down: 0.0,
        growth: 0.0,
    };

    /// Fits a circle to the inner edge; `None` where too little of it can be seen.
    #[must_use]
    #[inline(always)]
    pub fn find(image: &[u8], width: usize, frame: &Frame) -> Option<Self> {
        let step = SAMPLE_PX / frame.wheel_radius_px;
        let ratio = frame.rim_radius_px / frame.wheel_radius_px;
        let (turn_sin, turn_cos) = (std::f64::consts::TAU / RAYS as f64).sin_cos();
        // Half a turn from straight down, each ray from the one before.
        let (mut sin, mut cos) = (0.0, -1.0);
        let mut edges = [(0.0, 0.0, 0.0); RAYS];
        let mut count = 0;
        for _ in 0..RAYS {
            (sin, cos) = (sin * turn_cos + cos * turn_sin, cos * turn_cos - sin * turn_sin);
            if cos <= COSINE_MAX
                && let Some(place) = edge(image, width, &frame.homography, (sin, cos), ratio, step)
            {
                edges[count] = (sin, cos, place);
                count += 1;
            }
        }
        let [right, down, outward] = circle(&edges[..count], step / SAMPLE_PX)?;
        Some(Self {
            right,
            down,
            growth: outward / ratio,
        })
    }

    /// The rim where it really is.
    #[must_use]
    pub fn applied(&self, rim: &Rim) -> Rim {
        let mut moved = rim.clone();
        let plane = &mut moved.plane;
        let scale = 1.0 / (1.0 + self.growth);
        for k in 0..3 {
            plane[k] = (plane[k] - self.right * plane[6 + k]) * scale;
            plane[3 + k] = (plane[3 + k] - self.down * plane[6 + k]) * scale;
        }
        let image = &mut moved.image;
        for row in image.chunks_exact_mut(3) {
            row[2] += self.right * row[0] + self.down * row[1];
            row[0] *= 1.0 + self.growth;
            row[1] *= 1.0 + self.growth;
        }
        moved
    }
}

/// Where on a ray the gray values rise the most, outwards from the expected place, in outer radii.
#[inline(always)]
fn edge(
    image: &[u8],
    width: usize,
    homography: &[f64; 9],
    (sin, cos): (f64, f64),
    ratio: f64,
    step: f64,
) -> Option<f64> {
    // Over these few pixels the ray is seen evenly.
    let reach = (SAMPLES / 2) as f64 * step;
    let from = project(homography, (ratio - reach) * sin, (ratio - reach) * cos)?;
    let to = project(homography, (ratio + reach) * sin, (ratio + reach) * cos)?;
    let least = from.0.min(to.0).min(from.1).min(to.1);
    if !(least >= 0.0 && from.0.max(to.0) + 1.0 < width as f64) {
        return None;
    }
    let share = 1.0 / (SAMPLES - 1) as f32;
    let (column, row) = (from.0 as f32, from.1 as f32);
    let (right, down) = (share * (to.0 as f32 - column), share * (to.1 as f32 - row));
    let grays = samples(image, width, (column, row), (right, down))?;
    // Sums of the gray values up to each sample.
    let mut sums = [0.0_f32; SAMPLES + 1];
    for j in 0..SAMPLES {
        sums[j + 1] = sums[j] + grays[j];
    }
    // Three samples against three: the mean rise over 2 px.
    let rise = |j: usize| (sums[j + 4] - sums[j + 1]) - (sums[j] - sums[j - 3]);
    let (mut best, mut most) = (0, 3.0 * STEP_MIN);
    for j in 3..SAMPLES - 3 {
        if rise(j) > most {
            (best, most) = (j, rise(j));
        }
    }
    if best <= 3 || best >= SAMPLES - 4 {
        return None;
    }
    let (before, after) = (rise(best - 1), rise(best + 1));
    let between = 0.5 * (before - after) / (before - 2.0 * most + after);
    let between = if between.abs() <= 0.5 { f64::from(between) } else { 0.0 };
    Some((best as f64 + between - (SAMPLES / 2) as f64) * step)
}

/// The gray values along a ray, each between the pixels right of and below a place that is not negative.
#[inline(always)]
fn samples(image: &[u8], width: usize, (column, row): (f32, f32), (right, down): (f32, f32)) -> Option<[f32; LANES]> {
    // A value below 2^22 and this has a unit of 1: its last bits are the whole number next to the value.
    const LARGE: f32 = 12_582_912.0;
    let (mut columns, mut rows) = ([0_u32; LANES], [0_u32; LANES]);
    let (mut u, mut v) = ([0.0_f32; LANES], [0.0_f32; LANES]);
    for j in 0..LANES {
        let (x, y) = (column + j as f32 * right, row + j as f32 * down);
        let (i, k) = (x - 0.5 + LARGE, y - 0.5 + LARGE);
        (columns[j], rows[j]) = (i.to_bits() & 0x003f_ffff, k.to_bits() & 0x003f_ffff);
        (u[j], v[j]) = (x - (i - LARGE), y - (k - LARGE));
    }
    let mut corners = [[0.0_f32; LANES]; 4];
    for j in 0..SAMPLES {
        let first = (rows[j] as usize)
            .checked_mul(width)?
            .checked_add(columns[j] as usize)?;
        let above: &[u8; 2] = image.get(first..)?.first_chunk()?;
        let below: &[u8; 2] = image.get(first.checked_add(width)?..)?.first_chunk()?;
        let grays = [above[0], above[1], below[0], below[1]];
        for (corner, gray) in corners.iter_mut().zip(grays) {
            corner[j] = f32::from(gray);
        }
    }
    let [a, b, c, d] = &corners;
    Some(std::array::from_fn(|j| {
        let (above, below) = (a[j] + u[j] * (b[j] - a[j]), c[j] + u[j] * (d[j] - c[j]));
        above + v[j] * (below - above)
    }))
}

/// Right, down and outward of the circle through the edges `(sin, cos, outward)`: Tukey's weights, and a prior from what
/// the geometry is known to. `pixel` is one pixel in outer radii.
#[inline(always)]
fn circle(edges: &[(f64, f64, f64)], pixel: f64) -> Option<[f64; 3]> {
    if (edges.len() as f64) < RAYS_MIN {
        return None;
    }
    let mut agreeing = 0.0;
    let variance = (EDGE_SIGMA_PX * pixel).powi(2);
    let center = variance / (CENTER_SIGMA_PX * pixel).powi(2);
    let prior = [center, center, variance / (RADIUS_SIGMA * RADIUS_SIGMA)];
    let mut found = [0.0, 0.0, median(edges)];
    let mut reach = RESIDUAL_PX.0 * pixel;
    for iteration in 0..ITERATIONS {
        let mut normal = [[0.0; 3]; 3];
        let mut right_side = [0.0; 3];
        agreeing = 0.0;
        for &(sin, cos, place) in edges {
            let row = [sin, cos, 1.0];
            let residual = place - row[0] * found[0] - row[1] * found[1] - found[2];
            let weight = (1.0 - (residual / reach).powi(2)).max(0.0).powi(2);
            agreeing += weight;
            for i in 0..3 {
                let weighted = weight * row[i];
                for k in 0..3 {
                    normal[i][k] += weighted * row[k];
                }
                right_side[i] += weighted * place;
            }
        }
        for k in 0..3 {
            normal[k][k] += prior[k];
        }
        found = solve(&normal, right_side)?;
        if iteration >= 2 {
            reach = (0.7 * reach).max(RESIDUAL_PX.1 * pixel);
        }
    }
    (agreeing >= RAYS_MIN).then_some(found)
}

fn median(edges: &[(f64, f64, f64)]) -> f64 {
    let mut places = [f64::INFINITY; RAYS];
    for (place, edge) in places.iter_mut().zip(edges) {
        *place = edge.2;
    }
    places.sort_unstable_by(f64::total_cmp);
    places[edges.len() / 2]
}

/// Cramer's rule.
#[inline(always)]
fn solve(a: &[[f64; 3]; 3], b: [f64; 3]) -> Option<[f64; 3]> {
    let determinant = |m: &[[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = determinant(a);
    let solution = std::array::from_fn(|column| {
        let mut replaced = *a;
        for (row, value) in replaced.iter_mut().zip(b) {
            row[column] = value;
        }
        determinant(&replaced) / whole
    });
    solution.iter().all(|value: &f64| value.is_finite()).then_some(solution)
}
