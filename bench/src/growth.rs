//! How a cost grows with a size.

/// The exponent e of cost ∝ size^e: slope of the logarithms, by least squares. `None` where there are not two sizes.
#[must_use]
pub fn exponent(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> = points.iter().map(|(size, cost)| (size.ln(), cost.ln())).collect();
    let mean = |of: fn(&(f64, f64)) -> f64| logs.iter().map(of).sum::<f64>() / logs.len() as f64;
    let (x, y) = (mean(|log| log.0), mean(|log| log.1));
    let spread: f64 = logs.iter().map(|log| (log.0 - x) * (log.0 - x)).sum();
    let common: f64 = logs.iter().map(|log| (log.0 - x) * (log.1 - y)).sum();
    (spread > 0.0).then(|| common / spread)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponent_of_a_power_is_found() {
        for expected in [-0.5, 0.0, 1.0, 2.0] {
            let points: Vec<(f64, f64)> = [1.0, 2.0, 4.0, 6.0]
                .map(|size: f64| (size, 3.0 * size.powf(expected)))
                .into();
            assert!((exponent(&points).unwrap() - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn one_size_has_no_growth() {
        assert_eq!(exponent(&[]), None);
        assert_eq!(exponent(&[(2.0, 1.0), (2.0, 3.0)]), None);
    }
}
