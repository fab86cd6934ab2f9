"""Two tools over a near backing plate: where the lower one waits, how it rises, and what is left as it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import IsfError
from isf_core.files.job import JobFile
from isf_planner import plan
from isf_planner.exports.programs import path_points
from isf_planner.part_plan import Plan
from isf_planner.paths.support_tool import waiting
from planner_parts import Cone, job_for, write
from scipy.spatial import cKDTree

TOOL = 5e-3


def over_plate(folder: Path, opening: float, **changes: str) -> JobFile:
    """Cone of 30 mm radius, 12 mm deep, over a round plate with ``opening`` mm across."""
    job = job_for(write(Cone().mesh(20e-6), folder / "cone.stl"), **changes)
    return JobFile(f"{job.text}\nbacking_plate: {{shape: circle, size: [{opening:g} mm, {opening:g} mm]}}", job.base)


@pytest.fixture(scope="module")
def near(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return plan(over_plate(tmp_path_factory.mktemp("near"), 66.0))


@pytest.fixture(scope="module")
def wide(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return plan(over_plate(tmp_path_factory.mktemp("wide"), 84.0))


def waits(made: Plan) -> list[bool]:
    return [contour.support_waits for contour in made.contours]


def test_the_lower_tool_waits_until_the_plate_leaves_it_room(near: Plan, wide: Plan) -> None:
    """Room: its radius of 5 mm inside the opening of 33 mm. Then both plans are the same."""
    furthest = [float(np.hypot(*contour.support_tip[:, :2].T).max()) for contour in wide.contours]
    first = next(k for k, reach in enumerate(furthest) if reach + TOOL <= 33e-3)
    assert 3 <= first < len(furthest)
    assert waits(near) == [k < first for k in range(len(furthest))]
    assert not any(waits(wide))
    for here, there in zip(near.contours, wide.contours, strict=True):
        assert np.array_equal(here.forming_tip, there.forming_tip)
        if here.index >= first:
            assert np.array_equal(here.support_tip, there.support_tip)
            assert np.array_equal(here.support_force, there.support_force)
        else:
            assert not here.force_controlled
    (told,) = [text for text in near.warnings if "waits below the sheet" in text]
    assert f"until contour {first + 1}, " in told
    assert not any("waits below" in text for text in wide.warnings)


def test_it_stands_clear_of_sheet_and_plate_and_rises_straight_to_the_wall(near: Plan) -> None:
    """Distances of its ball to the lower face of all that is formed by then: along the contacts, and below the tool."""
    contours = near.contours
    first = waits(near).index(False)
    place = contours[0].support_tip[0]
    assert all(np.array_equal(contour.support_tip, np.tile(place, (len(contour), 1))) for contour in contours[:first])
    assert np.hypot(*place[:2]) + TOOL <= 33e-3
    formed = np.vstack([c.contact - c.thickness[:, None] * c.normal for c in contours[: first + 1]])
    floor_level = float(contours[first].forming_tip[:, 2].min())
    inside = np.linspace(-1.0, 1.0, 81)
    gx, gy = np.meshgrid(inside, inside)
    reach = float(np.hypot(*contours[first].contact[:, :2].T).min())
    flat = np.column_stack([reach * gx.ravel(), reach * gy.ravel(), np.full(gx.size, floor_level - 1e-3)])
    sheet = cKDTree(np.vstack([formed, flat[np.hypot(gx.ravel(), gy.ravel()) < 1.0]]))
    apart = sheet.query(place - [0.0, 0.0, TOOL])[0] - TOOL
    assert apart > 4e-3
    wanted = contours[first].support_tip[0]
    assert np.array_equal(place[:2], wanted[:2])
    rising = np.column_stack([np.tile(place[:2], (200, 1)), np.linspace(place[2], wanted[2], 200) - TOOL])
    distance = sheet.query(rising)[0]
    assert np.all(np.diff(distance) < 0.0)  # nothing is in the way before the wall that it goes to
    assert distance[-1] == pytest.approx(TOOL, abs=0.2e-3)


def test_a_program_moves_no_tool_by_leaps(near: Plan) -> None:
    """The lower tool comes with lifted tools; beside the feed of the upper one it has no centimetres to go."""
    points = path_points(near.contours)
    first = waits(near).index(False)
    begins = int(np.flatnonzero(points.contour == first)[0])
    assert np.flatnonzero(points.lift).tolist() == [0, begins]
    step = np.linalg.norm(np.diff(points.tool_2, axis=0), axis=1)
    until = np.flatnonzero(points.contour == first)[-1]
    assert step[:until][~points.lift[1 : until + 1]].max() < 1e-3
    assert step[begins - 1] > 5e-3


def test_corrected_it_goes_on_standing_still(near: Plan) -> None:
    """A correction pushes the upper tool down and sideways, point by point: the lower one makes room for it at once."""
    contour = near.contours[0]
    turn = np.linspace(0.0, 2.0 * np.pi, len(contour), endpoint=False)
    offset = 1e-3 * np.column_stack([np.cos(turn), np.sin(turn), -2.0 - np.sin(turn)])
    moved = contour.shifted(offset)
    assert np.allclose(moved.support_tip - contour.support_tip, [0.0, 0.0, -3e-3], atol=1e-5)
    assert moved.support_waits
    assert np.array_equal(contour.shifted(-offset).support_tip, contour.support_tip)


def test_it_waits_through_no_whole_feature(tmp_path: Path, wide: Plan) -> None:
    """Contours of a feature that has no room all the way down, and of another one that has, are left to the check."""
    job = over_plate(tmp_path, 66.0).job
    far = [replace(one, feature=2) for one in wide.contours]
    near_edge = [one.shifted(np.tile([20e-3, 0.0, 0.0], (len(one), 1))) for one in wide.contours]
    placed, told = waiting([*near_edge, *far], job)
    assert not told
    assert not any(one.support_waits for one in placed)


def test_a_plate_that_never_leaves_room_is_refused(tmp_path: Path) -> None:
    """A lower tool of 20 mm over an opening of 33 mm: the floor begins 18 mm from the middle, 13 mm is its room."""
    job = over_plate(tmp_path, 66.0)
    with pytest.raises(IsfError, match=r"lower tool of radius 20.00 mm would run .* into the edge"):
        plan(JobFile(job.text.replace("tool_2: {radius: 5 mm}", "tool_2: {radius: 20 mm}"), job.base))


def test_two_tools_are_told_of_the_near_plate(tmp_path: Path) -> None:
    """The advice for an unbacked part is a plate over which it can be planned."""
    job = job_for(write(Cone().mesh(20e-6), tmp_path / "cone.stl"))
    (told,) = [text for text in plan(job).warnings if "put a backing_plate closer" in text]
    size = told.split("({")[1].split("})")[0]
    made = plan(JobFile(f"{job.text}\nbacking_plate: {{{size}}}", job.base))
    assert any(waits(made))
    assert not any("is free for" in text for text in made.warnings)
