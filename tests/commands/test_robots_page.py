"""The commands of the page on robots, as they stand there: what a plan says of the arm, and the part it forms."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import forked_process
import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "own_cell" / "robots.md"


def lines(name: str) -> list[list[str]]:
    """Arguments of the page's ``isf`` commands of this ``name``, paths made absolute."""
    blocks = re.findall(r"^```sh\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    found = [shlex.split(line, comments=True) for line in "".join(blocks).splitlines()]
    return [
        [str(ROOT / word) if word.startswith("examples/") else word for word in words[1:]]
        for words in found
        if words[:2] == ["./isf", name]
    ]


def isf(arguments: list[str], cwd: Path) -> subprocess.CompletedProcess[str]:
    return forked_process.run([sys.executable, "-m", "isf_cell.cli", *arguments], cwd=cwd)


def test_the_plan_says_what_the_arm_does(tmp_path: Path) -> None:
    plain = lines("plan")[0]
    done = isf([*plain, "--json"], tmp_path)
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    (arm,) = data["machine"]["arms"]
    assert data["machine"]["kinematics"] == "arm"
    assert 40.0 < arm["joint_margin_deg"] < 60.0
    assert 40.0 < arm["singular_deg"] < 50.0
    assert arm["joint_speed_share"] < 0.05
    assert (arm["clearance_of"], arm["clearance_to"]) == ("tool holder", "clamp")
    assert 0.9 < arm["gives_way_mm"] < 1.1
    assert Path(tmp_path / data["machine"]["picture"]).stat().st_size > 20_000


@pytest.mark.parametrize("number", range(1, 6))
def test_the_programs_of_the_page_are_written(number: int, tmp_path: Path) -> None:
    arguments = lines("plan")[number]
    done = isf([*arguments, "--json"], tmp_path)
    assert done.returncode == 0, done.stderr
    files = [tmp_path / name for name in json.loads(done.stdout)["files"]]
    assert len(files) == (2 if "robot_pair" in arguments[1] else 1)
    assert all(file.stat().st_size > 10_000 for file in files)


@pytest.mark.slow
def test_the_compensated_arm_forms_as_a_stiff_machine(tmp_path: Path) -> None:
    """0.196 mm RMS is what a stiff machine leaves of this part (the page's table)."""
    done = isf([*lines("simulate")[0], "--json"], tmp_path)
    assert done.returncode == 0, done.stderr
    error = json.loads(done.stdout)["deviation"]
    assert error["rms_mm"] == pytest.approx(0.196, abs=0.03)
