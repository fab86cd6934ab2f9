"""Compiled platform: printed poses of Torrao 2013, forces of the legs, and the uncompiled hexapod as a judge."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.geometry.hexapod import rotation, spif_a
from isf_sim.legs import platform as pf

HEXAPOD = spif_a()
PLATFORM = pf.platform_of(HEXAPOD, 0.005, mass=30.0, gyration=0.15, spindle=30.6, rod=8.0)
MIDDLE = np.array([0.0, 0.0, -1.1172872, 0.0, 0.0, 0.0])


def legs_at(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    turned, rates, lengths = np.empty((3, 3)), np.empty((6, 6)), np.empty(6)
    pf.legs_of(pose, PLATFORM, turned, rates, lengths)
    return turned, rates, lengths


def test_legs_and_rates_are_the_derived_ones() -> None:
    pose = np.array([0.05, -0.03, -1.15, *np.radians([15.0, -20.0, 0.0])])
    expected = [1.2846204, 1.2053742, 1.1372849, 1.0894206, 1.1122499, 1.2320730]
    assert legs_at(pose)[2] == pytest.approx(expected, abs=1e-6)
    # Jacobian of leg 1 in the middle of the stroke: directions, and levers in m
    row = legs_at(MIDDLE)[1][0]
    assert row == pytest.approx([0.2022, -0.0438, -0.9784, 0.146754, -0.169457, 0.037917], abs=5e-5)


@given(
    place=st.tuples(st.floats(-0.25, 0.25), st.floats(-0.25, 0.25), st.floats(-1.2, -1.0)),
    degrees=st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(-3, 3)),
)
@settings(max_examples=30, deadline=None)
def test_pose_comes_back_from_its_lengths(place: tuple[float, ...], degrees: tuple[float, ...]) -> None:
    pose = np.array([*place, *np.radians(degrees)])
    lengths = HEXAPOD.lengths(pose[:3], pose[3:])
    assert legs_at(pose)[2] == pytest.approx(lengths, abs=1e-12)
    found = MIDDLE.copy()
    assert 0 <= pf.find_pose(lengths, PLATFORM, found) <= 8
    assert found == pytest.approx(pose, abs=1e-9)
    near = pose + [1e-3, -1e-3, 1e-3, *np.radians([0.5, -0.5, 0.5])]
    assert 0 <= pf.find_pose(lengths, PLATFORM, near) <= 3  # warm start


def test_a_tool_turns_about_its_ball() -> None:
    """The centre of the ball, and so the lowest point of it, stays when the tool tilts."""
    tip, tilt, pose = np.array([0.02, -0.01, -0.03]), np.radians([12.0, -25.0]), np.empty(6)
    pf.place_for(tip, tilt, PLATFORM, pose)
    turned = rotation(tilt)
    centre = pose[:3] - HEXAPOD.sheet - (HEXAPOD.tool_length - 0.005) * turned[:, 2]
    assert centre - [0.0, 0.0, 0.005] == pytest.approx(tip, abs=1e-12)
    found = np.empty(3)
    pf.tip_at(pose, turned, PLATFORM, found)
    assert found == pytest.approx(tip, abs=1e-12)
    upright, strokes = np.zeros(2), np.empty(6)
    assert pf.strokes_for(tip, upright, PLATFORM, strokes)
    assert strokes == pytest.approx(HEXAPOD.strokes(tip, upright), abs=1e-12)


@pytest.mark.parametrize(
    ("tip", "degrees"), [((0.55, 0.0, 0.0), (0.0, 0.0)), ((0.0, 0.0, 0.3), (0.0, 0.0)), ((0.0, 0.0, 0.0), (31.0, 0.0))]
)
def test_out_of_reach(tip: tuple[float, ...], degrees: tuple[float, float]) -> None:
    assert not pf.strokes_for(np.array(tip), np.radians(degrees), PLATFORM, np.empty(6))


@pytest.mark.parametrize(
    ("force", "expected"),
    [  # Torrao 2013, eq. 8.1, at the middle of the stroke with the tool of 100 mm
        ((0.0, 0.0, 13000.0), [2214.6] * 6),
        ((6500.0, 0.0, 13000.0), [-7477.0, -7477.0, 11151.0, 2969.0, 2969.0, 11151.0]),
        ((0.0, 6500.0, 13000.0), [6939.0, -2509.0, 8246.0, 12970.0, -8540.0, -3816.0]),
    ],
)
def test_forces_of_the_legs(force: tuple[float, ...], expected: list[float]) -> None:
    """Printed with the sign of the push; force of the sheet on the tool."""
    turned, rates, _ = legs_at(MIDDLE)
    wrench, pushes = np.empty(6), np.empty(6)
    pf.tip_wrench(np.array(force), turned, PLATFORM, wrench)
    assert pf.pushes_against(wrench, rates, pushes)
    assert pushes == pytest.approx(expected, abs=1.0)


def test_inertia_is_that_of_bodies_in_free_fall_and_at_rest() -> None:
    """Without forces of the legs everything falls with g: the legs' accelerations are those of a falling platform,
    less what the rods, which fall along their legs only, hold back; legs that carry the weights hold still."""
    light = pf.platform_of(HEXAPOD, 0.005, mass=30.0, gyration=0.15, spindle=30.6, rod=1e-9)
    pose = np.array([0.05, -0.03, -1.15, *np.radians([15.0, -20.0, 0.0])])
    turned, rates, _ = legs_at(pose)
    mobility, free, pull = np.empty((6, 6)), np.empty(6), np.empty(6)
    assert pf.seen_by_legs(turned, rates, np.zeros(6), light, mobility, free, pull)
    assert free == pytest.approx(rates[:, 2] * -pf.GRAVITY, abs=1e-7)
    # held: the sum of the forces along the legs is the weight, and their moment balances that of the spindle
    held = np.linalg.solve(mobility, -free)
    wrench = rates.T @ held
    assert wrench[:3] == pytest.approx([0.0, 0.0, 60.6 * pf.GRAVITY], abs=1e-6)
    arm = -0.219 * turned[:, 2]
    assert wrench[3:] == pytest.approx(np.cross(arm, [0.0, 0.0, 30.6 * pf.GRAVITY]), abs=1e-6)
    # kinetic energy of a motion, from the legs and from the bodies
    twist = np.array([0.1, -0.2, 0.05, 0.3, 0.2, -0.4])
    speeds = rates @ twist
    by_legs = 0.5 * speeds @ np.linalg.solve(mobility, speeds)
    spin, moving = twist[3:], twist[:3]
    spindle = moving + np.cross(spin, arm)
    axial = spin @ turned[:, 2]
    across = spin @ spin - axial**2
    plate = 30.0 * 0.15**2
    bodies = 0.5 * (30.0 * moving @ moving + 30.6 * spindle @ spindle)
    bodies += 0.5 * (plate * axial**2 + 0.5 * plate * across + 30.6 * 0.219**2 / 12.0 * across * 1.0)
    assert by_legs == pytest.approx(bodies, rel=1e-6)
