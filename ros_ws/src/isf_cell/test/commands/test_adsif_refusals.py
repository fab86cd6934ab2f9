"""Command and springback session refuse to correct ADSIF parts, wherever the method comes from."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import forked_process
import numpy as np
import pytest
from isf_cell.commands.exit_codes import Exit
from isf_core.errors import ErrorCode
from isf_core.files.job import load_job
from isf_planner.planning import plan
from isf_springback.methods import method_names
from isf_springback.session import CorrectionSession

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "adsif_cone.yaml"


@pytest.mark.parametrize(
    ("options", "where"),
    [(("--correction", "analytic"), "--correction"), (("--support-force", "120"), "--support-force")],
)
@pytest.mark.parametrize("command", ["simulate", "form"])
def test_an_option_that_adsif_cannot_follow_is_refused(
    command: str, options: tuple[str, str], where: str, tmp_path: Path
) -> None:
    arguments = [sys.executable, "-m", "isf_cell.cli", command, str(JOB), *options, "--json"]
    ended = forked_process.run(arguments, cwd=tmp_path)
    assert ended.returncode == Exit.INPUT
    error = json.loads(ended.stdout)["error"]
    assert error["name"] == "FILE_FIELD"
    assert error["message"].startswith(f"{where}: process ADSIF")
    assert list(tmp_path.iterdir()) == []


def test_a_method_set_by_parameter_corrects_no_adsif_contour() -> None:
    """The node's parameter outranks the job; with none of the methods does a contour leave its plane."""
    job_file = load_job(JOB)
    contour = plan(job_file).contours[0]
    for name in method_names():
        session = CorrectionSession(timeout=0.0)
        session.choose(name)
        session.set_job(job_file)
        session.add_contour(contour)
        outcome = session.advance()
        assert outcome is not None
        if name == "none":
            assert outcome.corrected is not None
            np.testing.assert_array_equal(outcome.corrected.forming_tip, contour.forming_tip)
        else:
            assert (outcome.correction.code, outcome.corrected) == (ErrorCode.FILE_FIELD, None)
