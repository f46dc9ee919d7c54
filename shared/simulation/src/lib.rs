//! The simulated rover: a pure function of (seed, time).
//!
//! Whoever asks for the same instant gets the same answer: `camera` and `telemetry` need not talk to each other, and a
//! service that starts again sees the world go on.

pub mod conditions;
mod forward;
mod noise;
mod picture;
mod route;
mod soil;
mod vibration;

pub use forward::{Contact, WheelModel};
pub use soil::{SOILS, Soil};
pub use vibration::CHANNELS;

use messages::{Frame, Header, PIXELS_MAX, Wheel};
use noise::{Stream, normal};
use picture::{Painter, Scene};
use serde::Deserialize;

/// How far behind the wheel the soil is seen to reach, as a share of the entry angle: the rut's edge.
const RUT_SHARE: f64 = 0.45;
/// Times beyond this [s], some 30 years, are taken for it; those before the start, and NaN, for the start.
const TIME_MAX_S: f64 = 1e9;

/// A simulated rover and its route.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Another seed, another noise.
    pub seed: u64,
    /// Duration of the route [s], which then starts over.
    pub route_s: f64,
    /// Sensor noise, as a multiple of the usual: load and torque 3 %, slip 0.02, pictures 2.5 gray values.
    pub noise: f64,
    /// Wheel radius.
    pub radius_m: f64,
    /// Wheel width.
    pub width_m: f64,
    /// Columns of a picture.
    pub picture_width_px: u32,
    /// Rows of a picture.
    pub picture_height_px: u32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 1,
            route_s: 20.0,
            noise: 1.0,
            radius_m: 0.15,
            width_m: 0.16,
            picture_width_px: 640,
            picture_height_px: 480,
        }
    }
}

impl Config {
    /// Whether the values make sense.
    ///
    /// # Errors
    /// The key, and what would be right.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        let numbers = [
            ("route_s", self.route_s, 1.0, 1e6),
            ("noise", self.noise, 0.0, 100.0),
            ("radius_m", self.radius_m, 0.01, 10.0),
            ("width_m", self.width_m, 0.01, 10.0),
        ];
        for (key, value, low, high) in numbers {
            if !(low..=high).contains(&value) {
                return Err((key, format!("must be {low} to {high}, is {value}")));
            }
        }
        let sides = [
            ("picture_width_px", self.picture_width_px),
            ("picture_height_px", self.picture_height_px),
        ];
        for (key, value) in sides {
            if !(64..=4096).contains(&value) {
                return Err((key, format!("must be 64 to 4096, is {value}")));
            }
        }
        if self.picture_width_px as usize * self.picture_height_px as usize > PIXELS_MAX {
            return Err((
                "picture_width_px",
                format!("times picture_height_px must be at most {PIXELS_MAX}"),
            ));
        }
        Ok(())
    }
}

/// A rover on its route.
pub struct Rover {
    config: Config,
    wheel: WheelModel,
    painter: Painter,
}

/// The truth at one instant, without noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Index into [`SOILS`].
    pub soil: usize,
    /// Vertical load W.
    pub load_n: f64,
    /// Torque T.
    pub torque_nm: f64,
    /// Drawbar pull.
    pub drawbar_pull_n: f64,
    /// Slip i.
    pub slip: f64,
    /// Angular velocity ω.
    pub angular_velocity_rad_s: f64,
    /// Linear velocity V.
    pub linear_velocity_m_s: f64,
    /// Entry angle θ1.
    pub entry_rad: f64,
    /// Angle at which the soil is seen to meet the wheel behind, negative: the rut's edge. The stresses end at 0.
    pub exit_rad: f64,
    /// Sinkage z = r (1 − cos θ1).
    pub sinkage_m: f64,
    /// Pitch of the wheel in the picture.
    pub pitch_rad: f64,
}

impl Rover {
    /// The rover of a validated configuration.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let wheel = WheelModel::new(config.radius_m, config.width_m);
        let painter = Painter::new(
            config.seed,
            config.picture_width_px,
            config.picture_height_px,
            config.noise,
        );
        Self { config, wheel, painter }
    }

    /// The soils of the route.
    #[must_use]
    pub fn soils(&self) -> &'static [Soil] {
        &SOILS
    }

    /// The truth at a time [s] from the start.
    #[must_use]
    pub fn state(&self, time_s: f64) -> State {
        let time_s = on_mission(time_s);
        let drive = route::drive(self.config.route_s, time_s);
        let contact = self.wheel.contact(&SOILS[drive.soil], drive.load_n, drive.slip);
        let angular_velocity_rad_s = route::ANGULAR_VELOCITY_RAD_S;
        State {
            soil: drive.soil,
            load_n: drive.load_n,
            torque_nm: contact.torque_nm,
            drawbar_pull_n: contact.drawbar_pull_n,
            slip: drive.slip,
            angular_velocity_rad_s,
            linear_velocity_m_s: self.config.radius_m * angular_velocity_rad_s * (1.0 - drive.slip),
            entry_rad: contact.entry_rad,
            exit_rad: -RUT_SHARE * contact.entry_rad,
            sinkage_m: self.config.radius_m * (1.0 - contact.entry_rad.cos()),
            pitch_rad: drive.pitch_rad,
        }
    }

    /// What the wheel's sensors read. The header is left for the caller.
    #[must_use]
    pub fn wheel(&self, time_s: f64) -> Wheel {
        let time_s = on_mission(time_s);
        let state = self.state(time_s);
        let tick = (time_s * 1e5).round() as u64;
        let noise = |stream| self.config.noise * normal(self.config.seed, stream, tick);
        let rim_m_s = self.config.radius_m * state.angular_velocity_rad_s;
        Wheel {
            header: Header::default(),
            load_n: state.load_n * (1.0 + 0.03 * noise(Stream::Load)),
            torque_nm: state.torque_nm * (1.0 + 0.03 * noise(Stream::Torque)),
            angular_velocity_rad_s: state.angular_velocity_rad_s * (1.0 + 0.002 * noise(Stream::Angular)),
            linear_velocity_m_s: state.linear_velocity_m_s + 0.02 * rim_m_s * noise(Stream::Linear),
            slip: f64::NAN,
        }
    }

    /// What the inertial unit reads: one sample of each of [`CHANNELS`].
    #[must_use]
    pub fn vibration(&self, time_s: f64) -> [f32; 7] {
        let time_s = on_mission(time_s);
        let drive = route::drive(self.config.route_s, time_s);
        let speed_m_s = self.config.radius_m * route::ANGULAR_VELOCITY_RAD_S * (1.0 - drive.slip);
        vibration::sample(
            self.config.seed,
            &SOILS[drive.soil],
            speed_m_s,
            self.config.noise,
            time_s,
        )
    }

    /// Draws what the camera sees, in place. The header is left for the caller.
    pub fn render(&self, time_s: f64, frame: &mut Frame) {
        let time_s = on_mission(time_s);
        let state = self.state(time_s);
        let soil = &SOILS[state.soil];
        let scene = Scene {
            time_ms: (time_s * 1e3).round() as u64,
            left_rad: -state.exit_rad,
            right_rad: state.entry_rad,
            pitch_rad: state.pitch_rad,
            wheel_angle_rad: state.angular_velocity_rad_s * time_s,
            travelled_m: self.config.radius_m * route::rolled_rad(time_s),
            radius_m: self.config.radius_m,
            soil_brightness: soil.brightness,
            soil_grain: soil.grain,
        };
        self.painter.paint(&scene, frame);
    }

    /// Wheel radius.
    #[must_use]
    pub fn radius_m(&self) -> f64 {
        self.config.radius_m
    }

    /// Wheel width.
    #[must_use]
    pub fn width_m(&self) -> f64 {
        self.config.width_m
    }

    /// The shear deformation modulus that an estimator is told: that of the first soil.
    #[must_use]
    pub fn shear_modulus_m(&self) -> f64 {
        SOILS[0].shear_modulus_m
    }
}

fn on_mission(time_s: f64) -> f64 {
    if time_s > 0.0 { time_s.min(TIME_MAX_S) } else { 0.0 }
}
