"""A springback method of another package is found by its entry point: in the command, in the node.

In the node: test_own_packages_formed.py.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from own_package import Environment, install, isf, own_method
from quick_cone import quick_cone_file


@pytest.fixture
def environment(tmp_path: Path) -> Environment:
    return own_method(tmp_path)


def test_a_part_is_simulated_with_it(environment: Environment, tmp_path: Path) -> None:
    job = quick_cone_file(tmp_path)
    run = isf(
        environment, "simulate", job, "--correction", "constant", "--no-compare", "--json", "-o", tmp_path / "run"
    )
    assert run.returncode == 0, run.stderr[-2000:]
    assert json.loads(run.stdout)["correction"] == "constant"


def test_an_unknown_method_is_refused_with_the_known_ones(environment: Environment, tmp_path: Path) -> None:
    run = isf(environment, "simulate", quick_cone_file(tmp_path), "--correction", "constnat")
    assert run.returncode == 4
    assert "constant" in run.stderr


def test_a_method_that_cannot_be_loaded_is_named(tmp_path: Path) -> None:
    broken = install(tmp_path, "import nothing_of_that_name", "isf.springback_methods", "constant", "Constant")
    run = isf(broken, "simulate", quick_cone_file(tmp_path), "--correction", "constant")
    assert run.returncode not in (0, 1)
    assert "nothing_of_that_name" in run.stderr
    assert "Traceback" not in run.stderr
