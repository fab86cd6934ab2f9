"""The numbers of a contour that an operator sees."""

import numpy as np
import pytest
from isf_cell.run.part_step import PartStep
from isf_core.contour import Contour, ContourResult, Process

RING = np.column_stack([0.02 * np.cos(np.arange(40)), 0.02 * np.sin(np.arange(40)), np.zeros(40)])


@pytest.mark.parametrize(
    ("tool", "tip", "holder"),
    [(1, -6e-3, 0.0), (2, 6e-3, 0.0), (1, 0.0, -6e-3)],
    ids=["upper tool", "lower tool", "blank holder pulls the sheet over a die"],
)
def test_depth_is_along_the_push(tool: int, tip: float, holder: float) -> None:
    up = np.tile([0.0, 0.0, 1.0], (40, 1))
    contour = Contour(
        plan_id="plan",
        index=2,
        count=9,
        process=Process.TPIF if holder else Process.SPIF,
        feed=0.03,
        contact=RING + [0.0, 0.0, tip],
        normal=up if tool == 1 else -up,
        wall_angle=np.zeros(40),
        thickness=np.full(40, 1e-3),
        forming_tip=RING + [0.0, 0.0, tip],
        forming_tool=tool,
        holder_height=holder,
    )
    some, tips = np.empty(0), np.empty((0, 3))
    result = ContourResult(
        plan_id="plan",
        index=2,
        start=0.0,
        end=1.0,
        completed=True,
        forming_force=tips,
        support_force=tips,
        forming_target=tips,
        support_target=tips,
        force_offset=some,
        compliance_offset=tips,
        tick_time=some,
        tick_set_point=some,
        tick_normal_force=some,
        tick_engaged=np.empty(0, dtype=bool),
    )
    assert PartStep.of(contour, None, result).depth == pytest.approx(6e-3, abs=1e-12)
