"""Runs the cycle once: writes the dataflow into the run's folder and hands it to `dora run`."""

import argparse
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
INPUTS = {
    "source": {"terrain": "terrain/terrain"},
    "sinkage": {"frames": "source/frames"},
    "terramechanics": {"sinkage": "sinkage/sinkage", "wheel": "source/wheel"},
    "terrain": {"soil": "terramechanics/soil", "sinkage": "sinkage/sinkage"},
}
OUTPUTS = {"source": "frames, wheel", "sinkage": "sinkage", "terramechanics": "soil", "terrain": "terrain"}


def dataflow(module, words, cpus):
    """The dataflow as YAML: frames wait 8 at the most, everything else 64, as elsewhere."""
    text = "nodes:\n"
    for role, cpu in zip(INPUTS, cpus):
        placed = f" --cpu {cpu}" if cpu else ""
        text += f"  - id: {role}\n    path: {HERE}/node.py\n"
        text += f"    args: {module} --role {role} {words}{placed}\n"
        text += "    env:\n      RUST_BACKTRACE: 0\n      RUST_LIB_BACKTRACE: 0\n    inputs:\n"
        for wire, writer in INPUTS[role].items():
            queue = 8 if wire == "frames" else 64
            text += f"      {wire}: {{ source: {writer}, queue_size: {queue} }}\n"
        text += f"    outputs: [{OUTPUTS[role]}]\n"
    return text


def main():
    parser = argparse.ArgumentParser()
    for word in ["--folder", "--pace", "--cycles", "--warm-up"]:
        parser.add_argument(word, required=True)
    parser.add_argument("--role")
    parser.add_argument("--cpu", default="")
    parser.add_argument("--module", required=True)
    parser.add_argument("--cpus", default=",,,")
    told = parser.parse_args()
    words = f"--folder {told.folder} --pace {told.pace} --cycles {told.cycles} --warm-up {told.warm_up}"
    path = Path(told.folder) / "dataflow.yml"
    path.write_text(dataflow(told.module, words, told.cpus.split(",")))
    programs = Path(sys.executable).parent
    os.environ["PATH"] = f"{programs}:{os.environ['PATH']}"
    with open(Path(told.folder) / "log", "w") as log:
        run = subprocess.run([programs / "dora", "run", path], cwd=told.folder, stdout=log, stderr=log, check=False)
    if run.returncode != 0:
        print((Path(told.folder) / "log").read_text()[-4000:], file=sys.stderr)
    return run.returncode


sys.exit(main())
