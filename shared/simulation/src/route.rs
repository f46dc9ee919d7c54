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
const SLIP_MEAN: f64 = 0.34;
/// Amplitude and period [s] of each sweep of the slip.
const SLIP_SWEEPS: [(f64, f64); 2] = [(0.20, 2.1), (0.06, 0.83)];
const TAU: f64 = std::f64::consts::TAU;

/// The drive at a time of a route that takes `route_s` and then starts over; each soil is a third of it.
pub(crate) fn drive(route_s: f64, time_s: f64) -> Drive {
    let share = (time_s / route_s).rem_euclid(1.0);
    let soil = ((share * SOILS.len() as f64) as usize).min(SOILS.len() - 1);
    // Load and slip sweep at rates that are no multiples of each other: only so can c and φ be told apart.
    let load_n = 90.0 + 28.0 * (TAU * time_s / 2.9).sin() + 12.0 * (TAU * time_s / 1.1).sin();
    let slip = SLIP_MEAN
        + SLIP_SWEEPS
            .map(|(level, period_s)| level * (TAU * time_s / period_s).sin())
            .iter()
            .sum::<f64>();
    let pitch_rad = 0.03 * (TAU * time_s / 4.7).sin();
    Drive {
        soil,
        load_n,
        slip,
        pitch_rad,
    }
}

/// The way since the start, in wheel radii: what the wheel has turned, less its slip.
pub(crate) fn rolled_rad(time_s: f64) -> f64 {
    let sweep = |(level, period_s): (f64, f64)| level * period_s / TAU * (1.0 - (TAU * time_s / period_s).cos());
    let slipped_s = SLIP_MEAN * time_s + SLIP_SWEEPS.map(sweep).iter().sum::<f64>();
    ANGULAR_VELOCITY_RAD_S * (time_s - slipped_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_is_the_sum_of_the_speeds() {
        let step_s = 1e-3;
        let mut way_rad = 0.0;
        for tick in 0..7_000 {
            let middle_s = (f64::from(tick) + 0.5) * step_s;
            way_rad += step_s * ANGULAR_VELOCITY_RAD_S * (1.0 - drive(20.0, middle_s).slip);
        }
        assert!((rolled_rad(7.0) - way_rad).abs() < 1e-6);
    }
}
