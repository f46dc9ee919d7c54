//! The full wheel–soil model: from load and slip to entry angle, torque and drawbar pull.

use crate::Soil;

/// Nodes of the quadrature, on each side of the greatest stress.
const NODES: usize = 24;
/// Halvings of the interval in which the entry angle is sought: to the last bit.
const HALVINGS_MAX: usize = 60;
/// The deepest entry angle that is sought [rad]: the wheel stands in the soil up to its axle.
const ENTRY_MAX_RAD: f64 = 1.5;

/// A rigid wheel in soil.
#[derive(Clone, Debug)]
pub struct WheelModel {
    /// Radius r.
    pub radius_m: f64,
    /// Width b.
    pub width_m: f64,
    nodes: [(f64, f64); NODES],
}

/// What the soil does to the wheel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Entry angle θ1.
    pub entry_rad: f64,
    /// Vertical load W that the soil carries.
    pub load_n: f64,
    /// Torque T.
    pub torque_nm: f64,
    /// Drawbar pull DP.
    pub drawbar_pull_n: f64,
}

impl WheelModel {
    /// A wheel of this radius and width.
    #[must_use]
    pub fn new(radius_m: f64, width_m: f64) -> Self {
        Self {
            radius_m,
            width_m,
            nodes: gauss_legendre(),
        }
    }

    /// The contact under this load at this slip. θ2 = 0.
    #[must_use]
    pub fn contact(&self, soil: &Soil, load_n: f64, slip: f64) -> Contact {
        let (mut low, mut high) = (1e-6, ENTRY_MAX_RAD);
        for _ in 0..HALVINGS_MAX {
            let middle = 0.5 * (low + high);
            if self.at(soil, middle, slip).load_n < load_n {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.at(soil, 0.5 * (low + high), slip)
    }

    /// The contact at this entry angle and slip.
    #[must_use]
    pub fn at(&self, soil: &Soil, entry_rad: f64, slip: f64) -> Contact {
        let (r, b) = (self.radius_m, self.width_m);
        let peak_rad = (soil.peak[0] + soil.peak[1] * slip) * entry_rad;
        let stiffness = soil.cohesive_modulus / b + soil.frictional_modulus;
        let (mut load, mut torque, mut pull) = (0.0, 0.0, 0.0);
        let mut add = |angle: f64, mirrored: f64, weight: f64| {
            // Eqs. (6) and (7): Bekker in front of the peak, mirrored by Wong and Reece behind it.
            let depth_m = r * (mirrored.cos() - entry_rad.cos()).max(0.0);
            let normal_pa = stiffness * depth_m.powf(soil.sinkage_exponent);
            // Eq. (5), with the shear deformation of Eq. (8).
            let shear_m = r * ((entry_rad - angle) - (1.0 - slip) * (entry_rad.sin() - angle.sin()));
            let strength_pa = soil.cohesion_pa + normal_pa * soil.friction_rad.tan(); // Eq. (1)
            let shear_pa = strength_pa * (1.0 - (-shear_m / soil.shear_modulus_m).exp());
            load += weight * (normal_pa * angle.cos() + shear_pa * angle.sin());
            pull += weight * (shear_pa * angle.cos() - normal_pa * angle.sin());
            torque += weight * shear_pa;
        };
        for (node, weight) in self.nodes {
            // The substitution with u² takes away the root at the ends that a broken exponent n leaves.
            let (square, slope) = (node * node, 2.0 * node);
            let front_rad = entry_rad - (entry_rad - peak_rad) * square;
            add(front_rad, front_rad, weight * slope * (entry_rad - peak_rad));
            let rear_rad = peak_rad * square;
            add(
                rear_rad,
                entry_rad - square * (entry_rad - peak_rad),
                weight * slope * peak_rad,
            );
        }
        Contact {
            entry_rad,
            load_n: r * b * load,          // Eq. (2)
            torque_nm: r * r * b * torque, // Eq. (4)
            drawbar_pull_n: r * b * pull,  // Eq. (3)
        }
    }
}

/// Nodes and weights of Gauss and Legendre on 0..1.
fn gauss_legendre() -> [(f64, f64); NODES] {
    std::array::from_fn(|index| {
        let n = NODES as f64;
        let mut x = (std::f64::consts::PI * (index as f64 + 0.75) / (n + 0.5)).cos();
        let mut slope = 0.0;
        for _ in 0..20 {
            let (mut previous, mut value) = (1.0, x);
            for degree in 2..=NODES {
                let k = degree as f64;
                (previous, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * previous) / k);
            }
            slope = n * (x * value - previous) / (x * x - 1.0);
            x -= value / slope;
        }
        (0.5 * (1.0 - x), 1.0 / ((1.0 - x * x) * slope * slope))
    })
}
