//! Trains the built-in model on the simulated rover and prints it:
//! `cargo run --release -p vibration --example built_in_model > services/vibration/src/built_in.toml`

use nalgebra::DMatrix;
use simulation::{CHANNELS, Config, Rover, SOILS};
use vibration::spectrum::Spectrum;
use vibration::train::{Setup, train};

const RATE_HZ: f64 = 100.0;
const WINDOW_SAMPLES: usize = 100;
const TAPERS: usize = 5;
/// Windows of each soil.
const WINDOWS: usize = 100;

fn main() -> Result<(), String> {
    print!("{}", built_in_model()?);
    Ok(())
}

/// The model as text.
pub fn built_in_model() -> Result<String, String> {
    let window_s = WINDOW_SAMPLES as f64 / RATE_HZ;
    let route_s = (SOILS.len() * WINDOWS) as f64 * window_s;
    let rover = Rover::new(Config {
        seed: 1997,
        route_s,
        ..Config::default()
    });
    let channels = &CHANNELS[..6];
    let setup = Setup {
        labels: SOILS.iter().map(|soil| soil.name.to_owned()).collect(),
        channels: channels.iter().map(|name| (*name).to_owned()).collect(),
        rate_hz: RATE_HZ,
        window_samples: WINDOW_SAMPLES,
        tapers: TAPERS,
        still_m_s: 0.005,
        components: 6,
    };
    let bins = WINDOW_SAMPLES / 2;
    let mut spectrum = Spectrum::new(WINDOW_SAMPLES, RATE_HZ, TAPERS);
    let mut features = DMatrix::zeros(SOILS.len() * WINDOWS, channels.len() * bins);
    let mut classes = Vec::new();
    let mut log_psd = vec![0.0; bins];
    for row in 0..features.nrows() {
        let start_s = row as f64 * window_s;
        let samples: Vec<_> = (0..WINDOW_SAMPLES)
            .map(|i| rover.vibration(start_s + i as f64 / RATE_HZ))
            .collect();
        for channel in 0..channels.len() {
            let window: Vec<f64> = samples.iter().map(|sample| f64::from(sample[channel])).collect();
            spectrum.log_psd(&window, &mut log_psd);
            features
                .view_mut((row, channel * bins), (1, bins))
                .copy_from_slice(&log_psd);
        }
        classes.push(rover.state(start_s + window_s / 2.0).soil);
    }
    train(&setup, &features, &classes)?.to_text()
}
