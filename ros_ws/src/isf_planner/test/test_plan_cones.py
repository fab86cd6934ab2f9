"""Planned contours of cones against closed forms, and the tools against each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from ball_gap import tool_gap
from isf_core.contour import Contour, Process
from isf_core.files.job import ControlSpec, load_job
from isf_planner import Plan, plan
from isf_planner.loops.tip_loops import TipLoop
from isf_planner.paths.contour_making import contour_of, path_of
from planner_parts import EXAMPLES, Cone, job_for, told, write

R = 5e-3
CONE = Cone()


@pytest.fixture(scope="module")
def cone_plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    path = write(CONE.mesh(), tmp_path_factory.mktemp("cone") / "cone.stl")
    return plan(job_for(path))


def chords(contour: Contour) -> np.ndarray:
    return np.linalg.norm(np.roll(contour.forming_tip, -1, axis=0) - contour.forming_tip, axis=1)


def distance_to_facets(points: np.ndarray) -> np.ndarray:
    """(N,) m from points (N, 3) to the facets of the cone, all of them: no search structure that could err."""
    corners = CONE.mesh().corners() * 1e3  # mm: closest_point compares with fixed tolerances
    return np.array([_distance(corners, point * 1e3) * 1e-3 for point in points])


def _distance(corners: np.ndarray, point: np.ndarray) -> float:
    closest = trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
    return float(np.linalg.norm(closest - point, axis=1).min())


def test_levels(cone_plan: Plan) -> None:
    assert [contour.index for contour in cone_plan.contours] == list(range(24))
    assert {contour.count for contour in cone_plan.contours} == {24}
    for contour in cone_plan.contours:
        np.testing.assert_allclose(contour.forming_tip[:, 2], -0.5e-3 * (contour.index + 1), atol=1e-12)
        assert contour.process is Process.DSIF
        assert contour.closed
        assert contour.plan_id == cone_plan.plan_id


def test_tip_circles(cone_plan: Plan) -> None:
    """Radius of the tip circle and wall angle at every level, through entry fillet, wall and floor fillet."""
    for contour in cone_plan.contours[:-1]:
        radius, angle = CONE.tip(contour.forming_tip[0, 2], R)
        # facets lie up to 5 um beside the smooth surface (twice that across a wall of 45 deg), the drop errs by 2 um
        np.testing.assert_allclose(np.hypot(*contour.forming_tip[:, :2].T), radius, atol=20e-6)
        np.testing.assert_allclose(contour.wall_angle, angle, atol=np.radians(0.5))


def test_contact_runs_where_the_wall_meets_the_floor_in_the_end(cone_plan: Plan) -> None:
    last = cone_plan.contours[-1]
    edge = CONE.opening - CONE.depth / np.tan(CONE.angle) - CONE.floor * np.tan(CONE.angle / 2)
    # the level line is taken 2 um above the floor, where the offset fillet (radius 3 mm) is sqrt(2 * 3 mm * 2 um) out;
    # facets of the fillet (0.09 rad) begin up to half a chord earlier
    assert np.hypot(*last.contact[:, :2].T) == pytest.approx(edge, abs=0.4e-3)
    assert np.abs(last.contact[:, 2] + CONE.depth).max() < 20e-6


def test_normals(cone_plan: Plan) -> None:
    for contour in cone_plan.contours[:-1]:
        _, angle = CONE.tip(contour.forming_tip[0, 2], R)
        out = contour.forming_tip[:, :2] / np.linalg.norm(contour.forming_tip[:, :2], axis=1, keepdims=True)
        exact = np.column_stack([-np.sin(angle) * out, np.full(len(out), np.cos(angle))])
        off = np.degrees(np.arccos(np.clip((contour.normal * exact).sum(axis=1), -1, 1)))
        assert off.max() < 0.5
        np.testing.assert_allclose(np.linalg.norm(contour.normal, axis=1), 1.0, atol=1e-12)


def test_contacts_lie_on_the_surface(cone_plan: Plan) -> None:
    distance = distance_to_facets(np.vstack([contour.contact[::120] for contour in cone_plan.contours]))
    assert distance.max() < 20e-6


def test_spacing_start_and_direction(cone_plan: Plan) -> None:
    for contour in cone_plan.contours:
        step = chords(contour)
        assert np.abs(step / step.mean() - 1).max() < 0.02
        assert step.mean() == pytest.approx(0.5e-3, rel=0.01)
        bearing = np.unwrap(np.arctan2(contour.forming_tip[:, 1], contour.forming_tip[:, 0]))
        assert abs(np.degrees(bearing[0])) < 1.0
        assert (np.diff(bearing) > 0).all()
        # closed: the way from the last point to the first is a step like all others
        assert bearing[-1] - bearing[0] + step.mean() / np.hypot(*contour.forming_tip[0, :2]) == pytest.approx(
            2 * np.pi, abs=1e-3
        )


def test_ball_does_not_cut_the_facets(cone_plan: Plan) -> None:
    """Distance from every 120th ball centre to the facets themselves; 20 um may be cut, 2 um are meant to be."""
    centres = np.vstack([contour.forming_tip[::120] for contour in cone_plan.contours]) + [0, 0, R]
    distance = distance_to_facets(centres)
    assert distance.min() > R - 20e-6
    assert distance.max() < R + 20e-6


def test_tools_are_apart_by_the_thickness(cone_plan: Plan) -> None:
    """Centre distance R1 + R2 + t with the sine-law thickness t0 cos(phi) (Ren 2018, 1.1.2 and 2.9)."""
    for contour in cone_plan.contours:
        np.testing.assert_allclose(contour.thickness, 1e-3 * np.cos(contour.wall_angle), atol=1e-15)
        gap = tool_gap(contour.forming_tip, contour.support_tip, R, R)
        np.testing.assert_allclose(gap, contour.thickness, atol=1e-9)


def test_force_acts_from_the_engage_depth_and_wall_angle_on(cone_plan: Plan) -> None:
    """Not on the entry fillet (Ren 2018, 2.4.1), nor where the wall is so flat that a horizontal force has no hold."""
    for contour in cone_plan.contours:
        depth = -contour.forming_tip[0, 2]
        steep = contour.wall_angle.min() >= ControlSpec().engage_wall_angle
        assert contour.force_controlled == bool(depth >= 2e-3 - 1e-9 and steep)
        assert (contour.support_force == 120.0).all()
    assert not cone_plan.contours[2].force_controlled
    assert cone_plan.contours[3].force_controlled
    assert not cone_plan.contours[-1].force_controlled  # at the floor


def test_target(cone_plan: Plan) -> None:
    assert cone_plan.target.z.shape == (251, 251)
    assert cone_plan.target.at(np.zeros((1, 2)))[0] == pytest.approx(-CONE.depth)
    assert cone_plan.target.z[:, 0].max() == cone_plan.target.z.max() == 0.0


def test_predictions(cone_plan: Plan) -> None:
    assert told(cone_plan) == ()
    assert np.degrees(cone_plan.largest_wall_angle) == pytest.approx(45.0, abs=0.5)
    # sine law (Ren 2018, 1.1.2): 0.7071 mm at 45 deg
    assert cone_plan.smallest_thickness == pytest.approx(0.7071e-3, abs=7e-6)
    exact = sum(2 * np.pi * CONE.tip(contour.forming_tip[0, 2], R)[0] for contour in cone_plan.contours)
    assert cone_plan.path_length == pytest.approx(exact, rel=2e-3)
    assert cone_plan.forming_time == pytest.approx(cone_plan.path_length / 30e-3)


def test_sample_program_line_of_ren() -> None:
    """Ren 2018, Appendix C: X 42.5714, Z -0.0825, U 43.7223, W -1.0166; from that: gap 0.9945 mm at 6.009 deg."""
    job = load_job(EXAMPLES / "jobs" / "ren_pyramid.yaml").job
    slope = np.radians(6.009)
    normal = np.tile([-np.sin(slope), 0.0, np.cos(slope)], (3, 1))
    points = np.array([[42.5714e-3, 0.0], [42.5714e-3, 0.5e-3], [42.5714e-3, 1.0e-3]])  # Y in steps of 0.5 mm
    contour = contour_of(path_of(TipLoop(-0.0825e-3, points, normal)), job, "program", 0, 1)
    # four decimals of mm are printed; the slope is known to 0.001 deg = 0.2 um at the distance of the ball centres
    np.testing.assert_allclose(contour.forming_tip[0], [42.5714e-3, 0.0, -0.0825e-3], atol=1e-12)
    np.testing.assert_allclose(contour.support_tip[:, 0], 43.7223e-3, atol=0.3e-6)
    np.testing.assert_allclose(contour.support_tip[:, 2], -1.0166e-3, atol=0.3e-6)
    np.testing.assert_allclose(tool_gap(contour.forming_tip, contour.support_tip, R, R), 0.9945e-3, atol=0.1e-6)


def test_squeeze_factor_narrows_the_gap(tmp_path: Path) -> None:
    path = write(CONE.mesh(50e-6), tmp_path / "cone.stl")
    contour = plan(job_for(path, squeeze="0.8", depth="2 mm")).contours[-2]
    gap = tool_gap(contour.forming_tip, contour.support_tip, R, R)
    np.testing.assert_allclose(gap, 0.8 * contour.thickness, atol=1e-9)


def test_one_tool(tmp_path: Path) -> None:
    path = write(CONE.mesh(50e-6), tmp_path / "cone.stl")
    for contour in plan(job_for(path, process="SPIF", depth="2 mm")).contours:
        assert contour.process is Process.SPIF
        assert not contour.has_support
        assert not contour.force_controlled


def test_position_control_when_no_force_is_set(tmp_path: Path) -> None:
    path = write(CONE.mesh(50e-6), tmp_path / "cone.stl")
    assert not any(contour.force_controlled for contour in plan(job_for(path, force="0 N", depth="2 mm")).contours)


def test_a_plan_repeats_bit_by_bit(tmp_path: Path) -> None:
    path = write(CONE.mesh(50e-6), tmp_path / "cone.stl")
    first, second = plan(job_for(path, depth="3 mm")), plan(job_for(path, depth="3 mm"))
    assert first.plan_id == second.plan_id
    for a, b in zip(first.contours, second.contours, strict=True):
        np.testing.assert_array_equal(a.support_tip, b.support_tip)
    assert plan(job_for(path, depth="4 mm")).plan_id != first.plan_id
