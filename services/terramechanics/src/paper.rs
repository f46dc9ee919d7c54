//! The paper's estimator: recursive least squares on its linear stresses, with gates.

use crate::least_squares::{BilinearLeastSquares, Solution};
use crate::{Config, LinearForm, Row};
use messages::{Soil, Status};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Rows before the estimate is called one.
const ROWS_MIN: u64 = 10;
/// A row this many standard deviations off is left out …
const GATE_SIGMAS: f64 = 4.0;
/// … unless so many in succession are: then the soil has changed, and the estimate starts over.
const OUTLIERS_MAX: u64 = 15;
/// With a larger standard deviation than this the friction angle is not known.
const FRICTION_SIGMA_MAX_RAD: f64 = 0.1;

/// Everything that changes from row to row.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct PaperEstimator {
    least_squares: BilinearLeastSquares,
    outliers_in_a_row: u64,
    rows_rejected: u64,
    resets: u64,
}

impl PaperEstimator {
    /// Takes in the row of this cycle, unless it is an outlier; the reason why not.
    pub(crate) fn add(&mut self, row: &Row, config: &Config, soil: &mut Soil) -> u32 {
        let (r, b) = (config.effective_radius_m(), config.width_m);
        let form = LinearForm::new(row, r, b, config.shear_modulus_m);
        soil.slip = row.slip;
        soil.pressure_pa = row.load_n / (r * b * row.entry_rad);
        if !(form.x_pa.is_finite() && form.y_pa.is_finite() && form.s.is_finite()) {
            return Soil::LOAD;
        }
        if let Some(solution) = self.least_squares.solve() {
            soil.normalized_innovation = solution.innovation_pa(&form) / solution.scatter_pa.max(1.0);
            let is_outlier = soil.normalized_innovation.abs() > GATE_SIGMAS && self.least_squares.rows() >= ROWS_MIN;
            if is_outlier && self.outliers_in_a_row < OUTLIERS_MAX {
                self.outliers_in_a_row += 1;
                return Soil::OUTLIER;
            }
            if is_outlier {
                *self = Self {
                    resets: self.resets + 1,
                    ..Self::default()
                };
            }
        }
        self.outliers_in_a_row = 0;
        self.least_squares.add(&form);
        Soil::USED
    }

    /// Counts a cycle without a row.
    pub(crate) fn reject(&mut self) {
        self.rows_rejected += 1;
    }

    /// Writes what is known; the status that it deserves.
    pub(crate) fn report(&self, config: &Config, soil: &mut Soil) -> Status {
        soil.rows = u32::try_from(self.least_squares.rows()).unwrap_or(u32::MAX);
        soil.resets = u32::try_from(self.resets).unwrap_or(u32::MAX);
        soil.rows_rejected = u32::try_from(self.rows_rejected).unwrap_or(u32::MAX);
        let Some(solution) = self.least_squares.solve() else {
            return Status::WARMING_UP;
        };
        fill(soil, &solution, config);
        if self.least_squares.rows() < ROWS_MIN {
            Status::WARMING_UP
        } else if soil.friction_sigma_rad > FRICTION_SIGMA_MAX_RAD {
            Status::NOT_OBSERVABLE
        } else {
            Status::OK
        }
    }
}

/// Writes the solution and the strength that follows from it.
fn fill(soil: &mut Soil, solution: &Solution, config: &Config) {
    let tangent = solution.tangent;
    let per_tangent = 1.0 / (1.0 + tangent * tangent); // dφ/dtanφ
    let covariance = &solution.covariance;
    soil.cohesion_pa = solution.cohesion_pa;
    soil.cohesion_sigma_pa = covariance[(0, 0)].max(0.0).sqrt();
    soil.friction_rad = tangent.atan();
    soil.friction_sigma_rad = covariance[(1, 1)].max(0.0).sqrt() * per_tangent;
    soil.cohesion_friction_covariance_pa_rad = covariance[(0, 1)] * per_tangent;
    let p = soil.pressure_pa;
    soil.strength_pa = solution.cohesion_pa + p * tangent; // Eq. (1)
    let variance = covariance[(0, 0)] + 2.0 * p * covariance[(0, 1)] + p * p * covariance[(1, 1)];
    soil.strength_sigma_pa = if p.is_nan() { f64::NAN } else { variance.max(0.0).sqrt() };
    soil.shear_modulus_m = config.shear_modulus_m;
    soil.shear_modulus_sigma_m = 0.0;
}
