"""A rig of one's own is one file, made by the recipe, and one line of the job."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from own_package import isf, recipe
from quick_cone import CONTOURS, quick_cone_file


@pytest.fixture
def job(tmp_path: Path) -> Path:
    path = quick_cone_file(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines()
    (entry,) = (k for k, line in enumerate(lines) if line.startswith("rig:"))
    lines[entry] = "rig: my_rig.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_a_part_is_simulated_on_it(job: Path, tmp_path: Path) -> None:
    (tmp_path / "my_rig.yaml").write_text(recipe("my_rig.yaml"), encoding="utf-8")
    run = isf(dict(os.environ), "simulate", job, "--no-compare", "--json", "-o", tmp_path / "run")
    assert run.returncode == 0, run.stderr[-2000:]
    assert json.loads(run.stdout)["contours"] == CONTOURS


def test_its_limits_count(job: Path, tmp_path: Path) -> None:
    text = recipe("my_rig.yaml")
    assert "speed: 80 mm/s" in text
    (tmp_path / "my_rig.yaml").write_text(text.replace("80 mm/s", "8 mm/s"), encoding="utf-8")
    run = isf(dict(os.environ), "simulate", job, "--no-compare", "--json", "-o", tmp_path / "run")
    assert run.returncode != 0
    assert "8 mm/s" in json.loads(run.stdout)["error"]["message"]
