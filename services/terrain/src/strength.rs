//! The shear strength of the soil at the operating pressure.

use messages::{Soil, Status};
use std::f64::consts::FRAC_PI_2;

/// A shear strength, and whether it can be believed.
pub(crate) struct Strength {
    /// S; NaN where it is not known.
    pub(crate) value_pa: f64,
    /// Its standard deviation; NaN where it is not known.
    pub(crate) sigma_pa: f64,
    /// True where S is known and nothing speaks against it.
    pub(crate) holds: bool,
}

/// Far above any soil's; what Eq. (1) gives beyond it, near φ = 90°, is no strength.
const STRENGTH_MAX_PA: f64 = 1e9;
/// Standard deviations by which the estimator's own strength may miss the one that follows from its c and φ.
const DISAGREEMENT_SIGMAS: f64 = 3.0;
/// What rounding may add to that, of S.
const DISAGREEMENT_RELATIVE: f64 = 1e-6;

/// The strength that follows from c, φ and p where they are known, so that one sample never contradicts itself;
/// the estimator's own where c and φ cannot be told apart.
pub(crate) fn of(soil: &Soil) -> Strength {
    let tan = soil.friction_rad.tan();
    let value_pa = soil.cohesion_pa + soil.pressure_pa * tan; // Eq. (1)
    let computable = soil.friction_rad.abs() < FRAC_PI_2 && value_pa.abs() <= STRENGTH_MAX_PA;
    if soil.header.status == Status::NOT_OBSERVABLE || !computable {
        return Strength {
            value_pa: soil.strength_pa,
            sigma_pa: soil.strength_sigma_pa,
            holds: soil.strength_pa.is_finite(),
        };
    }
    let sigma_pa = if soil.strength_sigma_pa.is_nan() {
        propagated_sigma_pa(soil, tan)
    } else {
        soil.strength_sigma_pa
    };
    let allowed_pa = DISAGREEMENT_SIGMAS * sigma_pa + DISAGREEMENT_RELATIVE * value_pa.abs();
    // An estimator that gave no strength of its own contradicts nothing: NaN is not greater.
    let contradicted = (value_pa - soil.strength_pa).abs() > allowed_pa;
    Strength {
        value_pa,
        sigma_pa,
        holds: !contradicted,
    }
}

/// Eq. (1) to first order: dS = dc + p (1 + tan² φ) dφ.
fn propagated_sigma_pa(soil: &Soil, tan: f64) -> f64 {
    let slope_pa_rad = soil.pressure_pa * (1.0 + tan * tan);
    let friction_share_pa = slope_pa_rad * soil.friction_sigma_rad;
    let covariance_pa2 = slope_pa_rad * soil.cohesion_friction_covariance_pa_rad;
    (soil.cohesion_sigma_pa.powi(2) + 2.0 * covariance_pa2 + friction_share_pa.powi(2)).sqrt()
}
