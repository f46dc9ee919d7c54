//! What the rover hears: a piece of the body's or the wheel's vibration, several channels.

use crate::ZeroCopySend;
use crate::{Field, Header, Kind, LABEL_BYTES, Label, Message, within};
use std::mem::offset_of;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Channels a piece holds at the most.
pub const CHANNELS_MAX: usize = 8;
/// Samples of each channel a piece holds at the most.
pub const SAMPLES_MAX: usize = 256;

/// A piece of vibration. `header.taken_ns` is the end of the interval that it covers; one without samples
/// (`count` 0, status `NO_DATA`) says that the sensor was silent.
#[derive(Clone, Debug, FromBytes, IntoBytes, Immutable, KnownLayout, ZeroCopySend)]
#[repr(C)]
#[type_name("terrasense/Vibration/1")]
pub struct Vibration {
    /// What every sample starts with.
    pub header: Header,
    /// Sensor instant of the first sample.
    pub start_ns: u64,
    /// Nominal time from one sample to the next.
    pub period_ns: u64,
    /// Samples of each channel, at most [`SAMPLES_MAX`].
    pub count: u32,
    /// Channels, at most [`CHANNELS_MAX`].
    pub channel_count: u32,
    /// The channels' names, their units at the end: `acceleration_z_m_s2`, `linear_velocity_m_s`.
    pub channels: [Label; CHANNELS_MAX],
    /// Each sample's instant, from `start_ns`.
    pub offset_ns: [u32; SAMPLES_MAX],
    /// The samples, channel by channel; NaN where one was missing.
    pub samples: [[f32; SAMPLES_MAX]; CHANNELS_MAX],
}

const _: () = assert!(size_of::<Vibration>() == 56 + 24 * 8 + 4 * 256 * 9);
const _: () = assert!(crate::covers(Vibration::FIELDS, size_of::<Vibration>()));

impl Vibration {
    /// The samples of one channel; empty where there is no such channel.
    #[must_use]
    pub fn channel(&self, index: usize) -> &[f32] {
        let known = index < self.channel_count as usize;
        self.samples
            .get(index)
            .and_then(|all| all.get(..self.count as usize))
            .filter(|_| known)
            .unwrap_or(&[])
    }
}

impl Message for Vibration {
    const NAME: &'static str = "Vibration/1";
    const FIELDS: &'static [Field] = &[
        Field::new("header", offset_of!(Self, header), Kind::Header),
        Field::new("start_ns", offset_of!(Self, start_ns), Kind::U64),
        Field::new("period_ns", offset_of!(Self, period_ns), Kind::U64),
        Field::new("count", offset_of!(Self, count), Kind::U32),
        Field::new("channel_count", offset_of!(Self, channel_count), Kind::U32),
        Field::array(
            "channels",
            offset_of!(Self, channels),
            Kind::Text(LABEL_BYTES),
            CHANNELS_MAX,
        ),
        Field::array("offset_ns", offset_of!(Self, offset_ns), Kind::U32, SAMPLES_MAX),
        Field::array(
            "samples",
            offset_of!(Self, samples),
            Kind::F32,
            SAMPLES_MAX * CHANNELS_MAX,
        ),
    ];

    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn check_values(&self) -> Result<(), &'static str> {
        if self.count as usize > SAMPLES_MAX || self.channel_count as usize > CHANNELS_MAX {
            return Err("more samples or channels than a piece of vibration holds");
        }
        if self.count > 0 && !(1..=10_000_000_000).contains(&self.period_ns) {
            return Err("the sampling period is zero or longer than 10 s");
        }
        for index in 0..self.channel_count as usize {
            let fits = |value: &f32| value.is_nan() || within(f64::from(*value), -1e9, 1e9);
            if !self.channel(index).iter().all(fits) {
                return Err("a vibration sample is infinite or out of range");
            }
        }
        Ok(())
    }
}
