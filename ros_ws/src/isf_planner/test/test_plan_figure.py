"""The picture of a plan: written for one and two tools, and a place where nothing can be written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_planner import plan
from isf_planner.plan_figure import draw_plan
from matplotlib.image import imread
from planner_parts import Cone, job_for, write


@pytest.mark.parametrize("process", ["SPIF", "DSIF"])
def test_picture(process: str, tmp_path: Path) -> None:
    job_file = job_for(write(Cone().mesh(50e-6), tmp_path / "cone.stl"), depth="1 mm", process=process)
    picture = draw_plan(plan(job_file), job_file, tmp_path / "plan.png")
    pixels = imread(picture)
    assert pixels.shape[:2] == (936, 1560)
    left, upper, lower = pixels[:, :780, :3], pixels[:468, 780:, :3], pixels[468:, 780:, :3]
    for panel in (left, upper, lower):  # ink in every panel
        assert np.mean(panel.min(axis=2) < 0.9) > 0.01
    support_colour = np.array([0xD5, 0x5E, 0x00]) / 255
    support_drawn = np.abs(upper - support_colour).max(axis=2) < 0.1
    assert support_drawn.any() == (process == "DSIF")


def test_folder_that_does_not_exist(tmp_path: Path) -> None:
    job_file = job_for(write(Cone().mesh(50e-6), tmp_path / "cone.stl"), depth="4 mm")
    with pytest.raises(IsfError) as caught:
        draw_plan(plan(job_file), job_file, tmp_path / "none" / "plan.png")
    assert caught.value.code is ErrorCode.FILE_NOT_WRITABLE
