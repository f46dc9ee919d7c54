//! The rim in cells: log gray values over rows of constant height and columns of constant distance from the middle.

use crate::rim::Rim;
use crate::rows::ROWS;
use std::ops::Range;

/// Columns from the middle of the wheel to its outermost point.
pub const COLUMNS: usize = 20;
/// Empty rows above the first and below the last row, into which a tilted line may reach.
pub const MARGIN: usize = 32;
/// Edges of a column with its margins: edge `k` is the upper one of row `k - MARGIN`.
pub const EDGES: usize = ROWS + 2 * MARGIN + 1;
/// Gray values below which the sensor's noise hides ratios.
const DARK: f32 = 4.0;
/// About the logarithm of a middle gray: sums of what is left keep their digits.
const MIDDLE: f32 = 4.0;
/// Pixels whose cells are worked out together.
const BLOCK: usize = 32;

/// Pixels of a cell, the sum of their log gray values, and the sum of the squares; the fourth fills a vector up.
pub type Sums = [f32; 4];

/// One side of the lower half of the annulus.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// Sums of each cell.
    pub cells: [[Sums; ROWS]; COLUMNS],
}

impl Cells {
    /// A side without a pixel.
    pub const EMPTY: Self = Self {
        cells: [[[0.0; 4]; ROWS]; COLUMNS],
    };

    /// Pixels of all cells.
    #[must_use]
    pub fn pixels(&self) -> f32 {
        self.cells.as_flattened().iter().map(|sums| sums[0]).sum()
    }
}

/// The logarithm of each gray value.
#[must_use]
pub fn log_table() -> [f32; 256] {
    std::array::from_fn(|gray| (gray as f32 + DARK).ln() - MIDDLE)
}

/// Sums the picture's cells: `[left, right]`. `image` holds rows of `width` pixels without gaps.
pub fn accumulate(image: &[u8], width: usize, rim: &Rim, log: &[f32; 256], sides: &mut [Cells; 2]) {
    for side in &mut *sides {
        side.cells = Cells::EMPTY.cells;
    }
    let lines = image.chunks_exact(width.max(1)).enumerate();
    for (row, line) in lines.take(rim.rows.end).skip(rim.rows.start) {
        for span in spans(rim, row) {
            let mut first = span.start;
            for block in line.get(span).unwrap_or(&[]).chunks(BLOCK) {
                add(block, first, row, rim, log, sides);
                first += block.len();
            }
        }
    }
}

/// Adds pixels of one row of the picture, from column `first` on.
fn add(block: &[u8], first: usize, row: usize, rim: &Rim, log: &[f32; 256], sides: &mut [Cells; 2]) {
    let [a, b, c, d, e, f, g, h, i] = rim.plane;
    let (x, y) = (first as f64, row as f64);
    let start = [a * x + b * y + c, d * x + e * y + f, g * x + h * y + i].map(|value| value as f32);
    let step = [a as f32, d as f32, g as f32];
    let mut places = [(0_u32, 0_u32, false); BLOCK];
    for (k, place) in places.iter_mut().enumerate() {
        let along = k as f32;
        let scale = 1.0 / (start[2] + along * step[2]);
        let right = (start[0] + along * step[0]) * scale;
        let down = (start[1] + along * step[1]) * scale;
        *place = (
            (right.abs() * COLUMNS as f32) as u32,
            (down * ROWS as f32) as u32,
            right >= 0.0,
        );
    }
    for (&gray, (column, row, right)) in block.iter().zip(places) {
        let value = log[usize::from(gray)];
        let cell =
            &mut sides[usize::from(right)].cells[(column as usize).min(COLUMNS - 1)][(row as usize).min(ROWS - 1)];
        for (sum, term) in cell.iter_mut().zip([1.0, value, value * value, 0.0]) {
            *sum += term;
        }
    }
}

/// The columns of a row of the picture that show the lower half of the annulus: left and right of the wheel's inside.
fn spans(rim: &Rim, row: usize) -> [Range<usize>; 2] {
    let [a, b, c, d, e, f, g, h, i] = rim.plane;
    let y = row as f64;
    let (right, down, scale) = (b * y + c, e * y + f, h * y + i);
    // (a x + right)² + (d x + down)² = radius² (g x + scale)²
    let meets = |radius: f64| {
        let q = radius * radius;
        let (square, half, rest) = (
            a * a + d * d - q * g * g,
            a * right + d * down - q * g * scale,
            right * right + down * down - q * scale * scale,
        );
        let root = (half * half - square * rest).sqrt();
        (square > 0.0 && root.is_finite()).then(|| ((-half - root) / square, (-half + root) / square))
    };
    let Some((from, to)) = meets(rim.outer) else {
        return [0..0, 0..0];
    };
    // d x + down >= 0
    let level = -down / d;
    let (from, to) = if d > 0.0 {
        (from.max(level), to)
    } else if d < 0.0 {
        (from, to.min(level))
    } else if down >= 0.0 {
        (from, to)
    } else {
        return [0..0, 0..0];
    };
    // `as` saturates: what lies left of the picture becomes its first column.
    let columns = |from: f64, to: f64| {
        let start = (from.ceil() as usize).max(rim.columns.start);
        start..(to.ceil() as usize).clamp(start, rim.columns.end.max(start))
    };
    match meets(rim.inner) {
        Some((first, last)) => [columns(from, first.min(to)), columns(last.max(from), to)],
        None => [columns(from, to), 0..0],
    }
}
