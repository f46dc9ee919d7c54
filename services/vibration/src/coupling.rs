//! Class probabilities from pairwise ones: the second method of Wu, Lin and Weng, JMLR 5 (2004).

use messages::CLASSES_MAX;

/// Pairwise probabilities are kept this far from 0 and 1.
const MARGIN: f64 = 1e-9;
/// Unknowns of the linear system: the probabilities, and the multiplier of their sum.
const UNKNOWNS_MAX: usize = CLASSES_MAX + 1;

/// One number for each ordered pair of classes.
pub type PairTable = [[f64; CLASSES_MAX]; CLASSES_MAX];

/// Finds the probabilities p of the first `classes` classes that agree best with the pairwise ones r: those that
/// minimise the sum over all pairs of `(r[b][a] p[a] - r[a][b] p[b])²`, where `r[a][b] = 1 - r[b][a]`. The rest stays 0.
#[must_use]
pub fn couple(pairwise: &PairTable, classes: usize) -> [f64; CLASSES_MAX] {
    let classes = classes.min(CLASSES_MAX);
    let r = |a: usize, b: usize| pairwise[a][b].clamp(MARGIN, 1.0 - MARGIN);
    // The optimum is where Q p + m 1 = 0 and the sum of p is 1.
    let mut system = [[0.0; UNKNOWNS_MAX + 1]; UNKNOWNS_MAX];
    for (a, row) in system.iter_mut().enumerate().take(classes) {
        for b in (0..classes).filter(|b| *b != a) {
            row[a] += r(b, a).powi(2);
            row[b] = -r(b, a) * r(a, b);
        }
        row[classes] = 1.0;
    }
    system[classes][..classes].fill(1.0);
    system[classes][classes + 1] = 1.0;
    let solution = solve(&mut system, classes + 1);
    let mut p: [f64; CLASSES_MAX] = std::array::from_fn(|a| if a < classes { solution[a].max(0.0) } else { 0.0 });
    let sum: f64 = p.iter().sum();
    if sum.is_finite() && sum > 0.0 {
        p.iter_mut().for_each(|value| *value /= sum);
    } else {
        p[..classes].fill(1.0 / classes.max(1) as f64);
    }
    p
}

/// Gauss's elimination with pivots, of the first `size` equations; the right-hand side is column `size`.
fn solve(system: &mut [[f64; UNKNOWNS_MAX + 1]; UNKNOWNS_MAX], size: usize) -> [f64; UNKNOWNS_MAX] {
    for column in 0..size {
        let pivot = (column..size).fold(column, |best, row| {
            if system[row][column].abs() > system[best][column].abs() {
                row
            } else {
                best
            }
        });
        system.swap(column, pivot);
        let above = system[column];
        for row in system.iter_mut().take(size).skip(column + 1) {
            let factor = row[column] / above[column];
            for (value, upper) in row.iter_mut().zip(&above).take(size + 1).skip(column) {
                *value -= factor * upper;
            }
        }
    }
    let mut solution = [0.0; UNKNOWNS_MAX];
    for row in (0..size).rev() {
        let known: f64 = (row + 1..size)
            .map(|column| system[row][column] * solution[column])
            .sum();
        solution[row] = (system[row][size] - known) / system[row][row];
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairwise_probabilities_that_agree_give_the_classes_probabilities_back() {
        let truth = [0.5, 0.3, 0.15, 0.05];
        let mut pairwise = [[0.0; CLASSES_MAX]; CLASSES_MAX];
        for (a, pa) in truth.iter().enumerate() {
            for (b, pb) in truth.iter().enumerate() {
                pairwise[a][b] = pa / (pa + pb);
            }
        }
        let found = couple(&pairwise, 4);
        for (p, expected) in found.iter().zip(truth) {
            assert!((p - expected).abs() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn no_other_probabilities_agree_better() {
        let mut pairwise = [[0.0; CLASSES_MAX]; CLASSES_MAX];
        for (a, b, r) in [(0, 1, 0.9), (0, 2, 0.4), (1, 2, 0.7)] {
            (pairwise[a][b], pairwise[b][a]) = (r, 1.0 - r);
        }
        let cost = |p: &[f64]| -> f64 {
            let term = |a: usize, b: usize| (pairwise[b][a] * p[a] - pairwise[a][b] * p[b]).powi(2);
            term(0, 1) + term(0, 2) + term(1, 2)
        };
        let found = couple(&pairwise, 3);
        for step in [[1e-3, -1e-3, 0.0], [0.0, 1e-3, -1e-3], [-1e-3, 0.0, 1e-3]] {
            for sign in [1.0, -1.0] {
                let moved: Vec<f64> = (0..3).map(|a| found[a] + sign * step[a]).collect();
                assert!(cost(&moved) > cost(&found));
            }
        }
    }

    #[test]
    fn two_classes_are_their_own_pair() {
        let mut pairwise = [[0.0; CLASSES_MAX]; CLASSES_MAX];
        (pairwise[0][1], pairwise[1][0]) = (0.8, 0.2);
        let found = couple(&pairwise, 2);
        assert!((found[0] - 0.8).abs() < 1e-9 && (found[1] - 0.2).abs() < 1e-9);
    }

    #[test]
    fn contradicting_certainties_give_finite_probabilities() {
        let mut pairwise = [[0.0; CLASSES_MAX]; CLASSES_MAX];
        (pairwise[0][1], pairwise[1][2], pairwise[2][0]) = (1.0, 1.0, 1.0);
        for classes in [0, 1, 3, CLASSES_MAX] {
            let found = couple(&pairwise, classes);
            assert!(found.iter().all(|p| p.is_finite() && *p >= 0.0));
            assert!(classes == 0 || (found.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        }
    }
}
