//! A system's wires: each a publish-subscribe service for the samples and an event service of the same name that rings.
//!
//! The launcher creates the wires and holds them; services only open them, and insist on the layout's fingerprint.
//! (A process that is killed while it creates a service would leave it unusable for good.)

use crate::bell::{Bell, EventService, RING};
use crate::journal::Journal;
use crate::{Error, Mode, Output, SystemFile, Tap, Termination};
use iceoryx2::node::{Node, NodeState, NodeView};
use iceoryx2::prelude::{AttributeSpecifier, AttributeVerifier, Config, NodeBuilder, NodeName};
use iceoryx2::prelude::{CallbackProgression, FileName, SemanticString, ServiceName, SignalHandlingMode, ipc};
use iceoryx2::service::attribute::AttributeSet;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::port_factory::{PortFactory, publish_subscribe};
use messages::{
    Field, Frame, Header, Message, Sinkage, Soil, Supervision, Terrain, TerrainClass, Vibration, Wheel, difference,
};
use std::path::PathBuf;

/// Frames that the camera keeps for a stage that comes back: a second and a half at 30 Hz, a quarter of one at 200 Hz.
const FRAMES_KEPT: usize = 48;
/// Readers of a wire at the most.
const READERS_MAX: usize = 8;
/// Writers of a wire at the most: one at a time, and those that have died without the launcher having noticed yet.
const WRITERS_MAX: usize = 4;
/// Processes that have a wire open at the most.
const NODES_MAX: usize = 24;
/// Samples a reader holds at the most: the one it works on, the newest, and the one that may be newer.
const BORROWED_MAX: usize = 3;
/// Bytes of one service attribute at the most; a fingerprint is cut into pieces of this length.
const ATTRIBUTE_BYTES: usize = 240;

/// The wire on which the launcher tells how the process set is doing.
pub const SUPERVISION_WIRE: &str = "launcher/supervision";

/// The file, in the system's folder, by which the launcher says that every reader of a replay is connected.
pub const RELEASE: &str = "released";

/// What travels through a port of this name, by the catalogue in `messages`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Port {
    /// [`Frame`]
    Frames,
    /// [`Wheel`]
    Wheel,
    /// [`Vibration`]
    Vibration,
    /// [`Sinkage`]
    Sinkage,
    /// [`Soil`]
    Soil,
    /// [`TerrainClass`]
    Class,
    /// [`Terrain`]
    Terrain,
}

impl Port {
    /// All ports, in the order of the graph.
    pub const ALL: [Self; 7] = [
        Self::Frames,
        Self::Wheel,
        Self::Vibration,
        Self::Sinkage,
        Self::Soil,
        Self::Class,
        Self::Terrain,
    ];

    /// The port's name in a system file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Wheel => "wheel",
            Self::Vibration => "vibration",
            Self::Sinkage => "sinkage",
            Self::Soil => "soil",
            Self::Class => "class",
            Self::Terrain => "terrain",
        }
    }

    /// Names, types and offsets of the fields of the message that travels through this port.
    #[must_use]
    pub const fn fields(self) -> &'static [Field] {
        match self {
            Self::Frames => Frame::FIELDS,
            Self::Wheel => Wheel::FIELDS,
            Self::Vibration => Vibration::FIELDS,
            Self::Sinkage => Sinkage::FIELDS,
            Self::Soil => Soil::FIELDS,
            Self::Class => TerrainClass::FIELDS,
            Self::Terrain => Terrain::FIELDS,
        }
    }

    /// The input whose samples trigger the stage that writes this port; `None` where the first stage of a chain does.
    #[must_use]
    pub const fn trigger(self) -> Option<Self> {
        match self {
            Self::Frames | Self::Wheel | Self::Vibration => None,
            Self::Sinkage => Some(Self::Frames),
            Self::Soil => Some(Self::Sinkage),
            Self::Class => Some(Self::Vibration),
            Self::Terrain => Some(Self::Soil),
        }
    }

    /// The port of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|port| port.name() == name)
    }
}

type SampleService<T> = publish_subscribe::PortFactory<ipc::Service, T, ()>;

/// A wire that this process has open.
pub(crate) struct Wire<T: Message> {
    pub(crate) samples: SampleService<T>,
    pub(crate) event: EventService,
    pub(crate) bell: Bell,
    pub(crate) journal: Option<Journal>,
}

/// This process's place in a system's shared memory.
#[derive(Debug)]
pub struct Domain {
    node: Node<ipc::Service>,
    mode: Mode,
    root: String,
}

impl Domain {
    /// Enters a system as `name`.
    ///
    /// # Errors
    /// The system's folder cannot be used: another user's, or no space.
    pub fn enter(system: &SystemFile, name: &str) -> Result<Self, Error> {
        let config = iceoryx2_config(system)?;
        let failed = |what: String| Error::unavailable(format!("cannot enter {}: {what}", system.root()));
        let node_name = NodeName::new(name).map_err(|error| failed(format!("{error:?}")))?;
        let node = NodeBuilder::new()
            .name(&node_name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|error| {
                failed(format!(
                    "{error:?}; does another user run a system of this name, or is /dev/shm full?"
                ))
            })?;
        Ok(Self {
            node,
            mode: system.system.mode,
            root: system.root(),
        })
    }

    /// Removes what processes that have died left behind. True if something was removed.
    #[must_use]
    pub fn clean(&self) -> bool {
        self.node.try_cleanup_dead_nodes().cleanups > 0
    }

    /// The processes that live in a system's shared memory, without entering it.
    ///
    /// # Errors
    /// The system's name makes no file name, or its folder cannot be read.
    pub fn inhabitants(system: &SystemFile) -> Result<Vec<u32>, Error> {
        let mut pids = Vec::new();
        let config = iceoryx2_config(system)?;
        Node::<ipc::Service>::list(&config, |state| {
            if let NodeState::Alive(node) = state {
                pids.extend(
                    node.id()
                        .pid::<ipc::Service>()
                        .ok()
                        .and_then(|pid| u32::try_from(pid.value()).ok()),
                );
            }
            CallbackProgression::Continue
        })
        .map_err(|error| Error::unavailable(format!("cannot read {}: {error:?}", system.root())))?;
        Ok(pids)
    }

    /// Opens a wire of the catalogue for reading, whatever it carries.
    ///
    /// # Errors
    /// As [`Tap::open`].
    pub fn tap(&self, wire: &str, port: Port) -> Result<AnyTap, Error> {
        Ok(AnyTap(match port {
            Port::Frames => Box::new(Tap::<Frame>::open(self, wire)?),
            Port::Wheel => Box::new(Tap::<Wheel>::open(self, wire)?),
            Port::Vibration => Box::new(Tap::<Vibration>::open(self, wire)?),
            Port::Sinkage => Box::new(Tap::<Sinkage>::open(self, wire)?),
            Port::Soil => Box::new(Tap::<Soil>::open(self, wire)?),
            Port::Class => Box::new(Tap::<TerrainClass>::open(self, wire)?),
            Port::Terrain => Box::new(Tap::<Terrain>::open(self, wire)?),
        }))
    }

    /// Opens a wire for writing, outside of a service: for the launcher's own wire, and for tests and benches.
    ///
    /// # Errors
    /// The wire is not there, or its samples have another layout.
    pub fn output<T: Message>(&self, wire: &str, termination: &Termination) -> Result<Output<T>, Error> {
        Output::open(self, wire, None, 1, termination)
    }

    pub(crate) fn mode(&self) -> Mode {
        self.mode
    }

    /// What a service's first sample waits for: in a replay, the file by which the launcher says that every reader is
    /// connected.
    pub(crate) fn release(&self) -> Option<PathBuf> {
        (self.mode == Mode::Replay).then(|| PathBuf::from(&self.root).join(RELEASE))
    }

    /// Creates a wire. The launcher holds the result for as long as the system runs.
    ///
    /// # Errors
    /// A wire of this name is there already, or there is no space.
    pub fn create(&self, wire: &str, port: Port) -> Result<HeldWire, Error> {
        self.create_with(wire, port, |fingerprint| fingerprint)
    }

    /// Creates a wire whose samples have the port's type, size and alignment, but another layout: two fields have changed
    /// places. Whoever opens it as the port must refuse it; that is all that it is for.
    ///
    /// # Errors
    /// As [`Domain::create`].
    pub fn create_odd(&self, wire: &str, port: Port) -> Result<HeldWire, Error> {
        self.create_with(wire, port, |fingerprint| swapped(&fingerprint))
    }

    fn create_with(&self, wire: &str, port: Port, layout: fn(String) -> String) -> Result<HeldWire, Error> {
        match port {
            // Too large to be written twice: the camera itself keeps its last frames.
            Port::Frames if self.mode == Mode::Live => {
                self.create_as::<Frame>(wire, layout, FRAMES_KEPT, FRAMES_KEPT, 0)
            }
            Port::Frames => self.create_as::<Frame>(wire, layout, 4, 0, 0),
            Port::Wheel => self.create_as::<Wheel>(wire, layout, 512, 0, 1024),
            Port::Vibration => self.create_as::<Vibration>(wire, layout, 32, 0, 64),
            Port::Sinkage => self.create_as::<Sinkage>(wire, layout, 256, 0, 512),
            Port::Soil => self.create_as::<Soil>(wire, layout, 64, 0, 512),
            Port::Class => self.create_as::<TerrainClass>(wire, layout, 64, 0, 64),
            Port::Terrain => self.create_as::<Terrain>(wire, layout, 256, 0, 512),
        }
    }

    /// Creates the wire on which the launcher tells how the process set is doing.
    ///
    /// # Errors
    /// As [`Domain::create`].
    pub fn create_supervision(&self) -> Result<HeldWire, Error> {
        self.create_as::<Supervision>(SUPERVISION_WIRE, |fingerprint| fingerprint, 2, 0, 0)
    }

    /// `buffer` samples wait for a slow reader, `history` are kept by the writer for late ones, `journal` outlive the writer.
    fn create_as<T: Message>(
        &self,
        wire: &str,
        layout_of: fn(String) -> String,
        buffer: usize,
        history: usize,
        journal: usize,
    ) -> Result<HeldWire, Error> {
        let failed = |what: &dyn std::fmt::Debug| Error::unavailable(format!("cannot create wire {wire}: {what:?}"));
        let name: ServiceName = wire.try_into().map_err(|error| failed(&error))?;
        let mut layout = AttributeSpecifier::new();
        for (index, piece) in pieces(&layout_of(T::fingerprint())).enumerate() {
            let key = format!("layout.{index}");
            let key = key.as_str().try_into().map_err(|error| failed(&error))?;
            layout = layout
                .define(&key, &piece.try_into().map_err(|error| failed(&error))?)
                .map_err(|e| failed(&e))?;
        }
        let samples = self
            .node
            .service_builder(&name)
            .publish_subscribe::<T>()
            .max_publishers(WRITERS_MAX)
            .max_subscribers(READERS_MAX)
            .max_nodes(NODES_MAX)
            .subscriber_max_buffer_size(buffer)
            .subscriber_max_borrowed_samples(BORROWED_MAX)
            .history_size(history)
            .enable_safe_overflow(self.mode == Mode::Live)
            .create_with_attributes(&layout)
            .map_err(|error| failed(&error))?;
        let event = self
            .node
            .service_builder(&name)
            .event()
            .max_listeners(READERS_MAX)
            .max_notifiers(WRITERS_MAX + 1)
            .max_nodes(NODES_MAX)
            .event_id_max_value(RING + 1)
            .create()
            .map_err(|error| failed(&error))?;
        let bell = Bell::create(&Bell::path(&self.root, wire))?;
        // A replay neither restarts nor swaps.
        let journal = (journal > 0 && self.mode == Mode::Live)
            .then(|| Journal::create(&Journal::path(&self.root, wire), size_of::<T>(), journal))
            .transpose()?;
        Ok(HeldWire(Box::new(Wire {
            samples,
            event,
            bell,
            journal,
        })))
    }

    /// Opens a wire that the launcher holds.
    ///
    /// # Errors
    /// The wire is not there, or its samples have another layout: then what differs.
    pub(crate) fn open<T: Message>(&self, wire: &str) -> Result<Wire<T>, Error> {
        let failed = |what: &dyn std::fmt::Debug| Error::unavailable(format!("cannot open wire {wire}: {what:?}"));
        let name: ServiceName = wire.try_into().map_err(|error| failed(&error))?;
        let mut layout = AttributeVerifier::new();
        let ours = T::fingerprint();
        for (index, piece) in pieces(&ours).enumerate() {
            let key = format!("layout.{index}");
            let key = key.as_str().try_into().map_err(|error| failed(&error))?;
            layout = layout
                .require(&key, &piece.try_into().map_err(|error| failed(&error))?)
                .map_err(|e| failed(&e))?;
        }
        let samples = self
            .node
            .service_builder(&name)
            .publish_subscribe::<T>()
            .open_with_attributes(&layout);
        let samples = samples.map_err(|error| match error {
            PublishSubscribeOpenError::DoesNotExist => Error::unavailable(format!(
                "wire {wire} does not exist: the launcher creates the wires; start it with `terrasense up`"
            )),
            PublishSubscribeOpenError::IncompatibleAttributes | PublishSubscribeOpenError::IncompatibleTypes => {
                let theirs = self.fingerprint_of(&name).unwrap_or_default();
                Error::unavailable(format!(
                    "wire {wire} carries another layout than this program knows (- here, + there):\n{}",
                    difference(&ours, &theirs)
                ))
            }
            other => failed(&other),
        })?;
        let event = self
            .node
            .service_builder(&name)
            .event()
            .open()
            .map_err(|error| failed(&error))?;
        let bell = Bell::open(&Bell::path(&self.root, wire))?;
        let journal = Journal::open::<T>(&Journal::path(&self.root, wire))?;
        Ok(Wire {
            samples,
            event,
            bell,
            journal,
        })
    }

    fn fingerprint_of(&self, wire: &ServiceName) -> Option<String> {
        use iceoryx2::service::Service;
        let mut text = None;
        ipc::Service::list(self.node.config(), |found| {
            if found.static_details.name() == wire && found.static_details.attributes().number_of_attributes() > 0 {
                text = Some(join(found.static_details.attributes()));
            }
            CallbackProgression::Continue
        })
        .ok()?;
        text
    }
}

/// Which processes have a wire open, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Reads samples.
    Reader,
    /// Writes samples.
    Writer,
    /// Waits for the bell.
    Listener,
    /// Rings the bell.
    Ringer,
}

/// A wire that stays for as long as this value does.
pub struct HeldWire(Box<dyn Held>);

impl HeldWire {
    /// The processes that have the wire open.
    #[must_use]
    pub fn peers(&self) -> Vec<(Role, u32)> {
        self.0.peers()
    }

    /// Lets the writer of `generation` write from `sequence` on, and those before it no longer. False where the wire keeps no
    /// journal: its writer cannot be swapped.
    #[must_use]
    pub fn give_turn(&self, generation: u32, sequence: u64) -> bool {
        let journal = self.0.journal();
        journal
            .iter()
            .for_each(|journal| journal.give_turn(generation, sequence));
        journal.is_some()
    }
}

/// A wire that is read as it comes, whatever it carries.
pub struct AnyTap(Box<dyn Drain>);

impl AnyTap {
    /// Hands the next sample, if there is one, to `act`: its header and all its bytes.
    ///
    /// # Errors
    /// The wire is broken.
    pub fn poll(&self, act: &mut dyn FnMut(&Header, &[u8])) -> Result<bool, Error> {
        self.0.poll_bytes(act)
    }
}

trait Drain {
    fn poll_bytes(&self, act: &mut dyn FnMut(&Header, &[u8])) -> Result<bool, Error>;
}

impl<T: Message> Drain for Tap<T> {
    fn poll_bytes(&self, act: &mut dyn FnMut(&Header, &[u8])) -> Result<bool, Error> {
        Ok(self.poll(|sample| act(sample.header(), sample.as_bytes()))?.is_some())
    }
}

trait Held {
    fn peers(&self) -> Vec<(Role, u32)>;
    fn journal(&self) -> Option<&Journal>;
}

impl<T: Message> Held for Wire<T> {
    fn journal(&self) -> Option<&Journal> {
        self.journal.as_ref()
    }

    fn peers(&self) -> Vec<(Role, u32)> {
        let mut peers = Vec::new();
        let mut add = |role, node: &iceoryx2::identifiers::UniqueNodeId| {
            let pid = node
                .pid::<ipc::Service>()
                .map_or(0, |pid| u32::try_from(pid.value()).unwrap_or(0));
            peers.push((role, pid));
            CallbackProgression::Continue
        };
        self.samples
            .dynamic_config()
            .list_publishers(|details| add(Role::Writer, &details.node_id));
        self.samples
            .dynamic_config()
            .list_subscribers(|details| add(Role::Reader, &details.node_id));
        self.event
            .dynamic_config()
            .list_listeners(|details| add(Role::Listener, &details.node_id));
        self.event
            .dynamic_config()
            .list_notifiers(|details| add(Role::Ringer, &details.node_id));
        peers
    }
}

fn iceoryx2_config(system: &SystemFile) -> Result<Config, Error> {
    let failed = |what: &dyn std::fmt::Debug| {
        let span = system.system.name.span();
        system.error_at(
            span,
            &format!("`{}` makes no file name: {what:?}", system.system.name.get_ref()),
        )
    };
    let mut config = Config::default();
    let root = iceoryx2::prelude::Path::new(system.root().as_bytes()).map_err(|error| failed(&error))?;
    config.global.set_root_path(&root);
    config.global.prefix = FileName::new(system.prefix().as_bytes()).map_err(|error| failed(&error))?;
    // The launcher cleans up after the dead, and only the launcher: two cleaners would get in each other's way.
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    Ok(config)
}

/// The fingerprint in which the names of the last two fields have changed places.
fn swapped(fingerprint: &str) -> String {
    let mut words: Vec<String> = fingerprint.split(' ').map(str::to_owned).collect();
    if let [.., first, second] = words.as_mut_slice()
        && let (Some((a, first_type)), Some((b, second_type))) =
            (first.clone().split_once(':'), second.clone().split_once(':'))
    {
        (*first, *second) = (format!("{b}:{first_type}"), format!("{a}:{second_type}"));
    }
    words.join(" ")
}

fn pieces(fingerprint: &str) -> impl Iterator<Item = &str> {
    // A fingerprint is ASCII: every byte begins a character.
    (0..fingerprint.len())
        .step_by(ATTRIBUTE_BYTES)
        .map(|start| &fingerprint[start..fingerprint.len().min(start + ATTRIBUTE_BYTES)])
}

fn join(attributes: &AttributeSet) -> String {
    let mut pieces: Vec<_> = attributes
        .iter()
        .map(|each| (each.key().to_string(), each.value().to_string()))
        .collect();
    pieces.sort();
    pieces.into_iter().map(|(_, piece)| piece).collect()
}
