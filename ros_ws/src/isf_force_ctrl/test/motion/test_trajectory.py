"""Motion along any path keeps step, speed and acceleration limits, and goes where it should."""

import numpy as np
import pytest
from contact_sandbox import make_config, ring
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl.motion import tool_moves
from isf_force_ctrl.motion.contour_path import contour_path
from isf_force_ctrl.motion.tool_moves import Posture, Tools
from isf_force_ctrl.motion.trajectory import SUPPORT_RATIO, Limits, ToolPath, horizontal_direction, sample, straight

LIMITS = Limits(rate=500.0, acceleration=0.5, blend_time=0.03, jerk_time=0.01)
PARKED = np.array([0.0, 0.0, -0.1])


def any_path(tips_1, tips_2, turns):
    count = min(len(tips_1), len(tips_2), len(turns))
    return ToolPath(
        np.array(tips_1[:count]),
        np.array(tips_2[:count]),
        np.cumsum(turns[:count]),
        np.full(count, 120.0),
        np.arange(count, dtype=float),
        arm=1.5e-3,
    )


def derivatives(tips, rate=500.0):
    """Largest speed (m/s) and acceleration (m/s^2) of tips (T, 3), standing still before and after."""
    held = np.concatenate([np.repeat(tips[:1], 3, axis=0), tips, np.repeat(tips[-1:], 3, axis=0)])
    velocity = np.diff(held, axis=0) * rate
    acceleration = np.diff(velocity, axis=0) * rate
    return np.linalg.norm(velocity, axis=1).max(), np.linalg.norm(acceleration, axis=1).max()


point = st.tuples(*[st.integers(-2000, 2000).map(lambda n: n * 1e-5)] * 3)
path_inputs = st.integers(3, 25).flatmap(
    lambda n: st.tuples(
        st.lists(point, min_size=n, max_size=n),
        st.lists(point, min_size=n, max_size=n),
        st.lists(st.floats(-1.0, 1.0), min_size=n, max_size=n),
    )
)


@settings(max_examples=30, deadline=None)
@given(path_inputs, st.floats(0.005, 0.06))
def test_limits_hold_on_any_path(inputs, feed):
    path = any_path(*inputs)
    motion = sample(path, feed, LIMITS)
    speed_1, acceleration_1 = derivatives(motion.tip_1)
    speed_2, acceleration_2 = derivatives(motion.tip_2)
    # Bounds of the module's derivation; 0.1 % for sampling at ticks.
    assert speed_1 <= feed * 1.001
    assert speed_2 <= SUPPORT_RATIO * feed * 1.001
    assert acceleration_1 <= LIMITS.acceleration * 1.001
    assert acceleration_2 <= LIMITS.acceleration * 1.001
    assert motion.tip_1[0] == pytest.approx(path.tip_1[0], abs=1e-12)
    assert motion.tip_2[-1] == pytest.approx(path.tip_2[-1], abs=1e-12)
    assert np.linalg.norm(motion.normal, axis=1) == pytest.approx(1.0, abs=1e-9)
    low, high = path.tip_1.min(axis=0) - 1e-9, path.tip_1.max(axis=0) + 1e-9
    assert (motion.tip_1 >= low).all()
    assert (motion.tip_1 <= high).all()
    assert (np.diff(motion.coordinate) >= -1e-9).all()


def test_feed_is_reached_on_a_smooth_contour():
    path = contour_path(ring(radius=30e-3), make_config(), (PARKED, PARKED), None)
    motion = sample(path, 0.03, LIMITS)
    speed = np.linalg.norm(np.diff(motion.tip_1, axis=0), axis=1) * 500.0
    assert np.median(speed) == pytest.approx(0.03, rel=0.005)  # polygon of 160 sides, rounded


def test_closed_contour_returns_and_stays_near_its_path():
    contour = ring(radius=30e-3)
    motion = sample(contour_path(contour, make_config(), (PARKED, PARKED), None), 0.03, LIMITS)
    assert motion.tip_1[-1] == pytest.approx(motion.tip_1[0], abs=1e-12)
    radius = np.linalg.norm(motion.tip_1[:, :2], axis=1)
    nominal = np.linalg.norm(contour.forming_tip[0, :2])
    # A window of v T cuts a circle by (v T)^2/(24 R) = 1.4 um; a polygon of 160 sides by R (pi/160)^2/2 = 5 um.
    assert np.abs(radius - nominal).max() < 8e-6


def test_corner_is_slowed_and_rounded_little():
    side = np.linspace(0.0, 0.02, 41)
    zero = np.zeros(41)
    first = np.column_stack([side, zero, zero])
    corner = np.concatenate([first, np.column_stack([zero + 0.02, side, zero])[1:]])
    path = ToolPath(corner, np.tile(PARKED, (81, 1)), np.zeros(81), np.full(81, np.nan), np.arange(81.0))
    motion = sample(path, 0.03, LIMITS)
    nearest = np.linalg.norm(motion.tip_1 - [0.02, 0.0, 0.0], axis=1).min()
    # v <= a_c T / sqrt(2) = 5.3 mm/s; a box of T cuts a right angle by v T / (4 sqrt 2) = 28 um, two < 56 um.
    assert nearest < 60e-6
    at = np.argmin(np.linalg.norm(motion.tip_1 - [0.02, 0.0, 0.0], axis=1))
    assert motion.speed[at] < 6e-3


def test_direction_bridges_where_tools_stand_above_each_other():
    forming = np.zeros((5, 3))
    support = np.array([[1.0, 0, 0], [1.0, 0, 0], [1e-5, 1e-5, 0], [0, 1.0, 0], [0, 1.0, 0]]) * 1e-2
    angle = horizontal_direction(forming, support, 5e-4)
    assert angle == pytest.approx([0, 0, np.pi / 4, np.pi / 2, np.pi / 2])
    assert horizontal_direction(forming, forming, 5e-4) is None


def test_direction_is_continuous_around():
    contour = ring()
    angle = horizontal_direction(contour.forming_tip, contour.support_tip, 5e-4)
    assert angle is not None
    assert np.ptp(angle) == pytest.approx(2 * np.pi * 159 / 160, rel=1e-6)


def test_straight_turns_the_short_way():
    path = straight(np.zeros((2, 3)), np.zeros((2, 3)), (3.0, -3.0), 1e-3)
    assert path.direction[-1] - path.direction[0] == pytest.approx(2 * np.pi - 6.0)


def test_approach_traverses_at_park_height_and_touches_slowly():
    config = make_config()
    here = Posture(np.array([0.0, 0.0, 0.1]), PARKED, 0.0)
    start = Posture(np.array([0.03, 0.01, -5e-3]), np.array([0.04, 0.01, -7e-3]), 0.5)
    legs = tool_moves.approach(config, here, start, 0.03, Tools(1, True))
    tips = np.concatenate([leg.tip_1 for leg in legs])
    moved_sideways = np.linalg.norm(tips[:, :2] - tips[-1, :2], axis=1) > 1e-9
    assert tips[moved_sideways, 2].min() == pytest.approx(0.1)
    assert derivatives(tips)[0] <= 0.06 * 1.001
    assert legs[-1].speed.max() <= config.contact_speed * 1.001
    assert legs[-1].tip_2[-1] == pytest.approx(start.tip_2)


def test_long_links_are_refused():
    config = make_config()
    here = Posture(np.zeros(3), np.array([0.01, 0.0, 0.0]), 0.0)
    near = Posture(np.array([0.0, 0.001, -5e-4]), np.array([0.01, 0.001, -5e-4]), 0.0)
    far = Posture(np.array([0.0, 0.05, 0.0]), np.array([0.01, 0.05, 0.0]), 0.0)
    assert tool_moves.link(config, here, near, 0.03, Tools()) is not None
    assert tool_moves.link(config, here, far, 0.03, Tools()) is None


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"forming_tool": 3}, "must be 1 or 2"),
        ({"feed": 0.095}, "feed"),
        ({"forming_tip": np.full((160, 3), 0.13)}, "outside the travel"),
        ({"support_force": np.full(160, -1.0)}, "negative"),
        ({"feed": float("nan")}, "feed"),
        ({"forming_tip": np.zeros((160, 3)), "support_tip": np.tile([0.01, 0, 0], (160, 1))}, "no length"),
    ],
)
def test_contours_that_cannot_be_formed_are_refused(changes, match):
    with pytest.raises(IsfError, match=match) as caught:
        contour_path(ring(**changes), make_config(), (PARKED, PARKED), None)
    assert caught.value.code is ErrorCode.CONTOUR_REJECTED


def test_no_horizontal_normal_no_force_control():
    above = ring()
    above = ring(support_tip=above.forming_tip - [0.0, 0.0, 1e-2])
    with pytest.raises(IsfError, match="engage_depth"):
        contour_path(above, make_config(), (PARKED, PARKED), None)


@pytest.mark.parametrize(("override", "expected"), [(None, 120.0), (80.0, 80.0)])
def test_set_point_override(override, expected):
    assert contour_path(ring(), make_config(), (PARKED, PARKED), override).set_point == pytest.approx(expected)


def test_zero_override_is_position_control():
    assert np.isnan(contour_path(ring(), make_config(), (PARKED, PARKED), 0.0).set_point).all()
