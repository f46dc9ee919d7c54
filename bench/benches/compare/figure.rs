//! The picture: for each variant a bar from p50 to p99 of the whole cycle, on a logarithmic scale.

use bench::Series;
use std::fmt::Write as _;

const WIDTH_PX: f64 = 900.0;
const NAMES_PX: f64 = 210.0;
const ROW_PX: f64 = 26.0;
const TITLE_PX: f64 = 40.0;

/// Draws the tables one below the other.
pub fn draw(tables: &[(String, Vec<Series>)]) -> String {
    let filled = |series: &&Series| series.quantile_us(1.0) > 0.0;
    let all = || tables.iter().flat_map(|(_, series)| series.iter()).filter(filled);
    let low = all().map(Series::p50_us).fold(f64::INFINITY, f64::min).max(1.0);
    let high = all().map(|series| series.quantile_us(0.99)).fold(low * 2.0, f64::max);
    let (low, high) = ((low * 0.8).log10(), (high * 1.3).log10());
    let x = |micro: f64| NAMES_PX + (WIDTH_PX - NAMES_PX - 90.0) * (micro.max(1.0).log10() - low) / (high - low);
    let rows: usize = tables.iter().map(|(_, series)| series.len()).sum();
    let height = rows as f64 * ROW_PX + tables.len() as f64 * TITLE_PX + 20.0;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH_PX} {height}\" font-family=\"sans-serif\" \
         font-size=\"13\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    let mut y = 0.0;
    for (title, series) in tables {
        let _ = writeln!(
            svg,
            "<text x=\"10\" y=\"{:.0}\" font-weight=\"bold\">{title}</text>",
            y + 26.0
        );
        y += TITLE_PX;
        for each in series.iter().filter(filled) {
            let (p50, p99) = (each.p50_us(), each.quantile_us(0.99));
            let (from, to) = (x(p50), x(p99));
            let _ = write!(
                svg,
                "<text x=\"10\" y=\"{0:.0}\">{1}</text>\n<rect x=\"{from:.1}\" y=\"{2:.0}\" width=\"{3:.1}\" height=\"14\" \
                 fill=\"#56b4e9\"/>\n<rect x=\"{from:.1}\" y=\"{2:.0}\" width=\"3\" height=\"14\" fill=\"#0072b2\"/>\n\
                 <text x=\"{4:.1}\" y=\"{0:.0}\">{p50:.0} … {p99:.0}</text>\n",
                y + 14.0,
                each.name(),
                y + 2.0,
                (to - from).max(3.0),
                to.max(from + 3.0) + 6.0,
            );
            y += ROW_PX;
        }
    }
    let _ = writeln!(
        svg,
        "<text x=\"10\" y=\"{:.0}\" fill=\"#555555\">frame to terrain, µs: p50 … p99, logarithmic</text>\n</svg>",
        height - 6.0
    );
    svg
}
