//! What the simulated rover drives on.

/// A soil: its parameters in the wheel–soil model, and how it looks and sounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Soil {
    /// Its name, which is also its class.
    pub name: &'static str,
    /// Cohesion c.
    pub cohesion_pa: f64,
    /// Friction angle φ.
    pub friction_rad: f64,
    /// Shear deformation modulus k of Janosi.
    pub shear_modulus_m: f64,
    /// Cohesive modulus kc of Bekker [N/m^(n+1)].
    pub cohesive_modulus: f64,
    /// Frictional modulus kφ of Bekker [N/m^(n+2)].
    pub frictional_modulus: f64,
    /// Sinkage exponent n of Bekker.
    pub sinkage_exponent: f64,
    /// Where the normal stress is greatest: θm = (c1 + c2 i) θ1.
    pub peak: [f64; 2],
    /// Mean gray value in a picture.
    pub brightness: f64,
    /// Contrast of its grain in a picture, in gray values.
    pub grain: f64,
    /// Level of the vibration at 5 cm/s [m/s²].
    pub vibration_m_s2: f64,
    /// Exponent with which the vibration falls with frequency.
    pub vibration_slope: f64,
    /// Frequency that the vibration prefers [Hz].
    pub vibration_peak_hz: f64,
}

/// The soils of the route. c, φ, k and the moduli: Wong (2001) and, for the first two, Figures 10 and 11 of the paper.
pub const SOILS: [Soil; 3] = [
    Soil {
        name: "dry_sand",
        cohesion_pa: 2500.0,
        friction_rad: 27.0 * DEGREE_RAD,
        shear_modulus_m: 0.025,
        cohesive_modulus: 990.0,
        frictional_modulus: 1_528_430.0,
        sinkage_exponent: 1.1,
        peak: [0.18, 0.32],
        brightness: 168.0,
        grain: 14.0,
        vibration_m_s2: 0.10,
        vibration_slope: 1.1,
        vibration_peak_hz: 9.0,
    },
    Soil {
        name: "bentonite",
        cohesion_pa: 700.0,
        friction_rad: 32.1 * DEGREE_RAD,
        shear_modulus_m: 0.020,
        cohesive_modulus: 990.0,
        frictional_modulus: 1_528_430.0,
        sinkage_exponent: 1.1,
        peak: [0.30, 0.32],
        brightness: 205.0,
        grain: 6.0,
        vibration_m_s2: 0.055,
        vibration_slope: 1.6,
        vibration_peak_hz: 5.0,
    },
    Soil {
        name: "sandy_loam",
        cohesion_pa: 1720.0,
        friction_rad: 29.0 * DEGREE_RAD,
        shear_modulus_m: 0.025,
        cohesive_modulus: 5270.0,
        frictional_modulus: 1_515_040.0,
        sinkage_exponent: 0.7,
        peak: [0.18, 0.32],
        brightness: 140.0,
        grain: 20.0,
        vibration_m_s2: 0.25,
        vibration_slope: 0.6,
        vibration_peak_hz: 22.0,
    },
];

const DEGREE_RAD: f64 = std::f64::consts::PI / 180.0;
