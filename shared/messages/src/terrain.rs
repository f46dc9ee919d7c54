//! All that is known of the ground after one estimation cycle.

use crate::ZeroCopySend;
use crate::{Field, Header, Kind, LABEL_BYTES, Label, Message, Status, label_text, within, within_or_missing};
use std::mem::offset_of;
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

/// Everything of one cycle in one sample: what is valid, and how old each part is. What is not known is NaN.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout, ZeroCopySend)]
#[repr(C)]
#[type_name("terrasense/Terrain/1")]
pub struct Terrain {
    /// What every sample starts with. `OK` where every part is valid, `INCOMPLETE` where some are.
    pub header: Header,
    /// Sinkage z.
    pub sinkage_m: f64,
    /// Its standard deviation.
    pub sinkage_sigma_m: f64,
    /// Entry angle θ1.
    pub entry_rad: f64,
    /// Its standard deviation.
    pub entry_sigma_rad: f64,
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
    /// Shear strength S at the operating pressure, Eq. (1).
    pub strength_pa: f64,
    /// Its standard deviation.
    pub strength_sigma_pa: f64,
    /// Operating pressure p.
    pub pressure_pa: f64,
    /// Slip i.
    pub slip: f64,
    /// Probability of the class.
    pub class_probability: f64,
    /// The discriminant d of Eq. (23).
    pub class_metric: f64,
    /// Age of the sinkage at this cycle's instant: 0 where it is of this cycle.
    pub sinkage_age_ns: u64,
    /// Age of the soil parameters at this cycle's instant.
    pub soil_age_ns: u64,
    /// Age of the class: from the end of its window to this cycle's instant.
    pub class_age_ns: u64,
    /// Status of the sinkage.
    pub sinkage_status: Status,
    /// Status of the soil parameters.
    pub soil_status: Status,
    /// Status of the class.
    pub class_status: Status,
    /// Which parts hold: the sum of [`Terrain::SINKAGE`], [`Terrain::SOIL`], [`Terrain::STRENGTH`], [`Terrain::CLASS`].
    pub valid: u32,
    /// The most probable class, an index into the model's classes.
    pub class: u32,
    /// 1 where the terrain is none of the known classes, or cannot be told.
    pub unknown: u32,
    /// The class's name.
    pub class_label: Label,
}

const _: () = assert!(size_of::<Terrain>() == 224);
const _: () = assert!(crate::covers(Terrain::FIELDS, size_of::<Terrain>()));

impl Terrain {
    /// The sinkage is valid.
    pub const SINKAGE: u32 = 1;
    /// Cohesion and friction angle are valid.
    pub const SOIL: u32 = 2;
    /// The strength at the operating pressure is valid.
    pub const STRENGTH: u32 = 4;
    /// The class is valid.
    pub const CLASS: u32 = 8;
    /// The age of a part that has never been there.
    pub const NEVER_NS: u64 = u64::MAX;

    /// A sample that knows nothing: `header`, NaN, and parts that have never been there.
    #[must_use]
    pub fn unknown(header: Header) -> Self {
        let mut sample = Self::new_zeroed();
        sample.header = header;
        for value in [
            &mut sample.sinkage_m,
            &mut sample.sinkage_sigma_m,
            &mut sample.entry_rad,
            &mut sample.entry_sigma_rad,
            &mut sample.cohesion_pa,
            &mut sample.cohesion_sigma_pa,
            &mut sample.friction_rad,
            &mut sample.friction_sigma_rad,
            &mut sample.cohesion_friction_covariance_pa_rad,
            &mut sample.strength_pa,
            &mut sample.strength_sigma_pa,
            &mut sample.pressure_pa,
            &mut sample.slip,
            &mut sample.class_probability,
            &mut sample.class_metric,
        ] {
            *value = f64::NAN;
        }
        for age in [
            &mut sample.sinkage_age_ns,
            &mut sample.soil_age_ns,
            &mut sample.class_age_ns,
        ] {
            *age = Self::NEVER_NS;
        }
        for status in [
            &mut sample.sinkage_status,
            &mut sample.soil_status,
            &mut sample.class_status,
        ] {
            *status = Status::NO_DATA;
        }
        sample.unknown = 1;
        sample
    }

    /// The name of the class; empty where there is none.
    #[must_use]
    pub fn class_text(&self) -> &str {
        label_text(&self.class_label)
    }
}

impl Message for Terrain {
    const NAME: &'static str = "Terrain/1";
    const FIELDS: &'static [Field] = &[
        Field::new("header", offset_of!(Self, header), Kind::Header),
        Field::new("sinkage_m", offset_of!(Self, sinkage_m), Kind::F64),
        Field::new("sinkage_sigma_m", offset_of!(Self, sinkage_sigma_m), Kind::F64),
        Field::new("entry_rad", offset_of!(Self, entry_rad), Kind::F64),
        Field::new("entry_sigma_rad", offset_of!(Self, entry_sigma_rad), Kind::F64),
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
        Field::new("slip", offset_of!(Self, slip), Kind::F64),
        Field::new("class_probability", offset_of!(Self, class_probability), Kind::F64),
        Field::new("class_metric", offset_of!(Self, class_metric), Kind::F64),
        Field::new("sinkage_age_ns", offset_of!(Self, sinkage_age_ns), Kind::U64),
        Field::new("soil_age_ns", offset_of!(Self, soil_age_ns), Kind::U64),
        Field::new("class_age_ns", offset_of!(Self, class_age_ns), Kind::U64),
        Field::new("sinkage_status", offset_of!(Self, sinkage_status), Kind::Status),
        Field::new("soil_status", offset_of!(Self, soil_status), Kind::Status),
        Field::new("class_status", offset_of!(Self, class_status), Kind::Status),
        Field::new("valid", offset_of!(Self, valid), Kind::U32),
        Field::new("class", offset_of!(Self, class), Kind::U32),
        Field::new("unknown", offset_of!(Self, unknown), Kind::U32),
        Field::new("class_label", offset_of!(Self, class_label), Kind::Text(LABEL_BYTES)),
    ];

    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn check_values(&self) -> Result<(), &'static str> {
        let values = [
            self.sinkage_m,
            self.entry_rad,
            self.cohesion_pa,
            self.friction_rad,
            self.strength_pa,
        ];
        if !values.iter().all(|value| within_or_missing(*value, -1e9, 1e9)) {
            return Err("a terrain value is infinite or out of range");
        }
        if self.valid & Self::SOIL != 0
            && !(within(self.cohesion_pa, -1e9, 1e9) && within(self.friction_rad, -2.0, 2.0))
        {
            return Err("cohesion or friction angle is missing, but marked as valid");
        }
        Ok(())
    }
}
