//! The terramechanics process: sinkage triggers, the wheel is observed, the soil comes out.

fn main() {}
