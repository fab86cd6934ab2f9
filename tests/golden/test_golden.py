"""Recorded runs give the same results as when they were recorded.

A change of files or structure is compared bit for bit on one computer (``./test.sh tests/golden --exact``); another
processor or version of numpy rounds differently, so without that option every number has a bound, see golden_values.
A wanted change of results is recorded anew: ``./isf python tests/golden/record.py NAME...``.
"""

from __future__ import annotations

from pathlib import Path

import golden_cell as cell
import golden_values
import numpy as np
import pytest
from golden_cases import ANALYTIC, CASES, EXAMPLES, JOBS, LIFTS, LONG_PLANS, RECORDED, SCANS, SENSOR, Case
from golden_values import Quantity, Series, differences

MAXIMUM_REPORTED = 15
"""Lines of a failure."""

IN_GRAPH = {Quantity.LENGTH: 1000.0, Quantity.FORCE: 100.0}
"""1 um and 0.1 N: the contract of docs/reference/architecture.md between the node graph and one process."""


def _case(name: str) -> Case:
    return next(case for case in CASES if case.name == name)


def _reported(found: list[str], name: str) -> str:
    more = [f"... and {len(found) - MAXIMUM_REPORTED} more series"] if len(found) > MAXIMUM_REPORTED else []
    return "\n".join([f"{name} differs from its record in {len(found)} series:", *found[:MAXIMUM_REPORTED], *more])


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=() if case.always else pytest.mark.slow, id=case.name) for case in CASES]
)
def test_run_gives_what_was_recorded(case: Case, pytestconfig: pytest.Config) -> None:
    exact = pytestconfig.getoption("--exact")
    found = differences(golden_values.read(case.file), case.series(), exact=exact, factor=case.factor)
    assert not found, _reported(found, case.name)


@pytest.mark.slow  # every run has tests/graph/test_measurements_in_graph.py
@pytest.mark.graph
@pytest.mark.usefixtures("forked_nodes")
@pytest.mark.parametrize(
    ("name", "job", "springback"),
    [
        ("dsif_cone_fused", "dsif_cone", f"method: fused, {SENSOR}, {LIFTS}, {ANALYTIC}"),
        ("tpif_cone_none", "tpif_cone", "method: none"),
        ("adsif_cone_none_whole", "adsif_cone", "method: none"),
        ("stages_fused", "stages", f"method: fused, {SCANS}, {ANALYTIC}"),
        ("pocket_and_dome_fused", "pocket_and_dome", f"method: fused, {SENSOR}, {LIFTS}, {ANALYTIC}"),
    ],
)
def test_node_graph_gives_what_was_recorded_in_process(name: str, job: str, springback: str, tmp_path: Path) -> None:
    kept = ("offset", "forming_target", "support_target", "forming_force", "support_force", "code", "scan.z", "kind")
    series = cell.formed_in_graph(JOBS / f"{job}.yaml", springback, tmp_path, seed=3)
    recorded = golden_values.read(_case(name).file)
    assert set(recorded) == set(series)
    found = differences(
        {key: entry for key, entry in recorded.items() if key.endswith(kept)},
        {key: item for key, item in series.items() if key.endswith(kept)},
        factor=IN_GRAPH,
    )
    assert not found, _reported(found, name)


def test_a_gain_off_by_a_millionth_is_found() -> None:
    """5 mm of correction are off by 5 nm, of which the bounds let 1 nm pass."""
    series = cell.formed(JOBS / "dsif_cone.yaml", "method: analytic, gain: 1.000001", seed=3)
    found = differences(golden_values.read(_case("dsif_cone_analytic").file), series)
    assert any(line.startswith("correction.offset: contour ") and "nm, recorded" in line for line in found)


def test_a_last_bit_is_found_when_asked_for() -> None:
    values = np.linspace(0.0, 1e-3, 100)
    recorded = {"tip": Series(Quantity.LENGTH, [values]).entry()}
    values[17] = np.nextafter(values[17], 1.0)
    assert differences(recorded, {"tip": Series(Quantity.LENGTH, [values])}) == []
    found = differences(recorded, {"tip": Series(Quantity.LENGTH, [values])}, exact=True)
    assert found == ["tip: is not the same bit for bit, within the bound of 1 nm"]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.zeros((9, 3)), "has the shape [9, 3], recorded [10, 3]"),
        (np.full((10, 3), [0.0, 3e-9, 0.0]), "kept row 0[1] 3 nm, recorded 0, differs by 3"),
        (np.full((10, 3), np.nan), "nan nm, recorded 0, differs by inf"),
    ],
)
def test_what_differs_is_reported_with_place_and_size(values: np.ndarray, words: str) -> None:
    recorded = {"tip": Series(Quantity.LENGTH, [np.zeros((10, 3))]).entry()}
    (found,) = differences(recorded, {"tip": Series(Quantity.LENGTH, [values])}, exact=True)
    assert words in found
    assert differences(recorded, {"tip": Series(Quantity.LENGTH, [np.zeros((10, 3))])}, exact=True) == []


def test_every_process_method_and_example_is_compared_in_every_test_run() -> None:
    always = [case for case in CASES if case.always]
    assert {case.process for case in always} - {""} == {"SPIF", "DSIF", "TPIF", "ADSIF"}
    assert {case.method for case in always} - {""} == cell.method_names(JOBS / "dsif_cone.yaml")
    assert {f"plan_{job.stem}" for job in EXAMPLES if job.stem not in LONG_PLANS} <= {case.name for case in always}
    assert {path.stem for path in RECORDED.glob("*.json")} == {case.name for case in CASES}
