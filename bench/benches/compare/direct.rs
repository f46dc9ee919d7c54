//! The floor: one process, which takes the picture and calls one stage lib after the other.

use bench::Outcome;
use bench::compare::{Feed, Pace, Part, Point, Stamps, write_frame};
use messages::{Frame, Status};
use shell::{now_ns, sleep_until};
use sinkage::SinkageTracker;
use terrain::TerrainFusion;
use terramechanics::SoilEstimator;
use zerocopy::{FromZeros, IntoBytes};

/// Between two frames, paced [ns].
const PERIOD_NS: u64 = 33_333_333;

/// Runs all cycles.
pub fn play(part: &Part) -> Outcome<()> {
    part.settle()?;
    let feed = Feed::read(&part.feed())?;
    let mut frame = Frame::new_box_zeroed().map_err(|_| "no memory for a picture")?;
    let mut tracker = SinkageTracker::new(sinkage::Config::default());
    let mut estimator = SoilEstimator::new(terramechanics::Config::default());
    let mut fusion = TerrainFusion::new(terrain::Config::default());
    let mut stamps = Stamps::default();
    let started_ns = now_ns();
    for cycle in 0..part.warm_up + part.cycles {
        if part.pace == Pace::Paced {
            sleep_until(started_ns + (cycle + 1) * PERIOD_NS);
        }
        let sequence = cycle + 1;
        let frame_ns = write_frame(
            frame.as_mut_bytes(),
            Feed::header(sequence, Status::OK),
            feed.picture(cycle),
        );
        let sinkage = tracker.step(&frame);
        let sinkage_ns = now_ns();
        feed.readings(cycle, sequence)
            .for_each(|reading| estimator.observe_wheel(&reading));
        let soil = estimator.step(&sinkage);
        let soil_ns = now_ns();
        fusion.observe_sinkage(&sinkage);
        let terrain = fusion.step(&soil);
        let terrain_ns = now_ns();
        if cycle >= part.warm_up {
            stamps.note(Point::Frame, sequence, frame_ns);
            stamps.note(Point::Sinkage, terrain.header.sequence, sinkage_ns);
            stamps.note(Point::Soil, terrain.header.sequence, soil_ns);
            stamps.note(Point::Terrain, terrain.header.sequence, terrain_ns);
        }
    }
    stamps.write(&Part::stamps(&part.folder, part.role))
}
