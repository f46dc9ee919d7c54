//! Fusion: everything known of the ground after one estimation cycle, in one sample.
