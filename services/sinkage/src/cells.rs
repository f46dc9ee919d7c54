//! The rim in cells: log gray values over rows of constant height and columns of constant distance from the middle.

use crate::rim::Rim;
use crate::rows::ROWS;
use messages::PIXELS_MAX;
use std::ops::Range;

/// Columns from the middle of the wheel to its outermost point.
pub const COLUMNS: usize = 16;
/// Gray values below which the sensor's noise hides ratios.
const DARK: f32 = 4.0;
/// The same for the ratio of single pixels.
const DARK_PIXEL: f32 = 16.0;
/// About the logarithm of a middle gray: sums of what is left keep their digits.
const MIDDLE: f32 = 4.0;
/// Distance of the pixels whose ratio is the texture: neighbours are blurred into each other.
const APART: usize = 2;
/// The last of the four [`Sums`], and the others.
const LAST: Sums = [0.0, 0.0, 0.0, 1.0];
const OTHERS: Sums = [1.0, 1.0, 1.0, 0.0];
/// Pixels whose cells are worked out together.
const BLOCK: usize = 32;

/// Pixels of a cell; the sums of their log gray values, of their squares, and of the squared differences of pixels side by side.
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
        // Several sums at once: one of them alone would wait for each addition.
        let mut counts = [0.0; 8];
        for cells in self.cells.as_flattened().chunks_exact(counts.len()) {
            for (count, cell) in counts.iter_mut().zip(cells) {
                *count += cell[0];
            }
        }
        counts.iter().sum()
    }
}

/// Of each gray value: 1, its logarithm, the square of that, and the logarithm that texture is told by.
#[must_use]
pub fn log_table() -> [Sums; 256] {
    std::array::from_fn(|gray| {
        let log = (gray as f32 + DARK).ln() - MIDDLE;
        [1.0, log, log * log, (gray as f32 + DARK_PIXEL).ln()]
    })
}

/// Pixels side by side in one cell.
#[derive(Clone, Copy, Debug)]
struct Run {
    first: u32,
    /// Of both sides, the left ones first.
    cell: u16,
    length: u8,
    /// Where the pixels are that texture compares these with.
    apart: i8,
}

/// Which pixel belongs to which cell: prepared once for a rim that stays where it is in the picture.
#[derive(Clone, Debug)]
pub struct Lookup {
    runs: Vec<Run>,
}

impl Lookup {
    /// Without a rim; memory for the worst one is set aside, and touched where a rim needs it.
    #[must_use]
    pub fn new() -> Self {
        Self {
            runs: Vec::with_capacity(PIXELS_MAX),
        }
    }

    /// Prepares for a rim in a picture of rows of `width` pixels.
    #[inline(always)]
    pub fn prepare(&mut self, rim: &Rim, width: usize) {
        self.runs.clear();
        for row in rim.rows.clone() {
            for span in spans(rim, row) {
                // Texture compares within the span, since what lies beyond it is no rim: the first pixels with those after.
                let within = (span.start + APART).min(span.end);
                self.add(span.start..within, APART as i8, row, rim, width);
                for first in (within..span.end).step_by(BLOCK) {
                    self.add(first..span.end.min(first + BLOCK), -(APART as i8), row, rim, width);
                }
            }
        }
    }

    /// Adds at most [`BLOCK`] pixels of one row of the picture.
    #[inline(always)]
    fn add(&mut self, columns: Range<usize>, apart: i8, row: usize, rim: &Rim, width: usize) {
        let (first, length) = (columns.start, columns.len().min(BLOCK));
        let [a, b, c, d, e, f, g, h, i] = rim.plane;
        let (x, y) = (first as f64, row as f64);
        let start = [a * x + b * y + c, d * x + e * y + f, g * x + h * y + i].map(|value| value as f32);
        let step = [a as f32, d as f32, g as f32];
        let mut cells = [0_u16; BLOCK];
        for (k, cell) in cells.iter_mut().enumerate() {
            let along = k as f32;
            let scale = 1.0 / (start[2] + along * step[2]);
            let right = (start[0] + along * step[0]) * scale;
            let down = (start[1] + along * step[1]) * scale;
            let side = if right >= 0.0 { (COLUMNS * ROWS) as u32 } else { 0 };
            let column = floor(right.abs() * COLUMNS as f32, COLUMNS as u32 - 1);
            let height = floor(down * ROWS as f32, ROWS as u32 - 1);
            *cell = (side + column * ROWS as u32 + height) as u16;
        }
        // A bit for each pixel that is the last of a run: the next one belongs to another cell.
        let mut ends = 1_u64 << (length.max(1) - 1);
        for k in 1..BLOCK {
            ends |= u64::from(cells[k] != cells[k - 1]) << (k - 1);
        }
        ends &= (1 << length) - 1;
        let mut done = 0;
        while ends != 0 {
            let last = ends.trailing_zeros() as usize;
            // There is room: a frame has no more pixels than that.
            if self.runs.len() < self.runs.capacity() {
                self.runs.push(Run {
                    first: (row * width + first + done) as u32,
                    cell: cells[done % BLOCK],
                    length: (last + 1 - done) as u8,
                    apart,
                });
            }
            done = last + 1;
            ends &= ends - 1;
        }
    }

    /// Sums the picture's cells: `[left, right]`.
    #[inline(always)]
    pub fn accumulate(&self, image: &[u8], table: &[Sums; 256], sides: &mut [Cells; 2]) {
        for side in &mut *sides {
            side.cells = Cells::EMPTY.cells;
        }
        let [left, right] = sides;
        for run in &self.runs {
            let (first, length) = (run.first as usize, usize::from(run.length));
            let other = first.saturating_add_signed(isize::from(run.apart));
            let (Some(pixels), Some(others)) = (image.get(first..first + length), image.get(other..other + length))
            else {
                continue;
            };
            let mut sums = [0.0; 4];
            for (&gray, &other) in pixels.iter().zip(others) {
                let (here, there) = (&table[usize::from(gray)], &table[usize::from(other)]);
                for k in 0..4 {
                    // The last is squared, after the other pixel's is taken off: in all four alike, as one vector.
                    let off = there[k] * LAST[k];
                    sums[k] += (here[k] - off) * (OTHERS[k] + here[k] * LAST[k] - off);
                }
            }
            let cell = usize::from(run.cell);
            let cells = if cell < COLUMNS * ROWS {
                &mut left.cells
            } else {
                &mut right.cells
            };
            if let Some(cell) = cells.as_flattened_mut().get_mut(cell % (COLUMNS * ROWS)) {
                for (sum, term) in cell.iter_mut().zip(sums) {
                    *sum += term;
                }
            }
        }
    }
}

impl Default for Lookup {
    fn default() -> Self {
        Self::new()
    }
}

/// The whole number below a value, 0 to `most`: the last bits of a sum so large that its unit is 1, since the compiler makes
/// vectors of it and not of `as`.
#[inline(always)]
fn floor(value: f32, most: u32) -> u32 {
    const LARGE: f32 = 12_582_912.0;
    (value.max(0.0).min(most as f32 + 0.5) - 0.5 + LARGE).to_bits() & 0x003f_ffff
}

/// The columns of a row of the picture that show the lower half of the annulus: left and right of the wheel's inside.
#[inline(always)]
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
