"""A process of another package, made by the recipe, plans and forms parts under its own name.

Through the graph: test_own_packages_formed.py.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from own_package import Environment, install, isf, job_with_own_process, own_process
from quick_cone import CONTOURS

GROUP = "isf.processes"


@pytest.fixture
def environment(tmp_path: Path) -> Environment:
    return own_process(tmp_path)


@pytest.fixture
def job(tmp_path: Path) -> Path:
    return job_with_own_process(tmp_path)


def test_it_plans(environment: Environment, job: Path, tmp_path: Path) -> None:
    run = isf(environment, "plan", job, "--json", "-o", tmp_path / "run")
    assert run.returncode == 0, run.stderr[-2000:]
    assert json.loads(run.stdout)["contours"] == CONTOURS + 1


def test_a_part_is_simulated_with_it(environment: Environment, job: Path, tmp_path: Path) -> None:
    run = isf(environment, "simulate", job, "--no-compare", "--json", "-o", tmp_path / "run")
    assert run.returncode == 0, run.stderr[-2000:]
    assert json.loads(run.stdout)["contours"] == CONTOURS + 1


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("import nothing_of_that_name", "nothing_of_that_name"),
        ("class FloorTwice: kind = 'DSIF'", "isf_planner.processes.FormingProcess"),
        ("class FloorTwice: kind = 'HYDROFORMING'", "HYDROFORMING"),
    ],
)
def test_what_is_no_process_is_refused(source: str, words: str, job: Path, tmp_path: Path) -> None:
    run = isf(install(tmp_path, source, GROUP, "DSIF_FLOOR_TWICE", "FloorTwice"), "plan", job)
    assert run.returncode not in (0, 1)
    assert words in run.stderr
    assert "Traceback" not in run.stderr


def test_a_process_that_is_not_installed_is_refused_with_the_known_ones(job: Path) -> None:
    run = isf(install(job.parent, "", "nothing", "nothing", "Nothing"), "plan", job)
    assert run.returncode not in (0, 1)
    assert "DSIF_FLOOR_TWICE" in run.stderr
    assert "ADSIF, DSIF, SPIF, TPIF" in run.stderr
