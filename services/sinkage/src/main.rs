//! The sinkage service: pictures of the wheel in, sinkage out.

use messages::{Frame, Sinkage};
use sinkage::{Config, SinkageTracker};
use std::process::ExitCode;

fn main() -> ExitCode {
    shell::main(|shell| {
        let mut tracker = SinkageTracker::new(shell.config(Config::validate)?);
        let mut frames = shell.input::<Frame>("frames")?;
        let sinkage = shell.output::<Sinkage>("sinkage")?;
        shell.on_each(&mut tracker, &mut frames, &sinkage, |tracker, frame| {
            Ok(tracker.step(frame))
        })
    })
}
