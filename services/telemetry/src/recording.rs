//! A recorded traverse as one stream of samples in the order of their instants, without gaps.

use crate::sinkage::SinkageRows;
use crate::vibration::{Instant, VibrationRows};
use crate::wheel::{self, WheelRows};
use crate::{Event, PIECE_NS};
use messages::{CHANNELS_MAX, Header, SAMPLES_MAX, Sinkage, Status, Vibration, Wheel, label};
use traverse::{FrameRows, GAP_MAX_S, Input, InputError, Traverse};
use zerocopy::FromZeros;

/// The wires, in the order in which samples of one instant are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wire {
    Wheel,
    Sinkage,
    Vibration,
}

const WIRES: [Wire; 3] = [Wire::Wheel, Wire::Sinkage, Wire::Vibration];

/// Longest silence of each wire; then a sample says that there were no data. Readers wait for observations by these,
/// so that a sensor's pause does not stop them. Sinkage is no one's observation but a trigger, and its gaps stay.
const SILENCE_MAX_NS: [u64; 3] = [100_000_000, u64::MAX, PIECE_NS];
/// Samples of other wires, at the most, between two samples of one.
const RUN_MAX: u32 = 255;

/// The open files of a traverse folder; those that are `None` are not there.
#[derive(Default)]
pub struct Files {
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

/// A recorded traverse, file by file open, read as it is asked for.
pub struct Recording {
    wheel: Option<Ahead<WheelRows, Wheel>>,
    sinkage: Option<Ahead<SinkageRows, Sinkage>>,
    vibration: Option<Ahead<VibrationRows, Instant>>,
    pieces: Pieces,
    pulses: [Pulse; 3],
    now_ns: u64,
    end_ns: u64,
}

/// How long a wire has been silent.
#[derive(Clone, Copy, Debug)]
struct Pulse {
    last_ns: u64,
    /// Samples of the other wires since.
    others: u32,
}

impl Recording {
    /// Reads the headers and the first rows. `folder` is only for errors.
    ///
    /// # Errors
    /// Where a file is not what it must be, or its clock is another one than the other files'.
    pub fn new(folder: &str, traverse: &Traverse, files: Files) -> Result<Self, InputError> {
        let path = |name: &str| format!("{folder}/{name}");
        if files.vibration.is_some() && files.sound.is_some() {
            let what = "there is also a vibration.csv; keep one of the two";
            return Err(InputError::new(&path("vibration.wav"), 0, what));
        }
        let frames = files
            .frames
            .map(|input| span_ns(&path("frames.csv"), input))
            .transpose()?;
        let wheel = files.wheel.map(|input| WheelRows::open(&path("wheel.csv"), input));
        let wheel = Ahead::new(wheel.transpose()?, WheelRows::next_row)?;
        let sinkage = files
            .sinkage
            .map(|input| SinkageRows::open(&path("sinkage.csv"), input, traverse));
        let sinkage = Ahead::new(sinkage.transpose()?, SinkageRows::next_row)?;
        let vibration = match (files.vibration, files.sound) {
            (Some(input), _) => Some(VibrationRows::open_table(&path("vibration.csv"), input)?),
            (None, Some(input)) => Some(VibrationRows::open_sound(&path("vibration.wav"), input, traverse)?),
            (None, None) => None,
        };
        let pieces = Pieces::new(vibration.as_ref());
        let vibration = Ahead::new(vibration, VibrationRows::next_row)?;
        let starts = [
            ("frames.csv", frames.map(|(first_ns, _)| first_ns)),
            (
                "wheel.csv",
                wheel.as_ref().and_then(|rows| rows.next.map(|row| row.header.taken_ns)),
            ),
            (
                "sinkage.csv",
                sinkage
                    .as_ref()
                    .and_then(|rows| rows.next.map(|row| row.header.taken_ns)),
            ),
            (
                "vibration",
                vibration.as_ref().and_then(|rows| rows.next.map(|row| row.taken_ns)),
            ),
        ];
        let begin_ns = begin_ns(folder, &starts)?;
        Ok(Self {
            wheel,
            sinkage,
            vibration,
            pieces,
            pulses: [Pulse {
                last_ns: begin_ns,
                others: 0,
            }; 3],
            now_ns: begin_ns,
            end_ns: frames.map_or(begin_ns, |(_, last_ns)| last_ns),
        })
    }

    /// The next sample of any wire; `None` at the end of the traverse, which is the last instant of any file.
    ///
    /// # Errors
    /// Where a row is not what it must be.
    pub fn next_event(&mut self) -> Result<Option<Event<'_>>, InputError> {
        self.pieces.reopen();
        let event = loop {
            let head = self.earliest();
            let until_ns = head.map_or(self.end_ns.max(self.now_ns), |(taken_ns, _)| taken_ns);
            if let Some((due_ns, wire)) = self.overdue(until_ns) {
                break Some((due_ns, wire, None));
            }
            self.now_ns = until_ns;
            match head {
                Some((taken_ns, Wire::Vibration)) => {
                    // A sample fills the piece; only a full piece is sent.
                    if let Some(instant) = take(&mut self.vibration)? {
                        self.pieces.push(&instant);
                    }
                    if self.pieces.is_full() {
                        break Some((taken_ns, Wire::Vibration, None));
                    }
                }
                Some((taken_ns, Wire::Wheel)) => {
                    let row = take(&mut self.wheel)?.map(Event::Wheel);
                    break Some((taken_ns, Wire::Wheel, row));
                }
                Some((taken_ns, Wire::Sinkage)) => {
                    let row = take(&mut self.sinkage)?.map(Event::Sinkage);
                    break Some((taken_ns, Wire::Sinkage, row));
                }
                None if self.pieces.has_samples() => break Some((until_ns, Wire::Vibration, None)),
                None => break None,
            }
        };
        Ok(event.map(|(taken_ns, wire, row)| self.send(taken_ns, wire, row)))
    }

    /// The row that comes next, over all files.
    fn earliest(&self) -> Option<(u64, Wire)> {
        let heads = [
            self.wheel
                .as_ref()
                .and_then(|rows| rows.next.map(|row| row.header.taken_ns)),
            self.sinkage
                .as_ref()
                .and_then(|rows| rows.next.map(|row| row.header.taken_ns)),
            self.vibration
                .as_ref()
                .and_then(|rows| rows.next.map(|row| row.taken_ns)),
        ];
        let heads = heads
            .into_iter()
            .zip(WIRES)
            .filter_map(|(head, wire)| Some((head?, wire)));
        heads.min_by_key(|(taken_ns, _)| *taken_ns)
    }

    /// The wire that must send something before the instant, and when.
    fn overdue(&self, until_ns: u64) -> Option<(u64, Wire)> {
        let has_file = [self.wheel.is_some(), self.sinkage.is_some(), self.vibration.is_some()];
        let due = |wire: Wire| {
            let pulse = self.pulses[wire as usize];
            let silent_ns = pulse.last_ns.saturating_add(SILENCE_MAX_NS[wire as usize]);
            // The piece up to an instant leaves before the sample of that instant: that one begins the next piece.
            let silent = silent_ns < until_ns || (silent_ns == until_ns && wire == Wire::Vibration);
            match (has_file[wire as usize], silent) {
                (false, _) => None,
                (true, true) => Some((silent_ns, wire)),
                (true, false) => (pulse.others >= RUN_MAX).then_some((self.now_ns, wire)),
            }
        };
        WIRES.into_iter().filter_map(due).min_by_key(|(due_ns, _)| *due_ns)
    }

    /// Makes the event of a row, of a full piece or of a silence, and notes that the wire has spoken.
    fn send(&mut self, taken_ns: u64, wire: Wire, row: Option<Event<'static>>) -> Event<'_> {
        for pulse in &mut self.pulses {
            pulse.others = pulse.others.saturating_add(1);
        }
        let pulse = Pulse {
            last_ns: taken_ns,
            others: 0,
        };
        let since_ns = std::mem::replace(&mut self.pulses[wire as usize], pulse).last_ns;
        self.now_ns = taken_ns;
        // The number of a silence is that of the row that it waits for.
        let silence = |rows: Option<u64>| Header {
            taken_ns,
            sequence: rows.unwrap_or(0),
            status: Status::NO_DATA,
            ..Header::default()
        };
        match (row, wire) {
            (Some(event), _) => event,
            (None, Wire::Wheel) => Event::Wheel(wheel::silent(silence(self.wheel.as_ref().map(|rows| rows.taken)))),
            (None, Wire::Sinkage) => {
                Event::Sinkage(Sinkage::unknown(silence(self.sinkage.as_ref().map(|rows| rows.taken))))
            }
            (None, Wire::Vibration) => Event::Vibration(self.pieces.close(since_ns, taken_ns)),
        }
    }
}

/// The rows of a file, one of them read ahead.
struct Ahead<R, T> {
    rows: R,
    read: fn(&mut R) -> Result<Option<T>, InputError>,
    next: Option<T>,
    /// Rows taken so far.
    taken: u64,
}

impl<R, T> Ahead<R, T> {
    fn new(rows: Option<R>, read: fn(&mut R) -> Result<Option<T>, InputError>) -> Result<Option<Self>, InputError> {
        let Some(mut rows) = rows else { return Ok(None) };
        let next = read(&mut rows)?;
        Ok(Some(Self {
            rows,
            read,
            next,
            taken: 0,
        }))
    }
}

/// Takes the row that was read ahead, and reads the one after it.
fn take<R, T>(ahead: &mut Option<Ahead<R, T>>) -> Result<Option<T>, InputError> {
    let Some(ahead) = ahead else { return Ok(None) };
    ahead.taken += 1;
    let next = (ahead.read)(&mut ahead.rows)?;
    Ok(std::mem::replace(&mut ahead.next, next))
}

/// Collects instants into pieces of vibration.
struct Pieces {
    piece: Box<Vibration>,
    sent: bool,
    sequence: u64,
}

impl Pieces {
    fn new(rows: Option<&VibrationRows>) -> Self {
        let mut piece = Box::new(Vibration::new_zeroed());
        if let Some(rows) = rows {
            piece.period_ns = rows.period_ns;
            piece.channel_count = rows.channels.len().min(CHANNELS_MAX) as u32;
            for (target, name) in piece.channels.iter_mut().zip(&rows.channels) {
                *target = label(name);
            }
        }
        Self {
            piece,
            sent: false,
            sequence: 0,
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

/// The first instant of all, if all files have one clock.
fn begin_ns(folder: &str, starts: &[(&str, Option<u64>)]) -> Result<u64, InputError> {
    let known = starts.iter().filter_map(|(name, start_ns)| Some((*name, (*start_ns)?)));
    let Some((first, begin_ns)) = known.clone().min_by_key(|(_, start_ns)| *start_ns) else {
        return Ok(0);
    };
    for (name, start_ns) in known {
        let gap_s = (start_ns - begin_ns) as f64 / 1e9;
        if gap_s > GAP_MAX_S {
            let what = format!("starts {gap_s:.0} s after {first}; all files of a traverse must have the same clock");
            return Err(InputError::new(&format!("{folder}/{name}"), 0, what));
        }
    }
    Ok(begin_ns)
}
