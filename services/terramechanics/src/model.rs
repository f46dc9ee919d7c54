//! What is known before any row: the wheel, its sensors, and what soils are like.

use crate::Config;
use crate::cost::Cost;
use crate::stresses::{
    COHESION, EXPONENT, PARAMETERS, PEAK, PEAK_SLOPE, Parameters, Rim, SHEAR_MODULUS, STIFFNESS, TANGENT, TORQUE_OFFSET,
};

/// Means and standard deviations of the parameters over the soils of the literature, the shear modulus excepted.
const PRIOR: [(usize, f64, f64); PARAMETERS - 1] = [
    (COHESION, 1.2, 3.0),
    (TANGENT, 0.577, 0.25),
    // Stress at the reference depth: nothing is known.
    (STIFFNESS, 9.4, 2.5),
    (EXPONENT, 1.0, 0.45),
    (PEAK, 0.40, 0.09),
    (PEAK_SLOPE, 0.2, 0.08),
    (TORQUE_OFFSET, 0.0, 0.01),
];
/// The configured shear modulus is trusted this far, in its logarithm, …
const SHEAR_MODULUS_SIGMA: f64 = 0.2;
/// … and less once the soil has changed: it was given for the first.
const SHEAR_MODULUS_SIGMA_LATER: f64 = 0.45;

/// From an offset of one over this on, the prior does not hold it down any more.
const TORQUE_OFFSET_TAIL: f64 = 50.0;

/// How far a parameter may move in one step, and its range.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limit {
    pub(crate) step: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
}

const fn limit(step: f64, low: f64, high: f64) -> Limit {
    Limit { step, low, high }
}

/// The limits, in the order of the parameters: wide enough for any soil, and narrow enough that nothing overflows.
pub(crate) const LIMITS: [Limit; PARAMETERS] = [
    limit(1.0, 0.0, 50.0),
    limit(0.15, 0.02, 2.5),
    limit(1.0, 2.0, 20.0),
    limit(0.3, -9.0, 0.0),
    limit(0.3, 0.2, 2.5),
    limit(0.1, 0.05, 0.8),
    limit(0.1, -0.2, 0.8),
    limit(0.1, -1.0, 1.0),
];

/// The wheel, its sensors and what is expected of soils.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    pub(crate) rim: Rim,
    pub(crate) load_sigma: f64,
    pub(crate) torque_sigma: f64,
    pub(crate) slip_sigma: f64,
    /// What is expected of the first soil.
    pub(crate) first: Prior,
    /// What is expected of those that follow.
    pub(crate) later: Prior,
}

/// What the parameters are expected to be: independent normal distributions.
#[derive(Clone, Debug)]
pub(crate) struct Prior {
    pub(crate) mean: Parameters,
    pub(crate) sigma: Parameters,
    pub(crate) cost: Cost,
}

impl Model {
    pub(crate) fn new(config: &Config) -> Self {
        Self {
            rim: Rim {
                radius_m: config.effective_radius_m(),
                width_m: config.width_m,
            },
            load_sigma: config.load_sigma,
            torque_sigma: config.torque_sigma,
            slip_sigma: config.slip_sigma,
            first: Prior::new(config.shear_modulus_m, SHEAR_MODULUS_SIGMA),
            later: Prior::new(config.shear_modulus_m, SHEAR_MODULUS_SIGMA_LATER),
        }
    }
}

impl Prior {
    fn new(shear_modulus_m: f64, shear_modulus_sigma: f64) -> Self {
        let (mut mean, mut sigma) = ([0.0; PARAMETERS], [1.0; PARAMETERS]);
        for (parameter, value, deviation) in PRIOR {
            (mean[parameter], sigma[parameter]) = (value, deviation);
        }
        (mean[SHEAR_MODULUS], sigma[SHEAR_MODULUS]) = (shear_modulus_m.ln(), shear_modulus_sigma);
        let mut cost = Cost::default();
        for parameter in 0..PARAMETERS {
            let weight = sigma[parameter].powi(-2);
            cost.matrix[parameter][parameter] = weight;
            cost.vector[parameter] = weight * mean[parameter];
            cost.constant += weight * mean[parameter].powi(2);
        }
        Self { mean, sigma, cost }
    }

    /// What is taken from the certainty that there is no torque offset where the rows insist on one.
    ///
    /// As with a distribution of long tails, a small offset is held down, and a large one is free.
    pub(crate) fn looser_for_offset(&self, offset: f64) -> f64 {
        let variance = self.sigma[TORQUE_OFFSET].powi(2);
        1.0 / (variance + (TORQUE_OFFSET_TAIL * offset * offset).powi(2)) - 1.0 / variance
    }

    /// Logarithm of the product of the standard deviations.
    pub(crate) fn ln_volume(&self) -> f64 {
        self.sigma.iter().map(|sigma| sigma.ln()).sum()
    }
}
