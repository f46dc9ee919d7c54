//! One row of measurements: the wheel's telemetry and the sinkage of one instant, joined and checked.

use crate::{Config, ExitAngle};
use messages::{Sinkage, Soil, Status, Wheel};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Wheel readings kept between two sinkage samples; of more, the newest count.
const READINGS_MAX: usize = 16;
/// A reading this many standard deviations from the median of its neighbours is a spike.
const SPIKE_SIGMAS: f64 = 5.0;
/// Slower than this the wheel stands.
const ANGULAR_VELOCITY_MIN_RAD_S: f64 = 1e-3;
/// Slip that the model covers; a little below 0, so that noise at small slip is not cut off on one side.
const SLIP_MIN: f64 = -0.1;
const SLIP_MAX: f64 = 0.97;
/// A reported slip may differ by so many standard deviations, or by so many of these, from the one that V and ω give.
const SLIP_SIGMAS: f64 = 4.0;
const SLIP_SIGMA_MIN: f64 = 0.01;
/// Below this entry angle the wheel rolls on hard ground.
const ENTRY_MIN_RAD: f64 = 0.06;
/// Beyond this the wheel has sunk to its axle.
const ENTRY_MAX_RAD: f64 = 1.5;

/// One operating point of the wheel, as measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Row {
    /// Load W.
    pub load_n: f64,
    /// Torque T.
    pub torque_nm: f64,
    /// Entry angle θ1.
    pub entry_rad: f64,
    /// Exit angle θ2, 0 or negative.
    pub exit_rad: f64,
    /// Slip i.
    pub slip: f64,
    /// Standard deviation of the entry angle.
    pub entry_sigma_rad: f64,
    /// Variance of load, torque and slip against that of one reading: 1 for one reading, less for an average.
    pub variance_share: f64,
}

/// The wheel's readings since the last sinkage sample.
#[derive(Clone, Copy, Debug, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Wheels {
    readings: [Reading; READINGS_MAX],
    /// At most [`READINGS_MAX`].
    count: u64,
}

/// A reading of the wheel, or why it cannot be used.
#[derive(Clone, Copy, Debug, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct Reading {
    taken_ns: u64,
    load_n: f64,
    torque_nm: f64,
    slip: f64,
    /// One of the reasons of [`Soil`].
    reason: u32,
    _padding: u32,
}

impl Row {
    /// The row at the instant of `sinkage`.
    ///
    /// # Errors
    /// Why there is none: one of the reasons of [`Soil`].
    pub fn join(sinkage: &Sinkage, wheels: &mut Wheels, config: &Config) -> Result<Self, u32> {
        let wheel = wheels.take(sinkage.header.taken_ns, config);
        // Of a measurement without an exit angle the entry angle is good.
        let status = sinkage.header.status;
        if !status.is_answer() && status != Status::INCOMPLETE {
            return Err(Soil::NO_SINKAGE);
        }
        let (wheel, readings) = wheel?;
        let mut sigma_rad = sinkage.entry_sigma_rad;
        if !(sigma_rad > 0.0 && sigma_rad.is_finite()) {
            sigma_rad = config.entry_sigma_rad;
        }
        let entry_rad = to_grouser_tips(sinkage.entry_rad, config);
        if !entry_rad.is_finite() || entry_rad > ENTRY_MAX_RAD {
            return Err(Soil::NO_SINKAGE);
        }
        if entry_rad < ENTRY_MIN_RAD {
            return Err(Soil::HARD_GROUND);
        }
        Ok(Self {
            load_n: wheel.load_n,
            torque_nm: wheel.torque_nm,
            entry_rad,
            exit_rad: match config.exit_angle {
                ExitAngle::Measured if sinkage.exit_rad < 0.0 => sinkage.exit_rad.max(-entry_rad),
                ExitAngle::Measured | ExitAngle::Zero => 0.0,
            },
            slip: wheel.slip,
            entry_sigma_rad: sigma_rad,
            variance_share: 1.0 / f64::from(readings),
        })
    }
}

impl Default for Wheels {
    fn default() -> Self {
        Self {
            readings: [Reading::default(); READINGS_MAX],
            count: 0,
        }
    }
}

impl Wheels {
    /// Keeps a reading for the next sinkage sample.
    pub fn observe(&mut self, wheel: &Wheel, config: &Config) {
        if wheel.header.status != Status::OK && wheel.header.status != Status::INCOMPLETE {
            return;
        }
        let mut count = self.count();
        if count == READINGS_MAX {
            self.readings.rotate_left(1);
            count -= 1;
        }
        self.readings[count] = Reading::new(wheel, config);
        self.count = count as u64 + 1;
    }

    /// Readings kept.
    fn count(&self) -> usize {
        self.count.min(READINGS_MAX as u64) as usize
    }

    /// The wheel at `taken_ns`, and how many readings it is the mean of.
    ///
    /// A reading is used once: sinkage samples that come faster than readings do not repeat its error. Where several came
    /// since the last sinkage sample, motion is smooth over their short span, and their mean has less noise than the last.
    fn take(&mut self, taken_ns: u64, config: &Config) -> Result<(Reading, u32), u32> {
        let readings = &self.readings[..self.count()];
        self.count = 0;
        let Some(newest) = readings.last() else {
            return Err(Soil::NO_WHEEL);
        };
        if seconds_between(newest.taken_ns, taken_ns) > config.wheel_age_max_s {
            return Err(Soil::NO_WHEEL);
        }
        if newest.reason != Soil::USED {
            return Err(newest.reason);
        }
        Ok(mean(readings, newest, config))
    }
}

impl Reading {
    fn new(wheel: &Wheel, config: &Config) -> Self {
        let (slip, reason) = match slip(wheel, config) {
            Ok(slip) => (slip, Soil::USED),
            Err(reason) => (f64::NAN, reason),
        };
        let usable = wheel.load_n > 0.0 && wheel.torque_nm > 0.0 && (wheel.load_n * wheel.torque_nm).is_finite();
        Self {
            taken_ns: wheel.header.taken_ns,
            load_n: wheel.load_n,
            torque_nm: wheel.torque_nm,
            slip,
            _padding: 0,
            reason: if reason == Soil::USED && !usable {
                Soil::LOAD
            } else {
                reason
            },
        }
    }
}

/// Slip i as reported, else 1 − V/(r ω).
fn slip(wheel: &Wheel, config: &Config) -> Result<f64, u32> {
    let (omega, v) = (wheel.angular_velocity_rad_s, wheel.linear_velocity_m_s);
    if omega < ANGULAR_VELOCITY_MIN_RAD_S {
        return Err(Soil::STOPPED);
    }
    let computed = 1.0 - v / (config.effective_radius_m() * omega);
    if (wheel.slip - computed).abs() > SLIP_SIGMAS * config.slip_sigma.max(SLIP_SIGMA_MIN) {
        return Err(Soil::SLIP);
    }
    let slip = if wheel.slip.is_nan() { computed } else { wheel.slip };
    if (SLIP_MIN..=SLIP_MAX).contains(&slip) {
        Ok(slip)
    } else {
        Err(Soil::SLIP)
    }
}

/// The mean of the usable readings within the averaging span of the newest, spikes left out.
fn mean(readings: &[Reading], newest: &Reading, config: &Config) -> (Reading, u32) {
    let mut recent = [Reading::default(); READINGS_MAX];
    let mut count = 0;
    for reading in readings {
        let near = seconds_between(reading.taken_ns, newest.taken_ns) <= config.averaging_s;
        if near && reading.reason == Soil::USED {
            recent[count] = *reading;
            count += 1;
        }
    }
    let recent = &mut recent[..count];
    let load_n = median(recent, |reading| reading.load_n);
    let torque_nm = median(recent, |reading| reading.torque_nm);
    let slip = median(recent, |reading| reading.slip);
    let mut sum = Reading {
        taken_ns: newest.taken_ns,
        ..Reading::default()
    };
    let mut used = 0;
    for reading in recent.iter() {
        let spike = (reading.load_n / load_n - 1.0).abs() > SPIKE_SIGMAS * config.load_sigma
            || (reading.torque_nm / torque_nm - 1.0).abs() > SPIKE_SIGMAS * config.torque_sigma
            || (reading.slip - slip).abs() > SPIKE_SIGMAS * config.slip_sigma;
        if count <= 2 || !spike {
            sum.load_n += reading.load_n;
            sum.torque_nm += reading.torque_nm;
            sum.slip += reading.slip;
            used += 1;
        }
    }
    if used == 0 {
        return (*newest, 1);
    }
    let share = 1.0 / f64::from(used);
    (
        Reading {
            load_n: sum.load_n * share,
            torque_nm: sum.torque_nm * share,
            slip: sum.slip * share,
            ..sum
        },
        used,
    )
}

/// The (upper) median of one quantity. `readings` comes back sorted by it.
fn median(readings: &mut [Reading], of: impl Fn(&Reading) -> f64) -> f64 {
    readings.sort_unstable_by(|a, b| of(a).total_cmp(&of(b)));
    readings.get(readings.len() / 2).map_or(f64::NAN, of)
}

/// The entry angle at the radius of the grousers' tips, which reach deeper than the rim by their height.
fn to_grouser_tips(entry_rad: f64, config: &Config) -> f64 {
    if config.grouser_height_m == 0.0 || entry_rad <= 0.0 {
        return entry_rad;
    }
    let sinkage_m = config.radius_m * (1.0 - entry_rad.cos());
    (1.0 - (sinkage_m + config.grouser_height_m) / config.effective_radius_m()).acos()
}

fn seconds_between(earlier_ns: u64, later_ns: u64) -> f64 {
    later_ns.abs_diff(earlier_ns) as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::Header;

    fn wheel(taken_ms: u64, load_n: f64) -> Wheel {
        Wheel {
            header: Header {
                taken_ns: taken_ms * 1_000_000,
                ..Header::default()
            },
            load_n,
            torque_nm: load_n / 20.0,
            angular_velocity_rad_s: 1.0,
            linear_velocity_m_s: 0.15 * 0.7,
            slip: f64::NAN,
        }
    }

    fn sinkage(taken_ms: u64, entry_rad: f64) -> Sinkage {
        let header = Header {
            taken_ns: taken_ms * 1_000_000,
            ..Header::default()
        };
        Sinkage {
            entry_rad,
            exit_rad: 0.0,
            sinkage_m: 0.01,
            ..Sinkage::unknown(header)
        }
    }

    fn join(readings: &[Wheel], sinkage: &Sinkage) -> Result<Row, u32> {
        let config = Config::default();
        let mut wheels = Wheels::default();
        for reading in readings {
            wheels.observe(reading, &config);
        }
        Row::join(sinkage, &mut wheels, &config)
    }

    #[test]
    fn one_reading_at_the_instant_is_used_as_it_is() {
        let row = join(&[wheel(100, 91.0)], &sinkage(100, 0.4)).unwrap();
        assert_eq!(
            (row.load_n, row.torque_nm, row.variance_share),
            (91.0, 91.0 / 20.0, 1.0)
        );
        assert!((row.slip - 0.3).abs() < 1e-12);
        assert_eq!(row.entry_sigma_rad, Config::default().entry_sigma_rad);
    }

    #[test]
    fn several_readings_are_averaged_without_the_spike() {
        let readings = [wheel(75, 90.0), wheel(80, 92.0), wheel(85, 900.0), wheel(95, 91.0)];
        let row = join(&readings, &sinkage(100, 0.4)).unwrap();
        assert!((row.load_n - 91.0).abs() < 1e-9, "{row:?}");
        assert!((row.variance_share - 1.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn readings_before_the_averaging_span_do_not_count() {
        let row = join(&[wheel(20, 50.0), wheel(90, 90.0)], &sinkage(100, 0.4)).unwrap();
        assert_eq!(row.load_n, 90.0);
    }

    #[test]
    fn a_reading_is_used_once_and_not_when_it_is_old() {
        let config = Config::default();
        let mut wheels = Wheels::default();
        wheels.observe(&wheel(100, 90.0), &config);
        assert!(Row::join(&sinkage(100, 0.4), &mut wheels, &config).is_ok());
        assert_eq!(Row::join(&sinkage(133, 0.4), &mut wheels, &config), Err(Soil::NO_WHEEL));
        assert_eq!(join(&[wheel(100, 90.0)], &sinkage(900, 0.4)), Err(Soil::NO_WHEEL));
    }

    #[test]
    fn what_cannot_be_used_says_why() {
        let good = sinkage(100, 0.4);
        assert_eq!(join(&[], &good), Err(Soil::NO_WHEEL));
        assert_eq!(join(&[wheel(100, 90.0)], &sinkage(100, 0.01)), Err(Soil::HARD_GROUND));
        let unseen = Sinkage::unknown(good.header.answer(Status::NOT_VISIBLE));
        assert_eq!(join(&[wheel(100, 90.0)], &unseen), Err(Soil::NO_SINKAGE));
        let stopped = Wheel {
            angular_velocity_rad_s: 0.0,
            ..wheel(100, 90.0)
        };
        assert_eq!(join(&[stopped], &good), Err(Soil::STOPPED));
        let contradictory = Wheel {
            slip: 0.6,
            ..wheel(100, 90.0)
        };
        assert_eq!(join(&[contradictory], &good), Err(Soil::SLIP));
        let spinning = Wheel {
            linear_velocity_m_s: 0.0,
            ..wheel(100, 90.0)
        };
        assert_eq!(join(&[spinning], &good), Err(Soil::SLIP));
        let lifted = Wheel {
            load_n: -2.0,
            ..wheel(100, 90.0)
        };
        assert_eq!(join(&[lifted], &good), Err(Soil::LOAD));
        let silent = Wheel {
            torque_nm: f64::NAN,
            ..wheel(100, 90.0)
        };
        assert_eq!(join(&[silent], &good), Err(Soil::LOAD));
    }

    #[test]
    fn grousers_reach_deeper_than_the_rim() {
        let config = Config {
            grouser_height_m: 0.01,
            ..Config::default()
        };
        let entry_rad = to_grouser_tips(0.4, &config);
        let depth_m = config.effective_radius_m() * (1.0 - entry_rad.cos());
        let sinkage_m = config.radius_m * (1.0 - 0.4_f64.cos());
        assert!((depth_m - sinkage_m - 0.01).abs() < 1e-12);
    }
}
