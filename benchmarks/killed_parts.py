"""Parts whose processes are killed at random, and then go on: how far is the finished part from the undisturbed one?

usage: ./isf python benchmarks/killed_parts.py [--kills 4] [--methods none elastic fused]

Forms a quick cone in lockstep once for each method. Then again and again: kill -9 of the command, of one node or of
all, at a random time in a random contour; the part goes on with --resume until it is complete. Per kill a row of a
table: what was killed and when, where it went on, the largest difference of the finished part.
"""

from __future__ import annotations

import argparse
import os
import random
import select
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.measures.record import PartRecord
from isf_cell.run.checkpoint import CHECKPOINT, CheckpointFolder
from isf_core.errors import IsfError

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from quick_cone import LONGER, quick_cone  # noqa: E402

VICTIMS = ("command", "machine", "springback", "force_ctrl", "planner", "executive", "recorder", "all")
SPRINGBACK = {
    "none": "method: none",
    "analytic": "method: analytic",
    "elastic": "method: elastic",
    "fused": "method: fused\n  scan_every: 1",
}


def command(*words: str) -> list[str]:
    """``isf form`` in a process of its own."""
    return [sys.executable, "-m", "isf_cell.cli", "form", *words, "--no-compare"]


def children_of(number: int) -> dict[str, int]:
    """Nodes that the command ``number`` started, by their names."""
    found = subprocess.run(["pgrep", "-a", "-P", str(number)], capture_output=True, text=True, check=False).stdout
    lines = (line.split(" ", 1) for line in found.splitlines())
    return {name: int(pid) for pid, words in lines for name in VICTIMS if f"/{name} --ros-args" in words}


def formed_with_a_kill(words: list[str], victim: str, contour: int, delay: float) -> bool:
    """Run the command and kill ``victim`` ``delay`` s after ``contour`` (from 1) was formed; True when it was."""
    process = subprocess.Popen(command(*words), stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    assert process.stderr is not None
    killed: dict[str, int] = {}
    ends: list[int] = []
    for line in process.stderr:
        if f"contour {contour}/" in line and not killed:
            killed = children_of(process.pid)
            ends = [os.pidfd_open(number) for number in killed.values()]
            time.sleep(delay)  # drawn at random: where in the contour the kill comes
            chosen = {"all": [process.pid, *killed.values()], "command": [process.pid]}.get(victim)
            for number in chosen or [killed[name] for name in [victim] if name in killed]:
                with suppress(ProcessLookupError):  # the part was faster
                    os.kill(number, signal.SIGKILL)
    process.wait()
    for end in ends:  # nodes that were not killed see that their command is gone
        select.select([end], [], [])
        os.close(end)
    return bool(killed)


def resumed(folder: Path) -> int:
    """Exit code of the part that goes on."""
    return subprocess.run(command("--resume", str(folder)), capture_output=True, check=False).returncode


def difference(record: PartRecord, whole: PartRecord) -> tuple[float, float]:
    """Largest difference of the shape and of the corrections, m; NaN: the part is not complete."""
    if record.failure() is not None or record.scan is None or whole.scan is None:
        return np.nan, np.nan
    pairs = zip(record.corrections, whole.corrections, strict=True)
    offset = max(float(np.abs(a.offset - b.offset).max()) for a, b in pairs)
    return float(np.nanmax(np.abs(record.scan.z - whole.scan.z))), offset


def main() -> None:
    """Form, kill, go on, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=4, help="for each method")
    parser.add_argument("--methods", nargs="+", choices=list(SPRINGBACK), default=["none", "elastic", "fused"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--step", default=LONGER, help="depth of a contour")
    asked = parser.parse_args()
    chance = random.Random(asked.seed)
    print("| method | killed | after contour | went on at | exit code | shape [um] | corrections [um] |")
    print("|---|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as where:
        for method in asked.methods:
            job = quick_cone(SPRINGBACK[method], step=asked.step)
            path = Path(where) / f"{method}.yaml"
            path.write_text(job.text.replace("../parts", str(ROOT / "examples" / "parts")), encoding="utf-8")
            whole = Path(where) / f"{method}_whole"
            begin = time.monotonic()
            subprocess.run(command(str(path), "-o", str(whole)), capture_output=True, check=False)
            print(f"{method}: whole part {time.monotonic() - begin:.0f} s", file=sys.stderr, flush=True)
            record = read_bag(whole / "bag")
            for k in range(asked.kills):
                folder = Path(where) / f"{method}_{k}"
                victim, contour = chance.choice(VICTIMS), chance.randint(1, record.planned - 1)
                delay = chance.uniform(0.0, 3.0)
                if not formed_with_a_kill([str(path), "-o", str(folder)], victim, contour, delay):
                    print(f"| {method} | {victim} | {contour} | ended before | - | - | - |", flush=True)
                    continue
                try:
                    went_on = CheckpointFolder(folder / CHECKPOINT).read().next_index + 1
                except IsfError as error:  # before the first checkpoint, or all was formed
                    print(f"| {method} | {victim} | {contour} | {error.code.name} | - | - | - |", flush=True)
                    continue
                code = resumed(folder)
                shape, offset = difference(read_bag(folder / "bag"), record)
                row = (method, victim, contour, went_on, code, f"{1e6 * shape:.3f}", f"{1e6 * offset:.3f}")
                print("| " + " | ".join(map(str, row)) + " |", flush=True)


if __name__ == "__main__":
    main()
