//! The wheel-terrain interface as the line, a row or slightly tilted, across which the rim's cells differ most consistently.

use crate::cells::{COLUMNS, Cells};
use crate::ring::Ring;
use crate::rows::ROWS;
use crate::weights::{FEATURES, Feature};
use std::ops::Range;

/// Slopes of the lines: rows of height per distance outwards.
pub const TILTS: [f32; 9] = [-0.30, -0.20, -0.12, -0.055, 0.0, 0.055, 0.12, 0.20, 0.30];
/// Distance from the middle at which all lines of a row meet, in outer radii.
const PIVOT: f32 = 0.45;
/// Rows above and below a line that are compared: of the narrow, the middle and the wide window.
const WINDOWS: [usize; 3] = [3, 6, 12];
/// Rows above and below a line whose texture is compared.
const WIDE: usize = WINDOWS[2];
/// Empty rows above the first and below the last row, into which a tilted line and its window may reach.
const MARGIN: usize = 40;
/// Edges of a column with its margins: edge `k` is the upper one of row `k - MARGIN`.
const EDGES: usize = ROWS + 2 * MARGIN + 1;
/// Lines of a tilt, with those that a window beyond the first and last row needs.
const LINES: usize = ROWS + 2 * WIDE;
/// Lines that are summed up at once: their number, and where they begin, is a multiple of it.
const VECTOR: usize = 8;
const _: () = assert!(LINES.is_multiple_of(VECTOR) && MARGIN >= VECTOR);
/// Pixels of a column on either side of a line, below which it says nothing.
const COLUMN_MIN: f32 = 2.5;
/// Pixels of all columns below which a line is none.
const LINE_MIN: f32 = 6.0;
/// Heights between which a line may meet the outer circle.
const HEIGHTS: (f32, f32) = (0.25, 0.998);
/// Row down to which the rim is taken to be free of soil: what it looks like.
const FREE: usize = ROWS * 3 / 10;
/// Neighbouring pixels are not independent: their noise counts as many times.
const CORRELATION: f32 = 6.0;
/// Variance of the log gray values, and square of their differences, below which nothing is told apart.
const VARIANCE_MIN: f32 = 3e-4;
const TEXTURE_MIN: f32 = 5e-5;
/// Rows next to a line whose outer edge may be soil or not.
const EDGE_GAP: usize = 1;
/// A middling step across the outer edge, and for how many rows it counts.
const EDGE: f32 = 0.15;
const EDGE_ROWS: f32 = 1.0;
/// Step across the outer edge below which nothing is told apart.
const EDGE_MIN: f32 = 0.02;
/// Rows from which on a line can meet the circle within [`HEIGHTS`].
pub const FIRST: usize = 16;
/// Rows from there on.
const PART: usize = ROWS - FIRST;
/// Rows above a line that still belong to it.
const SAME: usize = 10;

/// Sums over the columns of one line: of each window the weight of the columns, their steps, and the steps' squares; and the
/// four sums of the cells over all that lies above the line.
const TERMS: usize = 3 * WINDOWS.len();

/// What speaks for or against each line of a tilt.
pub type Features = [[f32; ROWS]; FEATURES];

/// The work space of one side.
#[derive(Clone, Debug)]
pub struct Contrast {
    /// Sums over all rows above each edge of each column.
    above: [[[f32; EDGES]; COLUMNS]; 4],
    /// Terms of each column and edge.
    columns: [[[f32; EDGES]; COLUMNS]; TERMS],
    /// First and last edge between pixels.
    bands: [(usize, usize); COLUMNS],
    lines: [[f32; LINES]; TERMS],
    regions: [[f32; LINES]; 4],
    /// The features of each line, by tilt, feature and row.
    pub features: [Features; TILTS.len()],
    /// Whether there is such a line at all.
    pub known: [[bool; ROWS]; TILTS.len()],
    /// Height at which each line meets the outer circle; NaN where it does not.
    pub heights: [[f32; ROWS]; TILTS.len()],
    /// The rows of each tilt whose lines meet it within [`HEIGHTS`].
    pub rows: [Range<usize>; TILTS.len()],
}

impl Contrast {
    /// Prepares the work space.
    #[must_use]
    pub fn new() -> Box<Self> {
        let heights = TILTS.map(|tilt| std::array::from_fn(|row| meets_circle(row, tilt)));
        Box::new(Self {
            above: [[[0.0; EDGES]; COLUMNS]; 4],
            columns: [[[0.0; EDGES]; COLUMNS]; TERMS],
            bands: [(0, 0); COLUMNS],
            lines: [[0.0; LINES]; TERMS],
            regions: [[0.0; LINES]; 4],
            features: std::array::from_fn(|tilt| prior_features(TILTS[tilt], &heights[tilt])),
            known: [[false; ROWS]; TILTS.len()],
            rows: heights.each_ref().map(|heights: &[f32; ROWS]| {
                let within = |row: &usize| heights[*row] > HEIGHTS.0 && heights[*row] < HEIGHTS.1;
                let first = (0..ROWS).find(within).unwrap_or(0);
                first..(first..ROWS).rfind(within).map_or(first, |last| last + 1)
            }),
            heights,
        })
    }

    /// Fills the features of every line. The largest step of the middle window, as a log ratio, is the side's contrast.
    #[inline(always)]
    pub fn measure(&mut self, cells: &Cells, ring: &Ring) -> f32 {
        self.sum_above(cells);
        for column in 0..COLUMNS {
            for (k, window) in WINDOWS.into_iter().enumerate() {
                self.compare(column, window, 3 * k);
            }
        }
        let whole = self.whole();
        let free = self.free();
        let edges = edge_features(ring);
        for (tilt, slope) in TILTS.into_iter().enumerate() {
            self.sum_columns(slope);
            let rows = self.rows[tilt].clone();
            self.known[tilt] = [false; ROWS];
            for row in rows.clone() {
                self.known[tilt][row] = self.lines[0][row + WIDE] >= LINE_MIN;
            }
            let features = &mut self.features[tilt];
            for k in 0..WINDOWS.len() {
                window_features(&self.lines[3 * k..], &self.regions, k, features);
            }
            texture_features(&self.regions, &whole, free, features);
            region_features(&self.regions, &whole, features);
            let heights = &self.heights[tilt];
            let features = &mut features[Feature::EdgeAbove as usize..];
            for (row, height) in rows.clone().zip(&heights[rows]) {
                let edge = edges[((height * ROWS as f32) as usize).min(ROWS - 1)];
                for (feature, value) in features.iter_mut().zip(edge) {
                    feature[row] = value;
                }
            }
        }
        self.relate()
    }

    #[inline(always)]
    fn sum_above(&mut self, cells: &Cells) {
        for (column, rows) in cells.cells.iter().enumerate() {
            let first = rows.iter().position(|cell| cell[0] > 0.0).unwrap_or(ROWS);
            let last = rows
                .iter()
                .rposition(|cell| cell[0] > 0.0)
                .map_or(first, |last| last + 1);
            let mut sums = [0.0; 4];
            for above in &mut self.above {
                above[column][..=first + MARGIN].fill(0.0);
            }
            for (cell, edge) in rows[first..last].iter().zip(first + MARGIN + 1..) {
                for ((sum, value), above) in sums.iter_mut().zip(cell).zip(&mut self.above) {
                    *sum += value;
                    above[column][edge] = *sum;
                }
            }
            for (sum, above) in sums.iter().zip(&mut self.above) {
                above[column][last + MARGIN + 1..].fill(*sum);
            }
            self.bands[column] = (first + MARGIN, last + MARGIN);
        }
    }

    /// Per edge of a column: the step of the mean, weighted by the pixels it rests on, and its square.
    #[inline(always)]
    fn compare(&mut self, column: usize, window: usize, term: usize) {
        let (first, last) = self.bands[column];
        let size = last - first;
        let [count, log] = [0, 1].map(|k| {
            let at = |edge: usize| &self.above[k][column][edge..edge + size];
            [at(first.saturating_sub(window)), at(first), at(first + window)]
        });
        let [weights, steps, squares] = &mut self.columns[term..term + 3] else {
            return;
        };
        for terms in [&mut *weights, &mut *steps, &mut *squares] {
            terms[column][first - VECTOR..first].fill(0.0);
            terms[column][last..last + VECTOR].fill(0.0);
        }
        let (weights, steps, squares) = (
            &mut weights[column][first..last],
            &mut steps[column][first..last],
            &mut squares[column][first..last],
        );
        for k in 0..size {
            let (above, below) = (count[1][k] - count[0][k], count[2][k] - count[1][k]);
            let known = above >= COLUMN_MIN && below >= COLUMN_MIN;
            let (na, nb) = (1.0 / above.max(1.0), 1.0 / below.max(1.0));
            let step = (log[2][k] - log[1][k]) * nb - (log[1][k] - log[0][k]) * na;
            let weight = if known { 2.0 / (na + nb) } else { 0.0 };
            weights[k] = weight;
            steps[k] = weight * step;
            squares[k] = weight * step * step;
        }
    }

    /// Sums over the columns along the lines of one tilt.
    #[inline(always)]
    fn sum_columns(&mut self, tilt: f32) {
        self.lines = [[0.0; LINES]; TERMS];
        self.regions = [[0.0; LINES]; 4];
        for column in 0..COLUMNS {
            let outwards = (column as f32 + 0.5) / COLUMNS as f32 - PIVOT;
            // Line l is edge l + lift of this column.
            let lift = ((MARGIN - WIDE) as f32 + tilt * outwards * ROWS as f32).round() as usize;
            let (first, last) = self.bands[column];
            let line = |edge: usize| edge.saturating_sub(lift).min(LINES);
            let (from, to) = (line(first) / VECTOR * VECTOR, line(last).next_multiple_of(VECTOR));
            for (line, terms) in self.lines.iter_mut().zip(&self.columns) {
                add(&mut line[from..to], &terms[column][from + lift..to + lift]);
            }
            // What lies above the last edge lies above all further ones.
            for (line, sums) in self.regions.iter_mut().zip(&self.above) {
                add(&mut line[from..], &sums[column][from + lift..LINES + lift]);
            }
        }
    }

    /// Sums over the whole side.
    #[inline(always)]
    fn whole(&self) -> [f32; 4] {
        self.above
            .each_ref()
            .map(|sums| sums.iter().map(|column| column[EDGES - 1]).sum())
    }

    /// Texture of the rim where no soil is.
    #[inline(always)]
    fn free(&self) -> f32 {
        let sum = |k: usize| self.above[k].iter().map(|column| column[FREE + MARGIN]).sum::<f32>();
        sum(3) / sum(0).max(1.0)
    }

    /// What a line's features are among those of the other lines.
    #[inline(always)]
    fn relate(&mut self) -> f32 {
        let mut largest = [1e-3_f32; WINDOWS.len()];
        let mut best = [0.0_f32; ROWS];
        for ((features, known), rows) in self.features.iter().zip(&self.known).zip(&self.rows) {
            for (k, largest) in largest.iter_mut().enumerate() {
                for (share, known) in features[2 * k + 1][rows.clone()].iter().zip(&known[rows.clone()]) {
                    *largest = largest.max(if *known { *share } else { 0.0 });
                }
            }
            let scores = &features[Feature::MiddleContrast as usize];
            for ((best, score), known) in best.iter_mut().zip(scores).zip(known) {
                *best = best.max(if *known { *score } else { 0.0 });
            }
        }
        let (mut above, mut below) = ([0.0_f32; ROWS], [0.0_f32; ROWS]);
        for row in FIRST + SAME..ROWS {
            above[row] = above[row - 1].max(best[row - SAME]);
        }
        for row in (FIRST..ROWS - SAME).rev() {
            below[row] = below[row + 1].max(best[row + SAME]);
        }
        for features in &mut self.features {
            for (k, largest) in largest.iter().enumerate() {
                let scale = 1.0 / largest;
                for share in &mut features[2 * k + 1] {
                    *share *= scale;
                }
            }
            features[Feature::Above as usize] = above;
            features[Feature::Below as usize] = below;
        }
        largest[1]
    }
}

#[inline(always)]
fn variance(count: f32, log: f32, square: f32) -> f32 {
    let share = 1.0 / count.max(1.0);
    let mean = log * share;
    (square * share - mean * mean).max(0.0)
}

/// A t-like score: the mean step against its spread over the columns and the pixels' noise; and the step itself.
#[inline(always)]
fn window_features(lines: &[[f32; LINES]], regions: &[[f32; LINES]; 4], k: usize, features: &mut Features) {
    let window = WINDOWS[k];
    let [weights, steps, squares] = [0, 1, 2].map(|term| part(&lines[term], 0));
    let sums = |edge: isize| [0, 1, 2].map(|sum| part(&regions[sum], edge));
    let (from, here, to) = (sums(-(window as isize)), sums(0), sums(window as isize));
    let [contrast, share] = &mut features[2 * k..2 * k + 2] else {
        return;
    };
    let (contrast, shares) = (&mut contrast[FIRST..], &mut share[FIRST..]);
    for row in 0..PART {
        let na = here[0][row] - from[0][row];
        let nb = to[0][row] - here[0][row];
        let above = variance(na, here[1][row] - from[1][row], here[2][row] - from[2][row]);
        let below = variance(nb, to[1][row] - here[1][row], to[2][row] - here[2][row]);
        let noise = CORRELATION * (above / na.max(1.0) + below / nb.max(1.0));
        let share = 1.0 / weights[row].max(1e-3);
        let step = steps[row] * share;
        let spread = (squares[row] * share - step * step).max(0.0);
        let known = weights[row] / (weights[row] + 15.0);
        contrast[row] = known * ln(1.0 + step * step / (0.001 + 0.3 * spread + noise));
        shares[row] = known * step.abs();
    }
}

/// Soil is rougher than a rim: texture and variance next to the line, and texture of all above and all below.
#[inline(always)]
fn texture_features(regions: &[[f32; LINES]; 4], whole: &[f32; 4], free: f32, features: &mut Features) {
    let rim = ln(free + TEXTURE_MIN);
    let all = ln(whole[3] / whole[0].max(1.0) + TEXTURE_MIN);
    let sums = |edge: isize| regions.each_ref().map(|sums| part(sums, edge));
    let (from, here, to) = (sums(-(WIDE as isize)), sums(0), sums(WIDE as isize));
    let strip = |from: [&[f32; PART]; 4], to: [&[f32; PART]; 4], row: usize| {
        let count = to[0][row] - from[0][row];
        let known = count / (count + 40.0);
        let texture = (to[3][row] - from[3][row]).max(0.0) / count.max(1.0);
        let spread = variance(count, to[1][row] - from[1][row], to[2][row] - from[2][row]);
        (
            known * (ln(texture + TEXTURE_MIN) - rim),
            known * ln(spread + VARIANCE_MIN),
        )
    };
    let share = 1.0 / whole[0].max(1.0);
    let mut found = [[0.0; PART]; 5];
    for row in 0..PART {
        let ((above, spread_above), (below, spread_below)) = (strip(from, here, row), strip(here, to, row));
        let (na, ea) = (here[0][row], here[3][row]);
        let (nb, eb) = (whole[0] - na, (whole[3] - ea).max(0.0));
        let (la, lb) = (ln(ea / na.max(1.0) + TEXTURE_MIN), ln(eb / nb.max(1.0) + TEXTURE_MIN));
        found[0][row] = above;
        found[1][row] = below;
        found[2][row] = spread_below - spread_above;
        found[3][row] = all - (na * la + nb * lb) * share;
        found[4][row] = nb / (nb + 200.0) * (lb - la);
    }
    for (feature, found) in features[Feature::RimTexture as usize..].iter_mut().zip(&found) {
        feature[FIRST..].copy_from_slice(found);
    }
}

/// All above against all below: Otsu's criterion, and two normal classes.
#[inline(always)]
fn region_features(regions: &[[f32; LINES]; 4], whole: &[f32; 4], features: &mut Features) {
    let share = 1.0 / whole[0].max(1.0);
    let variance_whole = variance(whole[0], whole[1], whole[2]);
    let (one, least) = (ln(variance_whole + VARIANCE_MIN), 1.0 / variance_whole.max(1e-5));
    let [counts, logs, squares] = [0, 1, 2].map(|sum| part(&regions[sum], 0));
    let mut found = [[0.0; PART]; 3];
    for row in 0..PART {
        let (na, sa, qa) = (counts[row], logs[row], squares[row]);
        let nb = whole[0] - na;
        let (va, vb) = (variance(na, sa, qa), variance(nb, whole[1] - sa, whole[2] - qa));
        let (above, below) = (ln(va + VARIANCE_MIN), ln(vb + VARIANCE_MIN));
        found[0][row] = 1.0 - (na * va + nb * vb) * share * least;
        found[1][row] = one - (na * above + nb * below) * share;
        found[2][row] = nb / (nb + 200.0) * (below - above);
    }
    for (feature, found) in features[Feature::Between as usize..].iter_mut().zip(&found) {
        feature[FIRST..].copy_from_slice(found);
    }
}

/// The lines of the rows from [`FIRST`] on, or those so many rows further down.
#[inline(always)]
fn part(line: &[f32; LINES], further: isize) -> &[f32; PART] {
    // Always there: no window is wider than the lines beyond the first and last row.
    let start = (FIRST + WIDE).saturating_add_signed(further);
    line[start..].first_chunk().unwrap_or(const { &[0.0; PART] })
}

/// Of each height: how much of the wheel's outer edge is seen just above it, just below it, and over all above and below.
#[inline(always)]
fn edge_features(ring: &Ring) -> [[f32; 4]; ROWS] {
    let mut sums = [0.0; ROWS + 1];
    for (row, step) in ring.iter().enumerate() {
        sums[row + 1] = sums[row] + step;
    }
    let mean = |from: usize, to: usize| {
        let (from, to) = (from.min(ROWS), to.min(ROWS));
        // Few rows say little: a middling edge.
        let share = (sums[to] - sums[from] + EDGE_ROWS * EDGE) / (to.saturating_sub(from) as f32 + EDGE_ROWS);
        ln(share.max(0.0) + EDGE_MIN)
    };
    std::array::from_fn(|row| {
        let (above, below) = (row.saturating_sub(EDGE_GAP), row + EDGE_GAP + 1);
        [
            mean(above.saturating_sub(WIDE), above),
            mean(below, below + WIDE),
            mean(FREE.min(above), above),
            mean(below, ROWS),
        ]
    })
}

/// What is known of a line before the picture is seen; the other features are 0.
fn prior_features(tilt: f32, heights: &[f32; ROWS]) -> Features {
    let mut features = [[0.0; ROWS]; FEATURES];
    for row in FIRST..ROWS {
        let height = heights[row];
        features[Feature::Tilt as usize][row] = (tilt / 0.12).powi(2);
        features[Feature::Shallow as usize][row] = (height - 0.95).max(0.0);
        features[Feature::Deep as usize][row] = (0.65 - height).max(0.0);
    }
    features
}

#[inline(always)]
fn add(sums: &mut [f32], terms: &[f32]) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        *sum += term;
    }
}

/// Height at which the line through the pivot at this row meets the outer circle; NaN where it does not.
fn meets_circle(row: usize, tilt: f32) -> f32 {
    line_meets(row, tilt, 1.0)
}

/// The same of a circle of this radius.
pub(crate) fn line_meets(row: usize, tilt: f32, radius: f32) -> f32 {
    let start = row as f32 / ROWS as f32 - tilt * PIVOT;
    // z = start + tilt x and x² + z² = radius², x >= 0
    let (a, b, c) = (1.0 + tilt * tilt, tilt * start, start * start - radius * radius);
    let x = (-b + (b * b - a * c).sqrt()) / a;
    if x >= 0.0 { start + tilt * x } else { f32::NAN }
}

/// The natural logarithm of a positive normal number to 1e-4, in a form that a compiler can vectorise.
#[inline(always)]
fn ln(value: f32) -> f32 {
    let bits = value.to_bits();
    let exponent = (bits >> 23) as f32 - 127.0;
    let mantissa = f32::from_bits(bits & 0x007f_ffff | 0x3f80_0000);
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let q = s * s;
    exponent * std::f32::consts::LN_2 + 2.0 * s * (1.0 + q * (1.0 / 3.0 + q * (0.2 + q * (1.0 / 7.0))))
}
