//! Traverses made with the forward model: a wheel driven over soils, measured with noise.

use super::{SoilModel, WheelModel, entry_for, forces};
use messages::{Header, Sinkage, Wheel};
use terramechanics::Config;

/// The generator `SplitMix64`.
#[derive(Clone, Copy, Debug)]
pub struct Random(pub u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in `low .. high`.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal, by Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform(0.0, 1.0)).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform(0.0, 1.0)).cos()
    }
}

/// Standard deviations of the sensors: load and torque relative, entry angle, slip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    pub load: f64,
    pub torque: f64,
    pub entry_deg: f64,
    pub slip: f64,
}

/// The simulated rover's wheel.
pub const WHEEL: WheelModel = WheelModel {
    radius_m: 0.15,
    width_m: 0.16,
};

/// Good sensors: 3 % of load and torque, 1° of the entry angle, 0.02 of the slip.
pub const GOOD: Noise = Noise {
    load: 0.03,
    torque: 0.03,
    entry_deg: 1.0,
    slip: 0.02,
};

/// How load and slip vary along the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Excitation {
    /// Every row anywhere in the ranges.
    Random,
    /// Slow sines over the ranges, as on rolling ground.
    Smooth,
    /// A random walk over the ranges.
    Walk,
    /// Always the middle of the ranges.
    Constant,
}

/// One piece of ground.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    pub soil: SoilModel,
    pub rows: usize,
}

/// What to drive, over what, and how well it is measured.
#[derive(Clone, Debug)]
pub struct Plan {
    pub segments: Vec<Segment>,
    pub wheel: WheelModel,
    pub noise: Noise,
    pub excitation: Excitation,
    pub load_n: [f64; 2],
    pub slip: [f64; 2],
    /// k as configured over k of the first soil.
    pub shear_modulus_error: f64,
    pub rate_hz: f64,
    pub seed: u64,
}

/// One measured row.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    pub wheel: Wheel,
    pub sinkage: Sinkage,
}

impl Plan {
    /// What an operator would write for this traverse.
    pub fn config(&self) -> Config {
        Config {
            radius_m: self.wheel.radius_m,
            width_m: self.wheel.width_m,
            shear_modulus_m: self.segments[0].soil.shear_modulus_m * self.shear_modulus_error,
            load_sigma: self.noise.load.max(1e-3),
            torque_sigma: self.noise.torque.max(1e-3),
            entry_sigma_rad: self.noise.entry_deg.to_radians().max(1e-4),
            slip_sigma: self.noise.slip.max(1e-4),
            ..Config::default()
        }
    }

    /// The rows, as the estimator receives them.
    pub fn rows(&self) -> Vec<Measured> {
        let mut random = Random(self.seed);
        let mut drive = Drive::new(&mut random);
        let mut rows = Vec::new();
        for Segment { soil, rows: count } in &self.segments {
            for _ in 0..*count {
                let [load, slip] = drive.next(self.excitation, rows.len(), &mut random);
                let mut load_n = self.load_n[0] + load * (self.load_n[1] - self.load_n[0]);
                let slip = self.slip[0] + slip * (self.slip[1] - self.slip[0]);
                let entry_rad = loop {
                    match entry_for(soil, &self.wheel, load_n, slip, 0.0) {
                        Some(entry_rad) if entry_rad < 1.2 => break entry_rad,
                        _ => load_n *= 0.8,
                    }
                };
                let torque_nm = forces(soil, &self.wheel, entry_rad, 0.0, slip).torque_nm;
                let taken_ns = (rows.len() as f64 / self.rate_hz * 1e9) as u64;
                rows.push(self.measure([load_n, torque_nm, entry_rad, slip], taken_ns, &mut random));
            }
        }
        rows
    }

    fn measure(&self, truth: [f64; 4], taken_ns: u64, random: &mut Random) -> Measured {
        let [load_n, torque_nm, entry_rad, slip] = truth;
        let measured_slip = slip + self.noise.slip * random.normal();
        let entry = entry_rad + self.noise.entry_deg.to_radians() * random.normal();
        let header = Header {
            taken_ns,
            ..Header::default()
        };
        let angular_velocity_rad_s = 0.3;
        Measured {
            wheel: Wheel {
                header,
                load_n: load_n * (1.0 + self.noise.load * random.normal()),
                torque_nm: torque_nm * (1.0 + self.noise.torque * random.normal()),
                angular_velocity_rad_s,
                linear_velocity_m_s: self.wheel.radius_m * angular_velocity_rad_s * (1.0 - measured_slip),
                slip: f64::NAN,
            },
            sinkage: Sinkage {
                entry_rad: entry,
                exit_rad: 0.0,
                sinkage_m: self.wheel.radius_m * (1.0 - entry.cos()),
                ..Sinkage::unknown(header)
            },
        }
    }
}

/// Load and slip along the way, as fractions of their ranges.
struct Drive {
    phases: [f64; 4],
    at: [f64; 2],
}

impl Drive {
    fn new(random: &mut Random) -> Self {
        let phases = [0; 4].map(|_| random.uniform(0.0, std::f64::consts::TAU));
        Self { phases, at: [0.5, 0.5] }
    }

    fn next(&mut self, excitation: Excitation, row: usize, random: &mut Random) -> [f64; 2] {
        match excitation {
            Excitation::Random => [random.uniform(0.0, 1.0), random.uniform(0.0, 1.0)],
            Excitation::Constant => [0.5, 0.5],
            Excitation::Smooth => {
                let at = row as f64;
                let wave = |period: f64, phase: f64| (std::f64::consts::TAU * at / period + phase).sin();
                [
                    0.5 + 0.33 * wave(61.0, self.phases[0]) + 0.17 * wave(17.0, self.phases[1]),
                    0.5 + 0.33 * wave(43.0, self.phases[2]) + 0.17 * wave(13.0, self.phases[3]),
                ]
            }
            Excitation::Walk => {
                for at in &mut self.at {
                    *at += 0.08 * random.normal();
                    // Reflected at the ends of the range.
                    *at = 1.0 - (1.0 - at.abs()).abs();
                }
                self.at
            }
        }
    }
}
