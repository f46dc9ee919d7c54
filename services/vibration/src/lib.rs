//! Vibration-based terrain classification.
