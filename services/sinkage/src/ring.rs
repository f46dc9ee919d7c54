//! The wheel's outer edge: above the soil the rim ends at it, below it soil lies on either side.

use crate::cells::Sums;
use crate::contrast::{ByRow, ln};
use crate::rim::{Rim, project};
use crate::rows::ROWS;
use std::ops::Range;

/// Radii inside and outside the edge, in outer radii: far enough from it for a radius that is wrong by 0.5 %.
const INSIDE: [f64; 3] = [0.955, 0.968, 0.981];
const OUTSIDE: [f64; 3] = [1.019, 1.029, 1.039];
const RADII: usize = INSIDE.len();
/// A pixel outside of any picture.
pub(crate) const NOWHERE: u32 = u32::MAX;

/// Of each row of a side, the difference of the log gray values across the outer edge at its height.
pub type Ring = [f32; ROWS];

/// The pixels on either side of the outer edge: prepared once for a rim that stays where it is in the picture.
#[derive(Clone, Debug)]
pub struct RingLookup {
    pixels: [[[u32; 2 * RADII]; ROWS]; 2],
}

impl RingLookup {
    /// Without a rim.
    #[must_use]
    pub fn new() -> Self {
        Self {
            pixels: [[[NOWHERE; 2 * RADII]; ROWS]; 2],
        }
    }

    /// Prepares for a rim in a picture of `width` by `height` pixels.
    #[inline(always)]
    pub fn prepare(&mut self, rim: &Rim, width: usize, height: usize) {
        for (side, sign) in self.pixels.iter_mut().zip([-1.0, 1.0]) {
            for (row, pixels) in side.iter_mut().enumerate() {
                let cos = (row as f64 + 0.5) / ROWS as f64;
                let sin = sign * (1.0 - cos * cos).sqrt();
                for (pixel, radius) in pixels.iter_mut().zip(INSIDE.into_iter().chain(OUTSIDE)) {
                    *pixel = nearest(rim, (radius * sin, radius * cos), width, height);
                }
            }
        }
    }

    /// The outermost pixel of each row.
    pub(crate) fn outermost(&self) -> impl Iterator<Item = u32> {
        self.pixels.as_flattened().iter().map(|pixels| pixels[2 * RADII - 1])
    }

    /// The differences of both sides, left first; 0 where a pixel lies outside of the picture.
    #[inline(always)]
    pub fn measure(&self, image: &[u8], table: &[Sums; 256], rings: &mut [Ring; 2]) {
        for (ring, pixels) in rings.iter_mut().zip(&self.pixels) {
            compare(image, table, pixels, ring);
        }
    }
}

/// Index of the pixel nearest to a point of the wheel's face; [`NOWHERE`] beyond the picture.
#[inline(always)]
pub(crate) fn nearest(rim: &Rim, (right, down): (f64, f64), width: usize, height: usize) -> u32 {
    project(&rim.image, right, down)
        // `as` rounds down.
        .map(|(column, row)| (column + 0.5, row + 0.5))
        .filter(|(column, row)| (0.0..width as f64).contains(column) && (0.0..height as f64).contains(row))
        .map_or(NOWHERE, |(column, row)| (row as usize * width + column as usize) as u32)
}

/// The difference of the mean log gray values of the first and the other half of each row's `pixels`, without its sign; 0
/// where one of them lies outside of the picture.
#[inline(always)]
pub(crate) fn compare<const PIXELS: usize>(
    image: &[u8],
    table: &[Sums; 256],
    pixels: &[[u32; PIXELS]],
    ring: &mut [f32],
) {
    let log = |gray: u8| table[usize::from(gray)][1];
    let half = PIXELS / 2;
    for (step, pixels) in ring.iter_mut().zip(pixels) {
        let mut sum = 0.0;
        let mut all = true;
        for (k, pixel) in pixels.iter().enumerate() {
            match image.get(*pixel as usize) {
                Some(gray) if k < half => sum += log(*gray),
                Some(gray) => sum -= log(*gray),
                None => all = false,
            }
        }
        *step = if all { (sum / half as f32).abs() } else { 0.0 };
    }
}

/// What few rows are taken for.
pub(crate) struct Middling {
    /// A step across an edge, and for how many rows it counts.
    pub step: f32,
    pub rows: f32,
    /// Step below which nothing is told apart.
    pub least: f32,
}

/// Of each row up to the end of the ring, the log of the mean step over a range of rows that begins and ends within it or after.
#[inline(always)]
pub(crate) fn log_means(ring: &[f32], middling: &Middling, range: impl Fn(usize) -> Range<usize>) -> ByRow {
    let end = ring.len().min(ROWS);
    let mut above = [0.0; ROWS + 1];
    for (row, step) in ring[..end].iter().enumerate() {
        above[row + 1] = above[row] + step;
    }
    let (mut sums, mut counts) = ([0.0_f32; 1 << u8::BITS], [0.0_f32; 1 << u8::BITS]);
    for row in 0..=end {
        let range = range(row);
        let (first, last) = (range.start.min(end), range.end.min(end));
        sums[row] = above[last] - above[first];
        counts[row] = last.saturating_sub(first) as f32;
    }
    for (sum, count) in sums.iter_mut().zip(counts) {
        let mean = (*sum + middling.rows * middling.step) / (count + middling.rows);
        *sum = ln(mean.max(0.0) + middling.least);
    }
    sums
}

/// The mean difference below a height.
#[must_use]
pub fn below(ring: &Ring, height: f64) -> f32 {
    let first = (height.max(0.0) * ROWS as f64).ceil() as usize;
    let steps = &ring[first.min(ROWS - 1)..];
    steps.iter().sum::<f32>() / steps.len() as f32
}

impl Default for RingLookup {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_few_steps_is_drawn_to_a_middling_one() {
        let ring: [f32; 100] = std::array::from_fn(|row| 0.01 * (row % 9) as f32);
        let middling = Middling {
            step: 0.2,
            rows: 2.0,
            least: 0.01,
        };
        let means = log_means(&ring, &middling, |row| row + 1..row + 13);
        for (row, mean) in means.iter().enumerate().take(101) {
            let steps = ring.iter().skip(row + 1).take(12);
            let (sum, count) = (steps.clone().sum::<f32>(), steps.count() as f32);
            let expected = ((sum + 2.0 * 0.2) / (count + 2.0) + 0.01).ln();
            assert!((mean - expected).abs() < 1e-4, "{row}: {mean} {expected}");
        }
    }
}
