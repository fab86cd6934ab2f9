"""Published: AA1100-O of 1 mm under tools of 4.5 mm is fine at 120 N and sheds chips at 200 N (Ren 2018, 2.4.1)."""

from pathlib import Path

import pytest
from isf_core.job import JobFile
from isf_force_ctrl.chip_force import chip_warning

JOB = """
name: cone
part: {{mesh: cone.stl, unit: mm}}
process: DSIF
rig: ren2018
sheet: {{material: {material}, thickness: 1 mm}}
tool_1: {{radius: 4.5 mm}}
tool_2: {{radius: 4.5 mm}}
path: {{incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 5 mm/s}}
control: {{support_force: {force} N, engage_depth: 4 mm}}
"""


@pytest.mark.parametrize(
    ("material", "force", "asked", "warns"),
    [
        ("AA1100-O", 120, None, False),
        ("AA1100-O", 200, None, True),
        ("AA1100-O", 120, 200.0, True),
        ("AA1100-O", 200, 0.0, False),
        ("AA5754-O", 200, None, False),
    ],
)
def test_forces_that_shed_chips_are_warned_of(material: str, force: int, asked: float | None, warns: bool) -> None:
    job = JobFile(JOB.format(material=material, force=force), Path("/"))
    text = chip_warning(job, asked)
    assert bool(text) == warns
    assert not warns or ("200 N" in text and "AA1100-O" in text)
