//! The rim in cells: log gray values over rows of constant height and columns of constant distance from the middle.

use crate::rim::Rim;
use crate::rows::ROWS;
use messages::PIXELS_MAX;
use std::ops::Range;

/// Columns from the middle of the wheel to its outermost point.
pub const COLUMNS: usize = 16;
/// Cells of one side.
const CELLS: usize = COLUMNS * ROWS;
/// Gray values below which the sensor's noise hides ratios.
const DARK: f32 = 4.0;
/// The same for the ratio of single pixels.
const DARK_PIXEL: f32 = 16.0;
/// About the logarithm of a middle gray: sums of what is left keep their digits.
const MIDDLE: f32 = 4.0;
/// Distance of the pixels whose ratio is the texture: neighbours are blurred into each other.
const APART: usize = 2;
/// Pixels whose cells are worked out together.
const BLOCK: usize = 32;
/// Pixels of a span at most, and spans at most: 0.75 of one side of the largest wheel that a frame holds has fewer.
const SPAN: usize = 8 * BLOCK;
const SPANS: usize = 1 << 13;
/// Pixels that come from memory at once.
const CACHE_LINE: usize = 64;
/// Parts of a picture that a rim needs at most.
pub(crate) const PARTS_MAX: usize = SPANS * (SPAN / CACHE_LINE + 1);

/// Pixels of a cell; the sums of their log gray values, of their squares, and of the squared differences of pixels side by side.
pub type Sums = [f32; 4];

/// One side of the lower half of the annulus.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// Sums of each cell.
    pub cells: [[Sums; ROWS]; COLUMNS],
    /// The rows of each column that have pixels.
    pub bands: [Range<usize>; COLUMNS],
}

impl Cells {
    /// A side without a pixel.
    pub const EMPTY: Self = Self {
        cells: [[[0.0; 4]; ROWS]; COLUMNS],
        bands: [const { 0..0 }; COLUMNS],
    };

    /// Pixels of all cells.
    #[must_use]
    pub fn pixels(&self) -> f32 {
        let columns = self.cells.iter().zip(&self.bands);
        // Whole numbers, of which single precision loses nothing: the columns side by side.
        let of_column = |(rows, band): (&[Sums; ROWS], &Range<usize>)| -> f32 {
            rows[band.clone()].iter().map(|cell| cell[0]).sum()
        };
        columns.map(of_column).sum()
    }

    /// Without pixels, but the rows that may get some.
    #[inline(always)]
    fn clear(&mut self, bands: &[Range<usize>; COLUMNS]) {
        for (rows, band) in self.cells.iter_mut().zip(&self.bands) {
            rows[band.clone()].as_flattened_mut().fill(0.0);
        }
        self.bands.clone_from(bands);
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

/// Pixels side by side in the rim.
#[derive(Clone, Copy, Debug)]
struct Span {
    first: u32,
    length: u16,
    runs: u16,
    /// Whether what lies left of it is no rim.
    begins: bool,
}

/// Pixels of a span in one cell.
#[derive(Clone, Copy, Debug)]
struct Run {
    /// Of both sides, the left ones first.
    cell: u16,
    length: u16,
}

/// Which pixel belongs to which cell: prepared once for a rim that stays where it is in the picture.
#[derive(Clone, Debug)]
pub struct Lookup {
    spans: Vec<Span>,
    /// Of all spans, one after the other.
    runs: Vec<Run>,
    /// The rows of each column that have pixels, on either side.
    bands: [[Range<usize>; COLUMNS]; 2],
}

impl Lookup {
    /// Without a rim; memory for the worst one is set aside, and touched where a rim needs it.
    #[must_use]
    pub fn new() -> Self {
        Self {
            spans: Vec::with_capacity(SPANS),
            runs: Vec::with_capacity(PIXELS_MAX),
            bands: [Cells::EMPTY.bands, Cells::EMPTY.bands],
        }
    }

    /// Prepares for a rim in a picture of rows of `width` pixels.
    #[inline(always)]
    pub fn prepare(&mut self, rim: &Rim, width: usize) {
        self.spans.clear();
        self.runs.clear();
        for row in rim.rows.clone() {
            for columns in spans(rim, row) {
                for first in columns.clone().step_by(SPAN) {
                    let last = columns.end.min(first + SPAN);
                    if self.spans.len() < self.spans.capacity() {
                        let before = self.runs.len();
                        for first in (first..last).step_by(BLOCK) {
                            self.add(first..last.min(first + BLOCK), before, row, rim);
                        }
                        self.spans.push(Span {
                            first: (row * width + first) as u32,
                            length: (last - first) as u16,
                            runs: (self.runs.len() - before) as u16,
                            begins: first == columns.start,
                        });
                    }
                }
            }
        }
        self.bands = [Cells::EMPTY.bands, Cells::EMPTY.bands];
        let bands = self.bands.as_flattened_mut();
        for run in &self.runs {
            let (column, row) = (usize::from(run.cell) / ROWS, usize::from(run.cell) % ROWS);
            let band = &mut bands[column % (2 * COLUMNS)];
            *band = if band.start == band.end {
                row..row + 1
            } else {
                band.start.min(row)..band.end.max(row + 1)
            };
        }
    }

    /// Adds at most [`BLOCK`] pixels of one row of the picture to the runs of their span, which are those from `begin` on.
    #[inline(always)]
    fn add(&mut self, columns: Range<usize>, begin: usize, row: usize, rim: &Rim) {
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
            let side = if right >= 0.0 { CELLS as u32 } else { 0 };
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
            let run = Run {
                cell: cells[done % BLOCK],
                length: (last + 1 - done) as u16,
            };
            if let Some(before) = self.runs[begin..].last_mut()
                && before.cell == run.cell
            {
                before.length += run.length;
            } else if self.runs.len() < self.runs.capacity() {
                // There is room: a frame has no more pixels than that.
                self.runs.push(run);
            }
            done = last + 1;
            ends &= ends - 1;
        }
    }

    /// A pixel of each part of the picture that is needed.
    #[inline(always)]
    pub fn parts(&self) -> impl Iterator<Item = u32> {
        self.spans.iter().flat_map(|span| {
            let end = span.first + u32::from(span.length);
            (span.first..end).step_by(CACHE_LINE).chain([end - 1])
        })
    }

    /// Sums the picture's cells: `[left, right]`.
    #[inline(always)]
    pub fn accumulate(&self, image: &[u8], table: &[Sums; 256], sides: &mut [Cells; 2]) {
        for (side, bands) in sides.iter_mut().zip(&self.bands) {
            side.clear(bands);
        }
        let [left, right] = sides.each_mut().map(|side| side.cells.as_flattened_mut());
        let mut runs = self.runs.as_slice();
        for span in &self.spans {
            let Some((mine, others)) = runs.split_at_checked(usize::from(span.runs)) else {
                return;
            };
            runs = others;
            let first = span.first as usize;
            // Texture compares with the pixel two before, which the first ones of a rim do not have: with those after.
            let apart = if span.begins {
                first + APART
            } else {
                first.saturating_sub(APART)
            };
            let (Some(mut pixels), Some([two_before, before])) = (
                image.get(first..first + usize::from(span.length)),
                image.get(apart..apart + APART),
            ) else {
                continue;
            };
            let of_pixel = |gray: u8| table[usize::from(gray)][3];
            let (mut two_before, mut before) = (of_pixel(*two_before), of_pixel(*before));
            for run in mine {
                let Some((here, others)) = pixels.split_at_checked(usize::from(run.length)) else {
                    break;
                };
                pixels = others;
                let (mut logs, mut squares, mut textures) = (0.0, 0.0, 0.0);
                for gray in here {
                    let [_, log, square, texture] = table[usize::from(*gray)];
                    let step = texture - two_before;
                    logs += log;
                    squares += square;
                    textures += step * step;
                    (two_before, before) = (before, texture);
                }
                let sums = [f32::from(run.length), logs, squares, textures];
                let cell = usize::from(run.cell);
                let cell = if cell < CELLS {
                    left.get_mut(cell)
                } else {
                    right.get_mut(cell - CELLS)
                };
                if let Some(cell) = cell {
                    for (sum, term) in cell.iter_mut().zip(sums) {
                        *sum += term;
                    }
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
