//! What the rows can tell: whether cohesion and friction angle can be told apart, and whether the model fits at all.

use crate::model::Model;
use crate::regression::Regression;
use crate::stresses::{EXPONENT, PEAK, PEAK_SLOPE, SHEAR_MODULUS, TANGENT, TORQUE_OFFSET};
use messages::Status;

/// Rows before anything is said.
const ROWS_MIN: u64 = 5;
/// Cohesion shows only through changes of the load; with a smaller relative deviation than this it does not.
const LOAD_VARIATION_MIN: f64 = 0.04;
/// With a larger standard deviation than this the friction angle is not known.
const FRICTION_SIGMA_MAX_RAD: f64 = 0.07;
/// A variance so many times the expected one is not noise.
const SCATTER_MAX: f64 = 4.0;
/// So unlikely parameters, as a sum of squared deviations from the prior, only serve to bend the model.
const STRAIN_MAX: f64 = 38.0;
/// With few rows, strain and misfit trade against each other; their sum says more than either.
const ROWS_FEW: f64 = 24.0;
const STRAIN_AND_MISFIT_MAX: f64 = 36.0;

/// A torque offset is one beyond this, in units of r² b kPa, and beyond so many standard deviations.
const TORQUE_OFFSET_MIN: f64 = 0.05;
const TORQUE_OFFSET_SIGMAS: f64 = 4.0;

/// The status that the rows deserve.
pub(crate) fn status(regression: &Regression, model: &Model) -> Status {
    if regression.rows() < ROWS_MIN {
        Status::WARMING_UP
    } else if has_torque_offset(regression) {
        Status::SENSOR_FAULT
    } else if is_lack_of_fit(regression, model) {
        Status::LACK_OF_FIT
    } else if load_variation(regression, model) < LOAD_VARIATION_MIN
        || friction_sigma_rad(regression) > FRICTION_SIGMA_MAX_RAD
    {
        Status::NOT_OBSERVABLE
    } else {
        Status::OK
    }
}

/// Standard deviation of the friction angle, as far as the rows go.
pub(crate) fn friction_sigma_rad(regression: &Regression) -> f64 {
    let tangent = regression.solution.parameters[TANGENT];
    regression.solution.covariance[TANGENT][TANGENT].max(0.0).sqrt() / (1.0 + tangent * tangent)
}

/// Whether the torque sensor reads more or less than the torque. The estimate allows for it, at the price of a larger sigma.
fn has_torque_offset(regression: &Regression) -> bool {
    let offset = regression.solution.parameters[TORQUE_OFFSET].abs();
    let sigma = regression.solution.covariance[TORQUE_OFFSET][TORQUE_OFFSET].sqrt();
    offset > TORQUE_OFFSET_MIN && offset > TORQUE_OFFSET_SIGMAS * sigma
}

fn is_lack_of_fit(regression: &Regression, model: &Model) -> bool {
    let prior = regression.prior(model);
    let strain: f64 = [SHEAR_MODULUS, EXPONENT, PEAK, PEAK_SLOPE]
        .map(|index| ((regression.solution.parameters[index] - prior.mean[index]) / prior.sigma[index]).powi(2))
        .iter()
        .sum();
    let rows = regression.rows() as f64;
    let excess = (regression.misfit - 2.0 * rows).max(0.0);
    regression.scatter > SCATTER_MAX
        || strain > STRAIN_MAX
        || (rows < ROWS_FEW && strain + excess > STRAIN_AND_MISFIT_MAX)
}

/// Relative standard deviation of the load over the window, its noise taken off.
fn load_variation(regression: &Regression, model: &Model) -> f64 {
    let (mut rows, mut sum, mut squares, mut noise) = (0.0, 0.0, 0.0, 0.0);
    for tracked in regression.tracked() {
        rows += 1.0;
        sum += tracked.row.load_n;
        squares += tracked.row.load_n.powi(2);
        noise += tracked.row.variance_share;
    }
    let mean = sum / rows;
    let variance = squares / rows / (mean * mean) - 1.0;
    (variance - model.load_sigma.powi(2) * noise / rows).max(0.0).sqrt()
}
