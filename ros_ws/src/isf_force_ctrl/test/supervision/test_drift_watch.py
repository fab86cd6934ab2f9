"""Drift of the load cells, watched where the tools are known to be off the sheet."""

import numpy as np
import pytest
from contact_sandbox import make_config, ring, run
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl import Mode
from isf_force_ctrl.control_state import Flag
from isf_force_ctrl.motion.segments import RESTING
from isf_force_ctrl.motion.tool_moves import Tools
from isf_force_ctrl.supervision.wrench_watch import WINDOW, DriftWatch, check_drift

BOTH = Tools(1, with_support=True)
PARK = 0.03
"""m, park height of the sandbox."""


def drifted(tool, force, *, when=lambda controller: True, seen=None):
    """Adds ``force`` N in z to the readings of ``tool``; ``seen`` takes the flags of the state."""

    def on_tick(_, controller, wrench_1, wrench_2):
        wrenches = [list(wrench_1), list(wrench_2)]
        if when(controller):
            wrenches[tool - 1][2] += force
        if seen is not None:
            seen.append(controller.state().flags)
        return wrenches

    return on_tick


def row_at(height_1, height_2):
    row = list(RESTING)
    row[2], row[5] = height_1, -height_2
    return row


@pytest.mark.parametrize("force", [0.0, 8.0])
def test_a_good_zero_is_not_reported(force):
    seen = []
    outcome = run([ring(k, 2) for k in range(2)], make_config(), on_tick=drifted(2, force, seen=seen))
    assert [(result.completed, result.code, result.message) for result in outcome.results] == [(True, 0, "")] * 2
    assert not any(flags & Flag.DRIFT for flags in seen)
    # cells of the sandbox read whole N with noise of 0.5 N: the mean of a window is within 0.5 N
    assert outcome.controller.drift.drift == pytest.approx([0.0, force], abs=0.5)


@pytest.mark.parametrize("tool", [1, 2])
def test_a_drift_is_warned_of_and_the_part_formed(tool):
    seen = []
    outcome = run([ring(k, 3) for k in range(3)], make_config(), on_tick=drifted(tool, 15.0, seen=seen))
    first, second, last = outcome.results
    assert all(result.completed for result in outcome.results)
    assert (first.code, last.code) == (ErrorCode.NO_TARE, ErrorCode.NO_TARE)
    assert f"tool_{tool} has drifted by 15." in first.message
    assert "tare it again" in first.message
    # Between the first and the last contour the tools are on the sheet: nothing new is known.
    assert (second.code, second.message) == (0, "")
    assert seen[-1] & Flag.DRIFT
    assert abs(outcome.force[outcome.mode == Mode.CONTROL].mean() - 120.0) < 3.0


@pytest.mark.parametrize("tool", [1, 2])
def test_a_large_drift_makes_no_contact(tool):
    outcome = run([ring(0, 1)], make_config(), on_tick=drifted(tool, 40.0))
    (result,) = outcome.results
    assert (result.completed, result.code) == (False, ErrorCode.NO_TARE)
    assert f"tool_{tool} has drifted by 40." in result.message
    assert outcome.controller.mode is Mode.HOLD
    assert outcome.force.max() == 0.0
    assert set(outcome.mode.tolist()) <= {Mode.APPROACH, Mode.HOLD}
    # found on the way from park, within a window and what braking takes
    assert outcome.targets[:, 2].min() > PARK - make_config().clearance


def test_a_cell_that_shifts_while_forming_is_reported_with_the_last_contour():
    def formed(controller):
        return controller.mode in (Mode.CONTROL, Mode.LIFT, Mode.FREEZE)

    outcome = run([ring(0, 1)], make_config(), on_tick=drifted(1, 40.0, when=formed))
    (result,) = outcome.results
    # beyond the limit of refusal, too, but the part is formed: nothing is to be refused any more
    assert (result.completed, result.code) == (True, ErrorCode.NO_TARE)
    assert outcome.controller.mode is Mode.IDLE


def test_forces_on_the_sheet_and_of_idle_tools_are_no_drift():
    watch, loaded = DriftWatch(make_config()), (0.0, 0.0, 500.0, 120.0, 0.0, -80.0)
    for _ in range(500):
        assert watch.check(row_at(0.02, 0.02), BOTH, Mode.CONTROL, loaded) is None
    assert np.isnan(watch.drift).all()
    alone = Tools(1, with_support=False)
    for _ in range(500):
        assert watch.check(row_at(PARK, PARK), alone, Mode.APPROACH, (0.0, 0.0, 0.0, 1e3, 0.0, 0.0)) is None
    assert watch.drift[0] == 0.0
    assert np.isnan(watch.drift[1])
    assert watch.values() == {"drift_1": "0.0"}


def test_a_window_begun_before_the_sheet_does_not_count():
    config = make_config()
    watch, ticks = DriftWatch(config), round(WINDOW * config.rate)
    for _ in range(20):
        for _ in range(ticks - 1):
            watch.check(row_at(PARK, PARK), BOTH, Mode.ARMED, [100.0] * 6)
        watch.check(row_at(0.0, 0.0), BOTH, Mode.CONTROL, [100.0] * 6)
    assert watch.warning is None
    assert np.isnan(watch.drift).all()


def test_noise_is_averaged():
    watch, random = DriftWatch(make_config()), np.random.default_rng(0)
    for _ in range(20_000):
        assert watch.check(row_at(PARK, PARK), BOTH, Mode.ARMED, 8.0 * random.standard_normal(6)) is None
        assert watch.warning is None


def test_the_warning_is_reported_once_and_ends_with_the_drift():
    watch = DriftWatch(make_config())

    def windows(force):
        for _ in range(50):
            watch.check(row_at(PARK, PARK), BOTH, Mode.LIFT, [0.0, 0.0, force, 0.0, 0.0, 0.0])

    windows(12.0)
    assert "12.0 N" in str(watch.untold())
    windows(13.0)
    assert watch.untold() is None
    assert watch.news() == (ErrorCode.NO_TARE, watch.warning.message)
    assert watch.news() == (0, "")
    windows(1.0)
    assert watch.untold() is None
    windows(14.0)
    assert "14.0 N" in str(watch.untold())


def test_limits():
    with pytest.raises(IsfError, match="drift_stop") as caught:
        make_config(drift_limit=20.0, drift_stop=15.0).check()
    assert caught.value.code == ErrorCode.FILE_FIELD
    check_drift(9.9, 10.0)
    for drift in (10.1, float("nan")):
        with pytest.raises(IsfError) as caught:
            check_drift(drift, 10.0)
        assert caught.value.code == ErrorCode.NO_TARE
