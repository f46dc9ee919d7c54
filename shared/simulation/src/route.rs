//! Where the simulated rover drives, and how hard it works there.

use crate::soil::SOILS;

/// The rover's doing at one instant, before the soil has answered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Drive {
    /// Index into [`SOILS`].
    pub(crate) soil: usize,
    /// Vertical load of the wheel: the rover sways, and its other wheels take over.
    pub(crate) load_n: f64,
    /// Slip: the rover climbs and pulls.
    pub(crate) slip: f64,
    /// Pitch of the wheel's suspension.
    pub(crate) pitch_rad: f64,
}

/// Angular velocity of the wheel [rad/s]: the rover drives at a constant one.
pub(crate) const ANGULAR_VELOCITY_RAD_S: f64 = 0.5;
const TAU: f64 = std::f64::consts::TAU;

/// The drive at a time of a route that takes `route_s` and then starts over; each soil is a third of it.
pub(crate) fn drive(route_s: f64, time_s: f64) -> Drive {
    let share = (time_s / route_s).rem_euclid(1.0);
    let soil = ((share * SOILS.len() as f64) as usize).min(SOILS.len() - 1);
    // Load and slip sweep at rates that are no multiples of each other: only so can c and φ be told apart.
    let load_n = 90.0 + 28.0 * (TAU * time_s / 2.9).sin() + 12.0 * (TAU * time_s / 1.1).sin();
    let slip = 0.34 + 0.20 * (TAU * time_s / 2.1).sin() + 0.06 * (TAU * time_s / 0.83).sin();
    let pitch_rad = 0.03 * (TAU * time_s / 4.7).sin();
    Drive {
        soil,
        load_n,
        slip,
        pitch_rad,
    }
}
