"""Rasterised heights and normals against the surfaces the facets were made from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_planner.part.meshes import Mesh
from isf_planner.surface.target_surface import fine_surface, target_map
from planner_parts import Cone, grid_mesh

CONE = Cone()


@settings(max_examples=12, deadline=None)
@given(st.floats(0, 6.28), st.floats(0.05, 0.8), st.integers(5, 23))
def test_a_facetted_plane_is_exact_everywhere_under_it(direction: float, slope: float, nodes: int) -> None:
    """A plane is linear over every facet: heights to rounding, no node under the mesh missed at any facet edge."""
    x = np.linspace(-13e-3, 13e-3, nodes)
    tilt = slope * np.array([np.cos(direction), np.sin(direction)])
    gx, gy = np.meshgrid(x, x)
    surface = fine_surface(grid_mesh(x, x, gx * tilt[0] + gy * tilt[1] - 0.05), 5e-3)
    inside_x, inside_y = np.abs(surface.x) < 13e-3 - 1e-9, np.abs(surface.y) < 13e-3 - 1e-9
    found = surface.z[np.ix_(inside_y, inside_x)]
    sx, sy = np.meshgrid(surface.x[inside_x], surface.y[inside_y])
    np.testing.assert_allclose(found, sx * tilt[0] + sy * tilt[1] - 0.05, atol=1e-12)
    normal = surface.normal_xy[np.ix_(inside_y, inside_x)]
    expected = np.broadcast_to(-tilt / np.sqrt(1 + slope**2), normal.shape)
    np.testing.assert_allclose(normal, expected, atol=1e-9)
    beside = np.abs(surface.y) > 13e-3 + 1e-9
    assert (surface.z[beside] == 0).all()


def test_target_map_has_a_node_at_the_origin_and_is_flat_beside_the_part() -> None:
    target = target_map(CONE.mesh(10e-6), (0.25, 0.2))
    assert target.z.shape == (201, 251)
    assert target.z[100, 125] == pytest.approx(-CONE.depth, abs=1e-12)
    gx, gy = np.meshgrid(target.x, target.y)
    distance = np.hypot(gx, gy)
    assert (target.z[distance > CONE.opening + CONE.flange + 3e-3] == 0).all()
    wall = (distance > 22e-3) & (distance < 26e-3)
    # chord error 10 um of the mesh, seen along z on a wall of 45 deg: 14 um
    np.testing.assert_allclose(target.z[wall], -(CONE.opening - distance[wall]), atol=15e-6)


def test_part_beyond_the_clamp_is_cut_at_the_clamp() -> None:
    target = target_map(CONE.mesh(50e-6), (0.04, 0.04))
    assert target.z.shape == (41, 41)
    assert target.z.min() == pytest.approx(-CONE.depth)


def test_two_layers_are_refused() -> None:
    """A ramp that winds over itself looks up everywhere; only the heights tell."""
    angle = np.linspace(0, 3 * np.pi, 200)
    inner = np.column_stack([0.01 * np.cos(angle), 0.01 * np.sin(angle), -1e-3 * angle])
    outer = np.column_stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), -1e-3 * angle])
    k = np.arange(199)
    faces = np.vstack([np.column_stack([k, k + 200, k + 201]), np.column_stack([k, k + 201, k + 1])])
    with pytest.raises(IsfError) as caught:
        fine_surface(Mesh(np.vstack([inner, outer]), faces), 5e-3)
    assert caught.value.code is ErrorCode.MESH_NOT_HEIGHT_FIELD
