//! Pictures with what was found drawn in: the annulus, the rows, the interface and its angles, to be checked by eye.

use image::{Rgb, RgbImage};
use messages::Frame;
use shell::Error;
use std::fs::File;
use std::path::{Path, PathBuf};
use traverse::{FrameRow, FrameRows, Table};

const ANNULUS: Rgb<u8> = Rgb([60, 200, 255]);
const ROWS: Rgb<u8> = Rgb([90, 110, 130]);
const INTERFACE: Rgb<u8> = Rgb([255, 60, 40]);
const UNCERTAIN: Rgb<u8> = Rgb([255, 180, 0]);
/// Rows that are drawn from the wheel's centre down to its lowest point.
const ROWS_DRAWN: usize = 16;
/// Widths of a line in the wheel's radius.
const LINES: f64 = 120.0;
/// Straight pieces of which a whole circle is drawn.
const PIECES: usize = 360;

/// Writes `out/overlay/…png` for each picture of a traverse that can be read, with what `out/sinkage.csv` says of it. Gives
/// their number.
pub fn write(traverse: &Path, out: &Path) -> Result<usize, Error> {
    let folder = out.join("overlay");
    std::fs::create_dir_all(&folder).map_err(|error| Error::data(format!("{}: {error}", folder.display())))?;
    let mut found = Found::open(&out.join("sinkage.csv"))?;
    let rows = FrameRows::open("frames.csv", open(&traverse.join("frames.csv"))?).map_err(data)?;
    let mut written = 0;
    for row in rows {
        let row = row.map_err(data)?;
        let path = traverse.join(&row.file);
        // The camera has said what is wrong with the others.
        let Ok(picture) = image::open(&path) else {
            continue;
        };
        let mut picture = picture.into_rgb8();
        draw(&mut picture, &row, found.of(row.sequence)?);
        let path = folder.join(drawn(&row.file));
        picture
            .save(&path)
            .map_err(|error| Error::data(format!("{}: {error}", path.display())))?;
        written += 1;
    }
    Ok(written)
}

/// The name of what is drawn over a picture: its own, which ends with `.png`.
fn drawn(file: &str) -> PathBuf {
    let name = Path::new(Path::new(file).file_name().unwrap_or_default());
    if name.extension().is_some_and(|kind| kind.eq_ignore_ascii_case("png")) {
        name.into()
    } else {
        name.with_added_extension("png")
    }
}

fn open(path: &Path) -> Result<traverse::Input, Error> {
    let file = File::open(path).map_err(|error| Error::data(format!("{}: {error}", path.display())))?;
    Ok(Box::new(file))
}

#[allow(clippy::needless_pass_by_value)]
fn data(error: traverse::InputError) -> Error {
    Error::data(error.to_string())
}

/// The interface of one picture.
#[derive(Clone, Copy, Debug)]
pub struct Interface {
    /// Left angle and its sigma.
    left: (f64, f64),
    /// Right angle and its sigma.
    right: (f64, f64),
    sure: bool,
}

/// The recorded sinkage, row by row.
struct Found {
    table: Table,
    next: Option<(u64, Interface)>,
}

impl Found {
    const COLUMNS: [&str; 6] = [
        "sequence",
        "status",
        "left_rad",
        "left_sigma_rad",
        "right_rad",
        "right_sigma_rad",
    ];

    fn open(path: &Path) -> Result<Self, Error> {
        let mut table = Table::open("sinkage.csv", open(path)?).map_err(data)?;
        let others: Vec<String> = table.names().to_vec();
        let others: Vec<&str> = others
            .iter()
            .map(String::as_str)
            .filter(|name| !Self::COLUMNS.contains(name))
            .collect();
        table.bind(&Self::COLUMNS, &others).map_err(data)?;
        Ok(Self { table, next: None })
    }

    /// What was found in a picture; pictures come in order.
    fn of(&mut self, sequence: u64) -> Result<Option<Interface>, Error> {
        while self.next.is_none_or(|(known, _)| known < sequence) {
            if !self.table.next_row().map_err(data)? {
                return Ok(None);
            }
            let number = |column| self.table.number(column, f64::MIN..=f64::MAX).map_err(data);
            let interface = Interface {
                left: (number(2)?, number(3)?),
                right: (number(4)?, number(5)?),
                sure: self.table.text(1) == "ok",
            };
            self.next = Some((number(0)? as u64, interface));
        }
        Ok(self
            .next
            .filter(|(known, _)| *known == sequence)
            .map(|(_, interface)| interface))
    }
}

/// Draws the annulus, and the interface where there is one.
pub fn draw(picture: &mut RgbImage, row: &FrameRow, found: Option<Interface>) {
    let homography = row.homography.unwrap_or_else(|| {
        Frame::circle_homography(row.center_x_px, row.center_y_px, row.wheel_radius_px, row.pitch_rad)
    });
    // `as` turns what is no number into 0.
    let width = ((row.wheel_radius_px / LINES) as u32).clamp(1, 32);
    let mut pen = Pen {
        picture,
        homography,
        width,
    };
    let inner = row.rim_radius_px / row.wheel_radius_px;
    for k in 1..ROWS_DRAWN {
        let z = k as f64 / ROWS_DRAWN as f64;
        let within = |radius: f64| (radius * radius - z * z).max(0.0).sqrt();
        for side in [-1.0, 1.0] {
            pen.line((side * within(inner), z), (side * within(1.0), z), ROWS);
        }
    }
    for radius in [inner, 1.0] {
        pen.arc(radius, 0.0, std::f64::consts::TAU, ANNULUS);
    }
    pen.line((0.0, 0.0), (0.0, 1.0), ANNULUS);
    let Some(found) = found else {
        return;
    };
    let color = if found.sure { INTERFACE } else { UNCERTAIN };
    let at = |angle: f64| (angle.sin(), angle.cos());
    if found.left.0.is_finite() && found.right.0.is_finite() {
        pen.line(at(-found.left.0), at(found.right.0), color);
    }
    for (sign, (angle, sigma)) in [(-1.0, found.left), (1.0, found.right)] {
        if angle.is_finite() {
            pen.line((0.0, 0.0), at(sign * angle), color);
            pen.arc(0.3, 0.0, sign * angle, color);
            // Two sigma, along the outer edge.
            pen.arc(1.03, sign * (angle - 2.0 * sigma), sign * (angle + 2.0 * sigma), color);
        }
    }
}

/// Draws in coordinates of the wheel's face.
struct Pen<'a> {
    picture: &'a mut RgbImage,
    homography: [f64; 9],
    /// Of a line [px].
    width: u32,
}

impl Pen<'_> {
    /// An arc about the wheel's centre, angles from straight down.
    fn arc(&mut self, radius: f64, from: f64, to: f64, color: Rgb<u8>) {
        let pieces = ((to - from).abs() / std::f64::consts::TAU * PIECES as f64)
            .ceil()
            .clamp(1.0, PIECES as f64);
        let at = |k: f64| {
            let angle = from + (to - from) * k / pieces;
            (radius * angle.sin(), radius * angle.cos())
        };
        for k in 0..pieces as usize {
            self.line(at(k as f64), at(k as f64 + 1.0), color);
        }
    }

    fn line(&mut self, from: (f64, f64), to: (f64, f64), color: Rgb<u8>) {
        let (Some(from), Some(to)) = (self.pixel(from), self.pixel(to)) else {
            return;
        };
        let steps = (to.0 - from.0).abs().max((to.1 - from.1).abs()).ceil().clamp(1.0, 1e4);
        for k in 0..=steps as usize {
            let share = k as f64 / steps;
            self.dot(
                from.0 + share * (to.0 - from.0),
                from.1 + share * (to.1 - from.1),
                color,
            );
        }
    }

    /// A square as wide as a line.
    fn dot(&mut self, column: f64, row: f64, color: Rgb<u8>) {
        let half = f64::from((self.width - 1) / 2);
        for k in 0..self.width * self.width {
            let column = column.round() - half + f64::from(k % self.width);
            let row = row.round() - half + f64::from(k / self.width);
            if column >= 0.0
                && row >= 0.0
                && let Some(pixel) = self.picture.get_pixel_mut_checked(column as u32, row as u32)
            {
                *pixel = color;
            }
        }
    }

    fn pixel(&self, (x, z): (f64, f64)) -> Option<(f64, f64)> {
        let h = &self.homography;
        let w = h[6] * x + h[7] * z + h[8];
        let pixel = ((h[0] * x + h[1] * z + h[2]) / w, (h[3] * x + h[4] * z + h[5]) / w);
        (pixel.0.is_finite() && pixel.1.is_finite()).then_some(pixel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_drawn_over_a_picture_is_a_png_of_its_name() {
        assert_eq!(drawn("left/000.png"), PathBuf::from("000.png"));
        assert_eq!(drawn("left/000.PNG"), PathBuf::from("000.PNG"));
        assert_eq!(drawn("000.jpg"), PathBuf::from("000.jpg.png"));
    }

    #[test]
    fn the_outer_edge_and_the_interface_are_drawn_where_they_are() {
        let row = FrameRow {
            line: 2,
            sequence: 0,
            file: "000.png".to_owned(),
            taken_ns: 0,
            center_x_px: 100.0,
            center_y_px: 80.0,
            rim_radius_px: 40.0,
            wheel_radius_px: 50.0,
            pitch_rad: 0.0,
            homography: None,
        };
        let found = Interface {
            left: (0.5, 0.01),
            right: (0.5, 0.01),
            sure: true,
        };
        let mut picture = RgbImage::new(200, 160);
        draw(&mut picture, &row, Some(found));
        assert_eq!(*picture.get_pixel(150, 80), ANNULUS);
        assert_eq!(*picture.get_pixel(100, 40), ANNULUS);
        let contact_row = (80.0 + 50.0 * 0.5_f64.cos()).round() as u32;
        assert_eq!(*picture.get_pixel(110, contact_row), INTERFACE);
        assert_eq!(*picture.get_pixel(5, 5), Rgb([0, 0, 0]));
    }
}
