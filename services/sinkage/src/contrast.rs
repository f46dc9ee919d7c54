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
const MARGIN: usize = 48;
/// Edges of a column with its margins: edge `k` is the upper one of row `k - MARGIN`.
const EDGES: usize = ROWS + 2 * MARGIN + 1;
/// Lines that are worked on at once: their number, and where they begin, is a multiple of it.
const VECTOR: usize = 8;
/// Lines of a tilt, with those that a window beyond the first and last row needs, and room for [`ROWS`] from each on.
const LINES: usize = ROWS + 2 * MARGIN;
/// Edges before the first and after the last between pixels that a window or a vector reaches.
const REACH: usize = WIDE + VECTOR;
const _: () = assert!(LINES.is_multiple_of(VECTOR) && ROWS.is_multiple_of(VECTOR) && MARGIN >= REACH);
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
/// Rows above a line that still belong to it.
const SAME: usize = 10;

/// Of each window the weight of a column, its step, and the step's square.
const TERMS: usize = 3 * WINDOWS.len();
/// Those, and the four sums of the cells over all that lies above.
const SUMS: usize = TERMS + 4;

type Lines = [[f32; LINES]; SUMS];
/// Some features of the lines from the first that is looked at on. The compiler makes vectors where it knows that what is
/// written is not what is read, and how long it is.
type Found = [[f32; ROWS]; 5];

/// What speaks for or against each line of a tilt.
pub type Features = [[f32; ROWS]; FEATURES];

/// The work space of one side.
#[derive(Clone, Debug)]
pub struct Contrast {
    /// Of each column and edge, the terms, and the sums over all rows above.
    columns: [[[f32; EDGES]; COLUMNS]; SUMS],
    /// First and last edge between pixels.
    bands: [(usize, usize); COLUMNS],
    /// Sums of those over the columns along each line of one tilt.
    lines: Lines,
    found: Found,
    /// The features of each line, by tilt, feature and row.
    pub features: [Features; TILTS.len()],
    /// Whether there is such a line at all.
    pub known: [[bool; ROWS]; TILTS.len()],
    /// Height at which each line meets the outer circle; NaN where it does not.
    pub heights: [[f32; ROWS]; TILTS.len()],
    /// The row of a side at which each line meets it.
    bins: [[u8; ROWS]; TILTS.len()],
    /// The rows of each tilt whose lines meet it within [`HEIGHTS`].
    pub rows: [Range<usize>; TILTS.len()],
}

impl Contrast {
    /// Prepares the work space.
    #[must_use]
    pub fn new() -> Box<Self> {
        let heights = TILTS.map(|tilt| std::array::from_fn(|row| meets_circle(row, tilt)));
        Box::new(Self {
            columns: [[[0.0; EDGES]; COLUMNS]; SUMS],
            bands: [(0, 0); COLUMNS],
            lines: [[0.0; LINES]; SUMS],
            found: [[0.0; ROWS]; 5],
            features: std::array::from_fn(|tilt| prior_features(TILTS[tilt], &heights[tilt])),
            known: [[false; ROWS]; TILTS.len()],
            rows: heights.each_ref().map(|heights: &[f32; ROWS]| {
                let within = |row: &usize| heights[*row] > HEIGHTS.0 && heights[*row] < HEIGHTS.1;
                let first = (0..ROWS).find(within).unwrap_or(0);
                first..(first..ROWS).rfind(within).map_or(first, |last| last + 1)
            }),
            bins: heights.map(|heights| heights.map(|height| ((height * ROWS as f32) as u8).min(ROWS as u8 - 1))),
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
            let rows = self.rows[tilt].clone();
            self.sum_columns(slope, rows.clone());
            self.known[tilt] = [false; ROWS];
            for row in rows.clone() {
                self.known[tilt][row] = self.lines[0][row + WIDE] >= LINE_MIN;
            }
            let rows = rows.start / VECTOR * VECTOR..rows.end.next_multiple_of(VECTOR);
            let features = &mut self.features[tilt];
            for k in 0..WINDOWS.len() {
                window_features(&self.lines, k, rows.clone(), &mut self.found, features);
            }
            strip_features(&self.lines, free, rows.clone(), &mut self.found, features);
            region_features(&self.lines, &whole, rows.clone(), &mut self.found, features);
            for (feature, edges) in features[Feature::EdgeAbove as usize..].iter_mut().zip(&edges) {
                for (value, bin) in feature[rows.clone()].iter_mut().zip(&self.bins[tilt][rows.clone()]) {
                    *value = edges[usize::from(*bin)];
                }
            }
        }
        self.relate()
    }

    #[inline(always)]
    fn sum_above(&mut self, cells: &Cells) {
        for (column, (rows, band)) in cells.cells.iter().zip(&cells.bands).enumerate() {
            let (first, last) = (band.start + MARGIN, band.end + MARGIN);
            let mut sums = [0.0; 4];
            for above in &mut self.columns[TERMS..] {
                above[column][first - REACH..=first].fill(0.0);
            }
            for (cell, edge) in rows[band.clone()].iter().zip(first + 1..) {
                for ((sum, value), above) in sums.iter_mut().zip(cell).zip(&mut self.columns[TERMS..]) {
                    *sum += value;
                    above[column][edge] = *sum;
                }
            }
            for (sum, above) in sums.iter().zip(&mut self.columns[TERMS..]) {
                above[column][last + 1..last + REACH].fill(*sum);
            }
            self.bands[column] = (first, last);
        }
    }

    /// Per edge of a column: the step of the mean, weighted by the pixels it rests on, and its square.
    #[inline(always)]
    fn compare(&mut self, column: usize, window: usize, term: usize) {
        let (first, last) = self.bands[column];
        let size = (last - first).next_multiple_of(VECTOR);
        let (terms, sums) = self.columns.split_at_mut(TERMS);
        let [counts, logs] = [0, 1].map(|k| {
            let at = |edge: usize| &sums[k][column][edge..edge + size];
            at(first - window).iter().zip(at(first)).zip(at(first + window))
        });
        let [weights, steps, squares] = &mut terms[term..term + 3] else {
            return;
        };
        for terms in [&mut *weights, &mut *steps, &mut *squares] {
            terms[column][first - VECTOR..first].fill(0.0);
            terms[column][first + size..first + size + VECTOR].fill(0.0);
        }
        let [weights, steps, squares] = [weights, steps, squares].map(|terms| &mut terms[column][first..first + size]);
        let terms = weights.iter_mut().zip(steps).zip(squares);
        // Beyond the last edge there are no pixels, and so no weight.
        for ((((c0, c1), c2), ((l0, l1), l2)), ((weight_of, step_of), square_of)) in counts.zip(logs).zip(terms) {
            let (above, below) = (c1 - c0, c2 - c1);
            let known = (above >= COLUMN_MIN) & (below >= COLUMN_MIN);
            let (na, nb) = (above.max(1.0), below.max(1.0));
            let step = (l2 - l1) / nb - (l1 - l0) / na;
            let weight = if known { 2.0 * na * nb / (na + nb) } else { 0.0 };
            *weight_of = weight;
            *step_of = weight * step;
            *square_of = weight * step * step;
        }
    }

    /// Sums over the columns along those lines of one tilt that a window about one of these rows needs.
    #[inline(always)]
    fn sum_columns(&mut self, tilt: f32, rows: Range<usize>) {
        let needed = rows.start / VECTOR..(rows.end + 2 * WIDE).div_ceil(VECTOR);
        let mut lifts = [0; COLUMNS];
        let (mut from, mut to) = ([0_u8; COLUMNS], [0_u8; COLUMNS]);
        // Sums of the columns that end before a vector of lines: they lie above all further ones.
        let mut ended = [[0.0; 4]; LINES / VECTOR + 1];
        for (column, lift) in lifts.iter_mut().enumerate() {
            let outwards = (column as f32 + 0.5) / COLUMNS as f32 - PIVOT;
            // Line l is edge l + lift of this column.
            *lift = ((MARGIN - WIDE) as f32 + tilt * outwards * ROWS as f32 + 0.5) as usize;
            let (first, last) = self.bands[column];
            let line = |edge: usize| edge.saturating_sub(*lift);
            let (first_line, last_line) = (line(first) / VECTOR, line(last).div_ceil(VECTOR));
            from[column] = first_line.clamp(needed.start, needed.end) as u8;
            to[column] = last_line.clamp(needed.start, needed.end) as u8;
            for (ended, sums) in ended[usize::from(to[column])].iter_mut().zip(&self.columns[TERMS..]) {
                *ended += sums[column][last];
            }
        }
        let mut beyond = [0.0; 4];
        for vector in needed {
            for (beyond, ended) in beyond.iter_mut().zip(ended[vector]) {
                *beyond += ended;
            }
            let mut sums = [[0.0; VECTOR]; SUMS];
            for (sum, beyond) in sums[TERMS..].iter_mut().zip(beyond) {
                *sum = [beyond; VECTOR];
            }
            let mut columns = 0_u32;
            for column in 0..COLUMNS {
                let meets = (from[column] <= vector as u8) & ((vector as u8) < to[column]);
                columns |= u32::from(meets) << column;
            }
            while columns != 0 {
                let column = columns.trailing_zeros() as usize % COLUMNS;
                columns &= columns - 1;
                let edge = (vector * VECTOR + lifts[column]).min(EDGES - VECTOR);
                for (sum, terms) in sums.iter_mut().zip(&self.columns) {
                    if let Some(terms) = terms[column][edge..].first_chunk::<VECTOR>() {
                        *sum = std::array::from_fn(|k| sum[k] + terms[k]);
                    }
                }
            }
            for (line, sum) in self.lines.iter_mut().zip(sums) {
                line.as_chunks_mut::<VECTOR>().0[vector] = sum;
            }
        }
    }

    /// Sums over the whole side.
    #[inline(always)]
    fn whole(&self) -> [f32; 4] {
        self.above_edge(EDGES)
    }

    /// Texture of the rim where no soil is.
    #[inline(always)]
    fn free(&self) -> f32 {
        let sums = self.above_edge(FREE + MARGIN);
        sums[3] / sums[0].max(1.0)
    }

    /// Sums over all columns above an edge.
    #[inline(always)]
    fn above_edge(&self, edge: usize) -> [f32; 4] {
        std::array::from_fn(|sum| {
            let columns = self.columns[TERMS + sum].iter().zip(&self.bands);
            columns
                .map(|(column, (first, last))| column[edge.clamp(*first, *last)])
                .sum()
        })
    }

    /// What a line's features are among those of the other lines.
    #[inline(always)]
    fn relate(&mut self) -> f32 {
        // Of each row first: a compiler makes vectors of that.
        let mut largest = [[1e-3_f32; ROWS]; WINDOWS.len()];
        let mut best = [0.0_f32; ROWS];
        for ((features, known), rows) in self.features.iter().zip(&self.known).zip(&self.rows) {
            let known = &known[rows.clone()];
            for (k, largest) in largest.iter_mut().enumerate() {
                raise(&mut largest[rows.clone()], &features[2 * k + 1][rows.clone()], known);
            }
            let scores = &features[Feature::MiddleContrast as usize];
            raise(&mut best[rows.clone()], &scores[rows.clone()], known);
        }
        let largest = largest.map(|rows| rows.into_iter().fold(0.0, f32::max));
        let (mut above, mut below) = ([0.0_f32; ROWS], [0.0_f32; ROWS]);
        for row in FIRST + SAME..ROWS {
            above[row] = above[row - 1].max(best[row - SAME]);
        }
        for row in (FIRST..ROWS - SAME).rev() {
            below[row] = below[row + 1].max(best[row + SAME]);
        }
        for (features, rows) in self.features.iter_mut().zip(&self.rows) {
            for (k, largest) in largest.iter().enumerate() {
                let scale = 1.0 / largest;
                for share in &mut features[2 * k + 1][rows.clone()] {
                    *share *= scale;
                }
            }
            features[Feature::Above as usize] = above;
            features[Feature::Below as usize] = below;
        }
        largest[1]
    }
}

/// To the values that are larger and known.
#[inline(always)]
fn raise(largest: &mut [f32], values: &[f32], known: &[bool]) {
    for ((largest, value), known) in largest.iter_mut().zip(values).zip(known) {
        *largest = largest.max(if *known { *value } else { 0.0 });
    }
}

/// Variance of values by one over their number, their sum, and the sum of their squares.
#[inline(always)]
fn variance(share: f32, sum: f32, squares: f32) -> f32 {
    let mean = sum * share;
    (squares * share - mean * mean).max(0.0)
}

/// A t-like score: the mean step against its spread over the columns and the pixels' noise; and the step itself.
#[inline(always)]
fn window_features(lines: &Lines, k: usize, rows: Range<usize>, found: &mut Found, features: &mut Features) {
    let (first, size, window) = (rows.start + WIDE, rows.len().min(ROWS), WINDOWS[k]);
    // Of the pixels between a line and the one a window further down: the noise of their mean, from the window above on.
    let mut noise = [0.0; LINES];
    let [(count, next_count), (log, next_log), (square, next_square)] =
        [0, 1, 2].map(|sum| strips(lines, sum, first - window, window));
    for l in 0..(size + window).next_multiple_of(VECTOR).min(ROWS) {
        let share = 1.0 / (next_count[l] - count[l]).max(1.0);
        noise[l] = CORRELATION * share * variance(share, next_log[l] - log[l], next_square[l] - square[l]);
    }
    let (above, below) = (part(&noise, 0), part(&noise, window));
    let [weights, steps, squares] = [0, 1, 2].map(|term| part(&lines[3 * k + term], first));
    let [contrast, shares, ..] = found;
    for l in 0..size {
        let (weight, known) = (weights[l].max(1e-3), weights[l] + 15.0);
        // One division for two: they take longest.
        let inverse = 1.0 / (weight * known);
        let (share, known) = (known * inverse, weights[l] * weight * inverse);
        let step = steps[l] * share;
        let spread = (squares[l] * share - step * step).max(0.0);
        contrast[l] = known * ln(1.0 + step * step / (0.001 + 0.3 * spread + above[l] + below[l]));
        shares[l] = known * step.abs();
    }
    keep(&found[..2], rows, &mut features[2 * k..]);
}

/// Soil is rougher than a rim: texture and variance next to the line.
#[inline(always)]
fn strip_features(lines: &Lines, free: f32, rows: Range<usize>, found: &mut Found, features: &mut Features) {
    let rim = ln(free + TEXTURE_MIN);
    let (first, size) = (rows.start + WIDE, rows.len().min(ROWS));
    let (mut texture, mut spread) = ([0.0; LINES], [0.0; LINES]);
    let [counts, logs, squares, steps] = [0, 1, 2, 3].map(|sum| strips(lines, sum, first - WIDE, WIDE));
    for l in 0..(size + WIDE).next_multiple_of(VECTOR).min(ROWS) {
        let count = counts.1[l] - counts.0[l];
        let (pixels, known) = (count.max(1.0), count + 40.0);
        let inverse = 1.0 / (pixels * known);
        let (share, known) = (known * inverse, count * pixels * inverse);
        let roughness = (steps.1[l] - steps.0[l]).max(0.0) * share;
        texture[l] = known * (ln(roughness + TEXTURE_MIN) - rim);
        spread[l] = known * ln(variance(share, logs.1[l] - logs.0[l], squares.1[l] - squares.0[l]) + VARIANCE_MIN);
    }
    let (above, below) = (part(&spread, 0), part(&spread, WIDE));
    found[0] = *part(&texture, 0);
    found[1] = *part(&texture, WIDE);
    for l in 0..size {
        found[2][l] = below[l] - above[l];
    }
    keep(&found[..3], rows, &mut features[Feature::RimTexture as usize..]);
}

/// All above against all below: two textures, Otsu's criterion, and two normal classes.
#[inline(always)]
fn region_features(lines: &Lines, whole: &[f32; 4], rows: Range<usize>, found: &mut Found, features: &mut Features) {
    let (first, size) = (rows.start + WIDE, rows.len().min(ROWS));
    let share = 1.0 / whole[0].max(1.0);
    let variance_whole = variance(share, whole[1], whole[2]);
    let (one, least) = (ln(variance_whole + VARIANCE_MIN), 1.0 / variance_whole.max(1e-5));
    let all = ln(whole[3] * share + TEXTURE_MIN);
    let [counts, logs, squares, steps] = [0, 1, 2, 3].map(|sum| part(&lines[TERMS + sum], first));
    let [likelihood, ratio, between, normal, roughness] = found;
    for l in 0..size {
        let (na, nb) = (counts[l], whole[0] - counts[l]);
        let (above, below, known) = (na.max(1.0), nb.max(1.0), nb + 200.0);
        let inverse = 1.0 / (above * below * known);
        let (one_above, one_below) = (below * known * inverse, above * known * inverse);
        let known = nb * above * below * inverse;
        let la = ln(steps[l] * one_above + TEXTURE_MIN);
        let lb = ln((whole[3] - steps[l]).max(0.0) * one_below + TEXTURE_MIN);
        likelihood[l] = all - (na * la + nb * lb) * share;
        ratio[l] = known * (lb - la);
        let va = variance(one_above, logs[l], squares[l]);
        let vb = variance(one_below, whole[1] - logs[l], whole[2] - squares[l]);
        let (la, lb) = (ln(va + VARIANCE_MIN), ln(vb + VARIANCE_MIN));
        between[l] = 1.0 - (na * va + nb * vb) * share * least;
        normal[l] = one - (na * la + nb * lb) * share;
        roughness[l] = known * (lb - la);
    }
    keep(found, rows, &mut features[Feature::TextureLikelihood as usize..]);
}

/// The sums above each line from `first` on, and above the one a window further down.
#[inline(always)]
fn strips(lines: &Lines, sum: usize, first: usize, window: usize) -> (&[f32; ROWS], &[f32; ROWS]) {
    let line = &lines[TERMS + sum];
    (part(line, first), part(line, first + window))
}

/// As many lines as there are rows, so that the compiler knows their number.
#[inline(always)]
fn part(line: &[f32; LINES], first: usize) -> &[f32; ROWS] {
    // Always there: no line is further from the first row than the margin.
    line[first..].first_chunk().unwrap_or(const { &[0.0; ROWS] })
}

/// Writes what was found of these rows into their features.
#[inline(always)]
fn keep(found: &[[f32; ROWS]], rows: Range<usize>, features: &mut [[f32; ROWS]]) {
    for (feature, found) in features.iter_mut().zip(found) {
        feature[rows.clone()].copy_from_slice(&found[..rows.len()]);
    }
}

/// Of each height: how much of the wheel's outer edge is seen just above it, just below it, and over all above and below.
#[inline(always)]
fn edge_features(ring: &Ring) -> [[f32; 1 << u8::BITS]; 4] {
    let mut sums = [0.0; ROWS + 1];
    for (row, step) in ring.iter().enumerate() {
        sums[row + 1] = sums[row] + step;
    }
    let mean = |from: usize, to: usize| {
        let (from, to) = (from.min(ROWS), to.min(ROWS));
        // Few rows say little: a middling edge.
        (sums[to] - sums[from] + EDGE_ROWS * EDGE) / (to.saturating_sub(from) as f32 + EDGE_ROWS)
    };
    let mut means = [[0.0; 1 << u8::BITS]; 4];
    let [just_above, just_below, all_above, all_below] = &mut means;
    for row in 0..ROWS {
        let (above, below) = (row.saturating_sub(EDGE_GAP), row + EDGE_GAP + 1);
        just_above[row] = mean(above.saturating_sub(WIDE), above);
        just_below[row] = mean(below, below + WIDE);
        all_above[row] = mean(FREE.min(above), above);
        all_below[row] = mean(below, ROWS);
    }
    for mean in means.as_flattened_mut() {
        *mean = ln(mean.max(0.0) + EDGE_MIN);
    }
    means
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

/// The natural logarithm of a positive normal number to 1e-5, in a form that a compiler can vectorise: no division.
#[inline(always)]
fn ln(value: f32) -> f32 {
    const ROOT_HALF: u32 = 0x3f35_04f3;
    let bits = value.to_bits();
    // 2^exponent (1 + x) with 1 + x from √½ to √2; ln(1 + x) / x is interpolated at Chebyshev's nodes.
    let exponent = bits.wrapping_sub(ROOT_HALF) as i32 >> 23;
    let x = f32::from_bits(bits.wrapping_sub((exponent << 23) as u32)) - 1.0;
    let low = 1.000_003_7 - 0.499_894_8 * x + x * x * (0.332_659_06 - 0.254_333_56 * x);
    let high = 0.219_657_08 - 0.140_216_23 * x;
    let (square, exponent) = (x * x, exponent as f32);
    exponent * std::f32::consts::LN_2 + x * (low + square * square * high)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells without order in a ring, some of them without pixels.
    fn ring() -> Box<Cells> {
        let mut cells = Box::new(Cells::EMPTY);
        for column in 0..COLUMNS {
            let (first, last) = (9 * (COLUMNS - column), ROWS - 4 * column);
            cells.bands[column] = first..last;
            for row in first..last {
                let count = ((37 * row + 11 * column) % 13) as f32;
                let log = 0.1 * ((91 * row + 7 * column) % 23) as f32 - 1.0;
                cells.cells[column][row] = [count, count * log, count * log * log, 0.01 * count];
            }
        }
        cells
    }

    #[test]
    fn sums_along_a_line_agree_with_the_slow_obvious_ones() {
        let (cells, mut contrast) = (ring(), Contrast::new());
        contrast.sum_above(&cells);
        for column in 0..COLUMNS {
            contrast.compare(column, WINDOWS[1], 3);
        }
        for tilt in TILTS {
            contrast.sum_columns(tilt, FIRST..ROWS);
            for row in FIRST..ROWS {
                let (mut all, mut terms) = ([0.0; 4], [0.0; 3]);
                for (column, cells) in cells.cells.iter().enumerate() {
                    let outwards = (column as f32 + 0.5) / COLUMNS as f32 - PIVOT;
                    let edge = row as isize + (tilt * outwards * ROWS as f32).round() as isize;
                    let sum = |from: isize, to: isize, k: usize| {
                        let (from, to) = (from.clamp(0, ROWS as isize), to.clamp(0, ROWS as isize));
                        let rows = &cells[from as usize..to as usize];
                        rows.iter().map(|cell| f64::from(cell[k])).sum::<f64>()
                    };
                    for (k, all) in all.iter_mut().enumerate() {
                        *all += sum(0, edge, k);
                    }
                    let window = WINDOWS[1] as isize;
                    let [above, below] = [(edge - window, edge), (edge, edge + window)]
                        .map(|(from, to)| (sum(from, to, 0), sum(from, to, 1)));
                    // An edge is one between two rows with pixels, or above the first.
                    let inside = contrast.bands[column].0 as isize <= edge + MARGIN as isize;
                    if inside && above.0 >= 2.5 && below.0 >= 2.5 {
                        let weight = 2.0 / (1.0 / above.0 + 1.0 / below.0);
                        let step = below.1 / below.0 - above.1 / above.0;
                        terms = [
                            terms[0] + weight,
                            terms[1] + weight * step,
                            terms[2] + weight * step * step,
                        ];
                    }
                }
                for (k, expected) in terms.into_iter().chain(all).enumerate() {
                    let sum = if k < 3 { 3 + k } else { TERMS + k - 3 };
                    let found = f64::from(contrast.lines[sum][row + WIDE]);
                    assert!(
                        (found - expected).abs() < 1e-4 * (10.0 + expected.abs()),
                        "{tilt} {row} {k}: {found} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_logarithm_is_good_to_five_digits() {
        for k in 0..20_000 {
            let value = 1e-5 * 1.001_f32.powi(k);
            assert!((ln(value) - value.ln()).abs() < 1e-5, "{value}: {}", ln(value));
        }
    }
}
