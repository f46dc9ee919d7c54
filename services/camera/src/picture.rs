//! A picture file, as bytes, into a frame: decoded, gray, and cropped to the wheel's surroundings where it is large, or
//! scaled down where the wheel itself is.

use crate::decode::{SIDE_PX_MAX, decode};
use messages::{Frame, Header, PIXELS_MAX, Status};
use traverse::FrameRow;

/// What a crop holds, in wheel radii: aside and below the centre, and above it. The first that fits into a frame is
/// taken: all of the wheel with its surroundings, then its lower half with them, then its lower half alone.
const CROPS: [(f64, f64); 3] = [(1.25, 1.25), (1.25, 0.25), (1.05, 0.05)];

/// Decodes pictures; keeps its memory from one to the next.
#[derive(Debug, Default)]
pub struct PictureReader {
    decoded: Vec<u8>,
}

impl PictureReader {
    /// Fills the frame, except for what the shell writes into its header, from a row of `frames.csv` and the bytes of
    /// the PNG or JPEG file that it names. 16-bit values lose their lower byte, colours become their luminance (Rec. 709), and
    /// transparency has no meaning.
    ///
    /// A picture of more than [`PIXELS_MAX`] pixels is cropped: to the wheel and a quarter of its radius around it, or, where
    /// that is too large, to its lower half. Where that is still too large, squares of pixels become one. The pose is that in
    /// the resulting picture.
    ///
    /// # Errors
    /// Says what is wrong with the file, and the way out. The frame is then not to be used.
    pub fn fill(&mut self, row: &FrameRow, file: &[u8], frame: &mut Frame) -> Result<(), String> {
        let (width, height, channels) = decode(file, &mut self.decoded)?;
        let crop = Crop::around_wheel(row, width, height);
        let stride = width as usize * channels;
        let left = crop.x_px as usize * channels;
        let scale = crop.scale as usize;
        let bands = self.decoded[crop.y_px as usize * stride..].chunks_exact(stride * scale);
        let targets = frame.pixels.chunks_exact_mut(crop.width as usize);
        for (target, band) in targets.take(crop.height as usize).zip(bands) {
            let source = left..left + target.len() * scale * channels;
            if scale == 1 {
                gray(&band[source], channels, target);
            } else {
                let lines = band.chunks_exact(stride).map(|line| &line[source.clone()]);
                gray_means(&lines, channels, scale, target);
            }
        }
        frame.header = Header {
            taken_ns: row.taken_ns,
            sequence: row.sequence,
            status: Status::OK,
            ..Header::default()
        };
        place(row, &crop, frame);
        Ok(())
    }
}

/// The part of a picture that a frame takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Crop {
    x_px: u32,
    y_px: u32,
    /// Pixels of the picture, aside and down, that become one.
    scale: u32,
    /// Size after that.
    width: u32,
    height: u32,
}

impl Crop {
    fn around_wheel(row: &FrameRow, width: u32, height: u32) -> Self {
        let whole = Self {
            x_px: 0,
            y_px: 0,
            scale: 1,
            width,
            height,
        };
        let radius = row.wheel_radius_px;
        let crops = CROPS.map(|(around, above)| {
            let (x_px, x_end) = interval(row.center_x_px, around * radius, around * radius, width);
            let (y_px, y_end) = interval(row.center_y_px, above * radius, around * radius, height);
            Self {
                x_px,
                y_px,
                scale: 1,
                width: x_end - x_px,
                height: y_end - y_px,
            }
        });
        // At the largest of scales each side of a picture is smaller than that of a frame.
        let last = crops[CROPS.len() - 1];
        let scaled = (2..=SIDE_PX_MAX).map(|scale| Self {
            scale,
            width: (last.width / scale).max(1),
            height: (last.height / scale).max(1),
            ..last
        });
        let mut choices = std::iter::once(whole).chain(crops).chain(scaled);
        let fits = |crop: &Self| crop.width as usize * crop.height as usize <= PIXELS_MAX;
        choices.find(fits).unwrap_or(Self {
            width: 1,
            height: 1,
            ..whole
        })
    }
}

/// The pixels from `center - before` to `center + after` that a row or column of `length` pixels has: first, and end. At
/// least the one at the picture's edge, where the wheel is beyond it.
fn interval(center: f64, before: f64, after: f64, length: u32) -> (u32, u32) {
    let clamp = |value: f64| value.clamp(0.0, f64::from(length)) as u32;
    let first = clamp((center - before).floor()).min(length.saturating_sub(1));
    (first, clamp((center + after).ceil() + 1.0).max(first + 1))
}

/// Gray values of 8-bit pixels of 1 (gray), 2 (with transparency), 3 (RGB) or 4 channels.
fn gray(source: &[u8], channels: usize, target: &mut [u8]) {
    for (target, pixel) in target.iter_mut().zip(source.chunks_exact(channels)) {
        *target = luminance(pixel);
    }
}

fn luminance(pixel: &[u8]) -> u8 {
    match *pixel {
        [red, green, blue, ..] => {
            // Rec. 709
            let luminance = 2126 * u32::from(red) + 7152 * u32::from(green) + 722 * u32::from(blue);
            ((luminance + 5000) / 10_000) as u8
        }
        [gray, ..] => gray,
        [] => 0,
    }
}

/// Mean gray values of squares of `scale` by `scale` pixels, from so many lines.
fn gray_means<'a>(lines: &(impl Iterator<Item = &'a [u8]> + Clone), channels: usize, scale: usize, target: &mut [u8]) {
    let count = (scale * scale) as u64;
    for (column, target) in target.iter_mut().enumerate() {
        let square = column * scale * channels..(column + 1) * scale * channels;
        let pixels = lines
            .clone()
            .flat_map(|line| line[square.clone()].chunks_exact(channels));
        let sum: u64 = pixels.map(|pixel| u64::from(luminance(pixel))).sum();
        *target = ((sum + count / 2) / count) as u8;
    }
}

/// Writes the size and the wheel's pose, moved into the cropped and scaled picture.
fn place(row: &FrameRow, crop: &Crop, frame: &mut Frame) {
    let scale = f64::from(crop.scale);
    // A pixel's coordinates are those of its middle: that of the first square of pixels becomes 0.
    let middle = 0.5 * (scale - 1.0);
    let (x_px, y_px) = (f64::from(crop.x_px) + middle, f64::from(crop.y_px) + middle);
    (frame.width, frame.height) = (crop.width, crop.height);
    (frame.crop_x_px, frame.crop_y_px) = (crop.x_px, crop.y_px);
    frame.center_x_px = (row.center_x_px - x_px) / scale;
    frame.center_y_px = (row.center_y_px - y_px) / scale;
    frame.rim_radius_px = row.rim_radius_px / scale;
    frame.wheel_radius_px = row.wheel_radius_px / scale;
    frame.pitch_rad = row.pitch_rad;
    let (x_px, y_px) = (x_px / scale, y_px / scale);
    frame.homography = match row.homography {
        // The shift by (-x, -y) after the given homography and the scale.
        Some([a, b, c, d, e, f, g, h, i]) => [
            a / scale - x_px * g,
            b / scale - x_px * h,
            c / scale - x_px * i,
            d / scale - y_px * g,
            e / scale - y_px * h,
            f / scale - y_px * i,
            g,
            h,
            i,
        ],
        None => Frame::circle_homography(
            frame.center_x_px,
            frame.center_y_px,
            frame.wheel_radius_px,
            row.pitch_rad,
        ),
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use zerocopy::FromZeros;

    fn row(center_x_px: f64, center_y_px: f64, wheel_radius_px: f64) -> FrameRow {
        FrameRow {
            line: 2,
            sequence: 0,
            file: "a.png".into(),
            taken_ns: 0,
            center_x_px,
            center_y_px,
            rim_radius_px: 0.8 * wheel_radius_px,
            wheel_radius_px,
            pitch_rad: 0.1,
            homography: None,
        }
    }

    #[test]
    fn a_crop_holds_the_wheel_its_surroundings_and_never_too_many_pixels() {
        let crop = Crop::around_wheel(&row(2000.0, 1500.0, 400.0), 4000, 3000);
        assert_eq!((crop.x_px, crop.y_px), (1500, 1000));
        assert_eq!((crop.width, crop.height), (1001, 1001));
        let half = Crop::around_wheel(&row(2000.0, 1500.0, 500.0), 4000, 3000);
        assert_eq!((half.x_px, half.y_px, half.width, half.height), (1375, 1375, 1251, 751));
        let bare = Crop::around_wheel(&row(2000.0, 1500.0, 670.0), 4000, 3000);
        assert_eq!((bare.x_px, bare.width), (1296, 1409));
        assert!(bare.width as usize * bare.height as usize <= PIXELS_MAX);
        let scaled = Crop::around_wheel(&row(2736.0, 1824.0, 1500.0), 5472, 3648);
        assert_eq!((scaled.x_px, scaled.y_px, scaled.scale), (1161, 1749, 3));
        assert_eq!((scaled.width, scaled.height), (1050, 550));
    }

    #[test]
    fn a_crop_ends_at_the_pictures_edges() {
        let crop = Crop::around_wheel(&row(10.0, 2990.0, 300.0), 4000, 3000);
        assert_eq!((crop.x_px, crop.width), (0, 386));
        assert_eq!(crop.y_px + crop.height, 3000);
        for center in [(-900.0, 1500.0), (9000.0, 1500.0), (2000.0, -1e5), (1e5, 1e5)] {
            let crop = Crop::around_wheel(&row(center.0, center.1, 300.0), 4000, 3000);
            assert!(crop.width >= 1 && crop.height >= 1, "{crop:?}");
            assert!(
                crop.x_px + crop.width <= 4000 && crop.y_px + crop.height <= 3000,
                "{crop:?}"
            );
        }
    }

    #[test]
    fn a_picture_that_is_scaled_down_shows_the_same_wheel() {
        let (mut row, mut frame) = (row(100.5, 60.0, 40.0), Frame::new_box_zeroed().unwrap());
        row.homography = Some([40.0, 3.0, 100.5, -3.0, 41.0, 60.0, 0.001, -0.01, 1.0]);
        let crop = Crop {
            x_px: 20,
            y_px: 30,
            scale: 4,
            width: 30,
            height: 20,
        };
        place(&row, &crop, &mut frame);
        // Its first pixel is the middle of the columns 20 to 23 and the rows 30 to 33.
        let scaled = |column: f64, row: f64| ((column - 21.5) / 4.0, (row - 31.5) / 4.0);
        assert_eq!((frame.center_x_px, frame.center_y_px), scaled(100.5, 60.0));
        assert_eq!((frame.rim_radius_px, frame.wheel_radius_px), (8.0, 10.0));
        let project = |h: &[f64; 9], x: f64, z: f64| {
            let w = h[6] * x + h[7] * z + h[8];
            ((h[0] * x + h[1] * z + h[2]) / w, (h[3] * x + h[4] * z + h[5]) / w)
        };
        for (x, z) in [(0.0, 0.0), (0.6, 0.8), (-1.0, 0.0), (0.1, 1.0)] {
            let before = project(&row.homography.unwrap(), x, z);
            let (expected, found) = (scaled(before.0, before.1), project(&frame.homography, x, z));
            assert!((expected.0 - found.0).hypot(expected.1 - found.1) < 1e-9, "{x} {z}");
        }
        let lines = [[10, 20, 30, 40, 0, 0], [11, 21, 31, 41, 0, 1]];
        let mut means = [0; 3];
        gray_means(&lines.iter().map(|line| &line[..]), 1, 2, &mut means);
        assert_eq!(means, [16, 36, 0]);
    }

    #[test]
    fn gray_is_the_luminance() {
        let mut target = [0; 4];
        gray(&[255, 255, 255, 255, 0, 0, 0, 255, 0, 0, 0, 255], 3, &mut target);
        assert_eq!(target, [255, 54, 182, 18]);
        gray(&[7, 0, 9, 1], 2, &mut target[..2]);
        assert_eq!(target[..2], [7, 9]);
    }
}
