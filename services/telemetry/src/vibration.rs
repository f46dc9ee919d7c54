//! `vibration.csv` or `vibration.wav`: all channels at one instant, row by row.

use hound::{SampleFormat, WavReader};
use messages::{CHANNELS_MAX, LABEL_BYTES};
use std::collections::VecDeque;
use traverse::{Input, InputError, SOUND_CHANNELS, Table, Traverse, sampling_period_ns};

/// Endings of a channel's name.
const UNITS: [&str; 11] = [
    "_m_s2", "_rad_s2", "_m_s", "_rad_s", "_m", "_rad", "_n", "_nm", "_pa", "_v", "_a",
];
/// Rows from which the sampling period of a table is found.
const PERIOD_ROWS: usize = 1024;
/// The sampling period where a single row leaves it open [ns].
const PERIOD_DEFAULT_NS: u64 = 10_000_000;
/// Largest amount of a sample.
const SAMPLE_MAX: f64 = 1e9;

/// All channels at one instant; NaN where a value is missing.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instant {
    pub(crate) taken_ns: u64,
    pub(crate) values: [f32; CHANNELS_MAX],
}

/// The instants of a vibration recording.
pub(crate) struct VibrationRows {
    /// The channels' names.
    pub(crate) channels: Vec<String>,
    /// Nominal time from one instant to the next.
    pub(crate) period_ns: u64,
    source: Source,
    ahead: VecDeque<Instant>,
}

enum Source {
    Table(Table),
    Sound(Sound),
}

impl VibrationRows {
    /// Opens a sound file where the name ends so, else a table.
    pub(crate) fn open(file: &str, input: Input, traverse: &Traverse) -> Result<Self, InputError> {
        match file.ends_with(".wav") {
            true => Self::open_sound(file, input, traverse),
            false => Self::open_table(file, input),
        }
    }

    /// Opens `vibration.csv`: `taken_s`, and a column for each channel.
    fn open_table(file: &str, input: Input) -> Result<Self, InputError> {
        let mut table = Table::open(file, input)?;
        if !table.names().iter().any(|name| name == "taken_s") {
            return Err(table.fault("column \"taken_s\" is missing; the others are the channels, unit in the name"));
        }
        let channels: Vec<String> = table
            .names()
            .iter()
            .filter(|name| *name != "taken_s")
            .cloned()
            .collect();
        check_channels(&channels).map_err(|what| InputError::new(file, 1, what))?;
        let columns: Vec<&str> = ["taken_s"]
            .into_iter()
            .chain(channels.iter().map(String::as_str))
            .collect();
        table.bind(&columns, &[])?;
        let mut rows = Self {
            channels,
            period_ns: PERIOD_DEFAULT_NS,
            source: Source::Table(table),
            ahead: VecDeque::with_capacity(PERIOD_ROWS),
        };
        while rows.ahead.len() < PERIOD_ROWS {
            let Some(instant) = rows.read()? else { break };
            rows.ahead.push_back(instant);
        }
        let times: Vec<u64> = rows.ahead.iter().map(|instant| instant.taken_ns).collect();
        rows.period_ns = period_ns(&times);
        Ok(rows)
    }

    /// Opens `vibration.wav`, whose start, scale and channels stand in `traverse.toml`.
    fn open_sound(file: &str, input: Input, traverse: &Traverse) -> Result<Self, InputError> {
        let (sound, channels) = Sound::open(file, input, traverse)?;
        check_channels(&channels).map_err(|what| InputError::new(file, 0, what))?;
        Ok(Self {
            channels,
            period_ns: sound.instant_ns(1) - sound.instant_ns(0),
            source: Source::Sound(sound),
            ahead: VecDeque::new(),
        })
    }

    pub(crate) fn next_row(&mut self) -> Result<Option<Instant>, InputError> {
        match self.ahead.pop_front() {
            Some(instant) => Ok(Some(instant)),
            None => self.read(),
        }
    }

    fn read(&mut self) -> Result<Option<Instant>, InputError> {
        let count = self.channels.len();
        match &mut self.source {
            Source::Sound(sound) => sound.next_row(count),
            Source::Table(table) => {
                if !table.next_row()? {
                    return Ok(None);
                }
                let mut instant = Instant {
                    taken_ns: table.taken_ns(0)?,
                    values: [f32::NAN; CHANNELS_MAX],
                };
                for (index, value) in instant.values.iter_mut().take(count).enumerate() {
                    *value = table.number(1 + index, -SAMPLE_MAX..=SAMPLE_MAX)? as f32;
                }
                Ok(Some(instant))
            }
        }
    }
}

/// A sound file of any sample format.
struct Sound {
    file: String,
    reader: WavReader<Input>,
    start_ns: u64,
    scale: f64,
    index: u64,
}

impl Sound {
    fn open(file: &str, input: Input, traverse: &Traverse) -> Result<(Self, Vec<String>), InputError> {
        let fault = |what: String| Err(InputError::new(file, 0, what));
        let Some(description) = &traverse.vibration else {
            return fault(
                "needs [vibration] start_s and scale (of full scale, in the channels' unit) in traverse.toml".into(),
            );
        };
        let reader = match WavReader::new(input) {
            Ok(reader) => reader,
            Err(error) => return fault(format!("not a sound WAV file: {error}; write it as PCM or float")),
        };
        let (spec, length) = (reader.spec(), reader.duration());
        let count = usize::from(spec.channels);
        if !(1..=1_000_000).contains(&spec.sample_rate) || length == 0 {
            return fault(format!(
                "{length} samples at {} Hz; it must hold some, at up to 1 MHz",
                spec.sample_rate
            ));
        }
        let channels = match (&description.channels, count) {
            (Some(names), _) => names.clone(),
            (None, 1) => vec![SOUND_CHANNELS[2].into()],
            (None, _) => SOUND_CHANNELS.iter().take(count).map(|name| (*name).into()).collect(),
        };
        let guessed_wrong = description.channels.is_none() && ![1, 3, 6].contains(&count);
        if guessed_wrong || channels.len() != count {
            return fault(format!(
                "has {count} channels; name each in traverse.toml, [vibration] channels = […]"
            ));
        }
        let sound = Self {
            file: file.into(),
            reader,
            start_ns: (description.start_s * 1e9).round() as u64,
            scale: description.scale,
            index: 0,
        };
        Ok((sound, channels))
    }

    /// The instant of a sample: start + index / rate.
    fn instant_ns(&self, index: u64) -> u64 {
        let rate = u128::from(self.reader.spec().sample_rate);
        let elapsed_ns = (u128::from(index) * 1_000_000_000 + rate / 2) / rate;
        self.start_ns
            .saturating_add(u64::try_from(elapsed_ns).unwrap_or(u64::MAX))
    }

    fn next_row(&mut self, count: usize) -> Result<Option<Instant>, InputError> {
        if self.index >= u64::from(self.reader.duration()) {
            return Ok(None);
        }
        let mut instant = Instant {
            taken_ns: self.instant_ns(self.index),
            values: [f32::NAN; CHANNELS_MAX],
        };
        for value in instant.values.iter_mut().take(count) {
            let sample = self.next_sample()? * self.scale;
            if sample.abs() > SAMPLE_MAX {
                let what = format!("sample {} is {sample:e}; at most {SAMPLE_MAX:e}", self.index);
                return Err(InputError::new(&self.file, 0, what));
            }
            *value = sample as f32;
        }
        self.index += 1;
        Ok(Some(instant))
    }

    /// The next sample of the next channel, full scale being 1.
    fn next_sample(&mut self) -> Result<f64, InputError> {
        let spec = self.reader.spec();
        let sample = match spec.sample_format {
            SampleFormat::Float => self.reader.samples::<f32>().next().map(|sample| sample.map(f64::from)),
            SampleFormat::Int => {
                let full_scale = 2_f64.powi(i32::from(spec.bits_per_sample) - 1);
                let sample = self.reader.samples::<i32>().next();
                sample.map(|sample| sample.map(|sample| f64::from(sample) / full_scale))
            }
        };
        match sample {
            Some(Ok(sample)) => Ok(sample),
            _ => {
                let promised = self.reader.duration();
                let what = format!(
                    "is cut off at sample {} of {promised}; copy it again from its source",
                    self.index
                );
                Err(InputError::new(&self.file, 0, what))
            }
        }
    }
}

/// The nominal period of a table's instants.
fn period_ns(times: &[u64]) -> u64 {
    sampling_period_ns(times).map_or(PERIOD_DEFAULT_NS, |period_ns| {
        (period_ns.round() as u64).clamp(1, 10_000_000_000)
    })
}

/// Names that a piece of vibration can carry, and from which a reader can tell the unit.
fn check_channels(channels: &[String]) -> Result<(), String> {
    if !(1..=CHANNELS_MAX).contains(&channels.len()) {
        return Err(format!(
            "{} channels; there must be 1 to {CHANNELS_MAX}, one a column",
            channels.len()
        ));
    }
    for (index, name) in channels.iter().enumerate() {
        let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_';
        let has_unit = UNITS.iter().any(|unit| name.len() > unit.len() && name.ends_with(unit));
        if !name.bytes().all(plain) || !has_unit || name.len() > LABEL_BYTES {
            let units = UNITS.join(" ");
            return Err(format!(
                "channel {name:?}: write at most {LABEL_BYTES} of a-z, 0-9 and _, the unit at the end ({units}), such as \
                 acceleration_z_m_s2"
            ));
        }
        if channels[..index].contains(name) {
            return Err(format!("channel {name:?} is there twice; rename one"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_period_is_never_zero() {
        assert_eq!(period_ns(&[]), PERIOD_DEFAULT_NS);
        assert_eq!(period_ns(&[5]), PERIOD_DEFAULT_NS);
        assert_eq!(period_ns(&[5, 5, 5]), PERIOD_DEFAULT_NS);
        assert_eq!(period_ns(&[0, u64::MAX]), 10_000_000_000);
    }

    #[test]
    fn a_channels_name_ends_with_its_unit() {
        let check = |names: &[&str]| check_channels(&names.iter().map(|name| (*name).into()).collect::<Vec<String>>());
        assert!(check(&["acceleration_x_m_s2", "linear_velocity_m_s"]).is_ok());
        for bad in [
            &["acceleration_x"][..],
            &["_m_s2"],
            &["Acceleration_m_s2"],
            &["acceleration_of_the_body_m_s2"],
            &["a_m_s2", "a_m_s2"],
            &[],
            &["a_v"; 9],
        ] {
            assert!(check(bad).is_err(), "{bad:?}");
        }
    }
}
