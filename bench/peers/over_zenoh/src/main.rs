//! One process of the estimation cycle over zenoh: pictures in its shared memory, everything else as bytes. The peers know
//! each other by Unix sockets in the folder of the run, so that nothing is looked for on a network.

use bench::Outcome;
use bench::compare::{
    Part, Read, Role, SinkageEnds, SourceEnds, TerrainEnds, TerramechanicsEnds, Transport, WAIT_MAX, Write,
    WriteFrames, play, write_frame,
};
use clap::Parser;
use messages::{Frame, Header, Message};
use std::marker::PhantomData;
use std::process::ExitCode;
use zenoh::handlers::FifoChannelHandler;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::sample::Sample;
use zenoh::shm::{AllocAlignment, BlockOn, GarbageCollect, PosixShmProviderBackend, ShmProvider, ShmProviderBuilder};
use zenoh::{Config, Session, Wait};

/// Frames that the shared memory has room for.
const FRAMES_MAX: usize = 16;

#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    part: Part,
}

fn main() -> ExitCode {
    let part = Arguments::parse().part;
    match run(&part) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("over_zenoh, {}: {error}", part.role.name());
            ExitCode::FAILURE
        }
    }
}

fn run(part: &Part) -> Outcome<()> {
    // Before zenoh starts its threads.
    part.settle()?;
    let config = Config::from_json5(&config(part)).map_err(boxed)?;
    play(part, &Zenoh(zenoh::open(config).wait().map_err(boxed)?))
}

/// Each process listens, and calls those before it.
fn config(part: &Part) -> String {
    const ROLES: [Role; 4] = [Role::Source, Role::Sinkage, Role::Terramechanics, Role::Terrain];
    let endpoint = |role: &Role| {
        let path = part.folder.join(format!("{}.zenoh", role.name()));
        format!("\"unixsock-stream/{}\"", path.display())
    };
    let before: Vec<String> = ROLES
        .iter()
        .take_while(|role| **role != part.role)
        .map(endpoint)
        .collect();
    format!(
        "{{ mode: \"peer\", listen: {{ endpoints: [{}] }}, connect: {{ endpoints: [{}], retry: {{ period_init_ms: 50, \
         period_max_ms: 200 }} }}, scouting: {{ multicast: {{ enabled: false }}, gossip: {{ enabled: false }} }}, \
         transport: {{ shared_memory: {{ enabled: true, mode: \"init\" }} }} }}",
        endpoint(&part.role),
        before.join(", ")
    )
}

fn boxed(error: zenoh::Error) -> Box<dyn std::error::Error> {
    error.to_string().into()
}

struct Zenoh(Session);

impl Zenoh {
    fn publisher(&self, wire: &'static str) -> Outcome<Publisher<'static>> {
        let builder = self.0.declare_publisher(wire);
        // Nothing is dropped, and nothing waits to be sent together with more.
        let builder = builder.congestion_control(CongestionControl::Block).express(true);
        builder.wait().map_err(boxed)
    }

    fn writer<T: Message>(&self, wire: &'static str) -> Outcome<Box<dyn Write<T>>> {
        Ok(Box::new(Writer(self.publisher(wire)?)))
    }

    fn reader<T: Message>(&self, wire: &'static str) -> Outcome<Box<dyn Read<T>>> {
        Ok(Box::new(Reader {
            subscriber: self.0.declare_subscriber(wire).wait().map_err(boxed)?,
            samples: PhantomData,
        }))
    }
}

impl Transport for Zenoh {
    fn source(&self) -> Outcome<SourceEnds> {
        let layout = (FRAMES_MAX * size_of::<Frame>(), AllocAlignment::for_type::<Frame>());
        let backend = PosixShmProviderBackend::builder(layout);
        let memory = ShmProviderBuilder::backend(backend.wait().map_err(|error| error.to_string())?).wait();
        Ok(SourceEnds {
            wheel: self.writer("wheel")?,
            frames: Box::new(Pictures {
                publisher: self.publisher("frames")?,
                memory,
            }),
            terrain: self.reader("terrain")?,
        })
    }

    fn sinkage(&self) -> Outcome<SinkageEnds> {
        Ok(SinkageEnds {
            frames: self.reader("frames")?,
            sinkage: self.writer("sinkage")?,
        })
    }

    fn terramechanics(&self) -> Outcome<TerramechanicsEnds> {
        Ok(TerramechanicsEnds {
            sinkage: self.reader("sinkage")?,
            wheel: self.reader("wheel")?,
            soil: self.writer("soil")?,
        })
    }

    fn terrain(&self) -> Outcome<TerrainEnds> {
        Ok(TerrainEnds {
            soil: self.reader("soil")?,
            sinkage: self.reader("sinkage")?,
            terrain: self.writer("terrain")?,
        })
    }
}

struct Writer(Publisher<'static>);

impl<T: Message> Write<T> for Writer {
    fn send(&mut self, sample: &T) -> Outcome<()> {
        self.0.put(sample.as_bytes()).wait().map_err(boxed)
    }
}

struct Pictures {
    publisher: Publisher<'static>,
    memory: ShmProvider<PosixShmProviderBackend>,
}

impl WriteFrames for Pictures {
    fn send(&mut self, header: Header, picture: &[u8]) -> Outcome<u64> {
        let layout = (size_of::<Frame>(), AllocAlignment::for_type::<Frame>());
        let place = self.memory.alloc(layout).with_policy::<BlockOn<GarbageCollect>>();
        let mut place = place.wait().map_err(|error| format!("no shared memory: {error:?}"))?;
        let published_ns = write_frame(&mut place, header, picture);
        self.publisher.put(place).wait().map_err(boxed)?;
        Ok(published_ns)
    }
}

struct Reader<T> {
    subscriber: Subscriber<FifoChannelHandler<Sample>>,
    samples: PhantomData<T>,
}

/// Hands over the sample of these bytes: in the shared memory itself where it lies there, and a picture must.
fn hand<T: Message, R>(sample: &Sample, act: impl FnOnce(&T) -> R) -> Outcome<R> {
    let odd = "a sample of another size";
    match sample.payload().as_shm() {
        Some(bytes) => Ok(act(T::ref_from_bytes(bytes).map_err(|_| odd)?)),
        None if size_of::<T>() > 4096 => Err("a picture did not come through shared memory".into()),
        None => Ok(act(&T::read_from_bytes(&sample.payload().to_bytes()).map_err(|_| odd)?)),
    }
}

impl<T: Message> Read<T> for Reader<T> {
    fn each(&mut self, act: &mut dyn FnMut(Option<&T>) -> Outcome<bool>) -> Outcome<()> {
        loop {
            let goes_on = match self.subscriber.recv_timeout(WAIT_MAX).map_err(boxed)? {
                Some(sample) => hand(&sample, |sample| act(Some(sample)))??,
                None => act(None)?,
            };
            if !goes_on {
                return Ok(());
            }
        }
    }

    fn poll(&mut self, act: &mut dyn FnMut(&T)) -> Outcome<bool> {
        match self.subscriber.try_recv().map_err(boxed)? {
            Some(sample) => hand(&sample, act).map(|()| true),
            None => Ok(false),
        }
    }
}
