//! What tells two classes apart: one linear discriminant, trained as the paper does or averaged over signal spaces.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Tells two classes apart by one number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Discriminant {
    /// Means of the metric over the training windows of either class.
    pub class_mean: [f64; 2],
    /// Standard deviations of the metric over the training windows of either class.
    pub class_sigma: [f64; 2],
    /// What the weights give for the mean of the training windows.
    pub offset: f64,
    /// Weight of log10 of the speed, relative to a usual one: what speed does to the features is taken out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub speed_weight: f64,
    /// One weight a feature.
    pub weights: Vec<f64>,
}

impl Discriminant {
    /// One that says nothing about windows of `features` features.
    #[must_use]
    pub fn neutral(features: usize) -> Self {
        Self {
            class_mean: [0.0; 2],
            class_sigma: [1.0; 2],
            offset: 0.0,
            speed_weight: 0.0,
            weights: vec![0.0; features],
        }
    }

    /// The metric d of a window's features: nearer to `class_mean[0]` for the first class, to `[1]` for the second.
    #[must_use]
    pub fn metric(&self, features: &[f64], log_speed: f64) -> f64 {
        dot(&self.weights, features) + self.speed_weight * log_speed - self.offset // Eq. (23)
    }

    /// Distances of a metric from the two classes, in their standard deviations.
    #[must_use]
    pub fn distances(&self, metric: f64) -> [f64; 2] {
        [0, 1].map(|side| (metric - self.class_mean[side]).abs() / self.class_sigma[side])
    }

    /// Log odds of the first class, both being normal about their means with the mean of their variances.
    #[must_use]
    pub fn log_odds(&self, metric: f64) -> f64 {
        let variance = (self.class_sigma[0].powi(2) + self.class_sigma[1].powi(2)) / 2.0;
        let middle = (self.class_mean[0] + self.class_mean[1]) / 2.0;
        (metric - middle) * (self.class_mean[0] - self.class_mean[1]) / variance
    }
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// What the paper's training finds for a pair of classes; the [`Discriminant`] is what of it is needed afterwards.
#[derive(Clone, Debug)]
pub struct PairFit {
    /// Mean feature vector of both classes' windows.
    pub mean: DVector<f64>,
    /// Singular values of the mean-free training windows, in falling order.
    pub singular_values: Vec<f64>,
    /// The classifier.
    pub discriminant: Discriminant,
}

/// Trains a pair the paper's way, on the windows of two classes (one column a window) in `components` principal
/// components.
///
/// # Errors
/// Says what is missing: at least two windows of each class, and more windows than components.
pub fn fit_pair(first: &DMatrix<f64>, second: &DMatrix<f64>, components: usize) -> Result<PairFit, String> {
    let counts = [first.ncols(), second.ncols()];
    if counts.iter().any(|count| *count < 2) || counts[0] + counts[1] < components + 2 {
        return Err(format!(
            "{components} components need at least {} windows, two of each class; there are {} and {}",
            components + 2,
            counts[0],
            counts[1]
        ));
    }
    // Eqs. (15), (16): the windows of both classes as the columns of one matrix, its rows made mean-free.
    let mut columns = DMatrix::zeros(first.nrows(), counts[0] + counts[1]);
    columns.columns_mut(0, counts[0]).copy_from(first);
    columns.columns_mut(counts[0], counts[1]).copy_from(second);
    let mean = columns.column_mean();
    for mut column in columns.column_iter_mut() {
        column -= &mean;
    }
    // Eqs. (17)-(19): the signal space, scaled to unit variance.
    let (basis, singular_values) = left_svd(&columns)?;
    let kept = components.min(basis.ncols());
    let mut projection = basis.columns(0, kept).transpose();
    for (mut row, value) in projection.row_iter_mut().zip(&singular_values) {
        if *value <= f64::EPSILON * singular_values[0] {
            return Err(format!("the windows do not span {kept} components"));
        }
        row /= *value;
    }
    let scores = &projection * &columns;
    let direction = second_svd(&scores, counts[0])?;
    let weights: Vec<f64> = projection.tr_mul(&direction).iter().copied().collect();
    let metrics = scores.tr_mul(&direction);
    let (class_mean, class_sigma) = class_moments(metrics.as_slice(), counts[0]);
    let discriminant = Discriminant {
        class_mean,
        class_sigma,
        offset: dot(&weights, mean.as_slice()),
        speed_weight: 0.0,
        weights,
    };
    Ok(PairFit {
        mean,
        singular_values,
        discriminant,
    })
}

/// Left singular vectors and singular values. Where there are more columns than rows, of the triangle that an orthogonal
/// decomposition leaves of them: the same, and sooner.
fn left_svd(columns: &DMatrix<f64>) -> Result<(DMatrix<f64>, Vec<f64>), String> {
    let svd = if columns.ncols() > columns.nrows() {
        columns.transpose().qr().r().transpose().svd(true, false)
    } else {
        columns.clone().svd(true, false)
    };
    let basis = svd.u.ok_or("the singular value decomposition failed")?;
    Ok((basis, svd.singular_values.iter().copied().collect()))
}

/// Eqs. (20)-(22): the difference of the class means, scaled by the inverse of the scatter within the classes.
fn second_svd(scores: &DMatrix<f64>, first: usize) -> Result<DVector<f64>, String> {
    let second = scores.ncols() - first;
    let means = [
        scores.columns(0, first).column_mean(),
        scores.columns(first, second).column_mean(),
    ];
    let mut within = scores.clone();
    for (index, mut column) in within.column_iter_mut().enumerate() {
        column -= &means[usize::from(index >= first)];
    }
    let svd = within.svd(true, false);
    let basis = svd.u.ok_or("the second singular value decomposition failed")?;
    let mut along = basis.tr_mul(&(&means[1] - &means[0]));
    for (value, scale) in along.iter_mut().zip(svd.singular_values.iter()) {
        if *scale <= f64::EPSILON {
            return Err("the windows of a class do not vary".into());
        }
        *value /= scale * scale;
    }
    Ok(basis * along)
}

/// Mean and standard deviation of the first `first` metrics and of the rest.
fn class_moments(metrics: &[f64], first: usize) -> ([f64; 2], [f64; 2]) {
    let moments = [&metrics[..first], &metrics[first..]].map(|side| {
        let mean = side.iter().sum::<f64>() / side.len() as f64;
        let sum: f64 = side.iter().map(|metric| (metric - mean).powi(2)).sum();
        (mean, (sum / (side.len() as f64 - 1.0)).sqrt())
    });
    ([moments[0].0, moments[1].0], [moments[0].1, moments[1].1])
}

/// Mean and covariance of a class's windows.
#[derive(Clone, Debug)]
pub struct Moments {
    /// Mean.
    pub mean: DVector<f64>,
    /// Covariance.
    pub covariance: DMatrix<f64>,
}

/// The pair's discriminants in its first k principal components, for several k: directions of unit standard deviation
/// within the classes. Their mean is a discriminant that no single k decides on.
#[derive(Clone, Debug)]
pub struct Directions {
    /// The number of components, and the direction.
    pub of_components: Vec<(usize, DVector<f64>)>,
}

impl Directions {
    /// For classes of the given moments; numbers of components beyond what the windows span are left out.
    #[must_use]
    pub fn new(first: &Moments, second: &Moments, components: &[usize]) -> Self {
        let apart = &second.mean - &first.mean;
        let within = (&first.covariance + &second.covariance) / 2.0;
        let total = &within + &apart * apart.transpose() / 4.0;
        let (basis, spanned) = whitening(total, components.iter().copied().max().unwrap_or(0));
        let mut scatter = basis.tr_mul(&(&within * &basis));
        for index in 0..spanned {
            scatter[(index, index)] += RIDGE;
        }
        let along = basis.tr_mul(&apart);
        let Some(factor) = scatter.cholesky().map(Cholesky::unpack) else {
            return Self {
                of_components: Vec::new(),
            };
        };
        let Some(forward) = factor.solve_lower_triangular(&along) else {
            return Self {
                of_components: Vec::new(),
            };
        };
        let direction = |count: usize| {
            // The leading block of the factor is the factor of the leading block.
            let block = factor.view((0, 0), (count, count));
            let solution = block.tr_solve_lower_triangular(&forward.rows(0, count))?;
            let sigma = forward.rows(0, count).norm();
            (sigma > 0.0).then(|| (count, basis.columns(0, count) * solution / sigma))
        };
        let of_components = components
            .iter()
            .filter(|count| **count <= spanned)
            .filter_map(|count| direction(*count))
            .collect();
        Self { of_components }
    }

    /// The discriminant along the mean of the directions with the given numbers of components; neutral where there are
    /// none of them.
    #[must_use]
    pub fn mean(&self, components: &[usize], first: &Moments, second: &Moments) -> Discriminant {
        let mut weights = DVector::zeros(first.mean.len());
        let chosen = self
            .of_components
            .iter()
            .filter(|(count, _)| components.contains(count));
        for (_, direction) in chosen {
            weights += direction;
        }
        let length = weights.norm();
        if length == 0.0 {
            return Discriminant::neutral(first.mean.len());
        }
        let sigma = |side: &Moments| {
            (weights.dot(&(&side.covariance * &weights)))
                .max(f64::MIN_POSITIVE)
                .sqrt()
        };
        let sigmas = [sigma(first), sigma(second)];
        let scale = 1.0 / ((sigmas[0].powi(2) + sigmas[1].powi(2)) / 2.0).sqrt();
        weights *= scale;
        Discriminant {
            class_mean: [weights.dot(&first.mean), weights.dot(&second.mean)],
            class_sigma: sigmas.map(|value| value * scale),
            offset: 0.0,
            speed_weight: 0.0,
            weights: weights.iter().copied().collect(),
        }
    }
}

/// Added to the unit total variance of each component, against classes that do not vary along one.
const RIDGE: f64 = 1e-6;

/// The first principal axes of a covariance, at most `most`, each divided by its standard deviation; and how many there are.
fn whitening(covariance: DMatrix<f64>, most: usize) -> (DMatrix<f64>, usize) {
    let (values, vectors) = principal_axes(covariance);
    let floor = values.first().copied().unwrap_or(0.0) * 1e-12;
    let spanned = values.iter().take_while(|value| **value > floor).count().min(most);
    let mut basis = vectors.columns(0, spanned).into_owned();
    for (mut column, value) in basis.column_iter_mut().zip(&values) {
        column /= value.sqrt();
    }
    (basis, spanned)
}

/// Eigenvalues of a covariance in falling order, and its eigenvectors in the columns.
#[must_use]
pub fn principal_axes(covariance: DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let eigen = covariance.symmetric_eigen();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let values = order.iter().map(|index| eigen.eigenvalues[*index]).collect();
    (values, eigen.eigenvectors.select_columns(&order))
}

/// The scalar product of two vectors of the same length.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    // Four sums at a time: the processor adds them at once.
    let (a, b) = (&a[..a.len().min(b.len())], &b[..a.len().min(b.len())]);
    let mut sums = [0.0; 4];
    for (x, y) in a.chunks_exact(4).zip(b.chunks_exact(4)) {
        for (sum, (x, y)) in sums.iter_mut().zip(x.iter().zip(y)) {
            *sum += x * y;
        }
    }
    let rest = a.chunks_exact(4).remainder().iter().zip(b.chunks_exact(4).remainder());
    sums.iter().sum::<f64>() + rest.map(|(x, y)| x * y).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_spheres_are_told_apart_along_the_line_between_them() {
        let first = Moments {
            mean: DVector::from_vec(vec![1.0, 2.0, 0.0]),
            covariance: DMatrix::identity(3, 3),
        };
        let second = Moments {
            mean: DVector::from_vec(vec![4.0, -2.0, 0.0]),
            covariance: DMatrix::identity(3, 3),
        };
        let directions = Directions::new(&first, &second, &[1, 3]);
        let pair = directions.mean(&[1, 3], &first, &second);
        for (found, expected) in pair.weights.iter().zip([0.6, -0.8, 0.0]) {
            assert!((found - expected).abs() < 1e-9, "{:?}", pair.weights);
        }
        assert!((pair.class_mean[1] - pair.class_mean[0] - 5.0).abs() < 1e-9);
        assert!((pair.class_sigma[0] - 1.0).abs() < 1e-9);
        // Halfway the odds are even; a standard deviation from there they are exp(5).
        let middle = (pair.class_mean[0] + pair.class_mean[1]) / 2.0;
        assert!(pair.log_odds(middle).abs() < 1e-9 && (pair.log_odds(middle - 1.0) - 5.0).abs() < 1e-9);
    }

    #[test]
    fn wide_and_tall_windows_have_the_same_left_vectors() {
        let tall = DMatrix::from_fn(7, 4, |a, b| ((a * 5 + b * 3) % 7) as f64 + (b * b) as f64);
        let wide = tall.transpose();
        let ((basis, values), direct) = (left_svd(&wide).unwrap(), wide.clone().svd(true, false));
        let expected = direct.u.unwrap();
        for (index, value) in values.iter().enumerate().take(4) {
            assert!((value - direct.singular_values[index]).abs() < 1e-10);
            let aligned = basis.column(index).dot(&expected.column(index)).abs();
            assert!((aligned - 1.0).abs() < 1e-10);
        }
    }

    #[test]
    fn the_product_is_the_sum_of_the_products() {
        let a: Vec<f64> = (0..11).map(f64::from).collect();
        assert!((dot(&a, &a) - 385.0).abs() < 1e-12);
    }
}
