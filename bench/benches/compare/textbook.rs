//! Plain iceoryx2 as its examples show it: a publish-subscribe service and an event service of the same name, the listener
//! attached to a `WaitSet`.

use bench::Outcome;
use bench::compare::{
    Read, SinkageEnds, SourceEnds, TerrainEnds, TerramechanicsEnds, Transport, WAIT_MAX, Write, WriteFrames,
    write_frame,
};
use iceoryx2::node::Node;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::{
    Alignment, CallbackProgression, Config, FileName, NodeBuilder, SemanticString, ServiceName, WaitSetBuilder, ipc,
};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use iceoryx2::waitset::WaitSetRunResult;
use messages::{Frame, Header, Message};
use shell::SystemFile;
use std::marker::PhantomData;
use zerocopy::FromBytes;

/// Frames and other samples that wait for a slow reader.
const FRAMES_MAX: usize = 8;
const SAMPLES_MAX: usize = 64;

/// This process's node.
pub struct Textbook(Node<ipc::Service>);

impl Textbook {
    /// Enters the shared memory of a run.
    pub fn enter(system: &SystemFile) -> Outcome<Self> {
        let mut config = Config::default();
        config
            .global
            .set_root_path(&iceoryx2::prelude::Path::new(system.root().as_bytes())?);
        config.global.prefix = FileName::new(system.prefix().as_bytes())?;
        Ok(Self(NodeBuilder::new().config(&config).create::<ipc::Service>()?))
    }

    fn notifier(&self, wire: &str) -> Outcome<Notifier<ipc::Service>> {
        let event = self.0.service_builder(&ServiceName::new(wire)?).event();
        Ok(event.open_or_create()?.notifier_builder().create()?)
    }

    fn listener(&self, wire: &str) -> Outcome<Listener<ipc::Service>> {
        let event = self.0.service_builder(&ServiceName::new(wire)?).event();
        Ok(event.open_or_create()?.listener_builder().create()?)
    }

    fn writer<T: Message + Copy>(&self, wire: &str, rings: bool) -> Outcome<Box<dyn Write<T>>> {
        let service = self
            .0
            .service_builder(&ServiceName::new(wire)?)
            .publish_subscribe::<T>()
            .subscriber_max_buffer_size(SAMPLES_MAX)
            .open_or_create()?;
        Ok(Box::new(Writer {
            publisher: service.publisher_builder().create()?,
            notifier: rings.then(|| self.notifier(wire)).transpose()?,
        }))
    }

    /// Pictures, of as many bytes as a frame.
    fn frames(&self) -> Outcome<PortFactory<ipc::Service, [u8], ()>> {
        Ok(self
            .0
            .service_builder(&ServiceName::new("frames")?)
            .publish_subscribe::<[u8]>()
            .payload_alignment(Alignment::new(align_of::<Frame>()).ok_or("no alignment")?)
            .subscriber_max_buffer_size(FRAMES_MAX)
            .open_or_create()?)
    }

    fn reader<T: Message>(&self, wire: &str, waits: bool) -> Outcome<Box<dyn Read<T>>> {
        let service = self
            .0
            .service_builder(&ServiceName::new(wire)?)
            .publish_subscribe::<T>()
            .subscriber_max_buffer_size(SAMPLES_MAX)
            .open_or_create()?;
        let subscriber = service.subscriber_builder().create()?;
        let receive = move |act: &mut dyn FnMut(&T) -> Outcome<bool>| {
            subscriber.receive()?.map(|sample| act(sample.payload())).transpose()
        };
        self.reader_of(wire, waits, receive)
    }

    /// A reader of whatever `receive` receives.
    fn reader_of<T: Message>(
        &self,
        wire: &str,
        waits: bool,
        receive: impl Fn(&mut dyn FnMut(&T) -> Outcome<bool>) -> Outcome<Option<bool>> + 'static,
    ) -> Outcome<Box<dyn Read<T>>> {
        Ok(Box::new(Reader {
            receive,
            listener: waits.then(|| self.listener(wire)).transpose()?,
            samples: PhantomData,
        }))
    }
}

impl Transport for Textbook {
    fn source(&self) -> Outcome<SourceEnds> {
        let publisher = self
            .frames()?
            .publisher_builder()
            .initial_max_slice_len(size_of::<Frame>())
            .create()?;
        Ok(SourceEnds {
            wheel: self.writer("wheel", false)?,
            frames: Box::new(Pictures {
                publisher,
                notifier: self.notifier("frames")?,
            }),
            terrain: self.reader("terrain", true)?,
        })
    }

    fn sinkage(&self) -> Outcome<SinkageEnds> {
        let subscriber = self.frames()?.subscriber_builder().create()?;
        let receive = move |act: &mut dyn FnMut(&Frame) -> Outcome<bool>| {
            let Some(sample) = subscriber.receive()? else {
                return Ok(None);
            };
            let frame = Frame::ref_from_bytes(sample.payload()).map_err(|_| "a picture of another size")?;
            act(frame).map(Some)
        };
        Ok(SinkageEnds {
            frames: self.reader_of("frames", true, receive)?,
            sinkage: self.writer("sinkage", true)?,
        })
    }

    fn terramechanics(&self) -> Outcome<TerramechanicsEnds> {
        Ok(TerramechanicsEnds {
            sinkage: self.reader("sinkage", true)?,
            wheel: self.reader("wheel", false)?,
            soil: self.writer("soil", true)?,
        })
    }

    fn terrain(&self) -> Outcome<TerrainEnds> {
        Ok(TerrainEnds {
            soil: self.reader("soil", true)?,
            sinkage: self.reader("sinkage", false)?,
            terrain: self.writer("terrain", true)?,
        })
    }
}

struct Writer<T: Message + Copy> {
    publisher: Publisher<ipc::Service, T, ()>,
    notifier: Option<Notifier<ipc::Service>>,
}

impl<T: Message + Copy> Write<T> for Writer<T> {
    fn send(&mut self, sample: &T) -> Outcome<()> {
        self.publisher.loan_uninit()?.write_payload(*sample).send()?;
        self.notifier.as_ref().map(Notifier::notify).transpose()?;
        Ok(())
    }
}

/// A picture is bytes: a type of a megabyte could be written in place with unsafe code only.
struct Pictures {
    publisher: Publisher<ipc::Service, [u8], ()>,
    notifier: Notifier<ipc::Service>,
}

impl WriteFrames for Pictures {
    fn send(&mut self, header: Header, picture: &[u8]) -> Outcome<u64> {
        let mut sample = self.publisher.loan_slice(size_of::<Frame>())?;
        let published_ns = write_frame(sample.payload_mut(), header, picture);
        sample.send()?;
        self.notifier.notify()?;
        Ok(published_ns)
    }
}

struct Reader<T, F> {
    receive: F,
    /// What is waited for; none on a wire that is only observed.
    listener: Option<Listener<ipc::Service>>,
    samples: PhantomData<T>,
}

impl<T, F> Read<T> for Reader<T, F>
where
    F: Fn(&mut dyn FnMut(&T) -> Outcome<bool>) -> Outcome<Option<bool>>,
{
    fn each(&mut self, act: &mut dyn FnMut(Option<&T>) -> Outcome<bool>) -> Outcome<()> {
        let listener = self.listener.as_ref().ok_or("nobody rings for this wire")?;
        let waitset = WaitSetBuilder::new().create::<ipc::Service>()?;
        let guard = waitset.attach_notification(listener)?;
        loop {
            let (mut outcome, mut rang) = (Ok(true), false);
            let result = waitset.wait_and_process_once_with_timeout(
                |id| {
                    if id.has_event_from(&guard) {
                        rang = true;
                        outcome = listener.try_wait(|_| ()).map_err(Into::into).and_then(|_| {
                            while let Some(goes_on) = (self.receive)(&mut |sample| act(Some(sample)))? {
                                if !goes_on {
                                    return Ok(false);
                                }
                            }
                            Ok(true)
                        });
                    }
                    CallbackProgression::Continue
                },
                WAIT_MAX,
            )?;
            if !rang {
                outcome = act(None);
            }
            let told = matches!(
                result,
                WaitSetRunResult::TerminationRequest | WaitSetRunResult::Interrupt
            );
            if told || !outcome? {
                return Ok(());
            }
        }
    }

    fn poll(&mut self, act: &mut dyn FnMut(&T)) -> Outcome<bool> {
        let mut act = |sample: &T| {
            act(sample);
            Ok(true)
        };
        Ok((self.receive)(&mut act)?.is_some())
    }
}
