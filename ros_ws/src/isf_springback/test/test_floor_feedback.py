"""Passes over the floor: pressed to level from above, whatever the floor gives way, and not twice for one question."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.contour import Contour, over_floor
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_springback.corrector import FIRST_SHARE, NEXT_ROUND, FloorFeedback, at_edge
from isf_springback.estimators.learning import Learned, save
from isf_springback.methods import make_corrector
from springback_parts import JOB_TEXT, cone_contour

GRID = np.arange(-40, 41) * 1e-3
X, Y = np.meshgrid(GRID, GRID)
RADIUS = np.hypot(X, Y)
LEVEL = -10e-3
TARGET = HeightMap(GRID, GRID, np.where(RADIUS < 25e-3, LEVEL, 0.0))
RINGS = (20e-3, 15e-3, 10e-3, 5e-3)
WALL_PUSH = 1.0e-3


def floor_contour(index: int, radius: float, level: float = LEVEL, angle: float = 0.0) -> Contour:
    contour = cone_contour(index, radius=radius)
    tip = contour.forming_tip.copy()
    tip[:, :2] *= radius / np.hypot(*tip[0, :2])
    tip[:, 2] = level
    return replace(contour, forming_tip=tip, contact=tip, wall_angle=np.full(len(tip), angle), floor_passes=True)


EDGE = floor_contour(0, 25e-3)


def formed(feedback: FloorFeedback, springback: float, rounds: int = 3, dome: float = 0.6e-3) -> list[np.ndarray]:
    """Error of the floor (m) after every round; a pass leaves what it presses ``springback`` m over the tip.

    Beside a ring the floor follows over 5 mm, the rest of its dome sinks by half of that.
    """
    error = np.where(RADIUS < 25e-3, dome * (1.0 - (RADIUS / 25e-3) ** 2), 0.0)
    before, push = EDGE, np.full(len(EDGE), WALL_PUSH)
    rounds_left, index = [], 0
    for turn in range(rounds):
        for radius in RINGS if turn % 2 == 0 else RINGS[::-1]:
            index += 1
            contour = floor_contour(index, radius)
            pushed = feedback.push(contour, before, np.full(len(contour), push.mean()))
            assert pushed is not None
            feedback.add(contour, pushed)
            ring = np.abs(RADIUS - radius) < 1e-3
            sunk = max(0.0, float(error[ring].mean()) - (springback - float(pushed.mean())))
            weight = np.where(radius > RADIUS, 0.5, 0.0) + np.where(np.abs(RADIUS - radius) < 2.5e-3, 0.5, 0.0)
            error = error - sunk * np.where(RADIUS < 25e-3, np.minimum(weight + 0.5 * ring, 1.0), 0.0)
            feedback.update(HeightMap(GRID, GRID, TARGET.z + error), TARGET)
            before, push = contour, pushed
        rounds_left.append(error.copy())
    return rounds_left


@pytest.mark.parametrize("springback", [0.65e-3, 0.8e-3, 0.95e-3])
def test_a_floor_comes_to_its_level_from_above(springback: float) -> None:
    after = formed(FloorFeedback(), springback)
    inside = RADIUS < 22e-3
    assert np.abs(after[-1][inside]).mean() < np.abs(after[0][inside]).mean() < 0.6e-3
    # further rounds press half of what is left, so some of it is left: 0.102 mm at most of the three
    assert np.abs(after[-1][inside]).mean() < 0.12e-3
    assert np.abs(after[-1][inside]).max() < 0.3e-3
    assert min(error[inside].min() for error in after) > -0.3e-3


def test_the_first_pass_is_pressed_less_than_the_wall_and_asking_again_changes_nothing() -> None:
    feedback = FloorFeedback()
    first, second = floor_contour(1, 20e-3), floor_contour(2, 15e-3)
    for _ in range(2):
        push = feedback.push(first, EDGE, np.full(len(first), WALL_PUSH))
        assert push == pytest.approx(FIRST_SHARE * WALL_PUSH)
        feedback.add(first, push)
    feedback.update(HeightMap(GRID, GRID, TARGET.z + 0.1e-3), TARGET)
    answers = []
    for _ in range(2):
        push = feedback.push(second, first, np.full(len(second), WALL_PUSH))
        feedback.add(second, push)
        answers.append(push)
    assert np.array_equal(*answers)
    assert answers[0].mean() > FIRST_SHARE * WALL_PUSH  # what still stands up is pressed deeper


def test_what_lies_too_deep_is_pressed_less_and_a_hole_of_the_scan_is_as_beside_it() -> None:
    feedback = FloorFeedback()
    first, second = floor_contour(1, 20e-3), floor_contour(2, 15e-3)
    feedback.add(first, feedback.push(first, EDGE, np.full(len(first), WALL_PUSH)))
    shape = TARGET.z - 0.2e-3
    shape[(X > 10e-3) & (Y > 0.0)] = np.nan
    feedback.update(HeightMap(GRID, GRID, shape), TARGET)
    push = feedback.push(second, first, np.full(len(second), WALL_PUSH))
    assert push == pytest.approx(np.full(len(second), FIRST_SHARE * WALL_PUSH - 0.2e-3), abs=1e-6)


@pytest.mark.parametrize("every", [1, 2, 3, 5])
def test_what_a_scan_shows_is_pressed_once_however_long_the_next_one_takes(every: int) -> None:
    """A floor that springs back by 0.8 mm from every pass: 0.2 mm are left by the first, pressed with 0.6 mm."""
    feedback, before, push = FloorFeedback(), EDGE, np.full(len(EDGE), WALL_PUSH)
    feedback.update(HeightMap(GRID, GRID, TARGET.z + 0.8e-3), TARGET)  # of the wall: it says nothing of the passes
    pushes = []
    for index in range(1, 13):
        contour = floor_contour(index, 24e-3 - 1.5e-3 * index)
        pushed = feedback.push(contour, before, np.full(len(contour), push.mean()))
        assert pushed is not None
        feedback.add(contour, pushed)
        pushes.append(float(pushed.mean()))
        if index % every == 0:
            feedback.update(HeightMap(GRID, GRID, TARGET.z + 0.8e-3 - pushes[-1]), TARGET)
        before, push = contour, pushed
    assert pushes[:every] == pytest.approx([FIRST_SHARE * WALL_PUSH] * every)
    assert pushes[every:] == pytest.approx([0.8e-3] * (12 - every), abs=1e-6)


@pytest.mark.parametrize(("method", "on_the_floor"), [("learned", 0.5e-3), ("analytic", None)])
def test_a_method_that_replays_a_part_replays_its_passes_over_the_floor(
    method: str, on_the_floor: float | None, tmp_path: Path
) -> None:
    contours = [replace(EDGE, count=3), *(replace(floor_contour(k, r), count=3) for k, r in ((1, 20e-3), (2, 15e-3)))]
    index = np.concatenate([np.full(len(contour), contour.index) for contour in contours])
    push, none = np.full(len(index), 0.5e-3), np.zeros(len(index))
    place = np.concatenate([contour.contact[:, :2] for contour in contours])
    known = Learned("cone", 3, 1, index, place, push, push, none, none, np.zeros((0, 4)), np.zeros(0), np.zeros((1, 2)))
    save(known, tmp_path / "known.npz")
    job_file = JobFile(JOB_TEXT.replace("method: analytic", f"method: {method}, learning: known.npz"), tmp_path)
    corrector = make_corrector(method, job_file)
    corrections = [corrector.correct(contour) for contour in contours]
    assert [formed.code for formed in corrections] == ([0] * 3 if method == "learned" else [0, 1302, 1302])
    wanted = on_the_floor if on_the_floor is not None else -FIRST_SHARE * float(corrections[0].offset[:, 2].mean())
    for correction in corrections[1:]:
        assert -correction.offset[:, 2] == pytest.approx(np.full(len(correction.offset), wanted), abs=1e-6)


@pytest.mark.parametrize(("error", "share"), [(0.2e-3, NEXT_ROUND), (-0.2e-3, 1.0)])
def test_a_further_round_presses_part_of_what_is_left_but_gives_way_by_all(error: float, share: float) -> None:
    feedback = FloorFeedback()
    first = floor_contour(1, 20e-3)
    pushed = feedback.push(first, EDGE, np.full(len(first), WALL_PUSH))
    assert pushed is not None
    feedback.add(first, pushed)
    feedback.update(HeightMap(GRID, GRID, TARGET.z + error), TARGET)
    again = feedback.push(floor_contour(2, 20e-3), first, pushed)
    assert again == pytest.approx(pushed + share * error, abs=1e-6)


def test_a_scan_that_shows_nothing_changes_nothing() -> None:
    feedback = FloorFeedback()
    first, second = floor_contour(1, 20e-3), floor_contour(2, 15e-3)
    feedback.add(first, feedback.push(first, EDGE, np.full(len(first), WALL_PUSH)))
    feedback.update(HeightMap(GRID, GRID, np.full_like(X, np.nan)), TARGET)
    push = feedback.push(second, first, np.full(len(second), WALL_PUSH))
    assert push == pytest.approx(FIRST_SHARE * WALL_PUSH)


def test_what_passes_over_a_floor() -> None:
    ring = floor_contour(1, 20e-3)
    assert over_floor(ring, EDGE)
    assert not over_floor(ring, None)
    assert not over_floor(ring, replace(EDGE, feature=1))
    assert not over_floor(ring, replace(EDGE, plan_id="another"))
    assert not over_floor(ring, floor_contour(0, 25e-3, level=LEVEL + 0.5e-3))
    assert not over_floor(floor_contour(1, 20e-3, angle=np.radians(20.0)), EDGE)


def test_the_contour_that_reaches_the_floor_is_pressed_no_more_than_the_wall() -> None:
    wanted, before = np.full(len(EDGE), 1.4e-3), np.full(len(EDGE), WALL_PUSH)
    assert at_edge(replace(EDGE, floor_passes=False), wanted, before) == pytest.approx(wanted)
    assert at_edge(EDGE, wanted, before) == pytest.approx(before)
    wall = floor_contour(0, 25e-3, angle=np.radians(30.0))
    assert at_edge(wall, wanted, before) == pytest.approx(wanted)


def test_pockets_whose_passes_alternate_are_pressed_each_as_its_own_passes_before() -> None:
    """Partial paths go from pocket to pocket level by level: the passes over one floor say nothing of the other."""
    aside, contours = np.array([0.1, 0.0, 0.0]), []
    for radius, level, angle in ((26e-3, LEVEL + 0.5e-3, 50.0), *((r, LEVEL, 0.0) for r in (25e-3, *RINGS))):
        for feature, force in enumerate((300.0, 150.0)):
            ring = floor_contour(len(contours), radius, level, np.radians(angle)).shifted(feature * aside)
            expected = np.full(len(ring), force)
            contours.append(replace(ring, feature=feature, retract=True, count=12, predicted_force=expected))
    corrector = make_corrector("analytic", JobFile(JOB_TEXT, Path(".")))
    pushes = [-corrector.correct(contour).offset[:, 2] for contour in contours]
    for feature in (0, 1):
        wall, edge, *passes = pushes[feature::2]
        assert wall.mean() > 0.4e-3
        assert edge == pytest.approx(np.full(len(edge), wall.mean()), abs=1e-6)
        for push in passes:
            assert push == pytest.approx(np.full(len(push), FIRST_SHARE * wall.mean()), abs=1e-6)
    assert pushes[0].mean() > 1.2 * pushes[1].mean()
