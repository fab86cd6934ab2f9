"""Scans between contours through the node graph against the same cores in one process, and learning from the bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag_reader import read_bag
from isf_cell import graph_run, in_process
from isf_cell.commands.learn import learn_record
from isf_cell.options import RunOptions
from isf_core.job import JobFile

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "examples" / "jobs"
TEXT = (FOLDER / "mini_cone.yaml").read_text(encoding="utf-8")


def quiet(_: Any) -> None:
    """Feedback that nobody looks at."""


def job(springback: str) -> JobFile:
    assert "method: analytic" in TEXT
    return JobFile(TEXT.replace("method: analytic", springback), FOLDER)


@pytest.mark.graph
def test_graph_and_in_process_agree_with_scans(tmp_path: Path) -> None:
    """1 um, contour by contour; scans after every third contour as a scanner would be used on a long part."""
    job_file = job("method: fused\n  scan_every: 3")
    _, failure = graph_run.form(job_file, RunOptions(seed=5), tmp_path, quiet)
    assert failure is None
    there, here = read_bag(tmp_path / "bag"), in_process.form(job_file, RunOptions(seed=5))
    assert [c.code for c in there.corrections] == [0] * there.planned
    for mine, theirs in zip(here.corrections, there.corrections, strict=True):
        np.testing.assert_allclose(theirs.offset, mine.offset, atol=1e-6)
        assert theirs.remarks == mine.remarks
    assert here.corrections[-1].uncertainty.mean() < here.corrections[1].uncertainty.mean()
    known = learn_record(there, FOLDER)
    assert known.parts == 1
    assert np.abs(known.push).max() > 1e-3
