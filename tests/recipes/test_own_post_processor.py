"""A post-processor of one's own is one file, made by the recipe, named on the command line."""

from __future__ import annotations

import os
import re
from pathlib import Path

from own_package import isf, recipe
from quick_cone import CONTOURS, quick_cone_file


def test_a_plan_becomes_a_program(tmp_path: Path) -> None:
    post, program = tmp_path / "my_post.yaml", tmp_path / "part.txt"
    post.write_text(recipe("my_post.yaml"), encoding="utf-8")
    job = quick_cone_file(tmp_path)
    run = isf(dict(os.environ), "plan", job, "--export", program, "--format", post, "-o", tmp_path / "run")
    assert run.returncode == 0, run.stderr[-2000:]
    lines = program.read_text(encoding="utf-8").splitlines()
    assert sum(line.startswith("; contour") for line in lines) == CONTOURS
    assert any(re.fullmatch(r"MOVE -?\d+\.\d{3} -?\d+\.\d{3} -?\d+\.\d{3} .*", line) for line in lines)
