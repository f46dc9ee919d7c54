//! All integration tests: one binary.

mod architecture;
mod hostile;
mod layout;
mod recording;
mod refusal;
mod replacement;
mod replay;
mod rover;
mod supervision;
