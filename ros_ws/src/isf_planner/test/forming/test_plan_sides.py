"""What each tool forms of a part whose walls cross the level of the flange."""

from __future__ import annotations

import numpy as np
import pytest
from isf_planner.forming.sides import cut_at, halves
from isf_planner.part.meshes import Mesh

FLANGE, FOOT, TOP = (100.0, 0.0), (40.0, -10.0), (25.0, 5.0)
"""mm, radius and height: a pocket, in it a boss whose wall of 45 deg rises through the flange in single facets."""


def boss_in_pocket(sides: int = 72) -> Mesh:
    profile = [FLANGE, (60.0, 0.0), (50.0, -10.0), FOOT, TOP, (0.0, 5.0)]
    angle = np.radians(np.arange(sides) * 360.0 / sides)
    rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(sides, z)]) for r, z in profile]
    faces = []
    for ring in range(len(profile) - 1):
        for k in range(sides):
            a, b = ring * sides + k, ring * sides + (k + 1) % sides
            c, d = a + sides, b + sides
            faces += [(a, b, c), (b, d, c)]
    return Mesh(1e-3 * np.vstack(rings), np.array(faces))


def heights_at(mesh: Mesh, radius: float) -> np.ndarray:
    """mm, of the facets over some places at ``radius`` mm from the middle."""
    found = []
    for angle in np.radians([0.3, 33.1, 141.7, 277.9]):
        place = 1e-3 * radius * np.array([np.cos(angle), np.sin(angle)])
        for a, b, c in mesh.corners():
            matrix = np.array([b[:2] - a[:2], c[:2] - a[:2]]).T
            if abs(np.linalg.det(matrix)) < 1e-15:
                continue
            s, t = np.linalg.solve(matrix, place - a[:2])
            if s >= -1e-9 and t >= -1e-9 and s + t <= 1.0 + 1e-9:
                found.append(1e3 * (a + s * (b - a) + t * (c - a))[2])
                break
    return np.array(found)


def test_walls_that_cross_the_flange_keep_their_angle_on_both_sides() -> None:
    upper, lower = halves(boss_in_pocket())
    assert (upper.forming_tool, lower.forming_tool) == (1, 2)
    # by hand: the wall is at z = 30 - r mm, through the flange at r = 30 mm; facets are 0.1 % further in than circles
    assert heights_at(upper.mesh, 35.0) == pytest.approx(np.full(4, -5.0), abs=0.05)
    assert heights_at(upper.mesh, 28.0) == pytest.approx(np.zeros(4), abs=1e-9)
    assert -heights_at(lower.mesh, 28.0) == pytest.approx(np.full(4, 2.0), abs=0.05)
    assert heights_at(lower.mesh, 35.0) == pytest.approx(np.zeros(4), abs=1e-9)


def test_a_cut_changes_no_surface_and_leaves_no_gap() -> None:
    mesh = boss_in_pocket()
    cut = cut_at(mesh, 0.0)
    heights = cut.corners()[:, :, 2]
    assert not ((heights.min(axis=1) < -1e-9) & (heights.max(axis=1) > 1e-9)).any()

    def areas(of: Mesh) -> np.ndarray:
        a, b, c = of.corners().transpose(1, 0, 2)
        return 0.5 * np.cross(b - a, c - a)

    assert areas(cut).sum(axis=0) == pytest.approx(areas(mesh).sum(axis=0), abs=1e-12)
    assert np.linalg.norm(areas(cut), axis=1).sum() == pytest.approx(np.linalg.norm(areas(mesh), axis=1).sum())
    edges = np.sort(cut.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() == 2
    assert (count == 1).sum() == 72 + 72  # outline, and the middle, where the ring is a point


def test_a_mesh_with_edges_at_the_flange_stays_as_it_is() -> None:
    mesh = boss_in_pocket()
    assert cut_at(mesh, 5e-3) is mesh
    assert cut_at(mesh, 1.0) is mesh
