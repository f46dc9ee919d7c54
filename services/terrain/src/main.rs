//! Fusion, as a process: soil in, terrain out, with the sinkage and the class taken in on the way.

use messages::{Sinkage, Soil, Terrain, TerrainClass};
use std::process::ExitCode;
use terrain::{Config, TerrainFusion};

fn main() -> ExitCode {
    shell::main(|shell| {
        let mut fusion = TerrainFusion::new(shell.config(Config::validate)?);
        let soil = shell.input::<Soil>("soil")?;
        let mut sinkage = shell.observation::<Sinkage>("sinkage")?;
        let mut class = shell.observation::<TerrainClass>("class")?;
        let terrain = shell.output::<Terrain>("terrain")?;
        shell.on_each(soil, terrain, |soil| {
            sinkage.until(soil.header.taken_ns, |sinkage| fusion.observe_sinkage(sinkage))?;
            class.until(soil.header.taken_ns, |class| fusion.observe_class(class))?;
            Ok(fusion.step(soil))
        })
    })
}
