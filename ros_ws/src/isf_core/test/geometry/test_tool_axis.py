"""The axis of a tool: orientation without roll, tilt, the point on the axis; scipy's rotations are the judge."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.geometry import tool_axis
from isf_core.geometry.hexapod import rotation
from scipy.spatial.transform import Rotation, Slerp

leaning = st.tuples(st.floats(0.0, 1.3), st.floats(-math.pi, math.pi)).map(
    lambda at: (math.sin(at[0]) * math.cos(at[1]), math.sin(at[0]) * math.sin(at[1]), math.cos(at[0]))
)


@settings(max_examples=60, deadline=None)
@given(leaning)
def test_orientation_and_tilt_are_those_of_the_machine_without_roll(axis: tuple[float, float, float]) -> None:
    """Torrao 2013, eq. 4.22 with roll 0: R = Ry Rx, whose third column is the axis; to 1 nrad."""
    tilt = tool_axis.tilt_of(np.array(axis))
    about_x_then_y = Rotation.from_euler("xy", tilt)
    assert rotation(tilt)[:, 2] == pytest.approx(np.array(axis), abs=1e-12)
    assert tool_axis.axis_of(tilt) == pytest.approx(np.array(axis), abs=1e-12)
    turn = Rotation.from_quat(tool_axis.quaternion_of(axis))
    assert (turn * about_x_then_y.inv()).magnitude() < 1e-9
    assert tool_axis.axis_of_quaternion(tool_axis.quaternion_of(axis)) == pytest.approx(axis, abs=1e-12)
    rolled = turn * Rotation.from_rotvec([0.0, 0.0, 0.7])
    assert tool_axis.axis_of_quaternion(rolled.as_quat()) == pytest.approx(axis, abs=1e-12)
    assert tool_axis.inclination(np.array(axis)) == pytest.approx(math.acos(min(1.0, axis[2])), abs=2e-8)


def test_an_upright_tool_has_exactly_no_rotation() -> None:
    assert tool_axis.quaternion_of(tool_axis.UPRIGHT) == (0.0, 0.0, 0.0, 1.0)
    assert tool_axis.axis_of_quaternion((0.0, 0.0, 0.0, 1.0)) == tool_axis.UPRIGHT
    assert (tool_axis.tilt_of(tool_axis.UP) == 0.0).all()
    assert all(map(math.isnan, tool_axis.axis_of_quaternion((0.0, 0.0, 0.0, 0.0))))


@pytest.mark.parametrize("place", range(4))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_an_orientation_that_is_not_finite_is_no_axis(place: int, value: float) -> None:
    quaternion = [0.0, 0.0, 0.0, 1.0]
    quaternion[place] = value
    assert any(map(math.isnan, tool_axis.axis_of_quaternion(quaternion)))


@settings(max_examples=60, deadline=None)
@given(leaning, leaning, st.floats(0.0, 1.0))
def test_axes_in_between_are_on_the_great_circle(
    first: tuple[float, ...], second: tuple[float, ...], at: float
) -> None:
    one, two = np.array(first), np.array(second)
    found = tool_axis.between(one, two, np.array([0.0, at, 1.0]))
    assert found[0] == pytest.approx(one, abs=1e-8)
    assert found[2] == pytest.approx(two, abs=1e-8)
    whole = float(tool_axis.angle_between(one, two))
    assert float(tool_axis.angle_between(one, found[1])) == pytest.approx(at * whole, abs=1e-7)
    if whole > 1e-3:
        across, _ = Rotation.align_vectors([two], [one])
        path = Slerp([0.0, 1.0], Rotation.concatenate([Rotation.identity(), across]))
        assert found[1] == pytest.approx(path([at])[0].apply(one), abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(leaning, st.sampled_from([1.0, -1.0]), st.floats(1e-3, 20e-3))
def test_the_ball_stays_where_it_is_when_the_tool_tilts(axis: tuple[float, ...], side: float, radius: float) -> None:
    """Tip and point on the axis are both one radius from the ball's centre: upper (1) and lower (-1) tool."""
    tip, leans = np.array([0.01, -0.02, -0.03]), side * np.array(axis)
    point = tool_axis.point_on_axis(tip, leans, radius)
    centre = tip + [0.0, 0.0, side * radius]
    assert point == pytest.approx(centre - radius * leans, abs=1e-12)
    assert tool_axis.tip_of_point(point, leans, radius) == pytest.approx(tip, abs=1e-12)
    assert tool_axis.point_on_axis(tip, np.array([0.0, 0.0, side]), radius) == pytest.approx(tip, abs=0.0)


def test_turn_per_length_sees_the_seam_of_a_closed_path() -> None:
    """Along a circle of 20 mm with 30 deg of tilt: sin 30 deg / 20 mm, by hand."""
    angle = np.linspace(0.0, 2 * np.pi, 400, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(400)])
    axis = 0.5 * ring + [0.0, 0.0, math.sqrt(0.75)]
    turn = tool_axis.turn_per_length(0.02 * ring, axis, closed=True)
    assert turn == pytest.approx(np.full(400, 0.5 / 0.02), rel=1e-4)
    jump = axis.copy()
    jump[0] = tool_axis.UP
    assert tool_axis.turn_per_length(0.02 * ring, jump, closed=True)[-1] > 1000.0
    assert tool_axis.turn_per_length(0.02 * ring, jump, closed=False)[-1] < 30.0
