"""Passes over the floor on the simulated machine: what stands up in the middle comes down to its level."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from isf_analysis.measures.deviation import compare
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_core.contour import ContourCorrection
from isf_core.files.job import JobFile

JOBS = Path(__file__).resolve().parents[5] / "examples" / "jobs"


def middle(floor_step: str, method: str, scans: int) -> tuple[float, tuple[ContourCorrection, ...]]:
    """m, mean error within 4 mm of the middle of the floor of mini_cone, and the corrections."""
    text = (JOBS / "mini_cone.yaml").read_text(encoding="utf-8")
    assert "rate: 500 Hz" in text
    text = text.replace("rate: 500 Hz", "rate: 100 Hz")  # fewer ticks
    text = text.replace("incremental_depth: 0.5 mm", "incremental_depth: 1 mm")
    text = text.replace("path:\n", f"path:\n  floor_step: {floor_step}\n" if floor_step else "path:\n")
    before, _, _ = text.partition("\nspringback:")
    job_file = JobFile(f"{before}\nspringback: {{method: {method}, scan_every: {scans}, scan_sensor: true}}\n", JOBS)
    record = in_process.form(job_file, RunOptions(seed=0))
    assert record.results[-1].completed
    assert not any(result.lost_messages for result in record.results)  # time that scans take is no loss
    assert record.scan is not None
    error = compare(record.scan, record.target).error
    x, y = np.meshgrid(error.x, error.y)
    return float(error.z[np.hypot(x, y) < 4e-3].mean()), record.corrections


def test_the_floor_comes_down_to_its_level() -> None:
    without, few = middle("", "fused", 1)
    passed, many = middle("2 mm", "fused", 1)
    assert len(many) > len(few)
    assert without > 0.25e-3
    assert abs(passed) < 0.7 * without
    assert not [correction for correction in many if correction.code]


def test_without_scans_the_floor_is_pressed_with_care() -> None:
    passed, corrections = middle("2 mm", "analytic", 0)
    assert passed > -0.3e-3
    wall = np.abs(corrections[4].offset[:, 2]).max()
    assert all(np.abs(correction.offset[:, 2]).max() < wall for correction in corrections[5:])
