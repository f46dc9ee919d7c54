//! What the rover's body does while it drives: noise whose spectrum is the soil's and whose level is the speed's.

use crate::Soil;
use crate::noise::{Stream, normal, uniform};

/// The channels of the simulated inertial unit, and the speed beside them.
pub const CHANNELS: [&str; 7] = [
    "acceleration_x_m_s2",
    "acceleration_y_m_s2",
    "acceleration_z_m_s2",
    "angular_rate_x_rad_s",
    "angular_rate_y_rad_s",
    "angular_rate_z_rad_s",
    "linear_velocity_m_s",
];

/// Tones of which a channel's noise is made.
const TONES: u64 = 20;
/// For this long the tones keep their phases and levels [s]; then others have faded in.
const BLOCK_S: f64 = 0.4;
/// The highest tone [Hz].
const HIGHEST_HZ: f64 = 48.0;
/// Each channel's share of the soil's level; those of the angular rates in rad/s for one m/s².
const GAINS: [f64; 6] = [0.6, 0.5, 1.0, 0.030, 0.040, 0.015];
/// White noise of the sensor, in the channel's unit.
const FLOORS: [f64; 6] = [0.01, 0.01, 0.01, 0.0005, 0.0005, 0.0005];
/// Gravity.
const GRAVITY_M_S2: f64 = 9.81;
/// The speed at which a soil's level holds.
const LEVEL_SPEED_M_S: f64 = 0.05;
/// How the level grows with speed.
const SPEED_EXPONENT: f64 = 0.7;

/// One sample of every channel.
pub(crate) fn sample(seed: u64, soil: &Soil, speed_m_s: f64, noise: f64, time_s: f64) -> [f32; 7] {
    let level = soil.vibration_m_s2 * (speed_m_s.abs() / LEVEL_SPEED_M_S).powf(SPEED_EXPONENT);
    let tick = (time_s * 1e5).round() as u64;
    let block = (time_s / BLOCK_S).floor();
    let fade = (time_s / BLOCK_S - block) * std::f64::consts::FRAC_PI_2;
    let mut channels = [0.0; 7];
    for (channel, gain) in GAINS.iter().enumerate() {
        // Two blocks overlap, with weights whose squares add up to one: the level stays.
        let now = tones(seed, soil, channel as u64, block as u64, time_s) * fade.cos();
        let next = tones(seed, soil, channel as u64, block as u64 + 1, time_s) * fade.sin();
        let floor = noise * FLOORS[channel] * normal(seed, Stream::VibrationFloor, 8 * tick + channel as u64);
        let rest = if channel == 2 { GRAVITY_M_S2 } else { 0.0 };
        channels[channel] = (rest + gain * level * (now + next) + floor) as f32;
    }
    channels[6] = speed_m_s as f32;
    channels
}

fn tones(seed: u64, soil: &Soil, channel: u64, block: u64, time_s: f64) -> f64 {
    let mut sum = 0.0;
    for tone in 0..TONES {
        let index = (block * 8 + channel) * TONES + tone;
        let place = (tone as f64 + uniform(seed, Stream::VibrationPhase, 2 * index + 1)) / TONES as f64;
        let frequency_hz = 1.0 + place * (HIGHEST_HZ - 1.0);
        let bump = (-((frequency_hz - soil.vibration_peak_hz) / 4.0).powi(2)).exp();
        let shape = (frequency_hz / 10.0).powf(-0.5 * soil.vibration_slope) * (0.6 + 1.4 * bump);
        let level = (-uniform(seed, Stream::VibrationLevel, index).ln()).sqrt();
        let phase = std::f64::consts::TAU * uniform(seed, Stream::VibrationPhase, 2 * index);
        sum += shape * level * (std::f64::consts::TAU * frequency_hz * time_s + phase).sin();
    }
    sum / (TONES as f64).sqrt()
}
