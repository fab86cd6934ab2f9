"""What happens to the tools in mid-contour: other gains, set-points and filters, and wrenches that do not come."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_sandbox import Run, make_config, ring, run
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl import ForceController, Mode

AT = 3000
"""Tick in full control of a contour of 30 mm radius."""

RATE = 500.0


def steps(outcome: Run, around: int) -> float:
    """m, largest change of a target from tick to tick in the 100 ms after ``around``, less the feed's own."""
    moved = np.linalg.norm(np.diff(outcome.targets.reshape(-1, 2, 3), axis=0), axis=2)
    return float(moved[around : around + 50].max() - moved[around - 50 : around].max())


def formed(change: dict[str, Any] | None = None) -> Run:
    def at_once(tick: int, controller: ForceController, one: list[float], two: list[float]) -> tuple[Any, Any]:
        if tick == AT and change:
            assert controller.mode is Mode.CONTROL
            controller.retune(replace(controller.config, **change))
        return one, two

    return run([ring(radius=30e-3)], make_config(compensation=1.0), on_tick=at_once)


@pytest.fixture(scope="module")
def unchanged() -> Run:
    return formed()


@pytest.mark.parametrize(
    "change",
    [{"loop_gain": 12.0}, {"filter_cutoff": 20.0}, {"compliance_time": 0.5}, {"dead_zone": 0.0}, {"error_clamp": 20.0}],
    ids=str,
)
def test_gains_filters_and_limits_change_without_a_bump(change: dict[str, Any], unchanged: Run) -> None:
    """The targets of the tick are those that would have come, to 1 um, and the force stays within 10 N."""
    outcome = formed(change)
    assert (outcome.targets[:AT] == unchanged.targets[:AT]).all()
    assert np.abs(outcome.targets[AT] - unchanged.targets[AT]).max() < 1e-6
    assert steps(outcome, AT) < 5e-6
    error = outcome.force[AT : AT + 250] - 120.0
    assert np.mean(np.abs(error) <= 10.0) >= 0.99
    assert outcome.results[0].completed


def test_a_set_point_is_ramped_to_and_held() -> None:
    outcome = formed({"set_point": 60.0})
    assert np.abs(np.diff(outcome.results[0].tick_set_point[AT - 10 : AT + 200])).max() <= 400.0 / RATE + 1e-9
    assert outcome.force[AT + 20] > 80.0  # 400 N/s: not at once
    assert outcome.force[AT + 250 : AT + 750].mean() == pytest.approx(60.0, abs=3.0)
    assert outcome.results[0].completed


def test_values_that_do_not_go_together_are_refused() -> None:
    with pytest.raises(IsfError) as caught:
        replace(make_config(), set_point=3.0).check()
    assert caught.value.code == ErrorCode.FILE_FIELD
    with pytest.raises(IsfError) as caught:
        replace(make_config(), loop_gain=400.0).check()
    assert caught.value.code == ErrorCode.UNSTABLE_GAIN
    replace(make_config(), loop_gain=40.0, compliance_time=0.5).check()


def test_without_wrenches_the_tools_stand_and_go_on_when_they_are_back(unchanged: Run) -> None:
    """For 400 ticks the last wrenches are repeated, and the sandbox is what it is: nothing is done on old readings."""
    kept: list[Any] = []

    def silent(tick: int, controller: ForceController, one: list[float], two: list[float]) -> tuple[Any, Any]:
        controller.paused = AT <= tick < AT + 400
        if not controller.paused:
            kept[:] = [one, two]
        return kept[0], kept[1]

    outcome = run([ring(radius=30e-3)], make_config(compensation=1.0), on_tick=silent)
    result = outcome.results[0]
    assert result.completed
    assert steps(outcome, AT) < 5e-6  # braked, not stopped dead
    standing = outcome.targets[AT + 200 : AT + 400]
    assert np.abs(standing - standing[0]).max() < 1e-9
    assert not result.tick_engaged[AT + 1 : AT + 400].any()  # no force was controlled then
    later = outcome.force[AT + 600 :][outcome.mode[AT + 600 :] == Mode.CONTROL] - 120.0
    assert np.mean(np.abs(later) <= 10.0) >= 0.99
    assert len(outcome.targets) == pytest.approx(len(unchanged.targets) + 400, abs=100)
