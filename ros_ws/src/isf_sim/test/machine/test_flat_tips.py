"""Tools with a flat tip: on the elasto-plastic sheet a disc with a rounded edge, refused by the fast one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.simulated_sheet import default_sheet
from isf_sim.machine import tick as mt
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.plant_constants import PlantConstants

EXAMPLES = Path(__file__).resolve().parents[5] / "examples" / "jobs"

JOB = """
name: flat
part: {mesh: ../parts/mini_cone.stl, unit: mm}
process: DSIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 8 mm, corner_radius: 5 mm}
tool_2: {radius: 6 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
control: {rate: 500 Hz}
"""

COARSE = PlantConstants(shell_cell_radii=1.2, shell_flange_cell=16e-3)


def job_file(**changes: str) -> JobFile:
    text = JOB
    for old, new in changes.items():
        text = text.replace(old, new)
    return JobFile(text, EXAMPLES, "job")


def test_a_flat_tip_is_formed_on_the_elasto_plastic_sheet_and_the_fast_one_refuses_it() -> None:
    file = job_file()
    assert default_sheet(file.job) == "shell_coarse"
    with pytest.raises(IsfError, match="the fast sheet does not know a flat tip") as refused:
        SimulatedMachine(file, sheet="fast")
    assert refused.value.code is ErrorCode.FILE_FIELD
    assert (refused.value.where, refused.value.advice) == ("tool_1.corner_radius", "take --sheet shell_coarse")
    lower = job_file(**{", corner_radius: 5 mm": "", "radius: 6 mm": "radius: 6 mm, corner_radius: 2 mm"})
    with pytest.raises(IsfError) as refused:
        SimulatedMachine(lower, sheet="fast")
    assert refused.value.where == "tool_2.corner_radius"
    assert default_sheet(job_file(**{", corner_radius: 5 mm": ""}).job) == "fast"


def test_cells_are_as_small_as_the_corner_needs_and_the_advice_names_no_sheet_that_refuses_it() -> None:
    file = job_file(**{"corner_radius: 5 mm": "corner_radius: 0.5 mm", "DSIF": "SPIF", "tool_2: {radius: 6 mm}\n": ""})
    with pytest.raises(IsfError, match=r"too large for a tip with a corner of radius 0.5 mm") as refused:
        SimulatedMachine(file)
    assert refused.value.code is ErrorCode.SHEET_MESH_COARSE
    assert refused.value.advice == "take a finer --sheet, or a larger tool"


def test_the_sheet_touches_disc_and_corner_and_no_ball_of_the_whole_radius() -> None:
    """Pressed 2 mm deep, a flat of radius 3 mm: the sheet under it is flat; a ball of 8 mm would leave it 0.6 mm."""
    cell = SimulatedMachine(job_file(), constants=COARSE, sheet="shell")
    assert cell._shell is not None
    tools = cell._shell.shell.tools
    assert tools["radius"].tolist() == pytest.approx([5e-3, 6e-3])
    assert tools["flat"].tolist() == pytest.approx([3e-3, 0.0])
    assert cell._balls == pytest.approx((5e-3, 6e-3))
    park = cell.job_file.rig.park_height
    for height in (*np.arange(park, 2e-3, -0.2e-3), *np.arange(2e-3, -2e-3, -0.08e-3)):
        sample = cell.tick((0.0, 0.0, height), (0.0, 0.0, -park))
    assert not cell.faults
    assert sample.true_force_1[2] > 50.0
    # a node this far beside the axis, on the wall of the dent, is outside the corner: 3 mm, and 5.5 mm round it
    position = cell._shell.shell.state.position
    centre = np.array([0.0, 0.0, cell._axes.tips[0, 2] + 5e-3])
    across = np.hypot(position[0], position[1])
    apart = np.hypot(np.maximum(across - 3e-3, 0.0), position[2] - centre[2]) - 5.5e-3
    assert apart.min() == pytest.approx(0.0, abs=0.2e-3)  # as a ball of 8 mm there would be 1.1 mm


def test_flat_tips_beside_each_other_are_apart_by_their_discs() -> None:
    """Axes 16 mm apart at equal height of the centres, flats of 3 mm and none, roundings of 5 and 6 mm: 2 mm free."""
    assert mt.apart(16e-3, 0.0, 0.0, 3e-3) - 11e-3 == pytest.approx(2e-3)
    assert mt.apart(2e-3, 0.0, 12e-3, 3e-3) == pytest.approx(12e-3)  # one over the other
    assert mt.apart(3e-3, 4e-3, 12e-3, 0.0) == pytest.approx(13e-3)
    limits = SimulatedMachine(job_file(), constants=COARSE, sheet="shell")._target_limits
    assert (limits.upper, limits.lower, limits.flat) == pytest.approx((5e-3, 6e-3, 3e-3))
