//! The vibration service.
fn main() {}
