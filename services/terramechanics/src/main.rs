//! The terramechanics process: sinkage triggers, the wheel is taken in, soil goes out.

use messages::{Sinkage, Soil, Wheel};
use std::process::ExitCode;
use terramechanics::{Config, SoilEstimator};

fn main() -> ExitCode {
    shell::main(|shell| {
        let mut estimator = SoilEstimator::new(shell.config(Config::validate)?);
        let mut sinkage = shell.input::<Sinkage>("sinkage")?;
        let wheel = shell.observation::<Wheel>("wheel")?;
        let soil = shell.output::<Soil>("soil")?;
        shell.on_each(&mut estimator, &mut sinkage, &soil, |estimator, sample| {
            wheel.until(sample.header.taken_ns, |reading| estimator.observe_wheel(reading))?;
            Ok(estimator.step(sample))
        })
    })
}
