"""All parameters of all nodes read and set to what they are, again and again in a running part: is it the same part?

usage: ./isf python benchmarks/parameters_while_forming.py [--rounds 1000] [--step "0.24 mm"]

Forms a cone in lockstep twice, with springback and force control: alone, and with a tool that goes round the nodes
(get all, set all at once) from the first formed contour on. Prints how many rounds were done in the part, and every
recorded array that is not the same bit for bit; exit code 1 if there is one, or if there were fewer rounds than asked.
Six minutes on two busy cores.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.measures.record import PartRecord
from isf_cell.options import RunOptions
from isf_cell.run import graph_run

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from parameter_rounds import ParameterRounds  # noqa: E402
from quick_cone import quick_cone  # noqa: E402

NODES = ["machine", "planner", "springback", "force_ctrl", "executive", "recorder", "cell_state_publisher"]
RESULT = (
    "forming_force", "support_force", "forming_target", "support_target", "force_offset", "compliance_offset",
    "tick_time", "tick_set_point", "tick_normal_force", "tick_engaged",
)  # fmt: skip
"""Of a contour's result; not the measured tips, whose messages are best effort."""


def differences(one: PartRecord, other: PartRecord) -> list[str]:
    """Names of what is not the same bit for bit."""
    pairs: dict[str, tuple[Any, Any]] = {"number of contours": (len(one.results), len(other.results))}
    for k, (a, b) in enumerate(zip(one.results, other.results, strict=False), start=1):
        pairs |= {f"contour {k}: {name}": (getattr(a, name), getattr(b, name)) for name in RESULT}
    for k, (a, b) in enumerate(zip(one.corrections, other.corrections, strict=False), start=1):
        pairs[f"contour {k}: correction"] = (a.offset, b.offset)
    pairs["scan"] = tuple(np.nan if item.scan is None else item.scan.z for item in (one, other))
    return [name for name, (a, b) in pairs.items() if not np.array_equal(a, b, equal_nan=True)]


def formed(folder: Path, step: str, rounds: ParameterRounds | None) -> PartRecord:
    """The part, with ``rounds`` from its first formed contour on."""

    def heard(feedback: Any) -> None:
        if rounds is not None and feedback.index > 0:
            rounds.start()

    folder.mkdir()
    _, failure = graph_run.form(quick_cone(step=step), RunOptions(), folder, heard)
    if rounds is not None:
        rounds.stop()
    if failure is not None:
        raise failure
    return read_bag(folder / "bag")


def main() -> int:
    """Form, form again, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=1000)
    parser.add_argument("--step", default="0.24 mm", help="depth of a contour")
    asked = parser.parse_args()
    rounds = ParameterRounds(NODES, asked.rounds)
    with tempfile.TemporaryDirectory() as where:
        alone = formed(Path(where) / "alone", asked.step, None)
        print(f"alone: {len(alone.results)} contours in {alone.wall_time:.0f} s", flush=True)
        beside = formed(Path(where) / "beside", asked.step, rounds)
    print(f"{rounds.done} rounds over {rounds.parameters} parameters of {len(NODES)} nodes in {rounds.seconds:.0f} s")
    print(f"beside: {len(beside.results)} contours in {beside.wall_time:.0f} s")
    other = differences(alone, beside)
    print("not the same: " + "; ".join(other) if other else "the part is the same bit for bit")
    if rounds.failure:
        print(rounds.failure)
    return int(bool(other or rounds.failure or rounds.done < asked.rounds))


if __name__ == "__main__":
    sys.exit(main())
