"""The axis of tool 1 on its way: bounded rate, tilted at park height, upright when parked, refused beyond the rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_sandbox import make_config, ring
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.contour import Contour, Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.tool_axis import UPRIGHT, angle_between, inclination
from isf_force_ctrl import ForceController
from isf_force_ctrl.motion import tool_moves
from isf_force_ctrl.motion.tool_moves import Posture

DEG = np.pi / 180.0
NO_FORCE = (0.0,) * 6


def leaning(contour: Contour, tilt: float) -> Contour:
    flat = contour.normal[:, :2] / np.linalg.norm(contour.normal[:, :2], axis=1)[:, None]
    axis = np.column_stack([np.sin(tilt) * flat, np.full(len(contour), np.cos(tilt))])
    alone = {"process": Process.SPIF, "support_tip": np.empty((0, 3)), "support_force": np.empty(0)}
    return replace(contour, forming_axis=axis, **alone)


def tilting(**changes: object):  # type: ignore[no-untyped-def]
    return replace(make_config(), largest_tilt=30 * DEG, **changes)  # type: ignore[arg-type]


direction = st.tuples(st.floats(0.0, 0.5), st.floats(-3.1, 3.1)).map(
    lambda at: np.array([np.sin(at[0]) * np.cos(at[1]), np.sin(at[0]) * np.sin(at[1]), np.cos(at[0])])
)


@settings(max_examples=30, deadline=None)
@given(direction, direction, st.floats(0.0, 20e-3), st.floats(0.02, 1.0))
def test_moves_turn_the_axis_no_faster_than_allowed(first, second, length: float, rate: float) -> None:
    """Also where the tip stands; along a great circle, so that no axis on the way is tilted further than the ends."""
    config, below = tilting(axis_rate=rate), np.array([0.0, 0.0, -0.1])
    start = Posture(np.zeros(3), below, 0.0, 0.0, first)
    end = Posture(np.array([length, 0.0, 0.0]), below, 0.0, 0.0, second)
    motion = tool_moves.move(config, start, end, 0.05)
    if float(angle_between(first, second)) < 1e-6:
        return
    turned = angle_between(motion.axis[:-1], motion.axis[1:]) * config.rate
    assert turned.max() <= 1.001 * rate
    assert motion.axis[0] == pytest.approx(first, abs=1e-9)
    assert motion.axis[-1] == pytest.approx(second, abs=1e-9)
    assert np.linalg.norm(motion.axis, axis=1) == pytest.approx(np.ones(len(motion)), abs=1e-12)


def test_a_tilted_contour_is_formed_and_the_tool_parks_upright() -> None:
    config = tilting()
    contour = leaning(ring(), 25 * DEG)
    tips, axes = _formed(config, contour)
    upright, unturned = _formed(config, replace(contour, forming_axis=np.empty((0, 3))))
    assert unturned == {UPRIGHT}
    turned = angle_between(axes[:-1], axes[1:]) * config.rate
    assert turned.max() <= 1.01 * config.axis_rate  # rad/s
    assert inclination(axes).max() == pytest.approx(25 * DEG, abs=1e-3)
    assert tuple(axes[-1]) == UPRIGHT
    assert inclination(axes[0]) < 1e-6
    low = tips[:, 2] < config.park_height - 1e-6
    assert inclination(axes[low]).min() > 24 * DEG  # tilted before it comes down, until it is up again
    assert tips[-1] == pytest.approx([0.0, 0.0, config.park_height], abs=1e-6)
    apart = [np.linalg.norm(upright - tip, axis=1).min() for tip in tips[low][::50]]
    assert max(apart) < 1e-3  # the same path; points of it are passed at other times


def test_where_the_axis_is_turned_it_accelerates_no_more_than_a_tip() -> None:
    """The joints that tilt the tool are far above it: a turn that the tip hardly sees is a long way there."""
    lever = 0.47  # m, of a hexapod

    def largest(config) -> float:  # type: ignore[no-untyped-def]
        tips, axes = _formed(config, leaning(ring(), 25 * DEG))
        joints = np.diff(tips + lever * axes, n=2, axis=0) * config.rate**2
        return float(np.linalg.norm(joints, axis=1).max())

    assert largest(tilting(tilt_lever=lever)) <= 0.52  # m/s^2, of which the configuration allows 0.5
    assert largest(tilting()) > 0.75


def _formed(config, contour: Contour):  # type: ignore[no-untyped-def]
    """Tips (T, 3) m and axes (T, 3) of all ticks; of an upright contour the set of its axes."""
    controller = ForceController(config)
    park = config.park_height
    controller.arm(contour.plan_id, 0, 1, (0.0, 0.0, park), (0.0, 0.0, -park))
    controller.start(contour)
    tips, axes, tick = [], [], 0
    while controller.busy:
        targets = controller.tick(tick, tick / config.rate, NO_FORCE, NO_FORCE)
        tips.append(targets.tip_1)
        axes.append(targets.axis)
        tick += 1
    result = controller.take_result()
    assert result is not None
    assert result.completed
    return np.array(tips), np.array(axes) if contour.tilted else set(axes)


def test_an_axis_beyond_the_rig_is_refused_before_anything_moves() -> None:
    for config, words in ((tilting(), "can be tilted by 30.00 deg"), (make_config(), "can be tilted by 0.00 deg")):
        controller = ForceController(config)
        contour = leaning(ring(), 35 * DEG)
        controller.arm(contour.plan_id, 0, 1, (0.0, 0.0, 0.1), (0.0, 0.0, -0.1))
        with pytest.raises(IsfError, match=words) as caught:
            controller.start(contour)
        assert caught.value.code == ErrorCode.CONTOUR_REJECTED
        assert not controller.busy
