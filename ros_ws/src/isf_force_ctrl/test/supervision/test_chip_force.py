"""Published: AA1100-O of 1 mm under tools of 4.5 mm on a wall of 65 deg is fine at 120 N and sheds chips at 200 N
(Ren 2018, 2.4.1)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contact_sandbox import ring
from isf_core.contour import Contour
from isf_core.files.job import JobFile
from isf_force_ctrl.supervision.contour_warnings import ChipWatch, chip_warning

JOB = """
name: cone
part: {{mesh: cone.stl, unit: mm}}
process: DSIF
rig: ren2018
sheet: {{material: {material}, thickness: 1 mm}}
tool_1: {{radius: 4.5 mm}}
tool_2: {{radius: 4.5 mm}}
path: {{incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 5 mm/s}}
control: {{support_force: 120 N, engage_depth: 4 mm}}
"""


def wall(angle: float, force: float) -> Contour:
    """A contour on a wall of ``angle`` deg under ``force`` N."""
    contour = ring()
    count = len(contour)
    return replace(contour, wall_angle=np.full(count, np.radians(angle)), support_force=np.full(count, force))


@pytest.mark.parametrize(
    ("material", "angle", "force", "asked", "warns"),
    [
        ("AA1100-O", 65, 120.0, None, False),
        ("AA1100-O", 65, 200.0, None, True),
        ("AA1100-O", 65, 120.0, 200.0, True),
        ("AA1100-O", 65, 200.0, 0.0, False),
        # the same horizontal force presses harder on a flatter wall: 120 N / sin 40 deg are 187 N, chips from 170 N on
        ("AA1100-O", 40, 120.0, None, True),
        ("AA5754-O", 65, 200.0, None, False),
    ],
)
def test_forces_that_shed_chips_are_warned_of(
    material: str, angle: float, force: float, asked: float | None, warns: bool
) -> None:
    job = JobFile(JOB.format(material=material), Path("/"))
    text = chip_warning(job, wall(angle, force), asked)
    assert bool(text) == warns
    assert not warns or (f"{force if asked is None else asked:.0f} N" in text and f"{angle} deg" in text)


def test_the_flattest_place_is_reported_and_position_control_is_fine() -> None:
    job = JobFile(JOB.format(material="AA1100-O"), Path("/"))
    contour = wall(65, 120.0)
    angle = contour.wall_angle.copy()
    angle[7] = np.radians(30)
    assert "30 deg" in chip_warning(job, replace(contour, wall_angle=angle), None)
    assert chip_warning(job, replace(contour, wall_angle=angle, support_force=np.empty(0)), None) == ""


def test_a_plan_is_warned_of_once() -> None:
    watch = ChipWatch(JobFile(JOB.format(material="AA1100-O"), Path("/")), None)
    reported = [watch.check(wall(65, force)) for force in (120.0, 200.0, 220.0)]
    assert [bool(text) for text in reported] == [False, True, False]
