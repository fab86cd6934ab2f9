"""Kinematics: round trips, the published geometry of the SPIF-A hexapod, and its limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.hexapod import spif_a
from isf_core.geometry.kinematics import Gantry, make_kinematics


@pytest.mark.parametrize(
    ("place", "tilt", "lengths"),
    [
        ((0.0, 0.0, -911.8830), (0, 0), [942.0] * 6),
        ((0.0, 0.0, -1321.0339), (0, 0), [1342.0] * 6),
        ((100.0, 0.0, -1100.0), (0, 0), [1149.7919, 1149.7919, 1115.3829, 1123.1205, 1123.1205, 1115.3829]),
        ((200.0, -150.0, -1100.0), (0, 0), [1198.2109, 1185.6262, 1147.7477, 1169.1731, 1109.9396, 1101.0562]),
        ((0.0, 0.0, -1100.0), (10, 0), [1150.4751, 1099.5386, 1087.4797, 1112.5938, 1138.0549, 1163.8401]),
        ((50.0, -30.0, -1150.0), (15, -20), [1284.6204, 1205.3742, 1137.2849, 1089.4206, 1112.2499, 1232.0730]),
    ],
)
def test_cylinder_lengths_of_known_poses(
    place: tuple[float, float, float], tilt: tuple[float, float], lengths: list[float]
) -> None:
    """Numbers follow from the plates of Torrao 2013, 4.2 (edges 600/200 and 300/150 mm) to 1e-4 mm."""
    found = 1e3 * spif_a().lengths(1e-3 * np.array(place), np.radians(np.array(tilt, dtype=float)))
    assert found == pytest.approx(lengths, abs=1e-3)


reach = st.floats(-0.09, 0.09)
angle = st.floats(-0.15, 0.15)


@settings(max_examples=60, deadline=None)
@given(reach, reach, st.floats(-0.08, 0.08), angle, angle)
def test_hexapod_round_trip(x: float, y: float, z: float, a: float, b: float) -> None:
    """Tip and tilt to cylinders and back: 1 nm and 1 nrad."""
    tip, tilt = np.array([x, y, z]), np.array([a, b])
    again, turned = spif_a().tip(spif_a().positions(tip, tilt))
    assert again == pytest.approx(tip, abs=1e-9)
    assert turned == pytest.approx(tilt, abs=1e-9)


def test_tip_stays_when_the_tool_tilts() -> None:
    hexapod = spif_a()
    upright, leaning = hexapod.positions(np.zeros(3)), hexapod.positions(np.zeros(3), np.array([0.2, 0.0]))
    assert np.abs(upright - leaning).max() > 1e-3
    assert hexapod.tip(leaning)[0] == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize(
    ("tip", "tilt"), [([0.0, 0.0, 0.5], [0.0, 0.0]), ([0.0, 0.0, -0.5], [0.0, 0.0]), ([0.0, 0.0, 0.0], [0.6, 0.0])]
)
def test_hexapod_refuses_what_its_cylinders_cannot_reach(tip: list[float], tilt: list[float]) -> None:
    with pytest.raises(IsfError) as error:
        spif_a().positions(np.array(tip), np.array(tilt))
    assert error.value.code == ErrorCode.TARGET_OUT_OF_WORKSPACE


def test_lengths_that_fit_no_pose_are_refused() -> None:
    with pytest.raises(IsfError):
        spif_a().tip(np.array([0.0, 0.4, 0.0, 0.4, 0.0, 0.4]))


def test_gantry_is_its_own_pose_and_does_not_tilt() -> None:
    upper, lower = make_kinematics()
    assert (upper.axes, lower.axes) == (("X", "Y", "Z"), ("U", "V", "W"))
    tip = np.array([0.01, 0.02, -0.03])
    assert lower.tip(upper.positions(tip))[0] == pytest.approx(tip)
    with pytest.raises(IsfError):
        Gantry().positions(tip, np.array([0.1, 0.0]))
    assert len(make_kinematics(spif_a())[0].axes) == 6
