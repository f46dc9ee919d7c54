//! Recordings cut into windows, by the same rules as on board.

use crate::features::Extractor;
use crate::window::{Collector, Quality};

/// One recording: a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// The run that it belongs to: recordings of one run resemble each other, and are left out together.
    pub run: String,
    /// Index of the terrain's class.
    pub class: usize,
    /// Sensor instant of each sample.
    pub taken_ns: Vec<u64>,
    /// The channels' samples, NaN where one is missing.
    pub channels: Vec<Vec<f64>>,
    /// The speed's samples; empty where the speed is not known.
    pub speed_m_s: Vec<f64>,
}

/// One window of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// Sensor instant of the first sample.
    pub start_ns: u64,
    /// Index of the recording.
    pub recording: usize,
    /// False for the windows that overlap others half: they are for training only.
    pub scored: bool,
    /// What the window is worth.
    pub quality: Quality,
    /// Mean speed, NaN where it is not known.
    pub speed_m_s: f64,
    /// Mean log10 of the PSD.
    pub level: f64,
    /// True where the vehicle turns.
    pub turning: bool,
    /// The features.
    pub features: Vec<f64>,
}

impl Window {
    /// One in which windows are measured, one after the other.
    #[must_use]
    pub fn prepared(extractor: &Extractor) -> Self {
        Self {
            start_ns: 0,
            recording: 0,
            scored: true,
            quality: Quality::Incomplete,
            speed_m_s: f64::NAN,
            level: f64::NAN,
            turning: false,
            features: vec![0.0; extractor.count()],
        }
    }

    /// Takes in what has been collected: the named channels, and the speed behind them.
    pub fn measure(&mut self, collector: &mut Collector, extractor: &mut Extractor, channels: &[String]) {
        self.start_ns = collector.start_ns();
        self.quality = collector.repair(channels.len());
        extractor.extract(|channel| collector.channel(channel), &mut self.features);
        self.speed_m_s = mean(collector.channel(channels.len()));
        self.level = extractor.level(&self.features);
        self.turning = is_turning(collector, channels);
    }
}

/// How recordings are cut.
#[derive(Clone, Debug, PartialEq)]
pub struct Cutter {
    /// Samples of a window.
    pub window_samples: usize,
    /// Sampling rate.
    pub rate_hz: f64,
    /// The channels' names.
    pub channels: Vec<String>,
}

impl Cutter {
    /// All windows of a recording, in order of time; with `overlap`, also those that start half a window later.
    #[must_use]
    pub fn cut(&self, index: usize, recording: &Recording, extractor: &mut Extractor, overlap: bool) -> Vec<Window> {
        let mut windows = Vec::new();
        let mut window = Window {
            recording: index,
            ..Window::prepared(extractor)
        };
        let starts: &[usize] = if overlap { &[0, self.window_samples / 2] } else { &[0] };
        for skipped in starts {
            self.for_each_window(recording, *skipped, |collector| {
                window.measure(collector, extractor, &self.channels);
                window.scored = *skipped == 0;
                windows.push(window.clone());
            });
        }
        windows.sort_by_key(|window| (window.start_ns, !window.scored));
        windows
    }

    /// The usual standard deviation of each channel within a window: the geometric mean over all windows.
    #[must_use]
    pub fn usual_deviations(&self, recordings: &[Recording]) -> Vec<f64> {
        let mut sums = vec![(0.0, 0.0); self.channels.len()];
        for recording in recordings {
            self.for_each_window(recording, 0, |collector| {
                let _ = collector.repair(self.channels.len());
                for (channel, (sum, count)) in sums.iter_mut().enumerate() {
                    let values = collector.channel(channel);
                    let centre = mean(values);
                    let variance = mean(
                        &values
                            .iter()
                            .map(|value| (value - centre).powi(2))
                            .collect::<Vec<f64>>(),
                    );
                    if variance > 0.0 {
                        *sum += variance.ln() / 2.0;
                        *count += 1.0;
                    }
                }
            });
        }
        sums.iter()
            .map(|(sum, count)| (sum / f64::max(*count, 1.0)).exp())
            .collect()
    }

    fn for_each_window(&self, recording: &Recording, skipped: usize, mut act: impl FnMut(&mut Collector)) {
        let channels = self.channels.len();
        let mut collector = Collector::new(channels + 1, self.window_samples, 1e9 / self.rate_hz);
        for (index, taken_ns) in recording.taken_ns.iter().enumerate().skip(skipped) {
            let slots = collector.advance(*taken_ns);
            for slot in 0..slots {
                let measured = slot + 1 == slots;
                let full = collector.place(*taken_ns, |channel| {
                    let samples = recording.channels.get(channel).unwrap_or(&recording.speed_m_s);
                    samples.get(index).copied().filter(|_| measured).unwrap_or(f64::NAN)
                });
                if full {
                    act(&mut collector);
                }
            }
        }
    }
}

/// Mean angular rate from which a vehicle turns [rad/s].
const TURNING_RAD_S: f64 = 0.05;

/// True where a channel that holds an angular rate has a mean that is none of vibration.
#[must_use]
pub fn is_turning(collector: &Collector, channels: &[String]) -> bool {
    let turns = |(index, name): (usize, &String)| {
        name.starts_with("angular_rate_") && mean(collector.channel(index)).abs() >= TURNING_RAD_S
    };
    channels.iter().enumerate().any(turns)
}

/// Mean of what is finite; NaN where nothing is.
#[must_use]
pub fn mean(values: &[f64]) -> f64 {
    let known = values.iter().filter(|value| value.is_finite());
    let (sum, count) = known.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    if count > 0.0 { sum / count } else { f64::NAN }
}
