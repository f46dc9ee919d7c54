//! What one process of the cycle does: the source, or a stage. The stage libs are called as the services call them.

use super::{Feed, Point, Read, SinkageEnds, SourceEnds, Stamps, TerrainEnds, TerramechanicsEnds, Transport};
use crate::Outcome;
use messages::{Frame, Header, Message, Sinkage, Soil, Status, Terrain};
use rustix::thread::{CpuSet, sched_setaffinity};
use serde::Deserialize;
use shell::{now_ns, sleep_until};
use sinkage::SinkageTracker;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use terrain::TerrainFusion;
use terramechanics::SoilEstimator;

/// Between two frames, paced [ns].
const PERIOD_NS: u64 = 33_333_333;
/// How long the first cycle may take to come back [ns]: the processes start.
const START_MAX_NS: u64 = 30_000_000_000;
/// How long the source waits for the last cycles [ns], and how often it looks.
const DRAIN_NS: u64 = 1_000_000_000;
const LOOK_NS: u64 = 1_000_000;

/// Who a process is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Sends frames and wheel readings, and reads the terrain.
    Source,
    /// Sinkage from frames.
    Sinkage,
    /// Soil from sinkage and wheel readings.
    Terramechanics,
    /// Terrain from soil and sinkage.
    Terrain,
}

impl Role {
    /// The role's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Source => "source",
            Self::Sinkage => "sinkage",
            Self::Terramechanics => "terramechanics",
            Self::Terrain => "terrain",
        }
    }
}

/// When the source sends the next frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pace {
    /// At 30 Hz.
    Paced,
    /// Once the terrain of the last one has come back.
    Fast,
}

impl Pace {
    /// The pace's name on a command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Paced => "paced",
            Self::Fast => "fast",
        }
    }
}

/// What a process of the cycle is told.
#[derive(Clone, Debug, clap::Args, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// Who it is.
    #[arg(long, value_enum)]
    pub role: Role,
    /// Where the processes of a run meet: `feed`, and what each leaves.
    #[arg(long)]
    pub folder: PathBuf,
    /// When the source sends.
    #[arg(long, value_enum)]
    pub pace: Pace,
    /// Cycles that count.
    #[arg(long)]
    pub cycles: u64,
    /// Cycles before them.
    #[arg(long)]
    pub warm_up: u64,
    /// The processor that it runs on.
    #[arg(long)]
    #[serde(default)]
    pub cpu: Option<usize>,
}

impl Part {
    /// The file that every run of a bench reads.
    #[must_use]
    pub fn feed(&self) -> PathBuf {
        self.folder.join("feed")
    }

    /// Where a process of the run leaves its stamps.
    #[must_use]
    pub fn stamps(folder: &Path, role: Role) -> PathBuf {
        folder.join(format!("{}.stamps", role.name()))
    }

    /// Keeps this process on its processor, if it has one.
    ///
    /// # Errors
    /// There is no such processor.
    pub fn settle(&self) -> Outcome<()> {
        let Some(cpu) = self.cpu else { return Ok(()) };
        let mut set = CpuSet::new();
        set.set(cpu);
        Ok(sched_setaffinity(None, &set)?)
    }

    fn leave(&self, stamps: &Stamps) -> Outcome<()> {
        stamps.write(&Self::stamps(&self.folder, self.role))
    }
}

/// Plays a process's part over a middleware, until the source has sent its last cycle.
///
/// # Errors
/// A wire is broken, or there is no space for the stamps.
pub fn play(part: &Part, transport: &impl Transport) -> Outcome<()> {
    part.settle()?;
    match part.role {
        Role::Source => play_source(part, transport.source()?).and_then(|stamps| part.leave(&stamps)),
        Role::Sinkage => play_sinkage(transport.sinkage()?),
        Role::Terramechanics => play_terramechanics(transport.terramechanics()?),
        Role::Terrain => play_terrain(transport.terrain()?).and_then(|stamps| part.leave(&stamps)),
    }
}

/// Sends the cycles, and notes when each frame was sent and each terrain was published.
///
/// # Errors
/// A wire is broken, or nothing ever comes back.
pub fn play_source(part: &Part, ends: SourceEnds) -> Outcome<Stamps> {
    let mut source = Source {
        feed: Feed::read(&part.feed())?,
        ends,
        stamps: Stamps::default(),
        sequence: 0,
    };
    source.greet()?;
    match part.pace {
        Pace::Paced => source.send_paced(part)?,
        Pace::Fast => source.send_fast(part)?,
    }
    let last = Feed::header(source.sequence + 1, Status::ENDED);
    let picture = source.feed.picture(0);
    source.ends.frames.send(last, picture)?;
    source.see_the_end()?;
    Ok(source.stamps)
}

struct Source {
    feed: Feed,
    ends: SourceEnds,
    stamps: Stamps,
    /// Of the last frame.
    sequence: u64,
}

impl Source {
    /// Sends the first picture again and again until a terrain comes back: the others are there.
    fn greet(&mut self) -> Outcome<()> {
        let last_ns = now_ns() + START_MAX_NS;
        let mut answered = 0;
        while answered < self.sequence.max(1) {
            if now_ns() > last_ns {
                return Err("no terrain comes back".into());
            }
            if answered == 0 {
                self.send(0)?;
            }
            sleep_until(now_ns() + PERIOD_NS);
            while self
                .ends
                .terrain
                .poll(&mut |terrain| answered = terrain.header.sequence)?
            {}
        }
        Ok(())
    }

    /// Sends a cycle's readings and its picture; when that was complete [ns].
    fn send(&mut self, cycle: u64) -> Outcome<u64> {
        let before = self.sequence;
        self.sequence += 1;
        for reading in self.feed.readings(cycle, before + 1) {
            self.ends.wheel.send(&reading)?;
        }
        let header = Feed::header(self.sequence, Status::OK);
        self.ends.frames.send(header, self.feed.picture(cycle))
    }

    fn send_counted(&mut self, cycle: u64, part: &Part) -> Outcome<()> {
        let published_ns = self.send(cycle)?;
        if cycle >= part.warm_up {
            self.stamps.note(Point::Frame, self.sequence, published_ns);
        }
        Ok(())
    }

    fn send_paced(&mut self, part: &Part) -> Outcome<()> {
        let started_ns = now_ns();
        for cycle in 0..part.warm_up + part.cycles {
            sleep_until(started_ns + (cycle + 1) * PERIOD_NS);
            self.drain()?;
            self.send_counted(cycle, part)?;
        }
        let last_ns = now_ns() + DRAIN_NS;
        while now_ns() < last_ns && self.stamps.lost() > 0 {
            sleep_until(now_ns() + LOOK_NS);
            self.drain()?;
        }
        Ok(())
    }

    /// Waits until the last stage has ended: it writes to this process.
    fn see_the_end(&mut self) -> Outcome<()> {
        let last_ns = now_ns() + DRAIN_NS;
        let mut over = false;
        while !over && now_ns() < last_ns {
            sleep_until(now_ns() + LOOK_NS);
            let mut look = |terrain: &Terrain| over |= terrain.header.status == Status::ENDED;
            while self.ends.terrain.poll(&mut look)? {}
        }
        Ok(())
    }

    fn drain(&mut self) -> Outcome<()> {
        let Self { ends, stamps, .. } = self;
        let mut note = |terrain: &Terrain| note_terrain(stamps, &terrain.header);
        while ends.terrain.poll(&mut note)? {}
        Ok(())
    }

    fn send_fast(&mut self, part: &Part) -> Outcome<()> {
        let last = part.warm_up + part.cycles;
        let mut cycle = 0;
        self.send_counted(cycle, part)?;
        // While it is read, the terrain's end is not to be reached through `self`.
        let mut terrain = std::mem::replace(&mut self.ends.terrain, Box::new(Nothing));
        terrain.each(&mut |sample| {
            // Without a sample one was lost: the next frame goes all the same.
            if let Some(sample) = sample {
                note_terrain(&mut self.stamps, &sample.header);
                if sample.header.sequence < self.sequence {
                    return Ok(true);
                }
            }
            cycle += 1;
            if cycle == last {
                return Ok(false);
            }
            self.send_counted(cycle, part)?;
            Ok(true)
        })?;
        self.ends.terrain = terrain;
        Ok(())
    }
}

fn note_terrain(stamps: &mut Stamps, header: &Header) {
    if header.status != Status::ENDED {
        stamps.note(Point::Terrain, header.sequence, header.published_ns);
    }
}

/// Stands where a wire is that is in use.
struct Nothing;

impl Read<Terrain> for Nothing {
    fn each(&mut self, _: &mut dyn FnMut(Option<&Terrain>) -> Outcome<bool>) -> Outcome<()> {
        Err("the wire is in use".into())
    }

    fn poll(&mut self, _: &mut dyn FnMut(&Terrain)) -> Outcome<bool> {
        Err("the wire is in use".into())
    }
}

fn play_sinkage(mut ends: SinkageEnds) -> Outcome<()> {
    let mut tracker = SinkageTracker::new(sinkage::Config::default());
    ends.frames.each(&mut |frame: Option<&Frame>| {
        let Some(frame) = frame else { return Ok(true) };
        let over = frame.header.status == Status::ENDED;
        let mut answer = if over {
            Sinkage::unknown(frame.header.answer(Status::ENDED))
        } else {
            tracker.step(frame)
        };
        answer.header.published_ns = now_ns();
        ends.sinkage.send(&answer)?;
        Ok(!over)
    })
}

fn play_terramechanics(mut ends: TerramechanicsEnds) -> Outcome<()> {
    let mut estimator = SoilEstimator::new(terramechanics::Config::default());
    let mut wheel = Observed::new(ends.wheel);
    ends.sinkage.each(&mut |sample: Option<&Sinkage>| {
        let Some(sample) = sample else { return Ok(true) };
        wheel.until(sample.header.taken_ns, |reading| estimator.observe_wheel(reading))?;
        let over = sample.header.status == Status::ENDED;
        let mut answer = if over {
            Soil::unknown(sample.header.answer(Status::ENDED))
        } else {
            estimator.step(sample)
        };
        answer.header.published_ns = now_ns();
        ends.soil.send(&answer)?;
        Ok(!over)
    })
}

/// The last stage has seen every stage's stamp.
fn play_terrain(mut ends: TerrainEnds) -> Outcome<Stamps> {
    let mut fusion = TerrainFusion::new(terrain::Config::default());
    let mut sinkage = Observed::new(ends.sinkage);
    let mut stamps = Stamps::default();
    ends.soil.each(&mut |sample: Option<&Soil>| {
        let Some(sample) = sample else { return Ok(true) };
        let mut seen_at = None;
        sinkage.until(sample.header.taken_ns, |seen| {
            fusion.observe_sinkage(seen);
            seen_at = Some((seen.header.sequence, seen.header.published_ns));
        })?;
        let over = sample.header.status == Status::ENDED;
        let mut answer = if over {
            Terrain::unknown(sample.header.answer(Status::ENDED))
        } else {
            fusion.step(sample)
        };
        answer.header.published_ns = now_ns();
        ends.terrain.send(&answer)?;
        if let Some((sequence, published_ns)) = seen_at {
            stamps.note(Point::Sinkage, sequence, published_ns);
        }
        stamps.note(Point::Soil, sample.header.sequence, sample.header.published_ns);
        Ok(!over)
    })?;
    Ok(stamps)
}

/// A wire that is taken in when the stage is triggered.
struct Observed<T> {
    wire: Box<dyn Read<T>>,
    pending: VecDeque<T>,
}

impl<T: Message + Copy> Observed<T> {
    fn new(wire: Box<dyn Read<T>>) -> Self {
        let pending = VecDeque::with_capacity(1024);
        Self { wire, pending }
    }

    /// Hands every sample taken until `taken_ns` that is new to `observe`, in order.
    fn until(&mut self, taken_ns: u64, mut observe: impl FnMut(&T)) -> Outcome<()> {
        let Self { wire, pending } = self;
        while wire.poll(&mut |sample| pending.push_back(*sample))? {}
        while let Some(sample) = pending.pop_front_if(|sample| sample.header().taken_ns <= taken_ns) {
            observe(&sample);
        }
        Ok(())
    }
}
