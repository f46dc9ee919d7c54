//! All integration tests: one binary.
#![allow(clippy::unwrap_used)] // A test that cannot go on ends here, with the reason and the line.

mod architecture;
mod chaos;
mod conformance;
mod hostile;
mod layout;
mod placement;
mod privacy;
mod recording;
mod refusal;
mod replacement;
mod replay;
mod rover;
mod steady;
mod supervision;
mod swap;
