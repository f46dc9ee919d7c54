//! The camera process: frames go out.

use camera::{Config, RecordedCamera, SimulatedCamera};
use messages::Frame;
use shell::{Error, tell};
use std::process::ExitCode;

fn main() -> ExitCode {
    shell::main(|shell| {
        let config = shell.config(Config::validate)?;
        let frames = shell.output::<Frame>("frames")?;
        match config {
            Config::Simulated { rate_hz, rover } => {
                let camera = SimulatedCamera::new(rover, rate_hz, shell.started_ns());
                shell.on_tick(camera.period_ns(), |number, _| {
                    frames.send_with(|frame| {
                        camera.fill(number, frame);
                        Ok(())
                    })
                })
            }
            Config::Recorded { folder } => {
                let table = shell.read(&format!("{folder}/frames.csv"))?;
                let mut camera = RecordedCamera::open(&folder, table).map_err(Error::data)?;
                while let (true, Some(row)) = (shell.running(), camera.next_row().map_err(Error::data)?) {
                    let png = shell.read(&camera.path(&row)).map_err(|error| error.to_string());
                    frames.send_with(|frame| {
                        let filled = camera.fill(&row, png.as_deref().map_err(Clone::clone), frame);
                        filled.unwrap_or_else(|why| tell(format!("camera: {why}; the frame goes without a picture")));
                        Ok(())
                    })?;
                }
                frames.end(camera.last_ns(), 0)?;
                shell.until_told();
                Ok(())
            }
        }
    })
}
