//! The sensors of a system of some size: what they deliver was made before, so that it costs no more than being handed over.

use messages::{Frame, Header, Message, Status, Vibration, Wheel};
use serde::Deserialize;
use shell::{Error, Shell};
use simulation::Rover;
use zerocopy::FromZeros;

/// Pictures that a source has, made beforehand, from all over the route.
const PICTURES: usize = 64;
/// Between two readings of the wheel, and between two pieces of vibration [ns].
const READING_NS: u64 = 10_000_000;
const PIECE_NS: u64 = 100_000_000;

/// What a source is told.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Pictures {
    rate_hz: f64,
    width_px: u32,
    height_px: u32,
}

/// The same, of one that plays samples.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Samples {
    file: String,
}

/// A source whose samples have been made before: what it costs is that they are handed over.
pub fn source(shell: &mut Shell) -> Result<(), Error> {
    if shell.writes("frames") {
        return camera(shell);
    }
    let samples: Samples = shell.config(|_| Ok(()))?;
    if shell.writes("wheel") {
        return play::<Wheel>(shell, "wheel", &samples.file, READING_NS, |_, _| ());
    }
    play::<Vibration>(shell, "vibration", &samples.file, PIECE_NS, |piece, later_ns| {
        piece.start_ns = piece.start_ns.wrapping_add(later_ns);
    })
}

/// Sends the samples of a file one after the other, and again; `move_later` does so with instants beyond the header's.
fn play<T: Message + Clone>(
    shell: &mut Shell,
    port: &str,
    file: &str,
    period_ns: u64,
    move_later: fn(&mut T, u64),
) -> Result<(), Error> {
    let output = shell.output::<T>(port)?;
    let bytes = shell.read(file)?;
    let samples = bytes.chunks_exact(size_of::<T>()).map(T::read_from_bytes);
    let samples: Vec<T> = samples.collect::<Result<_, _>>().map_err(|_| Error::data(file))?;
    shell.on_tick(period_ns, |number, instant_ns| {
        let mut sample = samples[number as usize % samples.len()].clone();
        let later_ns = instant_ns.wrapping_sub(sample.header().taken_ns);
        move_later(&mut sample, later_ns);
        (sample.header_mut().taken_ns, sample.header_mut().sequence) = (instant_ns, number);
        output.send(sample)
    })
}

/// Sends pictures of the route over and over.
fn camera(shell: &mut Shell) -> Result<(), Error> {
    let config: Pictures = shell.config(|_| Ok(()))?;
    let frames = shell.output::<Frame>("frames")?;
    let about = simulation::Config {
        picture_width_px: config.width_px,
        picture_height_px: config.height_px,
        ..simulation::Config::default()
    };
    let route_ns = about.route_s * 1e9;
    let rover = Rover::new(about);
    let mut pictures = Vec::with_capacity(PICTURES);
    for index in 0..PICTURES {
        let mut picture = Frame::new_box_zeroed().map_err(|_| Error::internal("no memory for a picture"))?;
        rover.render(route_ns * 1e-9 * index as f64 / PICTURES as f64, &mut picture);
        pictures.push(picture);
    }
    let period_ns = (1e9 / config.rate_hz).round() as u64;
    shell.on_tick(period_ns, |number, instant_ns| {
        let share = ((number * period_ns) as f64 % route_ns) / route_ns;
        let picture = &pictures[(share * PICTURES as f64) as usize % PICTURES];
        frames.send_with(|frame| {
            copy(picture, frame);
            frame.header = Header {
                taken_ns: instant_ns,
                sequence: number,
                status: Status::OK,
                ..Header::default()
            };
            Ok(())
        })
    })
}

/// Copies what has a meaning.
fn copy(picture: &Frame, frame: &mut Frame) {
    (frame.width, frame.height) = (picture.width, picture.height);
    (frame.crop_x_px, frame.crop_y_px) = (picture.crop_x_px, picture.crop_y_px);
    (frame.center_x_px, frame.center_y_px) = (picture.center_x_px, picture.center_y_px);
    (frame.rim_radius_px, frame.wheel_radius_px) = (picture.rim_radius_px, picture.wheel_radius_px);
    frame.pitch_rad = picture.pitch_rad;
    frame.homography = picture.homography;
    let image = picture.image();
    frame.pixels[..image.len()].copy_from_slice(image);
}
