"""A program formed through real nodes: the path and the shape of the job that it was written from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from isf_analysis.bag.bag_reader import read_bag
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_cell.run import graph_run
from isf_core.files.job import JobFile
from isf_planner import exports, plan
from quick_cone import quick_cone

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]

ROUNDING = 2e-7
"""m: the export writes four decimals of a millimetre of the point on the axis, and the axis itself rounded."""


def quiet(_: Any) -> None:
    """Feedback that nobody looks at."""


def test_a_program_forms_what_the_job_does_that_it_was_written_from(tmp_path: Path) -> None:
    """On legs with three load cells and a tilted tool, through the graph; the job itself in one process."""
    cone = quick_cone("method: none")
    data = yaml.safe_load(cone.text)
    del data["tool_2"]
    data |= {"process": "SPIF", "rig": "torrao2013", "control": {"rate": "250 Hz"}}
    data["tool_axis"] = {"strategy": "five_axis", "largest_tilt": "20 deg"}
    job = JobFile(yaml.safe_dump(data), cone.base)
    planned = plan(job)
    exports.export(planned, tmp_path / "cone.nc")
    del data["tool_axis"]  # the program says it
    data["part"]["mesh"] = str(job.mesh)
    depth = data["path"]["incremental_depth"]
    # points that are planned 1 mm apart are so to 0.5 %: none is put between them
    data["path"] = {"program": "cone.nc", "incremental_depth": depth, "point_spacing": "2 mm"}
    program = JobFile(yaml.safe_dump(data), tmp_path)

    result, failure = graph_run.form(program, RunOptions(), tmp_path / "run", quiet)
    assert failure is None, failure
    assert result.contours == len(planned.contours) == 3
    there, here = read_bag(tmp_path / "run" / "bag"), in_process.form(job)
    for mine, theirs in zip(planned.contours, there.nominal, strict=True):
        assert theirs.closed == mine.closed
        np.testing.assert_allclose(theirs.forming_tip, mine.forming_tip, atol=ROUNDING)
        np.testing.assert_allclose(theirs.forming_axis, mine.forming_axis, atol=1e-6)
    np.testing.assert_array_equal(there.target.z, here.target.z)  # that of the part, which the job names
    # contacts come from the tips alone: the compensation of the machine's compliance takes their forecast
    apart = np.abs(there.scan.z - here.scan.z)
    assert np.quantile(apart, 0.999) < 30e-6
    assert apart.max() < 60e-6  # once two neighbouring points were 40 um apart
    assert here.scan.z.min() < -1e-3

    log = np.loadtxt(tmp_path / "run" / "operator_log.txt")  # written while it was formed, without being asked for
    assert log.shape[1] == 12
    step = np.diff(log[:, 0])
    assert 0.0499 < step.min() <= step.max() < 0.0561  # the 20 Hz of the log in ticks of 4 ms
    assert log[-1, 0] == pytest.approx(result.sim_time, abs=2.0)
    deepest = 1e3 * min(float(contour.forming_tip[:, 2].min()) for contour in planned.contours)
    assert log[:, 3].min() == pytest.approx(deepest, abs=0.3)  # legs and tool give way
    assert np.abs(log[:, 4:6]).max() == pytest.approx(19.5, abs=1.0)  # about x and y, of 20 deg in all directions
    np.testing.assert_allclose(log[:, 6], 0.0, atol=0.5)  # a tool has no roll
    measured = max(float(np.linalg.norm(one.forming_force, axis=1).max()) for one in there.results)
    assert np.linalg.norm(log[:, 7:10], axis=1).max() == pytest.approx(measured, rel=0.2)
