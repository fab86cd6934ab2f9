"""A pocket with a cone on its floor, formed by both tools in turn: who forms, which way it pushes, and what comes out.

The part is F1 / F2 of Praveen 2020, 3.2.1.1, in small (examples/jobs/free_form.yaml).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.measures.record import PartRecord
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_cell.run import graph_run
from isf_core.files.job import JobFile, load_job

JOB = Path(__file__).resolve().parents[2] / "examples" / "jobs" / "free_form.yaml"

FLOOR, TOP = -6e-3, -1e-3

COARSE = {
    "incremental_depth: 0.5 mm": "incremental_depth: 2 mm",
    "point_spacing: 0.8 mm": "point_spacing: 1.6 mm",
    "feed: 60 mm/s": "feed: 90 mm/s",
    "rate: 250 Hz": "rate: 100 Hz",
}
"""Settings of the job exchanged for a part of few ticks."""


@pytest.fixture(scope="module")
def record() -> PartRecord:
    return in_process.form(load_job(JOB), RunOptions(seed=3))


def test_the_tools_swap_once(record: PartRecord) -> None:
    assert record.failure() is None
    assert [contour.forming_tool for contour in record.nominal] == [1] * 12 + [2] * 10
    assert [contour.retract for contour in record.nominal] == [k == 12 for k in range(22)]


def test_the_tool_that_forms_carries_the_force(record: PartRecord) -> None:
    """Fz > 0 on the upper, < 0 on the lower tool; the forming tool carries more than the support tool all along."""
    for contour, result in zip(record.nominal, record.results, strict=True):
        side = 1.0 if contour.forming_tool == 1 else -1.0
        axial = side * float(result.forming_force[:, 2].mean())
        assert axial > 150.0
        assert -side * float(result.support_force[:, 2].mean()) < 0.6 * axial


def test_the_second_feature_stands_on_the_floor(record: PartRecord) -> None:
    """Uncorrected nearly nothing of it would stay; with the analytic correction the plant bends it over its height."""
    assert record.scan is not None
    target, shape = record.target, record.scan
    points = np.stack(np.meshgrid(shape.x, shape.y), axis=-1).reshape(-1, 2)
    wanted, formed = target.at(points), shape.z.ravel()
    floor, top = np.abs(wanted - FLOOR) < 1e-6, np.abs(wanted - TOP) < 1e-6
    inside = np.hypot(*(points - points[top].mean(axis=0)).T) < 10e-3
    assert np.count_nonzero(floor) > 500
    assert np.abs(np.median(formed[floor]) - FLOOR) < 0.3e-3
    height = np.median(formed[top & inside]) - np.median(formed[floor])
    assert 4e-3 < height < 7e-3


@pytest.mark.graph
@pytest.mark.usefixtures("forked_nodes")
def test_graph_and_in_process_agree_when_the_tools_swap(tmp_path: Path) -> None:
    """The contract of docs/reference/architecture.md: 1 um and 0.1 N, also where the lower tool forms; six coarse
    contours."""
    text = JOB.read_text(encoding="utf-8")
    for fine, coarse in COARSE.items():
        assert fine in text
        text = text.replace(fine, coarse)
    job_file = JobFile(text, JOB.parent)
    record = in_process.form(job_file, RunOptions(seed=3))
    assert [contour.forming_tool for contour in record.nominal] == [1] * 3 + [2] * 3
    assert record.corrections[3].offset[:, 2].min() > 1e-3

    def quiet(_: Any) -> None:
        """Feedback that nobody looks at."""

    result, failure = graph_run.form(job_file, RunOptions(seed=3), tmp_path, quiet)
    assert failure is None
    assert result.lost_messages == 0
    graph = read_bag(tmp_path / "bag")
    for mine, theirs in zip(record.results, graph.results, strict=True):
        np.testing.assert_allclose(theirs.forming_target, mine.forming_target, atol=1e-6)
        np.testing.assert_allclose(theirs.support_target, mine.support_target, atol=1e-6)
        np.testing.assert_allclose(theirs.forming_force, mine.forming_force, atol=0.1)
        np.testing.assert_allclose(theirs.support_force, mine.support_force, atol=0.1)
