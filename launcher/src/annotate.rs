//! `terrasense annotate`: finds the wheel in one's own pictures and writes their frames.csv, with overlays to check.

use crate::overlay;
use crate::perspective::Face;
use clap::Args;
use image::GrayImage;
use shell::Error;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use traverse::{FRAME_COLUMNS, FrameRow};

/// Pitches beyond this are a mistake.
const PITCH_MAX_RAD: f64 = 1.6;
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
/// Circles with the most votes that are looked at, and pairs of circles that are settled.
const CIRCLES: usize = 24;
const PAIRS: usize = 4;
/// Gray values of a step from which on it counts as a whole edge: no edge outshouts many.
const STEP: f64 = 24.0;
/// Sizes that differ by less are the same, relative to their mean.
const SAME_SIZE: f64 = 0.015;
/// Strength below which there is no wheel.
const STRENGTH_MIN: f64 = 0.6;
/// Share of the usual strength below which a wheel is to be doubted.
const WEAK: f64 = 0.7;
/// Rays on which an edge is measured: all but those near straight down, where soil may be.
const RAYS: usize = 180;
const COSINE_MAX: f64 = 0.6;

/// `terrasense annotate`
#[derive(Debug, Args)]
#[command(after_long_help = HELP)]
pub struct AnnotateArguments {
    /// A folder of PNG or JPEG pictures of a wheel, seen from the side. `frames.csv` is written into it.
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    /// Seconds from one picture to the next.
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    interval: f64,
    /// The angle by which straight down, on the rover, is turned towards the right of the picture [rad]: of a camera that is
    /// fixed to the rover it is the same in all pictures. It cannot be seen in a picture of a wheel.
    #[arg(long, value_name = "RAD", default_value_t = 0.0, allow_negative_numbers = true)]
    pitch: f64,
    /// Whether the rim may be an ellipse, because the camera does not look straight at the wheel: h11 to h33 are then written.
    #[arg(long, value_enum, default_value_t = Perspective::Detect)]
    perspective: Perspective,
    /// Replaces a frames.csv that is there.
    #[arg(long)]
    replace: bool,
}

const HELP: &str = "\
Each row of frames.csv gives a picture's wheel: centre and radii, the pitch, and, where the rim is visibly no circle, the
homography h11 to h33 (row by row) from the wheel's face to the picture: X to the right and Z down along the rover's own axes,
the outer radius being 1. The sinkage is measured along Z.

The pitch: v_down = (sin pitch, cos pitch) in the picture, x to the right and y down. Lay a straight line through two points
of the rover that are one above the other, (x1, y1) the upper and (x2, y2) the lower one: pitch = atan2(x2 - x1, y2 - y1). Or
of two points that are level, (x1, y1) left and (x2, y2) right: pitch = atan2(y1 - y2, x2 - x1).

Perspective: a wheel that is seen at an angle is an ellipse, and its centre is not in the ellipse's middle. A circle is then wrong
by some percent of the radius. `detect` fits the homography to both edges of the rim, and writes it where they are visibly no circles.
Check the overlays: both drawn edges must lie on the rim all around.

  terrasense annotate pictures --interval 0.5 --pitch -0.03
";

/// How the rim is seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Perspective {
    /// As an ellipse where it visibly is one, else as a circle.
    Detect,
    /// As a circle.
    None,
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
    if arguments.pitch.is_nan() || arguments.pitch.abs() > PITCH_MAX_RAD {
        return Err(Error::data(format!(
            "--pitch: must be -{PITCH_MAX_RAD} to {PITCH_MAX_RAD} rad"
        )));
    }
    let pictures = pictures(folder)?;
    let shown = folder.join("overlay");
    std::fs::create_dir_all(&shown).map_err(|error| at(&shown, &error))?;
    let wheels = agree(folder, &pictures)?;
    let (mut rows, mut missing) = (Vec::new(), 0);
    for (sequence, (file, wheel)) in pictures.iter().zip(&wheels).enumerate() {
        let path = folder.join(file);
        let Some(wheel) = wheel else {
            shell::tell(format_args!(
                "terrasense: {}: no wheel found of {} to {} of the picture's smaller side in radius; left out",
                path.display(),
                RADII.0,
                RADII.1
            ));
            missing += 1;
            continue;
        };
        let picture = image::open(&path).map_err(|error| at(&path, &error))?;
        let face = match arguments.perspective {
            Perspective::Detect => Face::find(&picture.to_luma8(), wheel.center, wheel.rim_px, wheel.outer_px),
            Perspective::None => None,
        };
        let row = row(file, sequence, wheel, face, arguments);
        let mut picture = picture.into_rgb8();
        overlay::draw(&mut picture, &row, None);
        let path = shown.join(file);
        picture.save(&path).map_err(|error| at(&path, &error))?;
        rows.push(row);
    }
    let seen_askew = rows.iter().filter(|row| row.homography.is_some()).count();
    let text = table_of(&rows);
    std::fs::write(&table, text).map_err(|error| at(&table, &error))?;
    println!(
        "{}: {} pictures, {seen_askew} of them with a homography; look at {} and correct what is wrong; the pitch is {} rad \
         in all of them (--help says how to measure it)",
        table.display(),
        rows.len(),
        shown.display(),
        arguments.pitch
    );
    Ok(ExitCode::from(u8::from(missing > 0)))
}

/// The wheel of each picture. Pictures of the same width and height show one wheel, at one distance: those that disagree
/// with most of the others on its size are searched again for a wheel of theirs.
fn agree(folder: &Path, files: &[String]) -> Result<Vec<Option<Wheel>>, Error> {
    let open = |file: &String| {
        let path = folder.join(file);
        let picture = image::open(&path).map_err(|error| at(&path, &error))?;
        Ok::<GrayImage, Error>(picture.into_luma8())
    };
    let mut wheels = Vec::new();
    let mut groups: BTreeMap<(u32, u32), Vec<usize>> = BTreeMap::new();
    for (index, file) in files.iter().enumerate() {
        let picture = open(file)?;
        groups.entry(picture.dimensions()).or_default().push(index);
        wheels.push(find(&picture, None));
    }
    for members in groups.values() {
        let found: Vec<Wheel> = members.iter().filter_map(|index| wheels[*index]).collect();
        let Some(usual) = usual(&found) else {
            if found.len() > 1 {
                shell::tell(format_args!(
                    "terrasense: {}: no two pictures agree on the wheel's size; check each",
                    folder.display()
                ));
            }
            continue;
        };
        for &index in members {
            let before = wheels[index];
            let agrees = before.is_some_and(|wheel| wheel.has_size_of(&usual));
            let picture = open(&files[index])?;
            let after = match before.filter(|_| agrees) {
                Some(wheel) => Some(settle(
                    &picture,
                    Wheel {
                        center: wheel.center,
                        ..usual
                    },
                    false,
                )),
                None => find(&picture, Some(&usual)),
            };
            let doubted = after.is_some_and(|wheel| wheel.strength < WEAK * usual.strength);
            let path = folder.join(&files[index]);
            if doubted {
                shell::tell(format_args!(
                    "terrasense: {}: the wheel is hardly seen; check it",
                    path.display()
                ));
            } else if !agrees {
                shell::tell(format_args!(
                    "terrasense: {}: disagreed on the wheel's size; searched again with that of the others, check it",
                    path.display()
                ));
            }
            wheels[index] = after;
        }
    }
    Ok(wheels)
}

/// The medians of the most wheels that agree on their size; `None` where no two do.
fn usual(wheels: &[Wheel]) -> Option<Wheel> {
    let alike = |wheel: &Wheel| wheels.iter().filter(|other| wheel.has_size_of(other)).count();
    // The first of those with the most.
    let middle = wheels.iter().rev().max_by_key(|wheel| alike(wheel))?;
    let same: Vec<&Wheel> = wheels.iter().filter(|wheel| wheel.has_size_of(middle)).collect();
    let median = |value: fn(&Wheel) -> f64| {
        let mut values: Vec<f64> = same.iter().map(|wheel| value(wheel)).collect();
        values.sort_by(f64::total_cmp);
        0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
    };
    (same.len() > 1).then(|| Wheel {
        center: (median(|wheel| wheel.center.0), median(|wheel| wheel.center.1)),
        rim_px: median(|wheel| wheel.rim_px),
        outer_px: median(|wheel| wheel.outer_px),
        strength: median(|wheel| wheel.strength),
    })
}

fn at(path: &Path, error: &dyn std::fmt::Display) -> Error {
    Error::data(format!("{}: {error}", path.display()))
}

/// The PNG and JPEG files of a folder, by name.
fn pictures(folder: &Path) -> Result<Vec<String>, Error> {
    let entries = std::fs::read_dir(folder).map_err(|error| at(folder, &error))?;
    let mut files: Vec<String> = entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|file| {
            let name = file.to_ascii_lowercase();
            [".png", ".jpg", ".jpeg"].iter().any(|kind| name.ends_with(kind)) && !file.contains([',', '"'])
        })
        .collect();
    files.sort();
    if files.is_empty() {
        return Err(at(folder, &"no PNG or JPEG pictures; convert others to PNG first"));
    }
    Ok(files)
}

fn row(file: &str, sequence: usize, wheel: &Wheel, face: Option<Face>, arguments: &AnnotateArguments) -> FrameRow {
    let circle = FrameRow {
        line: 0,
        sequence: sequence as u64,
        file: file.to_owned(),
        taken_ns: (sequence as f64 * arguments.interval * 1e9).round() as u64,
        center_x_px: wheel.center.0,
        center_y_px: wheel.center.1,
        rim_radius_px: wheel.rim_px,
        wheel_radius_px: wheel.outer_px,
        pitch_rad: arguments.pitch,
        homography: None,
    };
    let Some(face) = face else { return circle };
    let (center, outer_px) = (face.pixel(0.0, 0.0), face.outer_px());
    FrameRow {
        center_x_px: center.0,
        center_y_px: center.1,
        rim_radius_px: face.rim * outer_px,
        wheel_radius_px: outer_px,
        homography: Some(face.pitched(arguments.pitch)),
        ..circle
    }
}

/// The text of frames.csv; with the homography's columns where a row has one.
fn table_of(rows: &[FrameRow]) -> String {
    let columns = if rows.iter().any(|row| row.homography.is_some()) {
        FRAME_COLUMNS.len()
    } else {
        FRAME_COLUMNS.len() - 9
    };
    let mut text = FRAME_COLUMNS[..columns].join(",") + "\n";
    for row in rows {
        let _ = write!(
            text,
            "{},{:.6},{:.2},{:.2},{:.2},{:.2},{}",
            row.file,
            row.taken_ns as f64 * 1e-9,
            row.center_x_px,
            row.center_y_px,
            row.rim_radius_px,
            row.wheel_radius_px,
            row.pitch_rad
        );
        match row.homography {
            Some(homography) => {
                for value in homography {
                    let _ = write!(text, ",{value:.6}");
                }
            }
            None => text.push_str(&",".repeat(columns - (FRAME_COLUMNS.len() - 9))),
        }
        text.push('\n');
    }
    text
}

/// A wheel, seen as two circles about one centre [px].
#[derive(Clone, Copy, Debug)]
struct Wheel {
    center: (f64, f64),
    rim_px: f64,
    outer_px: f64,
    /// How much of the two circles is seen, 0 to 2.
    strength: f64,
}

impl Wheel {
    fn new(picture: &GrayImage, center: (f64, f64), rim_px: f64, outer_px: f64) -> Self {
        // Between spokes the rim's inner edge is of one kind; outside there may be sky and ground.
        let strength = edge(picture, center, rim_px).0.abs() + edge(picture, center, outer_px).1;
        Self {
            center,
            rim_px,
            outer_px,
            strength,
        }
    }

    fn has_size_of(&self, other: &Self) -> bool {
        let alike = |a: f64, b: f64| (a - b).abs() < SAME_SIZE * (a + b);
        alike(self.rim_px, other.rim_px) && alike(self.outer_px, other.outer_px)
    }
}

/// The pair of circles that is seen best, or, where the size is known, the place: coarsely by votes in a small picture,
/// then in the picture itself.
fn find(picture: &GrayImage, size: Option<&Wheel>) -> Option<Wheel> {
    let (width, height) = picture.dimensions();
    let scale = (f64::from(width) / f64::from(SEARCH_PX)).max(1.0);
    let small = image::imageops::thumbnail(
        picture,
        (f64::from(width) / scale) as u32,
        (f64::from(height) / scale) as u32,
    );
    let mut candidates = Vec::new();
    for (center, radius) in vote(&small) {
        let center = ((center.0 + 0.5) * scale - 0.5, (center.1 + 0.5) * scale - 0.5);
        match size {
            Some(size) => candidates.push(Wheel::new(picture, center, size.rim_px, size.outer_px)),
            None => candidates.extend(best_pair(picture, center, radius * scale)),
        }
    }
    if let Some(size) = size {
        candidates.push(Wheel::new(picture, size.center, size.rim_px, size.outer_px));
    }
    candidates.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    let settled = candidates
        .into_iter()
        .take(PAIRS)
        .map(|wheel| settle(picture, wheel, size.is_none()));
    settled
        .max_by(|a, b| a.strength.total_cmp(&b.strength))
        .filter(|wheel| wheel.strength >= STRENGTH_MIN)
}

/// The circle that was found is the rim's inner edge or the outer one: the second circle that is seen best decides.
fn best_pair(picture: &GrayImage, center: (f64, f64), radius: f64) -> Option<Wheel> {
    let steps = (1.5 * (RATIOS.1 - RATIOS.0) * radius.min(400.0)).ceil();
    let ratios = (0..=steps as usize).map(|k| RATIOS.0 + (RATIOS.1 - RATIOS.0) * k as f64 / steps);
    ratios
        .flat_map(|ratio| {
            [
                Wheel::new(picture, center, radius, radius / ratio),
                Wheel::new(picture, center, radius * ratio, radius),
            ]
        })
        .max_by(|a, b| a.strength.total_cmp(&b.strength))
}

/// Centres and radii that most edges point to: each votes along its gradient, both ways.
fn vote(picture: &GrayImage) -> Vec<((f64, f64), f64)> {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let smaller = width.min(height) as f64;
    let (least, most) = ((RADII.0 * smaller) as usize, (RADII.1 * smaller) as usize);
    if least < 4 {
        return Vec::new();
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
    strongest(&mut votes, columns, rows)
        .into_iter()
        .map(|(column, row, layer)| {
            let middle = |cell: usize| (cell * CELL_PX) as f64 + 0.5 * (CELL_PX - 1) as f64;
            ((middle(column), middle(row)), (layer + least) as f64)
        })
        .collect()
}

/// Column, row and layer of the cells with the most votes, none a neighbour of another; takes the votes away.
fn strongest(votes: &mut [f32], columns: usize, rows: usize) -> Vec<(usize, usize, usize)> {
    let layers = votes.len() / (columns * rows);
    let mut cells = Vec::new();
    while cells.len() < CIRCLES {
        let most = votes.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        let Some((k, _)) = most.filter(|(_, votes)| **votes > VOTES_MIN) else {
            break;
        };
        let (column, row, layer) = (k % columns, k / columns % rows, k / (columns * rows));
        cells.push((column, row, layer));
        for layer in layer.saturating_sub(3)..(layer + 4).min(layers) {
            for row in row.saturating_sub(1)..(row + 2).min(rows) {
                let start = (layer * rows + row) * columns;
                votes[start + column.saturating_sub(1)..start + (column + 2).min(columns)].fill(0.0);
            }
        }
    }
    cells
}

/// Moves a wheel to where it is seen best, in ever smaller steps; its radii too where they are free.
fn settle(picture: &GrayImage, wheel: Wheel, free: bool) -> Wheel {
    let mut best = wheel;
    let mut step = wheel.outer_px / 20.0;
    let radii = if free { 3 } else { 1 };
    while step > 0.1 {
        let before = best;
        for k in 0..9 * radii * radii {
            let move_by = |k: i32, count: i32| f64::from(k - count / 2) * step;
            let center = (
                before.center.0 + move_by(k % 3, 3),
                before.center.1 + move_by(k / 3 % 3, 3),
            );
            let rim_px = before.rim_px + move_by(k / 9 % radii, radii);
            let outer_px = before.outer_px + move_by(k / 9 / radii, radii);
            let moved = Wheel::new(picture, center, rim_px, outer_px);
            if moved.strength > best.strength && (RATIOS.0..RATIOS.1).contains(&(rim_px / outer_px)) {
                best = moved;
            }
        }
        if best.strength <= before.strength {
            step *= 0.5;
        }
    }
    best
}

/// Mean step across a circle over the rays on which soil is seldom, -1 to 1, and mean size of the step.
fn edge(picture: &GrayImage, center: (f64, f64), radius: f64) -> (f64, f64) {
    let (mut sum, mut size, mut count) = (0.0, 0.0, 0.0);
    let reach = (radius / 100.0).max(1.5);
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
        if let (Some(inner), Some(outer)) = (gray(radius - reach), gray(radius + reach)) {
            let step = ((outer - inner) / STEP).clamp(-1.0, 1.0);
            sum += step;
            size += step.abs();
        }
    }
    (sum / count, size / count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Luma;
    use zerocopy::FromZeros;

    /// A rim of 120 to 150 px, with soil below; what is nearer than 40 px to `decoy` is white, and black around.
    fn drawn(center: (f64, f64), decoy: Option<(f64, f64)>) -> GrayImage {
        GrayImage::from_fn(640, 480, |x, y| {
            let from = |(column, row): (f64, f64)| (f64::from(x) - column).hypot(f64::from(y) - row);
            let soil = y > 330;
            Luma([match (from(center), decoy.map(from)) {
                (_, Some(radius)) if radius < 70.0 => 255 * u8::from(radius > 50.0),
                _ if soil => 120,
                (radius, _) if radius < 120.0 => 80 - 50 * u8::from(decoy.is_none()),
                (radius, _) if radius < 150.0 => 92 + 88 * u8::from(decoy.is_none()),
                _ => 80,
            }])
        })
    }

    fn is_near(wheel: &Wheel, center: (f64, f64)) -> bool {
        let off = (wheel.center.0 - center.0).hypot(wheel.center.1 - center.1);
        off < 1.5 && (wheel.rim_px - 120.0).abs() < 1.5 && (wheel.outer_px - 150.0).abs() < 1.5
    }

    #[test]
    fn a_drawn_wheel_is_found_to_a_pixel() {
        let wheel = find(&drawn((310.0, 205.0), None), None).unwrap();
        assert!(is_near(&wheel, (310.0, 205.0)), "{wheel:?}");
    }

    #[test]
    fn a_picture_that_disagrees_is_searched_for_the_wheel_of_the_others() {
        let folder = tempfile::tempdir().unwrap();
        let centers = [(310.0, 205.0), (318.0, 200.0), (330.0, 210.0)];
        let files = ["a.png", "b.png", "c.png"].map(str::to_owned);
        for (file, center) in files.iter().zip(centers) {
            let decoy = (file == "c.png").then_some((90.0, 100.0));
            let picture = drawn(center, decoy);
            let alone = find(&picture, None).unwrap();
            assert_eq!(is_near(&alone, center), decoy.is_none(), "{file}: {alone:?}");
            picture.save(folder.path().join(file)).unwrap();
        }
        let wheels = agree(folder.path(), &files).unwrap();
        for (wheel, center) in wheels.iter().zip(centers) {
            assert!(is_near(wheel.as_ref().unwrap(), center), "{wheel:?} at {center:?}");
        }
    }

    #[test]
    fn a_rendered_wheel_in_perspective_gets_the_homography_that_it_was_rendered_with() {
        let mut frame = messages::Frame::new_box_zeroed().unwrap();
        let mut found = 0;
        for seed in 0..6 {
            simulation::conditions::Clip::new(simulation::conditions::Condition::Bentonite, seed)
                .paint(0.0, &mut frame);
            let picture = GrayImage::from_raw(frame.width, frame.height, frame.image().to_vec()).unwrap();
            // Next to the wheel, as a person would put it.
            let (start, radius_px) = (
                (frame.center_x_px + 1.5, frame.center_y_px - 1.0),
                frame.wheel_radius_px,
            );
            let face = Face::find(&picture, start, 1.01 * frame.rim_radius_px, 1.01 * radius_px);
            let truth = Face {
                homography: frame.homography,
                rim: 0.0,
            };
            let Some(face) = face else {
                continue;
            };
            found += 1;
            // As the user measures it: the direction of the rover's own down in the picture.
            let (above, below) = (truth.pixel(0.0, -0.1), truth.pixel(0.0, 0.1));
            let pitched = Face {
                homography: face.pitched((below.0 - above.0).atan2(below.1 - above.1)),
                ..face
            };
            // Of the rim's lower half, where the sinkage is measured.
            for k in -4..=4 {
                let (sin, cos) = (0.3 * f64::from(k)).sin_cos();
                let (at, expected) = (
                    pitched.pixel(0.95 * sin, 0.95 * cos),
                    truth.pixel(0.95 * sin, 0.95 * cos),
                );
                let off = (at.0 - expected.0).hypot(at.1 - expected.1) / frame.wheel_radius_px;
                assert!(off < 0.016, "{seed}: {off} at {k}");
            }
        }
        assert!(found >= 4, "{found}");
    }

    #[test]
    fn a_wheel_seen_square_on_stays_a_circle() {
        let picture = drawn((310.0, 205.0), None);
        let wheel = find(&picture, None).unwrap();
        assert_eq!(Face::find(&picture, wheel.center, wheel.rim_px, wheel.outer_px), None);
    }

    #[test]
    fn an_empty_picture_has_no_wheel() {
        for (width, height) in [(1, 1), (3, 2), (640, 480)] {
            assert!(find(&GrayImage::new(width, height), None).is_none());
        }
    }
}
