//! What a simulated rover says on each wire, and what no sound rover would.

use messages::{Field, Frame, Header, Kind, Message, Sinkage, Soil, Status, TerrainClass, Vibration, Wheel, label};
use shell::{Domain, Error, Output, Termination};
use simulation::{CHANNELS, Rover};
use zerocopy::FromZeros;

/// Samples of a piece of vibration, and the time between them [ns].
const PIECE: (u32, u64) = (10, 10_000_000);

/// A message that the rover can say.
pub trait Played: Message {
    /// Fills all but the header with what holds at a time [s] of the simulated route.
    fn play(&mut self, rover: &Rover, time_s: f64);
}

impl Played for Frame {
    fn play(&mut self, rover: &Rover, time_s: f64) {
        rover.render(time_s, self);
    }
}

impl Played for Wheel {
    fn play(&mut self, rover: &Rover, time_s: f64) {
        *self = rover.wheel(time_s);
    }
}

impl Played for Sinkage {
    fn play(&mut self, rover: &Rover, time_s: f64) {
        let state = rover.state(time_s);
        *self = Self::unknown(Header::default());
        (self.entry_rad, self.exit_rad) = (state.entry_rad, state.exit_rad);
        (self.right_rad, self.left_rad) = (state.entry_rad, -state.exit_rad);
        self.sinkage_m = state.sinkage_m;
        self.confidence = 0.9;
        for sigma in [
            &mut self.entry_sigma_rad,
            &mut self.exit_sigma_rad,
            &mut self.left_sigma_rad,
            &mut self.right_sigma_rad,
        ] {
            *sigma = 0.01;
        }
        self.sinkage_sigma_m = 0.001;
    }
}

impl Played for Vibration {
    fn play(&mut self, rover: &Rover, time_s: f64) {
        self.zero();
        (self.count, self.period_ns) = PIECE;
        self.channel_count = CHANNELS.len() as u32;
        for (target, name) in self.channels.iter_mut().zip(CHANNELS) {
            *target = label(name);
        }
        let span_s = f64::from(PIECE.0) * PIECE.1 as f64 * 1e-9;
        for index in 0..PIECE.0 as usize {
            self.offset_ns[index] = index as u32 * PIECE.1 as u32;
            let values = rover.vibration(time_s - span_s + index as f64 * PIECE.1 as f64 * 1e-9);
            for (channel, value) in self.samples.iter_mut().zip(values) {
                channel[index] = value;
            }
        }
    }
}

impl Played for Soil {
    fn play(&mut self, rover: &Rover, time_s: f64) {
        let state = rover.state(time_s);
        let soil = &rover.soils()[state.soil];
        let pressure_pa = 8000.0;
        *self = Self::unknown(Header::default());
        (self.cohesion_pa, self.cohesion_sigma_pa) = (soil.cohesion_pa, 100.0);
        (self.friction_rad, self.friction_sigma_rad) = (soil.friction_rad, 0.02);
        self.cohesion_friction_covariance_pa_rad = 0.0;
        self.pressure_pa = pressure_pa;
        self.strength_pa = soil.cohesion_pa + pressure_pa * soil.friction_rad.tan();
        self.strength_sigma_pa = 100.0;
        self.slip = state.slip;
        self.rows = 100;
        self.reason = Self::USED;
    }
}

impl Played for TerrainClass {
    fn play(&mut self, rover: &Rover, time_s: f64) {
        let soils = rover.soils();
        *self = Self::undecided(Header::default());
        self.class = rover.state(time_s).soil as u32;
        self.class_count = soils.len() as u32;
        self.unknown = 0;
        self.metric = 1.0;
        for (index, soil) in soils.iter().enumerate() {
            self.labels[index] = label(soil.name);
            self.probability[index] = if index == self.class as usize { 0.9 } else { 0.05 };
        }
    }
}

/// The instants of a wire: what begins a sample's interval follows from its header.
pub fn place_in_time(bytes: &mut [u8], fields: &[Field], header: &Header) {
    let begins_ns = header.taken_ns.saturating_sub(u64::from(PIECE.0) * PIECE.1);
    for field in fields.iter().filter(|field| field.name == "start_ns") {
        bytes[field.offset..field.end()].copy_from_slice(&begins_ns.to_le_bytes());
    }
}

/// Sends what holds at an instant, on a wire that the stage takes in.
pub type Observed = Box<dyn Fn(&Rover, f64, &Header) -> Result<(), Error>>;

/// Opens a wire that the stage takes in.
pub fn observed<T: Played>(domain: &Domain, wire: &str, termination: &Termination) -> Result<Observed, Error> {
    let output: Output<T> = domain.output(wire, termination)?;
    Ok(Box::new(move |rover, time_s, header| {
        output.send_with(|sample| {
            sample.play(rover, time_s);
            *sample.header_mut() = *header;
            place_in_time(sample.as_mut_bytes(), T::FIELDS, header);
            Ok(())
        })
    }))
}

/// What cannot be believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spoiled {
    /// A status that has no meaning.
    UnknownStatus,
    /// All values are infinite.
    Infinite,
    /// All values are NaN, and the status says that they are known.
    Missing,
    /// All counts and sizes are as large as can be.
    Huge,
    /// Bytes without a pattern behind a plausible header.
    Noise,
    /// The sensor delivered nothing.
    NoData,
}

impl Spoiled {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::UnknownStatus,
        Self::Infinite,
        Self::Missing,
        Self::Huge,
        Self::Noise,
        Self::NoData,
    ];

    /// What it is, for a person.
    pub const fn words(self) -> &'static str {
        match self {
            Self::UnknownStatus => "an unknown status",
            Self::Infinite => "infinite values",
            Self::Missing => "NaN values",
            Self::Huge => "huge sizes",
            Self::Noise => "random bytes",
            Self::NoData => "no data",
        }
    }

    /// Spoils a good sample. True if no answer may then claim to know anything.
    pub fn spoil<T: Message>(self, sample: &mut T) -> bool {
        let header = *sample.header();
        match self {
            Self::UnknownStatus => sample.header_mut().status = Status(4711),
            Self::Infinite => fill(sample, f64::INFINITY),
            Self::Missing => fill(sample, f64::NAN),
            Self::Huge => {
                for field in T::FIELDS
                    .iter()
                    .filter(|field| field.kind == Kind::U32 && field.count == 1)
                {
                    sample.as_mut_bytes()[field.offset..field.end()].fill(0xff);
                }
            }
            Self::Noise => {
                let bytes = &mut sample.as_mut_bytes()[size_of::<Header>()..];
                for (index, byte) in bytes.iter_mut().enumerate() {
                    *byte = ((index as u32 ^ 0x5bd1).wrapping_mul(0x9e37_79b1) >> 13) as u8;
                }
            }
            Self::NoData => {
                sample.zero();
                *sample.header_mut() = Header {
                    status: Status::NO_DATA,
                    ..header
                };
            }
        }
        // Whatever the message's own check refuses.
        sample.check().is_err()
    }
}

fn fill<T: Message>(sample: &mut T, value: f64) {
    for field in T::FIELDS {
        let bytes = &mut sample.as_mut_bytes()[field.offset..field.end()];
        match field.kind {
            Kind::F64 => bytes
                .chunks_exact_mut(8)
                .for_each(|place| place.copy_from_slice(&value.to_le_bytes())),
            Kind::F32 => bytes
                .chunks_exact_mut(4)
                .for_each(|place| place.copy_from_slice(&(value as f32).to_le_bytes())),
            _ => (),
        }
    }
}
