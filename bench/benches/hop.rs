//! What one wire costs from one process to the next, against a Unix socket and a futex in shared memory.
//!
//! As fast as possible: the peer answers each message; one way is half of the round trip. Paced: a message every 5 ms, one
//! way from before it is written to its receipt by the peer, so that the reader's core has gone to sleep in between.

use bench::{Options, Outcome, Report, ScratchSystem, Series};
use clap::Parser;
use messages::{Frame, Message, Status, Wheel};
use sem_safe::named::{OpenFlags, Semaphore};
use shell::{Domain, Error, HeldWire, Output, Port, SystemFile, Tap, Termination, now_ns, sleep_until};
use std::ffi::CString;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::process::{Child, ChildStdout, Command, Stdio};

const ROUNDS: usize = 5;
/// Round trips in a round.
const ROUND_TRIPS: usize = 1000;
/// Paced messages in a round.
const PACED: usize = 100;
const PERIOD_NS: u64 = 5_000_000;
/// A picture of 640 × 480 and what stands before it.
const VGA_BYTES: usize = size_of::<Frame>() - messages::PIXELS_MAX + 640 * 480;
/// Waits for the bell, of 20 ms at the most, after which the other process is taken for dead.
const WAITS_MAX: u32 = 1000;
/// The same, for a reader that spins.
const SPINS_MAX: u32 = 200_000_000;
const HEADER_BYTES: usize = size_of::<messages::Header>();

#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
    /// Be the other process, of this variant …
    #[arg(long, hide = true)]
    peer: Option<usize>,
    /// … in the system of this name …
    #[arg(long, hide = true, default_value = "")]
    system: String,
    /// … for so many messages …
    #[arg(long, hide = true, default_value_t = 0)]
    count: usize,
    /// … and answer each.
    #[arg(long, hide = true)]
    answer: bool,
}

/// One way to carry a message.
struct Variant {
    name: &'static str,
    port: Port,
    medium: Medium,
}

#[derive(Clone, Copy)]
enum Medium {
    /// A POSIX semaphore: a futex in shared memory, which carries nothing. The floor of what wakes a process.
    Futex,
    /// So many bytes written to a Unix socket and read from it.
    Socket(usize),
    /// A wire, of whose sample so many bytes are copied into shared memory; the reader spins, or waits for the bell.
    Wire { copied: usize, spins: bool },
}

const FLOOR: &str = "futex, no message (floor)";
const VARIANTS: [Variant; 9] = [
    variant(FLOOR, Port::Wheel, Medium::Futex),
    variant("wire, reader spins", Port::Wheel, wire(size_of::<Wheel>(), true)),
    variant("Unix socket", Port::Wheel, Medium::Socket(size_of::<Wheel>())),
    variant("wire", Port::Wheel, wire(size_of::<Wheel>(), false)),
    variant(FLOOR, Port::Frames, Medium::Futex),
    variant(
        "wire, reader spins, picture made in place",
        Port::Frames,
        wire(HEADER_BYTES, true),
    ),
    variant("Unix socket", Port::Frames, Medium::Socket(VGA_BYTES)),
    variant("wire, picture copied in", Port::Frames, wire(VGA_BYTES, false)),
    variant("wire, picture made in place", Port::Frames, wire(HEADER_BYTES, false)),
];

const fn variant(name: &'static str, port: Port, medium: Medium) -> Variant {
    Variant { name, port, medium }
}

const fn wire(copied: usize, spins: bool) -> Medium {
    Medium::Wire { copied, spins }
}

fn main() -> Outcome<()> {
    let arguments = Arguments::parse();
    if let Some(number) = arguments.peer {
        return be_peer(&VARIANTS[number], &arguments);
    }
    let termination = Termination::listen()?;
    let mut report = Report::begin("hop", &arguments.options);
    let system = ScratchSystem::make()?;
    let bench = Bench::new(&system, termination)?;
    let (mut lost, mut sent) = (0, 0);
    for (port, message) in [
        (Port::Wheel, "Wheel, 72 bytes"),
        (Port::Frames, "Frame, 640 x 480 pixels"),
    ] {
        for paced in [false, true] {
            let variants = || VARIANTS.iter().enumerate().filter(|(_, variant)| variant.port == port);
            let mut series: Vec<Series> = variants()
                .map(|(_, variant)| Series::new(variant.name).over(FLOOR))
                .collect();
            let count = arguments.options.amount(if paced { PACED } else { ROUND_TRIPS });
            for _ in 0..ROUNDS {
                for ((number, _), series) in variants().zip(&mut series) {
                    series.begin_round();
                    lost += bench.round(number, count, paced, series)?;
                    sent += count;
                }
            }
            let pace = if paced { "one each 5 ms" } else { "as fast as possible" };
            report.table(&format!("One way, {message}, {pace}"), &series);
        }
    }
    report.note(format!("\nMessages: {sent} sent, {lost} lost."));
    report.end()
}

/// The measuring process.
struct Bench<'a> {
    system: &'a ScratchSystem,
    domain: Domain,
    termination: Termination,
    _wires: Vec<HeldWire>,
}

impl<'a> Bench<'a> {
    fn new(system: &'a ScratchSystem, termination: Termination) -> Outcome<Self> {
        let domain = Domain::enter(system.file(), "bench")?;
        let mut wires = Vec::new();
        for port in [Port::Wheel, Port::Frames] {
            for way in ["there", "back"] {
                wires.push(domain.create(&format!("{way}/{}", port.name()), port)?);
            }
        }
        Ok(Self {
            system,
            domain,
            termination,
            _wires: wires,
        })
    }

    /// Measures one variant with a peer of its own, and returns how many messages got lost.
    fn round(&self, number: usize, count: usize, paced: bool, series: &mut Series) -> Outcome<usize> {
        let variant = &VARIANTS[number];
        let end = End {
            domain: &self.domain,
            system: self.system.file(),
            here: "there",
            there: "back",
        };
        let (socket, theirs) = UnixStream::pair()?;
        let mut link = end.open(variant, socket, &self.termination)?;
        let mut peer = Peer::start(number, self.system.name(), count, !paced, theirs)?;
        for way in ["there", "back"]
            .iter()
            .filter(|_| matches!(variant.medium, Medium::Futex))
        {
            Semaphore::unlink(&semaphore_name(self.system.file(), way)?).map_err(|()| "no semaphore")?;
        }
        let mut sent_ns = vec![0; count];
        for (sequence, sent_ns) in sent_ns.iter_mut().enumerate() {
            if self.termination.requested() {
                return Err("told to end".into());
            }
            if paced {
                sleep_until((now_ns() / PERIOD_NS + 1) * PERIOD_NS);
            }
            *sent_ns = now_ns();
            link.send(sequence as u64)?;
            if !paced {
                link.receive()?;
                series.record((now_ns() - *sent_ns) / 2);
            }
        }
        let receipts = peer.receipts()?;
        for (sequence, received_ns) in receipts.iter().filter(|_| paced) {
            series.record(received_ns - sent_ns[usize::try_from(*sequence)?]);
        }
        Ok(count - receipts.len())
    }
}

/// The other process. It ends with its round, or with this value.
struct Peer {
    child: Child,
    output: BufReader<ChildStdout>,
}

impl Peer {
    fn start(number: usize, system: &str, count: usize, answer: bool, socket: UnixStream) -> Outcome<Self> {
        shell::harden_descriptors();
        let mut command = Command::new(std::env::current_exe()?);
        command
            .args([
                "--peer",
                &number.to_string(),
                "--system",
                system,
                "--count",
                &count.to_string(),
            ])
            .args(answer.then_some("--answer"))
            .stdin(OwnedFd::from(socket))
            .stdout(Stdio::piped());
        shell::bind_to_parent(&mut command);
        let mut child = command.spawn()?;
        let output = BufReader::new(child.stdout.take().ok_or("the peer has no output")?);
        let mut peer = Self { child, output };
        let mut line = String::new();
        peer.output.read_line(&mut line)?;
        if line == "ready\n" {
            Ok(peer)
        } else {
            Err("the peer does not start".into())
        }
    }

    /// What the peer received: each message's number, and when [ns].
    fn receipts(&mut self) -> Outcome<Vec<(u64, u64)>> {
        let mut text = String::new();
        self.output.read_to_string(&mut text)?;
        let status = self.child.wait()?;
        if !status.success() {
            return Err(format!("the peer failed: {status}").into());
        }
        let pair = |line: &str| -> Outcome<(u64, u64)> {
            let (sequence, received_ns) = line.split_once(' ').ok_or("the peer writes something else")?;
            Ok((sequence.parse()?, received_ns.parse()?))
        };
        text.lines().map(pair).collect()
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn be_peer(variant: &Variant, arguments: &Arguments) -> Outcome<()> {
    let system = ScratchSystem::named(&arguments.system)?;
    let domain = Domain::enter(&system, "peer")?;
    let socket = UnixStream::from(std::io::stdin().as_fd().try_clone_to_owned()?);
    let end = End {
        domain: &domain,
        system: &system,
        here: "back",
        there: "there",
    };
    let mut link = end.open(variant, socket, &Termination::listen()?)?;
    let mut receipts = Vec::with_capacity(arguments.count);
    println!("ready");
    let last = arguments.count as u64 - 1;
    loop {
        let sequence = link.receive()?;
        receipts.push((sequence, now_ns()));
        if arguments.answer {
            link.send(sequence)?;
        }
        if sequence == last {
            break;
        }
    }
    let lines: String = receipts
        .iter()
        .map(|(sequence, received_ns)| format!("{sequence} {received_ns}\n"))
        .collect();
    std::io::stdout().write_all(lines.as_bytes())?;
    Ok(())
}

/// One end of a link: what it writes and what it reads.
struct End<'a> {
    domain: &'a Domain,
    system: &'a SystemFile,
    here: &'static str,
    there: &'static str,
}

impl End<'_> {
    fn open(&self, variant: &Variant, socket: UnixStream, termination: &Termination) -> Outcome<Box<dyn Link>> {
        Ok(match (variant.medium, variant.port) {
            (Medium::Futex, _) => Box::new(FutexLink {
                post: self.semaphore(self.here)?,
                wait: self.semaphore(self.there)?,
                received: 0,
            }),
            (Medium::Socket(bytes), _) => Box::new(SocketLink {
                socket,
                message: vec![0; bytes],
            }),
            (Medium::Wire { copied, spins }, Port::Frames) => {
                Box::new(self.wire::<Frame>(Port::Frames, copied, spins, termination)?)
            }
            (Medium::Wire { copied, spins }, _) => {
                Box::new(self.wire::<Wheel>(Port::Wheel, copied, spins, termination)?)
            }
        })
    }

    fn wire<T: Message>(
        &self,
        port: Port,
        copied: usize,
        spins: bool,
        termination: &Termination,
    ) -> Result<WireLink<T>, Error> {
        let name = |way: &str| format!("{way}/{}", port.name());
        Ok(WireLink {
            output: self.domain.output(&name(self.here), termination)?,
            tap: Tap::open(self.domain, &name(self.there))?,
            body: vec![0; copied - HEADER_BYTES],
            spins,
        })
    }

    /// A semaphore, made by the end that comes first.
    fn semaphore(&self, way: &str) -> Outcome<Semaphore> {
        let name = semaphore_name(self.system, way)?;
        let flags = OpenFlags::Create {
            exclusive: false,
            mode: 0o600,
            value: 0,
        };
        Semaphore::open(&name, flags).map_err(|()| "no semaphore".into())
    }
}

fn semaphore_name(system: &SystemFile, way: &str) -> Outcome<CString> {
    Ok(CString::new(format!("/{}{way}", system.prefix()))?)
}

/// One way to carry a message, seen from one end.
trait Link {
    /// Sends the message of this number.
    fn send(&mut self, sequence: u64) -> Outcome<()>;
    /// Waits for a message and returns its number.
    fn receive(&mut self) -> Outcome<u64>;
}

struct FutexLink {
    post: Semaphore,
    wait: Semaphore,
    received: u64,
}

impl Link for FutexLink {
    fn send(&mut self, _: u64) -> Outcome<()> {
        self.post.sem_ref().post().map_err(|()| "cannot post".into())
    }

    fn receive(&mut self) -> Outcome<u64> {
        self.wait.sem_ref().wait().map_err(|()| "interrupted")?;
        self.received += 1;
        Ok(self.received - 1)
    }
}

struct SocketLink {
    socket: UnixStream,
    message: Vec<u8>,
}

impl Link for SocketLink {
    fn send(&mut self, sequence: u64) -> Outcome<()> {
        self.message[..8].copy_from_slice(&sequence.to_le_bytes());
        Ok(self.socket.write_all(&self.message)?)
    }

    fn receive(&mut self) -> Outcome<u64> {
        self.socket.read_exact(&mut self.message)?;
        let (sequence, _) = self.message.split_first_chunk().ok_or("a message without a number")?;
        Ok(u64::from_le_bytes(*sequence))
    }
}

struct WireLink<T: Message> {
    output: Output<T>,
    tap: Tap<T>,
    /// What is copied into each sample behind its header.
    body: Vec<u8>,
    spins: bool,
}

impl<T: Message> Link for WireLink<T> {
    fn send(&mut self, sequence: u64) -> Outcome<()> {
        Ok(self.output.send_with(|sample| {
            sample.as_mut_bytes()[HEADER_BYTES..][..self.body.len()].copy_from_slice(&self.body);
            sample.header_mut().sequence = sequence;
            sample.header_mut().status = Status::OK;
            Ok(())
        })?)
    }

    fn receive(&mut self) -> Outcome<u64> {
        let looks_max = if self.spins { SPINS_MAX } else { WAITS_MAX };
        for _ in 0..looks_max {
            if let Some(sequence) = self.tap.poll(|sample| sample.header().sequence)? {
                return Ok(sequence);
            }
            if self.spins {
                std::hint::spin_loop();
            } else {
                self.tap.wait()?;
            }
        }
        Err("the other process does not answer".into())
    }
}
