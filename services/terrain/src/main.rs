//! The fusion process: soil triggers, sinkage and class are taken in, terrain goes out.

use messages::{Sinkage, Soil, Terrain, TerrainClass};
use std::process::ExitCode;
use terrain::{Config, TerrainFusion};

fn main() -> ExitCode {
    shell::main(|shell| {
        let mut fusion = TerrainFusion::new(shell.config(Config::validate)?);
        let mut soil = shell.input::<Soil>("soil")?;
        let sinkage = shell.observation::<Sinkage>("sinkage")?;
        let class = shell.observation::<TerrainClass>("class")?;
        let terrain = shell.output::<Terrain>("terrain")?;
        shell.on_each(&mut fusion, &mut soil, &terrain, |fusion, sample| {
            sinkage.until(sample.header.taken_ns, |seen| fusion.observe_sinkage(seen))?;
            class.until(sample.header.taken_ns, |heard| fusion.observe_class(heard))?;
            Ok(fusion.step(sample))
        })
    })
}
