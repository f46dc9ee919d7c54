//! Cohesion and friction angle, cycle by cycle.

use crate::least_squares::Solution;
use crate::{BilinearLeastSquares, Config, LinearForm, Row, Wheels};
use messages::{Sinkage, Soil, Status, Wheel};

/// Rows before the estimate is called one.
const ROWS_MIN: u32 = 10;
/// A row this many standard deviations off is left out …
const GATE_SIGMAS: f64 = 4.0;
/// … unless so many in succession are: then the soil has changed, and the estimate starts over.
const OUTLIERS_MAX: u32 = 15;
/// With a larger standard deviation than this the friction angle is not known.
const FRICTION_SIGMA_MAX_RAD: f64 = 0.1;

/// The paper's estimator: recursive least squares on its linear form.
#[derive(Clone, Debug)]
pub struct SoilEstimator {
    config: Config,
    wheels: Wheels,
    least_squares: BilinearLeastSquares,
    outliers_in_a_row: u32,
    rows_rejected: u32,
    resets: u32,
}

impl SoilEstimator {
    /// An estimator that knows nothing of the soil yet. `config` has been validated.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            config,
            wheels: Wheels::default(),
            least_squares: BilinearLeastSquares::default(),
            outliers_in_a_row: 0,
            rows_rejected: 0,
            resets: 0,
        }
    }

    /// Takes in a reading of the wheel, not later than the next sinkage.
    pub fn observe_wheel(&mut self, wheel: &Wheel) {
        self.wheels.observe(wheel, &self.config);
    }

    /// The soil, after the sinkage of one more cycle.
    pub fn step(&mut self, sinkage: &Sinkage) -> Soil {
        let row = Row::join(sinkage, &mut self.wheels, &self.config);
        let mut soil = Soil::unknown(sinkage.header.answer(Status::INPUT_REJECTED));
        let (reason, form) = match row {
            Ok(row) => {
                let form = LinearForm::new(
                    &row,
                    self.config.effective_radius_m(),
                    self.config.width_m,
                    self.config.shear_modulus_m,
                );
                soil.slip = row.slip;
                soil.pressure_pa =
                    row.load_n / (self.config.effective_radius_m() * self.config.width_m * row.entry_rad);
                (self.add(&form, &mut soil), Some(form))
            }
            Err(reason) => (reason, None),
        };
        let solution = self.least_squares.solve();
        if let Some(solution) = &solution {
            fill(&mut soil, solution, &self.config);
        }
        soil.rows = self.least_squares.rows();
        soil.resets = self.resets;
        soil.rows_rejected = self.rows_rejected;
        soil.reason = reason;
        if form.is_some() && reason == Soil::USED {
            soil.header.status = self.status(&soil);
        }
        soil
    }

    /// Adds the row unless it is an outlier; the reason why not.
    fn add(&mut self, form: &LinearForm, soil: &mut Soil) -> u32 {
        let finite = form.x_pa.is_finite() && form.y_pa.is_finite() && form.s.is_finite();
        if !finite {
            self.rows_rejected += 1;
            return Soil::LOAD;
        }
        if let Some(solution) = self.least_squares.solve() {
            soil.normalized_innovation = solution.innovation_pa(form) / solution.scatter_pa.max(1.0);
            let is_outlier = soil.normalized_innovation.abs() > GATE_SIGMAS && self.least_squares.rows() >= ROWS_MIN;
            if is_outlier && self.outliers_in_a_row < OUTLIERS_MAX {
                self.outliers_in_a_row += 1;
                self.rows_rejected += 1;
                return Soil::OUTLIER;
            }
            if is_outlier {
                self.least_squares = BilinearLeastSquares::default();
                self.rows_rejected = 0;
                self.resets += 1;
            }
        }
        self.outliers_in_a_row = 0;
        self.least_squares.add(form);
        Soil::USED
    }

    fn status(&self, soil: &Soil) -> Status {
        if self.least_squares.rows() < ROWS_MIN || soil.cohesion_pa.is_nan() {
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
    soil.strength_pa = solution.cohesion_pa + soil.pressure_pa * tangent; // Eq. (1)
    let p = soil.pressure_pa;
    let variance = covariance[(0, 0)] + 2.0 * p * covariance[(0, 1)] + p * p * covariance[(1, 1)];
    soil.strength_sigma_pa = if p.is_nan() { f64::NAN } else { variance.max(0.0).sqrt() };
    soil.shear_modulus_m = config.shear_modulus_m;
    soil.shear_modulus_sigma_m = 0.0;
}
