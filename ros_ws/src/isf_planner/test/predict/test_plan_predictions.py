"""Predictions along a plan: published forces, limits with their place, time against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from isf_core.contour import Contour
from isf_core.files.job import JobFile, load_job
from isf_planner.predict import predictions
from isf_planner.predict.predictions import predict, step_depths, warnings_of, with_predictions
from planner_contours import circle
from planner_parts import EXAMPLES

JOB = """\
name: praveen
part: {mesh: none.stl, unit: mm}
process: SPIF
rig: ren2018
sheet: {material: Al8011, thickness: 0.8 mm}
tool_1: {radius: 6.35 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
"""


@pytest.fixture
def praveen() -> JobFile:
    return JobFile(JOB, EXAMPLES)


@pytest.mark.parametrize(
    ("angle", "axial", "radial"), [(25, 351.2, 0.0), (30, 384.9, 0.0), (45, 452.5, 3.0), (60, 433.1, 69.0)]
)
def test_equilibrium_along_a_contour(angle: float, axial: float, radial: float, praveen: JobFile) -> None:
    """Praveen 2020 eq. 1-3 evaluated to one digit; negative radial forces are held at zero."""
    (prediction,) = predict([circle(angle=np.radians(angle), sheet=0.8e-3)], praveen)
    np.testing.assert_allclose(prediction.axial_equilibrium, axial, rtol=1e-3)
    np.testing.assert_allclose(prediction.radial_equilibrium, radial, atol=0.5)
    assert prediction.equilibrium_valid.all()


@pytest.mark.parametrize(("angle", "axial"), [(25, 338), (30, 376), (45, 432), (60, 393)])
def test_regression_fills_the_predicted_force(angle: float, axial: float, praveen: JobFile) -> None:
    """Praveen 2020 eq. 1-3 evaluated to whole newtons."""
    (contour,), reported = with_predictions([circle(angle=np.radians(angle), sheet=0.8e-3)], praveen)
    np.testing.assert_allclose(contour.predicted_force, axial, atol=1.0)
    assert reported == ()
    contour.validate()


def test_models_are_held_at_the_edge_of_their_range(praveen: JobFile) -> None:
    (flat,) = predict([circle(angle=0.01, sheet=0.8e-3)], praveen)
    (edge,) = predict([circle(angle=np.radians(20) + 1e-12, sheet=0.8e-3)], praveen)
    assert not flat.regression_valid.any()
    assert edge.regression_valid.all()
    np.testing.assert_allclose(flat.axial, edge.axial)
    np.testing.assert_allclose(flat.axial_equilibrium, edge.axial_equilibrium)


def test_too_thin_sheet_is_warned_of_with_its_place(praveen: JobFile) -> None:
    """Al8011 allows 68 deg, a loss of 62.5 %; the warning comes from 95 % of that."""
    good = circle(angle=np.radians(50), sheet=0.8e-3)
    thin = good.thickness.copy()
    thin[7] = 0.8e-3 * 0.39
    reported = warnings_of(
        [good, replace(good, thickness=thin)], predict([good, replace(good, thickness=thin)], praveen), praveen
    )
    assert len(reported) == 1
    x, y, z = good.contact[7] * 1e3
    assert f"contour 2 at x = {x:.1f}, y = {y:.1f}, z = {z:.1f} mm" in reported[0]
    assert "close to the 63 %" in reported[0]
    thin[7] = 0.8e-3 * 0.3
    assert "beyond the 63 %" in with_predictions([replace(good, thickness=thin)], praveen)[1][0]


def test_force_beyond_the_rig_and_extrapolation() -> None:
    heavy = JobFile(JOB.replace("Al8011, thickness: 0.8 mm", "AA7075-O, thickness: 4 mm"), EXAMPLES)
    reported = with_predictions([circle(angle=np.radians(50), sheet=4e-3)], heavy)[1]
    assert len(reported) == 2
    assert "the rig allows 2000 N" in reported[0]
    assert "sheet of 4.00 mm (known for 0.5 to 2 mm)" in reported[1]


def test_step_depths_follow_each_feature() -> None:
    contours = [circle(z=z, feature=f) for z, f in ((-1e-3, 0), (-1.4e-3, 0), (-1e-3, 1), (-2e-3, 0), (-1.7e-3, 1))]
    np.testing.assert_allclose(step_depths(contours, 0.5e-3), [0.5e-3, 0.4e-3, 0.5e-3, 0.6e-3, 0.7e-3])


def arc(contour: Contour, begin: float, end: float) -> Contour:
    """The part of a circle between two bearings, deg, as an open pass."""
    share = np.arange(len(contour)) / len(contour) * 360.0
    kept = (share >= begin) & (share < end)
    names = ("contact", "normal", "wall_angle", "thickness", "forming_tip")
    return replace(contour, closed=False, **{name: getattr(contour, name)[kept] for name in names})


def test_step_depths_of_partial_paths_are_those_on_their_own_wall() -> None:
    """A ring, then passes on two walls in turn, and a ring again, most of which is below neither of them."""
    wall = {"left": (100.0, 260.0), "right": (-1.0, 80.0)}
    passes = [("", -1.0), ("left", -1.3), ("right", -1.9), ("left", -1.7), ("right", -2.8), ("", -3.0), ("right", -3.4)]
    contours = []
    for name, level in passes:
        ring = circle(radius=30e-3 + 1e-3 * level, z=level * 1e-3)
        contours.append(arc(ring, *wall[name]) if name else ring)
    steps = step_depths(contours, 0.5e-3, 15e-3)
    np.testing.assert_allclose(steps, [0.5e-3, 0.3e-3, 0.9e-3, 0.4e-3, 0.9e-3, 2e-3, 0.4e-3], atol=1e-9)
    # of contours that are no partial paths the one before counts, wherever it runs
    np.testing.assert_allclose(
        step_depths(contours, 0.5e-3), [0.5e-3, 0.3e-3, 0.6e-3, 0.2e-3, 1.1e-3, 0.2e-3, 0.4e-3], atol=1e-9
    )


def test_a_first_pass_far_from_all_others_has_the_incremental_depth() -> None:
    contours = [circle(radius=5e-3, z=-1e-3), circle(radius=40e-3, z=-1.2e-3)]
    np.testing.assert_allclose(step_depths(contours, 0.5e-3, 15e-3), [0.5e-3, 0.5e-3])


def test_time_of_a_circle_and_of_moves(praveen: JobFile) -> None:
    first, second = circle(z=-1e-3), replace(circle(z=-2e-3), index=1)
    one, two = predict([first, second], praveen)
    circumference = 2 * np.pi * np.hypot(*first.forming_tip[0, :2])
    assert one.time == pytest.approx(circumference / first.feed, rel=1e-4)
    assert two.travel_time == pytest.approx(np.linalg.norm(second.forming_tip[0] - first.forming_tip[0]) / first.feed)
    lifted = predict([first, replace(second, retract=True)], praveen)[1]
    assert lifted.travel_time > 0.2 / 0.1  # up and down 100 mm each at 100 mm/s


def test_speed_of_the_points_counts(praveen: JobFile) -> None:
    contour = circle()
    slow = replace(contour, speed=np.full(len(contour), contour.feed / 2))
    assert predictions.contour_time(slow) == pytest.approx(2 * predictions.contour_time(contour))


def test_planned_part_carries_its_forces() -> None:
    from isf_planner import plan

    made = plan(load_job(EXAMPLES / "jobs" / "mini_cone.yaml"))
    forces: list[Contour] = [contour for contour in made.contours if len(contour.predicted_force) == len(contour)]
    assert len(forces) == len(made.contours)
    # AA5754-O of 1 mm at 45 deg, R 5 mm, step 0.5 mm by the regression: 0.0716 * 215 * 10^0.41 * 0.0125^0.09 * 45 * cos
    assert forces[5].predicted_force.max() == pytest.approx(
        0.0716 * 215 * 10**0.41 * 0.0125**0.09 * 45 * np.cos(np.radians(45)), rel=0.02
    )
