//! Vibration-based terrain classification: log spectra of the vehicle's vibration, told apart by linear discriminants.
//!
//! The method is §4 of Iagnemma, Brooks and Dubowsky, "Visual, Tactile, and Vibration-Based Terrain Analysis for
//! Planetary Rovers", IEEE Aerospace 2004, and what real recordings asked for beyond it.

pub mod calibrate;
pub mod classifier;
pub mod coupling;
pub mod decision;
pub mod discriminant;
pub mod evaluate;
pub mod features;
pub mod filter;
pub mod model;
pub mod recording;
pub mod score;
pub mod select;
pub mod spectrum;
pub mod train;
pub mod training_set;
pub mod warnings;
pub mod window;

pub use classifier::{Config, VibrationClassifier};
pub use model::Model;
