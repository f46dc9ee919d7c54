//! Where the rim is in the picture: the lower half of the annulus between the rim's inner edge and the wheel's outer edge.

use messages::{Frame, Status};
use std::ops::Range;

/// Share of the outer radius by which the annulus is narrowed at either edge, so that a wheel centre that is wrong by a
/// pixel lets neither the spokes nor the background in.
const INSET: f64 = 0.01;
/// Outer radius below which a picture shows too little of the rim [px].
const RADIUS_MIN_PX: f64 = 20.0;
/// Width of the annulus below which a picture shows too little of the rim [px].
const WIDTH_MIN_PX: f64 = 3.0;

/// The annulus of one frame, and the way from its pixels to the wheel-face plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Rim {
    /// Pixels to the wheel-face plane, row by row, scaled such that the third coordinate is positive at the wheel.
    pub plane: [f64; 9],
    /// The wheel-face plane to pixels.
    pub image: [f64; 9],
    /// Inner radius of the annulus, in outer wheel radii.
    pub inner: f64,
    /// Radius of the rim's inner edge itself, in outer wheel radii.
    pub lip: f64,
    /// Outer radius of the annulus, in outer wheel radii.
    pub outer: f64,
    /// Columns of the picture that can show the lower half of the annulus; empty where it lies outside.
    pub columns: Range<usize>,
    /// Rows of the picture that can show the lower half of the annulus; empty where it lies outside.
    pub rows: Range<usize>,
    /// Outer radius.
    pub wheel_px: f64,
    /// Pixels that one side of the lower half would have if all of it were in the picture.
    pub side_px: f64,
}

impl Rim {
    /// Finds the annulus in a picture of `width` by `height` pixels.
    ///
    /// # Errors
    /// `BAD_GEOMETRY` where radii, centre and homography contradict themselves or each other, `NOT_VISIBLE` where the
    /// wheel is too small in the picture.
    pub fn locate(frame: &Frame, width: usize, height: usize) -> Result<Self, Status> {
        let (rim_px, wheel_px) = (frame.rim_radius_px, frame.wheel_radius_px);
        if !(rim_px > 0.0 && rim_px < wheel_px && wheel_px < 1e6) {
            return Err(Status::BAD_GEOMETRY);
        }
        if wheel_px < RADIUS_MIN_PX || wheel_px - rim_px < WIDTH_MIN_PX {
            return Err(Status::NOT_VISIBLE);
        }
        let image = frame.homography;
        let plane = inverse(&image).ok_or(Status::BAD_GEOMETRY)?;
        if !agrees(&image, frame) {
            return Err(Status::BAD_GEOMETRY);
        }
        let (columns, rows) = bounds(&image, width, height).ok_or(Status::BAD_GEOMETRY)?;
        let (inner, outer) = (rim_px / wheel_px + INSET, 1.0 - INSET);
        if inner >= outer {
            return Err(Status::NOT_VISIBLE);
        }
        let side_px = std::f64::consts::FRAC_PI_4 * (outer * outer - inner * inner) * wheel_px * wheel_px;
        Ok(Self {
            plane,
            image,
            inner,
            lip: rim_px / wheel_px,
            outer,
            columns,
            rows,
            wheel_px,
            side_px,
        })
    }
}

/// The pixel of a point of the plane, `None` where it lies at or behind the camera.
#[must_use]
pub fn project(image: &[f64; 9], x: f64, z: f64) -> Option<(f64, f64)> {
    let h = image;
    let w = h[6] * x + h[7] * z + h[8];
    let pixel = ((h[0] * x + h[1] * z + h[2]) / w, (h[3] * x + h[4] * z + h[5]) / w);
    // The sign of the whole matrix has no meaning; one that changes over the wheel has.
    (w * h[8] > 0.0 && pixel.0.is_finite() && pixel.1.is_finite()).then_some(pixel)
}

/// Whether the homography puts the wheel about where centre, radius and pitch put it.
fn agrees(image: &[f64; 9], frame: &Frame) -> bool {
    let (sin, cos) = frame.pitch_rad.sin_cos();
    [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0)].iter().all(|&(x, z)| {
        let expected = (
            frame.center_x_px + frame.wheel_radius_px * (x * cos + z * sin),
            frame.center_y_px + frame.wheel_radius_px * (z * cos - x * sin),
        );
        project(image, x, z)
            .is_some_and(|(column, row)| (column - expected.0).hypot(row - expected.1) <= 0.25 * frame.wheel_radius_px)
    })
}

/// The pixels around the lower half of the wheel: a projective map keeps it within the hull of its mapped corners.
fn bounds(image: &[f64; 9], width: usize, height: usize) -> Option<(Range<usize>, Range<usize>)> {
    let (mut least, mut most) = ((f64::MAX, f64::MAX), (f64::MIN, f64::MIN));
    for (x, z) in [(-1.0, 0.0), (1.0, 0.0), (-1.0, 1.0), (1.0, 1.0)] {
        let (column, row) = project(image, x, z)?;
        least = (least.0.min(column), least.1.min(row));
        most = (most.0.max(column), most.1.max(row));
    }
    // `as` saturates: what lies left of or above the picture becomes its first pixel.
    let range =
        |from: f64, to: f64, end: usize| (from.ceil() as usize).min(end)..((to + 1.0).floor() as usize).min(end);
    Some((range(least.0, most.0, width), range(least.1, most.1, height)))
}

/// The inverse by cofactors, up to a positive factor; `None` where the matrix is (nearly) singular or not finite.
fn inverse(image: &[f64; 9]) -> Option<[f64; 9]> {
    let [a, b, c, d, e, f, g, h, i] = *image;
    let cofactors = [
        e * i - f * h,
        c * h - b * i,
        b * f - c * e,
        f * g - d * i,
        a * i - c * g,
        c * d - a * f,
        d * h - e * g,
        b * g - a * h,
        a * e - b * d,
    ];
    let determinant = a * cofactors[0] + b * cofactors[3] + c * cofactors[6];
    // The adjugate's third coordinate at the image of (0, 0) is determinant / i.
    let scale = i / determinant;
    let plane = cofactors.map(|cofactor| cofactor * scale);
    (determinant.is_normal() && plane.iter().all(|value| value.is_finite())).then_some(plane)
}
