"""Distances to shank and holder: by hand, and against the distances of trimesh to the same body as a mesh."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from isf_core.files.tooling import HolderPart, ToolSpec
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.tool_solid import tool_solid

SPEC = ToolSpec(
    radius=5e-3,
    shank_radius=6e-3,
    stick_out=45e-3,
    holder=(HolderPart(length=20e-3, radius=10e-3, top_radius=18e-3), HolderPart(length=30e-3, radius=25e-3)),
)


def test_what_a_job_does_not_say_is_assumed() -> None:
    """70 mm to the chuck and a holder of 60 x 25 mm, from the centre of a ball of 5 mm."""
    solid = tool_solid(ToolSpec(radius=5e-3))
    assert solid.names == ("shank", "holder")
    assert solid.parts == pytest.approx(np.array([[0.0, 0.065, 5e-3, 5e-3], [0.065, 0.125, 0.025, 0.025]]), abs=1e-12)


def test_distances_by_hand() -> None:
    solid, up = tool_solid(SPEC), np.array([0.0, 0.0, 1.0])
    points = np.array([[0.0, 8e-3, 20e-3], [0.0, 0.0, -3e-3], [2e-3, 0.0, 30e-3], [30e-3, 0.0, 75e-3]])
    distance, part = solid.distance(points, np.zeros(3), up)
    assert distance == pytest.approx([2e-3, 3e-3, -4e-3, 5e-3], abs=1e-12)
    assert part.tolist() == [0, 0, 0, 2]
    cone = np.array([[20e-3, 0.0, 50e-3]])  # beside the cone of 8 mm in 20 mm, foot of the perpendicular inside it
    slope = math.atan2(8e-3, 20e-3)
    wanted = (20e-3 - 10e-3 - 10e-3 * 8 / 20) * math.cos(slope)
    assert solid.distance(cone, np.zeros(3), up)[0][0] == pytest.approx(wanted, abs=1e-12)


def test_distances_of_a_tilted_tool_are_those_to_its_mesh() -> None:
    solid = tool_solid(SPEC)
    axis = np.array([math.sin(0.4), 0.0, math.cos(0.4)])
    turn = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], axis)
    bodies = []
    for begin, end, low, high in solid.parts:
        profile = np.array([[0.0, begin], [low, begin], [high, end], [0.0, end]])
        bodies.append(trimesh.creation.revolve(profile, sections=256).apply_transform(turn))
    points = np.random.default_rng(3).uniform([-0.06, -0.05, -0.02], [0.09, 0.05, 0.12], (60, 3))
    distance, _ = solid.distance(points, np.zeros(3), axis)
    outside = distance > 0.0
    triangles = np.concatenate([body.triangles for body in bodies])
    for point, found in zip(points[outside], distance[outside], strict=True):
        foot = trimesh.triangles.closest_point(triangles, np.tile(point, (len(triangles), 1)))
        assert found == pytest.approx(np.linalg.norm(foot - point, axis=1).min(), abs=3e-6)  # 256 sides
    assert outside.any()
    assert not outside.all()


def test_the_nearest_place_of_a_surface_and_of_other_points() -> None:
    """A tool with its ball on flat sheet leans by 30 deg: the edge of its shank's lower end is nearest."""
    solid = tool_solid(ToolSpec(radius=5e-3))
    grid = np.arange(-60, 61) * 1e-3
    flat = HeightMap(grid, grid, np.full((121, 121), -20e-3))
    axis = np.array([0.5, 0.0, math.sqrt(0.75)])
    nothing = np.empty((0, 3))
    distance, place, part = solid.nearest(flat, nothing, np.array([0.0, 0.0, -20e-3]), axis)
    assert distance == pytest.approx(5e-3 - 5e-3 * 0.5, abs=0.05e-3)  # points 1 mm apart
    assert (part, place[2]) == (0, -20e-3)
    post = np.array([[40e-3, 0.0, 50e-3]])  # above the sheet, in the way of the leaning shank
    distance, place, part = solid.nearest(flat, post, np.array([0.0, 0.0, -20e-3]), axis)
    assert distance < -4e-3
    assert place == pytest.approx(post[0])
    assert (
        solid.nearest(flat, nothing, np.array([0.0, 0.0, -20e-3]), axis, -15e-3)[0] < 0.0
    )  # sheet at the ball's centre
