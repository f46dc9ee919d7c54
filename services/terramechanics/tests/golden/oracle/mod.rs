//! The slow, obvious forward model, and traverses made with it: what the estimator is judged by.
//!
//! Shares no code with the crate: tanh–sinh quadrature of the stresses over the contact, bisection for the entry angle.

pub mod traverse;

/// A soil in the full Bekker / Wong–Reece / Janosi model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoilModel {
    pub name: &'static str,
    pub cohesion_pa: f64,
    pub friction_deg: f64,
    /// kc, N/m^(n+1).
    pub kc: f64,
    /// kφ, N/m^(n+2).
    pub kphi: f64,
    pub exponent: f64,
    pub shear_modulus_m: f64,
    pub c1: f64,
    pub c2: f64,
}

const fn soil(name: &'static str, c: [f64; 2], k: [f64; 3], rest: [f64; 3]) -> SoilModel {
    SoilModel {
        name,
        cohesion_pa: c[0],
        friction_deg: c[1],
        kc: k[0],
        kphi: k[1],
        exponent: k[2],
        shear_modulus_m: rest[0],
        c1: rest[1],
        c2: rest[2],
    }
}

/// The soils of `golden/terramechanics_forward.csv`.
pub const SOILS: [SoilModel; 10] = [
    soil(
        "paper_dry_sand",
        [2500.0, 27.0],
        [990.0, 1_528_430.0, 1.1],
        [0.025, 0.18, 0.32],
    ),
    soil("bentonite", [700.0, 32.1], [990.0, 1_528_430.0, 1.1], [0.02, 0.3, 0.32]),
    soil(
        "wong_dry_sand",
        [1040.0, 28.0],
        [990.0, 1_528_430.0, 1.1],
        [0.01, 0.18, 0.32],
    ),
    soil(
        "wong_sandy_loam",
        [1720.0, 29.0],
        [5270.0, 1_515_040.0, 0.7],
        [0.025, 0.18, 0.32],
    ),
    soil(
        "wong_clayey_soil",
        [4140.0, 13.0],
        [13190.0, 692_150.0, 0.5],
        [0.01, 0.43, 0.32],
    ),
    soil(
        "wong_snow_harrison",
        [1030.0, 19.7],
        [4370.0, 196_720.0, 1.6],
        [0.04, 0.43, 0.32],
    ),
    soil(
        "lunar_nominal",
        [170.0, 35.0],
        [1400.0, 820_000.0, 1.0],
        [0.0178, 0.4, 0.15],
    ),
    soil("FJS-1", [800.0, 37.2], [1370.0, 814_000.0, 1.0], [0.036, 0.4, 0.15]),
    soil("JSC-1A", [1000.0, 45.0], [1400.0, 820_000.0, 1.0], [0.0178, 0.4, 0.15]),
    soil(
        "mars_MMS",
        [600.0, 35.0],
        [846_000.0, 6_708_000.0, 1.4],
        [0.006, 0.4, 0.15],
    ),
];

/// Radius and width of a wheel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelModel {
    pub radius_m: f64,
    pub width_m: f64,
}

/// What acts on a wheel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forces {
    pub load_n: f64,
    pub torque_nm: f64,
    pub drawbar_n: f64,
}

/// Load, torque and drawbar pull at a contact from `entry_rad` to `exit_rad` (0 or negative).
pub fn forces(soil: &SoilModel, wheel: &WheelModel, entry_rad: f64, exit_rad: f64, slip: f64) -> Forces {
    let (r, b) = (wheel.radius_m, wheel.width_m);
    let middle = (soil.c1 + soil.c2 * slip) * entry_rad;
    let stiffness = soil.kc / b + soil.kphi;
    let tangent = soil.friction_deg.to_radians().tan();
    let normal = |angle: f64| stiffness * (r * (angle.cos() - entry_rad.cos()).max(0.0)).powf(soil.exponent);
    let stresses = |angle: f64| {
        let sigma = if angle >= middle {
            normal(angle)
        } else {
            normal(entry_rad - (angle - exit_rad) / (middle - exit_rad) * (entry_rad - middle))
        };
        let sheared_m = r * (entry_rad - angle - (1.0 - slip) * (entry_rad.sin() - angle.sin()));
        let tau = (soil.cohesion_pa + sigma * tangent) * (1.0 - (-sheared_m / soil.shear_modulus_m).exp());
        (sigma, tau)
    };
    let integrands = |angle: f64| {
        let (sigma, tau) = stresses(angle);
        let (sin, cos) = angle.sin_cos();
        [sigma * cos + tau * sin, tau * cos - sigma * sin, tau]
    };
    let front = tanh_sinh(middle, entry_rad, integrands);
    let rear = tanh_sinh(exit_rad, middle, integrands);
    Forces {
        load_n: r * b * (front[0] + rear[0]),
        drawbar_n: r * b * (front[1] + rear[1]),
        torque_nm: r * r * b * (front[2] + rear[2]),
    }
}

/// The entry angle at which the wheel carries `load_n`; `exit_ratio` is θ2/θ1. `None` if it would sink beyond 80°.
pub fn entry_for(soil: &SoilModel, wheel: &WheelModel, load_n: f64, slip: f64, exit_ratio: f64) -> Option<f64> {
    let carried = |entry: f64| forces(soil, wheel, entry, exit_ratio * entry, slip).load_n - load_n;
    let (mut low, mut high) = (1e-3, 1.4);
    if carried(high) < 0.0 {
        return None;
    }
    // Bisection first, then regula falsi by the Illinois rule.
    for _ in 0..6 {
        let middle = 0.5 * (low + high);
        if carried(middle) < 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    let (mut at_low, mut at_high) = (carried(low), carried(high));
    let mut side = 0;
    for _ in 0..60 {
        let middle = (low * at_high - high * at_low) / (at_high - at_low);
        let at_middle = carried(middle);
        if at_middle.abs() <= 1e-12 * load_n || (high - low) < 1e-15 {
            return Some(middle);
        }
        if at_middle < 0.0 {
            (low, at_low) = (middle, at_middle);
            if side == -1 {
                at_high *= 0.5;
            }
            side = -1;
        } else {
            (high, at_high) = (middle, at_middle);
            if side == 1 {
                at_low *= 0.5;
            }
            side = 1;
        }
    }
    Some(0.5 * (low + high))
}

/// ∫ of three integrands from `from` to `to`. Doubly exponential nodes take the root-like start of the stresses in their stride.
fn tanh_sinh(from: f64, to: f64, of: impl Fn(f64) -> [f64; 3]) -> [f64; 3] {
    use std::f64::consts::FRAC_PI_2;
    const STEP: f64 = 1.0 / 10.0;
    let half = 0.5 * (to - from);
    let mut sum = [0.0; 3];
    for index in -33..=33 {
        let at = STEP * f64::from(index);
        let inner = FRAC_PI_2 * at.sinh();
        let weight = STEP * FRAC_PI_2 * at.cosh() / inner.cosh().powi(2);
        // Distance from the nearer end without cancellation.
        let from_end = half * (-inner.abs()).exp() / inner.cosh();
        let angle = if index < 0 { from + from_end } else { to - from_end };
        let values = of(angle);
        for (sum, value) in sum.iter_mut().zip(values) {
            *sum += half * weight * value;
        }
    }
    sum
}
