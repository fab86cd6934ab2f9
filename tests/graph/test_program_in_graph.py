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

ROUNDING = 0.5e-7 * 1.001
"""m: the export writes four decimals of a millimetre."""


def quiet(_: Any) -> None:
    """Feedback that nobody looks at."""


def test_a_program_forms_what_the_job_does_that_it_was_written_from(tmp_path: Path) -> None:
    """On legs with three load cells, through the graph; the job itself in one process."""
    cone = quick_cone("method: none")
    data = yaml.safe_load(cone.text)
    del data["tool_2"]
    data |= {"process": "SPIF", "rig": "torrao2013", "control": {"rate": "250 Hz"}}
    job = JobFile(yaml.safe_dump(data), cone.base)
    planned = plan(job)
    exports.export(planned, tmp_path / "cone.nc")
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
    np.testing.assert_array_equal(there.target.z, here.target.z)  # that of the part, which the job names
    # contacts come from the tips alone: the compensation of the machine's compliance takes their forecast
    np.testing.assert_allclose(there.scan.z, here.scan.z, atol=20e-6)
    assert here.scan.z.min() < -1e-3
