"""The judge of a fault campaign on motions and forces made by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from isf_cell.faults import judge
from isf_cell.faults.judge import Trace

MS = 1_000_000
FAULT = 1000 * MS
"""ns, when the fault comes by both clocks."""


def trace(values: list[tuple[float, float, float]], period: int = 20, late: int = 0) -> Trace:
    stamp = np.arange(len(values), dtype=np.int64) * period * MS
    return Trace(stamp + late * MS, stamp, np.array(values))


def moving_until(end_ms: int, *, then: float = 0.0) -> Trace:
    """20 mm/s along x, told every 20 ms, until ``end_ms``; after that ``then`` m/s upwards."""
    x = [0.02 * 1e-3 * min(t, end_ms) for t in range(0, 2000, 20)]
    z = [then * 1e-3 * max(0, t - end_ms) for t in range(0, 2000, 20)]
    return trace([(a, 0.0, b) for a, b in zip(x, z, strict=True)], late=3)


LOADED = trace([(0.0, 0.0, 700.0)] * 200, period=10)


@pytest.mark.parametrize(
    ("end", "machine", "wall"), [(1000, 0.0, 0.0), (1040, 0.04, 0.043), (1100, 0.1, 0.103), (5000, 0.98, 0.983)]
)
def test_a_tool_is_held_when_it_stands_judged_to_the_next_pose(end: int, machine: float, wall: float) -> None:
    found = judge.held(moving_until(end), LOADED, stamp=FAULT, wall=FAULT)
    assert found.machine == pytest.approx(machine)
    assert found.wall == pytest.approx(wall)


def test_lifting_a_tool_is_no_forming() -> None:
    assert judge.held(moving_until(1040, then=0.05), LOADED, stamp=FAULT, wall=FAULT).machine == pytest.approx(0.04)


def test_moving_without_a_force_is_no_forming() -> None:
    free = trace([(0.0, 0.0, 700.0 if t < 1060 else 2.0) for t in range(0, 2000, 10)], period=10)
    assert judge.held(moving_until(1500), free, stamp=FAULT, wall=FAULT).machine == pytest.approx(0.06, abs=0.021)


def test_a_tool_that_is_pressed_deeper_does_not_stand() -> None:
    """As on the way into the sheet, where nothing moves along it."""
    down = trace([(0.0, 0.0, -0.02 * 1e-3 * min(t, 1100)) for t in range(0, 2000, 20)])
    assert judge.held(down, LOADED, stamp=FAULT, wall=FAULT).machine == pytest.approx(0.1)
    assert judge.speed(down, stamp=FAULT) == pytest.approx(0.02)


def test_a_pause_of_a_moment_is_no_stand() -> None:
    there = moving_until(5000).value.copy()
    there[53:56] = there[53]  # 60 ms on one place
    seen = Trace(moving_until(0).received, moving_until(0).stamp, there)
    assert judge.held(seen, LOADED, stamp=FAULT, wall=FAULT).machine == pytest.approx(0.98)


def test_a_machine_that_tells_nothing_any_more_has_no_motion() -> None:
    gone = moving_until(1500)
    ended = Trace(gone.received[:50], gone.stamp[:50], gone.value[:50])
    assert judge.held(ended, LOADED, stamp=FAULT, wall=FAULT).machine == 0.0


def test_released_is_the_last_force_of_either_tool() -> None:
    one = trace([(0.0, 0.0, 700.0 if t < 1500 else 1.0) for t in range(0, 3000, 10)], period=10)
    other = trace([(120.0 if t < 2200 else 1.0, 0.0, 0.0) for t in range(0, 3000, 10)], period=10)
    assert judge.released([one], wall=FAULT) == pytest.approx(0.5)
    assert judge.released([one, other], wall=FAULT) == pytest.approx(1.2)
    assert judge.released([one, LOADED], wall=FAULT) == math.inf
    assert math.isnan(judge.released([LOADED], wall=5000 * MS))
    late = trace([(0.0, 0.0, 700.0) for _ in range(0, 1200, 10)], period=10)
    assert math.isnan(judge.released([late], wall=FAULT)), "a reading on its way when its machine was killed"
    quick = trace([(0.0, 0.0, 700.0 if t < 1200 else 1.0) for t in range(0, 1400, 10)], period=10)
    assert judge.released([quick], wall=FAULT) == pytest.approx(0.2), "a machine that ends soon after"


def test_the_worst_force_is_that_of_the_nearest_limit() -> None:
    limit = np.array([1500.0, 1500.0, 2000.0])
    assert judge.worst([LOADED, trace([(-900.0, 0.0, 0.0)])], limit) == pytest.approx(0.6)


def test_speed_is_that_before_the_fault() -> None:
    assert judge.speed(moving_until(5000), stamp=FAULT) == pytest.approx(0.02)
    assert judge.speed(moving_until(500), stamp=FAULT) == 0.0
    assert judge.speed(moving_until(500), stamp=-1) == 0.0


def test_speed_is_that_which_a_tool_gathers_before_it_is_braked() -> None:
    """From 10 mm/s at the fault to 20 mm/s 40 ms later."""
    times = range(0, 2000, 20)
    x = [1e-5 * min(t, 1040) + 2e-5 * min(max(0, t - 1040), 60) for t in times]
    seen = trace([(a, 0.0, 0.0) for a in x])
    assert judge.speed(seen, stamp=FAULT) == pytest.approx(0.01)
    assert judge.speed(seen, stamp=FAULT, until=0.1) == pytest.approx(0.02)
    assert judge.speed(seen, stamp=FAULT, until=0.04) == pytest.approx(0.01)
