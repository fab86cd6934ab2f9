"""Paths of the contours: spiral, ramps, direction, start points, speed; on a cone and on a star."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_planner import Plan, plan
from isf_planner.loops.tip_loops import LIFT, signed_area
from isf_planner.part.meshes import load_mesh
from isf_planner.part_library import PARTS, part_mesh
from isf_planner.paths import contour_making
from isf_planner.surface import tip_surface
from isf_planner.surface.target_surface import fine_surface
from planner_parts import Cone as ConePart
from planner_parts import job_for, write

R = 5e-3
CONE = ConePart(opening=20e-3, depth=6e-3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("parts")
    write(CONE.mesh(), place / "cone.stl")
    write(part_mesh(PARTS["star"]()), place / "star.stl")
    write(part_mesh(PARTS["two_pockets"]()), place / "two_pockets.stl")
    return place


def planned(folder: Path, name: str, options: str = "", **changes: str) -> Plan:
    """Plan with further lines of the path section."""
    job = job_for(folder / f"{name}.stl", **({"depth": "1 mm", "spacing": "0.5 mm"} | changes))
    return plan(type(job)(job.text.replace("squeeze_factor:", f"{options} squeeze_factor:"), folder))


def line_of(contours: tuple[Contour, ...]) -> np.ndarray:
    return np.vstack([contours[0].forming_tip[:1], *[contour.forming_tip[1:] for contour in contours]])


def turns_of(line: np.ndarray) -> np.ndarray:
    """deg, change of direction at every inner point."""
    step = np.diff(line, axis=0)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip((step[1:] * step[:-1]).sum(axis=1), -1, 1)))


@pytest.mark.parametrize("direction", ["ccw", "cw"])
@pytest.mark.parametrize("name", ["cone", "star"])
def test_spiral(folder: Path, name: str, direction: str) -> None:
    contours = planned(folder, name, f"style: spiral, direction: {direction},").contours
    levels = len({round(c.forming_tip[0, 2], 9) for c in planned(folder, name).contours})
    assert len(contours) == levels + 1  # one turn on the first and one on the last loop
    for one, following in pairwise(contours):
        assert not one.closed
        np.testing.assert_array_equal(one.forming_tip[-1], following.forming_tip[0])
        np.testing.assert_allclose(one.support_tip[-1], following.support_tip[0], atol=1e-9)
    assert not any(contour.retract for contour in contours)
    line = line_of(contours)
    assert (np.diff(line[:, 2]) <= 1e-12).all()
    step = np.linalg.norm(np.diff(line, axis=0), axis=1)
    assert np.abs(step / 0.5e-3 - 1).max() < 0.03
    # the tip is on its surface: levels are taken 2 um above, Newton's method is done to less than 1 um
    surface = fine_surface(load_mesh(folder / f"{name}.stl", "mm"), R)
    height, _ = tip_surface.drop_tool(surface, line[:, :2], R)
    assert np.abs(height - LIFT - line[:, 2]).max() < 1e-6
    area = signed_area(contours[0].forming_tip[:-1, :2])
    assert (area > 0) == (direction == "ccw")


def test_spiral_of_a_cone_has_no_seam(folder: Path) -> None:
    """Around a cone the direction turns evenly, also where one contour passes into the next."""
    contours = planned(folder, "cone", "style: spiral,", depth="0.5 mm").contours
    for k in range(2, len(contours) - 2):
        one, following = contours[k - 1].forming_tip, contours[k].forming_tip
        seam = turns_of(np.vstack([one[-4:], following[1:4]]))
        # the facets of the mesh turn by 2 deg each; the turn before has a larger radius
        within = np.concatenate([turns_of(one), turns_of(following)])
        assert within.min() - 1e-9 <= seam.min()
        assert seam.max() <= within.max() + 1e-9
        even = np.degrees(0.5e-3 / np.hypot(*following[0, :2]))
        assert seam.mean() == pytest.approx(even, rel=0.1)
    # the radius follows the wall: its closed form at every height; at the floor it is not defined that well
    for contour in contours:
        for tip in contour.forming_tip[::40]:
            loose = 20e-6 if tip[2] > -5.9e-3 else 0.4e-3
            assert np.hypot(*tip[:2]) == pytest.approx(CONE.tip(tip[2], R)[0], abs=loose)
    bearing = np.unwrap(np.arctan2(*line_of(contours)[:, 1::-1].T))
    assert (bearing[-1] - bearing[0]) / (2 * np.pi) == pytest.approx(len(contours), abs=0.01)


def test_every_feature_has_its_own_spiral(folder: Path) -> None:
    contours = planned(folder, "two_pockets", "style: spiral,", depth="2 mm").contours
    lifted = [contour.index for contour in contours if contour.retract]
    features = [contour.feature for contour in contours]
    assert len(set(features)) > 1
    changes = [k for k in range(1, len(features)) if features[k] != features[k - 1]]
    assert lifted == changes
    for one, following in pairwise(contours):
        joined = np.array_equal(one.forming_tip[-1], following.forming_tip[0])
        assert joined != following.retract


def test_ramps_join_closed_loops(folder: Path) -> None:
    contours = planned(folder, "cone", "transition: ramp, ramp_length: 8 mm,").contours
    plain = planned(folder, "cone").contours
    assert len(contours) == len(plain)
    for contour, loop in zip(contours, plain, strict=True):
        level = loop.forming_tip[0, 2]
        flat = contour.forming_tip[contour.forming_tip[:, 2] < level + 1e-9]
        length = np.linalg.norm(np.diff(flat, axis=0), axis=1).sum()
        full = np.linalg.norm(np.roll(loop.forming_tip, -1, axis=0) - loop.forming_tip, axis=1).sum()
        assert length == pytest.approx(full, abs=1.1e-3)  # once around, to a point spacing at either end
    for one, following in pairwise(contours):
        np.testing.assert_array_equal(one.forming_tip[-1], following.forming_tip[0])
        ramp = following.forming_tip[following.forming_tip[:, 2] > following.forming_tip[-1, 2] + 1e-9]
        assert np.linalg.norm(np.diff(ramp, axis=0), axis=1).sum() == pytest.approx(8e-3, abs=1.5e-3)
    starts = np.unwrap([np.arctan2(contour.forming_tip[0, 1], contour.forming_tip[0, 0]) for contour in contours[1:]])
    assert (np.diff(starts) > 0.2).all()  # 8 mm further along each time


def test_direction_and_start_points(folder: Path) -> None:
    plain = planned(folder, "cone").contours
    for direction, sign in (("cw", [-1] * 6), ("alternating", [1, -1, 1, -1, 1, -1])):
        contours = planned(folder, "cone", f"direction: {direction},").contours
        assert [int(np.sign(signed_area(contour.forming_tip[:, :2]))) for contour in contours] == sign
        for contour, other in zip(contours, plain, strict=True):
            np.testing.assert_array_equal(contour.forming_tip[0], other.forming_tip[0])
            assert {tuple(p) for p in contour.support_tip} == {tuple(p) for p in other.support_tip}
    staggered = planned(folder, "cone", "stagger: 5 mm,").contours
    for k, (contour, other) in enumerate(zip(staggered, plain, strict=True)):
        place = int(np.argmin(np.linalg.norm(other.forming_tip - contour.forming_tip[0], axis=1)))
        np.testing.assert_array_equal(contour.forming_tip[0], other.forming_tip[place])
        assert place * 0.5e-3 == pytest.approx(5e-3 * k, abs=0.6e-3)


def test_tools_stay_apart_by_the_thickness_along_a_spiral(folder: Path) -> None:
    for contour in planned(folder, "star", "style: spiral,").contours:
        first = contour.forming_tip + [0, 0, R]
        second = contour.support_tip - [0, 0, R]
        np.testing.assert_allclose(
            np.linalg.norm(first - second, axis=1), 2 * R + contour.thickness, atol=1e-9
        )  # R1 + R2 + t (Praveen 2020, 2.5)


def test_options_that_contradict_each_other_are_refused(folder: Path) -> None:
    for options in ("style: spiral, direction: alternating,", "transition: ramp, stagger: 3 mm,"):
        with pytest.raises(IsfError) as caught:
            planned(folder, "cone", options)
        assert caught.value.code is ErrorCode.FILE_FIELD


def accelerations(line: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """m/s^2 at the inner points of a line passed at ``speed``, from its mean over two points before and after."""
    step = np.linalg.norm(np.diff(line, axis=0), axis=1)
    time = np.concatenate([[0.0], np.cumsum(2 * step / (speed[1:] + speed[:-1]))])
    before = (line[2:-2] - line[:-4]) / (time[2:-2] - time[:-4])[:, None]
    after = (line[4:] - line[2:-2]) / (time[4:] - time[2:-2])[:, None]
    return np.linalg.norm(2 * (after - before) / (time[4:] - time[:-4])[:, None], axis=1)


@pytest.mark.parametrize("options", ["", "style: spiral,"])
def test_speed_keeps_the_acceleration(folder: Path, options: str) -> None:
    limit, feed = 0.1, 30e-3
    contours = planned(folder, "star", f"{options} acceleration: 100 mm/s^2,").contours
    lines = [(line_of(contours), np.concatenate([contours[0].speed[:1], *[c.speed[1:] for c in contours]]))]
    if not options:
        lines = [(contour.forming_tip, contour.speed) for contour in contours]
    for line, speed in lines:
        assert 0 < speed.min() <= speed.max() <= feed + 1e-12
        assert speed.max() > 0.9 * feed
        assert speed[0] < 0.2 * feed
        # 3 %: the mean over two points is not the place itself
        assert accelerations(line, speed)[3:-3].max() < 1.03 * limit
    if options:  # no stop between the turns
        for one, following in pairwise(contours):
            assert one.speed[-1] == following.speed[0]
        assert min(contour.speed[0] for contour in contours[1:]) > 0.2 * feed


def test_without_an_acceleration_the_feed_holds_everywhere(folder: Path) -> None:
    assert all(len(contour.speed) == 0 for contour in planned(folder, "cone").contours)


def test_speed_in_a_right_angle() -> None:
    corner = np.array([[x, 0.0, 0.0] for x in np.arange(0, 50.0)] + [[49.0, y, 0.0] for y in np.arange(1.0, 50)]) * 1e-3
    speed = contour_making.speeds(corner, False, 50e-3, 0.5)
    assert int(np.argmin(speed[10:-10])) + 10 in (48, 49, 50)
    assert speed[20] == pytest.approx(50e-3)
    assert speed[0] == speed[-1] == pytest.approx(0.02 * 50e-3)
