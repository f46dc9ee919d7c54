//! Trains the built-in model on the simulated rover and prints it:
//! `cargo run --release -p vibration --example built_in_model > services/vibration/src/built_in.toml`

use simulation::{CHANNELS, Config, Rover, SOILS};
use vibration::model::{Filtering, Method, Rejecting};
use vibration::recording::Recording;
use vibration::train::{Setup, train};

const RATE_HZ: f64 = 100.0;
const WINDOW_SAMPLES: usize = 100;
/// Rovers, each of another seed, and the time that each of them spends on a soil [s].
const ROVERS: u64 = 4;
const SOIL_S: usize = 25;

fn main() -> Result<(), String> {
    print!("{}", built_in_model()?);
    Ok(())
}

/// The model as text.
pub fn built_in_model() -> Result<String, String> {
    let channels = &CHANNELS[..6];
    let setup = Setup {
        labels: SOILS.iter().map(|soil| soil.name.to_owned()).collect(),
        channels: channels.iter().map(|name| (*name).to_owned()).collect(),
        rate_hz: RATE_HZ,
        window_samples: WINDOW_SAMPLES,
        method: Method::Coupled,
        filtering: Filtering::Hmm,
        rejecting: Rejecting::Calibrated,
    };
    let mut recordings = Vec::new();
    for class in 0..SOILS.len() {
        recordings.extend((0..ROVERS).map(|rover| drive(class, 1997 + rover)));
    }
    train(&setup, &recordings, &mut |_, _| {})?.model.to_text()
}

/// A rover on one soil.
fn drive(class: usize, seed: u64) -> Recording {
    let rover = Rover::new(Config {
        seed,
        route_s: (SOILS.len() * SOIL_S) as f64,
        ..Config::default()
    });
    let count = SOIL_S * RATE_HZ as usize;
    let samples: Vec<[f32; 7]> = (0..count)
        .map(|index| rover.vibration((class * SOIL_S) as f64 + index as f64 / RATE_HZ))
        .collect();
    let channel = |index: usize| samples.iter().map(|sample| f64::from(sample[index])).collect();
    Recording {
        run: format!("{}_{seed}", SOILS[class].name),
        class,
        taken_ns: (0..count).map(|index| (index as f64 * 1e9 / RATE_HZ) as u64).collect(),
        channels: (0..6).map(channel).collect(),
        speed_m_s: channel(6),
    }
}
