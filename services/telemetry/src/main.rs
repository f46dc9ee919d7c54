//! The telemetry process: wheel and vibration go out, and sinkage where it was measured without a camera.

use messages::{Sinkage, Vibration, Wheel};
use shell::Error;
use std::process::ExitCode;
use telemetry::{Config, Event, Files, Recording, SimulatedTelemetry};

fn main() -> ExitCode {
    shell::main(|shell| {
        let config = shell.config(Config::validate)?;
        let wheel = shell.output_if_wired::<Wheel>("wheel")?;
        let sinkage = shell.output_if_wired::<Sinkage>("sinkage")?;
        let vibration = shell.output_if_wired::<Vibration>("vibration")?;
        let send = |event: Event| match event {
            Event::Wheel(sample) => wheel.iter().try_for_each(|wire| wire.send(sample)),
            Event::Sinkage(sample) => sinkage.iter().try_for_each(|wire| wire.send(sample)),
            Event::Vibration(piece) => vibration.iter().try_for_each(|wire| wire.send(piece.clone())),
        };
        match config {
            Config::Simulated { rover } => {
                let mut telemetry = SimulatedTelemetry::new(rover, shell.started_ns());
                shell.on_tick(SimulatedTelemetry::PERIOD_NS, |tick, _| telemetry.at(tick, send))
            }
            Config::Recorded { folder } => {
                let open = |name: &str| Ok(shell.open(&format!("{folder}/{name}"))?.map(|file| Box::new(file) as _));
                let files = Files::open(|port| shell.writes(port), open)?;
                let mut recording = Recording::open(&folder, files).map_err(Error::data)?;
                while let (true, Some(event)) = (shell.running(), recording.next_event().map_err(Error::data)?) {
                    send(event)?;
                }
                shell.until_told();
                Ok(())
            }
        }
    })
}
