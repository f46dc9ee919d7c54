//! A recorded traverse as one stream of samples in the order of their instants, without gaps.

use crate::sinkage::SinkageRows;
use crate::vibration::{Instant, VibrationRows};
use crate::wheel::{self, WheelRows};
use crate::{Event, PIECE_NS};
use messages::{CHANNELS_MAX, Header, SAMPLES_MAX, Sinkage, Status, Vibration, Wheel, label};
use traverse::{FrameRows, GAP_MAX_S, Input, InputError, Traverse};
use zerocopy::FromZeros;

/// Longest silence on the wires of wheel, sinkage and vibration. Readers wait for an observation until a later sample is
/// there; so that a sensor's pause does not stop them, a sample then says that there were no data. Sinkage is no
/// observation but a trigger, and every sample of it makes an estimate: its pauses stay.
const SILENCE_MAX_NS: [Option<u64>; 3] = [Some(100_000_000), None, Some(PIECE_NS)];
/// Samples of other wires, at the most, between two samples of an observation: what waits for it need not hold more.
const RUN_MAX: u32 = 255;

/// The open files of a traverse folder; those that are `None` are not there.
#[derive(Default)]
pub struct Files {
    /// `traverse.toml`
    pub description: Option<Input>,
    /// `frames.csv`: the traverse lasts until its last frame, and no clock of another file may be far from its.
    pub frames: Option<Input>,
    /// `wheel.csv`
    pub wheel: Option<Input>,
    /// `sinkage.csv`
    pub sinkage: Option<Input>,
    /// `vibration.csv`
    pub vibration: Option<Input>,
    /// `vibration.wav`
    pub sound: Option<Input>,
}

impl Files {
    /// Opens the files of a folder by their names; of the sensors', those whose wire is wanted.
    ///
    /// # Errors
    /// Those of `open`.
    pub fn open<E>(wanted: impl Fn(&str) -> bool, open: impl Fn(&str) -> Result<Option<Input>, E>) -> Result<Self, E> {
        let sensor = |port: &str, file: &str| if wanted(port) { open(file) } else { Ok(None) };
        Ok(Self {
            description: open("traverse.toml")?,
            frames: open("frames.csv")?,
            wheel: sensor("wheel", "wheel.csv")?,
            sinkage: sensor("sinkage", "sinkage.csv")?,
            vibration: sensor("vibration", "vibration.csv")?,
            sound: sensor("vibration", "vibration.wav")?,
        })
    }
}

/// A recorded traverse, file by file open, read as it is asked for.
pub struct Recording {
    /// Those of wheel, sinkage and vibration that are there, in this order.
    sensors: Vec<Sensor>,
    pieces: Pieces,
    now_ns: u64,
    end_ns: u64,
    /// Wires that have been told that the recording is over.
    ended: usize,
}

impl Recording {
    /// Reads the headers and the first rows. `folder` is only for errors.
    ///
    /// # Errors
    /// Where a file is not what it must be, or its clock is another one than the other files'.
    pub fn open(folder: &str, files: Files) -> Result<Self, InputError> {
        let path = |name: &str| format!("{folder}/{name}");
        if files.vibration.is_some() && files.sound.is_some() {
            let what = "there is also a vibration.csv; keep one of the two";
            return Err(InputError::new(&path("vibration.wav"), 0, what));
        }
        let traverse = Traverse::read(&path("traverse.toml"), files.description)?;
        let (mut pieces, mut sensors) = (Pieces::new(), Vec::new());
        if let Some(input) = files.wheel {
            let file = path("wheel.csv");
            sensors.push(Sensor::new(Rows::Wheel(WheelRows::open(&file, input)?), file)?);
        }
        if let Some(input) = files.sinkage {
            let file = path("sinkage.csv");
            sensors.push(Sensor::new(
                Rows::Sinkage(SinkageRows::open(&file, input, &traverse)?),
                file,
            )?);
        }
        for (file, input) in [("vibration.csv", files.vibration), ("vibration.wav", files.sound)] {
            let (Some(input), file) = (input, path(file)) else {
                continue;
            };
            let rows = VibrationRows::open(&file, input, &traverse)?;
            pieces.describe(&rows);
            sensors.push(Sensor::new(Rows::Vibration(rows), file)?);
        }
        let frames = files
            .frames
            .map(|input| span_ns(&path("frames.csv"), input))
            .transpose()?;
        let begin_ns = begin_ns(&sensors, frames.map(|(first_ns, _)| (first_ns, path("frames.csv"))))?;
        sensors.iter_mut().for_each(|sensor| sensor.last_ns = begin_ns);
        Ok(Self {
            sensors,
            pieces,
            now_ns: begin_ns,
            end_ns: frames.map_or(begin_ns, |(_, last_ns)| last_ns),
            ended: 0,
        })
    }

    /// The next sample of any wire. The traverse ends with the last instant of any file; then each wire, also one without a
    /// file, gets a sample that says so (`ENDED`), and `None` follows.
    ///
    /// # Errors
    /// Where a row is not what it must be.
    pub fn next_event(&mut self) -> Result<Option<Event<'_>>, InputError> {
        self.pieces.reopen();
        loop {
            let head = self.earliest();
            let until_ns = head.map_or(self.end_ns.max(self.now_ns), |(taken_ns, _)| taken_ns);
            if let Some((due_ns, index)) = self.overdue(until_ns) {
                return Ok(Some(self.end_interval(due_ns, index)));
            }
            self.now_ns = until_ns;
            let Some((taken_ns, index)) = head else {
                return Ok(self.end());
            };
            match self.sensors[index].take()? {
                Some(Row::Wheel(sample)) => {
                    self.note(taken_ns, index);
                    return Ok(Some(Event::Wheel(sample)));
                }
                Some(Row::Sinkage(sample)) => {
                    self.note(taken_ns, index);
                    return Ok(Some(Event::Sinkage(sample)));
                }
                Some(Row::Vibration(instant)) => self.pieces.push(&instant),
                None => (),
            }
            if self.pieces.is_full() {
                return Ok(Some(self.end_interval(taken_ns, index)));
            }
        }
    }

    /// The sensor whose row comes next, and when.
    fn earliest(&self) -> Option<(u64, usize)> {
        let heads = self.sensors.iter().enumerate();
        let heads = heads.filter_map(|(index, sensor)| Some((sensor.next.as_ref()?.taken_ns(), index)));
        heads.min()
    }

    /// The sensor whose wire must carry something before the instant, and when.
    fn overdue(&self, until_ns: u64) -> Option<(u64, usize)> {
        let due = |(index, sensor): (usize, &Sensor)| {
            let wire = sensor.rows.wire();
            let silent_ns = sensor.last_ns.saturating_add(SILENCE_MAX_NS[wire]?);
            // The piece up to an instant leaves before the sample of that instant: that one begins the next piece.
            let is_silent = silent_ns < until_ns || (silent_ns == until_ns && wire == VIBRATION);
            let is_behind = sensor.others >= RUN_MAX;
            is_silent
                .then_some((silent_ns, index))
                .or(is_behind.then_some((self.now_ns, index)))
        };
        self.sensors.iter().enumerate().filter_map(due).min()
    }

    /// The sample of an interval, which is no row: a piece of vibration, or one that says that there were no data.
    fn end_interval(&mut self, taken_ns: u64, index: usize) -> Event<'_> {
        let since_ns = self.sensors[index].last_ns;
        self.note(taken_ns, index);
        let sensor = &self.sensors[index];
        let silence = Header {
            taken_ns,
            // That of the row that is waited for.
            sequence: sensor.taken,
            status: Status::NO_DATA,
            ..Header::default()
        };
        match sensor.rows {
            Rows::Wheel(_) => Event::Wheel(wheel::unknown(silence)),
            Rows::Sinkage(_) => Event::Sinkage(Sinkage::unknown(silence)),
            Rows::Vibration(_) => Event::Vibration(self.pieces.close(since_ns, taken_ns)),
        }
    }

    /// Notes that a sensor's wire carries a sample.
    fn note(&mut self, taken_ns: u64, index: usize) {
        for sensor in &mut self.sensors {
            sensor.others = sensor.others.saturating_add(1);
        }
        (self.sensors[index].last_ns, self.sensors[index].others) = (taken_ns, 0);
        self.now_ns = taken_ns;
    }

    /// What follows the last row.
    fn end(&mut self) -> Option<Event<'_>> {
        if self.pieces.has_samples() {
            return Some(Event::Vibration(self.pieces.close(self.now_ns, self.now_ns)));
        }
        let over = Header {
            taken_ns: self.now_ns,
            status: Status::ENDED,
            ..Header::default()
        };
        self.ended += 1;
        match self.ended {
            1 => Some(Event::Wheel(wheel::unknown(over))),
            2 => Some(Event::Sinkage(Sinkage::unknown(over))),
            3 => Some(Event::Vibration(self.pieces.end(over))),
            _ => None,
        }
    }
}

/// A sensor's file, one row of it read ahead, and how long its wire has been silent.
struct Sensor {
    file: String,
    rows: Rows,
    next: Option<Row>,
    /// Rows taken so far.
    taken: u64,
    /// Instant of the wire's last sample.
    last_ns: u64,
    /// Samples of other wires since.
    others: u32,
}

impl Sensor {
    fn new(mut rows: Rows, file: String) -> Result<Self, InputError> {
        Ok(Self {
            file,
            next: rows.read()?,
            rows,
            taken: 0,
            last_ns: 0,
            others: 0,
        })
    }

    /// Takes the row that was read ahead, and reads the one after it.
    fn take(&mut self) -> Result<Option<Row>, InputError> {
        self.taken += 1;
        let next = self.rows.read()?;
        Ok(std::mem::replace(&mut self.next, next))
    }
}

/// The rows of a file.
enum Rows {
    Wheel(WheelRows),
    Sinkage(SinkageRows),
    Vibration(VibrationRows),
}

const VIBRATION: usize = 2;

impl Rows {
    fn read(&mut self) -> Result<Option<Row>, InputError> {
        Ok(match self {
            Self::Wheel(rows) => rows.next_row()?.map(Row::Wheel),
            Self::Sinkage(rows) => rows.next_row()?.map(Row::Sinkage),
            Self::Vibration(rows) => rows.next_row()?.map(Row::Vibration),
        })
    }

    /// The place in [`SILENCE_MAX_NS`].
    fn wire(&self) -> usize {
        match self {
            Self::Wheel(_) => 0,
            Self::Sinkage(_) => 1,
            Self::Vibration(_) => VIBRATION,
        }
    }
}

/// A row of a file.
enum Row {
    Wheel(Wheel),
    Sinkage(Sinkage),
    Vibration(Instant),
}

impl Row {
    fn taken_ns(&self) -> u64 {
        match self {
            Self::Wheel(sample) => sample.header.taken_ns,
            Self::Sinkage(sample) => sample.header.taken_ns,
            Self::Vibration(instant) => instant.taken_ns,
        }
    }
}

/// Collects instants into pieces of vibration.
struct Pieces {
    piece: Box<Vibration>,
    sent: bool,
    sequence: u64,
}

impl Pieces {
    fn new() -> Self {
        Self {
            piece: Box::new(Vibration::new_zeroed()),
            sent: false,
            sequence: 0,
        }
    }

    /// Writes what all pieces have in common.
    fn describe(&mut self, rows: &VibrationRows) {
        self.piece.period_ns = rows.period_ns;
        self.piece.channel_count = rows.channels.len().min(CHANNELS_MAX) as u32;
        for (target, name) in self.piece.channels.iter_mut().zip(&rows.channels) {
            *target = label(name);
        }
    }

    /// Begins a new piece where the last one was sent.
    fn reopen(&mut self) {
        if self.sent {
            self.sent = false;
            self.sequence += 1;
            self.piece.count = 0;
        }
    }

    fn push(&mut self, instant: &Instant) {
        let piece = &mut self.piece;
        let index = piece.count as usize;
        if index == 0 {
            piece.start_ns = instant.taken_ns;
        }
        // A piece is never longer than `PIECE_NS`, which fits.
        piece.offset_ns[index] = (instant.taken_ns - piece.start_ns) as u32;
        for (channel, value) in piece.samples.iter_mut().zip(instant.values) {
            channel[index] = value;
        }
        piece.count += 1;
    }

    fn has_samples(&self) -> bool {
        self.piece.count > 0
    }

    fn is_full(&self) -> bool {
        self.piece.count as usize == SAMPLES_MAX
    }

    /// Ends the piece that began at one instant at another, with whatever is in it.
    fn close(&mut self, since_ns: u64, taken_ns: u64) -> &Vibration {
        let piece = &mut self.piece;
        if piece.count == 0 {
            piece.start_ns = since_ns;
        }
        let missing =
            (0..piece.channel_count as usize).any(|index| piece.channel(index).iter().any(|value| value.is_nan()));
        piece.header = Header {
            taken_ns,
            sequence: self.sequence,
            status: match (piece.count, missing) {
                (0, _) => Status::NO_DATA,
                (_, true) => Status::INCOMPLETE,
                (_, false) => Status::OK,
            },
            ..Header::default()
        };
        self.sent = true;
        piece
    }

    /// A piece that says that none follows.
    fn end(&mut self, header: Header) -> &Vibration {
        self.piece.header = header;
        self.piece.count = 0;
        &self.piece
    }
}

/// First and last instant of `frames.csv`.
fn span_ns(file: &str, input: Input) -> Result<(u64, u64), InputError> {
    let mut span_ns = None;
    for row in FrameRows::open(file, input)? {
        let taken_ns = row?.taken_ns;
        span_ns = Some((span_ns.map_or(taken_ns, |(first_ns, _)| first_ns), taken_ns));
    }
    span_ns.ok_or_else(|| InputError::new(file, 0, "there is no row"))
}

/// The first instant of all files, if they have one clock.
fn begin_ns(sensors: &[Sensor], frames: Option<(u64, String)>) -> Result<u64, InputError> {
    let first = |sensor: &Sensor| Some((sensor.next.as_ref()?.taken_ns(), sensor.file.clone()));
    let mut starts: Vec<(u64, String)> = sensors.iter().filter_map(first).chain(frames).collect();
    starts.sort();
    let (Some((begin_ns, earliest)), Some((latest_ns, latest))) = (starts.first(), starts.last()) else {
        return Ok(0);
    };
    let gap_s = (latest_ns - begin_ns) as f64 / 1e9;
    if gap_s > GAP_MAX_S {
        let what = format!("starts {gap_s:.0} s after {earliest}; all files of a traverse must have the same clock");
        return Err(InputError::new(latest, 0, what));
    }
    Ok(*begin_ns)
}
