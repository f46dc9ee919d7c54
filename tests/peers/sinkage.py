"""A sinkage service in Python: shows that any program can take the place of a service.

In the system file: exec = ["python3", "tests/peers/sinkage.py"]. Needs Python 3.11 and `pip install -r requirements.txt`.

It finds the soil line as the paper does: the mean brightness of each row of the annulus between rim and outer edge, each
half of the wheel on its own, smoothed; the interface is where it changes most.
"""

import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "shared" / "shell" / "python"))
import terrasense_shell  # noqa: E402
from terrasense_messages import PIXELS_MAX, Frame, Sinkage, Status  # noqa: E402


def service(shell):
    config = shell.config(radius_m=0.15, rolls="right")
    frames, sinkage = shell.input("frames", Frame), shell.output("sinkage", Sinkage)
    shell.on_each(frames, sinkage, lambda frame: answer(frame, config))


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
    sys.exit(terrasense_shell.main(service))
