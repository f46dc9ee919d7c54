//! The rim's pixels in the picture, prepared once for a wheel that stays where it is.

use crate::cells::{Cells, Lookup, PARTS_MAX, Sums};
use crate::center::Shift;
use crate::contrast::Contrast;
use crate::lip::LipLookup;
use crate::rim::Rim;
use crate::ring::{Ring, RingLookup};
use crate::rows::ROWS;
use std::hint::black_box;

/// How far the refined rim may be from the prepared one [px]: what remains is taken off the answer.
const TOLERANCE_PX: f64 = 0.4;

/// Which pixel counts for what.
#[derive(Clone, Debug)]
pub struct Annulus {
    /// The rim as the frame gives it, the picture's width, and the shift that was prepared for.
    prepared: Option<(Rim, usize, Shift)>,
    cells: Lookup,
    ring: RingLookup,
    lip: LipLookup,
    lips: [Ring; 2],
    /// Pixels of all parts of the picture that these need.
    needed: Vec<u32>,
}

impl Annulus {
    /// Without a rim.
    #[must_use]
    pub fn new() -> Self {
        Self {
            prepared: None,
            cells: Lookup::new(),
            ring: RingLookup::new(),
            lip: LipLookup::new(),
            lips: [[0.0; ROWS]; 2],
            needed: Vec::with_capacity(PARTS_MAX + 2 * ROWS),
        }
    }

    /// Prepares for the rim, shifted, if it is not the one prepared for. Gives what remains of the shift.
    #[inline(always)]
    pub fn follow(&mut self, rim: &Rim, shift: Shift, width: usize, height: usize) -> Shift {
        if let Some((known, known_width, done)) = &self.prepared
            && known == rim
            && *known_width == width
        {
            let rest = Shift {
                right: shift.right - done.right,
                down: shift.down - done.down,
                growth: shift.growth - done.growth,
            };
            let most = rest.right.abs().max(rest.down.abs()).max(rest.growth.abs());
            if most * rim.wheel_px <= TOLERANCE_PX {
                return rest;
            }
        }
        let moved = shift.applied(rim);
        self.cells.prepare(&moved, width);
        self.ring.prepare(&moved, width, height);
        self.lip.prepare(&moved, width, height);
        self.needed.clear();
        self.needed.extend(self.cells.parts());
        self.needed.extend(self.ring.outermost());
        self.prepared = Some((rim.clone(), width, shift));
        Shift::NONE
    }

    /// Reads a pixel of each part of the picture that the last rim was made of, without waiting for any: they arrive side by
    /// side. Most often this rim is made of them, too.
    #[inline(always)]
    pub fn call_up(&self, image: &[u8]) {
        let mut sum = 0_u8;
        for pixel in &self.needed {
            sum ^= image.get(*pixel as usize).unwrap_or(&0);
        }
        black_box(sum);
    }

    /// Sums up the cells and the steps across the outer edge: `[left, right]`.
    #[inline(always)]
    pub fn measure(&mut self, image: &[u8], table: &[Sums; 256], cells: &mut [Cells; 2], rings: &mut [Ring; 2]) {
        self.cells.accumulate(image, table, cells);
        self.ring.measure(image, table, rings);
        self.lip.measure(image, table, &mut self.lips);
    }

    /// Adds what the rim's inner edge says to the features of the left or the right side, `side` 0 or 1.
    #[inline(always)]
    pub fn mark(&self, side: usize, contrast: &mut Contrast) {
        if let Some(lip) = self.lips.get(side) {
            self.lip.mark(lip, contrast);
        }
    }
}

impl Default for Annulus {
    fn default() -> Self {
        Self::new()
    }
}
