//! Fusion: the process.

fn main() {}
