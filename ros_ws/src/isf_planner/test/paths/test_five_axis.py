"""The axis along contours: the published formula, its bounds, what a rig cannot do, and what shank and holder meet."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.tool_axis import angle_between, inclination, point_on_axis, tilt_of, turn_per_length
from isf_planner import Plan, plan
from isf_planner.checks.shank_checks import check_shank
from isf_planner.paths.five_axis import pressing_axis, smoothed, with_tool_axis
from planner_parts import EXAMPLES, told

DEG = np.pi / 180.0
JOBS = EXAMPLES / "jobs"
NORMALS = Path(__file__).parent / "joints_along_normals.yaml"
"""Rig whose joints do not allow 30 deg."""


def job_with(axis: str, *, rig: str = "torrao2013", tool: str = "stick_out: 70 mm") -> JobFile:
    """The example in few contours."""
    if rig == "normals":
        rig = str(NORMALS)
    text = (JOBS / "torrao_cone_45_five_axis.yaml").read_text(encoding="utf-8")
    for old, new in (
        ("incremental_depth: 1 mm", "incremental_depth: 4 mm"),
        ("point_spacing: 1 mm", "point_spacing: 2 mm"),
        ("strategy: auto", axis),
        ("rig: torrao2013", f"rig: {rig}"),
        ("tool_1: spif_a_ball_10", f"tool_1: {{radius: 5 mm, {tool}}}"),
    ):
        assert old in text
        text = text.replace(old, new)
    return JobFile(text, JOBS)


HOLDER = "holder: [{length: 60 mm, radius: 25 mm}]"


@pytest.fixture(scope="module")
def upright() -> Plan:
    return plan(job_with("strategy: vertical"))


@pytest.mark.parametrize(("wall", "tilt"), [(0.0, 0.0), (10.0, 10.0), (30.0, 30.0), (45.0, 30.0), (70.0, 30.0)])
def test_the_tool_leans_towards_the_normal_by_the_wall_angle_at_most_30_deg(wall: float, tilt: float) -> None:
    """delta = min(lambda, 30 deg), Torrao 2013, 6.2.3: the wall at +x slopes up outwards, its normal points to -x."""
    normal = np.array([[-math.sin(wall * DEG), 0.0, math.cos(wall * DEG)]])
    axis = pressing_axis(normal, 30.0 * DEG)
    assert axis[0] == pytest.approx([-math.sin(tilt * DEG), 0.0, math.cos(tilt * DEG)], abs=1e-12)
    assert math.degrees(math.acos(min(1.0, float(axis[0] @ normal[0])))) == pytest.approx(wall - tilt, abs=1e-5)


angles = st.lists(st.tuples(st.floats(0.0, 1.4), st.floats(-3.1, 3.1)), min_size=4, max_size=40)


@settings(max_examples=60, deadline=None)
@given(angles, st.floats(2e-3, 30e-3), st.booleans())
def test_smoothed_axes_turn_no_faster_than_the_bound(
    walls: list[tuple[float, float]], length: float, closed: bool
) -> None:
    """2 tan(30 deg) over the length of the average, whatever the normals do; 5 % for samples of the average."""
    slope, around = np.array(walls).T
    normal = np.column_stack([np.sin(slope) * np.cos(around), np.sin(slope) * np.sin(around), np.cos(slope)])
    turn = np.linspace(0.0, 2 * np.pi, len(walls), endpoint=False)
    points = 0.03 * np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])
    axis = smoothed(points, pressing_axis(normal, 30 * DEG), length, closed=closed)
    assert np.linalg.norm(axis, axis=1) == pytest.approx(np.ones(len(axis)), abs=1e-12)
    assert inclination(axis).max() <= 30 * DEG + 1e-9
    assert turn_per_length(points, axis, closed=closed).max() <= 1.05 * 2 * math.tan(30 * DEG) / length


def test_three_and_five_axes_have_the_same_tips_and_contacts(upright: Plan) -> None:
    """Bit by bit, which is less than 10 um; only axis and speed differ."""
    tilted = plan(job_with("{strategy: five_axis, largest_tilt: 20 deg}"))
    for one, other in zip(upright.contours, tilted.contours, strict=True):
        np.testing.assert_array_equal(one.forming_tip, other.forming_tip)
        np.testing.assert_array_equal(one.contact, other.contact)
        assert not one.tilted
        assert inclination(other.forming_axis) == pytest.approx(np.minimum(other.wall_angle, 20 * DEG), abs=0.2 * DEG)
        turn = turn_per_length(other.forming_tip, other.forming_axis, closed=other.closed)
        speed = other.speed if len(other.speed) else np.full(len(other), other.feed)
        assert (speed * turn).max() <= 10.001 * DEG  # rad/s, of tool_axis.largest_rate
    assert tilted.largest_tilt == pytest.approx(20 * DEG, abs=0.1 * DEG)
    assert tilted.forming_time > 1.2 * upright.forming_time
    assert tilted.shank is not None
    assert tilted.shank.distance > 1e-3
    assert upright.shank is None


def test_auto_tilts_as_far_as_the_rig_reaches_and_says_so() -> None:
    job_file = job_with("strategy: auto", rig="normals")
    made = plan(job_file)
    hexapod = job_file.rig.make_kinematics()[0]
    for contour in made.contours:
        point = point_on_axis(contour.forming_tip, contour.forming_axis, 5e-3)
        assert hexapod.reachable(point, tilt_of(contour.forming_axis)).all()
    assert 20 * DEG < made.largest_tilt < 29 * DEG
    assert any("tilted less than asked for" in text for text in made.warnings)


@pytest.mark.parametrize("length", [43, 70, 100])
def test_the_wall_of_45_deg_is_pressed_with_30_deg_by_every_tool_of_the_source(length: int) -> None:
    """Torrao 2013, 6.2.3: delta = min(lambda, 30 deg), on all of the wall."""
    made = plan(job_with("strategy: auto", tool=f"stick_out: {length} mm, shank_radius: 4 mm"))
    assert told(made) == ()
    for contour in made.contours[1:-1]:
        assert inclination(contour.forming_axis) / DEG == pytest.approx(np.full(len(contour), 30.0), abs=0.3)


def test_auto_leaves_the_tool_upright_on_a_rig_that_cannot_tilt_it(upright: Plan) -> None:
    """The same job with another rig: one word."""
    made = plan(job_with("strategy: auto", rig="ren2018"))
    assert not any(contour.tilted for contour in made.contours)
    for one, other in zip(upright.contours, made.contours, strict=True):
        np.testing.assert_array_equal(one.forming_tip, other.forming_tip)


@pytest.mark.parametrize(
    ("axis", "rig", "tool", "code", "words"),
    [
        ("strategy: five_axis", "ren2018", "stick_out: 70 mm", "TOOL_AXIS_REFUSED", "ren2018 cannot tilt"),
        (
            "{strategy: five_axis, largest_tilt: 40 deg}",
            "torrao2013",
            "stick_out: 70 mm",
            "TOOL_AXIS_REFUSED",
            "40.0 deg are asked for",
        ),
        ("strategy: five_axis", "normals", "stick_out: 70 mm", "PART_DOES_NOT_FIT", "joint of cylinder"),
        (
            "{strategy: auto, largest_rate: 0.01 deg/s}",
            "torrao2013",
            "stick_out: 70 mm",
            "TOOL_AXIS_REFUSED",
            "deg per mm of path",
        ),
        (
            "strategy: auto",
            "torrao2013",
            f"stick_out: 15 mm, {HOLDER}",
            "SHANK_COLLISION",
            "the holder of the tilted tool would run 3.2",
        ),
    ],
)
def test_what_cannot_be_is_refused_with_code_and_place(
    axis: str, rig: str, tool: str, code: str, words: str, upright: Plan
) -> None:
    job_file = job_with(axis, rig=rig, tool=tool)
    known = code == "TOOL_AXIS_REFUSED"  # before anything is looked at that takes a while
    with pytest.raises(IsfError, match=words) as caught:
        with_tool_axis(upright.contours, job_file) if known else plan(job_file)
    assert caught.value.code == ErrorCode[code]
    assert caught.value.where
    assert caught.value.advice


@pytest.mark.parametrize(
    ("tool", "words", "end"),
    [
        ("stick_out: 15 mm", "the holder of the tilted tool would run 3.2", "say what it is in tool_1.holder"),
        ("shank_radius: 14 mm", "the shank of the tilted tool would run 2.7", "is that wide down to the ball"),
        (f"shank_radius: 14 mm, stick_out: 70 mm, {HOLDER}", "the shank of the", "is that wide down to the ball"),
    ],
)
def test_a_tilted_tool_is_warned_of_where_a_size_is_assumed(tool: str, words: str, end: str) -> None:
    made = plan(job_with("strategy: auto", tool=tool))
    (warning,) = (text for text in told(made) if "tilted tool" in text)
    assert warning.startswith(words)
    assert "with the tip at" in warning
    assert warning.endswith(end)
    assert made.shank is not None
    assert made.shank.distance < -2e-3


def test_a_shank_no_wider_than_the_tip_is_refused_where_radius_and_length_are_told() -> None:
    """Turned from 30 deg away from the wall of 45 deg to 60 deg towards it."""
    made = plan(job_with("strategy: auto"))
    turned = np.array([*[-math.sin(60 * DEG) / math.sin(30 * DEG)] * 2, math.cos(60 * DEG) / math.cos(30 * DEG)])
    leaning = [replace(contour, forming_axis=turned * contour.forming_axis) for contour in made.contours[1:-1]]

    def warnings(tool: str) -> tuple[str, ...]:
        thin = f"{tool}, holder: [{{length: 60 mm, radius: 5 mm}}]"
        return check_shank(leaning, made.target, job_with("strategy: auto", tool=thin))[1]

    (radius,) = warnings("stick_out: 70 mm")
    assert "the shank of the tilted tool would run" in radius
    assert "if the shank has the radius of the tip, 5 mm; that is assumed" in radius
    assert radius.endswith("tool_1.shank_radius")
    (length,) = warnings("shank_radius: 5 mm")
    assert length.endswith(
        "if the holder begins 70 mm above the tip; that is assumed: say what it is in tool_1.stick_out"
    )
    with pytest.raises(IsfError, match="the shank of the tilted tool would run") as caught:
        warnings("shank_radius: 5 mm, stick_out: 70 mm")
    assert caught.value.code == ErrorCode.SHANK_COLLISION


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("strategy: auto", "{strategy: vertical, largest_tilt: 10 deg}", "largest_tilt"),
        ("strategy: auto", "{strategy: five_axis, largest_tilt: 30}", "unit"),
        ("strategy: auto", "{strategy: five_axis, largest_rate: 0 deg/s}", "largest_rate"),
        ("tool", "corner_radius: 1 mm", "flat tip"),
    ],
)
def test_a_job_that_asks_for_what_has_no_effect_or_no_sense_is_refused(old: str, new: str, field: str) -> None:
    axis = "strategy: five_axis" if old == "tool" else new
    with pytest.raises(IsfError, match=field) as caught:
        job_with(axis, tool=new if old == "tool" else "stick_out: 70 mm")
    assert caught.value.code in (ErrorCode.FILE_FIELD, ErrorCode.FILE_UNIT)


def test_open_contours_that_go_on_share_the_axis_where_they_join(upright: Plan) -> None:
    """A spiral: each contour is half of a ring here, and the axis has no step where the next one goes on."""
    halves: list[Contour] = []
    for ring in upright.contours[:2]:
        middle = len(ring) // 2
        whole = np.append(np.arange(len(ring)), 0)
        for index in (whole[: middle + 1], whole[middle:]):
            named = ("contact", "normal", "wall_angle", "thickness", "forming_tip", "predicted_force")
            part = {name: getattr(ring, name)[index] for name in named}
            halves.append(replace(ring, closed=False, index=len(halves), **part))
    made = with_tool_axis(halves, job_with("strategy: auto"))
    assert float(angle_between(made[0].forming_axis[-1], made[1].forming_axis[0])) < 1e-6


def test_the_marker_draws_the_same_rings_upright_and_tilted() -> None:
    """The marker test of Torrao 2013, 7: the tip's path is that of the upright tool, only the axis leans."""
    text = (JOBS / "torrao_marker.yaml").read_text(encoding="utf-8")
    tilted = "tool_axis: {strategy: five_axis, largest_tilt: 25 deg}\n"
    assert tilted.strip() in text.replace("\n# ", " ")  # as the file advises
    pairs = list(zip(plan(JobFile(text, JOBS)).contours, plan(JobFile(text + tilted, JOBS)).contours, strict=True))
    assert len(pairs) == 8
    for straight, leaning in pairs:
        assert np.abs(straight.forming_tip - leaning.forming_tip).max() < 1e-12
        assert len(straight.forming_axis) == 0
    largest = [math.degrees(math.acos(leaning.forming_axis[:, 2].min())) for _, leaning in pairs]
    assert largest[1:-1] == pytest.approx([25.0] * 6, abs=0.1)
