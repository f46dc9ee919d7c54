//! `traverse.toml`: what the tables do not say, the wheel's size above all.

use crate::{Input, InputError};
use serde::Deserialize;
use std::io::Read;
use std::ops::RangeInclusive;

/// Length of a description at the most.
const TEXT_BYTES_MAX: u64 = 1 << 20;

/// The whole file. Every table may be absent; what a service then lacks is said by whoever starts it.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Traverse {
    /// The wheel.
    pub wheel: Option<Wheel>,
    /// What is assumed of the soil.
    #[serde(default)]
    pub soil: Soil,
    /// How good the sensors are.
    #[serde(default)]
    pub sensors: Sensors,
    /// How to read `vibration.wav`.
    pub vibration: Option<Vibration>,
}

/// The wheel.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wheel {
    /// Radius r, without grousers.
    pub radius_m: f64,
    /// Width b.
    pub width_m: f64,
    /// Height of the grousers.
    #[serde(default)]
    pub grouser_height_m: f64,
    /// To which side of the picture the wheel rolls.
    #[serde(default)]
    pub rolls: Rolls,
}

/// To which side of the picture the wheel rolls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rolls {
    /// To the left: the soil is entered on the picture's left.
    Left,
    /// To the right: the soil is entered on the picture's right.
    #[default]
    Right,
}

/// What is assumed of the soil.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Soil {
    /// Shear deformation modulus k.
    pub shear_modulus_m: Option<f64>,
}

/// How good the sensors are: standard deviations.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensors {
    /// Of the load, relative.
    pub load_sigma: Option<f64>,
    /// Of the torque, relative.
    pub torque_sigma: Option<f64>,
    /// Of the measured entry and exit angles of `sinkage.csv`.
    pub entry_sigma_rad: Option<f64>,
    /// Of the slip.
    pub slip_sigma: Option<f64>,
}

/// How to read `vibration.wav`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vibration {
    /// Instant of the first sample.
    #[serde(default)]
    pub start_s: f64,
    /// What full scale (1.0) means, in the channels' unit.
    pub scale: f64,
    /// The channels' names, units at the end. Left out, they are the accelerations (and angular rates) of 1, 3 or 6
    /// channels.
    pub channels: Option<Vec<String>>,
}

impl Traverse {
    /// The smallest file that is enough for every sensor but a sound file.
    pub const EXAMPLE: &str = "[wheel]\nradius_m = 0.15\nwidth_m = 0.16\n";

    /// Reads an open `traverse.toml`. `file` is the name that errors give.
    ///
    /// # Errors
    /// As [`Traverse::parse`], and where there is no file.
    pub fn read(file: &str, input: Option<Input>) -> Result<Self, InputError> {
        let Some(input) = input else {
            let what = format!("there is no such file; write one with at least:\n{}", Self::EXAMPLE);
            return Err(InputError::new(file, 0, what));
        };
        let mut text = String::new();
        match input.take(TEXT_BYTES_MAX).read_to_string(&mut text) {
            Ok(_) => Self::parse(file, &text),
            Err(error) => Err(InputError::new(file, 0, format!("cannot be read: {error}"))),
        }
    }

    /// Reads the text of a `traverse.toml`. `file` is the name that errors give.
    ///
    /// # Errors
    /// Where it is no TOML, names an unknown key, or gives a value that is out of range: with the line.
    pub fn parse(file: &str, text: &str) -> Result<Self, InputError> {
        let traverse: Self = toml::from_str(text).map_err(|error| {
            let line = error.span().map_or(0, |span| line_at(text, span.start));
            InputError::new(file, line, error.message().replace('\n', ", "))
        })?;
        for (table, key, value, range) in traverse.ranges() {
            if !range.contains(&value) {
                let line = line_of(text, table, key);
                let (low, high) = (range.start(), range.end());
                let what = format!("[{table}] {key} = {value:?} is out of range; it must lie in {low:?} to {high:?}");
                return Err(InputError::new(file, line, what));
            }
        }
        Ok(traverse)
    }

    /// Every number that was given, with the range in which it must lie.
    fn ranges(&self) -> Vec<(&'static str, &'static str, f64, RangeInclusive<f64>)> {
        let mut ranges = Vec::new();
        if let Some(wheel) = &self.wheel {
            ranges.push(("wheel", "radius_m", wheel.radius_m, 0.01..=10.0));
            ranges.push(("wheel", "width_m", wheel.width_m, 0.001..=10.0));
            ranges.push(("wheel", "grouser_height_m", wheel.grouser_height_m, 0.0..=1.0));
        }
        let optional = [
            ("soil", "shear_modulus_m", self.soil.shear_modulus_m, 1e-4..=1.0),
            ("sensors", "load_sigma", self.sensors.load_sigma, 1e-6..=1.0),
            ("sensors", "torque_sigma", self.sensors.torque_sigma, 1e-6..=1.0),
            ("sensors", "entry_sigma_rad", self.sensors.entry_sigma_rad, 1e-6..=1.0),
            ("sensors", "slip_sigma", self.sensors.slip_sigma, 1e-6..=1.0),
        ];
        for (table, key, value, range) in optional {
            ranges.extend(value.map(|value| (table, key, value, range)));
        }
        if let Some(vibration) = &self.vibration {
            ranges.push(("vibration", "start_s", vibration.start_s, 0.0..=1e10));
            ranges.push(("vibration", "scale", vibration.scale, 1e-9..=1e9));
        }
        ranges
    }
}

/// The line of a key, counted from 1; 0 where it is not there.
fn line_of(text: &str, table: &str, key: &str) -> u64 {
    let Ok(document) = toml::de::DeTable::parse(text) else {
        return 0;
    };
    let value = document.get_ref().get(table).and_then(|table| table.get_ref().get(key));
    value.map_or(0, |value| line_at(text, value.span().start))
}

/// The line of a byte, counted from 1.
fn line_at(text: &str, byte: usize) -> u64 {
    let before = text.as_bytes().iter().take(byte);
    before.filter(|byte| **byte == b'\n').count() as u64 + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_example_is_enough() {
        let traverse = Traverse::parse("traverse.toml", Traverse::EXAMPLE).unwrap();
        let wheel = traverse.wheel.unwrap();
        assert_eq!((wheel.radius_m, wheel.width_m), (0.15, 0.16));
        assert_eq!((wheel.rolls, wheel.grouser_height_m), (Rolls::Right, 0.0));
        assert_eq!(traverse.sensors, Sensors::default());
    }

    #[test]
    fn a_whole_file_is_read() {
        let text = "[wheel]\nradius_m = 0.15\nwidth_m = 0.16\nrolls = \"left\"\n[soil]\nshear_modulus_m = 0.025\n\
                    [sensors]\nload_sigma = 0.03\ntorque_sigma = 0.03\nentry_sigma_rad = 0.0175\nslip_sigma = 0.02\n\
                    [vibration]\nstart_s = 1.5\nscale = 19.6\nchannels = [\"acceleration_z_m_s2\"]\n";
        let traverse = Traverse::parse("traverse.toml", text).unwrap();
        assert_eq!(traverse.wheel.unwrap().rolls, Rolls::Left);
        assert_eq!(traverse.soil.shear_modulus_m, Some(0.025));
        assert_eq!(traverse.sensors.entry_sigma_rad, Some(0.0175));
        assert_eq!(traverse.vibration.unwrap().scale, 19.6);
    }

    #[test]
    fn errors_name_the_line() {
        for (text, expected) in [
            (
                "[wheel]\nradius_m = 0.15\nwidth = 0.16\n",
                "traverse.toml:3: unknown field `width`, expected one of `radius_m`, `width_m`, `grouser_height_m`, `rolls`",
            ),
            ("[wheel]\nradius_m = 0.15\n", "traverse.toml:1: missing field `width_m`"),
            (
                "[wheel]\n\nradius_m = -1\nwidth_m = 0.16\n",
                "traverse.toml:3: [wheel] radius_m = -1.0 is out of range; it must lie in 0.01 to 10.0",
            ),
            (
                "[wheel]\nradius_m = nan\nwidth_m = 0.16\n",
                "traverse.toml:2: [wheel] radius_m = NaN is out of range; it must lie in 0.01 to 10.0",
            ),
            (
                "[sensors]\nslip_sigma = 2.0\n",
                "traverse.toml:2: [sensors] slip_sigma = 2.0 is out of range; it must lie in 1e-6 to 1.0",
            ),
            (
                "[wheel]\nradius_m = 0.1\nwidth_m = 0.1\nrolls = \"up\"\n",
                "traverse.toml:4: unknown variant `up`, expected `left` or `right`",
            ),
        ] {
            assert_eq!(
                Traverse::parse("traverse.toml", text).unwrap_err().to_string(),
                expected
            );
        }
        let broken = Traverse::parse("traverse.toml", "[wheel\n").unwrap_err();
        assert_eq!(broken.line, 1);
    }

    #[test]
    fn no_text_makes_it_panic() {
        let text = "[wheel]\nradius_m = 0.15\nwidth_m = 0.16\n[vibration]\nscale = 1e3\nchannels = [\"é\"]\n";
        for end in (0..=text.len()).filter(|end| text.is_char_boundary(*end)) {
            let _ = Traverse::parse("traverse.toml", &text[..end]);
        }
    }
}
