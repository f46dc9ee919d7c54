//! The rim's inner edge: above the soil the rim begins at it, below it soil lies on either side. The edge of a shadow
//! hides nothing of it.

use crate::cells::Sums;
use crate::contrast::Contrast;
use crate::lines::{PART, Parts, TILTS, line_meets};
use crate::rim::Rim;
use crate::ring::{Middling, NOWHERE, Ring, compare, log_means, nearest};
use crate::rows::ROWS;

/// Distances from the edge, inwards and outwards, in outer radii: far enough from it for a radius that is wrong by 0.5 %.
const AWAY: [f64; 3] = [0.014, 0.022, 0.030];
const RADII: usize = AWAY.len();
/// Rows next to a line whose inner edge may be soil or not.
const GAP: usize = 1;
/// Rows above and below a line that are looked at.
const WIDE: usize = 12;
/// Rows below a line's ends that the soil line may sag between them.
const SAG: usize = 8;
/// A middling step across the inner edge, for how many rows it counts, and a step below which nothing is told apart.
const EDGE: Middling = Middling {
    step: 0.3,
    rows: 3.0,
    least: 0.02,
};

/// The pixels on either side of the inner edge: prepared once for a rim that stays where it is in the picture.
#[derive(Clone, Debug)]
pub struct LipLookup {
    pixels: [[[u32; 2 * RADII]; ROWS]; 2],
    /// Rows down to the edge's lowest point.
    end: usize,
    /// Row at which each line meets the edge, [`LipLookup::end`] where it passes below.
    meets: Parts<[u8; PART]>,
}

impl LipLookup {
    /// Without a rim.
    #[must_use]
    pub fn new() -> Self {
        Self {
            pixels: [[[NOWHERE; 2 * RADII]; ROWS]; 2],
            end: 0,
            meets: [[[0; PART]; ROWS / PART]; TILTS.len()],
        }
    }

    /// Prepares for a rim in a picture of `width` by `height` pixels.
    #[inline(always)]
    pub fn prepare(&mut self, rim: &Rim, width: usize, height: usize) {
        let edge = rim.lip;
        self.end = ((edge * ROWS as f64) as usize).min(ROWS);
        for (side, sign) in self.pixels.iter_mut().zip([-1.0, 1.0]) {
            for (row, pixels) in side.iter_mut().enumerate().take(self.end) {
                let cos = (row as f64 + 0.5) / ROWS as f64 / edge;
                let sin = sign * (1.0 - cos * cos).max(0.0).sqrt();
                let radii = AWAY
                    .map(|away| edge + away)
                    .into_iter()
                    .chain(AWAY.map(|away| edge - away));
                for (pixel, radius) in pixels.iter_mut().zip(radii) {
                    *pixel = nearest(rim, (radius * sin, radius * cos), width, height);
                }
            }
        }
        for (meets, tilt) in self.meets.iter_mut().zip(TILTS) {
            for (row, meets) in meets.as_flattened_mut().iter_mut().enumerate() {
                let height = line_meets(row, tilt, edge as f32) * ROWS as f32;
                // NaN, where the line passes below, becomes the end.
                *meets = if height < self.end as f32 {
                    height.max(0.0) as u8
                } else {
                    self.end as u8
                };
            }
        }
    }

    /// The steps of both sides, left first; 0 where a pixel lies outside of the picture.
    #[inline(always)]
    pub fn measure(&self, image: &[u8], table: &[Sums; 256], lips: &mut [Ring; 2]) {
        for (lip, pixels) in lips.iter_mut().zip(&self.pixels) {
            compare(image, table, pixels, &mut lip[..self.end]);
        }
    }

    /// Fills in the features of every line: how much of the inner edge is seen just above it, just below it, and below.
    #[inline(always)]
    pub fn mark(&self, lip: &Ring, contrast: &mut Contrast) {
        let lip = &lip[..self.end];
        let above = |row: usize| row.saturating_sub(GAP);
        let below = |row: usize| row + GAP + 1;
        contrast.lips = [
            log_means(lip, &EDGE, |row| above(row).saturating_sub(WIDE)..above(row)),
            log_means(lip, &EDGE, |row| below(row)..below(row) + WIDE),
            log_means(lip, &EDGE, |row| row + SAG..ROWS),
        ];
        contrast.lip_rows = self.meets;
    }
}

impl Default for LipLookup {
    fn default() -> Self {
        Self::new()
    }
}
