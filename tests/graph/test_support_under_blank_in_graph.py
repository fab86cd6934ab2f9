"""A support tool under the blank through the node graph: no node moves it with the correction."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_cell.run import graph_run
from isf_core.files.job import JobFile
from quick_cone import CONTOURS, FOLDER, quick_cone

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]


def quiet(_: Any) -> None:
    """Feedback that nobody looks at."""


def test_the_nodes_form_what_one_process_does(tmp_path: Path) -> None:
    """On the sheet that a job gets which the fast one does not know, without asking for it."""
    text = quick_cone().text.replace("path:\n", "path:\n  support: on_blank\n")
    job_file = JobFile(re.sub(r"  (support_force|engage_depth):.*\n", "", text), FOLDER)
    result, failure = graph_run.form(job_file, RunOptions(), tmp_path, quiet)
    assert failure is None, failure
    assert result.contours == CONTOURS
    there, here = read_bag(tmp_path / "bag"), in_process.form(job_file, RunOptions(sheet="shell_coarse"))
    assert there.sheet["model"] == "shell_coarse"
    proof = "kinetic_over_plastic"  # told in /diagnostics
    assert there.sheet[proof] == pytest.approx(here.sheet[proof], rel=0.1)
    for planned, corrected, correction in zip(there.nominal, there.corrected, there.corrections, strict=True):
        assert correction.code == 0
        np.testing.assert_array_equal(corrected.support_tip, planned.support_tip)
        np.testing.assert_allclose(corrected.forming_tip, planned.forming_tip + correction.offset, atol=1e-15)
    assert there.corrections[-1].offset[:, 2].max() < -0.1e-3
    for mine, theirs in zip(here.results, there.results, strict=True):
        np.testing.assert_allclose(theirs.forming_target, mine.forming_target, atol=1e-6)
        np.testing.assert_allclose(theirs.support_target, mine.support_target, atol=1e-6)
        np.testing.assert_allclose(theirs.forming_force, mine.forming_force, atol=0.1)
