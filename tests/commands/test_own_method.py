"""A springback method of another package is found by its entry point, in the command and in the node."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from quick_cone import quick_cone_file

METHOD = """
import numpy as np
from isf_springback.estimators.estimator import Estimator, Prediction


class Constant(Estimator):
    name = "constant"

    def estimate(self, contour, history):
        return Prediction(np.full(len(contour), 0.7e-3))
"""


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """A package with one method, installed as pip leaves it, and the environment that finds it."""
    site = tmp_path / "site"
    info = site / "my_methods-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "my_methods.py").write_text(METHOD)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-methods\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[isf.springback_methods]\nconstant = my_methods:Constant\n")
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])}


def isf(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "isf_cell.cli", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600, check=False)


def test_a_part_is_simulated_with_it(environment: dict[str, str], tmp_path: Path) -> None:
    job = quick_cone_file(tmp_path)
    run = isf(environment, "simulate", str(job), "--correction", "constant", "--json", "-o", str(tmp_path / "run"))
    assert run.returncode == 0, run.stderr[-2000:]
    numbers = json.loads(run.stdout)
    assert numbers["correction"] == "constant"


@pytest.mark.graph
def test_a_part_is_formed_with_it_through_the_graph(environment: dict[str, str], tmp_path: Path) -> None:
    job = quick_cone_file(tmp_path)
    run = isf(environment, "form", str(job), "--correction", "constant", "--json", "-o", str(tmp_path / "run"))
    assert run.returncode == 0, run.stderr[-2000:]
    assert json.loads(run.stdout)["correction"] == "constant"


def test_an_unknown_method_is_refused_with_the_known_ones(environment: dict[str, str], tmp_path: Path) -> None:
    run = isf(environment, "simulate", str(quick_cone_file(tmp_path)), "--correction", "constnat")
    assert run.returncode == 4
    assert "constant" in run.stderr


def test_a_method_that_cannot_be_loaded_is_named(environment: dict[str, str], tmp_path: Path) -> None:
    Path(environment["PYTHONPATH"].split(os.pathsep)[0], "my_methods.py").write_text("import nothing_of_that_name")
    run = isf(environment, "simulate", str(quick_cone_file(tmp_path)), "--correction", "constant")
    assert run.returncode not in (0, 1)
    assert "nothing_of_that_name" in run.stderr
    assert "Traceback" not in run.stderr
