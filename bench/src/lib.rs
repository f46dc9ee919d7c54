//! What the benches share: the report, the machine, a system of their own, and the rover's day as input.

pub mod chaos;
pub mod compare;
mod day;
mod growth;
mod machine;
mod processes;
mod report;
mod scratch;

pub use day::Day;
pub use growth::exponent;
pub use machine::Machine;
pub use processes::{Processes, cpu_ns};
pub use report::{Options, Report, Series};
pub use scratch::ScratchSystem;

/// What a bench ends with where it cannot go on.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// The folder of the programs that cargo has built in the same profile as this one.
///
/// # Errors
/// They are not there.
pub fn programs() -> Outcome<std::path::PathBuf> {
    let here = std::env::current_exe()?;
    let folder = here
        .ancestors()
        .nth(2)
        .ok_or("this program stands in no target folder")?;
    if folder.join("terrasense").is_file() {
        return Ok(folder.into());
    }
    Err(format!(
        "{} has no terrasense; build the services first: cargo build --release",
        folder.display()
    )
    .into())
}
