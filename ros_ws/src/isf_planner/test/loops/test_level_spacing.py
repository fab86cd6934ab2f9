"""Levels by depth, scallop height and distance down the wall, on parts where the exact step is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_planner import Plan, plan
from planner_parts import Cone, job_for, write

R = 5e-3


def planned(cone: Cone, folder: Path, spacing: str, chord_error: float = 10e-6) -> Plan:
    path = write(cone.mesh(chord_error), folder / "cone.stl")
    job_file = job_for(path, process="SPIF", spacing="1 mm", depth="1 mm", limit="80 deg")
    text = job_file.text.replace("feed: 30 mm/s,", f"feed: 30 mm/s, {spacing},")
    return plan(type(job_file)(text, path.parent))


def on_the_wall(made: Plan, cone: Cone) -> np.ndarray:
    """(K, 2) m, radius and z of the contacts on the straight wall, one for each contour."""
    contacts = np.array([contour.contact[0] for contour in made.contours])
    straight = (contacts[:, 2] < cone.entry_end - 1e-4) & (contacts[:, 2] > cone.floor_begin + 1e-4)
    return np.column_stack([np.hypot(*contacts[straight, :2].T), contacts[straight, 2]])


@pytest.mark.parametrize("angle", [35.0, 60.0])
def test_constant_distance_down_the_wall(angle: float, tmp_path: Path) -> None:
    cone = Cone(angle=np.radians(angle), depth=12e-3)
    made = planned(cone, tmp_path, "spacing: arc, arc_step: 0.6 mm, smallest_step: 0.05 mm")
    step = np.linalg.norm(np.diff(on_the_wall(made, cone), axis=0), axis=1)
    # all steps are shortened alike to end at the full depth: by less than one part in the number of contours; next to
    # the fillets, where the curvature jumps, the smoothed slope profile makes single steps up to 3 % longer
    assert step.max() < 0.6e-3 * 1.03
    assert step[1:-2].min() > 0.6e-3 * (1 - 1.5 / len(made.contours))
    assert made.contours[-1].forming_tip[0, 2] == pytest.approx(-cone.depth, abs=1e-9)


def test_constant_scallop_height(tmp_path: Path) -> None:
    cone = Cone(angle=np.radians(50), depth=12e-3)
    made = planned(cone, tmp_path, "spacing: scallop, scallop_height: 0.01 mm, smallest_step: 0.05 mm")
    step = np.linalg.norm(np.diff(on_the_wall(made, cone), axis=0), axis=1)
    ridge = R - np.sqrt(R**2 - (step / 2) ** 2)  # two circles side by side on a straight wall
    assert ridge.max() < 0.01e-3 * 1.05  # the ridge goes with the square of the step, see above
    assert ridge[1:-2].min() > 0.01e-3 * (1 - 3.0 / len(made.contours))


def test_scallops_of_a_floor_fillet(tmp_path: Path) -> None:
    """In a concave fillet of 15 mm under a ball of 5 mm the contacts may be wider apart for the same ridge."""
    cone = Cone(opening=40e-3, angle=np.radians(50), depth=12e-3, floor=15e-3)
    made = planned(cone, tmp_path, "spacing: scallop, scallop_height: 0.01 mm, smallest_step: 0.05 mm")
    contacts = np.array([contour.contact[0] for contour in made.contours])
    turn = np.array([contour.wall_angle[0] for contour in made.contours])
    inside = (contacts[:, 2] < cone.floor_begin - 0.2e-3) & (turn > np.radians(15))
    step = 15e-3 * -np.diff(turn[inside])
    ridge = step**2 / 8 * (1 / R - 1 / 15e-3)
    # the slope profile is smoothed over 7 of 400 bands of the depth; the first step still begins on the wall
    np.testing.assert_allclose(ridge[1:], 0.01e-3, rtol=0.12)


def test_steps_stay_between_their_bounds(tmp_path: Path) -> None:
    cone = Cone(angle=np.radians(60), depth=10e-3)
    bounds = "spacing: arc, arc_step: 0.8 mm, smallest_step: 0.2 mm, largest_step: 0.5 mm"
    made = planned(cone, tmp_path, bounds)
    step = -np.diff([0.0, *(contour.forming_tip[0, 2] for contour in made.contours)])
    assert step.max() <= 0.5e-3 * 1.001
    assert step.min() >= 0.2e-3 * (1 - 1.5 / len(made.contours))
    assert np.ptp(step) > 0.1e-3  # fine at the rim and the floor, coarse on the wall


@pytest.mark.parametrize(("angle", "floor"), [(35.0, 5.001e-3), (50.0, 15e-3), (60.0, 15e-3)])
def test_distances_stay_even_where_fillets_begin_and_end(angle: float, floor: float, tmp_path: Path) -> None:
    """Contacts of all contours along the exact profile, but for the step onto the floor, which its fillet makes."""
    cone = Cone(opening=40e-3, angle=np.radians(angle), depth=12e-3, floor=floor)
    made = planned(cone, tmp_path, "spacing: arc, arc_step: 0.6 mm, smallest_step: 0.05 mm", 2e-6)
    place = np.array([arc(cone, float(contour.forming_tip[0, 2]) + 2e-6) for contour in made.contours])
    step = np.diff(place)[:-2]
    # 0.6 mm shortened alike to end at the full depth, by less than one part in the number of contours
    assert step.min() > 0.88 * 0.6e-3
    assert step.max() < 1.05 * 0.6e-3


def arc(cone: Cone, z: float) -> float:
    """m, way along the profile from its beginning to the contact of a ball whose tip is at ``z``."""
    turn = cone.tip(z, R)[1]
    height = z + R - R * np.cos(turn)
    if height > cone.entry_end:
        return cone.entry * turn
    wall = (cone.entry_end - max(height, cone.floor_begin)) / np.sin(cone.angle)
    beyond = cone.floor * (cone.angle - turn) if height < cone.floor_begin else 0.0
    return float(cone.entry * cone.angle + wall + beyond)
