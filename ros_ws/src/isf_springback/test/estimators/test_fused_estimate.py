"""What "fused" takes for the model's fault, and what for that of the force forecast: no swing between the two."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_springback.corrector import apply
from isf_springback.estimators.analytic import AnalyticModel, AnalyticOptions
from isf_springback.estimators.fused import DEEPER, FusedEstimator, ModelledContour, expected_error
from isf_springback.scan import FormedShape
from isf_springback.scan.readings import CONTOURS_PER_PLACE, read_errors
from springback_parts import JOB_TEXT, cone_contour, corrector_of, result_of

COMPLIANCE = 6e-6
"""m/N of the linear sheet."""

COUNT = 36
GRID = np.arange(-60, 61) * 1e-3
X, Y = np.meshgrid(GRID, GRID)
TARGET = HeightMap(GRID, GRID, np.clip((np.hypot(X, Y) - 36e-3) * np.tan(np.radians(50.0)), -22e-3, 0.0))


class LinearModel(AnalyticModel):
    """A sheet whose springback is proportional to the force."""

    def _springback(self, contour, place, angle, expected):
        return COMPLIANCE * expected.force


def gone(passed):
    """Share of the movement to come that a place has made which the contact has passed by ``passed`` m."""
    return np.clip((passed - 2e-3) / 4e-3, 0.0, 1.0)


def formed(true, stiffness, bump=0.0, edge=0.0, later=0.0, remarks=None):
    """(COUNT,) m, corrections of a part on which the force is 700 N + ``stiffness`` x (growth of the push).

    The sheet springs back ``true`` times what the model says; at contour 14 the force is ``bump`` N more. The edge of
    the opening, which is all that the first scans show, stands ``edge`` m higher. A place of the wall rises by
    ``later`` m while the contact goes from 2 to 6 mm further inwards.
    """
    job_file = JobFile(JOB_TEXT.replace("method: analytic", "scan_every: 1, method: fused"), Path("."))
    rig_size = GRID[-1] - GRID[0]
    job_file.rig = job_file.rig.model_copy(
        update={"clamp": job_file.rig.clamp.model_copy(update={"size": (rig_size, rig_size)})}
    )
    method = corrector_of(FusedEstimator, job_file, lambda job: LinearModel(job, AnalyticOptions(law="hold")))
    method.set_target(TARGET)
    pushes: list[float] = []
    radii: list[float] = []
    error = np.zeros_like(X)
    for index in range(COUNT):
        contour = cone_contour(index, count=COUNT)
        contour = replace(contour, predicted_force=np.full(len(contour), 700.0))
        correction = method.correct(contour)
        if remarks is not None:
            remarks.extend(correction.remarks)
        pushes.append(-float(correction.offset[:, 2].mean()))
        growth = 0.0 if index == 0 else pushes[-1] - pushes[-2]
        force = max(700.0 + stiffness * growth + (bump if index == 14 else 0.0), 50.0)
        method.add_result(apply(contour, correction), result_of(contour, force))
        inside = np.hypot(X, Y) <= np.hypot(*contour.contact[0, :2]) + 0.2e-3
        bottom = float(contour.forming_tip[0, 2])
        radii.append(float(np.hypot(*contour.contact[0, :2])))
        passed, way = np.hypot(X, Y) - radii[-1], radii[max(index - 1, 0)] - radii[-1]
        rise = later * (gone(passed) - gone(passed - way))
        error = np.where(inside, true * COMPLIANCE * force - pushes[-1], error + np.where(TARGET.z < 0.0, rise, 0.0))
        shape = (
            np.maximum(TARGET.z, bottom)
            + error
            + np.where(TARGET.z < 0.0, edge if index < CONTOURS_PER_PLACE else 0.0, 0.0)
        )
        method.add_scan(np.column_stack([X.ravel(), Y.ravel(), shape.ravel()]), index)
    return np.array(pushes)


@pytest.mark.parametrize("true", [0.85, 1.0, 1.15])
def test_the_correction_finds_the_springback_of_a_sheet_that_is_off(true):
    assert formed(true, 0.0)[-10:] == pytest.approx(np.full(10, true * COMPLIANCE * 700.0), abs=0.15e-3)


def test_a_force_that_the_push_raises_does_not_make_it_swing():
    """60 N more on one contour move the push by what they bend; the force that this raises does not keep it going."""
    pushes = formed(1.0, 60e3, bump=60.0)
    assert np.ptp(pushes[15:18]) > 0.05e-3
    assert np.ptp(pushes[-8:]) < 0.05e-3
    assert pushes[-1] == pytest.approx(COMPLIANCE * 700.0, abs=0.1e-3)


@pytest.mark.parametrize("later", [0.5e-3, -0.4e-3])
def test_a_wall_that_moves_after_the_tool_has_passed_is_formed_as_much_too_deep_or_high(later):
    """Where it ends is what counts; a wall that stays is formed where it is wanted, as the tests above hold."""
    pushes = formed(1.0, 0.0, later=later)
    assert pushes[26:34] == pytest.approx(np.full(8, COMPLIANCE * 700.0 + later), abs=0.15e-3)


def test_a_wall_that_moves_by_more_than_a_millimetre_is_allowed_for_one_and_that_is_said():
    remarks = []
    pushes = formed(1.0, 0.0, later=2.5e-3, remarks=remarks)
    assert 0.9e-3 < pushes.max() - COMPLIANCE * 700.0 < 1.3e-3  # the wall bias follows a little, too
    assert any("a finished wall rises by" in text and "allows for 1 mm" in text for text in remarks)
    remarks.clear()
    formed(1.0, 0.0, later=0.5e-3, remarks=remarks)
    assert not any("finished wall" in text for text in remarks)


def test_an_edge_that_stands_too_high_is_left_and_one_that_lies_too_deep_is_not_pressed_deeper():
    model = COMPLIANCE * 700.0
    high, deep = formed(1.0, 0.0, edge=0.5e-3)[:CONTOURS_PER_PLACE], formed(1.0, 0.0, edge=-0.5e-3)[:CONTOURS_PER_PLACE]
    assert high == pytest.approx(np.full(CONTOURS_PER_PLACE, model), abs=1e-6)
    assert deep[0] == high[0]
    assert (np.diff(deep) < 0.0).all()
    assert deep[-1] < model - 0.3e-3


def step(index, pushed, model):
    contour = cone_contour(index)
    return ModelledContour(contour, np.full(len(contour), pushed), np.full(len(contour), model))


def test_a_wall_is_made_by_several_contours_until_one_goes_deeper():
    place = cone_contour(8).forming_tip[::40, :2]
    even = [step(6, 5.0e-3, 5.2e-3), step(7, 5.1e-3, 5.2e-3), step(8, 5.2e-3, 5.2e-3)]
    assert expected_error(even, place) == pytest.approx(np.full(len(place), 0.1e-3))
    deeper = [*even[:2], step(8, 5.1e-3 + 1.1 * DEEPER, 5.4e-3)]
    assert expected_error(deeper, place) == pytest.approx(np.full(len(place), 0.3e-3 - 1.1 * DEEPER))


def shape_of(heights):
    return FormedShape(HeightMap(GRID, GRID, heights), 1.0, 0, None, None, np.zeros(2), 0.0, 0.0)


def test_the_bottom_is_read_by_area_and_what_was_formed_long_before_does_not_count():
    """A ring beside the tip, nearly half of the area from there to half of the way to the middle, lies deeper."""
    contour = cone_contour(20)
    tip, level = float(np.hypot(*contour.forming_tip[0, :2])), float(contour.forming_tip[0, 2])
    ring = np.hypot(X, Y) > 0.8 * tip
    floor = np.maximum(TARGET.z, level)
    assert bottom(contour, floor + np.where(ring, -0.3e-3, 0.1e-3)) == pytest.approx(-0.09e-3, abs=0.03e-3)
    assert bottom(contour, floor + np.where(ring, -4.0e-3, 0.1e-3)) == pytest.approx(-0.14e-3, abs=0.05e-3)  # 1 mm grid


def bottom(contour, heights):
    return float(read_errors(contour, shape_of(heights), TARGET, 5e-3).bottom.mean())
