//! What an answer rests on, to be drawn: intensity and score against angle, on either side. Figure 3 of the paper.

use crate::annulus::Annulus;
use crate::cells::{self, Cells};
use crate::center::Shift;
use crate::contrast::Contrast;
use crate::posterior::{BINS, Posterior};
use crate::rim::Rim;
use crate::rows::{self, ROWS, Side};
use crate::weights::Weights;
use messages::Frame;

/// One side of one picture: points of (angle from straight down, value), by falling angle.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Mean gray value of each row of the rim in the picture filtered by a 3x3 Gaussian, against the angle at which the row
    /// meets the outer circle. Rows without pixels are left out.
    pub intensity: Vec<(f64, f64)>,
    /// Probability that the soil begins about there, from this picture and this side alone.
    pub score: Vec<(f64, f64)>,
}

/// Left and right profile of a frame; `None` where its geometry shows no rim. Allocates: not for every frame.
#[must_use]
pub fn profiles(frame: &Frame) -> Option<[Profile; 2]> {
    let image = frame.image();
    if image.is_empty() {
        return None;
    }
    let width = (frame.width as usize).clamp(1, image.len());
    let height = image.len() / width;
    let rim = Rim::locate(frame, width, height).ok()?;
    let mut sides = [Side::EMPTY; 2];
    rows::accumulate(&gaussian(image, width), width, &rim, &mut sides);

    let shift = Shift::find(image, width, frame).unwrap_or(Shift::NONE);
    let mut annulus = Annulus::new();
    annulus.follow(&rim, shift, width, height);
    let (mut cells, mut rings) = ([Cells::EMPTY; 2], [[0.0; ROWS]; 2]);
    annulus.measure(image, &cells::log_table(), &mut cells, &mut rings);
    let (mut contrast, weights) = (Contrast::new(), Weights::fitted());
    Some([0, 1].map(|side| {
        contrast.measure(&cells[side], &rings[side]);
        annulus.mark(side, &mut contrast);
        Profile {
            intensity: intensity(&sides[side]),
            score: score(&Posterior::new(&contrast, &weights)),
        }
    }))
}

fn intensity(side: &Side) -> Vec<(f64, f64)> {
    let rows = side.sums.iter().zip(&side.counts).enumerate();
    rows.filter(|(_, (_, count))| **count > 0.0)
        .map(|(row, (sum, count))| (angle_rad(row, ROWS), sum / count))
        .collect()
}

fn score(posterior: &Posterior) -> Vec<(f64, f64)> {
    let height = |bin: usize| (bin as f32 + 0.5) / BINS as f32;
    (0..BINS)
        .map(|bin| (angle_rad(bin, BINS), f64::from(posterior.near(height(bin)))))
        .collect()
}

/// The angle at which the middle of one of `count` equal steps of height meets the outer circle.
fn angle_rad(step: usize, count: usize) -> f64 {
    ((step as f64 + 0.5) / count as f64).acos()
}

/// The picture filtered by a 3x3 Gaussian; its edges are repeated.
fn gaussian(image: &[u8], width: usize) -> Vec<u8> {
    let height = image.len() / width;
    let at = |row: usize, column: usize| u32::from(image[row.min(height - 1) * width + column.min(width - 1)]);
    let line =
        |row: usize, column: usize| at(row, column.saturating_sub(1)) + 2 * at(row, column) + at(row, column + 1);
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (row, column)));
    pixels
        .map(|(row, column)| {
            let sum = line(row.saturating_sub(1), column) + 2 * line(row, column) + line(row + 1, column);
            ((sum + 8) / 16) as u8
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_filter_spreads_a_point_and_keeps_an_even_picture() {
        let mut image = [0; 25];
        image[12] = 160;
        let filtered = gaussian(&image, 5);
        assert_eq!(filtered[6..9], [10, 20, 10]);
        assert_eq!(filtered[11..14], [20, 40, 20]);
        assert_eq!(gaussian(&[77; 12], 4), [77; 12]);
        assert_eq!(gaussian(&[5], 1), [5]);
    }
}
