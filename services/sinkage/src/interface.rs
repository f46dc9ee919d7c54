//! The wheel-terrain interface: the row at which the filtered mean intensity of the rim changes the most.
//!
//! §2 of Iagnemma, Brooks and Dubowsky, "Visual, Tactile, and Vibration-Based Terrain Analysis for Planetary Rovers",
//! IEEE Aerospace 2004.

use crate::rows::{ROWS, Side};

/// Weights of the binomial filter, one row of Pascal's triangle; its standard deviation is √8 / 2 rows.
const BINOMIAL: [f64; 9] = [1.0, 8.0, 28.0, 56.0, 70.0, 56.0, 28.0, 8.0, 1.0];
const HALF: usize = BINOMIAL.len() / 2;
/// Sum of [`BINOMIAL`].
const BINOMIAL_SUM: f64 = 256.0;
/// Rows between the two filtered values whose difference is the change.
const APART: usize = 4;
/// Rows around the largest change that are the same change.
const SAME: usize = 10;
/// Filtered pixel count below which a row says nothing.
const COUNT_MIN: f64 = 3.0;
/// Gray values below which a change is no contrast.
const CONTRAST_MIN: f64 = 2.0;
/// What remains of the error where the interface is clear, in wheel radii: of the wheel's centre and of the relief.
const SIGMA_MIN: f64 = 0.005;

/// Where the soil meets one side of the rim.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interface {
    /// Height below the wheel's centre, in outer radii: the cosine of the angle from straight down.
    pub cosine: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// Share of the largest change in the power of the two largest, 0.5 to 1.
    pub confidence: f64,
}

impl Interface {
    /// The row of the largest change; `None` where no row differs from its neighbours.
    #[must_use]
    pub fn find(side: &Side) -> Option<Self> {
        let changes = changes(side);
        let (peak, change) = largest(&changes, |_| true)?;
        if change < CONTRAST_MIN {
            return None;
        }
        let (other, second) = largest(&changes, |k| k.abs_diff(peak) > SAME).unwrap_or((peak, 0.0));
        let cosine = position(&changes, peak);
        // A peak of the filtered step moves by about its width times noise over height.
        let noise = spread(&changes, peak) / change;
        let sigma = (APART as f64 / ROWS as f64 * noise).hypot(SIGMA_MIN);
        let ratio = (second / change).powi(4);
        let confidence = 1.0 / (1.0 + ratio);
        // The variance about the larger of two candidates, the smaller being right with 1 - confidence.
        let apart = (other as f64 - peak as f64) / ROWS as f64;
        let sigma = sigma.hypot((1.0 - confidence).sqrt() * apart);
        Some(Self {
            cosine,
            sigma,
            confidence,
        })
    }
}

/// Change of the filtered intensity across the upper edge of each row, NaN where too few pixels lie above or below it.
fn changes(side: &Side) -> [f64; ROWS] {
    let filtered = filter(side);
    let mut changes = [f64::NAN; ROWS];
    for k in APART / 2..ROWS - APART / 2 {
        // Row k - 1/2 is the edge; APART rows about it.
        changes[k] = (filtered[k + APART / 2 - 1] - filtered[k - APART / 2]).abs();
    }
    changes
}

/// The binomial filter over the rows' mean intensities, weighted by their pixel counts; NaN where they are too few.
#[must_use]
pub fn filter(side: &Side) -> [f64; ROWS] {
    std::array::from_fn(|k| {
        let (mut sum, mut count) = (0.0, 0.0);
        for (j, weight) in BINOMIAL.iter().enumerate() {
            let row = (k + j).wrapping_sub(HALF);
            if row < ROWS {
                sum += weight * side.sums[row];
                count += weight * side.counts[row];
            }
        }
        if count < COUNT_MIN * BINOMIAL_SUM {
            f64::NAN
        } else {
            sum / count
        }
    })
}

/// The largest of the rows that `of` names, and where; NaN is none.
fn largest(changes: &[f64; ROWS], of: impl Fn(usize) -> bool) -> Option<(usize, f64)> {
    let known = changes
        .iter()
        .copied()
        .enumerate()
        .filter(|&(k, change)| change >= 0.0 && of(k));
    known.max_by(|a, b| a.1.total_cmp(&b.1))
}

/// The peak between rows, by the parabola through it and its neighbours, as a height in radii.
fn position(changes: &[f64; ROWS], peak: usize) -> f64 {
    let at = |k: usize| changes.get(k).copied().unwrap_or(f64::NAN);
    let (before, here, after) = (at(peak.wrapping_sub(1)), at(peak), at(peak + 1));
    let shift = 0.5 * (before - after) / (before - 2.0 * here + after);
    let shift = if shift.abs() <= 0.5 { shift } else { 0.0 };
    (peak as f64 + shift) / ROWS as f64
}

/// Root mean square of the changes away from the peak.
fn spread(changes: &[f64; ROWS], peak: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0_f64);
    for (k, change) in changes.iter().enumerate() {
        if change.is_finite() && k.abs_diff(peak) > SAME {
            sum += change * change;
            count += 1.0;
        }
    }
    (sum / count.max(1.0)).sqrt()
}
