//! Unix sockets: a stream a wire and reader, each message its length in four bytes and its fields as postcard writes them.

use crate::forms::{Picture, SinkageForm, SoilForm, TerrainForm, WheelForm};
use bench::Outcome;
use bench::compare::{
    Read, SinkageEnds, SourceEnds, TerrainEnds, TerramechanicsEnds, Transport, WAIT_MAX, Write, WriteFrames,
    write_frame,
};
use messages::{Frame, Header, Sinkage, Soil, Terrain, Wheel};
use serde::{Deserialize, Serialize};
use shell::{now_ns, sleep_until};
use std::io::{ErrorKind, Read as _, Write as _};
use std::marker::PhantomData;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use zerocopy::{FromZeros, IntoBytes};

/// Bytes of a message at the most, and of its length.
const MESSAGE_MAX: usize = 512 << 10;
const LENGTH_BYTES: usize = 4;
/// How long a process waits for the others to come [ns], and how often it looks.
const CONNECT_MAX_NS: u64 = 10_000_000_000;
const LOOK_NS: u64 = 1_000_000;

/// The folder in which the processes meet.
pub struct Sockets(pub PathBuf);

impl Sockets {
    fn path(&self, wire: &str, reader: &str) -> PathBuf {
        self.0.join(format!("{wire}-{reader}.socket"))
    }

    fn listen(&self, wire: &str, reader: &str) -> Outcome<UnixListener> {
        Ok(UnixListener::bind(self.path(wire, reader))?)
    }

    fn connect(&self, wire: &str, reader: &str) -> Outcome<UnixStream> {
        let last_ns = now_ns() + CONNECT_MAX_NS;
        loop {
            match UnixStream::connect(self.path(wire, reader)) {
                Ok(stream) => return Ok(stream),
                Err(error) if now_ns() > last_ns => return Err(error.into()),
                Err(_) => sleep_until(now_ns() + LOOK_NS),
            }
        }
    }

    fn writer<T: Coded + 'static>(&self, wire: &str, readers: &[&str]) -> Outcome<Box<dyn Write<T>>> {
        let streams = readers.iter().map(|reader| self.connect(wire, reader));
        Ok(Box::new(Writer {
            streams: streams.collect::<Result<_, _>>()?,
            buffer: vec![0; MESSAGE_MAX],
        }))
    }
}

impl Transport for Sockets {
    fn source(&self) -> Outcome<SourceEnds> {
        let terrain = self.listen("terrain", "source")?;
        Ok(SourceEnds {
            wheel: self.writer("wheel", &["terramechanics"])?,
            frames: Box::new(Pictures {
                stream: self.connect("frames", "sinkage")?,
                frame: Frame::new_box_zeroed().map_err(|_| "no memory for a picture")?,
                buffer: vec![0; MESSAGE_MAX],
            }),
            terrain: Reader::accept(&terrain)?,
        })
    }

    fn sinkage(&self) -> Outcome<SinkageEnds> {
        let frames = self.listen("frames", "sinkage")?;
        Ok(SinkageEnds {
            // First to whom it does not wake: the observation is there when the stage is triggered.
            sinkage: self.writer("sinkage", &["terrain", "terramechanics"])?,
            frames: Box::new(PictureReader {
                messages: Messages::accept(&frames)?,
                frame: Frame::new_box_zeroed().map_err(|_| "no memory for a picture")?,
            }),
        })
    }

    fn terramechanics(&self) -> Outcome<TerramechanicsEnds> {
        let sinkage = self.listen("sinkage", "terramechanics")?;
        let wheel = self.listen("wheel", "terramechanics")?;
        Ok(TerramechanicsEnds {
            soil: self.writer("soil", &["terrain"])?,
            sinkage: Reader::accept(&sinkage)?,
            wheel: Reader::accept(&wheel)?,
        })
    }

    fn terrain(&self) -> Outcome<TerrainEnds> {
        let soil = self.listen("soil", "terrain")?;
        let sinkage = self.listen("sinkage", "terrain")?;
        Ok(TerrainEnds {
            terrain: self.writer("terrain", &["source"])?,
            soil: Reader::accept(&soil)?,
            sinkage: Reader::accept(&sinkage)?,
        })
    }
}

/// A sample as postcard writes it.
pub trait Coded: Copy {
    /// Its bytes, at the beginning of `place`; how many.
    fn encode(&self, place: &mut [u8]) -> postcard::Result<usize>;
    /// The sample of these bytes.
    fn decode(bytes: &[u8]) -> postcard::Result<Self>;
}

impl Coded for Wheel {
    fn encode(&self, place: &mut [u8]) -> postcard::Result<usize> {
        #[derive(Serialize)]
        struct Coded<'a>(#[serde(with = "WheelForm")] &'a Wheel);
        Ok(postcard::to_slice(&Coded(self), place)?.len())
    }

    fn decode(bytes: &[u8]) -> postcard::Result<Self> {
        #[derive(Deserialize)]
        struct Coded(#[serde(with = "WheelForm")] Wheel);
        Ok(postcard::from_bytes::<Coded>(bytes)?.0)
    }
}

impl Coded for Sinkage {
    fn encode(&self, place: &mut [u8]) -> postcard::Result<usize> {
        #[derive(Serialize)]
        struct Coded<'a>(#[serde(with = "SinkageForm")] &'a Sinkage);
        Ok(postcard::to_slice(&Coded(self), place)?.len())
    }

    fn decode(bytes: &[u8]) -> postcard::Result<Self> {
        #[derive(Deserialize)]
        struct Coded(#[serde(with = "SinkageForm")] Sinkage);
        Ok(postcard::from_bytes::<Coded>(bytes)?.0)
    }
}

impl Coded for Soil {
    fn encode(&self, place: &mut [u8]) -> postcard::Result<usize> {
        #[derive(Serialize)]
        struct Coded<'a>(#[serde(with = "SoilForm")] &'a Soil);
        Ok(postcard::to_slice(&Coded(self), place)?.len())
    }

    fn decode(bytes: &[u8]) -> postcard::Result<Self> {
        #[derive(Deserialize)]
        struct Coded(#[serde(with = "SoilForm")] Soil);
        Ok(postcard::from_bytes::<Coded>(bytes)?.0)
    }
}

impl Coded for Terrain {
    fn encode(&self, place: &mut [u8]) -> postcard::Result<usize> {
        #[derive(Serialize)]
        struct Coded<'a>(#[serde(with = "TerrainForm")] &'a Terrain);
        Ok(postcard::to_slice(&Coded(self), place)?.len())
    }

    fn decode(bytes: &[u8]) -> postcard::Result<Self> {
        #[derive(Deserialize)]
        struct Coded(#[serde(with = "TerrainForm")] Terrain);
        Ok(postcard::from_bytes::<Coded>(bytes)?.0)
    }
}

/// Sends what `encode` writes, its length before it.
fn send(
    stream: &mut UnixStream,
    buffer: &mut [u8],
    encode: impl FnOnce(&mut [u8]) -> postcard::Result<usize>,
) -> Outcome<()> {
    let length = encode(&mut buffer[LENGTH_BYTES..])?;
    buffer[..LENGTH_BYTES].copy_from_slice(&u32::try_from(length)?.to_le_bytes());
    Ok(stream.write_all(&buffer[..LENGTH_BYTES + length])?)
}

struct Writer {
    streams: Vec<UnixStream>,
    buffer: Vec<u8>,
}

impl<T: Coded> Write<T> for Writer {
    fn send(&mut self, sample: &T) -> Outcome<()> {
        for stream in &mut self.streams {
            send(stream, &mut self.buffer, |place| sample.encode(place))?;
        }
        Ok(())
    }
}

struct Pictures {
    stream: UnixStream,
    /// The camera's own memory.
    frame: Box<Frame>,
    buffer: Vec<u8>,
}

impl WriteFrames for Pictures {
    fn send(&mut self, header: Header, picture: &[u8]) -> Outcome<u64> {
        let published_ns = write_frame(self.frame.as_mut_bytes(), header, picture);
        send(&mut self.stream, &mut self.buffer, |place| {
            Ok(postcard::to_slice(&Picture::of(&self.frame), place)?.len())
        })?;
        Ok(published_ns)
    }
}

/// What comes through a socket, message by message.
struct Messages {
    stream: UnixStream,
    waits: bool,
    buffer: Vec<u8>,
    filled: usize,
}

impl Messages {
    fn accept(listener: &UnixListener) -> Outcome<Self> {
        let (stream, _) = listener.accept()?;
        stream.set_read_timeout(Some(WAIT_MAX))?;
        Ok(Self {
            stream,
            waits: true,
            buffer: vec![0; MESSAGE_MAX],
            filled: 0,
        })
    }

    /// Hands the next message to `act`; `None` where there is none (yet).
    fn next<R>(&mut self, waits: bool, act: impl FnOnce(&[u8]) -> Outcome<R>) -> Outcome<Option<R>> {
        if self.waits != waits {
            self.stream.set_nonblocking(!waits)?;
            self.waits = waits;
        }
        while self.end().is_none_or(|end| end > self.filled) {
            match self.stream.read(&mut self.buffer[self.filled..]) {
                // Who only looks need not know that nothing more will come.
                Ok(0) if !waits => return Ok(None),
                Ok(0) => return Err("the other end has gone".into()),
                Ok(count) => self.filled += count,
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => return Ok(None),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
        let end = self.end().ok_or("a message without length")?;
        let result = act(&self.buffer[LENGTH_BYTES..end])?;
        self.buffer.copy_within(end..self.filled, 0);
        self.filled -= end;
        Ok(Some(result))
    }

    /// Where the message ends that is read, once its length is there.
    fn end(&self) -> Option<usize> {
        let (length, _) = self.buffer[..self.filled].split_first_chunk()?;
        Some(LENGTH_BYTES + u32::from_le_bytes(*length) as usize)
    }
}

struct Reader<T> {
    messages: Messages,
    samples: PhantomData<T>,
}

impl<T: Coded + 'static> Reader<T> {
    fn accept(listener: &UnixListener) -> Outcome<Box<dyn Read<T>>> {
        let messages = Messages::accept(listener)?;
        let samples = PhantomData;
        Ok(Box::new(Self { messages, samples }))
    }
}

impl<T: Coded> Read<T> for Reader<T> {
    fn each(&mut self, act: &mut dyn FnMut(Option<&T>) -> Outcome<bool>) -> Outcome<()> {
        loop {
            let goes_on = match self.messages.next(true, |bytes| act(Some(&T::decode(bytes)?)))? {
                Some(goes_on) => goes_on,
                None => act(None)?,
            };
            if !goes_on {
                return Ok(());
            }
        }
    }

    fn poll(&mut self, act: &mut dyn FnMut(&T)) -> Outcome<bool> {
        let decoded = self.messages.next(false, |bytes| {
            act(&T::decode(bytes)?);
            Ok(())
        });
        Ok(decoded?.is_some())
    }
}

struct PictureReader {
    messages: Messages,
    frame: Box<Frame>,
}

impl Read<Frame> for PictureReader {
    fn each(&mut self, act: &mut dyn FnMut(Option<&Frame>) -> Outcome<bool>) -> Outcome<()> {
        let Self { messages, frame } = self;
        loop {
            let goes_on = messages.next(true, |bytes| {
                postcard::from_bytes::<Picture>(bytes)?.unpack(frame);
                act(Some(frame))
            })?;
            if !goes_on.map_or_else(|| act(None), Ok)? {
                return Ok(());
            }
        }
    }

    fn poll(&mut self, _: &mut dyn FnMut(&Frame)) -> Outcome<bool> {
        Err("pictures are waited for".into())
    }
}
