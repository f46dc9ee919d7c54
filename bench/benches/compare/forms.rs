//! How the samples look to serde: the derive has to be told their fields again, for the messages themselves need none.

use messages::{Frame, Header, Label, Sinkage, Soil, Status, Terrain, Wheel};
use serde::{Deserialize, Serialize, Serializer};

/// A picture on its way through a socket. It lies where it was read.
#[derive(Serialize, Deserialize)]
pub struct Picture<'a> {
    #[serde(with = "HeaderForm")]
    header: Header,
    width: u32,
    height: u32,
    crop_px: [u32; 2],
    center_px: [f64; 2],
    radii_px: [f64; 2],
    pitch_rad: f64,
    homography: [f64; 9],
    #[serde(borrow, serialize_with = "as_bytes")]
    pixels: &'a [u8],
}

impl<'a> Picture<'a> {
    pub fn of(frame: &'a Frame) -> Self {
        Self {
            header: frame.header,
            width: frame.width,
            height: frame.height,
            crop_px: [frame.crop_x_px, frame.crop_y_px],
            center_px: [frame.center_x_px, frame.center_y_px],
            radii_px: [frame.rim_radius_px, frame.wheel_radius_px],
            pitch_rad: frame.pitch_rad,
            homography: frame.homography,
            pixels: frame.image(),
        }
    }

    /// Copies the picture to where the stage can look at it.
    pub fn unpack(&self, frame: &mut Frame) {
        frame.header = self.header;
        (frame.width, frame.height) = (self.width, self.height);
        [frame.crop_x_px, frame.crop_y_px] = self.crop_px;
        [frame.center_x_px, frame.center_y_px] = self.center_px;
        [frame.rim_radius_px, frame.wheel_radius_px] = self.radii_px;
        frame.pitch_rad = self.pitch_rad;
        frame.homography = self.homography;
        frame.pixels[..self.pixels.len()].copy_from_slice(self.pixels);
    }
}

/// As a whole: serde would write them one by one.
fn as_bytes<S: Serializer>(pixels: &&[u8], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(pixels)
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Status")]
struct StatusForm(u32);

#[derive(Serialize, Deserialize)]
#[serde(remote = "Header")]
struct HeaderForm {
    taken_ns: u64,
    published_ns: u64,
    sequence: u64,
    generation: u32,
    #[serde(with = "StatusForm")]
    status: Status,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Wheel")]
pub struct WheelForm {
    #[serde(with = "HeaderForm")]
    header: Header,
    load_n: f64,
    torque_nm: f64,
    angular_velocity_rad_s: f64,
    linear_velocity_m_s: f64,
    slip: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Sinkage")]
pub struct SinkageForm {
    #[serde(with = "HeaderForm")]
    header: Header,
    left_rad: f64,
    left_sigma_rad: f64,
    right_rad: f64,
    right_sigma_rad: f64,
    entry_rad: f64,
    entry_sigma_rad: f64,
    exit_rad: f64,
    exit_sigma_rad: f64,
    sinkage_m: f64,
    sinkage_sigma_m: f64,
    confidence: f64,
    center_x_px: f64,
    center_y_px: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Soil")]
pub struct SoilForm {
    #[serde(with = "HeaderForm")]
    header: Header,
    cohesion_pa: f64,
    cohesion_sigma_pa: f64,
    friction_rad: f64,
    friction_sigma_rad: f64,
    cohesion_friction_covariance_pa_rad: f64,
    strength_pa: f64,
    strength_sigma_pa: f64,
    pressure_pa: f64,
    shear_modulus_m: f64,
    shear_modulus_sigma_m: f64,
    sinkage_exponent: f64,
    sinkage_exponent_sigma: f64,
    slip: f64,
    normalized_innovation: f64,
    rows: u32,
    resets: u32,
    rows_rejected: u32,
    reason: u32,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Terrain")]
pub struct TerrainForm {
    #[serde(with = "HeaderForm")]
    header: Header,
    sinkage_m: f64,
    sinkage_sigma_m: f64,
    entry_rad: f64,
    entry_sigma_rad: f64,
    cohesion_pa: f64,
    cohesion_sigma_pa: f64,
    friction_rad: f64,
    friction_sigma_rad: f64,
    cohesion_friction_covariance_pa_rad: f64,
    strength_pa: f64,
    strength_sigma_pa: f64,
    pressure_pa: f64,
    slip: f64,
    class_probability: f64,
    class_metric: f64,
    sinkage_age_ns: u64,
    soil_age_ns: u64,
    class_age_ns: u64,
    #[serde(with = "StatusForm")]
    sinkage_status: Status,
    #[serde(with = "StatusForm")]
    soil_status: Status,
    #[serde(with = "StatusForm")]
    class_status: Status,
    valid: u32,
    class: u32,
    unknown: u32,
    class_label: Label,
}
