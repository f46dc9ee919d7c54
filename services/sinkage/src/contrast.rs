//! The wheel-terrain interface as the line, a row or slightly tilted, across which the rim's cells differ most consistently.

use crate::cells::Cells;
use crate::lines::{
    Columns, LINES, Lanes, Lines, PART, PARTS, Parts, SUMS, TERMS, TILTS, WIDE, WINDOWS, at, between, meets_circle,
    parts,
};
use crate::ring::{Middling, Ring, log_means};
use crate::rows::ROWS;
use crate::weights::{FEATURES, Feature};
use std::array::from_fn;
use std::ops::Range;

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
/// A middling step across the outer edge, for how many rows it counts, and a step below which nothing is told apart.
const EDGE: Middling = Middling {
    step: 0.15,
    rows: 1.0,
    least: 0.02,
};
/// Rows from which on a line can meet the circle within [`HEIGHTS`].
pub(crate) const FIRST: usize = 16;
/// Rows above a line that still belong to it.
const SAME: usize = 10;

/// Features of the windows, and all that are measured anew along every line.
const STEPS: usize = 2 * WINDOWS.len();
const MEASURED: usize = STEPS + 8;
/// The measured ones that are not of the windows: their first.
const TEXTURES: usize = Feature::RimTexture as usize;

/// Of each row; longer, so that any byte is an index.
pub(crate) type ByRow = [f32; 1 << u8::BITS];

/// The features of one side's lines, each kept only for what it differs by; and the work space for them.
#[derive(Clone, Debug)]
pub struct Contrast {
    columns: Columns,
    /// Sums over the columns along each line of one tilt.
    lines: Lines,
    strips: Strips,
    /// The features that are measured along each line.
    measured: Parts<[Lanes; MEASURED]>,
    /// What makes a share of a step, by window.
    shares: [f32; WINDOWS.len()],
    /// The features of the best contrast further up and down, by row.
    best: [[Lanes; PARTS]; 2],
    /// The features of the outer edge, by the row at which a line meets it.
    edges: [ByRow; 4],
    /// The features of the inner edge, by the row at which a line meets it, and that row.
    pub(crate) lips: [ByRow; 3],
    pub(crate) lip_rows: Parts<[u8; PART]>,
    /// 1 where there is such a line at all, 0 where not.
    pub known: Parts<Lanes>,
    /// Height at which each line meets the outer circle; NaN where it does not.
    pub heights: Parts<Lanes>,
    /// The row of a side at which each line meets it.
    edge_rows: Parts<[u8; PART]>,
    /// The rows of each tilt whose lines meet it within [`HEIGHTS`].
    rows: [Range<usize>; TILTS.len()],
}

impl Contrast {
    /// Prepares the work space.
    #[must_use]
    pub fn new() -> Box<Self> {
        let heights: Parts<Lanes> =
            TILTS.map(|tilt| from_fn(|part| from_fn(|lane| meets_circle(part * PART + lane, tilt))));
        let row = |height: f32| ((height * ROWS as f32) as u8).min(ROWS as u8 - 1);
        Box::new(Self {
            columns: Columns::new(),
            lines: [[0.0; LINES]; SUMS],
            strips: Strips {
                noise: [[0.0; LINES]; WINDOWS.len()],
                texture: [0.0; LINES],
                spread: [0.0; LINES],
            },
            measured: [[[[0.0; PART]; MEASURED]; PARTS]; TILTS.len()],
            shares: [0.0; WINDOWS.len()],
            best: [[[0.0; PART]; PARTS]; 2],
            edges: [[0.0; 1 << u8::BITS]; 4],
            lips: [[0.0; 1 << u8::BITS]; 3],
            lip_rows: [[[0; PART]; PARTS]; TILTS.len()],
            known: [[[0.0; PART]; PARTS]; TILTS.len()],
            rows: heights.each_ref().map(|heights| {
                let heights = heights.as_flattened();
                let within = |row: &usize| heights[*row] > HEIGHTS.0 && heights[*row] < HEIGHTS.1;
                let first = (0..ROWS).find(within).unwrap_or(0);
                first..(first..ROWS).rfind(within).map_or(first, |last| last + 1)
            }),
            edge_rows: heights.map(|parts| parts.map(|heights| heights.map(row))),
            heights,
        })
    }

    /// Measures the features of every line. The largest step of the middle window, as a log ratio, is the side's contrast.
    #[inline(always)]
    pub fn measure(&mut self, cells: &Cells, ring: &Ring) -> f32 {
        self.columns.compare(cells);
        self.edges = edge_features(ring);
        let whole = self.columns.above(usize::MAX);
        let rim = self.columns.above(FREE);
        let region = Region::of(whole);
        let rim_texture = ln(rim[3] / rim[0].max(1.0) + TEXTURE_MIN);
        let mut largest = [[1e-3; PART]; WINDOWS.len()];
        let mut best = [[0.0; PART]; PARTS];
        for tilt in 0..TILTS.len() {
            let rows = self.rows[tilt].clone();
            self.columns.sum_along(tilt, &rows, &mut self.lines);
            self.strips.fill(&self.lines, rim_texture, &rows);
            for part in parts(&rows) {
                let line = part * PART + WIDE;
                let weights = at(&self.lines[0], line);
                let heights = &self.heights[tilt][part];
                let within = |k: usize| (heights[k] > HEIGHTS.0) & (heights[k] < HEIGHTS.1);
                let known = from_fn(|k| if within(k) & (weights[k] >= LINE_MIN) { 1.0 } else { 0.0 });
                let measured = &mut self.measured[tilt][part];
                for window in 0..WINDOWS.len() {
                    let [contrast, step] = window_features(&self.lines, &self.strips, window, line);
                    raise(&mut largest[window], &step, &known);
                    if 2 * window == Feature::MiddleContrast as usize {
                        raise(&mut best[part], &contrast, &known);
                    }
                    (measured[2 * window], measured[2 * window + 1]) = (contrast, step);
                }
                let textures = &mut measured[STEPS..];
                for (texture, value) in textures.iter_mut().zip(self.strips.features(line)) {
                    *texture = value;
                }
                for (texture, value) in textures[3..].iter_mut().zip(region.features(&self.lines, line)) {
                    *texture = value;
                }
                self.known[tilt][part] = known;
            }
        }
        self.relate(&largest, best.as_flattened())
    }

    /// The features of the lines of one part of a tilt.
    #[must_use]
    #[inline(always)]
    pub fn features(&self, tilt: usize, part: usize) -> [Lanes; FEATURES] {
        let mut features = [[0.0; PART]; FEATURES];
        let (windows, textures) = self.measured[tilt][part].split_at(STEPS);
        features[..windows.len()].copy_from_slice(windows);
        for (window, share) in self.shares.into_iter().enumerate() {
            features[2 * window + 1] = windows[2 * window + 1].map(|step| step * share);
        }
        features[Feature::Tilt as usize] = [squared(tilt); PART];
        features[Feature::Shallow as usize] = self.heights[tilt][part].map(shallow);
        features[Feature::Deep as usize] = self.heights[tilt][part].map(deep);
        features[TEXTURES..][..textures.len()].copy_from_slice(textures);
        features[Feature::Above as usize] = self.best[0][part];
        features[Feature::Below as usize] = self.best[1][part];
        for (feature, edge) in features[Feature::EdgeAbove as usize..].iter_mut().zip(&self.edges) {
            *feature = self.edge_rows[tilt][part].map(|row| edge[usize::from(row)]);
        }
        for (feature, lip) in features[Feature::LipAbove as usize..].iter_mut().zip(&self.lips) {
            *feature = self.lip_rows[tilt][part].map(|row| lip[usize::from(row)]);
        }
        features
    }

    /// The weighted sum of every line's features; minus infinity where there is no line.
    #[must_use]
    #[inline(always)]
    pub fn scores(&self, weights: &[f32; FEATURES]) -> Parts<Lanes> {
        let weight = |feature: Feature| weights[feature as usize];
        let mut of_measured = [0.0; MEASURED];
        of_measured[..STEPS].copy_from_slice(&weights[..STEPS]);
        of_measured[STEPS..].copy_from_slice(&weights[TEXTURES..][..MEASURED - STEPS]);
        for (window, share) in self.shares.into_iter().enumerate() {
            of_measured[2 * window + 1] *= share;
        }
        // What many lines share is summed up once.
        let of_edge = weighted(&self.edges, &weights[Feature::EdgeAbove as usize..]);
        let of_lip = weighted(&self.lips, &weights[Feature::LipAbove as usize..]);
        let [above, below] = [Feature::Above, Feature::Below].map(weight);
        let mut scores = [[[f32::NEG_INFINITY; PART]; PARTS]; TILTS.len()];
        for (tilt, scores) in scores.iter_mut().enumerate() {
            let of_tilt = weight(Feature::Tilt) * squared(tilt);
            for part in parts(&self.rows[tilt]) {
                let (edges, lips) = (&self.edge_rows[tilt][part], &self.lip_rows[tilt][part]);
                let mut sums: Lanes = from_fn(|k| of_edge[usize::from(edges[k])] + of_lip[usize::from(lips[k])]);
                let heights = &self.heights[tilt][part];
                for k in 0..PART {
                    let prior =
                        weight(Feature::Shallow) * shallow(heights[k]) + weight(Feature::Deep) * deep(heights[k]);
                    sums[k] += of_tilt + prior + above * self.best[0][part][k] + below * self.best[1][part][k];
                }
                for (values, weight) in self.measured[tilt][part].iter().zip(of_measured) {
                    for (sum, value) in sums.iter_mut().zip(values) {
                        *sum += weight * value;
                    }
                }
                let known = &self.known[tilt][part];
                scores[part] = from_fn(|k| if known[k] > 0.0 { sums[k] } else { f32::NEG_INFINITY });
            }
        }
        scores
    }
}

impl Contrast {
    /// What a line's features are among those of the other lines.
    #[inline(always)]
    fn relate(&mut self, steps: &[Lanes; WINDOWS.len()], best: &[f32]) -> f32 {
        let mut largest = [0.0; WINDOWS.len()];
        for (largest, steps) in largest.iter_mut().zip(steps) {
            *largest = steps.iter().copied().fold(0.0, f32::max);
        }
        for (share, largest) in self.shares.iter_mut().zip(largest) {
            *share = 1.0 / largest;
        }
        let [above, below] = self.best.each_mut().map(|best| best.as_flattened_mut());
        for row in FIRST + SAME..ROWS {
            above[row] = above[row - 1].max(best[row - SAME]);
        }
        for row in (FIRST..ROWS - SAME).rev() {
            below[row] = below[row + 1].max(best[row + SAME]);
        }
        largest[1]
    }
}

/// The four sums over all above each line.
#[inline(always)]
fn above(lines: &Lines) -> [&[f32; LINES]; 4] {
    [&lines[TERMS], &lines[TERMS + 1], &lines[TERMS + 2], &lines[TERMS + 3]]
}

/// To the values that are larger and known.
#[inline(always)]
fn raise(largest: &mut Lanes, values: &Lanes, known: &Lanes) {
    for k in 0..PART {
        let value = known[k] * values[k];
        largest[k] = if value > largest[k] { value } else { largest[k] };
    }
}

/// The weighted sum of some features.
#[inline(always)]
fn weighted<const LENGTH: usize>(features: &[[f32; LENGTH]], weights: &[f32]) -> [f32; LENGTH] {
    let mut sums = [0.0; LENGTH];
    for (feature, weight) in features.iter().zip(weights) {
        for (sum, value) in sums.iter_mut().zip(feature) {
            *sum += weight * value;
        }
    }
    sums
}

/// Variance of values by one over their number, their sum, and the sum of their squares.
#[inline(always)]
fn variance(share: f32, sum: f32, squares: f32) -> f32 {
    let mean = sum * share;
    (squares * share - mean * mean).max(0.0)
}

/// A t-like score: the mean step against its spread over the columns and the pixels' noise; and the step itself.
#[inline(always)]
fn window_features(lines: &Lines, strips: &Strips, window: usize, line: usize) -> [Lanes; 2] {
    let (weights, steps) = (at(&lines[3 * window], line), at(&lines[3 * window + 1], line));
    let squares = at(&lines[3 * window + 2], line);
    let noise = &strips.noise[window];
    let (above, below) = (at(noise, line - WINDOWS[window]), at(noise, line));
    let (mut contrast, mut shares) = ([0.0; PART], [0.0; PART]);
    for k in 0..PART {
        let (weight, known) = (weights[k].max(1e-3), weights[k] + 15.0);
        // One division for two: they take longest.
        let inverse = 1.0 / (weight * known);
        let (share, known) = (known * inverse, weights[k] * weight * inverse);
        let step = steps[k] * share;
        let spread = (squares[k] * share - step * step).max(0.0);
        contrast[k] = known * ln(1.0 + step * step / (0.001 + 0.3 * spread + above[k] + below[k]));
        shares[k] = known * step.abs();
    }
    [contrast, shares]
}

/// Of the pixels between each line and the one a window further down.
#[derive(Clone, Debug)]
struct Strips {
    /// The noise of their mean, by window.
    noise: [[f32; LINES]; WINDOWS.len()],
    /// Of the wide window: log ratio of their texture and that of the free rim, and the log of their variance.
    texture: [f32; LINES],
    spread: [f32; LINES],
}

impl Strips {
    /// From the widest window above the first of some rows to the one below the last.
    #[inline(always)]
    fn fill(&mut self, lines: &Lines, rim_texture: f32, rows: &Range<usize>) {
        let [counts, logs, squares, steps] = above(lines);
        for part in rows.start / PART..(rows.end + WIDE).div_ceil(PART) {
            let line = part * PART;
            let (mut pixels, mut variances) = ([0.0; PART], [0.0; PART]);
            for (noise, window) in self.noise.iter_mut().zip(WINDOWS) {
                pixels = between(counts, line, line + window);
                let log = between(logs, line, line + window);
                let square = between(squares, line, line + window);
                let noise = &mut noise.as_chunks_mut::<PART>().0[part];
                for k in 0..PART {
                    let share = 1.0 / pixels[k].max(1.0);
                    variances[k] = variance(share, log[k], square[k]);
                    noise[k] = CORRELATION * share * variances[k];
                }
            }
            let step = between(steps, line, line + WIDE);
            let texture = &mut self.texture.as_chunks_mut::<PART>().0[part];
            let spread = &mut self.spread.as_chunks_mut::<PART>().0[part];
            for k in 0..PART {
                let (one, known) = (pixels[k].max(1.0), pixels[k] + 40.0);
                let inverse = 1.0 / (one * known);
                let (share, known) = (known * inverse, pixels[k] * one * inverse);
                texture[k] = known * (ln(step[k].max(0.0) * share + TEXTURE_MIN) - rim_texture);
                spread[k] = known * ln(variances[k] + VARIANCE_MIN);
            }
        }
    }

    /// Soil is rougher than a rim: texture and variance next to some lines.
    #[inline(always)]
    fn features(&self, line: usize) -> [Lanes; 3] {
        let (above, below) = (at(&self.spread, line - WIDE), at(&self.spread, line));
        [
            at(&self.texture, line - WIDE),
            at(&self.texture, line),
            from_fn(|k| below[k] - above[k]),
        ]
    }
}

/// All of a side: sums over its cells, and what one texture and one variance make of it.
struct Region {
    sums: [f32; 4],
    /// One over the pixels.
    share: f32,
    texture: f32,
    /// Log of the variance, and one over it.
    spread: f32,
    inverse: f32,
}

impl Region {
    #[inline(always)]
    fn of(sums: [f32; 4]) -> Self {
        let share = 1.0 / sums[0].max(1.0);
        let variance = variance(share, sums[1], sums[2]);
        Self {
            sums,
            share,
            texture: ln(sums[3] * share + TEXTURE_MIN),
            spread: ln(variance + VARIANCE_MIN),
            inverse: 1.0 / variance.max(1e-5),
        }
    }

    /// All above some lines against all below: two textures, Otsu's criterion, and two normal classes.
    #[inline(always)]
    fn features(&self, lines: &Lines, line: usize) -> [Lanes; 5] {
        let (whole, share) = (&self.sums, self.share);
        let [counts, logs, squares, steps] = above(lines);
        let (counts, logs, squares, steps) = (at(counts, line), at(logs, line), at(squares, line), at(steps, line));
        let mut features = [[0.0; PART]; 5];
        let [likelihood, ratio, between, normal, roughness] = &mut features;
        for k in 0..PART {
            let (na, nb) = (counts[k], whole[0] - counts[k]);
            let (above, below, known) = (na.max(1.0), nb.max(1.0), nb + 200.0);
            let inverse = 1.0 / (above * below * known);
            let (one_above, one_below) = (below * known * inverse, above * known * inverse);
            let known = nb * above * below * inverse;
            let la = ln(steps[k] * one_above + TEXTURE_MIN);
            let lb = ln((whole[3] - steps[k]).max(0.0) * one_below + TEXTURE_MIN);
            likelihood[k] = self.texture - (na * la + nb * lb) * share;
            ratio[k] = known * (lb - la);
            let va = variance(one_above, logs[k], squares[k]);
            let vb = variance(one_below, whole[1] - logs[k], whole[2] - squares[k]);
            let (la, lb) = (ln(va + VARIANCE_MIN), ln(vb + VARIANCE_MIN));
            between[k] = 1.0 - (na * va + nb * vb) * share * self.inverse;
            normal[k] = self.spread - (na * la + nb * lb) * share;
            roughness[k] = known * (lb - la);
        }
        features
    }
}

/// Of each height: how much of the wheel's outer edge is seen just above it, just below it, and over all above and below.
#[inline(always)]
fn edge_features(ring: &Ring) -> [ByRow; 4] {
    let above = |row: usize| row.saturating_sub(EDGE_GAP);
    let below = |row: usize| row + EDGE_GAP + 1;
    [
        log_means(ring, &EDGE, |row| above(row).saturating_sub(WIDE)..above(row)),
        log_means(ring, &EDGE, |row| below(row)..below(row) + WIDE),
        log_means(ring, &EDGE, |row| FREE.min(above(row))..above(row)),
        log_means(ring, &EDGE, |row| below(row)..ROWS),
    ]
}

/// What is known of a line before the picture is seen.
#[inline(always)]
fn squared(tilt: usize) -> f32 {
    (TILTS[tilt] / 0.12).powi(2)
}

#[inline(always)]
fn shallow(height: f32) -> f32 {
    (height - 0.95).max(0.0)
}

#[inline(always)]
fn deep(height: f32) -> f32 {
    (0.65 - height).max(0.0)
}

/// The natural logarithm of a positive normal number to 1e-5, in a form that a compiler can vectorise: no division.
#[inline(always)]
pub(crate) fn ln(value: f32) -> f32 {
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

    #[test]
    fn a_score_is_the_weighted_sum_of_the_lines_features() {
        let mut cells = Box::new(Cells::EMPTY);
        for (column, (rows, band)) in cells.cells.iter_mut().zip(&mut cells.bands).enumerate() {
            *band = 7 * (15 - column)..ROWS - 5 * column;
            for (row, cell) in rows.iter_mut().enumerate().take(band.end).skip(band.start) {
                let log = if row < 90 { 0.5 } else { -0.2 } + 0.01 * ((7 * row + 3 * column) % 10) as f32;
                *cell = [9.0, 9.0 * log, 9.1 * log * log, 0.02 * (1 + row % 3) as f32];
            }
        }
        let ring = from_fn(|row| if row < 90 { 0.3 } else { 0.05 });
        let mut contrast = Contrast::new();
        assert!((0.6..0.8).contains(&contrast.measure(&cells, &ring)));
        contrast.lips = from_fn(|k| from_fn(|row| 0.1 * (k + row % 7) as f32));
        contrast.lip_rows = from_fn(|tilt| from_fn(|part| from_fn(|k| (tilt + part * PART + k) as u8)));
        let weights = from_fn(|k| 0.3 * (k % 5) as f32 - 0.5);
        let scores = contrast.scores(&weights);
        let mut lines = 0;
        for (tilt, part) in (0..TILTS.len()).flat_map(|tilt| (0..PARTS).map(move |part| (tilt, part))) {
            let features = contrast.features(tilt, part);
            for k in 0..PART {
                let terms = features
                    .iter()
                    .zip(weights)
                    .map(|(feature, weight)| weight * feature[k]);
                let (expected, score) = (terms.sum::<f32>(), scores[tilt][part][k]);
                if contrast.known[tilt][part][k] > 0.0 {
                    assert!(
                        (score - expected).abs() < 1e-4 * (1.0 + expected.abs()),
                        "{tilt} {part} {k}"
                    );
                    lines += 1;
                } else {
                    assert_eq!(score, f32::NEG_INFINITY);
                }
            }
        }
        assert!(lines > 500, "{lines}");
    }

    #[test]
    fn the_logarithm_is_good_to_five_digits() {
        for k in 0..20_000 {
            let value = 1e-5 * 1.001_f32.powi(k);
            assert!((ln(value) - value.ln()).abs() < 1e-5, "{value}: {}", ln(value));
        }
    }
}
