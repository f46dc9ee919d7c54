//! A simulated rover's telemetry, tick by tick.

use crate::{Event, PIECE_NS};
use messages::{Header, Status, Vibration, label};
use simulation::{CHANNELS, Rover};
use zerocopy::FromZeros;

/// Telemetry of a simulated rover: wheel and vibration are both sampled every [`SimulatedTelemetry::PERIOD_NS`].
pub struct SimulatedTelemetry {
    rover: Rover,
    started_ns: u64,
    next_piece: Option<u64>,
    piece: Box<Vibration>,
}

impl SimulatedTelemetry {
    /// Time from one tick to the next.
    pub const PERIOD_NS: u64 = 10_000_000;
    /// Ticks whose vibration makes a piece.
    const PIECE_TICKS: u64 = PIECE_NS / Self::PERIOD_NS;
    /// Pieces that are made up for after a pause of the process; older ones are lost, as missed ticks of the wheel are.
    const PIECES_LATE_MAX: u64 = 5;

    /// The telemetry of a rover in a system that started at `started_ns`.
    #[must_use]
    pub fn new(rover: simulation::Config, started_ns: u64) -> Self {
        let mut piece = Box::new(Vibration::new_zeroed());
        piece.period_ns = Self::PERIOD_NS;
        piece.count = Self::PIECE_TICKS as u32;
        piece.channel_count = CHANNELS.len() as u32;
        for (target, name) in piece.channels.iter_mut().zip(CHANNELS) {
            *target = label(name);
        }
        for (target, index) in piece.offset_ns.iter_mut().zip(0..piece.count) {
            *target = index * Self::PERIOD_NS as u32;
        }
        Self {
            rover: Rover::new(rover),
            started_ns,
            next_piece: None,
            piece,
        }
    }

    /// Hands what is new at a tick to `send`: the wheel's sample, then each piece of vibration that is over.
    ///
    /// # Errors
    /// Those of `send`.
    pub fn at<E>(&mut self, tick: u64, mut send: impl FnMut(Event) -> Result<(), E>) -> Result<(), E> {
        let mut wheel = self.rover.wheel(elapsed_s(tick));
        wheel.header = self.header(tick, tick);
        send(Event::Wheel(wheel))?;
        let over = tick / Self::PIECE_TICKS;
        // A process that starts late starts with the piece that is under way.
        let next = self
            .next_piece
            .unwrap_or(over)
            .max(over.saturating_sub(Self::PIECES_LATE_MAX));
        for number in next..over {
            self.fill(number);
            send(Event::Vibration(&self.piece))?;
        }
        self.next_piece = Some(next.max(over));
        Ok(())
    }

    fn fill(&mut self, number: u64) {
        let first = number * Self::PIECE_TICKS;
        self.piece.header = self.header(first + Self::PIECE_TICKS, number);
        self.piece.start_ns = self.header(first, number).taken_ns;
        for index in 0..self.piece.count as usize {
            let values = self.rover.vibration(elapsed_s(first + index as u64));
            for (channel, value) in self.piece.samples.iter_mut().zip(values) {
                channel[index] = value;
            }
        }
    }

    fn header(&self, tick: u64, sequence: u64) -> Header {
        Header {
            taken_ns: self.started_ns.saturating_add(elapsed_ns(tick)),
            sequence,
            status: Status::OK,
            ..Header::default()
        }
    }
}

fn elapsed_ns(tick: u64) -> u64 {
    tick.saturating_mul(SimulatedTelemetry::PERIOD_NS)
}

fn elapsed_s(tick: u64) -> f64 {
    elapsed_ns(tick) as f64 / 1e9
}
