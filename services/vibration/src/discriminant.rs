//! The paper's pair classifier, Eqs. (15)-(23): principal components, a second SVD, one metric.

use nalgebra::{DMatrix, DVector};
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
    /// One weight a feature.
    pub weights: Vec<f64>,
}

impl Discriminant {
    /// The metric d of a window's features: low for the first class, high for the second.
    #[must_use]
    pub fn metric(&self, features: &[f64]) -> f64 {
        dot(&self.weights, features) - self.offset // Eq. (23)
    }

    /// Distances of a metric from the two classes, in their standard deviations.
    #[must_use]
    pub fn distances(&self, metric: f64) -> [f64; 2] {
        [0, 1].map(|side| (metric - self.class_mean[side]).abs() / self.class_sigma[side])
    }
}

/// What training finds for a pair of classes; the [`Discriminant`] is what of it is needed afterwards.
#[derive(Clone, Debug)]
pub struct PairFit {
    /// Mean feature vector of both classes' windows.
    pub mean: DVector<f64>,
    /// Singular values of the mean-free training windows, in falling order.
    pub singular_values: Vec<f64>,
    /// The classifier.
    pub discriminant: Discriminant,
}

/// Trains a pair on the windows of two classes (one row a window) in `components` principal components.
///
/// # Errors
/// Says what is missing: at least two windows of each class, and more windows than components.
pub fn fit_pair(first: &DMatrix<f64>, second: &DMatrix<f64>, components: usize) -> Result<PairFit, String> {
    let counts = [first.nrows(), second.nrows()];
    if counts.iter().any(|count| *count < 2) || counts[0] + counts[1] < components + 2 {
        return Err(format!(
            "{components} components need at least {} windows, two of each class; there are {} and {}",
            components + 2,
            counts[0],
            counts[1]
        ));
    }
    // Eqs. (15), (16): the windows of both classes as the columns of one matrix, its rows made mean-free.
    let mut columns = DMatrix::zeros(first.ncols(), counts[0] + counts[1]);
    columns.columns_mut(0, counts[0]).copy_from(&first.transpose());
    columns.columns_mut(counts[0], counts[1]).copy_from(&second.transpose());
    let mean = columns.column_mean();
    for mut column in columns.column_iter_mut() {
        column -= &mean;
    }
    // Eqs. (17)-(19): the signal space, scaled to unit variance.
    let svd = columns.clone().svd(true, false);
    let singular_values: Vec<f64> = svd.singular_values.iter().copied().collect();
    let basis = svd.u.ok_or("the singular value decomposition failed")?;
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
        weights,
    };
    Ok(PairFit {
        mean,
        singular_values,
        discriminant,
    })
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

/// The scalar product of two vectors of the same length.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}
