//! How good decisions are: confusion, balanced accuracy, unknowns, calibration.

use crate::decision::PerClass;

/// A decision on a window whose class is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scored {
    /// The true class.
    pub truth: usize,
    /// The chosen class.
    pub class: usize,
    /// True where it was rejected.
    pub unknown: bool,
    /// Probability of each class.
    pub probability: PerClass,
}

/// Counts of windows: truth in the rows; the chosen classes in the columns, the last one for the unknown.
#[must_use]
pub fn confusion(scored: &[Scored], classes: usize) -> Vec<Vec<usize>> {
    let mut counts = vec![vec![0; classes + 1]; classes];
    for window in scored {
        let column = if window.unknown { classes } else { window.class };
        counts[window.truth][column] += 1;
    }
    counts
}

/// Mean over the classes that occur of the share of windows for which `of` holds.
#[must_use]
pub fn balanced(scored: &[Scored], classes: usize, of: impl Fn(&Scored) -> bool) -> f64 {
    let (mut sum, mut occurring) = (0.0, 0.0);
    for class in 0..classes {
        let all = scored.iter().filter(|window| window.truth == class);
        let (hits, count) = all.fold((0.0, 0.0), |(hits, count), window| {
            (hits + f64::from(u8::from(of(window))), count + 1.0)
        });
        if count > 0.0 {
            sum += hits / count;
            occurring += 1.0;
        }
    }
    sum / f64::max(occurring, 1.0)
}

/// Balanced accuracy: mean recall over the classes, rejected or not.
#[must_use]
pub fn balanced_accuracy(scored: &[Scored], classes: usize) -> f64 {
    balanced(scored, classes, |window| window.class == window.truth)
}

/// Expected calibration error: how far the highest probability is from the share of right decisions, over ten bins of
/// equal width.
#[must_use]
pub fn calibration_error(scored: &[Scored]) -> f64 {
    let mut bins = [(0.0, 0.0); 10];
    for window in scored {
        let confidence = window.probability[window.class];
        let bin = &mut bins[((confidence * 10.0) as usize).min(9)];
        bin.0 += confidence;
        bin.1 += f64::from(u8::from(window.class == window.truth));
    }
    let sum: f64 = bins.iter().map(|(confidence, right)| (confidence - right).abs()).sum();
    sum / scored.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(truth: usize, class: usize, confidence: f64) -> Scored {
        let mut probability = [0.0; messages::CLASSES_MAX];
        probability[class] = confidence;
        Scored {
            truth,
            class,
            unknown: confidence < 0.4,
            probability,
        }
    }

    #[test]
    fn rare_classes_count_as_much_as_frequent_ones() {
        let scored = [
            window(0, 0, 0.9),
            window(0, 0, 0.9),
            window(0, 0, 0.9),
            window(1, 0, 0.9),
        ];
        assert_eq!(balanced_accuracy(&scored, 2), 0.5);
        assert_eq!(balanced_accuracy(&scored, 3), 0.5);
        assert_eq!(confusion(&scored, 2), [[3, 0, 0], [1, 0, 0]]);
    }

    #[test]
    fn calibration_is_confidence_against_the_share_of_right_decisions() {
        let scored = [window(0, 0, 0.75), window(0, 1, 0.75), window(1, 1, 0.35)];
        let expected = ((1.5 - 1.0_f64).abs() + (0.35 - 1.0_f64).abs()) / 3.0;
        assert!((calibration_error(&scored) - expected).abs() < 1e-12);
        assert_eq!(confusion(&scored, 2), [[1, 1, 0], [0, 0, 1]]);
    }
}
