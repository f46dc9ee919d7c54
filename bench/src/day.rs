//! Input for the stages: what the simulated rover's sensors deliver on one round of its route, made beforehand.

use messages::{Frame, Header, Sinkage, Status, Vibration, Wheel};
use simulation::{Config, Rover};
use telemetry::{Event, SimulatedTelemetry};
use zerocopy::FromZeros;

/// The sensor instant at which the rover starts [ns].
const START_NS: u64 = 1_000_000_000;
/// Wheel readings taken in with one cycle: 100 Hz to about 30 Hz.
const READINGS_A_CYCLE: usize = 3;

/// What the sensors deliver.
pub struct Day {
    /// The rover that it is of.
    pub rover: Rover,
    /// Wheel readings, one each 10 ms.
    pub wheel: Vec<Wheel>,
    /// Pieces of vibration, one each 100 ms.
    pub vibration: Vec<Vibration>,
    /// The sinkage as a good camera would see it, one each 30 ms.
    pub sinkage: Vec<Sinkage>,
}

impl Day {
    /// One round of the route.
    #[must_use]
    pub fn new() -> Self {
        let config = Config::default();
        let mut day = Self {
            rover: Rover::new(config.clone()),
            wheel: Vec::new(),
            vibration: Vec::new(),
            sinkage: Vec::new(),
        };
        let ticks = (config.route_s * 1e9) as u64 / SimulatedTelemetry::PERIOD_NS;
        let mut telemetry = SimulatedTelemetry::new(config, START_NS);
        for tick in 0..ticks {
            let Ok(()) = telemetry.at(tick, |event| {
                match event {
                    Event::Wheel(reading) => day.wheel.push(reading),
                    Event::Vibration(piece) => day.vibration.push(piece.clone()),
                    Event::Sinkage(_) => {}
                }
                Ok::<(), std::convert::Infallible>(())
            });
        }
        day.sinkage = day
            .cycles()
            .map(|(number, wheel)| day.seen(number, &wheel[READINGS_A_CYCLE - 1]))
            .collect();
        day
    }

    /// The wheel readings, cycle by cycle.
    pub fn cycles(&self) -> impl Iterator<Item = (usize, &[Wheel])> {
        self.wheel.chunks_exact(READINGS_A_CYCLE).enumerate()
    }

    /// `count` pictures, from all over the route.
    #[must_use]
    pub fn frames(&self, count: usize) -> Vec<Box<Frame>> {
        let route_s = self.wheel.len() as f64 * SimulatedTelemetry::PERIOD_NS as f64 / 1e9;
        let pictures = (0..count).map(|index| {
            let mut frame = Frame::new_box_zeroed().expect("there is memory for a picture");
            self.rover.render(route_s * index as f64 / count as f64, &mut frame);
            frame.header = Header {
                sequence: index as u64,
                status: Status::OK,
                ..Header::default()
            };
            frame
        });
        pictures.collect()
    }

    /// The true sinkage, half a degree off to either side by turns.
    fn seen(&self, number: usize, last: &Wheel) -> Sinkage {
        let state = self.rover.state((last.header.taken_ns - START_NS) as f64 / 1e9);
        let entry_rad = state.entry_rad + if number.is_multiple_of(2) { 0.0087 } else { -0.0087 };
        let header = Header {
            sequence: number as u64,
            ..last.header
        };
        Sinkage {
            right_rad: entry_rad,
            right_sigma_rad: 0.0175,
            left_rad: -state.exit_rad,
            left_sigma_rad: 0.0175,
            entry_rad,
            entry_sigma_rad: 0.0175,
            exit_rad: state.exit_rad,
            exit_sigma_rad: 0.0175,
            sinkage_m: self.rover.radius_m() * (1.0 - entry_rad.cos()),
            sinkage_sigma_m: 1e-3,
            confidence: 1.0,
            ..Sinkage::unknown(header)
        }
    }
}

impl Default for Day {
    fn default() -> Self {
        Self::new()
    }
}
