//! One camera picture of the wheel, and where the wheel is in it.

use crate::ZeroCopySend;
use crate::{Field, Header, Kind, Message, within};
use std::mem::offset_of;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Pixels a frame holds at the most; `camera` crops larger pictures to the wheel's surroundings.
pub const PIXELS_MAX: usize = 1 << 20;

/// One 8-bit gray picture with the wheel's pose in it. Filled in place, never copied.
///
/// Pixel coordinates: integers are pixel centres, x right, y down, of this (cropped) picture.
#[derive(Debug, FromBytes, IntoBytes, Immutable, KnownLayout, ZeroCopySend)]
#[repr(C)]
#[type_name("terrasense/Frame/1")]
pub struct Frame {
    /// What every sample starts with.
    pub header: Header,
    /// Pixels of a row.
    pub width: u32,
    /// Rows. `width * height` is at most [`PIXELS_MAX`].
    pub height: u32,
    /// Column of the camera's picture at which this crop begins.
    pub crop_x_px: u32,
    /// Row of the camera's picture at which this crop begins.
    pub crop_y_px: u32,
    /// Wheel centre, column.
    pub center_x_px: f64,
    /// Wheel centre, row.
    pub center_y_px: f64,
    /// Radius of the bright rim's inner edge.
    pub rim_radius_px: f64,
    /// Radius of the wheel's outer edge, which meets the soil.
    pub wheel_radius_px: f64,
    /// Pitch: `v_down = (sin pitch, cos pitch)` in the picture.
    pub pitch_rad: f64,
    /// Wheel-face plane (X along `v_right`, Z along `v_down`, outer radius 1) to this picture's pixels, row by row.
    /// Made from centre, radius and pitch where no better one is known.
    pub homography: [f64; 9],
    /// Gray values, row by row, without gaps; what lies behind `width * height` has no meaning.
    pub pixels: [u8; PIXELS_MAX],
}

const _: () = assert!(size_of::<Frame>() == 160 + PIXELS_MAX);
const _: () = assert!(crate::covers(Frame::FIELDS, size_of::<Frame>()));

impl Frame {
    /// The pixels that have a meaning: `width * height` of them, none where that is more than the frame holds.
    #[must_use]
    pub fn image(&self) -> &[u8] {
        let count = (self.width as usize).saturating_mul(self.height as usize);
        self.pixels.get(..count).unwrap_or(&[])
    }

    /// The homography of a wheel that is seen as a circle, face on.
    #[must_use]
    pub fn circle_homography(center_x_px: f64, center_y_px: f64, wheel_radius_px: f64, pitch_rad: f64) -> [f64; 9] {
        let (sin, cos) = pitch_rad.sin_cos();
        let (right, down) = ((cos, -sin), (sin, cos));
        [
            wheel_radius_px * right.0,
            wheel_radius_px * down.0,
            center_x_px,
            wheel_radius_px * right.1,
            wheel_radius_px * down.1,
            center_y_px,
            0.0,
            0.0,
            1.0,
        ]
    }
}

impl Message for Frame {
    const NAME: &'static str = "Frame/1";
    const FIELDS: &'static [Field] = &[
        Field::new("header", offset_of!(Self, header), Kind::Header),
        Field::new("width", offset_of!(Self, width), Kind::U32),
        Field::new("height", offset_of!(Self, height), Kind::U32),
        Field::new("crop_x_px", offset_of!(Self, crop_x_px), Kind::U32),
        Field::new("crop_y_px", offset_of!(Self, crop_y_px), Kind::U32),
        Field::new("center_x_px", offset_of!(Self, center_x_px), Kind::F64),
        Field::new("center_y_px", offset_of!(Self, center_y_px), Kind::F64),
        Field::new("rim_radius_px", offset_of!(Self, rim_radius_px), Kind::F64),
        Field::new("wheel_radius_px", offset_of!(Self, wheel_radius_px), Kind::F64),
        Field::new("pitch_rad", offset_of!(Self, pitch_rad), Kind::F64),
        Field::array("homography", offset_of!(Self, homography), Kind::F64, 9),
        Field::array("pixels", offset_of!(Self, pixels), Kind::U8, PIXELS_MAX),
    ];

    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn check_values(&self) -> Result<(), &'static str> {
        if !self.header.status.is_answer() {
            return Ok(());
        }
        if self.image().is_empty() {
            return Err("width * height is zero or more than a frame holds");
        }
        let pose = [
            self.center_x_px,
            self.center_y_px,
            self.rim_radius_px,
            self.wheel_radius_px,
        ];
        if !pose.iter().all(|value| within(*value, -1e6, 1e6)) || !within(self.pitch_rad, -7.0, 7.0) {
            return Err("the wheel's pose is not finite or out of range");
        }
        if !self.homography.iter().all(|value| within(*value, -1e9, 1e9)) {
            return Err("the homography is not finite or out of range");
        }
        Ok(())
    }
}
