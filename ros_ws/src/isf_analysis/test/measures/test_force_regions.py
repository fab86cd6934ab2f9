"""Force by region of the path and losses of contact, from results whose force is known at every point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_analysis.measures.force_regions import (
    AFTER,
    BEFORE,
    CHORD,
    CORNER_RADIUS,
    REGIONS,
    contact_losses,
    curvature,
    path_forces,
    region_forces,
    regions_along,
)
from isf_core.contour import Contour, ContourResult, Process
from isf_core.types import Array

TRANSITION, CORNER, WALL = range(3)


def circle(radius: float, spacing: float = 0.5e-3) -> Array:
    angle = np.linspace(0, 2 * np.pi, round(2 * np.pi * radius / spacing), endpoint=False)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(len(angle), -1e-3)])


def square(half: float, spacing: float = 0.5e-3) -> Array:
    """Sharp corners; begins in the middle of a side."""
    corners = np.array([[half, 0], [half, half], [-half, half], [-half, -half], [half, -half], [half, 0]])
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    places = np.arange(0, along[-1], spacing)
    return np.column_stack([*(np.interp(places, along, corners[:, k]) for k in (0, 1)), np.zeros(len(places))])


def result_along(tip: Array, force: Array, *, set_point: float = 100.0, turn: float = 0.7) -> ContourResult:
    """Support tool 10 mm beside the forming tool in direction ``turn`` (rad), normal force ``force`` at the points."""
    direction = np.array([np.cos(turn), np.sin(turn), 0.0])
    across = np.array([-np.sin(turn), np.cos(turn), 0.0])
    ticks = 50
    return ContourResult(
        plan_id="p",
        index=4,
        start=1.0,
        end=2.0,
        completed=True,
        forming_force=np.zeros_like(tip),
        # neither the force along the wall nor the axial one counts
        support_force=force[:, None] * direction + 33.0 * across + [0.0, 0.0, -70.0],
        forming_target=tip,
        support_target=tip + 0.01 * direction - [0.0, 0.0, 2e-3],
        force_offset=np.zeros(len(tip)),
        compliance_offset=np.zeros_like(tip),
        tick_time=np.linspace(1.0, 2.0, ticks),
        tick_set_point=np.full(ticks, set_point) if set_point > 0 else np.empty(0),
        tick_normal_force=np.full(ticks, 100.0),
        tick_engaged=np.ones(ticks, dtype=bool),
    )


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.5, -1.8])
def test_the_force_is_that_along_the_horizontal_between_the_tools(turn: float) -> None:
    tip = circle(30e-3)
    force = 100.0 + 5.0 * np.sin(np.linspace(0, 9, len(tip)))
    (path,) = path_forces([result_along(tip, force, turn=turn)])
    np.testing.assert_allclose(path.force, force, atol=1e-9)
    np.testing.assert_allclose(path.error, force - 100.0, atol=1e-9)
    assert path.index == 4


@settings(max_examples=15, deadline=None)
@given(radius=st.floats(4e-3, 80e-3))
def test_curvature_of_a_circle(radius: float) -> None:
    # the turn between two chords of length c of a circle: 2 asin(c / 2r) over c; chords of polygons are shorter
    np.testing.assert_allclose(curvature(circle(radius)), 1 / radius, rtol=0.03)


def test_corners_of_a_square_and_nothing_else_are_corners() -> None:
    tip = square(40e-3)
    region = regions_along(tip)
    side = np.abs(np.abs(tip[:, :2]) - 40e-3)
    from_corner = side.max(axis=1)
    # the turn of a sharp corner is seen from both sides within a chord
    assert (region[from_corner < 0.9 * CHORD] == CORNER).all()
    assert (region[(from_corner > 1.1 * CHORD)] != CORNER).all()


def test_a_round_contour_has_no_corner_however_small() -> None:
    for radius in (6e-3, 9e-3, 40e-3):
        assert not (regions_along(circle(radius)) == CORNER).any()


def test_a_rounded_corner_is_reported_by_its_radius() -> None:
    def rounded(radius: float) -> Array:
        """Quarter circle between two straight lines of 60 mm."""
        arc = np.linspace(0, np.pi / 2, max(3, round(radius * np.pi / 2 / 0.5e-3)))
        line = np.arange(0, 60e-3, 0.5e-3)
        first = np.column_stack([line - 60e-3, np.zeros(len(line))])
        turn = radius * np.column_stack([np.sin(arc), 1 - np.cos(arc)])
        last = np.column_stack([np.full(len(line), radius), radius + 0.5e-3 + line])
        return np.column_stack([np.concatenate([first, turn, last]), np.zeros(2 * len(line) + len(arc))])

    assert (regions_along(rounded(0.6 * CORNER_RADIUS)) == CORNER).any()
    assert not (regions_along(rounded(1.5 * CORNER_RADIUS)) == CORNER).any()


def test_transitions_are_at_both_ends_of_the_path() -> None:
    tip = circle(30e-3)
    region = regions_along(tip)
    along = 0.5e-3 * np.arange(len(tip))
    step = 1e-3
    assert (region[along < AFTER - step] == TRANSITION).all()
    assert (region[along > along[-1] - BEFORE + step] == TRANSITION).all()
    assert (region[(along > AFTER + step) & (along < along[-1] - BEFORE - step)] == WALL).all()


def test_errors_are_counted_in_their_regions() -> None:
    tip = square(40e-3)
    region = regions_along(tip)
    force = np.select([region == TRANSITION, region == CORNER], [100.0 + 3.0, 100.0 - 12.0], 100.0 + 1.0)
    numbers = region_forces(path_forces([result_along(tip, force)]))
    assert list(numbers) == [*REGIONS, "all"]
    for name, error in (("transition", 3.0), ("corner", -12.0), ("wall", 1.0)):
        assert numbers[name].mean_error == pytest.approx(error)
        assert numbers[name].rms_error == pytest.approx(abs(error))
        assert numbers[name].max_abs_error == pytest.approx(abs(error))
        assert numbers[name].within_band == (abs(error) <= 10.0)
    assert sum(numbers[name].points for name in REGIONS) == numbers["all"].points == len(tip)
    assert numbers["all"].max_abs_error == pytest.approx(12.0)


def test_the_error_is_that_from_the_set_point_of_the_place() -> None:
    """Two walls with 100 and 200 N: the ticks have both, the contour says where; one replaced force goes for both."""
    tip = square(40e-3)
    wanted = np.where(tip[:, 0] > tip[:, 0].mean(), 200.0, 100.0)
    contour = Contour(
        plan_id="p",
        index=4,
        count=9,
        process=Process.DSIF,
        feed=0.015,
        contact=tip,
        normal=np.tile([0.0, 0.0, 1.0], (len(tip), 1)),
        wall_angle=np.full(len(tip), 0.8),
        thickness=np.full(len(tip), 1e-3),
        forming_tip=tip,
        support_force=wanted,
    )
    result = result_along(tip, wanted + 3.0)
    both = replace(result, tick_set_point=np.repeat([100.0, 200.0], 25))
    (path,) = path_forces([both], [contour])
    np.testing.assert_allclose(path.error, 3.0)
    (replaced,) = path_forces([result], [contour])
    np.testing.assert_allclose(replaced.error, wanted + 3.0 - 100.0)


def test_losses_are_reported_with_place_length_and_region() -> None:
    tip = circle(30e-3)
    force = np.full(len(tip), 100.0)
    force[60:80] = 0.0
    force[200] = -2.0
    losses = contact_losses(path_forces([result_along(tip, force)]))
    assert [loss.contour for loss in losses] == [4, 4]
    assert losses[0].start == pytest.approx(tuple(tip[60]))
    assert losses[0].length == pytest.approx(20 * 0.5e-3, rel=0.01)
    assert losses[1].length == pytest.approx(0.5e-3, rel=0.01)
    assert {loss.region for loss in losses} == {"wall"}
    whole = contact_losses(path_forces([result_along(tip, np.zeros(len(tip)))]))
    assert len(whole) == 1
    assert whole[0].region == "transition"
    assert whole[0].length == pytest.approx(path_forces([result_along(tip, force)])[0].length)


def test_position_control_has_losses_but_no_error() -> None:
    tip = circle(30e-3)
    force = np.where(np.arange(len(tip)) < 100, 0.0, 60.0)
    numbers = region_forces(path_forces([result_along(tip, force, set_point=0.0)]))
    assert np.isnan(numbers["all"].rms_error)
    assert numbers["all"].lost_share == pytest.approx(100 / len(tip))


def test_what_was_not_reached_and_what_has_no_support_is_left_out() -> None:
    tip = circle(30e-3)
    result = result_along(tip, np.full(len(tip), 100.0))
    force, target = result.support_force.copy(), result.support_target.copy()
    force[150:], target[150:] = np.nan, np.nan
    (path,) = path_forces([replace(result, support_force=force, support_target=target, completed=False)])
    assert len(path.force) == 150
    none = np.empty((0, 3))
    assert path_forces([replace(result, support_force=none, support_target=none)]) == ()
    assert region_forces(()) == {}
    above = replace(result, support_target=tip - [0.0, 0.0, 5e-3])  # one ball straight below the other
    assert path_forces([above]) == ()
