"""A tilted tool through real nodes: targets, poses and the nine cells that tilt with it, as in one process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_cell.replay.live_node import play_into
from isf_cell.replay.outcome import replay
from isf_cell.replay.recorded_run import read_run
from isf_cell.replay.what_if import parse
from isf_cell.run import graph_run
from isf_core.files.job import JobFile

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]

JOBS = Path(__file__).resolve().parents[2] / "examples" / "jobs"
CHANGES = {
    "torrao_cone_45.stl": "mini_cone.stl",
    "incremental_depth: 1 mm": "incremental_depth: 4.9 mm",
    "point_spacing: 1 mm": "point_spacing: 2 mm",
    "strategy: auto": "strategy: auto\n  largest_rate: 60 deg/s\ncontrol: {rate: 200 Hz}",
}


def quiet(_: Any) -> None:
    """Feedback that nobody looks at."""


@pytest.mark.slow
def test_a_tilted_tool_forms_the_same_in_the_graph_as_in_one_process(tmp_path: Path) -> None:
    """Tips within 1 um. The cells are turned by poses of 50 Hz: 20 ms at 60 deg/s of 300 N of weight are 6 N."""
    text = (JOBS / "torrao_cone_45_five_axis.yaml").read_text(encoding="utf-8")
    for old, new in CHANGES.items():
        assert old in text
        text = text.replace(old, new)
    job_file = JobFile(text, JOBS)
    _, failure = graph_run.form(job_file, RunOptions(), tmp_path, quiet)
    assert failure is None
    there, here = read_bag(tmp_path / "bag"), in_process.form(job_file)
    assert len(there.results) == len(here.results) == 1
    for formed, mine, theirs in zip(there.corrected, here.results, there.results, strict=True):
        assert formed.tilted
        np.testing.assert_allclose(theirs.forming_target, mine.forming_target, atol=1e-6)
        np.testing.assert_allclose(theirs.forming_force, mine.forming_force, atol=6.0)
        assert np.abs(theirs.forming_force[:, 2]).max() > 10.0
    run = read_run(tmp_path)
    assert run.armed is not None
    assert run.armed.axis == (0.0, 0.0, 1.0)
    assert replay(run, parse([])).identical is True
    assert play_into(run, "force_ctrl", run.job_file(), tmp_path / "logs", {}).identical
    other = play_into(run, "force_ctrl", run.job_file(), tmp_path / "logs", {"compliance_time": 0.1})
    assert not other.identical
    assert other.differing > 0
    assert "compliance_time 0.1 (recorded 0.2)" in other.notes[0]
