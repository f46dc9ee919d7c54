//! Terramechanics: cohesion and friction angle of the soil from what the wheel feels.
//!
//! The method is §3 of Iagnemma, Brooks, Dubowsky, "Visual, Tactile, and Vibration-Based Terrain Analysis for Planetary
//! Rovers" (IEEE Aerospace 2004), with its Eq. (14) corrected in sign and completed by the term that the paper drops.

mod config;
mod estimator;
mod least_squares;
mod linear;
mod row;

pub use config::Config;
pub use estimator::SoilEstimator;
pub use least_squares::BilinearLeastSquares;
pub use linear::LinearForm;
pub use row::{Row, Wheels};
