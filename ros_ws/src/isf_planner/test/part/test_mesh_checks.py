"""What is refused as a part, with its code, place and advice; and where an accepted part is placed."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_planner.part.mesh_checks import check_and_place
from isf_planner.part.meshes import Mesh
from planner_parts import Cone, grid_mesh

CLAMP = (0.25, 0.25)
RADIUS = 5e-3
CONE = Cone().mesh(20e-6)


def refusal(mesh: Mesh) -> IsfError:
    with pytest.raises(IsfError) as caught:
        check_and_place(mesh, CLAMP, RADIUS)
    assert caught.value.where
    assert caught.value.advice
    return caught.value


def test_a_part_in_place_stays() -> None:
    part = check_and_place(CONE, CLAMP, RADIUS)
    assert part.warnings == ()
    assert part.depth == pytest.approx(12e-3, abs=1e-12)


def test_a_part_elsewhere_is_moved_and_reported() -> None:
    part = check_and_place(CONE.moved(np.array([0.1, -0.02, 0.3])), CLAMP, RADIUS)
    np.testing.assert_allclose(part.mesh.vertices, check_and_place(CONE, CLAMP, RADIUS).mesh.vertices, atol=1e-12)
    assert "(-100.000, 20.000, -300.000) mm" in part.warnings[0]


@pytest.mark.parametrize("factor", [1e3, 25.4, 1e-3])
def test_wrong_unit(factor: float) -> None:
    error = refusal(Mesh(CONE.vertices * factor, CONE.faces))
    assert error.code is ErrorCode.MESH_UNIT_SUSPECT
    assert "part.unit" in error.advice


def test_flat_part() -> None:
    assert refusal(Mesh(CONE.vertices * [1, 1, 1e-4], CONE.faces)).code is ErrorCode.MESH_EMPTY


def test_reversed_normals() -> None:
    assert refusal(Mesh(CONE.vertices, CONE.faces[:, ::-1])).code is ErrorCode.MESH_INVERTED


def test_turned_upside_down() -> None:
    assert refusal(Mesh(CONE.vertices * [1, -1, -1], CONE.faces)).code is ErrorCode.MESH_INVERTED


def test_dome_opening_downwards() -> None:
    error = refusal(Mesh(CONE.vertices * [1, 1, -1], CONE.faces))
    assert error.code is ErrorCode.MESH_INVERTED
    assert "opens downwards" in error.what


def test_one_facet_turned_round() -> None:
    faces = CONE.faces.copy()
    faces[100] = faces[100, ::-1]
    error = refusal(Mesh(CONE.vertices, faces))
    assert error.code is ErrorCode.MESH_INVERTED
    # the place is an edge of that facet
    corners = CONE.vertices[CONE.faces[100]]
    middles = (corners + np.roll(corners, 1, axis=0)) / 2
    named = np.array([float(part.split("=")[1].split()[0]) for part in error.where.removeprefix("mesh at ").split(",")])
    assert np.abs(middles * 1e3 - named).max(axis=1).min() < 0.06  # printed with one decimal


def test_hole() -> None:
    error = refusal(Mesh(CONE.vertices, np.delete(CONE.faces, 200, axis=0)))
    assert error.code is ErrorCode.MESH_OPEN
    assert "hole" in error.what


def test_crack_between_facets_that_do_not_share_vertices() -> None:
    split = Mesh(np.vstack([CONE.vertices, CONE.vertices[CONE.faces[50]] + [0, 0, 1e-5]]), CONE.faces.copy())
    split.faces[50] = len(CONE.vertices) + np.arange(3)
    assert refusal(split).code is ErrorCode.MESH_OPEN


def test_two_separate_surfaces() -> None:
    both = np.vstack([CONE.vertices * 0.5, CONE.vertices * 0.5 + [0.05, 0, 0]])
    assert refusal(Mesh(both, np.vstack([CONE.faces, CONE.faces + len(CONE.vertices)]))).code is ErrorCode.MESH_OPEN


def test_closed_body() -> None:
    lid = np.array([0.0, 0.0, 1e-3])
    distance = np.hypot(CONE.vertices[:, 0], CONE.vertices[:, 1])
    rim = np.flatnonzero(distance > distance.max() - 1e-9)
    fan = np.column_stack([np.roll(rim, -1), rim, np.full(len(rim), len(CONE.vertices))])
    closed = Mesh(np.vstack([CONE.vertices, lid]), np.vstack([CONE.faces, fan]))
    error = refusal(closed)
    assert error.code is ErrorCode.MESH_NOT_HEIGHT_FIELD
    assert "closed body" in error.what


def test_overhang() -> None:
    vertices = CONE.vertices.copy()
    low = vertices[:, 2] < -6e-3
    vertices[low, :2] *= 2.0  # the lower half is wider than what is above it
    error = refusal(Mesh(vertices, CONE.faces))
    assert error.code is ErrorCode.MESH_NOT_HEIGHT_FIELD
    assert "overhang" in error.what


def test_outline_below_the_highest_point() -> None:
    x = np.linspace(-0.04, 0.04, 41)
    radius = np.hypot(*np.meshgrid(x, x))
    ring = 3e-3 * np.exp(-(((radius - 0.025) / 5e-3) ** 2)) - 8e-3 * np.exp(-((radius / 0.012) ** 2))
    error = refusal(grid_mesh(x, x, ring))
    assert error.code is ErrorCode.MESH_OPEN
    assert "below the highest point" in error.what


def test_trimmed_part_without_flange() -> None:
    cut = CONE.faces[(CONE.vertices[CONE.faces][:, :, 0] < 0.02).all(axis=1)]
    error = refusal(Mesh(CONE.vertices, cut))
    assert error.code is ErrorCode.MESH_OPEN
