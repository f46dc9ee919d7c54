//! Recursive least squares for c and tan φ from rows y = c + x tan φ + s c tan φ.

use crate::LinearForm;
use nalgebra::{Matrix2, Matrix4, Matrix4x2, Vector2, Vector4};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Pressures are summed up in units of this, so that all sums are of one magnitude.
const UNIT_PA: f64 = 1e3;
/// Gauss–Newton steps of a solve; three reach the last digit where the rows are good.
const ITERATIONS_MAX: usize = 12;

/// The least squares solution over all rows so far.
///
/// The rows enter through their moments alone, so that an update costs the same after a thousand rows, and yet the solution
/// is that of all rows at once: the term in c tan φ is linearised around the present solution each time, not once for good.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct BilinearLeastSquares {
    /// Σ z zᵀ with z = (1, x, s, y), pressures in [`UNIT_PA`].
    moments: [[f64; 4]; 4],
    rows: u64,
}

/// c and tan φ, with what the scatter of the rows says of their covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// Cohesion c.
    pub cohesion_pa: f64,
    /// Tangent of the friction angle φ.
    pub tangent: f64,
    /// Covariance of (c, tan φ), in Pa and 1.
    pub covariance: Matrix2<f64>,
    /// Standard deviation of y about the solution.
    pub scatter_pa: f64,
}

impl BilinearLeastSquares {
    /// Adds a row.
    pub fn add(&mut self, form: &LinearForm) {
        let z = Vector4::new(1.0, form.x_pa / UNIT_PA, form.s, form.y_pa / UNIT_PA);
        self.moments = (Matrix4::from(self.moments) + z * z.transpose()).into();
        self.rows += 1;
    }

    /// Number of rows added.
    #[must_use]
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// The solution over all rows, or `None` while they do not determine one.
    #[must_use]
    pub fn solve(&self) -> Option<Solution> {
        let moments = Matrix4::from(self.moments);
        let mut parameters = Vector2::zeros();
        for _ in 0..ITERATIONS_MAX {
            let jacobian = jacobian(&parameters);
            let gradient = jacobian.transpose() * (moments * residual(&parameters));
            let step = (jacobian.transpose() * moments * jacobian).try_inverse()? * gradient;
            parameters += step;
            if step.norm() <= 1e-14 * parameters.norm() {
                break;
            }
        }
        let jacobian = jacobian(&parameters);
        let residual = residual(&parameters);
        let spare = self.rows as f64 - 2.0;
        let variance = (residual.dot(&(moments * residual))).max(0.0) / spare;
        let units = Matrix2::from_diagonal(&Vector2::new(UNIT_PA, 1.0));
        let inverse = (jacobian.transpose() * moments * jacobian).try_inverse()?;
        let solution = Solution {
            cohesion_pa: parameters[0] * UNIT_PA,
            tangent: parameters[1],
            covariance: units * inverse * units * variance,
            scatter_pa: variance.sqrt() * UNIT_PA,
        };
        (spare > 0.0 && parameters.iter().chain(inverse.iter()).all(|value| value.is_finite())).then_some(solution)
    }
}

impl Solution {
    /// By how much the row misses the solution.
    #[must_use]
    pub fn innovation_pa(&self, form: &LinearForm) -> f64 {
        form.y_pa - self.cohesion_pa - form.x_pa * self.tangent - form.s * self.cohesion_pa * self.tangent
    }
}

/// The residual y − c − x t − s c t as coefficients of z.
fn residual(parameters: &Vector2<f64>) -> Vector4<f64> {
    let (c, t) = (parameters[0], parameters[1]);
    Vector4::new(-c, -t, -c * t, 1.0)
}

/// The derivative of c + x t + s c t by c and t, as coefficients of z.
fn jacobian(parameters: &Vector2<f64>) -> Matrix4x2<f64> {
    let (c, t) = (parameters[0], parameters[1]);
    Matrix4x2::from_columns(&[Vector4::new(1.0, 0.0, t, 0.0), Vector4::new(0.0, 1.0, c, 0.0)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Row;

    const COHESION_PA: f64 = 2500.0;
    const FRICTION_RAD: f64 = 27.0 * std::f64::consts::PI / 180.0;
    const RADIUS_M: f64 = 0.15;
    const WIDTH_M: f64 = 0.16;
    const SHEAR_MODULUS_M: f64 = 0.025;

    /// Load and torque of a wheel in soil that obeys the paper's linear stresses: triangles that peak at θm = θ1/2, integrated
    /// over Eqs. (2) and (4) by the trapezoidal rule, from the shear fraction A and the peak stress.
    fn simplified_row(entry_rad: f64, slip: f64, peak_pa: f64) -> Row {
        let middle = entry_rad / 2.0;
        let sheared_m = RADIUS_M * (middle - (1.0 - slip) * (entry_rad.sin() - middle.sin()));
        let a = 1.0 - (-sheared_m / SHEAR_MODULUS_M).exp();
        let shear_peak_pa = a * (COHESION_PA + peak_pa * FRICTION_RAD.tan());
        let (mut load_n, mut torque_nm) = (0.0, 0.0);
        let nodes = 20_000;
        let step = entry_rad / f64::from(nodes);
        for index in 0..nodes {
            let angle = step * (f64::from(index) + 0.5);
            let (normal, shear) = if angle >= middle {
                let part = (entry_rad - angle) / middle;
                (part * peak_pa, part * shear_peak_pa)
            } else {
                let part = angle / middle;
                (part * peak_pa, COHESION_PA + part * (shear_peak_pa - COHESION_PA))
            };
            load_n += RADIUS_M * WIDTH_M * step * (normal * angle.cos() + shear * angle.sin());
            torque_nm += RADIUS_M * RADIUS_M * WIDTH_M * step * shear;
        }
        Row {
            load_n,
            torque_nm,
            entry_rad,
            slip,
            ..Row::default()
        }
    }

    fn simplified_forms() -> Vec<LinearForm> {
        let mut forms = Vec::new();
        for entry_deg in [16, 20, 24, 28, 32, 36] {
            for slip in [0.1, 0.25, 0.4, 0.55, 0.7] {
                let row = simplified_row(f64::from(entry_deg).to_radians(), slip, 400.0 * f64::from(entry_deg));
                forms.push(LinearForm::new(&row, RADIUS_M, WIDTH_M, SHEAR_MODULUS_M));
            }
        }
        forms
    }

    fn solution(forms: impl Iterator<Item = LinearForm>) -> Solution {
        let mut least_squares = BilinearLeastSquares::default();
        forms.for_each(|form| least_squares.add(&form));
        least_squares.solve().unwrap()
    }

    #[test]
    fn the_simplified_model_gives_back_its_soil() {
        let solution = solution(simplified_forms().into_iter());
        assert!((solution.cohesion_pa / COHESION_PA - 1.0).abs() < 1e-6, "{solution:?}");
        assert!(
            (solution.tangent.atan() / FRICTION_RAD - 1.0).abs() < 1e-6,
            "{solution:?}"
        );
    }

    #[test]
    fn the_printed_sign_of_eq_14_gives_the_opposite_friction_angle() {
        // y = c + (κ1/κ3) t instead of y = c − (κ1/κ3) t.
        let printed = simplified_forms().into_iter().map(|form| LinearForm {
            x_pa: -form.x_pa,
            s: 0.0,
            ..form
        });
        let friction_deg = solution(printed).tangent.atan().to_degrees();
        assert!((friction_deg + 27.0).abs() < 0.5, "{friction_deg}");
    }

    #[test]
    fn without_the_bilinear_term_the_friction_angle_comes_out_too_large() {
        let simplified = simplified_forms().into_iter().map(|form| LinearForm { s: 0.0, ..form });
        let solution = solution(simplified);
        let excess_deg = solution.tangent.atan().to_degrees() - 27.0;
        assert!((0.2..0.6).contains(&excess_deg), "{excess_deg}");
        assert!((solution.cohesion_pa / COHESION_PA - 1.0).abs() < 0.02, "{solution:?}");
    }

    #[test]
    fn two_rows_or_equal_rows_determine_nothing() {
        let form = simplified_forms()[0];
        let mut least_squares = BilinearLeastSquares::default();
        assert_eq!(least_squares.solve(), None);
        least_squares.add(&form);
        least_squares.add(&form);
        assert_eq!(least_squares.solve(), None);
    }
}
