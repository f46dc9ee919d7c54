//! What the benches share: the report, the machine, a system of their own, and the rover's day as input.

mod day;
mod machine;
mod report;
mod scratch;

pub use day::Day;
pub use machine::Machine;
pub use report::{Options, Report, Series};
pub use scratch::ScratchSystem;

/// What a bench ends with where it cannot go on.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error>>;
