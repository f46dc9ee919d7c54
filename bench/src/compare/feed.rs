//! The input of every variant: pictures and wheel readings of the simulated rover, made once and read from a file.

use crate::{Day, Outcome};
use messages::{Frame, Header, Status, Wheel};
use shell::now_ns;
use std::io::{BufWriter, Write};
use std::path::Path;
use zerocopy::{FromBytes, FromZeros, IntoBytes};

/// Sensor time of a cycle [ns].
pub const CYCLE_NS: u64 = 30_000_000;
/// Wheel readings of a cycle: 100 Hz.
const READINGS: usize = 3;
const READING_NS: u64 = CYCLE_NS / READINGS as u64;
/// Bytes of a frame up to the end of its picture of 640 × 480.
pub const FRAME_BYTES: usize = 160 + 640 * 480;
const RECORD_BYTES: usize = FRAME_BYTES + READINGS * size_of::<Wheel>();
/// Pictures in a row; then they begin again.
const PICTURES: usize = 100;

/// What the sensors deliver, cycle by cycle, without end.
pub struct Feed(Vec<u8>);

impl Feed {
    /// Renders the pictures into a file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(path: &Path) -> Outcome<()> {
        let day = Day::new();
        let mut file = BufWriter::new(std::fs::File::create(path)?);
        let mut frame = Frame::new_box_zeroed().map_err(|_| "no memory for a picture")?;
        for (number, readings) in day.cycles().take(PICTURES) {
            let taken_s = ((number * READINGS + READINGS) as u64 * READING_NS) as f64 / 1e9;
            day.rover.render(taken_s, &mut frame);
            if frame.image().len() + 160 != FRAME_BYTES {
                return Err("the simulated camera is not of 640 x 480 pixels".into());
            }
            file.write_all(&frame.as_bytes()[..FRAME_BYTES])?;
            file.write_all(readings.as_bytes())?;
        }
        Ok(file.flush()?)
    }

    /// Reads what [`Feed::write`] has written.
    ///
    /// # Errors
    /// The file is not there, or of another length.
    pub fn read(path: &Path) -> Outcome<Self> {
        let bytes = std::fs::read(path)?;
        if bytes.len() != PICTURES * RECORD_BYTES {
            return Err(format!("{}: is no feed of this version", path.display()).into());
        }
        Ok(Self(bytes))
    }

    /// The picture of a cycle, to be sent with the header of its number.
    #[must_use]
    pub fn picture(&self, cycle: u64) -> &[u8] {
        &self.record(cycle)[..FRAME_BYTES]
    }

    /// The wheel readings of a cycle, to be sent before the picture of this sequence number.
    pub fn readings(&self, cycle: u64, sequence: u64) -> impl Iterator<Item = Wheel> {
        let records = self.record(cycle)[FRAME_BYTES..].chunks_exact(size_of::<Wheel>());
        let readings = records.filter_map(|bytes| Wheel::read_from_bytes(bytes).ok());
        readings.zip(1..).map(move |(reading, number)| Wheel {
            header: Header {
                taken_ns: sequence * CYCLE_NS + number * READING_NS,
                published_ns: now_ns(),
                sequence: sequence * READINGS as u64 + number,
                ..reading.header
            },
            ..reading
        })
    }

    /// The header of a picture.
    #[must_use]
    pub fn header(sequence: u64, status: Status) -> Header {
        Header {
            taken_ns: (sequence + 1) * CYCLE_NS,
            sequence,
            generation: 1,
            status,
            ..Header::default()
        }
    }

    fn record(&self, cycle: u64) -> &[u8] {
        let index = usize::try_from(cycle % PICTURES as u64).unwrap_or(0);
        &self.0[index * RECORD_BYTES..][..RECORD_BYTES]
    }
}

/// Writes a picture in place, then its header, and returns the instant between [ns]: that at which it was complete.
pub fn write_frame(place: &mut [u8], header: Header, picture: &[u8]) -> u64 {
    place[..picture.len()].copy_from_slice(picture);
    let published_ns = now_ns();
    let header = Header { published_ns, ..header };
    place[..size_of::<Header>()].copy_from_slice(header.as_bytes());
    published_ns
}
