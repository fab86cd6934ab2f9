"""Where a tool may go by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_force_ctrl.hand.hand_space import HandSpace

JOBS = Path(__file__).resolve().parents[5] / "examples" / "jobs"
AWAY = np.array([0.0, 0.0, -0.1])
"""m, tip of the other tool."""


@pytest.fixture(scope="module")
def pair() -> HandSpace:
    """Two tools of 5 mm on the rig ren2018: travel 125 x 125 x 110 mm, opening 250 mm, frame 20 mm high."""
    return HandSpace.of_job(load_job(JOBS / "mini_cone.yaml"))


@pytest.fixture(scope="module")
def hexapod() -> HandSpace:
    """One tool on legs."""
    return HandSpace.of_job(load_job(JOBS / "torrao_cone_45.yaml"))


def refusal(
    space: HandSpace, tool: int, start: object, end: object, other: object = AWAY, **options: bool
) -> ErrorCode:
    """Code of a way in mm; OK for one that is free."""
    ends = (1e-3 * np.array(start, dtype=float), 1e-3 * np.array(end, dtype=float))
    found = ErrorCode.OK
    try:
        space.check(tool, *ends, np.array(other), to_sheet=options.get("to_sheet", False))
    except IsfError as error:
        found = error.code
    return found


def test_ways_above_the_sheet_are_free(pair: HandSpace) -> None:
    assert refusal(pair, 1, (0, 0, 100), (50, -40, 1)) == ErrorCode.OK
    assert refusal(pair, 2, (0, 0, -100), (50, -40, -2), (0.0, 0.0, 0.1)) == ErrorCode.OK


@pytest.mark.parametrize(
    "end", [(126, 0, 50), (0, -126, 50), (0, 0, 111), (float("nan"), 0, 50), (float("inf"), 0, 50)]
)
def test_the_travel_ends_where_the_rig_says(pair: HandSpace, end: tuple[float, float, float]) -> None:
    assert refusal(pair, 1, (0, 0, 100), end) == ErrorCode.MOVE_OUT_OF_REACH


def test_legs_reach_less_far_than_the_travel(hexapod: HandSpace) -> None:
    """The box of the travel has corners that the strokes of Torrao 2013 do not reach; found by its own kinematics."""
    kinematics, travel = hexapod.rig.make_kinematics()[0], np.array(hexapod.rig.limits.travel)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * travel
    reached = kinematics.reachable(corners)
    for corner, within in zip(corners, reached, strict=True):
        found = refusal(hexapod, 1, (0, 0, 100), 1e3 * corner, to_sheet=True)
        assert within or found == ErrorCode.MOVE_OUT_OF_REACH
    assert refusal(hexapod, 2, (0, 0, -100), (0, 0, -90)) == ErrorCode.MOVE_OUT_OF_REACH  # there is no tool 2


def test_the_sheet_is_in_the_way(pair: HandSpace) -> None:
    assert refusal(pair, 1, (0, 0, 100), (0, 0, -0.1)) == ErrorCode.MOVE_INTO_SHEET
    assert refusal(pair, 1, (0, 0, 100), (0, 0, -0.1), to_sheet=True) == ErrorCode.OK
    assert refusal(pair, 1, (0, 0, 100), (0, 0, 0)) == ErrorCode.OK
    over = (0.05, 0.0, 0.1)
    assert refusal(pair, 2, (0, 0, -100), (0, 0, -0.9), over) == ErrorCode.MOVE_INTO_SHEET  # 1 mm thick
    assert refusal(pair, 2, (0, 0, -100), (0, 0, -1.0), over) == ErrorCode.OK


def test_a_formed_sheet_hangs_lower(pair: HandSpace) -> None:
    formed = HandSpace(pair.rig, pair.radii, pair.thickness, depth=12e-3)
    over = (0.05, 0.0, 0.1)
    assert refusal(formed, 2, (0, 0, -100), (0, 0, -12.9), over) == ErrorCode.MOVE_INTO_SHEET
    assert refusal(formed, 2, (0, 0, -100), (0, 0, -13.0), over) == ErrorCode.OK


def test_who_is_in_the_sheet_may_leave_it_and_not_go_deeper(pair: HandSpace) -> None:
    assert refusal(pair, 1, (0, 0, -5), (0, 0, 10)) == ErrorCode.OK
    assert refusal(pair, 1, (0, 0, -5), (0, 0, -6)) == ErrorCode.MOVE_INTO_SHEET
    assert refusal(pair, 1, (0, 0, -5), (10, 0, -5)) == ErrorCode.MOVE_INTO_SHEET


def test_the_frame_of_the_clamp_is_in_the_way(pair: HandSpace) -> None:
    """20 mm high, from 125 mm on; a ball of 5 mm touches it at 120 mm."""
    assert refusal(pair, 1, (0, 0, 10), (119, 0, 10)) == ErrorCode.OK
    assert refusal(pair, 1, (0, 0, 10), (121, 0, 10)) == ErrorCode.MOVE_INTO_SHEET
    assert refusal(pair, 1, (0, 0, 30), (121, 0, 21)) == ErrorCode.OK
    assert refusal(pair, 1, (0, 0, 30), (121, 0, 19)) == ErrorCode.MOVE_INTO_SHEET


def test_the_other_tool_is_in_the_way(pair: HandSpace) -> None:
    """Balls of 5 mm with 1 mm of sheet between: in line their centres stay 11 mm apart, which touching tips have."""
    below = (0.0, 0.0, -0.001)
    assert refusal(pair, 1, (0, 0, 50), (0, 0, 0), below, to_sheet=True) == ErrorCode.OK
    assert refusal(pair, 1, (0, 0, 50), (0, 0, -0.1), below, to_sheet=True) == ErrorCode.MOVE_INTO_TOOL
    # beside each other in the sheet: balls at the same height, 11 mm apart
    beside = (0.0, 0.0, 0.0)
    assert refusal(pair, 1, (50, 0, -10), (11.1, 0, -10), beside, to_sheet=True) == ErrorCode.OK
    assert refusal(pair, 1, (50, 0, -10), (10.9, 0, -10), beside, to_sheet=True) == ErrorCode.MOVE_INTO_TOOL
    # a way whose ends are free, through the other tool
    assert refusal(pair, 1, (50, 0, -10), (-50, 0, -10), beside, to_sheet=True) == ErrorCode.MOVE_INTO_TOOL


def test_room_ends_where_a_step_would_be_refused(pair: HandSpace) -> None:
    start = np.array([0.0, 0.0, 0.1])
    assert pair.room(1, start, np.array([1.0, 0.0, 0.0]), AWAY) == pytest.approx(0.125, abs=2e-4)
    assert pair.room(1, start, np.array([0.0, 0.0, 1.0]), AWAY) == pytest.approx(0.010, abs=2e-4)
    # down to the other tool 100 mm below the sheet: tips 1 mm of sheet apart
    assert pair.room(1, start, np.array([0.0, 0.0, -1.0]), AWAY) == pytest.approx(0.199, abs=2e-4)


def test_a_tool_that_is_none_is_refused(pair: HandSpace) -> None:
    for tool in (0, 3, 255):
        assert refusal(pair, tool, (0, 0, 100), (0, 0, 90)) == ErrorCode.MOVE_OUT_OF_REACH
