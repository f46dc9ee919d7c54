//! The wheel-terrain interface as the line, a row or slightly tilted, across which the rim's cells differ most consistently.

use crate::cells::{COLUMNS, Cells, EDGES, MARGIN};
use crate::rows::ROWS;
use crate::weights::Weights;

/// Slopes of the lines: rows of height per distance outwards.
pub const TILTS: [f32; 11] = [-0.30, -0.22, -0.15, -0.095, -0.045, 0.0, 0.045, 0.095, 0.15, 0.22, 0.30];
/// Distance from the middle at which all lines of a row meet, in outer radii.
const PIVOT: f32 = 0.45;
/// Rows above and below a line that are compared: of the narrow, the middle and the wide window.
const WINDOWS: [usize; 3] = [3, 6, 12];
/// Pixels of a column on either side of a line, below which it says nothing.
const COLUMN_MIN: f32 = 2.5;
/// Pixels of all columns below which a line is none.
const LINE_MIN: f32 = 6.0;
/// Heights between which a line may meet the outer circle.
const HEIGHTS: (f32, f32) = (0.25, 0.998);
/// Neighbouring pixels are not independent: their noise counts as many times.
const CORRELATION: f32 = 6.0;
/// Variance of the log gray values below which nothing is told apart.
const VARIANCE_MIN: f32 = 3e-4;
/// Rows from which on a line can meet the circle within [`HEIGHTS`].
const FIRST: usize = 16;
/// Rows above a line that still belong to it.
const SAME: usize = 10;

/// What speaks for or against a line, in the order of [`Weights::NAMES`].
pub const FEATURES: usize = 15;

/// Sums over the columns of one line: of each window, and of all that lies above it.
const TERMS: usize = 19;
const WEIGHT: usize = 0;
const STEP: usize = 1;
const STEP_SQUARE: usize = 2;
const NOISE: usize = 3;
/// Terms of a window; those of the next follow.
const PER_WINDOW: usize = 4;
const WIDE: usize = 2 * PER_WINDOW;
const VARIANCE_ABOVE: usize = 12;
const VARIANCE_BELOW: usize = 13;
const LOG_VARIANCE_ABOVE: usize = 14;
const LOG_VARIANCE_BELOW: usize = 15;
const COUNT: usize = 16;
const LOG: usize = 17;
const SQUARE: usize = 18;

type Lines = [[f32; ROWS]; TERMS];

/// The work space of one side.
#[derive(Clone, Debug)]
pub struct Contrast {
    /// Sums over all rows above each edge of each column: pixels, logs, squares.
    above: [[[f32; EDGES]; COLUMNS]; 3],
    /// Terms of each column and edge.
    columns: [[[f32; EDGES]; COLUMNS]; COUNT],
    /// First and last edge between pixels.
    bands: [(usize, usize); COLUMNS],
    lines: Lines,
    /// The features of each line, by tilt, feature and row.
    pub features: [[[f32; ROWS]; FEATURES]; TILTS.len()],
    /// Whether there is such a line at all.
    pub known: [[bool; ROWS]; TILTS.len()],
    /// Height at which each line meets the outer circle; NaN where it does not.
    pub heights: [[f32; ROWS]; TILTS.len()],
}

impl Contrast {
    /// Prepares the work space.
    #[must_use]
    pub fn new() -> Box<Self> {
        Box::new(Self {
            above: [[[0.0; EDGES]; COLUMNS]; 3],
            columns: [[[0.0; EDGES]; COLUMNS]; COUNT],
            bands: [(0, 0); COLUMNS],
            lines: [[0.0; ROWS]; TERMS],
            features: [[[0.0; ROWS]; FEATURES]; TILTS.len()],
            known: [[false; ROWS]; TILTS.len()],
            heights: TILTS.map(|tilt| std::array::from_fn(|row| meets_circle(row, tilt))),
        })
    }

    /// Fills the features of every line. The largest step of the middle window, as a log ratio, is the side's contrast.
    pub fn measure(&mut self, cells: &Cells) -> f32 {
        self.sum_above(cells);
        for column in 0..COLUMNS {
            for (k, window) in WINDOWS.into_iter().enumerate() {
                self.compare(column, window, PER_WINDOW * k);
            }
        }
        let whole = Whole::new(&self.above);
        for (tilt, slope) in TILTS.into_iter().enumerate() {
            self.sum_columns(slope);
            for row in FIRST..ROWS {
                let height = self.heights[tilt][row];
                self.known[tilt][row] = height > HEIGHTS.0 && height < HEIGHTS.1 && self.lines[WEIGHT][row] >= LINE_MIN;
            }
            let features = &mut self.features[tilt];
            for k in 0..WINDOWS.len() {
                window_features(&self.lines, k, features);
            }
            texture_features(&self.lines, features);
            region_features(&self.lines, &whole, features);
            prior_features(slope, &self.heights[tilt], features);
        }
        self.relate()
    }

    fn sum_above(&mut self, cells: &Cells) {
        let [count, log, square] = &mut self.above;
        for (column, rows) in cells.cells.iter().enumerate() {
            let (mut first, mut last) = (EDGES, 0);
            let mut sums = [0.0; 4];
            for (row, cell) in rows.iter().enumerate() {
                if cell[0] > 0.0 {
                    first = first.min(row + MARGIN);
                    last = row + MARGIN + 1;
                }
                for (sum, value) in sums.iter_mut().zip(cell) {
                    *sum += value;
                }
                let edge = row + MARGIN + 1;
                (count[column][edge], log[column][edge], square[column][edge]) = (sums[0], sums[1], sums[2]);
            }
            count[column][ROWS + MARGIN + 1..].fill(sums[0]);
            log[column][ROWS + MARGIN + 1..].fill(sums[1]);
            square[column][ROWS + MARGIN + 1..].fill(sums[2]);
            self.bands[column] = (first.min(last), last);
        }
    }

    /// Per edge of a column: the step of the mean, weighted by the pixels it rests on, its square, and its noise.
    fn compare(&mut self, column: usize, window: usize, term: usize) {
        let (first, last) = self.bands[column];
        let size = last - first;
        let [count, log, square] = self.above.each_ref().map(|sums| {
            let at = |edge: usize| &sums[column][edge..edge + size];
            [at(first - window.min(first)), at(first), at(first + window)]
        });
        let terms = self.columns.each_mut().map(|terms| &mut terms[column][first..last]);
        for k in 0..size {
            let (above, below) = (count[1][k] - count[0][k], count[2][k] - count[1][k]);
            let known = above >= COLUMN_MIN && below >= COLUMN_MIN;
            let (na, nb) = (1.0 / above.max(1.0), 1.0 / below.max(1.0));
            let (ma, mb) = ((log[1][k] - log[0][k]) * na, (log[2][k] - log[1][k]) * nb);
            let va = ((square[1][k] - square[0][k]) * na - ma * ma).max(0.0);
            let vb = ((square[2][k] - square[1][k]) * nb - mb * mb).max(0.0);
            let weight = if known { 2.0 / (na + nb) } else { 0.0 };
            let step = weight * (mb - ma);
            terms[term + WEIGHT][k] = weight;
            terms[term + STEP][k] = step;
            terms[term + STEP_SQUARE][k] = step * (mb - ma);
            terms[term + NOISE][k] = weight * weight * (va * na + vb * nb);
            if term == WIDE {
                terms[VARIANCE_ABOVE][k] = weight * va;
                terms[VARIANCE_BELOW][k] = weight * vb;
                terms[LOG_VARIANCE_ABOVE][k] = weight * ln(va + 1e-4);
                terms[LOG_VARIANCE_BELOW][k] = weight * ln(vb + 1e-4);
            }
        }
    }

    /// Sums over the columns along the lines of one tilt.
    fn sum_columns(&mut self, tilt: f32) {
        self.lines = [[0.0; ROWS]; TERMS];
        for column in 0..COLUMNS {
            let outwards = (column as f32 + 0.5) / COLUMNS as f32 - PIVOT;
            // Row r of the line is edge r + lift of this column.
            let lift = (MARGIN as f32 + tilt * outwards * ROWS as f32).round() as usize;
            let (first, last) = self.bands[column];
            let row = |edge: usize| edge.saturating_sub(lift).clamp(FIRST, ROWS);
            let (from, to) = (row(first), row(last));
            for (line, terms) in self.lines.iter_mut().zip(&self.columns) {
                add(&mut line[from..to], &terms[column][from + lift..to + lift]);
            }
            for (line, sums) in self.lines[COUNT..].iter_mut().zip(&self.above) {
                add(&mut line[from..to], &sums[column][from + lift..to + lift]);
                let total = sums[column][EDGES - 1];
                for sum in &mut line[to..] {
                    *sum += total;
                }
            }
        }
    }

    /// What a line's features are among those of the other lines.
    fn relate(&mut self) -> f32 {
        let mut largest = [1e-3_f32; WINDOWS.len()];
        let mut best = [0.0_f32; ROWS];
        for (features, known) in self.features.iter().zip(&self.known) {
            for row in (FIRST..ROWS).filter(|row| known[*row]) {
                for (k, largest) in largest.iter_mut().enumerate() {
                    *largest = largest.max(features[2 * k + 1][row]);
                }
                best[row] = best[row].max(features[Weights::MIDDLE_CONTRAST][row]);
            }
        }
        let mut above = [0.0_f32; ROWS];
        for row in FIRST + SAME..ROWS {
            above[row] = above[row - 1].max(best[row - SAME]);
        }
        for features in &mut self.features {
            for (k, largest) in largest.iter().enumerate() {
                for share in &mut features[2 * k + 1] {
                    *share /= largest;
                }
            }
            features[Weights::ABOVE] = above;
        }
        largest[1]
    }
}

/// Sums over the whole side.
struct Whole {
    count: f32,
    log: f32,
    square: f32,
    variance: f32,
}

impl Whole {
    fn new(above: &[[[f32; EDGES]; COLUMNS]; 3]) -> Self {
        let [count, log, square] = above
            .each_ref()
            .map(|sums| sums.iter().map(|column| column[EDGES - 1]).sum::<f32>());
        let count = count.max(1.0);
        Self {
            count,
            log,
            square,
            variance: variance(count, log, square),
        }
    }
}

fn variance(count: f32, log: f32, square: f32) -> f32 {
    let share = 1.0 / count.max(1.0);
    let mean = log * share;
    (square * share - mean * mean).max(0.0)
}

/// A t-like score: the mean step against its spread over the columns and the pixels' noise; and the step itself.
fn window_features(lines: &Lines, k: usize, features: &mut [[f32; ROWS]; FEATURES]) {
    let term = PER_WINDOW * k;
    for row in FIRST..ROWS {
        let weight = lines[term + WEIGHT][row];
        let share = 1.0 / weight.max(1e-3);
        let step = lines[term + STEP][row] * share;
        let spread = (lines[term + STEP_SQUARE][row] * share - step * step).max(0.0);
        let noise = CORRELATION * lines[term + NOISE][row] * share * share;
        let known = weight / (weight + 15.0);
        features[2 * k][row] = known * ln(1.0 + step * step / (0.001 + 0.3 * spread + noise));
        features[2 * k + 1][row] = known * step.abs();
    }
}

/// Soil is rougher than a rim.
fn texture_features(lines: &Lines, features: &mut [[f32; ROWS]; FEATURES]) {
    for row in FIRST..ROWS {
        let weight = lines[WIDE + WEIGHT][row].max(1e-3);
        let floor = 2e-4 * weight;
        let known = weight / (weight + 40.0);
        let ratio = (lines[VARIANCE_BELOW][row] + floor) / (lines[VARIANCE_ABOVE][row] + floor);
        let logs = lines[LOG_VARIANCE_BELOW][row] - lines[LOG_VARIANCE_ABOVE][row];
        features[Weights::TEXTURE][row] = known * ln(ratio);
        features[Weights::COLUMN_TEXTURE][row] = known * logs / weight;
    }
}

/// All above against all below: Otsu's criterion, and two normal classes.
fn region_features(lines: &Lines, whole: &Whole, features: &mut [[f32; ROWS]; FEATURES]) {
    let share = 1.0 / whole.count;
    let one = ln(whole.variance + VARIANCE_MIN);
    for row in FIRST..ROWS {
        let (na, sa, qa) = (lines[COUNT][row], lines[LOG][row], lines[SQUARE][row]);
        let nb = whole.count - na;
        let (va, vb) = (variance(na, sa, qa), variance(nb, whole.log - sa, whole.square - qa));
        let (above, below) = (ln(va + VARIANCE_MIN), ln(vb + VARIANCE_MIN));
        features[Weights::BETWEEN][row] = 1.0 - (na * va + nb * vb) * share / whole.variance.max(1e-5);
        features[Weights::LIKELIHOOD][row] = one - (na * above + nb * below) * share;
        features[Weights::ROUGHNESS][row] = nb / (nb + 200.0) * (below - above);
    }
}

/// What is known of a line before the picture is seen.
fn prior_features(tilt: f32, heights: &[f32; ROWS], features: &mut [[f32; ROWS]; FEATURES]) {
    for (row, height) in heights.iter().enumerate() {
        features[Weights::TILT][row] = (tilt / 0.12).powi(2);
        features[Weights::SHALLOW][row] = (height - 0.95).max(0.0);
        features[Weights::DEEP][row] = (0.65 - height).max(0.0);
    }
}

fn add(sums: &mut [f32], terms: &[f32]) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        *sum += term;
    }
}

/// Height at which the line through the pivot at this row meets the outer circle; NaN where it does not.
fn meets_circle(row: usize, tilt: f32) -> f32 {
    let start = row as f32 / ROWS as f32 - tilt * PIVOT;
    // z = start + tilt x and x² + z² = 1, x >= 0
    let (a, b, c) = (1.0 + tilt * tilt, tilt * start, start * start - 1.0);
    let x = (-b + (b * b - a * c).sqrt()) / a;
    if x >= 0.0 { start + tilt * x } else { f32::NAN }
}

/// The natural logarithm of a positive normal number to 1e-4, in a form that a compiler can vectorise.
fn ln(value: f32) -> f32 {
    let bits = value.to_bits();
    let exponent = (bits >> 23) as f32 - 127.0;
    let mantissa = f32::from_bits(bits & 0x007f_ffff | 0x3f80_0000);
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let q = s * s;
    exponent * std::f32::consts::LN_2 + 2.0 * s * (1.0 + q * (1.0 / 3.0 + q * (0.2 + q * (1.0 / 7.0))))
}
