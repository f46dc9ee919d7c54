"""A sinkage service that breaks one rule of the contract: `terrasense conformance` must tell which.

usage: broken.py FAULT SYSTEM.TOML SERVICE. Without a fault (`none`) it keeps all rules, though it never sees anything.
"""

import sys
import time
import tomllib
from pathlib import Path

import iceoryx2
from sinkage import is_believable
from terrasense_messages import Frame, Sinkage, Status
from terrasense_shell import EXIT_CONFIG, Failure, Journal, Shell

SINGLES, GOOD = 60, 120  # sequences up to which triggers come one by one, and up to which all are sound


def main(fault, system_file, name):
    tables = tomllib.loads(Path(system_file).read_text(encoding="utf-8"))
    if name not in tables["service"]:
        if fault == "any_name":
            return 0
        print(f"{system_file} has no service {name}", file=sys.stderr)
        return EXIT_CONFIG
    service = tables["service"][name]
    if service["config"].keys() - {"radius_m", "rolls"} and fault != "any_key":
        print(f"{system_file}: unknown key in {service['config']}", file=sys.stderr)
        return EXIT_CONFIG

    shell = (Unlooking if fault == "ignores_layout" else Shell)(tables, name)
    first = shell.generation == 1
    if fault == "late" and first:
        time.sleep(service["start_timeout_ms"] / 1000)
    try:
        reader, output = shell.input("frames", Frame), shell.output("sinkage", Sinkage)
    except Failure as failure:
        if fault == "any_layout":
            time.sleep(1000)
        print(failure, file=sys.stderr)
        return failure.code
    broken, hoard = Broken(fault, shell, output), []
    if output.answered is not None:
        reader.resume_after(output.answered)
    while not shell.stopping or fault == "deaf":
        frame = reader.next()
        if frame is not None and not (fault == "amnesia" and not first and frame.header.status != Status.ENDED):
            broken.answer(frame)
            if fault == "leaks":
                hoard.append(b"x" * (64 << 10))
    return 3 if fault == "wrong_code" else 0


class Unlooking(Shell):
    """Opens wires without a look at their layout."""

    def open_wire(self, wire, message):
        name = iceoryx2.ServiceName.new(wire)
        samples = self.node.service_builder(name).publish_subscribe(message).open()
        bell = self.node.service_builder(name).event().open()
        return samples, bell, Journal.open(self.root / f"journal.{wire.replace('/', '.')}", message)


class Broken:
    """Answers every frame, but for the fault."""

    def __init__(self, fault, shell, output):
        self.fault, self.generation, self.wire = fault, shell.generation, output.wire
        self.held = []

    def answer(self, frame):
        fault, status, sequence = self.fault, frame.header.status, frame.header.sequence
        if status == Status.ENDED:
            reply = Status.NOT_VISIBLE if fault == "never_ends" else Status.ENDED
            return self.send(Sinkage.empty(frame.header.answer(reply)))
        if status not in (Status.OK, Status.UNCERTAIN) or not is_believable(frame):
            if fault == "silence":
                return None
            sample = Sinkage.empty(frame.header.answer(Status.INPUT_REJECTED))
            if fault == "believes":
                sample.header.status, sample.entry_rad, sample.sinkage_m = Status.OK, 0.4, 0.01
            return self.send(sample)
        sample = Sinkage.empty(frame.header.answer(Status.NOT_VISIBLE))
        if sequence > GOOD:
            return self.send(sample)
        if fault == "own_sequence":
            sample.header.sequence += 1000
        elif fault == "own_instant":
            sample.header.taken_ns += 1
        elif fault == "infinite":
            sample.left_rad = float("inf")
        elif fault == "skips" and sequence in (7, 14):
            return None
        elif fault == "two_answers":
            self.send(sample)
        elif fault == "reversed" and sequence > SINGLES:
            return self.hold(sample)
        return self.send(sample)

    def hold(self, sample):
        """Bursts are of three."""
        self.held.append(sample)
        if len(self.held) == 3:
            for late in reversed(self.held):
                self.send(late)
            self.held = []

    def send(self, sample):
        sample.header.generation = 0 if self.fault == "no_generation" else self.generation
        sample.header.published_ns = 0 if self.fault == "no_stamp" else time.monotonic_ns()
        self.wire.journal.append(sample)
        self.wire.publisher.send_copy(sample)
        self.wire.journal.note_sent()
        if self.fault != "silent_bell":
            self.wire.notifier.notify()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
