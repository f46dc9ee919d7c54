//! What the processes are compared with: one for all wheels, in which the stages are called one after the other. Nothing
//! between them is sent, and one wake-up serves all wheels: no arrangement of fewer processes costs less.

use bench::Outcome;
use messages::{Frame, Message, Terrain, TerrainClass, Wheel};
use serde::Deserialize;
use shell::{Domain, Error, Shell, SystemFile, Tap};
use sinkage::SinkageTracker;
use std::collections::VecDeque;
use terrain::TerrainFusion;
use terramechanics::SoilEstimator;

/// The wire that carries the terrain of all wheels: of a wheel's cycle, the number is cycle * wheels + wheel.
pub const WIRE: &str = "all/terrain";

/// What the process is told.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Together {
    wheels: u64,
}

/// The process's table of the system file.
pub fn table(wheels: usize) -> Outcome<String> {
    let program = std::env::current_exe()?;
    Ok(format!(
        r#"
[service.stages]
exec = [{program:?}]
outputs = {{ terrain = "{WIRE}" }}
config = {{ wheels = {wheels} }}
"#
    ))
}

/// Answers the frames of all wheels of a system file.
pub fn stages(shell: &mut Shell, system: &str) -> Result<(), Error> {
    let config: Together = shell.config(|_| Ok(()))?;
    let output = shell.output::<Terrain>("terrain")?;
    let domain = Domain::enter(&SystemFile::read(system)?, "together")?;
    let wheels = (0..config.wheels).map(|wheel| Stages::open(&domain, wheel));
    let mut wheels = wheels.collect::<Result<Vec<_>, _>>()?;
    while shell.running() {
        // The cameras take their pictures at the same time: who waits for one after the other waits once.
        for (wheel, stages) in wheels.iter_mut().enumerate() {
            let mut answered = false;
            while !answered && shell.running() {
                while let Some(mut terrain) = stages.answer()? {
                    terrain.header.sequence = terrain.header.sequence * config.wheels + wheel as u64;
                    output.send(terrain)?;
                    answered = true;
                }
                if !answered {
                    stages.frames.wait()?;
                }
            }
        }
    }
    Ok(())
}

/// One wheel's stages and what they read.
struct Stages {
    frames: Tap<Frame>,
    readings: Observed<Wheel>,
    classes: Observed<TerrainClass>,
    tracker: SinkageTracker,
    estimator: SoilEstimator,
    fusion: TerrainFusion,
}

impl Stages {
    fn open(domain: &Domain, wheel: u64) -> Result<Self, Error> {
        Ok(Self {
            frames: Tap::open(domain, &format!("wheel{wheel}/frames"))?,
            readings: Observed::open(domain, &format!("wheel{wheel}/wheel"))?,
            classes: Observed::open(domain, "body/class")?,
            tracker: SinkageTracker::new(sinkage::Config::default()),
            estimator: SoilEstimator::new(terramechanics::Config::default()),
            fusion: TerrainFusion::new(terrain::Config::default()),
        })
    }

    /// The terrain of the next frame that is there.
    fn answer(&mut self) -> Result<Option<Terrain>, Error> {
        let Some(seen) = self.frames.poll(|frame| self.tracker.step(frame))? else {
            return Ok(None);
        };
        let taken_ns = seen.header.taken_ns;
        let estimator = &mut self.estimator;
        self.readings
            .until(taken_ns, |reading| estimator.observe_wheel(reading))?;
        let soil = estimator.step(&seen);
        let fusion = &mut self.fusion;
        fusion.observe_sinkage(&seen);
        self.classes.until(taken_ns, |class| fusion.observe_class(class))?;
        Ok(Some(fusion.step(&soil)))
    }
}

/// A wire that is taken in when there is a frame.
struct Observed<T: Message> {
    tap: Tap<T>,
    pending: VecDeque<T>,
}

impl<T: Message + Clone> Observed<T> {
    fn open(domain: &Domain, wire: &str) -> Result<Self, Error> {
        Ok(Self {
            tap: Tap::open(domain, wire)?,
            pending: VecDeque::new(),
        })
    }

    fn until(&mut self, taken_ns: u64, mut observe: impl FnMut(&T)) -> Result<(), Error> {
        while let Some(sample) = self.tap.poll(T::clone)? {
            self.pending.push_back(sample);
        }
        while let Some(sample) = self.pending.pop_front_if(|sample| sample.header().taken_ns <= taken_ns) {
            observe(&sample);
        }
        Ok(())
    }
}
