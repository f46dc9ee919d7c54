//! `terrasense annotate`: finds the wheel in one's own pictures and writes their frames.csv, with overlays to check.

use crate::overlay;
use clap::Args;
use image::GrayImage;
use shell::Error;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use traverse::FrameRow;

/// Side of a cell of centres that votes are counted in [px].
const CELL_PX: usize = 3;
/// Width to which a picture is reduced for the search [px].
const SEARCH_PX: u32 = 240;
/// Radii that are looked for, as shares of the picture's smaller side.
const RADII: (f64, f64) = (0.12, 0.6);
/// Rim to outer radius.
const RATIOS: (f64, f64) = (0.6, 0.96);
/// Votes over radius below which there is no circle: a perfect one has some 2π.
const VOTES_MIN: f32 = 0.8;
/// Rays on which an edge is measured: all but those near straight down, where soil may be.
const RAYS: usize = 180;
const COSINE_MAX: f64 = 0.6;

/// `terrasense annotate`
#[derive(Debug, Args)]
pub struct AnnotateArguments {
    /// A folder of PNG pictures of a wheel, seen from the side. `frames.csv` is written into it.
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    /// Seconds from one picture to the next.
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    interval: f64,
    /// Replaces a frames.csv that is there.
    #[arg(long)]
    replace: bool,
}

/// Finds the wheel in every picture.
pub fn run(arguments: &AnnotateArguments) -> Result<ExitCode, Error> {
    let folder = &arguments.folder;
    let table = folder.join("frames.csv");
    if table.exists() && !arguments.replace {
        return Err(Error::data(format!(
            "{}: is there; --replace replaces it",
            table.display()
        )));
    }
    if !(arguments.interval > 0.0 && arguments.interval < 1e6) {
        return Err(Error::data("--interval: must be above 0 and below 1000000"));
    }
    let pictures = pictures(folder)?;
    let shown = folder.join("overlay");
    std::fs::create_dir_all(&shown).map_err(|error| at(&shown, &error))?;
    let mut text = String::from("file,taken_s,center_x_px,center_y_px,rim_radius_px,wheel_radius_px,pitch_rad\n");
    let mut missing = 0;
    for (sequence, file) in pictures.iter().enumerate() {
        let path = folder.join(file);
        let picture = image::open(&path).map_err(|error| at(&path, &error))?;
        let Some(wheel) = find(&picture.to_luma8()) else {
            eprintln!("terrasense: {}: no wheel found; left out", path.display());
            missing += 1;
            continue;
        };
        let taken_s = sequence as f64 * arguments.interval;
        let _ = writeln!(
            text,
            "{file},{taken_s:.6},{:.2},{:.2},{:.2},{:.2},0",
            wheel.center.0, wheel.center.1, wheel.rim_px, wheel.outer_px
        );
        let mut picture = picture.into_rgb8();
        overlay::draw(&mut picture, &row(file, sequence, &wheel), None);
        let path = shown.join(file);
        picture.save(&path).map_err(|error| at(&path, &error))?;
    }
    std::fs::write(&table, text).map_err(|error| at(&table, &error))?;
    println!(
        "{}: {} pictures; look at {} and correct what is wrong, the pitch too",
        table.display(),
        pictures.len() - missing,
        shown.display()
    );
    Ok(ExitCode::from(u8::from(missing > 0)))
}

fn at(path: &Path, error: &dyn std::fmt::Display) -> Error {
    Error::data(format!("{}: {error}", path.display()))
}

/// The PNG files of a folder, by name.
fn pictures(folder: &Path) -> Result<Vec<String>, Error> {
    let entries = std::fs::read_dir(folder).map_err(|error| at(folder, &error))?;
    let mut files: Vec<String> = entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|file| file.to_ascii_lowercase().ends_with(".png") && !file.contains([',', '"']))
        .collect();
    files.sort();
    if files.is_empty() {
        return Err(at(folder, &"no PNG pictures; convert others to PNG first"));
    }
    Ok(files)
}

fn row(file: &str, sequence: usize, wheel: &Wheel) -> FrameRow {
    FrameRow {
        line: 0,
        sequence: sequence as u64,
        file: file.to_owned(),
        taken_ns: 0,
        center_x_px: wheel.center.0,
        center_y_px: wheel.center.1,
        rim_radius_px: wheel.rim_px,
        wheel_radius_px: wheel.outer_px,
        pitch_rad: 0.0,
        homography: None,
    }
}

/// A wheel, seen as two circles about one centre [px].
#[derive(Clone, Copy, Debug)]
struct Wheel {
    center: (f64, f64),
    rim_px: f64,
    outer_px: f64,
}

/// The pair of circles with the strongest edges: coarsely by votes in a small picture, then in the picture itself.
fn find(picture: &GrayImage) -> Option<Wheel> {
    let (width, height) = picture.dimensions();
    let scale = (f64::from(width) / f64::from(SEARCH_PX)).max(1.0);
    let small = image::imageops::thumbnail(
        picture,
        (f64::from(width) / scale) as u32,
        (f64::from(height) / scale) as u32,
    );
    let (center, radius) = vote(&small)?;
    let center = ((center.0 + 0.5) * scale - 0.5, (center.1 + 0.5) * scale - 0.5);
    let (center, radius) = settle(picture, center, radius * scale, scale * CELL_PX as f64);
    // The circle that was found is the rim's inner edge or the outer one: the stronger second circle decides.
    let best = |from: f64, to: f64| {
        let steps = ((to - from).abs() * radius).ceil() as usize;
        (0..=steps)
            .map(|k| radius * (from + (to - from) * k as f64 / steps.max(1) as f64))
            .map(|other| (edge(picture, center, other), other))
            .max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let (inner, outer) = (best(RATIOS.0, RATIOS.1)?, best(1.0 / RATIOS.1, 1.0 / RATIOS.0)?);
    let (rim_px, outer_px) = if inner.0 > outer.0 {
        (inner.1, radius)
    } else {
        (radius, outer.1)
    };
    Some(Wheel {
        center,
        rim_px,
        outer_px,
    })
}

/// Centre and radius that most edges point to: each votes along its gradient, both ways.
fn vote(picture: &GrayImage) -> Option<((f64, f64), f64)> {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let smaller = width.min(height) as f64;
    let (least, most) = ((RADII.0 * smaller) as usize, (RADII.1 * smaller) as usize);
    if least < 4 {
        return None;
    }
    let gray = |x: usize, y: usize| f64::from(picture.get_pixel(x as u32, y as u32).0[0]);
    let mut edges = Vec::new();
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let (dx, dy) = (gray(x + 1, y) - gray(x - 1, y), gray(x, y + 1) - gray(x, y - 1));
            edges.push((dx.hypot(dy), x as f64, y as f64, dx, dy));
        }
    }
    edges.sort_by(|a, b| b.0.total_cmp(&a.0));
    edges.truncate(edges.len() / 6);
    let (columns, rows) = (width.div_ceil(CELL_PX), height.div_ceil(CELL_PX));
    let mut votes = vec![0.0_f32; (most + 1 - least) * columns * rows];
    for &(size, x, y, dx, dy) in edges.iter().filter(|edge| edge.0 > 8.0) {
        for radius in least..=most {
            for sign in [-1.0, 1.0] {
                let (column, row) = (
                    x + sign * radius as f64 * dx / size,
                    y + sign * radius as f64 * dy / size,
                );
                if column >= 0.0 && row >= 0.0 && (column as usize) < width && (row as usize) < height {
                    let k = ((radius - least) * rows + row as usize / CELL_PX) * columns + column as usize / CELL_PX;
                    votes[k] += 1.0 / radius as f32;
                }
            }
        }
    }
    let (k, most) = votes.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    let middle = |cell: usize| (cell * CELL_PX) as f64 + 0.5 * (CELL_PX - 1) as f64;
    (*most > VOTES_MIN).then_some((
        (middle(k % columns), middle(k / columns % rows)),
        (k / (columns * rows) + least) as f64,
    ))
}

/// Moves centre and radius to where the edge is strongest, in ever smaller steps.
fn settle(picture: &GrayImage, center: (f64, f64), radius: f64, reach: f64) -> ((f64, f64), f64) {
    let start = radius;
    let mut best = (edge(picture, center, radius), center, radius);
    let mut step = 2.0 * reach;
    while step > 0.1 {
        let before = best;
        for (x, y, r) in (0..27).map(|k| (k % 3, k / 3 % 3, k / 9)) {
            let move_by = |k: i32| f64::from(k - 1) * step;
            let center = (before.1.0 + move_by(x), before.1.1 + move_by(y));
            let radius = before.2 + move_by(r);
            let strength = edge(picture, center, radius);
            // Smaller and smaller circles would end on a spoke.
            if strength > best.0 && (radius / start - 1.0).abs() < 0.15 {
                best = (strength, center, radius);
            }
        }
        if best.0 <= before.0 {
            step *= 0.5;
        }
    }
    (best.1, best.2)
}

/// Mean size of the step across a circle over the rays on which soil is seldom.
fn edge(picture: &GrayImage, center: (f64, f64), radius: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for k in 0..RAYS {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / RAYS as f64).sin_cos();
        if cos > COSINE_MAX {
            continue;
        }
        let gray = |radius: f64| {
            let (column, row) = (center.0 + radius * sin, center.1 + radius * cos);
            let inside = column >= 0.0 && row >= 0.0;
            let pixel = picture.get_pixel_checked(column.round() as u32, row.round() as u32);
            pixel.filter(|_| inside).map(|pixel| f64::from(pixel.0[0]))
        };
        count += 1.0;
        if let (Some(inner), Some(outer)) = (gray(radius - 1.5), gray(radius + 1.5)) {
            sum += (outer - inner).abs();
        }
    }
    sum / count
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Luma;

    #[test]
    fn a_drawn_wheel_is_found_to_a_pixel() {
        let picture = GrayImage::from_fn(640, 480, |x, y| {
            let radius = (f64::from(x) - 310.0).hypot(f64::from(y) - 205.0);
            let soil = y > 330;
            Luma([match radius {
                _ if soil => 120,
                r if r < 120.0 => 30,
                r if r < 150.0 => 180,
                _ => 90,
            }])
        });
        let wheel = find(&picture).unwrap();
        assert!(
            (wheel.center.0 - 310.0).abs() < 1.0 && (wheel.center.1 - 205.0).abs() < 1.0,
            "{wheel:?}"
        );
        assert!(
            (wheel.rim_px - 120.0).abs() < 1.5 && (wheel.outer_px - 150.0).abs() < 1.5,
            "{wheel:?}"
        );
    }

    #[test]
    fn an_empty_picture_has_no_wheel() {
        for (width, height) in [(1, 1), (3, 2), (640, 480)] {
            assert!(find(&GrayImage::new(width, height)).is_none());
        }
    }
}
