"""The part library: exact surfaces against differences and closed forms, meshes against the surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_planner.part.mesh_checks import check_and_place
from isf_planner.part_library import PARTS, part_mesh
from isf_planner.part_library.arc_chain import belt, rounded_polygon
from isf_planner.part_library.catalogue import cone, free_form, pyramid
from isf_planner.part_library.wall_profile import straight_wall, wall

CHORD = 2e-6


@pytest.mark.parametrize("name", PARTS)
def test_mesh_is_a_picture_of_the_exact_surface(name: str) -> None:
    part = PARTS[name]()
    mesh = part_mesh(part, CHORD)
    assert np.abs(part.distance(mesh.vertices)).max() < 1e-9
    corners = mesh.corners()
    facet = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (facet[:, 2] > 0).all()
    # a facet of a doubly curved fillet has the chord errors of both directions
    assert np.abs(part.distance(corners.mean(axis=1))).max() < 2 * CHORD
    side = 1.0 if name == "bonnet" else 0.25
    placed = check_and_place(mesh, (side, side), 5e-3)
    assert placed.depth == pytest.approx(part.depth, abs=1e-9)
    assert placed.warnings == ()


@pytest.mark.parametrize("name", PARTS)
def test_normals_are_the_gradient_of_the_height(name: str) -> None:
    part = PARTS[name]()
    points = np.random.default_rng(3).uniform(-0.06, 0.06, (2000, 2))
    step = 1e-6
    slope = [(part.height(points + shift) - part.height(points - shift)) / (2 * step) for shift in step * np.eye(2)]
    normal = np.column_stack([-slope[0], -slope[1], np.ones(len(points))])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # central differences err by step times the jump of the curvature where arcs meet: 1e-6 m / 5 mm, doubled
    assert np.abs(normal - part.normal(points)).max() < 4e-4


def test_cone_against_closed_form() -> None:
    part = cone(radius=30e-3, angle=np.radians(45), depth=12e-3, entry=6e-3, floor=8e-3)
    radius = np.array([10e-3, 22e-3, 24e-3, 26e-3, 50e-3])
    z = part.height(np.column_stack([radius, np.zeros(5)]))
    assert z[0] == pytest.approx(-12e-3)
    np.testing.assert_allclose(z[1:4], radius[1:4] - 30e-3, atol=1e-15)  # on the straight wall
    assert z[4] == 0.0
    assert np.degrees(np.arccos(part.normal(np.array([[24e-3, 0.0]]))[0, 2])) == pytest.approx(45.0)


def test_wall_angle_of_the_oblique_cone_changes_around() -> None:
    part = PARTS["asymmetric_cone"]()
    line = np.column_stack([np.linspace(-0.06, 0.06, 4001), np.zeros(4001)])
    angle = np.degrees(np.arccos(part.normal(line)[:, 2]))
    assert angle[line[:, 0] > 0].max() == pytest.approx(52.0, abs=1e-6)
    assert angle[line[:, 0] < 0].max() == pytest.approx(38.0, abs=1e-6)


def test_second_feature_rises_from_the_floor() -> None:
    part = free_form()
    middle = np.array([[2e-3, -4e-3]]) - part.origin
    assert part.height(middle)[0] == pytest.approx(-15e-3 + 8e-3)
    assert part.depth == 15e-3


@settings(max_examples=30, deadline=None)
@given(corner=st.floats(8e-3, 28e-3), hollow=st.floats(8e-3, 20e-3), x=st.floats(-0.09, 0.09), y=st.floats(-0.09, 0.09))
def test_signed_distance_is_that_to_the_nearest_point(corner: float, hollow: float, x: float, y: float) -> None:
    """Against a dense sampling of an L: within its pitch squared over twice the distance, or the pitch."""
    corners = np.array([[-60, -60], [60, -60], [60, 0], [0, 0], [0, 60], [-60, 60]]) * 1e-3
    line = rounded_polygon(corners, np.array([corner, corner, corner, hollow, corner, corner]))
    pitch = 2e-5
    dense = np.vstack(
        [
            line.at(np.full(n := int(length / pitch) + 2, k), np.linspace(0, length, n))[0]
            for k, length in enumerate(line.length)
        ]
    )
    point = np.array([[x, y]])
    distance, normal = line.signed_distance(point)
    nearest = np.linalg.norm(dense - point, axis=1).min()
    assert abs(distance[0]) == pytest.approx(nearest, abs=pitch / 2)
    foot = point - distance[:, None] * normal
    assert np.linalg.norm(dense - foot, axis=1).min() < pitch


def test_closed_lines_close() -> None:
    line = belt([[-0.03, 0], [0.03, 0], [0, 0.02]], [0.02, 0.02, -0.005])
    end, normal = line.at(np.array([len(line.length) - 1]), line.length[-1:])
    np.testing.assert_allclose(end[0], line.start[0], atol=1e-12)
    np.testing.assert_allclose(normal[0], [-np.sin(line.heading[0]), np.cos(line.heading[0])], atol=1e-9)


def test_impossible_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="no common tangent"):
        belt([[0, 0], [0.001, 0]], [0.02, 0.01])
    with pytest.raises(ValueError, match="wind around"):
        belt([[-0.03, 0], [0.03, 0], [0, 0.07]], [0.02, 0.02, -0.02])
    with pytest.raises(ValueError, match="too shallow"):
        straight_wall(np.radians(50), 2e-3, 6e-3, 8e-3)
    with pytest.raises(ValueError, match="one radius more"):
        wall([0.5], [1e-3], [1e-3], 0.0)
    with pytest.raises(ValueError, match="corner radius"):
        part_mesh(pyramid(corner=8e-3))
