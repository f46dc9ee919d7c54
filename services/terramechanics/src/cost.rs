//! What rows say of the parameters, as a quadratic cost, and the parameters that follow.

use crate::model::{LIMITS, Limit};
use crate::stresses::{PARAMETERS, Parameters};
use nalgebra::{SMatrix, SVector};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

pub(crate) type Matrix = SMatrix<f64, PARAMETERS, PARAMETERS>;
pub(crate) type Vector = SVector<f64, PARAMETERS>;

/// A quadratic cost of the parameters p: constant − 2 vectorᵀ p + pᵀ matrix p, from so many rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct Cost {
    pub(crate) matrix: [[f64; PARAMETERS]; PARAMETERS],
    pub(crate) vector: Parameters,
    pub(crate) constant: f64,
    pub(crate) rows: f64,
}

/// The parameters and their covariance.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct Posterior {
    pub(crate) parameters: Parameters,
    pub(crate) covariance: [[f64; PARAMETERS]; PARAMETERS],
}

impl Posterior {
    /// Moves towards the least cost, by bounded steps and within the limits; where the least cost within the limits is.
    ///
    /// `None`, and nothing changes, where the cost has no least value.
    pub(crate) fn descend(&mut self, cost: &Cost) -> Option<Vector> {
        let cholesky = Matrix::from(cost.matrix).cholesky()?;
        let mut best = cholesky.solve(&Vector::from(cost.vector));
        let covariance = cholesky.inverse();
        let mut free = covariance;
        for (index, Limit { low, high, .. }) in LIMITS.into_iter().enumerate() {
            let excess = best[index] - best[index].clamp(low, high);
            if excess != 0.0 && free[(index, index)] > 0.0 {
                // The best solution with this parameter at its limit.
                let column: Vector = free.column(index) / free[(index, index)];
                best -= column * excess;
                free -= column * column.transpose() * free[(index, index)];
            }
        }
        self.covariance = covariance.into();
        for (index, Limit { step, low, high }) in LIMITS.into_iter().enumerate() {
            let change = (best[index] - self.parameters[index]).clamp(-step, step);
            self.parameters[index] = (self.parameters[index] + change).clamp(low, high);
        }
        Some(best)
    }
}

impl Cost {
    pub(crate) fn add(&mut self, other: &Self) {
        for (row, other) in self.matrix.iter_mut().zip(&other.matrix) {
            for (value, other) in row.iter_mut().zip(other) {
                *value += other;
            }
        }
        for (value, other) in self.vector.iter_mut().zip(&other.vector) {
            *value += other;
        }
        self.constant += other.constant;
        self.rows += other.rows;
    }

    pub(crate) fn scaled(mut self, by: f64) -> Self {
        self.matrix.as_flattened_mut().iter_mut().for_each(|value| *value *= by);
        self.vector.iter_mut().for_each(|value| *value *= by);
        self.constant *= by;
        self.rows *= by;
        self
    }

    /// The cost at these parameters.
    pub(crate) fn at(&self, parameters: &Vector) -> f64 {
        let matrix = Matrix::from(self.matrix);
        self.constant - 2.0 * parameters.dot(&Vector::from(self.vector)) + parameters.dot(&(matrix * parameters))
    }

    /// The least cost and the logarithm of the matrix' determinant; `None` where rows determine no least cost.
    pub(crate) fn least(&self) -> Option<(f64, f64)> {
        let cholesky = Matrix::from(self.matrix).cholesky()?;
        let vector = Vector::from(self.vector);
        let least = self.constant - cholesky.solve(&vector).dot(&vector);
        let ln_determinant = 2.0
            * cholesky
                .l_dirty()
                .diagonal()
                .iter()
                .map(|value| value.ln())
                .sum::<f64>();
        Some((least, ln_determinant))
    }
}
