//! Terramechanics: cohesion and friction angle of the soil from what the wheel feels.
//!
//! The method is §3 of Iagnemma, Brooks, Dubowsky, "Visual, Tactile, and Vibration-Based Terrain Analysis for Planetary
//! Rovers" (IEEE Aerospace 2004), with its Eq. (14) corrected in sign and completed by the term that the paper drops.

mod change;
mod checkpoint;
mod config;
mod cost;
mod estimator;
mod full;
mod least_squares;
mod linear;
mod model;
mod observability;
mod operating_point;
mod orthogonal_distance;
mod paper;
mod regression;
mod row;
mod stresses;

pub use checkpoint::Checkpoint;
pub use config::{Config, Estimator, ExitAngle};
pub use estimator::SoilEstimator;
pub use least_squares::BilinearLeastSquares;
pub use linear::LinearForm;
pub use row::{Row, Wheels};
