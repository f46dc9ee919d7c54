//! The parts of the estimation cycle behind dora's Python nodes: `play(node, words)` waits by `node.next` and sends by
//! `node.send_output`, and calls the stage lib in between.

use bench::Outcome;
use bench::compare::{
    FRAME_BYTES, Part, Read, SinkageEnds, SourceEnds, TerrainEnds, TerramechanicsEnds, Transport, WAIT_MAX, Write,
    WriteFrames, play, write_frame,
};
use clap::Parser;
use messages::{Header, Message};
use pyo3::buffer::PyBuffer;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use zerocopy::FromBytes;

/// How long a look for an event takes at the most [s]: the node has no way to look without waiting.
const LOOK_S: f64 = 0.001;

#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    part: Part,
}

/// The Python module.
#[pymodule]
mod over_dora {
    #[pymodule_export]
    use super::play_node;
}

/// Plays a node's part until the source has sent its last cycle. `words` are the command line.
#[pyfunction]
#[pyo3(name = "play")]
fn play_node(node: Py<PyAny>, words: Vec<String>) -> PyResult<()> {
    let failed = |error: &dyn std::fmt::Display| PyRuntimeError::new_err(error.to_string());
    let part = Arguments::try_parse_from(words).map_err(|error| failed(&error))?.part;
    let stream = Stream {
        node,
        waiting: VecDeque::new(),
    };
    play(&part, &Dora(Rc::new(RefCell::new(stream)))).map_err(|error| failed(&error))
}

/// What comes to a node: one stream for all its inputs.
struct Stream {
    node: Py<PyAny>,
    /// What came for another input than the one that was waited for.
    waiting: VecDeque<(String, Vec<u8>)>,
}

impl Stream {
    /// The next sample of any input: its input, and how long it is in `place`.
    fn next(&self, wait_s: f64, place: &mut [u8]) -> Outcome<Option<(String, usize)>> {
        Python::attach(|python| {
            let event = self.node.bind(python).call_method1("next", (wait_s,))?;
            if event.is_none() {
                return Err("the other nodes have gone".into());
            }
            // A time-out is an error of dora's.
            if event.get_item("type")?.extract::<String>()? != "INPUT" {
                return Ok(None);
            }
            let bytes = event.get_item("value")?.call_method0("buffers")?.get_item(1)?;
            // Arrow says that its bytes have a sign.
            let bytes = PyBuffer::<i8>::get(&bytes)?;
            let length = bytes.len_bytes();
            let place = place.get_mut(..length).ok_or("a sample that is too long")?;
            let place = <[i8]>::mut_from_bytes(place).map_err(|_| "no bytes")?;
            bytes.copy_to_slice(python, place)?;
            Ok(Some((event.get_item("id")?.extract()?, length)))
        })
    }

    fn send(&self, wire: &str, bytes: Bound<'_, PyBytes>) -> Outcome<()> {
        self.node.bind(bytes.py()).call_method1("send_output", (wire, &bytes))?;
        Ok(())
    }
}

struct Dora(Rc<RefCell<Stream>>);

impl Dora {
    fn writer<T: Message>(&self, wire: &'static str) -> Box<dyn Write<T>> {
        Box::new(Writer {
            stream: self.0.clone(),
            wire,
        })
    }

    fn reader<T: Message>(&self, wire: &'static str, looks: bool) -> Outcome<Box<dyn Read<T>>> {
        Ok(Box::new(Reader {
            stream: self.0.clone(),
            wire,
            looks,
            place: T::new_box_zeroed().map_err(|_| "no memory for a sample")?,
        }))
    }
}

impl Transport for Dora {
    fn source(&self) -> Outcome<SourceEnds> {
        Ok(SourceEnds {
            wheel: self.writer("wheel"),
            frames: Box::new(Pictures(self.0.clone())),
            terrain: self.reader("terrain", true)?,
        })
    }

    fn sinkage(&self) -> Outcome<SinkageEnds> {
        Ok(SinkageEnds {
            frames: self.reader("frames", false)?,
            sinkage: self.writer("sinkage"),
        })
    }

    fn terramechanics(&self) -> Outcome<TerramechanicsEnds> {
        Ok(TerramechanicsEnds {
            sinkage: self.reader("sinkage", false)?,
            wheel: self.reader("wheel", false)?,
            soil: self.writer("soil"),
        })
    }

    fn terrain(&self) -> Outcome<TerrainEnds> {
        Ok(TerrainEnds {
            soil: self.reader("soil", false)?,
            sinkage: self.reader("sinkage", false)?,
            terrain: self.writer("terrain"),
        })
    }
}

struct Writer {
    stream: Rc<RefCell<Stream>>,
    wire: &'static str,
}

impl<T: Message> Write<T> for Writer {
    fn send(&mut self, sample: &T) -> Outcome<()> {
        Python::attach(|python| {
            let bytes = PyBytes::new(python, sample.as_bytes());
            self.stream.borrow().send(self.wire, bytes)
        })
    }
}

struct Pictures(Rc<RefCell<Stream>>);

impl WriteFrames for Pictures {
    fn send(&mut self, header: Header, picture: &[u8]) -> Outcome<u64> {
        Python::attach(|python| {
            let mut published_ns = 0;
            let bytes = PyBytes::new_with(python, FRAME_BYTES, |place| {
                published_ns = write_frame(place, header, picture);
                Ok(())
            })?;
            self.0.borrow().send("frames", bytes)?;
            Ok(published_ns)
        })
    }
}

struct Reader<T> {
    stream: Rc<RefCell<Stream>>,
    wire: &'static str,
    /// Whether `poll` looks for what has come, and not only at what has come already while something else was waited for.
    looks: bool,
    place: Box<T>,
}

impl<T: Message> Reader<T> {
    /// Puts the next sample of this wire into `place`, if one comes.
    fn take(&mut self, wait_s: Option<f64>) -> Outcome<bool> {
        let mut stream = self.stream.borrow_mut();
        if let Some(index) = stream.waiting.iter().position(|(wire, _)| wire == self.wire) {
            let bytes = stream.waiting.remove(index).map(|(_, bytes)| bytes).unwrap_or_default();
            *self.place = T::read_from_bytes(&bytes).map_err(|_| "a sample of another size")?;
            return Ok(true);
        }
        let Some(wait_s) = wait_s else { return Ok(false) };
        if size_of::<T>() > SMALL_MAX {
            // The only input of its node.
            return Ok(stream.next(wait_s, self.place.as_mut_bytes())?.is_some());
        }
        let mut place = [0; SMALL_MAX];
        let Some((wire, length)) = stream.next(wait_s, &mut place)? else {
            return Ok(false);
        };
        stream.waiting.push_back((wire, place[..length].to_vec()));
        Ok(false)
    }
}

/// Bytes of any sample but a picture.
const SMALL_MAX: usize = 1024;

impl<T: Message> Read<T> for Reader<T> {
    fn each(&mut self, act: &mut dyn FnMut(Option<&T>) -> Outcome<bool>) -> Outcome<()> {
        loop {
            let there = self.take(None)? || self.take(Some(WAIT_MAX.as_secs_f64()))? || self.take(None)?;
            let sample = there.then_some(&*self.place);
            if !act(sample)? {
                return Ok(());
            }
        }
    }

    fn poll(&mut self, act: &mut dyn FnMut(&T)) -> Outcome<bool> {
        let wait_s = self.looks.then_some(LOOK_S);
        let there = self.take(None)? || self.take(wait_s)? || self.take(None)?;
        if there {
            act(&self.place);
        }
        Ok(there)
    }
}
