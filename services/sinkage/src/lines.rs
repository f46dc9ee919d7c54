//! The lines that the soil may make, rows or slightly tilted, and what the cells sum up to along them.

use crate::cells::{COLUMNS, Cells, Sums};
use crate::rows::ROWS;
use std::array::from_fn;
use std::ops::Range;

/// Slopes of the lines: rows of height per distance outwards.
pub const TILTS: [f32; 9] = [-0.30, -0.20, -0.12, -0.055, 0.0, 0.055, 0.12, 0.20, 0.30];
/// Distance from the middle at which all lines of a row meet, in outer radii.
const PIVOT: f32 = 0.45;
/// Rows above and below a line that are compared: of the narrow, the middle and the wide window.
pub(crate) const WINDOWS: [usize; 3] = [3, 6, 12];
/// Rows above and below a line whose texture is compared.
pub(crate) const WIDE: usize = WINDOWS[2];
/// Rows that are worked on together: those of a part of a tilt's lines.
pub const PART: usize = 8;
/// Parts of a tilt.
pub const PARTS: usize = ROWS / PART;
/// Lines of a tilt, with those that a window beyond the first and last row needs. Line `l` is that of row `l - WIDE`.
pub(crate) const LINES: usize = ROWS + 2 * WIDE + PART;
/// Rows by which a line crosses a column higher than its row says, at the most.
const LIFT: usize = 28;
/// Edges before the first and after the last of a column that a window or a part reaches.
const REACH: usize = 24;
/// Edges of all columns.
const EDGES: usize = COLUMNS * (ROWS + 2 * REACH);
const _: () = assert!(ROWS.is_multiple_of(PART) && LINES.is_multiple_of(PART) && REACH >= WIDE + PART);
/// Pixels of a column on either side of a line, below which it says nothing.
const COLUMN_MIN: f32 = 2.5;

/// Of each window the weight of a column, its step, and the step's square.
pub(crate) const TERMS: usize = 3 * WINDOWS.len();
/// Those, and the four sums of the cells over all that lies above.
pub(crate) const SUMS: usize = TERMS + 4;
pub(crate) type Lines = [[f32; LINES]; SUMS];
/// Of some lines side by side.
pub type Lanes = [f32; PART];
/// Of each part of each tilt.
pub type Parts<T> = [[T; PARTS]; TILTS.len()];

/// The cells of one side, and what each column says of the edges between its rows.
#[derive(Clone, Debug)]
pub(crate) struct Columns {
    /// Of each column and edge, the terms, and the sums over all rows above. Only edges between pixels are kept.
    columns: [[f32; EDGES]; SUMS],
    bands: [Band; COLUMNS],
    /// By how many edges, less [`LIFT`], each column is crossed lower than the row of a tilt's line says.
    lifts: [[usize; COLUMNS]; TILTS.len()],
}

/// Where the edges of a column are kept: the first and the last one between pixels, and the place of the first.
#[derive(Clone, Copy, Debug, Default)]
struct Band {
    first: usize,
    last: usize,
    place: usize,
    /// Sums over the whole column.
    whole: Sums,
}

impl Band {
    /// Edges that are worked on.
    fn room(&self) -> usize {
        (self.last - self.first).next_multiple_of(PART)
    }
}

impl Columns {
    /// Without cells.
    pub fn new() -> Self {
        Self {
            columns: [[0.0; EDGES]; SUMS],
            bands: [Band::default(); COLUMNS],
            lifts: TILTS.map(|tilt| from_fn(|column| lift(column, tilt))),
        }
    }

    /// Of each column the sums above every edge, and the steps across it.
    #[inline(always)]
    pub fn compare(&mut self, cells: &Cells) {
        let mut place = REACH;
        for ((rows, band), kept) in cells.cells.iter().zip(&cells.bands).zip(&mut self.bands) {
            for above in &mut self.columns[TERMS..] {
                above[place - REACH..=place].fill(0.0);
            }
            let mut whole = [0.0; 4];
            for (cell, edge) in rows[band.clone()].iter().zip(place + 1..) {
                for k in 0..4 {
                    whole[k] += cell[k];
                    self.columns[TERMS + k][edge] = whole[k];
                }
            }
            *kept = Band {
                first: band.start,
                last: band.end,
                place,
                whole,
            };
            for (above, sum) in self.columns[TERMS..].iter_mut().zip(whole) {
                above[place + band.len()..place + kept.room() + REACH].fill(sum);
            }
            place += kept.room() + 2 * REACH;
        }
        let (terms, sums) = self.columns.split_at_mut(TERMS);
        for band in &self.bands {
            let (place, end) = (band.place, band.place + band.room());
            for term in &mut *terms {
                term[place - PART..place].fill(0.0);
                term[end..end + PART].fill(0.0);
            }
            for edge in (place..end).step_by(PART) {
                for (window, terms) in WINDOWS.into_iter().zip(terms.as_chunks_mut::<3>().0) {
                    for (term, values) in terms.iter_mut().zip(compare(sums, edge, window)) {
                        term[edge..edge + PART].copy_from_slice(&values);
                    }
                }
            }
        }
    }

    /// Sums over the columns along those lines of one tilt that a window about one of these rows needs.
    #[inline(always)]
    pub fn sum_along(&self, tilt: usize, rows: &Range<usize>, lines: &mut Lines) {
        let needed = rows.start / PART..(rows.end + 2 * WIDE).div_ceil(PART);
        let mut places = [0; COLUMNS];
        let (mut from, mut to) = ([0_u8; COLUMNS], [0_u8; COLUMNS]);
        // Sums of the columns that end before a part: they lie above all further lines.
        let mut ended = [[0.0; 4]; LINES / PART + 1];
        for (column, (band, lift)) in self.bands.iter().zip(self.lifts[tilt]).enumerate() {
            // Line l is edge l + lift - (WIDE + LIFT) of this column.
            let line = |edge: usize| (edge + WIDE + LIFT).saturating_sub(lift);
            from[column] = (line(band.first) / PART).clamp(needed.start, needed.end) as u8;
            to[column] = line(band.last).div_ceil(PART).clamp(needed.start, needed.end) as u8;
            // The place of line 0: of the lines that the column meets it is never negative.
            places[column] = (band.place + lift).wrapping_sub(band.first + WIDE + LIFT);
            for (ended, sum) in ended[usize::from(to[column])].iter_mut().zip(band.whole) {
                *ended += sum;
            }
        }
        let mut beyond = [0.0; 4];
        for part in needed {
            for (beyond, ended) in beyond.iter_mut().zip(ended[part]) {
                *beyond += ended;
            }
            let mut sums = [[0.0; PART]; SUMS];
            for (sum, beyond) in sums[TERMS..].iter_mut().zip(beyond) {
                *sum = [beyond; PART];
            }
            let mut columns = 0_u32;
            for column in 0..COLUMNS {
                let meets = (from[column] <= part as u8) & ((part as u8) < to[column]);
                columns |= u32::from(meets) << column;
            }
            while columns != 0 {
                let column = columns.trailing_zeros() as usize % COLUMNS;
                columns &= columns - 1;
                let place = places[column].wrapping_add(part * PART);
                for (sum, terms) in sums.iter_mut().zip(&self.columns) {
                    let terms = at(terms, place);
                    *sum = from_fn(|k| sum[k] + terms[k]);
                }
            }
            for (line, sum) in lines.iter_mut().zip(sums) {
                line.as_chunks_mut::<PART>().0[part] = sum;
            }
        }
    }

    /// Sums over all columns above the upper edge of a row.
    #[inline(always)]
    pub fn above(&self, row: usize) -> [f32; 4] {
        from_fn(|sum| {
            let above = &self.columns[TERMS + sum];
            let of_column = |band: &Band| above[band.place + row.clamp(band.first, band.last) - band.first];
            self.bands.iter().map(of_column).sum()
        })
    }
}

/// The weight of a column at some edges, its step, and the step's square: the step is that of the mean log gray value, its
/// weight the pixels it rests on.
#[inline(always)]
fn compare(above: &[[f32; EDGES]], edge: usize, window: usize) -> [Lanes; 3] {
    let (first, last) = (edge - window, edge + window);
    let [counts, logs, ..] = above else {
        return [[0.0; PART]; 3];
    };
    let (counts_above, counts_below) = (between(counts, first, edge), between(counts, edge, last));
    let (logs_above, logs_below) = (between(logs, first, edge), between(logs, edge, last));
    let mut terms = [[0.0; PART]; 3];
    for k in 0..PART {
        let (above, below) = (counts_above[k], counts_below[k]);
        let known = (above >= COLUMN_MIN) & (below >= COLUMN_MIN);
        let (na, nb) = (above.max(1.0), below.max(1.0));
        let step = logs_below[k] / nb - logs_above[k] / na;
        let weight = if known { 2.0 * na * nb / (na + nb) } else { 0.0 };
        terms[0][k] = weight;
        terms[1][k] = weight * step;
        terms[2][k] = weight * step * step;
    }
    terms
}

/// The parts that these rows are in.
#[inline(always)]
pub(crate) fn parts(rows: &Range<usize>) -> Range<usize> {
    rows.start / PART..rows.end.div_ceil(PART).min(PARTS)
}

/// As many values as a part has, from the `first` on.
#[inline(always)]
pub(crate) fn at<const LENGTH: usize>(values: &[f32; LENGTH], first: usize) -> Lanes {
    // Always there; the compiler would not know.
    let values = &values[first.min(LENGTH - PART)..];
    *values.first_chunk().unwrap_or(&[0.0; PART])
}

/// What lies between two places, from sums over all that is above.
#[inline(always)]
pub(crate) fn between<const LENGTH: usize>(sums: &[f32; LENGTH], first: usize, last: usize) -> Lanes {
    let (above, below) = (at(sums, first), at(sums, last));
    from_fn(|k| below[k] - above[k])
}

/// Edges, and [`LIFT`], by which a line crosses a column lower than its row says.
fn lift(column: usize, tilt: f32) -> usize {
    let outwards = (column as f32 + 0.5) / COLUMNS as f32 - PIVOT;
    (LIFT as f32 + tilt * outwards * ROWS as f32 + 0.5) as usize
}

/// Height at which the line through the pivot at this row meets the outer circle; NaN where it does not.
pub(crate) fn meets_circle(row: usize, tilt: f32) -> f32 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contrast::FIRST;

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
        let (cells, mut columns, mut lines) = (ring(), Columns::new(), [[0.0; LINES]; SUMS]);
        columns.compare(&cells);
        for (k, tilt) in TILTS.into_iter().enumerate() {
            columns.sum_along(k, &(FIRST..ROWS), &mut lines);
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
                    if above.0 >= 2.5 && below.0 >= 2.5 {
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
                    let found = f64::from(lines[sum][row + WIDE]);
                    assert!(
                        (found - expected).abs() < 1e-4 * (10.0 + expected.abs()),
                        "{tilt} {row} {k}: {found} {expected}"
                    );
                }
            }
        }
    }
}
