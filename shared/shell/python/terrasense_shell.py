"""What a service in Python does around its algorithm: the replacement contract of the README, as `shared/shell` keeps it in Rust.

    def service(shell):
        frames, sinkage = shell.input("frames", Frame), shell.output("sinkage", Sinkage)
        config = shell.config(radius_m=0.15)
        shell.on_each(frames, sinkage, lambda frame: answer(frame, config))

    sys.exit(terrasense_shell.main(service))

Needs Python 3.11 and the package iceoryx2, version 0.10.0.
"""

import ctypes
import mmap
import os
import signal
import struct
import sys
import time
import tomllib
from ctypes import sizeof
from pathlib import Path

import iceoryx2

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "messages" / "python"))
from terrasense_messages import Header, Status  # noqa: E402

WAIT_MAX = iceoryx2.Duration.from_millis(20)
ATTRIBUTE_BYTES = 240
FALLING_BEHIND_MAX_NS = 250_000_000
EXIT_USAGE, EXIT_UNAVAILABLE, EXIT_CONFIG = 64, 69, 78


def main(service):
    """Runs a service, which is started as `<program> SYSTEM.TOML SERVICE`. Returns its exit code."""
    if len(sys.argv) != 3:
        print(f"usage: {sys.argv[0]} SYSTEM.TOML SERVICE", file=sys.stderr)
        return EXIT_USAGE
    system_file, name = sys.argv[1:]
    try:
        try:
            tables = tomllib.loads(Path(system_file).read_text(encoding="utf-8"))
            shell = Shell(tables, name)
        except (OSError, tomllib.TOMLDecodeError, KeyError) as error:
            raise Failure(EXIT_CONFIG, f"{system_file}: {type(error).__name__} {error}") from None
        service(shell)
    except Failure as failure:
        print(f"service {name}: {failure}", file=sys.stderr)
        return failure.code
    return 0


class Failure(Exception):
    """What ends a service, with the exit code that tells the launcher what to do."""

    def __init__(self, code, text):
        super().__init__(text)
        self.code = code


class Shell:
    """A service process: what the system file says of it, and its place in shared memory."""

    def __init__(self, tables, name):
        self.table = tables["service"][name]
        system = tables["system"]["name"]
        self.is_live = tables["system"].get("mode", "live") == "live"
        self.root = Path(f"/dev/shm/terrasense-{system}")
        self.stopping = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)
        generation = self.root / f"{name}.generation"
        self.generation = int(generation.read_text()) if generation.exists() else 0
        self._place(name)
        self.node = self._enter(f"terrasense-{system}-", name)

    def config(self, **defaults):
        """What the system file sets for this service, over the defaults. A key without a default is unknown."""
        config = self.table.get("config", {})
        unknown = sorted(config.keys() - defaults.keys())
        if unknown:
            raise Failure(EXIT_CONFIG, f"unknown key of config: {', '.join(unknown)}; known: {', '.join(defaults)}")
        return defaults | config

    def input(self, port, message):
        """The wire whose samples trigger this service."""
        return Reader(self, self._wire("inputs", port), message)

    def output(self, port, message):
        """A wire that this service writes."""
        rehearsal = self._wire("outputs", port)
        wire = self.table.get("takes_over", {}).get(port)
        return Output(self, wire or rehearsal, rehearsal if wire else None, message)

    def on_each(self, reader, output, step):
        """Answers every sample with exactly one, until the process is to end, another one has taken its place, or the
        recording is over. Goes on after what a predecessor has answered."""
        if output.answered is not None:
            reader.resume_after(output.answered)
        while not self.stopping:
            sample = reader.next()
            if sample is None:
                continue
            if output.is_over(sample.header):
                break
            output.send(step(sample))
            if sample.header.status == Status.ENDED:
                break
        while not self.stopping:
            time.sleep(0.02)

    def _wire(self, kind, port):
        try:
            return self.table[kind][port]
        except KeyError:
            raise Failure(EXIT_CONFIG, f"needs a wire for its port {port}: {kind} = {{ {port} = … }}") from None

    def _place(self, name):
        """Asks the machine for what the table says: processors, priority, memory that stays."""
        asked = {
            "cpus": lambda cpus: os.sched_setaffinity(0, cpus),
            "sched": lambda sched: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(sched["fifo"])),
            "lock_memory": lambda lock: lock_memory() if lock else None,
        }
        for key in asked.keys() & self.table.keys():
            try:
                asked[key](self.table[key])
            except OSError as error:
                if self.table.get("on_refusal") == "refuse":
                    raise Failure(EXIT_CONFIG, f"{key}: {error}") from None
                print(f"service {name}: {key}: {error}; it goes on without", file=sys.stderr)

    def _stop(self, *_):
        self.stopping = True

    def _enter(self, prefix, name):
        # Only the launcher cleans up after the dead.
        config = iceoryx2.config.default()
        config.global_cfg.root_path = iceoryx2.Path.new(str(self.root))
        config.global_cfg.prefix = iceoryx2.FileName.new(prefix)
        config.global_cfg.node.cleanup_dead_nodes_on_creation = False
        config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
        config.global_cfg.service.cleanup_dead_nodes_on_open = False
        builder = iceoryx2.NodeBuilder.new().config(config).name(iceoryx2.NodeName.new(name))
        builder = builder.signal_handling_mode(iceoryx2.SignalHandlingMode.Disabled)
        return builder.create(iceoryx2.ServiceType.Ipc)

    def open_wire(self, wire, message):
        """The wire's samples, its bell and its journal. The launcher creates wires; who opens one insists on the layout."""
        layout = iceoryx2.AttributeVerifier.new()
        text = message.fingerprint()
        for index, start in enumerate(range(0, len(text), ATTRIBUTE_BYTES)):
            piece = iceoryx2.AttributeValue.new(text[start : start + ATTRIBUTE_BYTES])
            layout = layout.require(iceoryx2.AttributeKey.new(f"layout.{index}"), piece)
        name = iceoryx2.ServiceName.new(wire)
        try:
            samples = self.node.service_builder(name).publish_subscribe(message).open_with_attributes(layout)
            bell = self.node.service_builder(name).event().open()
        except (iceoryx2.PublishSubscribeOpenError, iceoryx2.EventOpenError) as error:
            problem = f"cannot open wire {wire} with the layout of {message.NAME}: {error}; is the launcher up?"
            raise Failure(EXIT_UNAVAILABLE, problem) from None
        return samples, bell, Journal.open(self.root / f"journal.{wire.replace('/', '.')}", message)


class Reader:
    """A wire that is read: every sample once. What the wire does not bring comes from the journal."""

    def __init__(self, shell, wire, message):
        samples, bell, self.journal = shell.open_wire(wire, message)
        self.subscriber = samples.subscriber_builder().create()
        self.listener = bell.listener_builder().create()
        self.is_live = shell.is_live
        self.next_number = 0
        self.held = None
        self.last = None
        self.age_ns, self.behind_since_ns = 0, None

    def resume_after(self, header):
        """Goes on after a sample that has been taken in already."""
        self.last = header
        if self.journal is not None:
            self.next_number = self.journal.first_after(header)

    def next(self):
        """The next sample, which holds until the next call; None where none came while waiting. A bell can be missed, a
        sample cannot: whatever woke us, we look."""
        sample = self._receive()
        if sample is None:
            try:
                self.listener.timed_wait(WAIT_MAX)
            except iceoryx2.ListenerWaitError as error:
                if "InterruptSignal" not in str(error):
                    raise
            sample = self._receive()
        if sample is not None and self._falls_behind(sample.header):
            return self._skip_to_newest(sample)
        return sample

    def _falls_behind(self, header):
        """Whether one sample after the other comes later. What a pause has piled up comes earlier and earlier."""
        now_ns = time.monotonic_ns()
        age_ns = now_ns - header.published_ns
        is_later = self.is_live and age_ns > self.age_ns and self._has_more()
        self.age_ns = age_ns
        self.behind_since_ns = (self.behind_since_ns or now_ns) if is_later else None
        return is_later and now_ns - self.behind_since_ns > FALLING_BEHIND_MAX_NS

    def _has_more(self):
        kept = self.journal is not None and self.next_number < self.journal.numbers()[1]
        return kept or self.held is not None or self.subscriber.has_samples()

    def _skip_to_newest(self, sample):
        """The newest data win; what is left out is missing in the answers' numbers, and the launcher counts it."""
        self.behind_since_ns = None
        newest = sample
        while newest is not None:
            sample, newest = newest, self._receive()
        return sample

    def _receive(self):
        while True:
            lent, self.held = self.held or self.subscriber.receive(), None
            brought = None if lent is None else lent.payload().contents
            kept = self._missed(brought)
            if kept is not None:
                self.held, self.last = lent, copy(kept.header)
                return kept
            if lent is None:
                return None
            if not self._is_repeat(brought.header):
                self.lent, self.last = lent, copy(brought.header)
                return brought

    def _missed(self, brought):
        """The next sample of the journal, unless it is the one that the wire has brought."""
        if self.journal is None:
            return None
        first, end = self.journal.numbers()
        self.next_number = max(self.next_number, first)
        while self.next_number < end:
            sample = self.journal.read(self.next_number)
            self.next_number += 1
            if sample is None:
                continue
            if brought is not None and bytes(sample.header) == bytes(brought.header):
                return None
            if not self._is_repeat(sample.header):
                return sample
        return None

    def _is_repeat(self, header):
        return self.is_live and self.last is not None and repeats(header, self.last)


class Output:
    """A wire that is written, each cycle by one process: this one, or the one before or after it."""

    def __init__(self, shell, wire, rehearsal, message):
        self.wire = Writer(shell, wire, message)
        self.rehearsal = Writer(shell, rehearsal, message) if rehearsal else None
        self.rehearses = rehearsal is not None
        self.generation = shell.generation
        self.answered = self.wire.newest()
        if not self.rehearses:
            self.wire.send_unsent()

    def is_over(self, trigger):
        """Whether another process answers this trigger, and all later ones."""
        return not self.rehearses and self._turn_is_after(self.generation, trigger)

    def send(self, sample):
        """Sends a sample. What a predecessor has sent already is left out."""
        sample.header.generation = self.generation
        sample.header.published_ns = time.monotonic_ns()
        if self.rehearses:
            if not self._turn_is_after(self.generation - 1, sample.header):
                self.rehearsal.publish(sample)
                return
            self.rehearses = False
            # The one before may have gone on for a moment longer.
            self.answered = self.wire.newest()
        if self.answered is None or not repeats(sample.header, self.answered):
            self.wire.publish(sample)

    def _turn_is_after(self, generation, header):
        if self.wire.journal is None:
            return False
        turn, sequence = self.wire.journal.turn()
        return turn > generation and header.sequence >= sequence


class Writer:
    """One wire's publisher, bell and journal."""

    def __init__(self, shell, wire, message):
        samples, bell, self.journal = shell.open_wire(wire, message)
        strategy = iceoryx2.BackpressureStrategy
        strategy = strategy.DiscardData if shell.is_live else strategy.RetryUntilDelivered
        self.publisher = samples.publisher_builder().backpressure_strategy(strategy).create()
        self.notifier = bell.notifier_builder().default_event_id(iceoryx2.EventId.new(0)).create()

    def newest(self):
        return None if self.journal is None else self.journal.newest()

    def send_unsent(self):
        """Sends what a predecessor died over: it is in the journal, and perhaps on the wire."""
        if self.journal is not None:
            for sample in self.journal.unsent():
                self._hand_over(sample)

    def publish(self, sample):
        """In the journal first: from there on it is published, whatever happens to this process."""
        if self.journal is not None:
            self.journal.append(sample)
        self._hand_over(sample)

    def _hand_over(self, sample):
        self.publisher.send_copy(sample)
        if self.journal is not None:
            self.journal.note_sent()
        self.notifier.notify()


class Journal:
    """The last samples of a wire, in memory that outlives its writer: `shared/shell/src/journal.rs` tells its layout."""

    MAGIC = int.from_bytes(b"TERRAJ01", "little")
    SAMPLE_WORDS, PLACES, APPENDED, SENT, TURN_SEQUENCE, TURN_GENERATION, HEADER_WORDS = 1, 2, 3, 4, 5, 6, 8

    @classmethod
    def open(cls, path, message):
        """The journal of a wire; None where it has none."""
        if not path.exists():
            return None
        with path.open("r+b") as file:
            journal = cls(mmap.mmap(file.fileno(), 0), message)
        if journal._word(0) != cls.MAGIC or journal._word(cls.SAMPLE_WORDS) != journal.sample_words:
            raise Failure(EXIT_UNAVAILABLE, f"{path}: no journal of {message.NAME}")
        return journal

    def __init__(self, memory, message):
        self.memory, self.message = memory, message
        self.sample_words = (sizeof(message) + 7) // 8
        self.places = self._word(self.PLACES)

    def append(self, sample):
        number = self._word(self.APPENDED)
        place = self._place(number)
        self._set_word(place, 0)
        start = 8 * (place + 1)
        self.memory[start : start + sizeof(self.message)] = bytes(sample)
        self._set_word(place, number + 1)
        self._set_word(self.APPENDED, number + 1)

    def note_sent(self):
        self._set_word(self.SENT, self._word(self.APPENDED))

    def numbers(self):
        """The first number of the samples that can be read, and the one after the last."""
        end = self._word(self.APPENDED)
        return max(end - self.places, 0), end

    def unsent(self):
        first, end = self.numbers()
        samples = [self.read(number) for number in range(max(self._word(self.SENT), first), end)]
        return [sample for sample in samples if sample is not None]

    def read(self, number):
        """The sample of this number; None where it has been overwritten."""
        place = self._place(number)
        if self._word(place) != number + 1:
            return None
        start = 8 * (place + 1)
        sample = self.message.from_buffer_copy(self.memory[start : start + sizeof(self.message)])
        return sample if self._word(place) == number + 1 else None

    def newest(self):
        """The header of the newest sample; None where there is none."""
        first, end = self.numbers()
        sample = self.read(end - 1) if end > first else None
        return None if sample is None else copy(sample.header)

    def first_after(self, header):
        """The number of the first sample that does not repeat the one of `header`."""
        first, number = self.numbers()
        while number > first:
            sample = self.read(number - 1)
            if sample is None or repeats(sample.header, header):
                break
            number -= 1
        return number

    def turn(self):
        """The generation whose turn begins, and with which sequence."""
        return self._word(self.TURN_GENERATION), self._word(self.TURN_SEQUENCE)

    def _place(self, number):
        return self.HEADER_WORDS + number % self.places * (1 + self.sample_words)

    def _word(self, index):
        return struct.unpack_from("<Q", self.memory, 8 * index)[0]

    def _set_word(self, index, value):
        struct.pack_into("<Q", self.memory, 8 * index, value)


def lock_memory():
    """Keeps what has been touched from being paged out."""
    current, future, on_fault = 1, 2, 4
    if ctypes.CDLL(None, use_errno=True).mlockall(current | future | on_fault) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def repeats(header, before):
    """Whether a sample says again what one that came before has said: neither its number nor its instant is newer."""
    is_newer = header.sequence > before.sequence or header.taken_ns > before.taken_ns
    return not is_newer and header.status != Status.ENDED


def copy(header):
    """A header that stays when its sample goes."""
    return Header.from_buffer_copy(header)
