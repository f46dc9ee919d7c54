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
/// Rows from the first to the last of those whose filtered values are compared.
const APART: usize = 4;
/// Rows around the largest change that are the same change.
const SAME: usize = 10;
/// Filtered pixel count below which a row says nothing.
const COUNT_MIN: f64 = 3.0;
/// Gray values below which a change is no contrast.
const CONTRAST_MIN: f64 = 2.0;
/// What remains of the error where the interface is clear, in wheel radii: the root mean square over the rendered
/// traverses in clear light. It is that of the wheel's centre and of soil lines that are no rows.
const SIGMA_MIN: f64 = 0.015;

/// Where the soil meets one side of the rim.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interface {
    /// Height below the wheel's centre, in outer radii: the cosine of the angle from straight down.
    pub cosine: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// How far the largest change stands out from the second: 0.5 where they are equal, to 1. It does not know of
    /// edges that are no soil: in hard shadows it is too high.
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
        let confidence = 1.0 / (1.0 + (second / change).powi(4));
        // The spread about the larger of two candidates, where the smaller is right with 1 - confidence.
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
        // The two lie evenly about the edge between rows k - 1 and k.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums and counts without order, among them rows without pixels.
    fn side() -> Side {
        let mut side = Side::EMPTY;
        for k in 0..ROWS {
            side.counts[k] = ((k * 37) % 23) as f64;
            side.sums[k] = side.counts[k] * ((k * 91) % 199) as f64;
        }
        side
    }

    /// The binomial filter as what it is: eight times the mean of two neighbours.
    fn eight_means_of_two(values: &[f64; ROWS]) -> Vec<f64> {
        let mut wide = vec![0.0; 8];
        wide.extend_from_slice(values);
        wide.resize(ROWS + 16, 0.0);
        for _ in 0..8 {
            wide = wide.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
        }
        wide[4..ROWS + 4].to_vec()
    }

    #[test]
    fn the_filter_is_binomial_and_weighted_by_pixel_count() {
        let side = side();
        let (sums, counts) = (eight_means_of_two(&side.sums), eight_means_of_two(&side.counts));
        for (k, filtered) in filter(&side).into_iter().enumerate() {
            if counts[k] > COUNT_MIN {
                assert!((filtered - sums[k] / counts[k]).abs() < 1e-9, "row {k}: {filtered}");
            } else {
                assert!(filtered.is_nan(), "row {k}: {filtered}");
            }
        }
    }

    #[test]
    fn a_side_without_pixels_or_contrast_has_no_interface() {
        assert_eq!(Interface::find(&Side::EMPTY), None);
        assert_eq!(
            Interface::find(&Side {
                sums: [700.0; ROWS],
                counts: [7.0; ROWS]
            }),
            None
        );
        assert_eq!(
            Interface::find(&Side {
                sums: [f64::NAN; ROWS],
                counts: [7.0; ROWS]
            }),
            None
        );
    }

    #[test]
    fn a_step_is_found_at_its_edge() {
        for edge in 20..ROWS - 20 {
            let sums = std::array::from_fn(|k| if k < edge { 2000.0 } else { 900.0 });
            let interface = Interface::find(&Side {
                sums,
                counts: [10.0; ROWS],
            })
            .unwrap();
            assert!(
                (interface.cosine - edge as f64 / ROWS as f64).abs() < 1e-9,
                "{edge}: {interface:?}"
            );
            assert!(interface.confidence > 0.999);
        }
    }
}
