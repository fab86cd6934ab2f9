"""Level sections of meshes: the rule for what lies on a level, closure, direction, and an independent slicer."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_planner.checks.mesh_slicing import MeshLoop, slice_mesh
from isf_planner.part.meshes import Mesh
from planner_parts import Cone, grid_mesh

X = np.linspace(-0.04, 0.04, 41)
GX, GY = np.meshgrid(X, X)
DISTANCE = np.hypot(GX, GY)


def test_sections_of_a_cone_are_circles() -> None:
    cone = Cone()
    levels = np.array([-4e-3, -6.5e-3, -9e-3])
    for (loop,), level in zip(slice_mesh(cone.mesh(), levels), levels, strict=True):
        assert loop.closed
        assert loop.level == level
        # on the wall of 45 deg the radius is opening + z; chord error of the mesh 5 um
        np.testing.assert_allclose(np.hypot(*loop.points.T), cone.opening + level, atol=8e-6)
        assert loop.area == pytest.approx(np.pi * (cone.opening + level) ** 2, rel=1e-3)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 12))
def test_every_loop_is_closed_even_where_all_vertices_lie_on_levels(seed: int, steps: int) -> None:
    """Heights are small multiples of 1 mm and so are the levels: flat facets, edges and vertices on every level."""
    rng = np.random.default_rng(seed)
    z = -1e-3 * rng.integers(0, steps, GX.shape).astype(float)
    z[0], z[-1], z[:, 0], z[:, -1] = 0.0, 0.0, 0.0, 0.0
    mesh = grid_mesh(X, X, z)
    levels = -1e-3 * np.arange(1, steps)
    cut_area = [_area_below(mesh, level) for level in levels]
    for loops, area in zip(slice_mesh(mesh, levels), cut_area, strict=True):
        assert all(loop.closed for loop in loops)
        # what the loops enclose, islands negative, is what lies below or on the level
        assert sum(loop.area for loop in loops) == pytest.approx(area, abs=1e-12)


def _area_below(mesh: Mesh, level: float) -> float:
    """m^2 of the facets at or below the level, seen from above."""
    corners = mesh.corners()
    size = 0.5 * np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2])
    low, middle, high = np.sort(corners[:, :, 2], axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        most = 1 - (high - level) ** 2 / ((high - low) * (high - middle))
        least = (level - low) ** 2 / ((high - low) * (middle - low))
    share = np.select([high <= level, middle <= level, low < level], [1.0, most, least], 0.0)
    return float((size * share).sum())


def test_pockets_and_islands_run_against_each_other() -> None:
    ring = np.abs(DISTANCE - 0.02) - 0.01
    (loops,) = slice_mesh(grid_mesh(X, X, ring), np.array([-4e-3]))
    outer, inner = sorted(loops, key=lambda loop: -abs(loop.area))
    assert outer.area > 0 > inner.area


def test_a_chain_that_ends_at_a_free_edge_is_reported() -> None:
    tilted = grid_mesh(X, X, 0.1 * GX)
    (loops,) = slice_mesh(tilted, np.array([0.123e-3]))
    (line,) = loops
    assert not line.closed
    np.testing.assert_allclose(np.sort(line.points[[0, -1], 1]), [-0.04, 0.04], atol=1e-12)


def test_an_edge_of_three_facets_ends_the_chain() -> None:
    fin = Mesh(
        np.array([[0, 0, -1.0], [0, 0, 1], [1, 0, 0], [-1, 1, 0], [-1, -1, 0]]) * 1e-2,
        np.array([[0, 1, 2], [1, 0, 3], [1, 0, 4]]),
    )
    (loops,) = slice_mesh(fin, np.array([1e-3]))
    assert len(loops) >= 2
    assert not any(loop.closed for loop in loops)


def test_agrees_with_an_independent_slicer() -> None:
    rng = np.random.default_rng(5)
    z = sum(-a * np.exp(-(((GX - p) ** 2 + (GY - q) ** 2) / 0.008**2)) for a, p, q in rng.uniform(-0.02, 0.02, (6, 3)))
    z = z * np.clip((0.04 - np.maximum(np.abs(GX), np.abs(GY))) / 0.01, 0, 1)
    mesh = grid_mesh(X, X, z)
    levels = np.linspace(z.min(), z.max(), 14)[1:-1] + 1e-7
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    for loops, level in zip(slice_mesh(mesh, levels), levels, strict=True):
        section = body.section([0, 0, 1], [0, 0, level])
        lengths = sum(_length(loop) for loop in loops)
        assert lengths == pytest.approx(section.length, rel=1e-6)


def _length(loop: MeshLoop) -> float:
    line = np.vstack([loop.points, loop.points[:1]]) if loop.closed else loop.points
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def test_no_levels_or_levels_beside_the_mesh() -> None:
    mesh = Cone().mesh(50e-6)
    assert slice_mesh(mesh, np.array([5e-3, -0.5])) == [[], []]
