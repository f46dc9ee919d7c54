//! A wheel and level soil of one gray value each, without noise: what a user draws to try the method, and deeper than rendered
//! wheels are.

use crate::learn::Random;
use messages::Frame;

/// Draws one, and gives its left and right angle.
pub fn draw(seed: u64, frame: &mut Frame) -> [f64; 2] {
    let mut random = Random(seed);
    let mut range = |from: f64, to: f64| from + (to - from) * f64::midpoint(f64::from(random.symmetric()), 1.0);
    let angles = [range(0.2, 1.3), range(0.2, 1.3)];
    let (soil, rim, spokes, sky) = (
        range(60.0, 120.0),
        range(140.0, 220.0),
        range(5.0, 50.0),
        range(60.0, 250.0),
    );
    let (soil, rim) = if range(0.0, 1.0) < 0.5 {
        (soil, rim)
    } else {
        (rim, soil)
    };
    let (radius_px, pitch_rad) = (range(120.0, 180.0), range(-0.2, 0.2));
    (frame.width, frame.height) = (640, 480);
    (frame.center_x_px, frame.center_y_px) = (range(310.0, 330.0), range(190.0, 210.0));
    (frame.wheel_radius_px, frame.pitch_rad) = (radius_px, pitch_rad);
    frame.rim_radius_px = range(0.75, 0.88) * radius_px;
    frame.homography = Frame::circle_homography(frame.center_x_px, frame.center_y_px, radius_px, pitch_rad);
    let (sin, cos) = pitch_rad.sin_cos();
    let inner = frame.rim_radius_px / radius_px;
    for (k, pixel) in frame.pixels[..640 * 480].iter_mut().enumerate() {
        let right = ((k % 640) as f64 - frame.center_x_px) / radius_px;
        let down = ((k / 640) as f64 - frame.center_y_px) / radius_px;
        let (x, z) = (right * cos - down * sin, right * sin + down * cos);
        let gray = if z > angles[usize::from(x >= 0.0)].cos() {
            soil
        } else if x.hypot(z) > 1.0 {
            sky
        } else if x.hypot(z) > inner {
            rim
        } else {
            spokes
        };
        *pixel = gray as u8;
    }
    angles
}
