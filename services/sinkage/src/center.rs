//! The wheel's centre and radius, refined on the rim's inner edge: the outer edge lies against soil, grousers and sky.

use crate::rim::{Rim, project};
use messages::Frame;

/// Rays from the wheel's centre on which the edge is looked for, and as a multiple of what a processor works on at once.
const RAYS: usize = 108;
const RAYS_ROOM: usize = RAYS.next_multiple_of(VECTOR);
const VECTOR: usize = 8;
/// Samples along a ray, evenly about the edge's expected place.
const SAMPLES: usize = 25;
/// The same, as a multiple of what a processor works on at once.
const LANES: usize = SAMPLES.next_multiple_of(VECTOR);
/// Samples of which as many are on either side that the rise of the gray values is known.
const RISES: usize = SAMPLES - 6;
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
/// A place that no edge has.
const NOWHERE: f32 = 1e3;
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
        let mut edges = Edges {
            sin: [0.0; RAYS_ROOM],
            cos: [0.0; RAYS_ROOM],
            place: [NOWHERE; RAYS_ROOM],
            count: 0,
        };
        for _ in 0..RAYS {
            (sin, cos) = (sin * turn_cos + cos * turn_sin, cos * turn_cos - sin * turn_sin);
            if cos <= COSINE_MAX
                && let Some(place) = edge(image, width, &frame.homography, (sin, cos), ratio, step)
            {
                (edges.sin[edges.count], edges.cos[edges.count]) = (sin as f32, cos as f32);
                edges.place[edges.count] = place as f32;
                edges.count += 1;
            }
        }
        let [right, down, outward] = circle(&edges, step / SAMPLE_PX)?;
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
    let (right, down) = (from.0.max(to.0) + 1.0, from.1.max(to.1) + 1.0);
    if !(least >= 0.0 && right < width as f64 && down < (image.len() / width) as f64) {
        return None;
    }
    let share = 1.0 / (SAMPLES - 1) as f32;
    let (column, row) = (from.0 as f32, from.1 as f32);
    let (right, down) = (share * (to.0 as f32 - column), share * (to.1 as f32 - row));
    let grays = samples(image, width, (column, row), (right, down))?;
    // Three samples against three: the mean rise over 2 px.
    let (mut threes, mut rises) = ([0.0; LANES - 2], [0.0; LANES - VECTOR]);
    for (three, grays) in threes.iter_mut().zip(grays.array_windows()) {
        let [first, second, third] = grays;
        *three = first + second + third;
    }
    for (j, rise) in rises[..RISES].iter_mut().enumerate() {
        *rise = threes[j + 4] - threes[j];
    }
    let mut most = [0.0_f32; VECTOR];
    for rises in rises.as_chunks::<VECTOR>().0 {
        most = std::array::from_fn(|k| if rises[k] > most[k] { rises[k] } else { most[k] });
    }
    let most = most.into_iter().fold(3.0 * STEP_MIN, f32::max);
    let best = rises.iter().position(|rise| *rise >= most)?;
    if best == 0 || best >= RISES - 1 {
        return None;
    }
    let (before, after) = (rises[best - 1], rises[best + 1]);
    let between = 0.5 * (before - after) / (before - 2.0 * most + after);
    let between = if between.abs() <= 0.5 { f64::from(between) } else { 0.0 };
    Some((best as f64 + 3.0 + between - (SAMPLES / 2) as f64) * step)
}

/// The gray values along a ray, each between the pixels right of and below a place that is not negative.
#[inline(always)]
fn samples(image: &[u8], width: usize, (column, row): (f32, f32), (right, down): (f32, f32)) -> Option<[f32; LANES]> {
    // A value below 2^22 and this has a unit of 1: its last bits are the whole number next to the value.
    const LARGE: f32 = 12_582_912.0;
    let mut firsts = [0_u32; LANES];
    let (mut u, mut v) = ([0.0_f32; LANES], [0.0_f32; LANES]);
    for j in 0..LANES {
        let (x, y) = (column + j as f32 * right, row + j as f32 * down);
        let (i, k) = (x - 0.5 + LARGE, y - 0.5 + LARGE);
        let (left, above) = (i.to_bits() & 0x003f_ffff, k.to_bits() & 0x003f_ffff);
        // No more than a picture has pixels, since all are within.
        firsts[j] = above.wrapping_mul(width as u32).wrapping_add(left);
        (u[j], v[j]) = (x - (i - LARGE), y - (k - LARGE));
    }
    // The four pixels around each place, as the bytes of a number.
    let mut corners = [0_u32; LANES];
    for (corner, first) in corners[..SAMPLES].iter_mut().zip(firsts) {
        let (first, below) = (first as usize, first as usize + width);
        let (Some([a, b]), Some([c, d])) = (image.get(first..first + 2), image.get(below..below + 2)) else {
            return None;
        };
        *corner = u32::from_le_bytes([*a, *b, *c, *d]);
    }
    let mut grays = [0.0; LANES];
    for (j, gray) in grays.iter_mut().enumerate() {
        let corner = |k: u32| (corners[j] >> (8 * k) & 0xff) as i32 as f32;
        let (above, below) = (
            corner(0) + u[j] * (corner(1) - corner(0)),
            corner(2) + u[j] * (corner(3) - corner(2)),
        );
        *gray = above + v[j] * (below - above);
    }
    Some(grays)
}

/// Where the rays meet the edge, outwards from its expected place; beyond `count`, [`NOWHERE`].
struct Edges {
    sin: [f32; RAYS_ROOM],
    cos: [f32; RAYS_ROOM],
    place: [f32; RAYS_ROOM],
    count: usize,
}

/// Right, down and outward of the circle through the edges: Tukey's weights, and a prior from what the geometry is known to.
/// `pixel` is one pixel in outer radii.
#[inline(always)]
fn circle(edges: &Edges, pixel: f64) -> Option<[f64; 3]> {
    if (edges.count as f64) < RAYS_MIN {
        return None;
    }
    let mut agreeing = 0.0;
    let variance = (EDGE_SIGMA_PX * pixel).powi(2);
    let center = variance / (CENTER_SIGMA_PX * pixel).powi(2);
    let prior = [center, center, variance / (RADIUS_SIGMA * RADIUS_SIGMA)];
    let mut found = [0.0, 0.0, median(edges)];
    let mut reach = RESIDUAL_PX.0 * pixel;
    for iteration in 0..ITERATIONS {
        let [w, s, c, ss, sc, cc, p, sp, cp] = moments(edges, found.map(|it| it as f32), reach as f32);
        agreeing = w;
        let mut normal = [[ss, sc, s], [sc, cc, c], [s, c, w]];
        for k in 0..3 {
            normal[k][k] += prior[k];
        }
        found = solve(&normal, [sp, cp, p])?;
        if iteration >= 2 {
            reach = (0.7 * reach).max(RESIDUAL_PX.1 * pixel);
        }
    }
    (agreeing >= RAYS_MIN).then_some(found)
}

/// Sums over the edges, by their weights, of 1, sin, cos, sin², sin cos, cos², and of the place, times sin, times cos.
#[inline(always)]
fn moments(edges: &Edges, found: [f32; 3], reach: f32) -> [f64; 9] {
    let mut sums = [[0.0_f32; VECTOR]; 9];
    let [sin, cos, place] = [&edges.sin, &edges.cos, &edges.place].map(|of| of.as_chunks::<VECTOR>().0);
    for ((sin, cos), place) in sin.iter().zip(cos).zip(place) {
        let mut terms = [[0.0; VECTOR]; 9];
        for k in 0..VECTOR {
            let (s, c, p) = (sin[k], cos[k], place[k]);
            let residual = (p - s * found[0] - c * found[1] - found[2]) / reach;
            let kept = (1.0 - residual * residual).max(0.0);
            let w = kept * kept;
            let (ws, wc) = (w * s, w * c);
            let all = [w, ws, wc, ws * s, ws * c, wc * c, w * p, ws * p, wc * p];
            for (terms, term) in terms.iter_mut().zip(all) {
                terms[k] = term;
            }
        }
        for (sums, terms) in sums.iter_mut().zip(terms) {
            for (sum, term) in sums.iter_mut().zip(terms) {
                *sum += term;
            }
        }
    }
    sums.map(|lanes| lanes.into_iter().map(f64::from).sum())
}

fn median(edges: &Edges) -> f64 {
    let mut places = edges.place;
    let (_, median, _) = places[..edges.count].select_nth_unstable_by(edges.count / 2, f32::total_cmp);
    f64::from(*median)
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
