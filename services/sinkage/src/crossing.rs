//! Where the soil line crosses the wheel's outer edge, once more from the cells near it: soil heaps up beside a wheel, and
//! the straight line that suits the whole rim crosses the edge elsewhere.

use crate::cells::{COLUMNS, Cells};
use crate::interface::Interface;
use crate::rows::ROWS;
use std::array::from_fn;

/// Rows about the interface that are looked at.
const BAND: usize = 10;
/// Rows by which it may move.
const ROWS_AWAY: [f32; 8] = [-3.5, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 3.5];
/// Of the lines of one slope, side by side.
type Lanes = [f32; ROWS_AWAY.len()];
/// Distance from the crossing at which a column counts 1/e, and the least that one counts.
const NEAR: f32 = 0.12;
const WEIGHT_MIN: f32 = 0.05;
/// More columns than count more than that.
const COLUMNS_MAX: usize = 8;
/// Slopes of the soil there, and their standard deviation.
const SLOPES: [f32; 9] = [-0.4, -0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.4];
const SLOPE_SIGMA: f32 = 0.2;
/// Loose prior of the rows by which the interface is wrong.
const ROWS_SIGMA: f32 = 4.0;
/// Neighbouring pixels are not independent: their evidence counts this share.
const INDEPENDENT: f32 = 0.16;
/// Variance of the log gray values below which nothing is told apart.
const VARIANCE_MIN: f32 = 1e-4;
/// Square [rows²] that keeps the change with the depth small where there is little to tell it by.
const CALM: f32 = 1.0;
/// Squares of deviations beyond which a line is none.
const APART_MAX: f32 = 24.0;
/// Weighted pixels that either side of a line needs.
const PIXELS_MIN: f32 = 5.0;
/// Spread of the places, in outer radii, at which the interface moves half of the way to their mean.
const SIGMA: f32 = 0.0032;

/// Weighted pixels and log gray values of one column in each row of the band.
#[derive(Clone, Copy)]
struct Column {
    /// Distance from the middle of the wheel, in outer radii.
    outwards: f32,
    rows: [[f32; 2]; BAND],
}

/// Moves the interface towards where one gray value above and another below explain the band the best, the less the wider
/// those places spread; its sigma stays that of the whole line. Near the wheel soil is darker, for less of the sky lights it:
/// the value below may change with the depth.
///
/// What each line that may be the soil's explains of the log gray values' variance (Otsu's criterion, with that change) is
/// its likelihood.
#[inline(always)]
pub fn refine(cells: &Cells, interface: &mut Interface) {
    let cosine = interface.cosine as f32;
    let middle = (cosine * ROWS as f32).round() as usize;
    if !(0.0..1.0).contains(&cosine) || middle < BAND / 2 {
        return;
    }
    let first = middle - BAND / 2;
    let mut room = [Column {
        outwards: 0.0,
        rows: [[0.0; 2]; BAND],
    }; COLUMNS_MAX];
    let (columns, [pixels, sum, squares]) = near(cells, first, sine(cosine), &mut room);
    if pixels < 2.0 * PIXELS_MIN {
        return;
    }
    let heights = ROWS_AWAY.map(|row| cosine + row / ROWS as f32);
    let crossings = heights.map(sine);
    // Nothing is told apart along a line of which one side is not seen.
    let mut explained = [[sum * sum / pixels; ROWS_AWAY.len()]; SLOPES.len()];
    for (slope, explained) in SLOPES.into_iter().zip(&mut explained) {
        // Rows of the band above the line in the middle of the wheel.
        let starts = from_fn(|k| (heights[k] - slope * crossings[k]) * ROWS as f32 - first as f32);
        let sides = Sides::along(columns, &starts, slope * ROWS as f32);
        for (k, explained) in explained.iter_mut().enumerate() {
            if sides.above[k] >= PIXELS_MIN && pixels - sides.above[k] >= PIXELS_MIN {
                *explained = sides.explained(k, pixels, sum);
            }
        }
    }
    let most = explained
        .as_flattened()
        .iter()
        .copied()
        .fold(f32::NEG_INFINITY, f32::max);
    let variance = (squares - most).max(0.0) / pixels + VARIANCE_MIN;
    let mut moments = [0.0; 3];
    for (slope, explained) in SLOPES.into_iter().zip(explained) {
        for (row, explained) in ROWS_AWAY.into_iter().zip(explained) {
            let apart = INDEPENDENT * (most - explained) / variance
                + (row / ROWS_SIGMA).powi(2)
                + (slope / SLOPE_SIGMA).powi(2);
            if apart > APART_MAX {
                continue;
            }
            let likely = (-0.5 * apart).exp();
            moments = [
                moments[0] + likely,
                moments[1] + likely * row,
                moments[2] + likely * row * row,
            ];
        }
    }
    // Never 0: the line that explains the most is no further away than the sigmas of row and slope put it.
    let mean = moments[1] / moments[0];
    let sigma = (moments[2] / moments[0] - mean * mean).max(0.0).sqrt() / ROWS as f32;
    let step = mean / ROWS as f32 * SIGMA * SIGMA / (SIGMA * SIGMA + sigma * sigma);
    interface.cosine = (interface.cosine + f64::from(step)).min(1.0);
}

/// The columns near a crossing, and all their pixels, log gray values and the squares of these, weighted by how near they are.
#[inline(always)]
fn near<'a>(
    cells: &Cells,
    first: usize,
    crossing: f32,
    room: &'a mut [Column; COLUMNS_MAX],
) -> (&'a [Column], [f32; 3]) {
    let (mut count, mut whole) = (0, [0.0; 3]);
    for (column, rows) in cells.cells.iter().enumerate() {
        let outwards = (column as f32 + 0.5) / COLUMNS as f32;
        let weight = (-((outwards - crossing) / NEAR).powi(2)).exp();
        let Some(kept) = room.get_mut(count).filter(|_| weight >= WEIGHT_MIN) else {
            continue;
        };
        *kept = Column {
            outwards,
            rows: [[0.0; 2]; BAND],
        };
        for (kept, [pixels, sum, squares, _]) in kept.rows.iter_mut().zip(&rows[first..]) {
            *kept = [weight * pixels, weight * sum];
            whole = [whole[0] + kept[0], whole[1] + kept[1], whole[2] + weight * squares];
        }
        count += 1;
    }
    (&room[..count], whole)
}

/// What lies above and below some lines.
struct Sides {
    /// Pixels, and their log gray values.
    above: Lanes,
    logs_above: Lanes,
    /// Depths below the line [rows], their squares, and their products with the log gray values.
    depths: Lanes,
    squares: Lanes,
    products: Lanes,
}

impl Sides {
    /// Of the lines that begin at these rows of the band and fall by `slope` rows per outer radius.
    #[inline(always)]
    fn along(columns: &[Column], starts: &Lanes, slope: f32) -> Self {
        let [mut above, mut logs_above, mut depths, mut squares, mut products] = [[0.0; ROWS_AWAY.len()]; 5];
        for column in columns {
            let lines = starts.map(|start| start + slope * column.outwards);
            for (row, [pixels, sum]) in column.rows.iter().enumerate() {
                for (k, line) in lines.iter().enumerate() {
                    let share = (line - row as f32).clamp(0.0, 1.0);
                    let depth = (row as f32 + 0.5 - line).max(0.0);
                    let below = (1.0 - share) * depth;
                    above[k] += share * pixels;
                    logs_above[k] += share * sum;
                    depths[k] += below * pixels;
                    squares[k] += below * depth * pixels;
                    products[k] += below * sum;
                }
            }
        }
        Self {
            above,
            logs_above,
            depths,
            squares,
            products,
        }
    }

    /// The part of the sum of all squares that one gray value above line `k`, and below it another one that changes with
    /// the depth, explain, less what holds that change small.
    #[inline(always)]
    fn explained(&self, k: usize, pixels: f32, sum: f32) -> f32 {
        let (above, logs_above) = (self.above[k], self.logs_above[k]);
        let (below, logs_below) = (pixels - above, sum - logs_above);
        let depth = self.depths[k] / below;
        let square = self.squares[k] - depth * self.depths[k] + CALM * below;
        let product = self.products[k] - depth * logs_below;
        logs_above * logs_above / above + logs_below * logs_below / below + product * product / square
    }
}

/// How far outwards the outer edge is at a height below the middle.
fn sine(cosine: f32) -> f32 {
    (1.0 - cosine * cosine).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A side of which the rim is dark, and the soil below a line as bright as `soil` says of the rows that it lies deeper.
    fn side(line: impl Fn(f64) -> f64, soil: impl Fn(f64) -> f64) -> Box<Cells> {
        let mut cells = Box::new(Cells::EMPTY);
        for column in 0..COLUMNS {
            for (row, cell) in cells.cells[column].iter_mut().enumerate() {
                for sample in 0..100 {
                    let x = (column as f64 + f64::from(sample % 10) / 10.0 + 0.05) / COLUMNS as f64;
                    let z = (row as f64 + f64::from(sample / 10) / 10.0 + 0.05) / ROWS as f64;
                    let deeper = (z - line(x)) * ROWS as f64;
                    let log = if deeper < 0.0 { 0.2 } else { soil(deeper) };
                    if (0.8 * 0.8..1.0).contains(&(x * x + z * z)) {
                        let log = log as f32;
                        *cell = [cell[0] + 0.1, cell[1] + 0.1 * log, cell[2] + 0.1 * log * log, 0.0];
                    }
                }
            }
        }
        cells
    }

    /// The same: the line crosses the outer edge at `height`, and 0.25 from there towards the middle it bends to a level one.
    fn bent(height: f64, slope: f64) -> Box<Cells> {
        let outermost = (1.0 - height * height).sqrt();
        side(|x| height + slope * (x.max(outermost - 0.25) - outermost), |_| 0.5)
    }

    fn at(cosine: f64) -> Interface {
        Interface {
            cosine,
            sigma: 0.01,
            confidence: 0.9,
        }
    }

    #[test]
    fn a_bent_line_is_followed_to_where_it_crosses_the_edge() {
        const AWAY: f64 = 0.015;
        let mut squares = Vec::new();
        for (height, slope) in [(0.75, 0.0), (0.8, 0.2), (0.85, -0.2), (0.9, 0.3), (0.93, -0.1)] {
            let cells = bent(height, slope);
            let left = |away: f64| {
                let mut interface = at(height + away);
                refine(&cells, &mut interface);
                interface.cosine - height
            };
            // Half a row.
            assert!(left(0.0).abs() < 0.0032, "{height} {slope}: {}", left(0.0));
            for away in [-AWAY, AWAY] {
                assert!(
                    left(away).abs() < 0.75 * AWAY,
                    "{height} {slope} {away}: {}",
                    left(away)
                );
                squares.push(left(away).powi(2));
            }
        }
        let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!(rms < 0.5 * AWAY, "{rms}");
    }

    #[test]
    fn soil_that_is_darker_near_the_wheel_is_no_lower() {
        for height in [0.75, 0.8, 0.85, 0.9] {
            let cells = side(|_| height, |deeper| 0.26 + 0.06 * deeper.min(6.0));
            let mut interface = at(height);
            refine(&cells, &mut interface);
            let left = interface.cosine - height;
            assert!(left.abs() < 0.0032, "{height}: {left}");
        }
    }

    #[test]
    fn an_interface_stays_on_the_wheel() {
        for start in [0.98, 0.99, 1.0, 1.012] {
            let cells = side(|x| start - 0.4 * x, |_| 0.5);
            for cosine in [0.97, 0.98, 0.99, 0.995, 0.999] {
                let mut interface = at(cosine);
                refine(&cells, &mut interface);
                assert!(
                    (0.9..=1.0).contains(&interface.cosine),
                    "{start} {cosine}: {interface:?}"
                );
            }
        }
    }

    #[test]
    fn where_nothing_is_seen_the_interface_stays() {
        for cosine in [-0.1, 0.0, 0.02, 0.5, 0.9, 0.999, 1.0, 1.2, f64::NAN] {
            let mut interface = at(cosine);
            refine(&Cells::EMPTY, &mut interface);
            assert_eq!(interface.cosine.to_bits(), cosine.to_bits());
        }
    }
}
