//! What kind of ground the vibration sounds like.

use crate::ZeroCopySend;
use crate::{Field, Header, Kind, LABEL_BYTES, Label, Message, label_text, within_or_missing};
use std::mem::offset_of;
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

/// Classes a model has at the most.
pub const CLASSES_MAX: usize = 16;

/// The class of the terrain, after one piece of vibration. Between two windows the last decision is repeated.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout, ZeroCopySend)]
#[repr(C)]
#[type_name("terrasense/TerrainClass/1")]
pub struct TerrainClass {
    /// What every sample starts with.
    pub header: Header,
    /// Sensor instant at which the classified window starts.
    pub start_ns: u64,
    /// Length of the window.
    pub window_ns: u64,
    /// The most probable class: an index into `labels`. It has a meaning also where `unknown` is 1.
    pub class: u32,
    /// Classes of the model, at most [`CLASSES_MAX`].
    pub class_count: u32,
    /// 1 where the terrain is none of the known classes, or cannot be told.
    pub unknown: u32,
    /// Windows classified so far.
    pub windows: u32,
    /// The discriminant d of Eq. (23), of the two most probable classes.
    pub metric: f64,
    /// Probability of each class; NaN where nothing was decided.
    pub probability: [f64; CLASSES_MAX],
    /// The names of the classes, from the model.
    pub labels: [Label; CLASSES_MAX],
}

const _: () = assert!(size_of::<TerrainClass>() == 72 + 16 * 8 + 16 * 24);
const _: () = assert!(crate::covers(TerrainClass::FIELDS, size_of::<TerrainClass>()));

impl TerrainClass {
    /// A sample that knows nothing.
    #[must_use]
    pub fn undecided(header: Header) -> Self {
        let mut sample = Self::new_zeroed();
        sample.header = header;
        sample.unknown = 1;
        sample.metric = f64::NAN;
        sample.probability = [f64::NAN; CLASSES_MAX];
        sample
    }

    /// The name of the most probable class; empty where there is none.
    #[must_use]
    pub fn class_text(&self) -> &str {
        let known = self.class < self.class_count;
        self.labels
            .get(self.class as usize)
            .filter(|_| known)
            .map_or("", |label| label_text(label))
    }
}

impl Message for TerrainClass {
    const NAME: &'static str = "TerrainClass/1";
    const FIELDS: &'static [Field] = &[
        Field::new("header", offset_of!(Self, header), Kind::Header),
        Field::new("start_ns", offset_of!(Self, start_ns), Kind::U64),
        Field::new("window_ns", offset_of!(Self, window_ns), Kind::U64),
        Field::new("class", offset_of!(Self, class), Kind::U32),
        Field::new("class_count", offset_of!(Self, class_count), Kind::U32),
        Field::new("unknown", offset_of!(Self, unknown), Kind::U32),
        Field::new("windows", offset_of!(Self, windows), Kind::U32),
        Field::new("metric", offset_of!(Self, metric), Kind::F64),
        Field::array("probability", offset_of!(Self, probability), Kind::F64, CLASSES_MAX),
        Field::array("labels", offset_of!(Self, labels), Kind::Text(LABEL_BYTES), CLASSES_MAX),
    ];

    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn check_values(&self) -> Result<(), &'static str> {
        if self.class_count as usize > CLASSES_MAX || (self.class_count > 0 && self.class >= self.class_count) {
            return Err("the class is none of the model's");
        }
        if !self
            .probability
            .iter()
            .all(|value| within_or_missing(*value, 0.0, 1.0 + 1e-9))
            || self.unknown > 1
        {
            return Err("a probability is outside 0 to 1");
        }
        if self.metric.is_infinite() {
            return Err("the metric is infinite");
        }
        Ok(())
    }
}
