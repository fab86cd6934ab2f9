"""Hydraulic legs against hand calculations with the derived rates at mid-stroke (Torrao 2013, chapters 3 and 4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from isf_core.contour import Contour, Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.rig import load_rig
from isf_planner.checks.leg_checks import check_legs, leg_path

RIG = load_rig("torrao2013")
MIDDLE = np.array([0.0, 0.0, -1.1172872 + 1.475 - 0.408])
"""m, tip of the tool of 70 mm with all legs in mid-stroke."""


def along(direction: list[float], feed: float) -> tuple[Contour]:
    """5 points 0.1 mm apart through mid-stroke."""
    tips = MIDDLE + 1e-4 * np.arange(-2.0, 3.0)[:, None] * np.array(direction)
    normal, zero = np.tile([0.0, 0.0, 1.0], (5, 1)), np.zeros(5)
    return (
        Contour(
            plan_id="legs",
            index=3,
            count=5,
            process=Process.SPIF,
            feed=feed,
            contact=tips,
            normal=normal,
            wall_angle=zero,
            thickness=np.full(5, 1e-3),
            forming_tip=tips,
            support_tip=np.empty((0, 3)),
            closed=False,
        ),
    )


def test_speeds_and_flow_of_straight_ways_are_those_by_hand() -> None:
    """Largest rates at mid-stroke 0.2022 along x and 0.9784 along z; 3117.2 mm^2 outwards, 1526.8 inwards."""
    across = leg_path(along([1.0, 0.0, 0.0], 0.04), RIG, 5e-3)
    down, up = (leg_path(along([0.0, 0.0, way], 0.05), RIG, 5e-3) for way in (-1.0, 1.0))
    assert across is not None
    assert down is not None
    assert up is not None
    assert np.abs(across.speed).max() == pytest.approx(0.2022 * 0.04, rel=1e-3)
    assert down.speed == pytest.approx(np.full((4, 6), 0.9784 * 0.05), rel=1e-3)
    assert 6e4 * down.flow == pytest.approx(np.full(4, 6 * 3117.2e-6 * 0.9784 * 0.05 * 6e4), rel=1e-3)
    assert up.flow / down.flow == pytest.approx(np.full(4, 1526.8 / 3117.2), rel=1e-3)


def test_the_pump_limits_six_legs_and_the_valve_a_single_one() -> None:
    """112 l/min, 3.6 l/min of it for leakage, are 98.7 mm/s straight down; a leg alone goes out at 131 mm/s."""
    check_legs(along([0.0, 0.0, -1.0], 0.0980), RIG, 5e-3)
    with pytest.raises(IsfError, match="the pump gives 108 l/min") as caught:
        check_legs(along([0.0, 0.0, -1.0], 0.0995), RIG, 5e-3)
    assert caught.value.code == ErrorCode.LEGS_TOO_FAST
    assert "contour 4" in caught.value.where
    check_legs(along([1.0, 0.0, 0.0], 0.4), RIG, 5e-3)
    with pytest.raises(IsfError, match=r"leg \d would have to go (in|out)") as caught:
        check_legs(along([1.0, 0.0, 0.0], 0.7), RIG, 5e-3)
    assert caught.value.code == ErrorCode.LEGS_TOO_FAST
    assert "path.feed" in caught.value.advice


def test_as_support_tool_it_is_no_faster_than_twice_the_feed() -> None:
    """On four times the way both tools get slower, so that down at 160 mm/s, too fast for the legs, are 80 mm/s."""
    (alone,) = along([0.0, 0.0, -1.0], 0.04)
    way = MIDDLE + np.linspace(0.0, 1.6e-3, 5)[:, None] * np.array([0.0, 0.0, -1.0])
    both = replace(alone, process=Process.DSIF, forming_tool=2, support_tip=way)
    path = leg_path([both], RIG, 5e-3)
    assert path is not None
    assert path.speed == pytest.approx(np.full((4, 6), 0.9784 * 0.08), rel=1e-2)
    check_legs([both], RIG, 5e-3)
    with pytest.raises(IsfError, match=r"leg \d would have to go out at 157 mm/s"):
        check_legs(along([0.0, 0.0, -1.0], 0.16), RIG, 5e-3)


def test_a_machine_without_legs_has_no_such_limit() -> None:
    assert leg_path(along([0.0, 0.0, -1.0], 1.0), load_rig("ren2018"), 5e-3) is None
    check_legs(along([0.0, 0.0, -1.0], 1.0), load_rig("ren2018"), 5e-3)
