//! Compute time of each stage: its lib called directly, on input made beforehand.

use bench::{Day, Options, Outcome, Report, Series};
use clap::Parser;
use messages::{Frame, Soil, TerrainClass};
use shell::now_ns;
use sinkage::SinkageTracker;
use std::hint::black_box;
use terrain::TerrainFusion;
use terramechanics::{Estimator, SoilEstimator};
use vibration::decision::Decider;
use vibration::features::Extractor;
use vibration::recording::Window;
use vibration::window::Quality;
use vibration::{Model, VibrationClassifier};
use zerocopy::FromZeros;

const ROUNDS: usize = 5;
/// Pictures that are worked on by turns: more than a cache holds.
const PICTURES: usize = 32;
/// Pictures in a round.
const PICTURES_A_ROUND: usize = 160;

#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
}

/// The stages' times, in the order of the table.
struct Times {
    clock: Series,
    render: Series,
    sinkage: Series,
    terramechanics: Series,
    terramechanics_linear: Series,
    piece: Series,
    window: Series,
    features: Series,
    decision: Series,
    terrain: Series,
}

fn main() -> Outcome<()> {
    let options = Arguments::parse().options;
    let mut report = Report::begin("step", &options);
    let day = Day::new();
    let frames = day.frames(PICTURES);
    let mut times = Times {
        clock: Series::new("reading the clock (part of every time below)"),
        render: Series::new("simulation: one VGA picture"),
        sinkage: Series::new("sinkage: one VGA picture"),
        terramechanics: Series::new("terramechanics, full: a cycle, with its share of the solution over the window"),
        terramechanics_linear: Series::new("terramechanics, linear: a cycle"),
        piece: Series::new("vibration: a piece of 0.1 s"),
        window: Series::new("vibration: a piece that completes a window"),
        features: Series::new("vibration: the features of a window of six channels"),
        decision: Series::new("vibration: the decision on a window"),
        terrain: Series::new("terrain: a sinkage, a class and a soil"),
    };
    for _ in 0..ROUNDS {
        times.begin_round();
        times.pictures(&day, &frames, options.amount(PICTURES_A_ROUND));
        for _ in 0..options.amount(2) {
            times.route(&day);
            times.windows(&day);
        }
    }
    let Times {
        clock,
        render,
        sinkage,
        terramechanics,
        terramechanics_linear,
        piece,
        window,
        features,
        decision,
        terrain,
    } = times;
    report.table(
        "Compute time of a step",
        &[
            clock,
            render,
            sinkage,
            terramechanics,
            terramechanics_linear,
            piece,
            window,
            features,
            decision,
            terrain,
        ],
    );
    report.end()
}

impl Times {
    fn begin_round(&mut self) {
        let Self {
            clock,
            render,
            sinkage,
            terramechanics,
            terramechanics_linear,
            piece,
            window,
            features,
            decision,
            terrain,
        } = self;
        for series in [
            clock,
            render,
            sinkage,
            terramechanics,
            terramechanics_linear,
            piece,
            window,
            features,
            decision,
            terrain,
        ] {
            series.begin_round();
        }
    }

    /// The stages that work on pictures.
    fn pictures(&mut self, day: &Day, frames: &[Box<Frame>], count: usize) {
        let mut tracker = SinkageTracker::new(sinkage::Config::default());
        let mut canvas = Frame::new_box_zeroed().expect("there is memory for a picture");
        for index in 0..count {
            self.clock.record(timed(|| ()).0);
            let frame = &frames[index % frames.len()];
            self.sinkage.record(timed(|| tracker.step(black_box(frame))).0);
            let time_s = index as f64 * 0.123;
            self.render
                .record(timed(|| day.rover.render(black_box(time_s), &mut canvas)).0);
            black_box(&canvas.pixels);
        }
    }

    /// The stages that work on numbers, over the whole route, each on what the one before has said.
    fn route(&mut self, day: &Day) {
        let classes = self.classes(day);
        let mut estimator = SoilEstimator::new(terramechanics::Config::default());
        let mut linear = SoilEstimator::new(terramechanics::Config {
            estimator: Estimator::Linear,
            ..terramechanics::Config::default()
        });
        let mut fusion = TerrainFusion::new(terrain::Config::default());
        for ((number, readings), sinkage) in day.cycles().zip(&day.sinkage) {
            let (time_ns, soil): (u64, Soil) = timed(|| {
                readings
                    .iter()
                    .for_each(|reading| estimator.observe_wheel(black_box(reading)));
                estimator.step(black_box(sinkage))
            });
            self.terramechanics.record(time_ns);
            let (time_ns, _) = timed(|| {
                readings
                    .iter()
                    .for_each(|reading| linear.observe_wheel(black_box(reading)));
                linear.step(black_box(sinkage))
            });
            self.terramechanics_linear.record(time_ns);
            let class = &classes[number * classes.len() / day.sinkage.len()];
            let (time_ns, _) = timed(|| {
                fusion.observe_sinkage(black_box(sinkage));
                fusion.observe_class(black_box(class));
                fusion.step(black_box(&soil))
            });
            self.terrain.record(time_ns);
        }
    }

    /// The parts of a window's classification.
    fn windows(&mut self, day: &Day) {
        let model = Model::built_in();
        let channels = model.channels.len();
        let mut extractor = Extractor::new(model.features.clone(), model.window_samples, model.rate_hz);
        let mut window = Window::prepared(&extractor);
        window.quality = Quality::Good;
        let mut decider = Decider::new(model, None, None);
        let piece_samples = day.vibration[0].count as usize;
        for pieces in day
            .vibration
            .chunks_exact(decider.model().window_samples / piece_samples)
        {
            let of_channel = |channel: usize| pieces.iter().flat_map(move |piece| piece.channel(channel));
            let samples: Vec<Vec<f64>> = (0..channels)
                .map(|channel| of_channel(channel).map(|value| f64::from(*value)).collect())
                .collect();
            let (time_ns, ()) =
                timed(|| extractor.extract(|channel| black_box(&samples[channel]), &mut window.features));
            self.features.record(time_ns);
            window.start_ns = pieces[0].start_ns;
            window.level = extractor.level(&window.features);
            self.decision.record(timed(|| decider.decide(black_box(&window))).0);
        }
    }

    fn classes(&mut self, day: &Day) -> Vec<TerrainClass> {
        let mut classifier = VibrationClassifier::new(&vibration::Config::default(), Model::built_in());
        let mut windows = 0;
        let mut classes = Vec::with_capacity(day.vibration.len());
        for piece in &day.vibration {
            let (time_ns, class) = timed(|| classifier.step(black_box(piece)));
            let series = if class.windows > windows {
                &mut self.window
            } else {
                &mut self.piece
            };
            series.record(time_ns);
            windows = class.windows;
            classes.push(class);
        }
        classes
    }
}

/// How long `act` takes [ns], and its answer, which the compiler may not leave out.
fn timed<T>(act: impl FnOnce() -> T) -> (u64, T) {
    let started_ns = now_ns();
    let answer = black_box(act());
    (now_ns() - started_ns, answer)
}
