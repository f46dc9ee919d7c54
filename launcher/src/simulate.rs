//! `simulate`: a recorded traverse of the simulated rover, with the truth beside it.

use crate::commands::listen;
use clap::Args;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use indicatif::{ProgressBar, ProgressStyle};
use messages::Frame;
use shell::{Error, Termination};
use simulation::{CHANNELS, Rover, SOILS};
use std::fmt::{Display, Write};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use traverse::{FRAME_COLUMNS, WHEEL_COLUMNS};
use zerocopy::FromZeros;

/// Time between two rows of `wheel.csv` and of `vibration.csv`, as on board.
const TELEMETRY_PERIOD_NS: u64 = 10_000_000;
const TRUTH_COLUMNS: [&str; 14] = [
    "file",
    "taken_s",
    "soil",
    "cohesion_pa",
    "friction_rad",
    "shear_modulus_m",
    "entry_rad",
    "exit_rad",
    "left_rad",
    "right_rad",
    "sinkage_m",
    "slip",
    "load_n",
    "torque_nm",
];

/// `terrasense simulate`
#[derive(Debug, Args)]
pub struct SimulateArguments {
    /// The traverse folder to write. It appears when it is complete.
    #[arg(long, value_name = "TRAVERSE")]
    out: PathBuf,
    /// How long to drive [s].
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,
    /// The noise: another seed, other readings.
    #[arg(long, default_value_t = 1)]
    seed: u32,
    /// Frames a second.
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rate_hz: u32,
    /// Replace the traverse that is there.
    #[arg(long)]
    force: bool,
}

/// Writes a traverse.
pub fn run(arguments: &SimulateArguments) -> Result<ExitCode, Error> {
    let termination = listen()?;
    let partial = Partial::create(&arguments.out, arguments.force)?;
    let config = simulation::Config {
        seed: u64::from(arguments.seed),
        ..simulation::Config::default()
    };
    partial.write("traverse.toml", description(&config).as_bytes())?;
    let rover = Rover::new(config);
    let end_ns = arguments.seconds * 1_000_000_000;
    partial.write("wheel.csv", wheel_table(&rover, end_ns).as_bytes())?;
    partial.write("vibration.csv", vibration_table(&rover, end_ns).as_bytes())?;
    let frames = write_frames(&partial, &rover, arguments, &termination)?;
    partial.complete()?;
    println!("{}: {} s, {frames} frames", arguments.out.display(), arguments.seconds);
    Ok(ExitCode::SUCCESS)
}

/// Writes the pictures, `frames.csv` and `truth.csv`; the number of frames.
fn write_frames(
    partial: &Partial,
    rover: &Rover,
    arguments: &SimulateArguments,
    termination: &Termination,
) -> Result<u64, Error> {
    let count = arguments.seconds * u64::from(arguments.rate_hz);
    let period_ns = (1e9 / f64::from(arguments.rate_hz)).round() as u64;
    let mut frame = Frame::new_box_zeroed().map_err(|_| Error::internal("no memory for a frame"))?;
    let (mut table, mut truth) = (line(FRAME_COLUMNS), line(TRUTH_COLUMNS));
    let style = ProgressStyle::with_template("{wide_bar} {pos} of {len} frames, {eta} left");
    // Drawn on a terminal only.
    let bar = ProgressBar::new(count).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    for index in 0..count {
        if termination.requested() {
            return Err(Error::internal("interrupted; nothing was written"));
        }
        let taken_ns = index * period_ns;
        let file = format!("{index:06}.png");
        rover.render(taken_ns as f64 / 1e9, &mut frame);
        partial.write(&file, &png_bytes(&frame)?)?;
        table += &frame_line(&file, taken_ns, &frame);
        truth += &truth_line(&file, taken_ns, rover);
        bar.inc(1);
    }
    bar.finish_and_clear();
    partial.write("frames.csv", table.as_bytes())?;
    partial.write("truth.csv", truth.as_bytes())?;
    Ok(count)
}

fn description(config: &simulation::Config) -> String {
    let sigma = 0.03 * config.noise;
    format!(
        "# A simulated rover, seed {}. The truth is in truth.csv.\n\n\
         [wheel]\nradius_m = {}\nwidth_m = {}\nrolls = \"right\"\n\n\
         [soil]\nshear_modulus_m = {}\n\n\
         [sensors]\nload_sigma = {sigma}\ntorque_sigma = {sigma}\nslip_sigma = {}\n",
        config.seed,
        config.radius_m,
        config.width_m,
        SOILS[0].shear_modulus_m,
        0.02 * config.noise,
    )
}

fn wheel_table(rover: &Rover, end_ns: u64) -> String {
    // The rover reports no slip.
    let mut table = line(&WHEEL_COLUMNS[..5]);
    for taken_ns in (0..end_ns).step_by(TELEMETRY_PERIOD_NS as usize) {
        let wheel = rover.wheel(taken_ns as f64 / 1e9);
        let motion = [wheel.angular_velocity_rad_s, wheel.linear_velocity_m_s];
        let values = [wheel.load_n, wheel.torque_nm].into_iter().chain(motion);
        table += &line(
            [seconds(taken_ns)]
                .into_iter()
                .chain(values.map(|value| value.to_string())),
        );
    }
    table
}

fn vibration_table(rover: &Rover, end_ns: u64) -> String {
    let mut table = line(["taken_s"].iter().chain(&CHANNELS));
    for taken_ns in (0..end_ns).step_by(TELEMETRY_PERIOD_NS as usize) {
        let values = rover.vibration(taken_ns as f64 / 1e9).map(|value| value.to_string());
        table += &line([seconds(taken_ns)].into_iter().chain(values));
    }
    table
}

fn frame_line(file: &str, taken_ns: u64, frame: &Frame) -> String {
    let pose = [
        frame.center_x_px,
        frame.center_y_px,
        frame.rim_radius_px,
        frame.wheel_radius_px,
        frame.pitch_rad,
    ];
    let numbers = pose.into_iter().chain(frame.homography).map(|value| value.to_string());
    line([file.to_owned(), seconds(taken_ns)].into_iter().chain(numbers))
}

fn truth_line(file: &str, taken_ns: u64, rover: &Rover) -> String {
    let state = rover.state(taken_ns as f64 / 1e9);
    let soil = &SOILS[state.soil];
    let numbers = [
        soil.cohesion_pa,
        soil.friction_rad,
        soil.shear_modulus_m,
        state.entry_rad,
        state.exit_rad,
        -state.exit_rad,
        state.entry_rad,
        state.sinkage_m,
        state.slip,
        state.load_n,
        state.torque_nm,
    ];
    let words = [file.to_owned(), seconds(taken_ns), soil.name.to_owned()];
    line(words.into_iter().chain(numbers.map(|value| value.to_string())))
}

/// A line of a table.
fn line(cells: impl IntoIterator<Item = impl Display>) -> String {
    let mut line = String::new();
    for cell in cells {
        let comma = if line.is_empty() { "" } else { "," };
        let _ = write!(line, "{comma}{cell}");
    }
    line + "\n"
}

fn seconds(ns: u64) -> String {
    (ns as f64 / 1e9).to_string()
}

fn png_bytes(frame: &Frame) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Up)
        .write_image(frame.image(), frame.width, frame.height, ExtendedColorType::L8)
        .map_err(|error| Error::internal(error.to_string()))?;
    Ok(bytes)
}

/// A folder in the making, beside the one that it becomes. It is gone if it does not become it.
struct Partial {
    folder: PathBuf,
    out: PathBuf,
}

impl Partial {
    fn create(out: &Path, force: bool) -> Result<Self, Error> {
        let out = std::path::absolute(out).map_err(|error| Error::usage(format!("{}: {error}", out.display())))?;
        let shown = out.display();
        let (Some(parent), Some(name)) = (out.parent(), out.file_name()) else {
            return Err(Error::usage(format!("{shown}: name a folder to be written")));
        };
        let is_file = out.symlink_metadata().is_ok_and(|metadata| !metadata.is_dir());
        if is_file {
            return Err(Error::usage(format!("{shown}: is there and is no folder")));
        }
        let is_empty = fs::read_dir(&out).map_or(true, |mut entries| entries.next().is_none());
        if !is_empty && !force {
            return Err(Error::usage(format!(
                "{shown}: is not empty; --force replaces a traverse that is there"
            )));
        }
        if !is_empty && !out.join("traverse.toml").is_file() {
            return Err(Error::usage(format!(
                "{shown}: holds something else than a traverse; name another folder"
            )));
        }
        let folder = parent.join(format!(".{}.partial-{}", name.display(), std::process::id()));
        fs::create_dir_all(&folder).map_err(|error| failed(&folder, &error))?;
        Ok(Self { folder, out })
    }

    fn write(&self, file: &str, bytes: &[u8]) -> Result<(), Error> {
        let path = self.folder.join(file);
        fs::write(&path, bytes).map_err(|error| failed(&path, &error))
    }

    /// Takes the place of the folder that is to be written.
    fn complete(self) -> Result<(), Error> {
        if self.out.exists() {
            fs::remove_dir_all(&self.out).map_err(|error| failed(&self.out, &error))?;
        }
        fs::rename(&self.folder, &self.out).map_err(|error| failed(&self.out, &error))
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        // Renamed by now, where all went well.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

fn failed(path: &Path, error: &std::io::Error) -> Error {
    Error::unavailable(format!("{}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use traverse::{FrameRows, Traverse};

    fn arguments(out: &Path, force: bool) -> SimulateArguments {
        SimulateArguments {
            out: out.to_owned(),
            seconds: 1,
            seed: 1,
            rate_hz: 3,
            force,
        }
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap().flatten();
        let mut names: Vec<String> = entries.map(|entry| entry.file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_traverse_is_written_that_its_readers_take() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("a");
        run(&arguments(&out, false)).unwrap();
        let files = "000000.png 000001.png 000002.png frames.csv traverse.toml truth.csv vibration.csv wheel.csv";
        assert_eq!(names(&out).join(" "), files);
        assert_eq!(names(folder.path()), ["a"]);
        let text = fs::read_to_string(out.join("traverse.toml")).unwrap();
        let described = Traverse::parse("traverse.toml", &text).unwrap();
        assert_eq!(described.wheel.unwrap().radius_m, 0.15);
        let table = fs::read(out.join("frames.csv")).unwrap();
        let rows: Vec<_> = FrameRows::open("frames.csv", Box::new(std::io::Cursor::new(table)))
            .unwrap()
            .collect();
        assert_eq!(rows.len(), 3);
        let last = rows[2].clone().unwrap();
        assert_eq!((last.taken_ns, last.file.as_str()), (666_666_666, "000002.png"));
        assert!(last.homography.is_some());
        let lines = |file: &str| fs::read_to_string(out.join(file)).unwrap().lines().count();
        assert_eq!(
            (lines("wheel.csv"), lines("vibration.csv"), lines("truth.csv")),
            (101, 101, 4)
        );
    }

    #[test]
    fn two_runs_write_the_same_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let (a, b) = (folder.path().join("a"), folder.path().join("b"));
        run(&arguments(&a, false)).unwrap();
        run(&arguments(&b, false)).unwrap();
        for name in names(&a) {
            assert!(
                fs::read(a.join(&name)).unwrap() == fs::read(b.join(&name)).unwrap(),
                "{name}"
            );
        }
    }

    #[test]
    fn only_a_traverse_is_replaced_and_only_by_force() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("a");
        let refused = |force| run(&arguments(&out, force)).unwrap_err().to_string();
        fs::create_dir(&out).unwrap();
        fs::write(out.join("thesis.txt"), "years of work").unwrap();
        assert!(refused(false).contains("is not empty"));
        assert!(refused(true).contains("something else than a traverse"));
        assert_eq!(names(&out), ["thesis.txt"]);
        fs::rename(out.join("thesis.txt"), out.join("traverse.toml")).unwrap();
        assert!(refused(false).contains("is not empty"));
        run(&arguments(&out, true)).unwrap();
        assert_eq!(names(&out).len(), 8);
        assert_eq!(names(folder.path()), ["a"]);
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        assert!(
            run(&arguments(&file, true))
                .unwrap_err()
                .to_string()
                .contains("is no folder")
        );
    }
}
