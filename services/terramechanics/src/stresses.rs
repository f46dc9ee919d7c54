//! What a soil does to a wheel: load and torque as integrals of the stresses over the contact, with all their derivatives.
//!
//! Normal stress by Bekker in front of θm and its Wong–Reece mirror behind, shear stress by Janosi, Eq. (5). The nodes are those of
//! Gauss and Legendre in u, where θ = θ1 − (θ1 − θm) u² in front and θ2 + (θm − θ2) u² behind: the square takes away the root of the
//! stress at the rim, and at equal u both sides have the same normal stress, so that it is computed once.

/// Number of the model's parameters, in the order of the constants below.
pub(crate) const PARAMETERS: usize = 8;
/// Cohesion c [kPa].
pub(crate) const COHESION: usize = 0;
/// tan φ.
pub(crate) const TANGENT: usize = 1;
/// Logarithm of the normal stress [Pa] at [`REFERENCE_DEPTH_M`].
pub(crate) const STIFFNESS: usize = 2;
/// Logarithm of the shear modulus k [m].
pub(crate) const SHEAR_MODULUS: usize = 3;
/// Sinkage exponent n.
pub(crate) const EXPONENT: usize = 4;
/// θm/θ1 of the largest stress at [`REFERENCE_SLIP`].
pub(crate) const PEAK: usize = 5;
/// By how much θm/θ1 grows with slip.
pub(crate) const PEAK_SLOPE: usize = 6;
/// What the torque sensor reads beyond the torque, in units of r² b [`COHESION_UNIT_PA`].
pub(crate) const TORQUE_OFFSET: usize = 7;

/// Depth to which the stiffness refers: with one within the range of the data, stiffness and exponent hardly correlate.
pub(crate) const REFERENCE_DEPTH_M: f64 = 0.01;
/// Slip to which the peak refers.
pub(crate) const REFERENCE_SLIP: f64 = 0.35;
/// Cohesion is counted in this unit, so that all parameters are of one magnitude.
pub(crate) const COHESION_UNIT_PA: f64 = 1e3;

/// The soil's parameters, and the sensor's.
pub(crate) type Parameters = [f64; PARAMETERS];

/// Nodes of Gauss and Legendre on 0 … 1, and their weights.
const NODES: [(f64, f64); 8] = [
    (0.019_855_071_751_231_884, 0.050_614_268_145_188_13),
    (0.101_666_761_293_186_63, 0.111_190_517_226_687_24),
    (0.237_233_795_041_835_5, 0.156_853_322_938_943_64),
    (0.408_282_678_752_175_1, 0.181_341_891_689_181),
    (0.591_717_321_247_825, 0.181_341_891_689_181),
    (0.762_766_204_958_164_5, 0.156_853_322_938_943_64),
    (0.898_333_238_706_813_4, 0.111_190_517_226_687_24),
    (0.980_144_928_248_768_1, 0.050_614_268_145_188_13),
];

/// The rim under load: radius and width.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rim {
    /// Radius r, to the tips of the grousers.
    pub(crate) radius_m: f64,
    /// Width b.
    pub(crate) width_m: f64,
}

/// Where the wheel touches the soil and how much it slips.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Contact {
    /// Entry angle θ1.
    pub(crate) entry_rad: f64,
    /// Exit angle θ2, 0 or negative.
    pub(crate) exit_rad: f64,
    /// Slip i.
    pub(crate) slip: f64,
}

/// Load and torque, and how they change with everything they depend on. Index 0 is the load [N], 1 the torque [N m].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Forces {
    /// Load W and torque T.
    pub(crate) values: [f64; 2],
    /// Derivatives by the parameters.
    pub(crate) by_parameters: [[f64; PARAMETERS]; 2],
    /// Derivatives by the entry angle and by the slip.
    pub(crate) by_contact: [[f64; 2]; 2],
}

impl Rim {
    /// Load by Eq. (2) and torque by Eq. (4).
    pub(crate) fn forces(&self, contact: &Contact, soil: &Parameters) -> Forces {
        let r = self.radius_m;
        let (entry, exit) = (contact.entry_rad, contact.exit_rad);
        let (sin_entry, cos_entry) = entry.sin_cos();
        let peak = (soil[PEAK] + soil[PEAK_SLOPE] * (contact.slip - REFERENCE_SLIP)).clamp(0.05, 0.95);
        let one_over_modulus = (-soil[SHEAR_MODULUS]).exp();
        let mut sums = Sums::default();
        for (u, weight) in NODES {
            let square = u * u;
            let spread = 2.0 * u * weight;
            let ratio = 1.0 - (1.0 - peak) * square;
            let front = Node::new(
                Position {
                    angle: entry * ratio,
                    by_entry: ratio,
                    by_peak: entry * square,
                },
                Position {
                    angle: spread * entry * (1.0 - peak),
                    by_entry: spread * (1.0 - peak),
                    by_peak: -spread * entry,
                },
            );
            let rear = Node::new(
                Position {
                    angle: exit + (peak * entry - exit) * square,
                    by_entry: peak * square,
                    by_peak: entry * square,
                },
                Position {
                    angle: spread * (peak * entry - exit),
                    by_entry: spread * peak,
                    by_peak: spread * entry,
                },
            );
            // Bekker's normal stress; behind θm its mirror, at equal u.
            let depth = r * (front.cos - cos_entry);
            let ln_depth = (depth / REFERENCE_DEPTH_M).ln();
            let sigma = (soil[STIFFNESS] + soil[EXPONENT] * ln_depth).exp();
            let per_depth = sigma * soil[EXPONENT] / depth;
            let normal = Normal {
                sigma,
                by_entry: per_depth * r * (sin_entry - front.sin * front.at.by_entry),
                by_peak: -per_depth * r * front.sin * front.at.by_peak,
                by_exponent: sigma * ln_depth,
            };
            for node in [&front, &rear] {
                let shear = Shear::new(node, r, contact, (sin_entry, cos_entry), one_over_modulus);
                sums.add(node, &normal, &shear, soil);
            }
        }
        sums.scaled(r * self.width_m, r * r * self.width_m, contact.slip, soil)
    }
}

/// A quantity of a node with its derivatives by θ1 and by θm/θ1.
#[derive(Clone, Copy)]
struct Position {
    angle: f64,
    by_entry: f64,
    by_peak: f64,
}

/// One node of the quadrature: its angle and the angle it stands for.
struct Node {
    at: Position,
    weight: Position,
    sin: f64,
    cos: f64,
}

impl Node {
    fn new(at: Position, weight: Position) -> Self {
        let (sin, cos) = at.angle.sin_cos();
        Self { at, weight, sin, cos }
    }
}

/// Normal stress with its derivatives.
struct Normal {
    sigma: f64,
    by_entry: f64,
    by_peak: f64,
    by_exponent: f64,
}

/// The built-up part 1 − exp(−j/k) of the shear strength with its derivatives; Eqs. (5)–(6).
struct Shear {
    part: f64,
    by_entry: f64,
    by_peak: f64,
    by_slip: f64,
    by_ln_modulus: f64,
}

impl Shear {
    fn new(node: &Node, r: f64, contact: &Contact, entry: (f64, f64), one_over_modulus: f64) -> Self {
        let grip = 1.0 - contact.slip;
        let lag = contact.entry_rad - node.at.angle;
        let fall = entry.0 - node.sin;
        let sheared = r * (lag - grip * fall) * one_over_modulus; // j/k, Eq. (6)
        let rest = (-sheared).exp();
        let scale = rest * r * one_over_modulus;
        let by_angle = grip * node.cos - 1.0;
        Self {
            part: 1.0 - rest, // Eq. (5)
            by_entry: scale * (1.0 - grip * entry.1 + by_angle * node.at.by_entry),
            by_peak: scale * by_angle * node.at.by_peak,
            by_slip: scale * fall,
            by_ln_modulus: -sheared * rest,
        }
    }
}

/// The integrals being summed up: for load/(r b) and torque/(r² b) the value and its derivatives.
#[derive(Default)]
struct Sums {
    values: [f64; 2],
    by_parameters: [[f64; PARAMETERS]; 2],
    by_entry: [f64; 2],
    by_slip: [f64; 2],
}

impl Sums {
    fn add(&mut self, node: &Node, normal: &Normal, shear: &Shear, soil: &Parameters) {
        let (c, t) = (soil[COHESION] * COHESION_UNIT_PA, soil[TANGENT]);
        let strength = c + normal.sigma * t; // Eq. (1)
        let tau = strength * shear.part;
        let tau_by_sigma = t * shear.part;
        let w = node.weight.angle;

        // d(weight) and d(angle) by θ1 and by θm/θ1 both act on the integrand.
        let tau_by_entry = tau_by_sigma * normal.by_entry + strength * shear.by_entry;
        let tau_by_peak = tau_by_sigma * normal.by_peak + strength * shear.by_peak;
        let load = normal.sigma * node.cos + tau * node.sin;
        let drawbar = tau * node.cos - normal.sigma * node.sin;
        let load_by = |sigma: f64, tau: f64, angle: f64| sigma * node.cos + tau * node.sin + drawbar * angle;
        let load_by_entry = load_by(normal.by_entry, tau_by_entry, node.at.by_entry);
        let load_by_peak = load_by(normal.by_peak, tau_by_peak, node.at.by_peak);

        self.values[0] += w * load; // Eq. (2)
        self.values[1] += w * tau; // Eq. (4)
        self.by_entry[0] += w * load_by_entry + node.weight.by_entry * load;
        self.by_entry[1] += w * tau_by_entry + node.weight.by_entry * tau;
        self.by_slip[0] += w * strength * shear.by_slip * node.sin;
        self.by_slip[1] += w * strength * shear.by_slip;

        let tau_by = [
            shear.part * COHESION_UNIT_PA,
            shear.part * normal.sigma,
            tau_by_sigma * normal.sigma,
            strength * shear.by_ln_modulus,
            tau_by_sigma * normal.by_exponent,
        ];
        let sigma_by = [0.0, 0.0, normal.sigma, 0.0, normal.by_exponent];
        for parameter in 0..PEAK {
            self.by_parameters[0][parameter] += w * (sigma_by[parameter] * node.cos + tau_by[parameter] * node.sin);
            self.by_parameters[1][parameter] += w * tau_by[parameter];
        }
        self.by_parameters[0][PEAK] += w * load_by_peak + node.weight.by_peak * load;
        self.by_parameters[1][PEAK] += w * tau_by_peak + node.weight.by_peak * tau;
    }

    fn scaled(mut self, load: f64, torque: f64, slip: f64, soil: &Parameters) -> Forces {
        let scale = [load, torque];
        let mut by_contact = [[0.0; 2]; 2];
        for force in 0..2 {
            self.values[force] *= scale[force];
            for derivative in &mut self.by_parameters[force] {
                *derivative *= scale[force];
            }
            let by_peak = self.by_parameters[force][PEAK];
            self.by_parameters[force][PEAK_SLOPE] = (slip - REFERENCE_SLIP) * by_peak;
            by_contact[force] = [
                scale[force] * self.by_entry[force],
                scale[force] * self.by_slip[force] + soil[PEAK_SLOPE] * by_peak,
            ];
        }
        // The sensor's, not the soil's.
        let unit_nm = torque * COHESION_UNIT_PA;
        self.values[1] += soil[TORQUE_OFFSET] * unit_nm;
        self.by_parameters[1][TORQUE_OFFSET] = unit_nm;
        Forces {
            values: self.values,
            by_parameters: self.by_parameters,
            by_contact,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RIM: Rim = Rim {
        radius_m: 0.15,
        width_m: 0.16,
    };

    fn soil() -> Parameters {
        [2.5, 0.5, 9.2, -3.7, 1.1, 0.3, 0.25, 0.05]
    }

    #[test]
    fn the_derivatives_are_those_of_central_differences() {
        let contact = Contact {
            entry_rad: 0.45,
            exit_rad: -0.08,
            slip: 0.3,
        };
        let forces = RIM.forces(&contact, &soil());
        let assert_close = |got: f64, high: [f64; 2], step: f64, force: usize, what: &str| {
            let wanted = (high[0] - high[1]) / (2.0 * step);
            assert!(
                (got - wanted).abs() < 1e-6 * (1.0 + wanted.abs()),
                "{what} of {force}: {got} is not {wanted}"
            );
        };
        let step = 1e-5;
        for force in 0..2 {
            for parameter in 0..PARAMETERS {
                let at = |change: f64| {
                    let mut soil = soil();
                    soil[parameter] += change;
                    RIM.forces(&contact, &soil).values[force]
                };
                let got = forces.by_parameters[force][parameter];
                assert_close(
                    got,
                    [at(step), at(-step)],
                    step,
                    force,
                    &format!("parameter {parameter}"),
                );
            }
            let by_entry = |change: f64| {
                let contact = Contact {
                    entry_rad: contact.entry_rad + change,
                    ..contact
                };
                RIM.forces(&contact, &soil()).values[force]
            };
            assert_close(
                forces.by_contact[force][0],
                [by_entry(step), by_entry(-step)],
                step,
                force,
                "entry",
            );
            let by_slip = |change: f64| {
                let contact = Contact {
                    slip: contact.slip + change,
                    ..contact
                };
                RIM.forces(&contact, &soil()).values[force]
            };
            assert_close(
                forces.by_contact[force][1],
                [by_slip(step), by_slip(-step)],
                step,
                force,
                "slip",
            );
        }
    }

    #[test]
    fn load_and_torque_agree_with_the_golden_forward_model() {
        let rows: Vec<Vec<f64>> = include_str!("../golden/terramechanics_forward.csv")
            .lines()
            .skip(1)
            .map(|line| line.split(',').skip(1).map(|cell| cell.parse().unwrap()).collect())
            .collect();
        for g in rows {
            let (n, slip) = (g[6], g[11]);
            let stiffness = (g[4] / g[1] + g[5]).ln() + n * REFERENCE_DEPTH_M.ln();
            let soil = [
                g[2] / COHESION_UNIT_PA,
                g[3].to_radians().tan(),
                stiffness,
                g[7].ln(),
                n,
                g[8] + g[9] * REFERENCE_SLIP,
                g[9],
                0.0,
            ];
            let rim = Rim {
                radius_m: g[0],
                width_m: g[1],
            };
            let contact = Contact {
                entry_rad: g[12],
                exit_rad: 0.0,
                slip,
            };
            let forces = rim.forces(&contact, &soil);
            for (got, wanted) in forces.values.iter().zip([g[10], g[13]]) {
                assert!((got / wanted - 1.0).abs() < 1e-6, "{got} is not {wanted}");
            }
        }
    }
}
