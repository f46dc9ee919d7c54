"""A sinkage service in Python: shows that any program can take the place of a service.

In the system file: exec = ["python3", "tests/peers/sinkage.py"]. Needs Python 3.11 and `pip install -r requirements.txt`.

It finds the soil line as the paper does: the mean brightness of each row of the annulus between rim and outer edge, each
half of the wheel on its own, smoothed; the interface is where it changes most.
"""

import math
import signal
import sys
import time
import tomllib
from pathlib import Path

import iceoryx2

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "shared" / "messages" / "python"))
from terrasense_messages import PIXELS_MAX, Frame, Sinkage, Status  # noqa: E402

WAIT_MAX = iceoryx2.Duration.from_millis(100)
ATTRIBUTE_BYTES = 240
EXIT_CONFIG = 78


def main(system_file, name):
    try:
        tables = tomllib.loads(Path(system_file).read_text(encoding="utf-8"))
        system, service = tables["system"], tables["service"][name]
        frames, sinkage = service["inputs"]["frames"], service["outputs"]["sinkage"]
        config = {"radius_m": 0.15, "rolls": "right"}
        unknown = service.get("config", {}).keys() - config.keys()
        if unknown:
            raise KeyError(f"unknown key of config: {', '.join(sorted(unknown))}")
        config |= service.get("config", {})
    except (OSError, tomllib.TOMLDecodeError, KeyError) as error:
        print(f"service {name}: {system_file}: {type(error).__name__} {error}", file=sys.stderr)
        return EXIT_CONFIG

    stopping = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.append(True))

    root = f"/dev/shm/terrasense-{system['name']}"
    node = enter(root, f"terrasense-{system['name']}-", name)
    reader = Reader(node, frames)
    writer = Writer(node, sinkage, Path(root, f"{name}.generation"), system.get("mode", "live"))
    while not stopping:
        frame = reader.next()
        if frame is None:
            continue
        writer.send(answer(frame, config))
        if frame.header.status == Status.ENDED:
            break
    return 0


def enter(root, prefix, name):
    """This process's place in the system's shared memory. Only the launcher cleans up after the dead."""
    config = iceoryx2.config.default()
    config.global_cfg.root_path = iceoryx2.Path.new(root)
    config.global_cfg.prefix = iceoryx2.FileName.new(prefix)
    config.global_cfg.node.cleanup_dead_nodes_on_creation = False
    config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
    config.global_cfg.service.cleanup_dead_nodes_on_open = False
    builder = iceoryx2.NodeBuilder.new().config(config).name(iceoryx2.NodeName.new(name))
    builder = builder.signal_handling_mode(iceoryx2.SignalHandlingMode.Disabled)
    return builder.create(iceoryx2.ServiceType.Ipc)


def open_wire(node, wire, message):
    """The wire's samples and its bell. The launcher creates wires; who opens one insists on the layout."""
    layout = iceoryx2.AttributeVerifier.new()
    text = message.fingerprint()
    for index, start in enumerate(range(0, len(text), ATTRIBUTE_BYTES)):
        piece = iceoryx2.AttributeValue.new(text[start : start + ATTRIBUTE_BYTES])
        layout = layout.require(iceoryx2.AttributeKey.new(f"layout.{index}"), piece)
    name = iceoryx2.ServiceName.new(wire)
    try:
        samples = node.service_builder(name).publish_subscribe(message).open_with_attributes(layout)
        return samples, node.service_builder(name).event().open()
    except (iceoryx2.PublishSubscribeOpenError, iceoryx2.EventOpenError) as error:
        sys.exit(f"cannot open wire {wire} with the layout of {message.NAME}: {error}; is the launcher up?")


class Reader:
    """The wire whose samples trigger this service."""

    def __init__(self, node, wire):
        samples, bell = open_wire(node, wire, Frame)
        self.subscriber = samples.subscriber_builder().create()
        self.listener = bell.listener_builder().create()
        self.sample = None

    def next(self):
        """The next frame, which holds until the next call; None where none came while waiting. A bell can be missed, a
        sample cannot: whatever woke us, we look."""
        self.sample = None
        self.sample = self.subscriber.receive()
        if self.sample is None:
            try:
                self.listener.timed_wait(WAIT_MAX)
            except iceoryx2.ListenerWaitError as error:
                if "InterruptSignal" not in str(error):
                    raise
            self.sample = self.subscriber.receive()
        return None if self.sample is None else self.sample.payload().contents


class Writer:
    """The wire that this service writes."""

    def __init__(self, node, wire, generation_file, mode):
        samples, bell = open_wire(node, wire, Sinkage)
        strategy = iceoryx2.BackpressureStrategy
        strategy = strategy.RetryUntilDelivered if mode == "replay" else strategy.DiscardData
        self.publisher = samples.publisher_builder().backpressure_strategy(strategy).create()
        self.notifier = bell.notifier_builder().default_event_id(iceoryx2.EventId.new(0)).create()
        self.generation = int(generation_file.read_text()) if generation_file.exists() else 0

    def send(self, sample):
        sample.header.generation = self.generation
        sample.header.published_ns = time.monotonic_ns()
        self.publisher.send_copy(sample)
        self.notifier.notify()


ROWS = 120  # of the lower half of the wheel
COLUMNS = 6  # of the annulus, each side
WINDOW = 3  # rows above and below the interface that are compared
EDGE = 6  # rows at the top and the bottom in which no interface is looked for
FILTER = (1, 4, 6, 4, 1)  # binomial
SIGMA_ROWS = 1.5  # standard deviation of an interface
UNCERTAIN_BELOW = 0.6


def answer(frame, config):
    """One frame in, one sinkage out."""
    status = frame.header.status
    if status == Status.ENDED:
        return Sinkage.empty(frame.header.answer(Status.ENDED))
    if status not in (Status.OK, Status.UNCERTAIN) or not is_believable(frame):
        return Sinkage.empty(frame.header.answer(Status.INPUT_REJECTED))
    left, right = interface(frame, -1.0), interface(frame, 1.0)
    if left is None or right is None:
        return Sinkage.empty(frame.header.answer(Status.NOT_VISIBLE))

    (left_rad, left_sigma_rad, left_confidence), (right_rad, right_sigma_rad, right_confidence) = left, right
    entry, back = ((right_rad, right_sigma_rad), (left_rad, left_sigma_rad))[:: -1 if config["rolls"] == "left" else 1]
    confidence = min(left_confidence, right_confidence)
    sample = Sinkage.empty(frame.header.answer(Status.UNCERTAIN if confidence < UNCERTAIN_BELOW else Status.OK))
    sample.left_rad, sample.left_sigma_rad = left_rad, left_sigma_rad
    sample.right_rad, sample.right_sigma_rad = right_rad, right_sigma_rad
    sample.entry_rad, sample.entry_sigma_rad = entry
    sample.exit_rad, sample.exit_sigma_rad = -back[0], back[1]
    sample.sinkage_m = config["radius_m"] * (1.0 - math.cos(entry[0]))
    sample.sinkage_sigma_m = config["radius_m"] * math.sin(entry[0]) * entry[1]
    sample.confidence = confidence
    return sample


def is_believable(frame):
    pose = (frame.rim_radius_px, frame.wheel_radius_px, *frame.homography)
    return (
        0 < frame.width * frame.height <= PIXELS_MAX
        and all(math.isfinite(value) for value in pose)
        and 0.0 < frame.rim_radius_px < frame.wheel_radius_px
    )


def interface(frame, side):
    """Where the soil meets one half of the wheel: angle from straight down, its sigma, and a confidence. None where too
    little of the wheel is in the picture."""
    rows = [row_mean(frame, side, (row + 0.5) / ROWS) for row in range(ROWS)]
    if sum(count for _, count in rows) < ROWS * COLUMNS / 2:
        return None
    smooth = [filtered(rows, row) for row in range(ROWS)]
    steps = {}
    for row in range(EDGE, ROWS - EDGE):
        above, below = smooth[row - WINDOW : row], smooth[row : row + WINDOW]
        if None not in above and None not in below:
            steps[row] = abs(sum(above) - sum(below)) / WINDOW
    if not steps:
        return None
    best = max(steps, key=steps.get)
    second = max((step for row, step in steps.items() if abs(row - best) > 2 * WINDOW), default=0.0)
    down = best / ROWS
    angle_rad = math.acos(down)
    total = steps[best] + second
    return angle_rad, SIGMA_ROWS / ROWS / math.sqrt(1.0 - down * down), steps[best] / total if total > 0.0 else 0.0


def row_mean(frame, side, down):
    """Mean brightness and number of the annulus' points `down` below the wheel's centre (outer radius 1), on one side."""
    rim = frame.rim_radius_px / frame.wheel_radius_px
    inner, outer = math.sqrt(max(rim * rim - down * down, 0.0)), math.sqrt(1.0 - down * down)
    h, width, height, pixels = frame.homography, frame.width, frame.height, frame.pixels
    total = count = 0
    for column in range(COLUMNS):
        right = side * (inner + (outer - inner) * (column + 0.5) / COLUMNS)
        scale = h[6] * right + h[7] * down + h[8]
        if scale <= 0.0:
            continue
        x = (h[0] * right + h[1] * down + h[2]) / scale
        y = (h[3] * right + h[4] * down + h[5]) / scale
        if -0.5 < x < width - 0.5 and -0.5 < y < height - 0.5:
            total += pixels[int(y + 0.5) * width + int(x + 0.5)]
            count += 1
    return (total / count if count else 0.0), count


def filtered(rows, row):
    """The binomial mean of a row and its neighbours, weighted by their numbers of points; None where there are none."""
    near = [(weight, *rows[row + shift]) for shift, weight in enumerate(FILTER, -2) if 0 <= row + shift < ROWS]
    weights = sum(weight * count for weight, _, count in near)
    return sum(weight * count * mean for weight, mean, count in near) / weights if weights else None


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: sinkage.py SYSTEM.TOML SERVICE")
    sys.exit(main(sys.argv[1], sys.argv[2]))
