//! Compute time of each stage: its lib called directly, on input made beforehand.

mod parts;

use bench::{Day, Options, Outcome, Report, Series};
use camera::PictureReader;
use clap::Parser;
use messages::{Frame, Soil, TerrainClass};
use parts::Parts;
use shell::now_ns;
use sinkage::{Method, SinkageTracker};
use std::hint::black_box;
use terrain::TerrainFusion;
use terramechanics::{Estimator, SoilEstimator};
use traverse::FrameRow;
use vibration::decision::Decider;
use vibration::features::Extractor;
use vibration::recording::Window;
use vibration::window::Quality;
use vibration::{Model, VibrationClassifier};
use zerocopy::{FromZeros, IntoBytes};

const ROUNDS: usize = 5;
/// Pictures that are worked on by turns: more than a cache holds.
const PICTURES: usize = 32;
/// Width and height of the largest picture that a frame holds, in the shape of a camera's.
const LARGEST_PX: (u32, u32) = (1182, 887);
/// Width and height of a picture of 20 Mpx.
const PHOTO_PX: (u32, u32) = (5472, 3648);
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
    sinkage_again: Series,
    sinkage_moving: Series,
    sinkage_largest_change: Series,
    sinkage_large: Series,
    sinkage_cropped: Series,
    parts: [Series; parts::NAMES.len()],
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
    let frames = Pictures::of(&day);
    let mut times = Times {
        clock: Series::new("reading the clock (part of every time below)"),
        render: Series::new("simulation: one VGA picture"),
        sinkage: Series::new("sinkage: one VGA picture, the wheel said to be where it was, and shaken by up to 3 px"),
        sinkage_again: Series::new("sinkage: one VGA picture, the wheel where it was"),
        sinkage_moving: Series::new("sinkage: one VGA picture, the wheel elsewhere in each"),
        sinkage_largest_change: Series::new("sinkage, largest_change: one VGA picture"),
        sinkage_large: Series::new("sinkage: the same wheel in the largest picture that a frame holds"),
        sinkage_cropped: Series::new("sinkage: the same wheel in a picture of 20 Mpx, cropped by the camera service"),
        parts: parts::NAMES.map(|part| Series::new(format!("sinkage, part: {part}"))),
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
    let all: Vec<Series> = times.all().map(|series| series.clone()).collect();
    report.table("Compute time of a step", &all);
    report.end()
}

impl Times {
    /// In the order of the table.
    fn all(&mut self) -> impl Iterator<Item = &mut Series> {
        let pictures = [
            &mut self.clock,
            &mut self.render,
            &mut self.sinkage,
            &mut self.sinkage_again,
            &mut self.sinkage_moving,
            &mut self.sinkage_largest_change,
            &mut self.sinkage_large,
            &mut self.sinkage_cropped,
        ];
        let numbers = [
            &mut self.terramechanics,
            &mut self.terramechanics_linear,
            &mut self.piece,
            &mut self.window,
            &mut self.features,
            &mut self.decision,
            &mut self.terrain,
        ];
        pictures.into_iter().chain(&mut self.parts).chain(numbers)
    }

    fn begin_round(&mut self) {
        for series in self.all() {
            series.begin_round();
        }
    }

    /// The stages that work on pictures.
    fn pictures(&mut self, day: &Day, frames: &Pictures, count: usize) {
        let tracker = |method| {
            SinkageTracker::new(sinkage::Config {
                method,
                ..sinkage::Config::default()
            })
        };
        let [mut still, mut again, mut moving, mut large, mut cropped] = [(); 5].map(|()| tracker(Method::Contrast));
        let mut parts = Parts::new();
        let mut largest_change = tracker(Method::LargestChange);
        let mut canvas = Frame::new_box_zeroed().expect("there is memory for a picture");
        for index in 0..count {
            self.clock.record(timed(|| ()).0);
            let step = |series: &mut Series, tracker: &mut SinkageTracker, frames: &[Box<Frame>]| {
                let frame = &frames[index % frames.len()];
                series.record(timed(|| tracker.step(black_box(frame))).0);
            };
            step(&mut self.sinkage, &mut still, &frames.still);
            step(&mut self.sinkage_again, &mut again, &frames.again);
            step(&mut self.sinkage_moving, &mut moving, &frames.moving);
            step(&mut self.sinkage_largest_change, &mut largest_change, &frames.still);
            step(&mut self.sinkage_large, &mut large, &frames.large);
            step(&mut self.sinkage_cropped, &mut cropped, &frames.cropped);
            for (series, time_ns) in self
                .parts
                .iter_mut()
                .zip(parts.measure(&frames.again[index % PICTURES]))
            {
                series.record(time_ns);
            }
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

/// What the camera sees, in five ways.
struct Pictures {
    /// The wheel is said to be where it is in the first.
    still: Vec<Box<Frame>>,
    /// The wheel is where it is in the first, in as many pictures.
    again: Vec<Box<Frame>>,
    /// The wheel is said to be elsewhere in each.
    moving: Vec<Box<Frame>>,
    /// The first ones, in the corner of a picture as large as a frame holds.
    large: Vec<Box<Frame>>,
    /// The first ones, in the corner of a picture of 20 Mpx, of which the camera service leaves the wheel's surroundings.
    cropped: Vec<Box<Frame>>,
}

impl Pictures {
    fn of(day: &Day) -> Self {
        let (mut still, mut moving) = (day.frames(PICTURES), day.frames(PICTURES));
        let first = &still[0];
        let (x_px, y_px, pitch_rad) = (first.center_x_px, first.center_y_px, first.pitch_rad);
        let homography = first.homography;
        for (index, (still, moving)) in still.iter_mut().zip(&mut moving).enumerate() {
            for frame in [&mut *still, &mut *moving] {
                (frame.center_x_px, frame.center_y_px) = (x_px, y_px);
                (frame.pitch_rad, frame.homography) = (pitch_rad, homography);
            }
            shift(moving, 0.5 * (index % 5) as f64, 0.5 * (index % 3) as f64);
        }
        let again = still.iter().map(|_| copied(&still[0])).collect();
        let large = still.iter().map(|frame| enlarged(frame)).collect();
        let mut reader = PictureReader::default();
        let cropped = still.iter().map(|frame| photographed(frame, &mut reader)).collect();
        Self {
            still,
            again,
            moving,
            large,
            cropped,
        }
    }
}

/// Says that the wheel is further to the right and further down.
fn shift(frame: &mut Frame, right_px: f64, down_px: f64) {
    (frame.center_x_px, frame.center_y_px) = (frame.center_x_px + right_px, frame.center_y_px + down_px);
    for column in 0..3 {
        frame.homography[column] += right_px * frame.homography[6 + column];
        frame.homography[3 + column] += down_px * frame.homography[6 + column];
    }
}

fn copied(frame: &Frame) -> Box<Frame> {
    let mut copy = Frame::new_box_zeroed().expect("there is memory for a picture");
    copy.as_mut_bytes().copy_from_slice(frame.as_bytes());
    copy
}

/// The picture in the lower right of the largest that a frame holds.
fn enlarged(frame: &Frame) -> Box<Frame> {
    let mut large = Frame::new_box_zeroed().expect("there is memory for a picture");
    large.header = frame.header;
    (large.center_x_px, large.center_y_px) = (frame.center_x_px, frame.center_y_px);
    (large.rim_radius_px, large.wheel_radius_px) = (frame.rim_radius_px, frame.wheel_radius_px);
    (large.pitch_rad, large.homography) = (frame.pitch_rad, frame.homography);
    (large.width, large.height) = LARGEST_PX;
    let (right_px, down_px) = paste(frame, LARGEST_PX, &mut large.pixels);
    shift(&mut large, right_px, down_px);
    large
}

/// The picture in the lower right of one of 20 Mpx, a PNG file, as the camera service reads it.
fn photographed(frame: &Frame, reader: &mut PictureReader) -> Box<Frame> {
    let (width, height) = PHOTO_PX;
    let mut pixels = vec![0; width as usize * height as usize];
    let (right_px, down_px) = paste(frame, PHOTO_PX, &mut pixels);
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_compression(png::Compression::NoCompression);
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&pixels))
        .expect("a picture in memory can be encoded");
    let mut moved = copied(frame);
    shift(&mut moved, right_px, down_px);
    let row = FrameRow {
        line: 2,
        sequence: frame.header.sequence,
        file: String::new(),
        taken_ns: frame.header.taken_ns,
        center_x_px: moved.center_x_px,
        center_y_px: moved.center_y_px,
        rim_radius_px: frame.rim_radius_px,
        wheel_radius_px: frame.wheel_radius_px,
        pitch_rad: frame.pitch_rad,
        homography: Some(moved.homography),
    };
    reader
        .fill(&row, &file, &mut moved)
        .expect("the camera reads what was just encoded");
    moved
}

/// Puts the picture into the lower right of a gray one; how far it has moved to the right and down.
fn paste(frame: &Frame, (width, height): (u32, u32), pixels: &mut [u8]) -> (f64, f64) {
    let (width, columns) = (width as usize, frame.width as usize);
    let (right, down) = (width - columns, (height - frame.height) as usize);
    pixels.fill(128);
    let lines = pixels.chunks_exact_mut(width).skip(down);
    for (line, source) in lines.zip(frame.image().chunks_exact(columns)) {
        line[right..].copy_from_slice(source);
    }
    (right as f64, down as f64)
}

/// How long `act` takes [ns], and its answer, which the compiler may not leave out.
fn timed<T>(act: impl FnOnce() -> T) -> (u64, T) {
    let started_ns = now_ns();
    let answer = black_box(act());
    (now_ns() - started_ns, answer)
}
