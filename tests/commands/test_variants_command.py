"""Variants as a user meets them: one option with two names, sealed runs that say so, scans that are not exact."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
from isf_analysis.measures.summary import summary
from isf_cell.in_process import form
from isf_cell.options import RunOptions
from isf_core.files.job import load_job
from quick_cone import quick_cone, quick_cone_file


def simulated(folder: Path, *options: str) -> tuple[dict[str, Any], str]:
    """Summary and report of the small cone."""
    command = [sys.executable, "-m", "isf_cell.cli", "simulate", str(quick_cone_file(folder)), "--json", *options]
    ended = forked_process.run([*command, "--correction", "none", "-o", "run"], cwd=folder)
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout), (folder / "run" / "report.html").read_text(encoding="utf-8")


def test_a_sealed_variant_is_formed_and_marked_under_the_former_name_of_the_option_too(tmp_path: Path) -> None:
    data, page = simulated(tmp_path, "--world", "101")
    assert (data["variant"], data["sealed"]) == (101, True)
    assert "<b>sealed</b>" in page
    record = form(load_job(quick_cone_file(tmp_path)), RunOptions(correction="none", variant=101))
    assert summary(record)["deviation"]["max_mm"] == pytest.approx(data["deviation"]["max_mm"], abs=1e-9)


@pytest.mark.parametrize(
    ("variant", "scans", "sensor"),
    [
        (0, "", False),
        (20, "", False),
        (0, ", scan_sensor: true", True),
        (21, "", True),
        (21, ", scan_sensor: false", False),
        (101, "", True),
    ],
)
def test_exact_scans_of_a_structural_variant_are_asked_for_by_name(variant: int, scans: str, sensor: bool) -> None:
    job_file = quick_cone("method: none" + scans.replace(", ", "\n  "))
    assert RunOptions(variant=variant).scans_with_sensor(job_file) is sensor


def test_a_part_of_a_structural_variant_with_its_scans() -> None:
    """The cloud reaches beyond the clamp and scatters; the correction goes on with it or says why not."""
    record = form(quick_cone("method: fused\n  scan_every: 1\n  open_loop_contours: 1"), RunOptions(variant=21))
    assert record.failure() is None
    assert record.scans
    points = record.scans[-1].points()
    half = 0.125
    assert np.abs(points[:, :2]).max() > half + 5e-3
    assert not [remark for remark in summary(record)["remarks"] if remark["failed"]]
