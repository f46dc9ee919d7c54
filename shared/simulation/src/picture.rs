//! Stand-in.
pub(crate) struct Painter;
pub(crate) struct Scene {
    pub frame_index: u64,
    pub left_rad: f64,
    pub right_rad: f64,
    pub pitch_rad: f64,
    pub wheel_angle_rad: f64,
    pub travelled_m: f64,
    pub radius_m: f64,
    pub soil_brightness: f64,
    pub soil_grain: f64,
}
impl Painter {
    pub(crate) fn new(_: u64, _: u32, _: u32, _: f64) -> Self {
        Self
    }
    pub(crate) fn paint(&self, s: &Scene, _: &mut messages::Frame) {
        let _ = (
            s.frame_index,
            s.left_rad,
            s.right_rad,
            s.pitch_rad,
            s.wheel_angle_rad,
            s.travelled_m,
            s.radius_m,
            s.soil_brightness,
            s.soil_grain,
        );
    }
}
