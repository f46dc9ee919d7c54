//! What the soil is made of, mechanically: cohesion, friction angle, strength.

use crate::ZeroCopySend;
use crate::{Field, Header, Kind, Message, within, within_or_missing};
use std::mem::offset_of;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The soil's estimated parameters after one cycle. What is not known is NaN, and the status says why.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout, ZeroCopySend)]
#[repr(C)]
#[type_name("terrasense/Soil/1")]
pub struct Soil {
    /// What every sample starts with.
    pub header: Header,
    /// Cohesion c.
    pub cohesion_pa: f64,
    /// Its standard deviation.
    pub cohesion_sigma_pa: f64,
    /// Friction angle φ.
    pub friction_rad: f64,
    /// Its standard deviation.
    pub friction_sigma_rad: f64,
    /// Covariance of c and φ.
    pub cohesion_friction_covariance_pa_rad: f64,
    /// Shear strength S = c + p tan φ at the operating pressure, Eq. (1).
    pub strength_pa: f64,
    /// Its standard deviation.
    pub strength_sigma_pa: f64,
    /// Operating pressure p ≈ W / (r b θ1).
    pub pressure_pa: f64,
    /// Shear deformation modulus k.
    pub shear_modulus_m: f64,
    /// Its standard deviation; 0 where k is taken as given.
    pub shear_modulus_sigma_m: f64,
    /// Sinkage exponent n.
    pub sinkage_exponent: f64,
    /// Its standard deviation.
    pub sinkage_exponent_sigma: f64,
    /// Slip i that this cycle was computed with.
    pub slip: f64,
    /// Innovation of this cycle's row in units of its standard deviation.
    pub normalized_innovation: f64,
    /// Rows that the estimate rests on, since the last reset.
    pub rows: u32,
    /// Changes of soil found so far.
    pub resets: u32,
    /// Rows left out since the last reset.
    pub rows_rejected: u32,
    /// Why this cycle's row was left out; see [`Soil::reason_word`].
    pub reason: u32,
}

const _: () = assert!(size_of::<Soil>() == 160);
const _: () = assert!(crate::covers(Soil::FIELDS, size_of::<Soil>()));

impl Soil {
    /// The row was used.
    pub const USED: u32 = 0;
    /// No sinkage was seen.
    pub const NO_SINKAGE: u32 = 1;
    /// No wheel reading near this instant.
    pub const NO_WHEEL: u32 = 2;
    /// The wheel stands still or turns backwards.
    pub const STOPPED: u32 = 3;
    /// The entry angle is about zero: hard ground.
    pub const HARD_GROUND: u32 = 4;
    /// The slip is outside what the model covers, or disagrees with V and ω.
    pub const SLIP: u32 = 5;
    /// Load or torque is outside what the model covers.
    pub const LOAD: u32 = 6;
    /// The row is too far from what was predicted.
    pub const OUTLIER: u32 = 7;
    /// The entry angle has not moved while the load did.
    pub const STUCK_ANGLE: u32 = 8;

    const REASONS: [&str; 9] = [
        "used",
        "no_sinkage",
        "no_wheel",
        "stopped",
        "hard_ground",
        "slip",
        "load",
        "outlier",
        "stuck_angle",
    ];

    /// The reason as a word, `None` for a number that has no meaning.
    #[must_use]
    pub fn reason_word(reason: u32) -> Option<&'static str> {
        Self::REASONS.get(reason as usize).copied()
    }

    /// A sample that knows nothing: `header`, and NaN everywhere else.
    #[must_use]
    pub fn unknown(header: Header) -> Self {
        Self {
            header,
            cohesion_pa: f64::NAN,
            cohesion_sigma_pa: f64::NAN,
            friction_rad: f64::NAN,
            friction_sigma_rad: f64::NAN,
            cohesion_friction_covariance_pa_rad: f64::NAN,
            strength_pa: f64::NAN,
            strength_sigma_pa: f64::NAN,
            pressure_pa: f64::NAN,
            shear_modulus_m: f64::NAN,
            shear_modulus_sigma_m: f64::NAN,
            sinkage_exponent: f64::NAN,
            sinkage_exponent_sigma: f64::NAN,
            slip: f64::NAN,
            normalized_innovation: f64::NAN,
            rows: 0,
            resets: 0,
            rows_rejected: 0,
            reason: Self::NO_SINKAGE,
        }
    }
}

impl Message for Soil {
    const NAME: &'static str = "Soil/1";
    const FIELDS: &'static [Field] = &[
        Field::new("header", offset_of!(Self, header), Kind::Header),
        Field::new("cohesion_pa", offset_of!(Self, cohesion_pa), Kind::F64),
        Field::new("cohesion_sigma_pa", offset_of!(Self, cohesion_sigma_pa), Kind::F64),
        Field::new("friction_rad", offset_of!(Self, friction_rad), Kind::F64),
        Field::new("friction_sigma_rad", offset_of!(Self, friction_sigma_rad), Kind::F64),
        Field::new(
            "cohesion_friction_covariance_pa_rad",
            offset_of!(Self, cohesion_friction_covariance_pa_rad),
            Kind::F64,
        ),
        Field::new("strength_pa", offset_of!(Self, strength_pa), Kind::F64),
        Field::new("strength_sigma_pa", offset_of!(Self, strength_sigma_pa), Kind::F64),
        Field::new("pressure_pa", offset_of!(Self, pressure_pa), Kind::F64),
        Field::new("shear_modulus_m", offset_of!(Self, shear_modulus_m), Kind::F64),
        Field::new(
            "shear_modulus_sigma_m",
            offset_of!(Self, shear_modulus_sigma_m),
            Kind::F64,
        ),
        Field::new("sinkage_exponent", offset_of!(Self, sinkage_exponent), Kind::F64),
        Field::new(
            "sinkage_exponent_sigma",
            offset_of!(Self, sinkage_exponent_sigma),
            Kind::F64,
        ),
        Field::new("slip", offset_of!(Self, slip), Kind::F64),
        Field::new(
            "normalized_innovation",
            offset_of!(Self, normalized_innovation),
            Kind::F64,
        ),
        Field::new("rows", offset_of!(Self, rows), Kind::U32),
        Field::new("resets", offset_of!(Self, resets), Kind::U32),
        Field::new("rows_rejected", offset_of!(Self, rows_rejected), Kind::U32),
        Field::new("reason", offset_of!(Self, reason), Kind::U32),
    ];

    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn check_values(&self) -> Result<(), &'static str> {
        let values = [
            self.cohesion_pa,
            self.friction_rad,
            self.strength_pa,
            self.pressure_pa,
            self.shear_modulus_m,
            self.sinkage_exponent,
        ];
        let sigmas = [
            self.cohesion_sigma_pa,
            self.friction_sigma_rad,
            self.strength_sigma_pa,
            self.shear_modulus_sigma_m,
            self.sinkage_exponent_sigma,
        ];
        if !values.iter().all(|value| within_or_missing(*value, -1e9, 1e9)) {
            return Err("a soil parameter is infinite or out of range");
        }
        if !sigmas.iter().all(|value| within_or_missing(*value, 0.0, 1e9)) {
            return Err("a sigma is infinite, negative or out of range");
        }
        if self.header.status.is_answer()
            && !(within(self.cohesion_pa, -1e9, 1e9) && within(self.friction_rad, -2.0, 2.0))
        {
            return Err("cohesion or friction angle is missing, but the status says that it is known");
        }
        Ok(())
    }
}
