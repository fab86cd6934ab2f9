"""When a wrench is missing."""

from __future__ import annotations

import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl.ros.readiness import Readiness
from isf_force_ctrl.supervision.wrench_receiver import WrenchFrames


class Time:
    """A clock that a test sets, s."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def heard(time: Time, period: float) -> Readiness:
    """200 wrenches of each tool, ``period`` s apart."""
    ready = Readiness(3.0, 0.25, WrenchFrames("sheet", lambda _frame, _stamp, wrench: wrench), time)
    for _ in range(200):
        time.now += period
        ready.wrench(1)
        ready.wrench(2)
    return ready


@pytest.mark.parametrize(("period", "missing_after"), [(0.002, 0.03), (0.01, 0.03), (0.02, 0.06), (0.1, 0.3)])
def test_a_wrench_is_missing_after_the_pause_or_three_usual_distances(period: float, missing_after: float) -> None:
    """Load cells may be slower than the control."""
    time = Time()
    ready = heard(time, period)
    last = time.now
    time.now = last + missing_after - 1e-3
    assert ready.missing(0.03) == []
    ready.wrench(2)
    time.now = last + missing_after + 1e-3
    assert ready.missing(0.03) == [1]
    assert ready.silent(0.03) == [1]


def test_of_tools_that_are_not_needed_nothing_is_missing() -> None:
    time = Time()
    ready = heard(time, 0.01)
    ready.needed = [2]
    time.now += 1.0
    assert ready.missing(0.03) == [2]


def test_a_tool_that_was_never_heard_is_missing() -> None:
    ready = Readiness(3.0, 0.25, WrenchFrames("sheet", lambda _frame, _stamp, wrench: wrench), Time())
    assert ready.missing(0.03) == [1, 2]


@pytest.mark.parametrize(("period", "rate", "said"), [(0.2, 100.0, "5 times"), (0.01, 500.0, "100 times")])
def test_wrenches_far_slower_than_the_control_do_not_arm(period: float, rate: float, said: str) -> None:
    with pytest.raises(IsfError, match=said) as refused:
        heard(Time(), period).keep_rates(rate)
    assert refused.value.code is ErrorCode.WRENCH_LOST
    assert f"{4.0 / period:.3g} Hz" in refused.value.advice


def test_wrenches_at_a_third_of_the_rate_arm() -> None:
    heard(Time(), 0.03).keep_rates(100.0)


def test_of_tools_that_are_not_needed_the_rate_does_not_count() -> None:
    ready = heard(Time(), 0.2)
    ready.needed = []
    ready.keep_rates(500.0)


def test_silences_after_arming_do_not_become_usual() -> None:
    time = Time()
    ready = heard(time, 0.01)
    ready.keep_rates(100.0)
    for _ in range(300):
        time.now += 1.0
        ready.wrench(1)
        ready.wrench(2)
    time.now += 0.031
    assert ready.missing(0.03) == [1, 2]
