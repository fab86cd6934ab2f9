"""The benchmarks that the manual names still run: each in its smallest form, for its rows, not for its times."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import forked_process
import pytest

ROOT = Path(__file__).resolve().parents[2]

SMALLEST = [
    ("mpc", "", r"\| fused\(analytic\): scan, then correction of one contour \| \d+ \+ \d+ \|"),
    ("axial_force", "--cells 5 --radius 14 --depth 4 --step 1", r"\| 5 \| 256 \| \d+ \+- \d+ \| 962 \|"),
    ("force_ctrl_tick", "--ticks 500 --repeats 1", r"\| 500 \| 1 \| [\d.]+ \|"),
    ("kinematics", "", r'"iterations": [1-3],'),
    ("plant_speed", "--step 4 --repeat 1 --ticks 100", r"100 ticks in real time: median \d+ us"),
    ("both_loops", "--jobs mini_cone --corrections none --factors 0 --worlds 0", r"\| mini_cone \| none \| 120 N \|"),
    ("force_control", "--jobs mini_cone --contours 3", r"\| mini_cone, 3 contours \| 120 \| 0 \|"),
    ("steep_parts", "--facets 12000", r"\d+ facets; processor time [\d.]+ s for features, [\d.]+ s for shapes"),
    (
        "tent_effect",
        "--sheets fast --half 35 --upper 18 --lower 5 --step 2 --passes 55",
        r"\| fast \| \+0\.0\d \|",
    ),
    (
        "unseen_shapes",
        "--sheet fast --shapes two_pockets --methods none --step 3.3",
        r"\| two_pockets \| none \| 1 of 1 \| [\d.]+ / [\d.]+ \| - \| ",
    ),
    ("hostile_files", "--count 40 --kinds job points mesh.obj-text request", r"unexpected 0, over 5 s 0, over 1 GB 0"),
    ("springback", "--jobs mini_cone --methods none --worlds 0", r"\| mini_cone \| none \| 1 \|"),
]


@pytest.mark.parametrize(("name", "arguments", "row"), SMALLEST, ids=[name for name, *_ in SMALLEST])
def test_a_benchmark_prints_its_rows(name: str, arguments: str, row: str, tmp_path: Path) -> None:
    assert_prints(name, arguments, row, tmp_path)


@pytest.mark.graph
@pytest.mark.clock
def test_the_benchmark_of_real_time_prints_its_row(tmp_path: Path) -> None:
    arguments = "--rates 250 --seconds 1 --settle 0.5 --load quiet --scheduling ordinary"
    assert_prints("real_time", arguments, r"\| 250 \| quiet \| ordinary \| [\d.]+", tmp_path)


@pytest.mark.graph
def test_the_soak_prints_its_rows(tmp_path: Path) -> None:
    assert_prints("soak", "--parts 1", r"\| force_ctrl \| [\d.]+ \| [\d.]+ \| [+-]0.0% \|", tmp_path)


def assert_prints(name: str, arguments: str, row: str, folder: Path) -> None:
    """Run a benchmark in ``folder``: it ends well and prints ``row`` (regular expression)."""
    command = [sys.executable, str(ROOT / "benchmarks" / f"{name}.py"), *arguments.split()]
    done = forked_process.run(command, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(row, done.stdout), done.stdout
