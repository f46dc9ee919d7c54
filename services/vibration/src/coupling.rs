//! Class probabilities from pairwise ones: the second method of Wu, Lin and Weng, JMLR 5 (2004).

use messages::CLASSES_MAX;

/// Sweeps over the classes at the most.
const SWEEPS_MAX: usize = 100;
/// Pairwise probabilities are kept this far from 0 and 1.
const MARGIN: f64 = 1e-9;

/// Probability of the first class against the second, for all pairs.
pub type PairTable = [[f64; CLASSES_MAX]; CLASSES_MAX];

/// Finds the probabilities p of the first `classes` classes that agree best with the pairwise ones r: those that
/// minimise the sum over all pairs of `(r[b][a] p[a] - r[a][b] p[b])²`, where `r[a][b] = 1 - r[b][a]`. The rest stays 0.
#[must_use]
pub fn couple(pairwise: &PairTable, classes: usize) -> [f64; CLASSES_MAX] {
    let classes = classes.min(CLASSES_MAX);
    let r = |a: usize, b: usize| pairwise[a][b].clamp(MARGIN, 1.0 - MARGIN);
    let mut q: PairTable = [[0.0; CLASSES_MAX]; CLASSES_MAX];
    for (a, row) in q.iter_mut().enumerate().take(classes) {
        for b in (0..classes).filter(|b| *b != a) {
            row[a] += r(b, a).powi(2);
            row[b] = -r(b, a) * r(a, b);
        }
    }
    let mut p = [0.0; CLASSES_MAX];
    p[..classes].fill(1.0 / classes.max(1) as f64);
    for _ in 0..SWEEPS_MAX {
        let mut change = 0.0_f64;
        for a in 0..classes {
            let row = |t: usize| (0..classes).map(|b| q[t][b] * p[b]).sum::<f64>();
            let total: f64 = (0..classes).map(|t| p[t] * row(t)).sum();
            let step = (total - row(a)) / q[a][a].max(f64::MIN_POSITIVE);
            p[a] = (p[a] + step).max(0.0);
            let sum: f64 = p[..classes].iter().sum();
            p[..classes]
                .iter_mut()
                .for_each(|value| *value /= sum.max(f64::MIN_POSITIVE));
            change = change.max(step.abs());
        }
        if change < 1e-9 {
            break;
        }
    }
    p
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
            assert!((p - expected).abs() < 1e-6, "{found:?}");
        }
    }

    #[test]
    fn two_classes_are_their_own_pair() {
        let mut pairwise = [[0.0; CLASSES_MAX]; CLASSES_MAX];
        (pairwise[0][1], pairwise[1][0]) = (0.8, 0.2);
        let found = couple(&pairwise, 2);
        assert!((found[0] - 0.8).abs() < 1e-6 && (found[1] - 0.2).abs() < 1e-6);
    }

    #[test]
    fn contradicting_certainties_give_finite_probabilities() {
        let mut pairwise = [[0.0; CLASSES_MAX]; CLASSES_MAX];
        (pairwise[0][1], pairwise[1][2], pairwise[2][0]) = (1.0, 1.0, 1.0);
        let found = couple(&pairwise, 3);
        assert!(found.iter().all(|p| p.is_finite()) && (found.iter().sum::<f64>() - 1.0).abs() < 1e-9);
    }
}
