//! What the shell does around a stage allocates nothing, cycle for cycle: a process of its own, which counts, answers so many
//! triggers, and then twice as many, and asks for memory as often. What iceoryx2 itself asks for with each sample that it lends
//! (one counter of references, given back when the sample is sent) is left out.

#![allow(clippy::unwrap_used)]

use messages::{Frame, Header, Message, Resumable, Sinkage, Soil, Status, Wheel};
use rustix::process::{Pid, Signal, kill_process};
use shell::{Domain, Error, HeldWire, Output, Port, Role, Shell, SystemFile, Tap, Termination, now_ns, sleep_until};
use std::os::unix::fs::DirBuilderExt;
use std::process::{Child, Command, ExitCode, Stdio};
use zerocopy::FromZeros;

/// Triggers of the shorter run: more than wires and journals have places.
const CYCLES: u64 = 600;
/// Allocations of iceoryx2 with each sample that is sent.
const LOAN: u64 = 1;
/// Comparisons until two are equal, at the most.
const ATTEMPTS: usize = 3;
/// Longer than anything takes on a slow machine [ns].
const PATIENCE_NS: u64 = 60_000_000_000;

const WIRES: [(&str, Port); 4] = [
    ("frames", Port::Frames),
    ("wheel", Port::Wheel),
    ("sinkage", Port::Sinkage),
    ("soil", Port::Soil),
];

fn main() -> ExitCode {
    // The launcher starts a service with the system file and its name; cargo starts a test with neither.
    if std::env::args()
        .nth(1)
        .is_some_and(|argument| argument.ends_with(".toml"))
    {
        return shell::main(service);
    }
    for (stage, run) in [
        ("tracker", frames as fn(&mut Stand, u64)),
        ("estimator", numbers),
        ("source", ticks),
    ] {
        // Where the machine stops for long enough, samples pile up and some are left out, which is told.
        let equal = (0..ATTEMPTS).any(|_| {
            let [once, twice] = [CYCLES, 2 * CYCLES].map(|cycles| Stand::allocations(stage, cycles, run));
            println!("{stage}: {once} allocations in {CYCLES} cycles, {twice} in twice as many");
            once == twice
        });
        assert!(equal, "`{stage}` asks for memory in the course of its cycles");
    }
    ExitCode::SUCCESS
}

/// A stage whose state grows with nothing.
struct Counter(u64);

impl Resumable for Counter {
    fn state_bytes(&self) -> usize {
        size_of::<u64>()
    }

    fn save(&self, state: &mut [u8]) {
        state.copy_from_slice(&self.0.to_ne_bytes());
    }

    fn restore(&mut self, _: &[u8]) -> Result<(), &'static str> {
        Err("is never restarted here")
    }
}

/// The process that counts.
fn service(shell: &mut Shell) -> Result<(), Error> {
    let mut counter = Counter(0);
    let mut sent = 0;
    let counted = if shell.writes("frames") {
        let frames = shell.output::<Frame>("frames")?;
        let mut outcome = Ok(());
        let counted = allocation_counter::measure(|| {
            outcome = shell.on_tick(1_000_000, |number, _| {
                sent += 1;
                frames.send_with(|frame| {
                    (frame.header.sequence, frame.header.taken_ns) = (number, number * 1_000_000);
                    Ok(())
                })
            });
        });
        outcome.map(|()| counted)
    } else if shell.writes("sinkage") {
        let mut frames = shell.input::<Frame>("frames")?;
        let sinkage = shell.output::<Sinkage>("sinkage")?;
        let mut outcome = Ok(());
        let counted = allocation_counter::measure(|| {
            outcome = shell.on_each(&mut counter, &mut frames, &sinkage, |counter, frame| {
                counter.0 += u64::from(frame.width);
                sent += 1;
                Ok(Sinkage::unknown(frame.header.answer(Status::NOT_VISIBLE)))
            });
        });
        outcome.map(|()| counted)
    } else {
        let mut sinkage = shell.input::<Sinkage>("sinkage")?;
        let wheel = shell.observation::<Wheel>("wheel")?;
        let soil = shell.output::<Soil>("soil")?;
        let mut outcome = Ok(());
        let counted = allocation_counter::measure(|| {
            outcome = shell.on_each(&mut counter, &mut sinkage, &soil, |counter, sample| {
                wheel.until(sample.header.taken_ns, |_| counter.0 += 1)?;
                sent += 1;
                Ok(Soil::unknown(sample.header.answer(Status::WARMING_UP)))
            });
        });
        outcome.map(|()| counted)
    }?;
    println!("{}", counted.count_total - sent * LOAN);
    Ok(())
}

/// A system of the test's own.
struct Stand {
    domain: Domain,
    wires: Vec<HeldWire>,
    termination: Termination,
    command: Command,
    child: Option<Child>,
}

impl Stand {
    /// How often the process of a stage asks for memory while `run` lets it go through so many cycles.
    fn allocations(stage: &str, cycles: u64, run: fn(&mut Self, u64)) -> u64 {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("system.toml").display().to_string();
        let text = format!(
            "[system]\nname = \"alloc{}\"\n\
             [service.source]\nexec = [\"a\"]\noutputs = {{ frames = \"frames\" }}\n\
             [service.tracker]\nexec = [\"a\"]\ninputs = {{ frames = \"frames\" }}\noutputs = {{ sinkage = \"sinkage\" }}\n\
             [service.estimator]\nexec = [\"a\"]\n\
             inputs = {{ sinkage = \"sinkage\", wheel = \"wheel\" }}\noutputs = {{ soil = \"soil\" }}\n",
            std::process::id()
        );
        std::fs::write(&path, &text).unwrap();
        let system = SystemFile::parse(&path, &text).unwrap();
        std::fs::DirBuilder::new().mode(0o700).create(system.root()).unwrap();
        let domain = Domain::enter(&system, "test").unwrap();
        let wires = WIRES.map(|(wire, port)| domain.create(wire, port).unwrap());
        let mut command = Command::new(std::env::current_exe().unwrap());
        shell::bind_to_parent(&mut command);
        command.args([&path, stage]).stdout(Stdio::piped());
        let mut stand = Self {
            domain,
            wires: wires.into(),
            termination: Termination::listen().unwrap(),
            command,
            child: None,
        };
        run(&mut stand, cycles);
        let count = ended(stand.child.take().unwrap());
        drop(stand);
        std::fs::remove_dir_all(system.root()).unwrap();
        // iceoryx2's counter of nodes lies beside the folder, and stays.
        let left = std::fs::read_dir("/dev/shm").unwrap().map(|entry| entry.unwrap());
        left.filter(|entry| entry.file_name().to_string_lossy().starts_with(&system.prefix()))
            .for_each(|entry| std::fs::remove_file(entry.path()).unwrap());
        count
    }

    /// Starts the process that counts, and waits until it has these wires open. All others are connected by then: that they
    /// come is not counted.
    fn start(&mut self, wires: &[(usize, Role)]) {
        let child = self.child.insert(self.command.spawn().unwrap()).id();
        for (wire, role) in wires {
            until("connected", || self.wires[*wire].peers().contains(&(*role, child)));
        }
    }

    fn output<T: Message>(&self, wire: &str) -> Output<T> {
        self.domain.output(wire, &self.termination).unwrap()
    }
}

/// Ends a service, and returns the number that it prints.
fn ended(child: Child) -> u64 {
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap().trim().parse().unwrap()
}

fn until(what: &str, holds: impl Fn() -> bool) {
    let last_ns = now_ns() + PATIENCE_NS;
    while !holds() {
        assert!(now_ns() < last_ns, "not yet: {what}");
        sleep_until(now_ns() + 100_000);
    }
}

/// Header of a cycle that is taken now.
fn cycle(sequence: u64) -> Header {
    Header {
        taken_ns: now_ns(),
        sequence,
        status: Status::NO_DATA,
        ..Header::default()
    }
}

fn answer<T: Message>(tap: &Tap<T>, sequence: u64) {
    until("answered", || {
        tap.poll(|sample| sample.header().sequence).unwrap() == Some(sequence)
    });
}

fn frames(stand: &mut Stand, cycles: u64) {
    let (output, tap) = (
        stand.output::<Frame>("frames"),
        Tap::<Sinkage>::open(&stand.domain, "sinkage").unwrap(),
    );
    stand.start(&[(0, Role::Reader), (2, Role::Writer)]);
    for sequence in 1..=cycles {
        let fill = |frame: &mut Frame| {
            frame.header = cycle(sequence);
            Ok(())
        };
        output.send_with(fill).unwrap();
        answer(&tap, sequence);
    }
}

fn numbers(stand: &mut Stand, cycles: u64) {
    let (wheel, sinkage) = (stand.output::<Wheel>("wheel"), stand.output::<Sinkage>("sinkage"));
    let tap = Tap::<Soil>::open(&stand.domain, "soil").unwrap();
    stand.start(&[(1, Role::Reader), (3, Role::Writer)]);
    for sequence in 1..=cycles {
        for part in 0..3 {
            let mut reading = Wheel::new_zeroed();
            reading.header = cycle(3 * sequence + part);
            wheel.send(reading).unwrap();
        }
        sinkage.send(Sinkage::unknown(cycle(sequence))).unwrap();
        answer(&tap, sequence);
    }
}

fn ticks(stand: &mut Stand, cycles: u64) {
    let tap = Tap::<Frame>::open(&stand.domain, "frames").unwrap();
    stand.start(&[(0, Role::Writer)]);
    for _ in 0..cycles {
        until("a frame", || tap.poll(|_| ()).unwrap().is_some());
    }
}
