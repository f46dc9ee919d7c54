//! Figures of a replay as SVG text: what was estimated against time, with its 95 % band and the truth.

use plotters::chart::ChartContext;
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use sinkage::profile::Profile;
use std::ops::Range;

/// Half of a 95 % interval, in standard deviations.
const BAND_SIGMAS: f64 = 1.96;
/// Share of the band's edges that may lie outside the axis at each end: the first sigmas after a reset are wild.
const OUTSIDE: f64 = 0.04;
/// Free space above and below what the axis has to show.
const MARGIN: f64 = 0.08;

// Drawn large, since coordinates are whole pixels; viewers scale it.
const WIDTH_PX: u32 = 1600;
const PANEL_PX: u32 = 520;
const LEGEND_PX: u32 = 70;
const FONT: (&str, u32) = ("sans-serif", 34);

// Okabe and Ito's colours, told apart by the colour-blind.
const ESTIMATE: RGBColor = RGBColor(0, 114, 178);
const CHANGE: RGBColor = RGBColor(213, 94, 0);
const TRUTH: RGBColor = RGBColor(0, 0, 0);
const DOUBTED: RGBColor = RGBColor(153, 153, 153);
const GRID: RGBColor = RGBColor(228, 228, 228);

/// Why a figure could not be drawn.
pub type DrawError = DrawingAreaErrorKind<std::io::Error>;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// A row of `soil.csv`; what is missing is NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoilRow {
    pub taken_s: f64,
    pub cohesion_pa: f64,
    pub cohesion_sigma_pa: f64,
    pub friction_rad: f64,
    pub friction_sigma_rad: f64,
    /// Changes of soil found so far.
    pub resets: f64,
    /// The status is `ok`.
    pub ok: bool,
}

/// A row of `truth.csv`; what is missing is NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoilTruth {
    pub taken_s: f64,
    pub cohesion_pa: f64,
    pub friction_rad: f64,
}

/// Figure 10 of the paper: cohesion and friction angle against time.
pub fn soil(rows: &[SoilRow], truth: &[SoilTruth]) -> Result<String, DrawError> {
    let start_s = rows.first().map_or(0.0, |row| row.taken_s);
    let estimates = |value: fn(&SoilRow) -> (f64, f64)| {
        let estimate = |row: &SoilRow| Estimate {
            time_s: row.taken_s - start_s,
            value: value(row).0,
            sigma: value(row).1,
            ok: row.ok,
        };
        rows.iter().map(estimate).collect()
    };
    let known = |value: fn(&SoilTruth) -> f64| truth.iter().map(|row| (row.taken_s - start_s, value(row))).collect();
    let panels = [
        Panel {
            title: "cohesion [kPa]",
            guesses: false,
            estimates: estimates(|row| (row.cohesion_pa / 1e3, row.cohesion_sigma_pa / 1e3)),
            truth: known(|row| row.cohesion_pa / 1e3),
        },
        Panel {
            title: "friction angle [deg]",
            guesses: false,
            estimates: estimates(|row| (row.friction_rad.to_degrees(), row.friction_sigma_rad.to_degrees())),
            truth: known(|row| row.friction_rad.to_degrees()),
        },
    ];
    let grown = rows.windows(2).filter(|pair| pair[1].resets > pair[0].resets);
    let changes_s: Vec<f64> = grown.map(|pair| pair[1].taken_s - start_s).collect();
    stacked(&panels, &changes_s, "change of soil")
}

/// A row of `sinkage.csv`, left then right; what is missing is NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SinkageRow {
    pub taken_s: f64,
    pub angles_rad: [f64; 2],
    pub sigmas_rad: [f64; 2],
    /// The status is `ok`.
    pub ok: bool,
}

/// Figures 5 and 7 of the paper: sinkage against time, on either side; `truth` has the angles of each row.
pub fn sinkage(rows: &[SinkageRow], truth: &[[f64; 2]]) -> Result<String, DrawError> {
    let start_s = rows.first().map_or(0.0, |row| row.taken_s);
    // z = r (1 - cos θ)
    let share = |angle_rad: f64| 100.0 * (1.0 - angle_rad.cos());
    let panel = |side: usize, title| {
        let estimate = |row: &SinkageRow| Estimate {
            time_s: row.taken_s - start_s,
            value: share(row.angles_rad[side]),
            sigma: 100.0 * row.angles_rad[side].sin().abs() * row.sigmas_rad[side],
            ok: row.ok,
        };
        let known = rows.iter().zip(truth);
        Panel {
            title,
            guesses: true,
            estimates: rows.iter().map(estimate).collect(),
            truth: known
                .map(|(row, angles)| (row.taken_s - start_s, share(angles[side])))
                .collect(),
        }
    };
    let panels = [
        panel(0, "sinkage on the left [% of radius]"),
        panel(1, "sinkage on the right [% of radius]"),
    ];
    stacked(&panels, &[], "")
}

/// Figure 3 of the paper: of one picture, intensity and score against the angle from straight down, left and right; the
/// angles are what was found.
pub fn interface(picture: &str, profiles: &[Profile; 2], angles_rad: [f64; 2]) -> Result<String, DrawError> {
    let mut svg = String::new();
    let root = SVGBackend::with_string(&mut svg, (WIDTH_PX, LEGEND_PX + 2 * PANEL_PX)).into_drawing_area();
    root.fill(&WHITE)?;
    let (top, rest) = root.split_vertically(LEGEND_PX);
    let middle = LEGEND_PX as i32 / 2 + 8;
    top.draw(&Text::new(picture.to_owned(), (146, middle - 12), FONT))?;
    let mark = [
        (WIDTH_PX as i32 - 360, middle - 18),
        (WIDTH_PX as i32 - 360, middle + 18),
    ];
    top.draw(&PathElement::new(mark, thick(CHANGE)))?;
    top.draw(&Text::new("interface found", (mark[0].0 + 20, middle - 12), FONT))?;
    let [left, right] = profiles;
    let curves = [
        (&left.intensity, "filtered intensity, left", 0),
        (&right.intensity, "filtered intensity, right", 1),
        (&left.score, "probability, left", 0),
        (&right.score, "probability, right", 1),
    ];
    for ((points, title, side), area) in curves.into_iter().zip(rest.split_evenly((2, 2))) {
        draw_profile(&area, title, points, angles_rad[side])?;
    }
    root.present()?;
    drop((top, rest, root));
    Ok(svg)
}

/// One curve against the angle, and the angle that was found; `points` are in radians.
fn draw_profile(area: &Area, title: &str, points: &[(f64, f64)], found_rad: f64) -> Result<(), DrawError> {
    let limits = around(points.iter().map(|point| point.1), MARGIN);
    let mut chart = ChartBuilder::on(area)
        .margin(16)
        .margin_right(40)
        .x_label_area_size(90)
        .y_label_area_size(130)
        .build_cartesian_2d(0.0..90.0, limits.clone())?;
    chart
        .configure_mesh()
        .x_desc("angle from straight down [deg]")
        .y_desc(title)
        .axis_desc_style(FONT)
        .label_style(FONT)
        .x_labels(7)
        .y_labels(7)
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .draw()?;
    if found_rad.is_finite() {
        let found_deg = found_rad.to_degrees().clamp(0.0, 90.0);
        let line = [(found_deg, limits.start), (found_deg, limits.end)];
        chart.draw_series([PathElement::new(line, thick(CHANGE))])?;
    }
    let curve: Vec<(f64, f64)> = points
        .iter()
        .map(|(angle, value)| (angle.to_degrees(), *value))
        .collect();
    chart.draw_series([PathElement::new(curve, thick(ESTIMATE))])?;
    Ok(())
}

/// An estimate at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Estimate {
    time_s: f64,
    value: f64,
    sigma: f64,
    ok: bool,
}

impl Estimate {
    fn band(&self) -> [f64; 2] {
        let half = BAND_SIGMAS * self.sigma;
        [self.value - half, self.value + half]
    }
}

/// One quantity against time, and what it truly was, where that is known.
#[derive(Clone, Debug)]
struct Panel {
    title: &'static str,
    /// Also the guesses whose status is not ok belong on the axis.
    guesses: bool,
    estimates: Vec<Estimate>,
    truth: Vec<(f64, f64)>,
}

/// Panels below each other on the same time axis, with vertical lines at `marks_s`.
fn stacked(panels: &[Panel], marks_s: &[f64], mark: &str) -> Result<String, DrawError> {
    let mut svg = String::new();
    let size = (WIDTH_PX, LEGEND_PX + PANEL_PX * panels.len() as u32);
    let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
    root.fill(&WHITE)?;
    let (top, rest) = root.split_vertically(LEGEND_PX);
    draw_legend(&top, panels, (!marks_s.is_empty()).then_some(mark))?;
    let instants = panels.iter().flat_map(|panel| &panel.estimates).map(|row| row.time_s);
    let time_s = around(instants, 0.0);
    for (panel, area) in panels.iter().zip(rest.split_evenly((panels.len(), 1))) {
        draw_panel(&area, panel, &time_s, marks_s)?;
    }
    root.present()?;
    drop((top, rest, root));
    Ok(svg)
}

fn draw_panel(area: &Area, panel: &Panel, time_s: &Range<f64>, marks_s: &[f64]) -> Result<(), DrawError> {
    let limits = limits(panel);
    let mut chart = ChartBuilder::on(area)
        .margin(16)
        .margin_right(40)
        .x_label_area_size(90)
        .y_label_area_size(130)
        .build_cartesian_2d(time_s.clone(), limits.clone())?;
    chart
        .configure_mesh()
        .x_desc("time from the start [s]")
        .y_desc(panel.title)
        .axis_desc_style(FONT)
        .label_style(FONT)
        .x_labels(11)
        .y_labels(7)
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .draw()?;
    draw_band(&mut chart, &panel.estimates, &limits)?;
    let marks = marks_s.iter().filter(|instant_s| time_s.contains(instant_s));
    chart.draw_series(
        marks.map(|instant_s| PathElement::new([(*instant_s, limits.start), (*instant_s, limits.end)], thick(CHANGE))),
    )?;
    draw_line(&mut chart, &panel.estimates, &limits)?;
    let drawn = |(instant_s, value): &(f64, f64)| (time_s.start..=time_s.end).contains(instant_s) && value.is_finite();
    for run in panel.truth.split(|point| !drawn(point)).filter(|run| run.len() > 1) {
        chart.draw_series(DashedLineSeries::new(run.iter().copied(), 18, 12, thick(TRUTH)))?;
    }
    Ok(())
}

/// The 95 % band, cut off at the limits.
fn draw_band(chart: &mut Chart, estimates: &[Estimate], limits: &Range<f64>) -> Result<(), DrawError> {
    for run in runs(estimates, |row| row.band().iter().all(|edge| edge.is_finite())) {
        let edge = |side: usize| {
            run.iter()
                .map(move |row| (row.time_s, row.band()[side].clamp(limits.start, limits.end)))
        };
        let outline: Vec<(f64, f64)> = edge(0).chain(edge(1).rev()).collect();
        let style = colour(run).mix(0.25);
        if run.len() > 1 {
            chart.draw_series([Polygon::new(outline, style)])?;
        } else {
            chart.draw_series([PathElement::new(outline, style.stroke_width(3))])?;
        }
    }
    Ok(())
}

/// The estimate itself; where it leaves the limits, the line ends.
fn draw_line(chart: &mut Chart, estimates: &[Estimate], limits: &Range<f64>) -> Result<(), DrawError> {
    for run in runs(estimates, |row| limits.contains(&row.value)) {
        let points: Vec<(f64, f64)> = run.iter().map(|row| (row.time_s, row.value)).collect();
        if let [point] = points[..] {
            chart.draw_series([Circle::new(point, 8, colour(run).filled())])?;
        } else {
            chart.draw_series([PathElement::new(points, thick(colour(run)))])?;
        }
    }
    Ok(())
}

/// What the lines and areas are, above the panels.
fn draw_legend(area: &Area, panels: &[Panel], mark: Option<&str>) -> Result<(), DrawError> {
    let mut rows = panels.iter().flat_map(|panel| &panel.estimates);
    let doubted = rows.any(|row| !row.ok && row.value.is_finite());
    let truth = panels
        .iter()
        .any(|panel| panel.truth.iter().any(|point| point.1.is_finite()));
    let entries = [
        Some(("estimate, 95 % band", ESTIMATE)),
        doubted.then_some(("status not ok", DOUBTED)),
        truth.then_some(("truth", TRUTH)),
        mark.map(|label| (label, CHANGE)),
    ];
    let (mut left, middle) = (146, LEGEND_PX as i32 / 2 + 8);
    for (label, colour) in entries.into_iter().flatten() {
        let (start, end) = ((left, middle), (left + 54, middle));
        if colour == TRUTH {
            area.draw(&DashedPathElement::new([start, end], 18, 12, thick(colour)))?;
        } else if colour == CHANGE {
            let (bottom, top) = ((left + 40, middle + 18), (left + 40, middle - 18));
            area.draw(&PathElement::new([bottom, top], thick(colour)))?;
        } else {
            let corners = [(left, middle - 14), (left + 54, middle + 14)];
            area.draw(&Rectangle::new(corners, colour.mix(0.25).filled()))?;
            area.draw(&PathElement::new([start, end], thick(colour)))?;
        }
        area.draw(&Text::new(label.to_owned(), (left + 66, middle - 12), FONT))?;
        // About what the words take: no font is measured.
        left += 120 + 15 * label.len() as i32;
    }
    Ok(())
}

/// The stretches that are drawn in one piece and one colour: consecutive rows that are there, with the same trust.
fn runs(estimates: &[Estimate], there: impl Fn(&Estimate) -> bool) -> Vec<&[Estimate]> {
    let drawn = |row: &Estimate| row.time_s.is_finite() && there(row);
    let mut runs = Vec::new();
    for whole in estimates.split(|row| !drawn(row)) {
        let mut start = 0;
        for same in whole.chunk_by(|a, b| a.ok == b.ok) {
            let end = start + same.len();
            // One row further: a line does not break where only the status changes.
            runs.push(&whole[start..whole.len().min(end + 1)]);
            start = end;
        }
    }
    runs
}

/// The values that a panel's axis covers: nearly all of the bands, and all of the truth.
fn limits(panel: &Panel) -> Range<f64> {
    let edges = |only_ok: bool| -> Vec<f64> {
        let rows = panel.estimates.iter().filter(|row| row.ok || !only_ok);
        let edges = rows.flat_map(|row| {
            if row.sigma.is_finite() {
                row.band()
            } else {
                [row.value; 2]
            }
        });
        edges.filter(|edge| edge.is_finite()).collect()
    };
    let mut edges = Some(edges(true))
        .filter(|edges| !edges.is_empty())
        .unwrap_or_else(|| edges(false));
    edges.sort_by(f64::total_cmp);
    let skipped = (edges.len() as f64 * OUTSIDE / 2.0) as usize;
    let kept = &edges[skipped..edges.len() - skipped];
    let guesses = panel.estimates.iter().filter(|_| panel.guesses).map(|row| row.value);
    let truth = panel.truth.iter().map(|point| point.1);
    around(kept.iter().copied().chain(guesses).chain(truth), MARGIN)
}

/// From the smallest to the largest finite value, with a margin relative to their distance; never empty.
fn around(values: impl Iterator<Item = f64>, margin: f64) -> Range<f64> {
    let start = (f64::INFINITY, f64::NEG_INFINITY);
    let finite = values.filter(|value| value.is_finite());
    let (low, high) = finite.fold(start, |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return 0.0..1.0;
    }
    let width = (high - low).max(1e-3).max(1e-6 * low.abs().max(high.abs()));
    let added = margin * width + (width - (high - low)) / 2.0;
    low - added..high + added
}

fn colour(run: &[Estimate]) -> RGBColor {
    if run.first().is_some_and(|row| row.ok) {
        ESTIMATE
    } else {
        DOUBTED
    }
}

fn thick(colour: RGBColor) -> ShapeStyle {
    colour.stroke_width(4)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MISSING: SoilRow = SoilRow {
        taken_s: 0.0,
        cohesion_pa: f64::NAN,
        cohesion_sigma_pa: f64::NAN,
        friction_rad: f64::NAN,
        friction_sigma_rad: f64::NAN,
        resets: 0.0,
        ok: false,
    };

    fn rows(count: usize) -> Vec<SoilRow> {
        let row = |index: usize| SoilRow {
            taken_s: 5.0 + 0.1 * index as f64,
            cohesion_pa: 800.0 + 10.0 * (index % 3) as f64,
            cohesion_sigma_pa: 100.0,
            friction_rad: 0.5,
            friction_sigma_rad: 0.02,
            resets: 0.0,
            ok: true,
        };
        (0..count).map(row).collect()
    }

    fn truth(until_s: f64) -> Vec<SoilTruth> {
        let row = |taken_s| SoilTruth {
            taken_s,
            cohesion_pa: 900.0,
            friction_rad: 0.52,
        };
        [5.0, until_s].map(row).to_vec()
    }

    /// How many elements of this kind and colour there are, the legend's included.
    fn count(svg: &str, element: &str, colour: RGBColor) -> usize {
        let colour = format!("#{:02X}{:02X}{:02X}", colour.0, colour.1, colour.2);
        let opening = format!("<{element} ");
        svg.lines()
            .filter(|line| line.starts_with(&opening) && line.contains(&colour))
            .count()
    }

    #[test]
    fn a_figure_has_a_band_a_line_a_truth_and_titled_axes_for_each_quantity() {
        let svg = soil(&rows(30), &truth(7.9)).unwrap();
        assert!(svg.starts_with("<svg ") && svg.trim_end().ends_with("</svg>"));
        assert_eq!(count(&svg, "polygon", ESTIMATE), 2);
        assert_eq!(count(&svg, "polyline", ESTIMATE), 2 + 1);
        assert!(count(&svg, "polyline", TRUTH) > 20);
        for words in [
            "cohesion [kPa]",
            "friction angle [deg]",
            "time from the start [s]",
            "truth",
        ] {
            assert!(svg.contains(words), "{words}");
        }
        // The last instant is 2.9 s after the first, whatever the recording's clock said.
        assert!(svg.contains("\n2.0\n") && !svg.contains("\n5.0\n"), "{svg}");
        assert_eq!(count(&svg, "polyline", DOUBTED) + count(&svg, "polyline", CHANGE), 0);
    }

    #[test]
    fn an_interface_is_marked_on_all_four_curves_where_it_was_found() {
        let profile = Profile {
            intensity: vec![(1.5, 180.0), (0.6, 170.0), (0.5, 90.0), (0.1, 80.0)],
            score: vec![(1.5, 0.0), (0.55, 1.0), (0.1, 0.0)],
        };
        let empty = Profile {
            intensity: Vec::new(),
            score: Vec::new(),
        };
        let svg = interface("000.png", &[profile.clone(), profile.clone()], [0.55, 0.56]).unwrap();
        assert_eq!(count(&svg, "polyline", ESTIMATE), 4);
        assert_eq!(count(&svg, "polyline", CHANGE), 4 + 1);
        assert!(svg.contains("000.png") && svg.contains("filtered intensity, left"));
        let svg = interface("000.png", &[profile, empty], [0.55, f64::NAN]).unwrap();
        assert_eq!(count(&svg, "polyline", CHANGE), 2 + 1);
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn without_a_truth_there_is_no_truth_line() {
        let svg = soil(&rows(30), &[]).unwrap();
        assert!(!svg.contains("truth"));
        let outside = soil(&rows(30), &truth(f64::NAN)).unwrap();
        assert_eq!(count(&outside, "polyline", TRUTH), count(&svg, "polyline", TRUTH) + 2);
    }

    #[test]
    fn each_change_of_soil_is_a_mark_in_each_panel() {
        let mut rows = rows(30);
        rows[10..].iter_mut().for_each(|row| row.resets = 1.0);
        rows[20..].iter_mut().for_each(|row| row.resets = 2.0);
        let svg = soil(&rows, &[]).unwrap();
        assert_eq!(count(&svg, "polyline", CHANGE), 2 * 2 + 1);
        assert!(svg.contains("change of soil"));
    }

    #[test]
    fn missing_rows_leave_a_gap_and_doubted_ones_are_grey() {
        let mut rows = rows(30);
        rows[10] = SoilRow {
            taken_s: rows[10].taken_s,
            ..MISSING
        };
        let svg = soil(&rows, &[]).unwrap();
        assert_eq!(count(&svg, "polygon", ESTIMATE), 2 * 2);
        assert_eq!(count(&svg, "polyline", ESTIMATE), 2 * 2 + 1);
        rows[20..].iter_mut().for_each(|row| row.ok = false);
        let svg = soil(&rows, &[]).unwrap();
        assert_eq!(count(&svg, "polygon", ESTIMATE), 2 * 2);
        assert_eq!(count(&svg, "polygon", DOUBTED), 2);
        assert!(svg.contains("status not ok"));
    }

    #[test]
    fn nothing_that_rows_can_hold_stops_the_drawing() {
        let odd = [
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            0.0,
            -1e9,
            1e9,
            1e300,
            -1e300,
            1e-300,
        ];
        for value in odd {
            for sigma in odd {
                for count in [0, 1, 2, 5] {
                    let mut rows = rows(count);
                    for row in rows.iter_mut().step_by(2) {
                        (row.cohesion_pa, row.cohesion_sigma_pa, row.resets) = (value, sigma, value);
                    }
                    let svg = soil(&rows, &truth(value)).unwrap();
                    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{value} {sigma} {count}");
                    rows.iter_mut().skip(1).for_each(|row| row.taken_s = value);
                    soil(&rows, &[]).unwrap();
                }
            }
        }
    }

    #[test]
    fn a_wild_first_sigma_does_not_widen_the_axis() {
        let mut rows = rows(200);
        let tame = limits(&cohesion(&rows));
        rows[0].cohesion_sigma_pa = 1e6;
        rows[1].cohesion_pa = -1e6;
        assert_eq!(limits(&cohesion(&rows)), tame);
    }

    /// The panel that `soil` makes of the cohesion, in Pa.
    fn cohesion(rows: &[SoilRow]) -> Panel {
        let estimate = |row: &SoilRow| Estimate {
            time_s: row.taken_s,
            value: row.cohesion_pa,
            sigma: row.cohesion_sigma_pa,
            ok: row.ok,
        };
        Panel {
            title: "",
            guesses: false,
            estimates: rows.iter().map(estimate).collect(),
            truth: Vec::new(),
        }
    }

    #[test]
    fn a_guess_of_the_sinkage_is_on_the_axis() {
        let row = |taken_s: f64, angle_rad: f64| SinkageRow {
            taken_s,
            angles_rad: [angle_rad; 2],
            sigmas_rad: [0.01; 2],
            ok: angle_rad > 0.2,
        };
        let svg = sinkage(&[row(0.0, 0.5), row(1.0, 0.5), row(2.0, 0.1), row(3.0, 0.1)], &[]).unwrap();
        // In each panel; in the legend once.
        assert_eq!(count(&svg, "polyline", DOUBTED), 2 + 1);
    }

    #[test]
    fn an_axis_is_never_empty() {
        for values in [vec![], vec![3.0, 3.0], vec![f64::NAN], vec![0.0], vec![1e9, 1e9]] {
            let range = around(values.iter().copied(), 0.0);
            assert!(range.end - range.start > 1e-4, "{values:?}: {range:?}");
            assert!(values.iter().all(|value| value.is_nan() || range.contains(value)));
        }
    }
}
