"""Constants that a package copies because it may not import where they are from are the same."""

from __future__ import annotations

from isf_force_ctrl.motion import trajectory
from isf_planner.checks import pace


def test_speed_of_the_support_tool_is_that_of_the_force_controller() -> None:
    assert pace.SUPPORT_RATIO == trajectory.SUPPORT_RATIO
