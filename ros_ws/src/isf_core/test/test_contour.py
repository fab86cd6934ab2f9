"""Contour: validation names the field at fault, shifting keeps the gap."""

from dataclasses import replace

import numpy as np
import pytest
from ball_gap import tool_gap
from hypothesis import given
from hypothesis import strategies as st
from isf_core.contour import Contour, Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.process.thickness_and_tips import forming_tip, support_tip


def ring(points: int = 40, radius: float = 0.02, slope: float = np.pi / 4) -> Contour:
    """A horizontal ring on a cone wall of the given slope (rad)."""
    angle = np.linspace(0, 2 * np.pi, points, endpoint=False)
    outward = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(points)])
    contact = radius * outward + [0, 0, -0.01]
    normal = -np.sin(slope) * outward + [0, 0, np.cos(slope)]
    thickness = np.full(points, 1e-3 * np.cos(slope))
    return Contour(
        plan_id="ring-1",
        index=0,
        count=1,
        process=Process.DSIF,
        feed=0.03,
        contact=contact,
        normal=normal,
        wall_angle=np.full(points, slope),
        thickness=thickness,
        forming_tip=forming_tip(contact, normal, 5e-3),
        support_tip=support_tip(contact, normal, 4e-3, thickness),
        support_force=np.full(points, 120.0),
    )


def test_a_sound_contour_is_accepted() -> None:
    contour = ring()
    assert contour.validate() is contour
    assert contour.has_support
    assert contour.force_controlled
    # chord of a 40-gon of radius 0.02 - 5 mm * sin 45 deg
    assert contour.arc_length()[-1] == pytest.approx(39 * 2 * (0.02 - 5e-3 * np.sqrt(0.5)) * np.sin(np.pi / 40))


@pytest.mark.parametrize("name", ["contact", "normal", "wall_angle", "thickness", "forming_tip", "support_tip"])
def test_a_nan_is_refused_with_field_and_point(name: str) -> None:
    contour = ring()
    array = getattr(contour, name).copy()
    array[7] = np.nan
    with pytest.raises(IsfError, match=f"{name} is not finite at point 7") as caught:
        replace(contour, **{name: array}).validate()
    assert caught.value.code == ErrorCode.CONTOUR_REJECTED


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"feed": 0.0}, "feed"),
        ({"feed": float("nan")}, "feed"),
        ({"forming_tool": 3}, "forming_tool"),
        ({"normal": np.zeros((39, 3))}, "normal has shape"),
        ({"support_force": np.zeros(3)}, "support_force has shape"),
        ({"forming_tip": np.zeros((2, 3))}, "needs 3 or more"),
    ],
)
def test_wrong_fields_are_refused_by_name(change: dict, text: str) -> None:
    with pytest.raises(IsfError, match=text):
        replace(ring(), **change).validate()


@given(st.tuples(*[st.floats(-0.01, 0.01)] * 3))
def test_shifting_moves_both_tools_and_keeps_the_gap(offset: tuple[float, float, float]) -> None:
    contour = ring()
    moved = contour.shifted(np.tile(offset, (len(contour), 1)))
    before = tool_gap(contour.forming_tip, contour.support_tip, 5e-3, 4e-3)
    after = tool_gap(moved.forming_tip, moved.support_tip, 5e-3, 4e-3)
    # rounding of sums of 1e-2 m in double precision
    np.testing.assert_allclose(after, before, atol=1e-15)
    np.testing.assert_allclose(moved.contact - contour.contact, np.tile(offset, (len(contour), 1)), atol=1e-15)


def tilted(tilt: float = np.pi / 6) -> Contour:
    """The ring with its tool leaning towards the normal."""
    contour = ring()
    flat = contour.normal[:, :2] / np.linalg.norm(contour.normal[:, :2], axis=1)[:, None]
    return replace(contour, forming_axis=np.column_stack([np.sin(tilt) * flat, np.full(len(contour), np.cos(tilt))]))


def test_a_tilted_contour_is_accepted_and_an_upright_one_needs_no_axis() -> None:
    assert tilted().validate().tilted
    assert not ring().tilted


@pytest.mark.parametrize(
    ("axis", "word"),
    [
        ((0.0, 0.0, 0.0), "no unit vector"),
        ((np.nan, 0.0, 1.0), "not finite"),
        ((0.0, 0.0, 1.1), "no unit vector"),
        ((0.0, 0.0, -1.0), "through the sheet"),
        ((0.6, 0.0, -0.8), "through the sheet"),
        ((0.8, 0.0, 0.6), "through the sheet"),  # into the wall of 45 deg at x > 0
    ],
)
def test_an_axis_that_is_none_or_leaves_on_the_wrong_side_is_refused(axis: tuple[float, ...], word: str) -> None:
    contour = tilted()
    contour.forming_axis[0] = axis
    with pytest.raises(IsfError, match=word) as caught:
        contour.validate()
    assert caught.value.code == ErrorCode.CONTOUR_REJECTED
    assert "point 0" in caught.value.what
