//! The wheel-terrain interface as the line, a row or slightly tilted, across which the rim's cells differ most consistently.

use crate::cells::{COLUMNS, Cells, Sums};
use crate::ring::{Middling, Ring, log_means};
use crate::rows::ROWS;
use crate::weights::{FEATURES, Feature};
use std::array::from_fn;
use std::ops::Range;

/// Slopes of the lines: rows of height per distance outwards.
pub const TILTS: [f32; 9] = [-0.30, -0.20, -0.12, -0.055, 0.0, 0.055, 0.12, 0.20, 0.30];
/// Distance from the middle at which all lines of a row meet, in outer radii.
const PIVOT: f32 = 0.45;
/// Rows above and below a line that are compared: of the narrow, the middle and the wide window.
const WINDOWS: [usize; 3] = [3, 6, 12];
/// Rows above and below a line whose texture is compared.
const WIDE: usize = WINDOWS[2];
/// Rows that are worked on together: those of a part of a tilt's lines.
pub const PART: usize = 8;
/// Parts of a tilt.
pub const PARTS: usize = ROWS / PART;
/// Lines of a tilt, with those that a window beyond the first and last row needs. Line `l` is that of row `l - WIDE`.
const LINES: usize = ROWS + 2 * WIDE + PART;
/// Rows by which a line crosses a column higher than its row says, at the most.
const LIFT: usize = 28;
/// Edges before the first and after the last of a column that a window or a part reaches.
const REACH: usize = 24;
/// Edges of all columns.
const EDGES: usize = COLUMNS * (ROWS + 2 * REACH);
const _: () = assert!(ROWS.is_multiple_of(PART) && LINES.is_multiple_of(PART) && REACH >= WIDE + PART);
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
/// A middling step across the outer edge, for how many rows it counts, and a step below which nothing is told apart.
const EDGE: Middling = Middling {
    step: 0.15,
    rows: 1.0,
    least: 0.02,
};
/// Rows from which on a line can meet the circle within [`HEIGHTS`].
pub const FIRST: usize = 16;
/// Rows above a line that still belong to it.
const SAME: usize = 10;

/// Of each window the weight of a column, its step, and the step's square.
const TERMS: usize = 3 * WINDOWS.len();
/// Those, and the four sums of the cells over all that lies above.
const SUMS: usize = TERMS + 4;
/// Features that are measured anew along every line.
const MEASURED: usize = 14;
/// The other measured ones, of the pixels next to the line and of all on either side of it, begin with this.
const TEXTURES: usize = Feature::RimTexture as usize;

type Lines = [[f32; LINES]; SUMS];
/// Of some lines side by side.
type Lanes = [f32; PART];
/// Of each part of each tilt.
pub type Parts<T> = [[T; PARTS]; TILTS.len()];
/// Of each row; longer, so that any byte is an index.
pub(crate) type ByRow = [f32; 1 << u8::BITS];

/// The features of one side's lines, each kept only for what it differs by; and the work space for them.
#[derive(Clone, Debug)]
pub struct Contrast {
    /// Of each column and edge, the terms, and the sums over all rows above. Only edges between pixels are kept.
    columns: [[f32; EDGES]; SUMS],
    bands: [Band; COLUMNS],
    /// By how many edges, less [`LIFT`], each column is crossed lower than the row of a tilt's line says.
    lifts: [[usize; COLUMNS]; TILTS.len()],
    /// Sums of those over the columns along each line of one tilt.
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

impl Contrast {
    /// Prepares the work space.
    #[must_use]
    pub fn new() -> Box<Self> {
        let heights: Parts<Lanes> =
            TILTS.map(|tilt| from_fn(|part| from_fn(|lane| meets_circle(part * PART + lane, tilt))));
        let row = |height: f32| ((height * ROWS as f32) as u8).min(ROWS as u8 - 1);
        Box::new(Self {
            columns: [[0.0; EDGES]; SUMS],
            bands: [Band::default(); COLUMNS],
            lifts: TILTS.map(|tilt| from_fn(|column| lift(column, tilt))),
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
        self.compare_columns(cells);
        self.edges = edge_features(ring);
        let whole = self.above(usize::MAX);
        let rim = self.above(FREE);
        let region = Region::of(whole);
        let rim_texture = ln(rim[3] / rim[0].max(1.0) + TEXTURE_MIN);
        let mut largest = [[1e-3; PART]; WINDOWS.len()];
        let mut best = [[0.0; PART]; PARTS];
        for tilt in 0..TILTS.len() {
            let rows = self.rows[tilt].clone();
            self.sum_columns(tilt, &rows);
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
                let textures = &mut measured[TERMS - WINDOWS.len()..];
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
        let (windows, textures) = self.measured[tilt][part].split_at(2 * WINDOWS.len());
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
        let mut of_measured: [f32; MEASURED] = from_fn(|k| {
            weights[if k < 2 * WINDOWS.len() {
                k
            } else {
                TEXTURES + k - 2 * WINDOWS.len()
            }]
        });
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
    /// Of each column the sums above every edge, and the steps across it.
    #[inline(always)]
    fn compare_columns(&mut self, cells: &Cells) {
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
    fn sum_columns(&mut self, tilt: usize, rows: &Range<usize>) {
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
            for (line, sum) in self.lines.iter_mut().zip(sums) {
                line.as_chunks_mut::<PART>().0[part] = sum;
            }
        }
    }

    /// Sums over all columns above the upper edge of a row.
    #[inline(always)]
    fn above(&self, row: usize) -> [f32; 4] {
        from_fn(|sum| {
            let above = &self.columns[TERMS + sum];
            let of_column = |band: &Band| above[band.place + row.clamp(band.first, band.last) - band.first];
            self.bands.iter().map(of_column).sum()
        })
    }

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

/// The four sums over all above each line.
#[inline(always)]
fn above(lines: &Lines) -> [&[f32; LINES]; 4] {
    [&lines[TERMS], &lines[TERMS + 1], &lines[TERMS + 2], &lines[TERMS + 3]]
}

/// The parts that these rows are in.
#[inline(always)]
fn parts(rows: &Range<usize>) -> Range<usize> {
    rows.start / PART..rows.end.div_ceil(PART).min(PARTS)
}

/// As many values as a part has, from the `first` on.
#[inline(always)]
fn at<const LENGTH: usize>(values: &[f32; LENGTH], first: usize) -> Lanes {
    // Always there; the compiler would not know.
    let values = &values[first.min(LENGTH - PART)..];
    *values.first_chunk().unwrap_or(&[0.0; PART])
}

/// What lies between two places, from sums over all that is above.
#[inline(always)]
fn between<const LENGTH: usize>(sums: &[f32; LENGTH], first: usize, last: usize) -> Lanes {
    let (above, below) = (at(sums, first), at(sums, last));
    from_fn(|k| below[k] - above[k])
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

/// Edges, and [`LIFT`], by which a line crosses a column lower than its row says.
fn lift(column: usize, tilt: f32) -> usize {
    let outwards = (column as f32 + 0.5) / COLUMNS as f32 - PIVOT;
    (LIFT as f32 + tilt * outwards * ROWS as f32 + 0.5) as usize
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
        contrast.compare_columns(&cells);
        for (k, tilt) in TILTS.into_iter().enumerate() {
            contrast.sum_columns(k, &(FIRST..ROWS));
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
