//! What the wheel feels: load, torque and how it turns and travels.

use crate::ZeroCopySend;
use crate::{Field, Header, Kind, Message, Status, within_or_missing};
use std::mem::offset_of;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// One reading of a wheel's telemetry. NaN is a value that was not measured; the status is then `INCOMPLETE`.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout, ZeroCopySend)]
#[repr(C)]
#[type_name("terrasense/Wheel/1")]
pub struct Wheel {
    /// What every sample starts with.
    pub header: Header,
    /// Vertical load W.
    pub load_n: f64,
    /// Axle torque T, net of gearbox friction.
    pub torque_nm: f64,
    /// Angular velocity ω, positive forward.
    pub angular_velocity_rad_s: f64,
    /// Linear velocity V of the axle, positive forward.
    pub linear_velocity_m_s: f64,
    /// Slip i as the vehicle reports it; NaN where it does not: then it follows from V and ω.
    pub slip: f64,
}

const _: () = assert!(size_of::<Wheel>() == 72);
const _: () = assert!(crate::covers(Wheel::FIELDS, size_of::<Wheel>()));

impl Message for Wheel {
    const NAME: &'static str = "Wheel/1";
    const FIELDS: &'static [Field] = &[
        Field::new("header", offset_of!(Self, header), Kind::Header),
        Field::new("load_n", offset_of!(Self, load_n), Kind::F64),
        Field::new("torque_nm", offset_of!(Self, torque_nm), Kind::F64),
        Field::new(
            "angular_velocity_rad_s",
            offset_of!(Self, angular_velocity_rad_s),
            Kind::F64,
        ),
        Field::new("linear_velocity_m_s", offset_of!(Self, linear_velocity_m_s), Kind::F64),
        Field::new("slip", offset_of!(Self, slip), Kind::F64),
    ];

    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn check_values(&self) -> Result<(), &'static str> {
        let values = [
            self.load_n,
            self.torque_nm,
            self.angular_velocity_rad_s,
            self.linear_velocity_m_s,
        ];
        if !values.iter().all(|value| within_or_missing(*value, -1e6, 1e6)) {
            return Err("a wheel value is infinite or out of range");
        }
        if !within_or_missing(self.slip, -1e3, 1e3) {
            return Err("the slip is infinite or out of range");
        }
        if self.header.status == Status::OK && values.iter().any(|value| value.is_nan()) {
            return Err("a wheel value is NaN, but the status is ok");
        }
        Ok(())
    }
}
