//! Figures 12, 13 and 14 of the paper, of evaluated recordings.

use super::recordings::Recordings;
use plotters::coord::Shift;
use plotters::prelude::*;
use shell::Error;
use std::ops::Range;
use std::path::Path;
use vibration::Model;
use vibration::decision::Decision;
use vibration::discriminant::Discriminant;
use vibration::evaluate::{Judged, principal_components};

const SIZE: (u32, u32) = (900, 560);
/// Share of the drawn range that is left free on either side.
const MARGIN: f64 = 0.05;
/// Time drawn before and after the change of terrain [s].
const AROUND_S: f64 = 60.0;

/// A pair of classes, by index, and what tells them apart.
struct Pair<'a> {
    classes: [usize; 2],
    discriminant: &'a Discriminant,
}

/// What the figures are drawn of.
pub struct Figures<'a> {
    /// The model that was evaluated.
    pub model: &'a Model,
    /// The recordings.
    pub read: &'a Recordings,
    /// Their windows.
    pub judged: &'a [Judged],
}

impl Figures<'_> {
    /// Draws all figures as SVG files into a folder.
    pub fn draw(&self, folder: &Path) -> Result<(), Error> {
        std::fs::create_dir_all(folder).map_err(|error| Error::data(format!("{}: {error}", folder.display())))?;
        let Some(pair) = self.mixed_pair() else {
            return Err(Error::data("there is no window to draw"));
        };
        let drawn = [
            ("figure_12_components.svg", self.components(folder)),
            ("figure_13_metric.svg", self.metric(folder, &pair)),
            ("figure_14_transition.svg", self.transition(folder, &pair)),
        ];
        for (file, result) in drawn {
            result.map_err(|what| Error::internal(format!("{}: {what}", folder.join(file).display())))?;
        }
        Ok(())
    }

    /// The windows on which something was decided, of classes that the model knows.
    fn decided(&self) -> impl Iterator<Item = (usize, &Judged, &Decision)> {
        self.judged.iter().filter_map(|judged| {
            let class = self.read.all[judged.window.recording].class;
            let decision = judged.decision.as_ref().ok()?;
            (class < self.model.labels.len()).then_some((class, judged, decision))
        })
    }

    /// The pair of classes that is mixed up most often.
    fn mixed_pair(&self) -> Option<Pair<'_>> {
        let mixed = |(a, b): (usize, usize)| {
            let confused = |(truth, _, decision): &(usize, &Judged, &Decision)| {
                (*truth == a && decision.class == b) || (*truth == b && decision.class == a)
            };
            self.decided().filter(confused).count()
        };
        let present = |class: usize| self.decided().any(|(truth, _, _)| truth == class);
        let pairs = self.model.class_pairs().zip(&self.model.pairs);
        let mut best: Option<(usize, Pair<'_>)> = None;
        for ((a, b), discriminant) in pairs {
            let count = mixed((a, b));
            if present(a) && present(b) && best.as_ref().is_none_or(|best| count > best.0) {
                let classes = [a, b];
                best = Some((count, Pair { classes, discriminant }));
            }
        }
        best.map(|(_, pair)| pair)
    }

    /// Figure 12: the windows in their first two principal components.
    fn components(&self, folder: &Path) -> Drawn {
        let windows: Vec<&[f64]> = self
            .decided()
            .map(|(_, judged, _)| judged.window.features.as_slice())
            .collect();
        let points = principal_components(&windows);
        let path = folder.join("figure_12_components.svg");
        let area = SVGBackend::new(&path, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&area)
            .caption("Windows in their first two principal components", ("sans-serif", 20))
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(
                range(points.iter().map(|point| point[0])),
                range(points.iter().map(|point| point[1])),
            )?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .x_desc("first component")
            .y_desc("second component")
            .draw()?;
        for (class, label) in self.model.labels.iter().enumerate() {
            let own = self.decided().zip(&points).filter(|((truth, _, _), _)| *truth == class);
            let style = Palette99::pick(class).mix(0.6).filled();
            chart
                .draw_series(own.map(|(_, [x, y])| Circle::new((*x, *y), 2, style)))?
                .label(label)
                .legend(move |(x, y)| Circle::new((x + 8, y), 4, Palette99::pick(class).filled()));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK)
            .draw()?;
        area.present()?;
        Ok(())
    }

    /// Figure 13: the metric of the windows of two classes, with their means and standard deviations.
    fn metric(&self, folder: &Path, pair: &Pair<'_>) -> Drawn {
        let points: Vec<(f64, f64, usize)> = pair
            .classes
            .iter()
            .flat_map(|class| self.decided().filter(move |(truth, _, _)| truth == class))
            .enumerate()
            .map(|(index, (truth, judged, _))| (index as f64, self.metric_of(pair, judged), truth))
            .collect();
        let [a, b] = pair.classes.map(|class| self.model.labels[class].as_str());
        let path = folder.join("figure_13_metric.svg");
        let area = SVGBackend::new(&path, SIZE).into_drawing_area();
        let title = format!("Metric d of {a} and {b}; means and standard deviations of the training");
        self.draw_metric(&area, &title, "window", pair, &points, None)
    }

    /// Figure 14: the metric over a change of terrain: the longest recordings of the two classes, one after the other.
    fn transition(&self, folder: &Path, pair: &Pair<'_>) -> Drawn {
        let half_s = self.model.window_s() / 2.0;
        let [before, after] = pair.classes.map(|class| self.longest(class));
        let since_s = |judged: &Judged, start: &Judged| {
            let between_ns = judged.window.start_ns as f64 - start.window.start_ns as f64;
            between_ns / 1e9
        };
        let mut points = Vec::new();
        if let (Some(last), Some(first)) = (before.last(), after.first()) {
            let left = before.iter().map(|judged| (since_s(judged, last) - half_s, *judged));
            let right = after.iter().map(|judged| (since_s(judged, first) + half_s, *judged));
            let near = left.chain(right).filter(|(time_s, _)| time_s.abs() <= AROUND_S);
            points.extend(near.map(|(time_s, judged)| (time_s, self.metric_of(pair, judged), judged)));
        }
        let chosen = |judged: &Judged| judged.decision.map_or(0, |decision| decision.class);
        let points: Vec<(f64, f64, usize)> = points
            .into_iter()
            .map(|(x, y, judged)| (x, y, chosen(judged)))
            .collect();
        let [a, b] = pair.classes.map(|class| self.model.labels[class].as_str());
        let path = folder.join("figure_14_transition.svg");
        let area = SVGBackend::new(&path, SIZE).into_drawing_area();
        let title = format!("Metric d from {a} to {b} (recordings joined at 0 s); colours: the class decided");
        self.draw_metric(&area, &title, "time [s]", pair, &points, Some(0.0))
    }

    /// The decided windows of the longest recording of a class.
    fn longest(&self, class: usize) -> Vec<&Judged> {
        let mut longest: Vec<&Judged> = Vec::new();
        let own: Vec<&Judged> = self
            .decided()
            .filter(|(truth, _, _)| *truth == class)
            .map(|(_, judged, _)| judged)
            .collect();
        for recording in own.chunk_by(|a, b| a.window.recording == b.window.recording) {
            if recording.len() > longest.len() {
                longest = recording.to_vec();
            }
        }
        longest
    }

    fn metric_of(&self, pair: &Pair<'_>, judged: &Judged) -> f64 {
        let log_speed = self.model.speed.log_ratio(judged.window.speed_m_s);
        pair.discriminant.metric(&judged.window.features, log_speed)
    }

    /// Points coloured by class over the bands of both classes; a line where the terrain changes.
    fn draw_metric(
        &self,
        area: &DrawingArea<SVGBackend<'_>, Shift>,
        title: &str,
        x_name: &str,
        pair: &Pair<'_>,
        points: &[(f64, f64, usize)],
        change: Option<f64>,
    ) -> Drawn {
        area.fill(&WHITE)?;
        let x = range(points.iter().map(|point| point.0));
        let y = range(points.iter().map(|point| point.1));
        let mut chart = ChartBuilder::on(area)
            .caption(title, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(x.clone(), y.clone())?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .x_desc(x_name)
            .y_desc("metric d")
            .draw()?;
        for (side, class) in pair.classes.into_iter().enumerate() {
            let colour = Palette99::pick(class);
            let (mean, sigma) = (pair.discriminant.class_mean[side], pair.discriminant.class_sigma[side]);
            let band = [(x.start, mean - sigma), (x.end, mean + sigma)];
            chart.draw_series([Rectangle::new(band, colour.mix(0.15).filled())])?;
            chart.draw_series(LineSeries::new(
                [(x.start, mean), (x.end, mean)],
                colour.stroke_width(1),
            ))?;
        }
        if let Some(change) = change {
            chart.draw_series(LineSeries::new([(change, y.start), (change, y.end)], BLACK))?;
        }
        for (class, label) in self.model.labels.iter().enumerate() {
            let mut own = points.iter().filter(|point| point.2 == class).peekable();
            if own.peek().is_none() {
                continue;
            }
            chart
                .draw_series(own.map(|point| Circle::new((point.0, point.1), 2, Palette99::pick(class).filled())))?
                .label(label)
                .legend(move |(x, y)| Circle::new((x + 8, y), 4, Palette99::pick(class).filled()));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK)
            .draw()?;
        area.present()?;
        Ok(())
    }
}

type Drawn = Result<(), Box<dyn std::error::Error>>;

/// The range of some values, and a margin; never empty.
fn range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
    if low > high {
        return 0.0..1.0;
    }
    let margin = MARGIN * (high - low).max(1e-6 * high.abs().max(1e-6));
    low - margin..high + margin
}
