"""Dropping a ball on surfaces for which the tip height is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_planner.part.meshes import Mesh
from isf_planner.surface.target_surface import fine_surface
from isf_planner.surface.tip_surface import STRIDE, contact_normals, drop_tool, tip_grid, unreached
from numpy.typing import NDArray
from planner_parts import Cone, grid_mesh, revolve

R = 5e-3
CONE = Cone()
SURFACE = fine_surface(CONE.mesh(), R)


@settings(max_examples=25, deadline=None)
@given(st.floats(0, 6.28), st.floats(0.0, np.radians(65)))
def test_tilted_plane(direction: float, angle: float) -> None:
    """Ball on a plane of angle a: the centre is R / cos(a) above the plane, so the tip is R (1 / cos(a) - 1) above."""
    x = np.linspace(-20e-3, 20e-3, 9)
    tilt = np.tan(angle) * np.array([np.cos(direction), np.sin(direction)])
    gx, gy = np.meshgrid(x, x)
    surface = fine_surface(grid_mesh(x, x, gx * tilt[0] + gy * tilt[1] - 0.05), R)
    points = np.array([[0.0, 0.0], [1.23e-3, -3.21e-3]])
    height, contact = drop_tool(surface, points, R)
    # the module states an error of R / 2500 / (8 cos^3): nearest node of a grid of R / 50, worst on its diagonal (x 2)
    bound = 2 * R / 2500 / (8 * np.cos(angle) ** 3)
    exact = points @ tilt - 0.05 + R * (1 / np.cos(angle) - 1)
    assert (height <= exact + 1e-12).all()
    assert (height >= exact - bound).all()
    normal = contact_normals(surface, points, contact, R)
    assert normal @ np.array([-tilt[0], -tilt[1], 1.0]) * np.cos(angle) == pytest.approx(np.ones(2), abs=1e-7)


def test_bowl_of_larger_radius() -> None:
    """Ball in a spherical bowl of radius B: its centre is on a sphere of radius B - R around the bowl's centre."""
    bowl = 20e-3
    turn = np.radians(np.linspace(60, 0.5, 120))
    profile = np.column_stack([bowl * np.sin(turn), -bowl * (np.cos(turn) - np.cos(turn[0]))])
    surface = fine_surface(revolve(profile, 360), R)
    distance = np.array([0.0, 2e-3, 5e-3, 9e-3])
    points = np.column_stack([distance, np.zeros(4)])
    height, contact = drop_tool(surface, points, R)
    centre = bowl * np.cos(turn[0]) - np.sqrt((bowl - R) ** 2 - distance**2)
    # sagitta of the facets: 20 mm x (0.5 deg / 2)^2 / 2 = 0.2 um; grid: 5 um x cos^-3 as above
    np.testing.assert_allclose(height, centre - R, atol=2e-6)
    normal = contact_normals(surface, points, contact, R)
    np.testing.assert_allclose(normal[:, 0], -distance / (bowl - R), atol=np.radians(0.2))


def test_sharp_rim_is_rolled_over() -> None:
    """Ball at distance a from a sharp rim: the tip is R - sqrt(R^2 - a^2) below the rim, the contact on it."""
    surface = fine_surface(revolve(np.array([[30e-3, 0.0], [20e-3, 0.0], [15e-3, -20e-3], [1e-3, -20e-3]]), 720), R)
    points = np.array([[18e-3, 0.0], [17e-3, 0.0]])
    height, contact = drop_tool(surface, points, R)
    # an edge between two nodes (0.1 mm apart) is missed by at most half a pitch times the slope there (0.75)
    expected = np.sqrt(R**2 - (points[:, 0] - 20e-3) ** 2) - R
    np.testing.assert_allclose(height, expected, atol=40e-6)
    np.testing.assert_allclose(contact[:, 0], 20e-3, atol=1e-4)
    normal = contact_normals(surface, points, contact, R)
    np.testing.assert_allclose(normal[:, 0], (points[:, 0] - 20e-3) / R, atol=0.02)


def test_grid_agrees_with_single_drops() -> None:
    x, y, height = tip_grid(SURFACE, R)
    rows, columns = np.array([40, 60, 75, 90]), np.array([70, 30, 75, 45])
    single, _ = drop_tool(SURFACE, np.column_stack([x[columns], y[rows]]), R)
    # the grid sees every fifth node: the error of a sample is (STRIDE R / 50)^2 / (8 R cos^3(45 deg)) at most, twice on
    # the diagonal; the single drop refines from there and is never lower
    bound = 2 * (STRIDE / 50) ** 2 * R / (8 * np.cos(CONE.angle) ** 3)
    difference = single - height[rows, columns]
    assert (difference >= -1e-12).all()
    assert (difference <= bound).all()


def test_search_near_a_known_contact_finds_the_same() -> None:
    angle = np.linspace(0, 2 * np.pi, 50)
    points = 22e-3 * np.column_stack([np.cos(angle), np.sin(angle)])
    height, contact = drop_tool(SURFACE, points, R)
    again, _ = drop_tool(SURFACE, points + [0.1e-3, 0.0], R, near=contact)
    fresh, _ = drop_tool(SURFACE, points + [0.1e-3, 0.0], R)
    np.testing.assert_array_equal(again, fresh)
    assert (height < 0).all()


def test_ball_touches_the_facets_and_does_not_cut_them() -> None:
    """Distance from the ball's centre to the facets themselves (not to the grid) is R."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-24e-3, 24e-3, (25, 2))
    mesh = CONE.mesh()
    height, _ = drop_tool(SURFACE, points, R)
    centres = np.column_stack([points, height + R])
    distance = np.array([_distance(mesh, centre) for centre in centres])
    # 3 um: error of the drop on a grid of R / 50 as above
    np.testing.assert_allclose(distance, R, atol=3e-6)


def _distance(mesh: Mesh, point: NDArray[np.float64]) -> float:
    corners = mesh.corners() * 1e3  # mm: closest_point compares with fixed tolerances
    closest = trimesh.triangles.closest_point(corners, np.tile(point * 1e3, (len(corners), 1)))
    return float(np.linalg.norm(closest - point * 1e3, axis=1).min()) * 1e-3


def test_unreached_material_of_a_fillet_that_is_too_small() -> None:
    """In a corner of angle a, ball R and fillet r < R touch the same two lines; the gap between the arcs is left."""
    small = Cone(floor=1e-3)
    surface = fine_surface(small.mesh(), R)
    left, place = unreached(surface, tip_grid(surface, R)[2], R, 0.0)
    x = np.linspace(-small.floor * np.tan(small.angle / 2), R * np.tan(small.angle / 2) * np.cos(small.angle), 2000)

    def arc(radius: float) -> NDArray[np.float64]:
        lower = radius - np.sqrt(radius**2 - np.minimum(np.abs(x + radius * np.tan(small.angle / 2)), radius) ** 2)
        end = radius * np.tan(small.angle / 2) * np.cos(small.angle)
        return np.where(x > end, x * np.tan(small.angle), lower)

    exact = float((arc(R) - arc(small.floor)).max())
    # the place of the peak is missed by up to 0.25 mm; tips every 0.2 mm are up to 0.1 mm from the best one, slope 1
    assert left == pytest.approx(exact, abs=0.06e-3)
    corner = small.opening - small.depth / np.tan(small.angle)
    assert np.hypot(place[0], place[1]) == pytest.approx(corner, abs=1e-3)


@pytest.mark.parametrize("floor", [5e-3, 8e-3])
def test_a_fillet_of_the_tool_radius_or_more_is_reached(floor: float) -> None:
    surface = fine_surface(Cone(floor=floor).mesh(), R)
    assert unreached(surface, tip_grid(surface, R)[2], R, 0.0)[0] < 0.06e-3
