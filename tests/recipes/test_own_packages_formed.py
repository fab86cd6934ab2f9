"""A part formed through the graph by the command, with a process and a springback method of other packages.

The middleware prints to standard output meanwhile, and ``--json`` is still one object there.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from noisy_middleware import COMPLAINT, noise
from own_package import isf, job_with_own_process, own_method, own_process
from quick_cone import CONTOURS

pytestmark = pytest.mark.graph


def test_a_part_is_formed_with_both_through_the_graph(tmp_path: Path) -> None:
    sites = [
        own_process(tmp_path / "process", module="my_process")["PYTHONPATH"],
        own_method(tmp_path / "method", module="my_method")["PYTHONPATH"],
    ]
    environment = {**os.environ, **noise(tmp_path), "PYTHONPATH": os.pathsep.join(sites)}
    options = ("--correction", "constant", "--no-compare", "--json", "-o", tmp_path / "run")
    run = isf(environment, "form", job_with_own_process(tmp_path), *options)
    assert run.returncode == 0, run.stderr[-2000:]
    data = json.loads(run.stdout)
    assert data["complete"] is True
    assert data["contours"] == CONTOURS + 1
    assert data["correction"] == "constant"
    assert COMPLAINT in run.stderr  # it is not lost either
