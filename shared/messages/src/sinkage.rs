//! How deep the wheel stands in the soil, as seen or measured.

use crate::ZeroCopySend;
use crate::{Field, Header, Kind, Message, within, within_or_missing};
use std::mem::offset_of;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The soil line at one wheel. Angles are measured from straight down. What is not known is NaN, and the status says why.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout, ZeroCopySend)]
#[repr(C)]
#[type_name("terrasense/Sinkage/1")]
pub struct Sinkage {
    /// What every sample starts with.
    pub header: Header,
    /// Angle at which the soil meets the wheel on the picture's left, positive.
    pub left_rad: f64,
    /// Its standard deviation.
    pub left_sigma_rad: f64,
    /// Angle at which the soil meets the wheel on the picture's right, positive.
    pub right_rad: f64,
    /// Its standard deviation.
    pub right_sigma_rad: f64,
    /// Entry angle θ1, forward of straight down, positive.
    pub entry_rad: f64,
    /// Its standard deviation.
    pub entry_sigma_rad: f64,
    /// Exit angle θ2, negative behind straight down.
    pub exit_rad: f64,
    /// Its standard deviation.
    pub exit_sigma_rad: f64,
    /// Sinkage z = r (1 − cos θ1).
    pub sinkage_m: f64,
    /// Its standard deviation.
    pub sinkage_sigma_m: f64,
    /// Probability that the answer is right, 0 to 1.
    pub confidence: f64,
    /// Wheel centre as refined in the picture, column; NaN where it was not.
    pub center_x_px: f64,
    /// Wheel centre as refined in the picture, row; NaN where it was not.
    pub center_y_px: f64,
}

const _: () = assert!(size_of::<Sinkage>() == 136);
const _: () = assert!(crate::covers(Sinkage::FIELDS, size_of::<Sinkage>()));

impl Sinkage {
    /// A sample that knows nothing: `header`, and NaN everywhere else.
    #[must_use]
    pub fn unknown(header: Header) -> Self {
        Self {
            header,
            left_rad: f64::NAN,
            left_sigma_rad: f64::NAN,
            right_rad: f64::NAN,
            right_sigma_rad: f64::NAN,
            entry_rad: f64::NAN,
            entry_sigma_rad: f64::NAN,
            exit_rad: f64::NAN,
            exit_sigma_rad: f64::NAN,
            sinkage_m: f64::NAN,
            sinkage_sigma_m: f64::NAN,
            confidence: f64::NAN,
            center_x_px: f64::NAN,
            center_y_px: f64::NAN,
        }
    }
}

impl Message for Sinkage {
    const NAME: &'static str = "Sinkage/1";
    const FIELDS: &'static [Field] = &[
        Field::new("header", offset_of!(Self, header), Kind::Header),
        Field::new("left_rad", offset_of!(Self, left_rad), Kind::F64),
        Field::new("left_sigma_rad", offset_of!(Self, left_sigma_rad), Kind::F64),
        Field::new("right_rad", offset_of!(Self, right_rad), Kind::F64),
        Field::new("right_sigma_rad", offset_of!(Self, right_sigma_rad), Kind::F64),
        Field::new("entry_rad", offset_of!(Self, entry_rad), Kind::F64),
        Field::new("entry_sigma_rad", offset_of!(Self, entry_sigma_rad), Kind::F64),
        Field::new("exit_rad", offset_of!(Self, exit_rad), Kind::F64),
        Field::new("exit_sigma_rad", offset_of!(Self, exit_sigma_rad), Kind::F64),
        Field::new("sinkage_m", offset_of!(Self, sinkage_m), Kind::F64),
        Field::new("sinkage_sigma_m", offset_of!(Self, sinkage_sigma_m), Kind::F64),
        Field::new("confidence", offset_of!(Self, confidence), Kind::F64),
        Field::new("center_x_px", offset_of!(Self, center_x_px), Kind::F64),
        Field::new("center_y_px", offset_of!(Self, center_y_px), Kind::F64),
    ];

    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn check_values(&self) -> Result<(), &'static str> {
        let angles = [self.left_rad, self.right_rad, self.entry_rad, self.exit_rad];
        let rest = [
            self.left_sigma_rad,
            self.right_sigma_rad,
            self.entry_sigma_rad,
            self.exit_sigma_rad,
            self.sinkage_sigma_m,
            self.confidence,
        ];
        let pi = std::f64::consts::PI;
        if !angles.iter().all(|value| within_or_missing(*value, -pi, pi)) {
            return Err("an angle is infinite or beyond half a turn");
        }
        if !rest.iter().all(|value| within_or_missing(*value, 0.0, 1e3)) {
            return Err("a sigma or the confidence is infinite, negative or out of range");
        }
        if self.header.status.is_answer() && !(within(self.entry_rad, -pi, pi) && within(self.sinkage_m, -1e3, 1e3)) {
            return Err("the entry angle or the sinkage is missing, but the status says that it is known");
        }
        Ok(())
    }
}
