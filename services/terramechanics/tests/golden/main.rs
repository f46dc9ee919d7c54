//! Golden data, oracles and faults: the estimator seen from outside.
#![allow(clippy::unwrap_used)] // A golden file that is not as it should be ends the test here.

mod accuracy;
mod checkpoint;
mod faults;
mod forward;
mod oracle;
mod real;
