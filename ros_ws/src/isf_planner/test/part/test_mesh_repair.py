"""Faults of a mesh are repaired, told with their place, and the repaired surface is the one without the fault."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_planner.forming.sides import flange_level
from isf_planner.part.mesh_checks import check_and_place, oriented, repair
from isf_planner.part.meshes import Mesh, topology
from planner_parts import Cone, grid_mesh, revolve

CLAMP, RADIUS = (0.25, 0.25), 5e-3
CONE = Cone().mesh(20e-6)
RNG = np.random.default_rng(4)


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.corners()[:, k] for k in range(3))
    area = 0.5 * np.cross(b - a, c - a)[:, 2]
    return float((area * (a + b + c)[:, 2] / 3).sum())


def repaired(mesh: Mesh) -> tuple[Mesh, str]:
    """The repaired mesh, which the checks accept, and the one sentence told."""
    with pytest.raises(IsfError):
        check_and_place(mesh, CLAMP, RADIUS)
    made, (reported,) = repair(mesh, RADIUS)
    check_and_place(made, CLAMP, RADIUS)
    return made, reported


def test_a_sound_mesh_comes_back_as_it_is() -> None:
    made, reported = repair(CONE, RADIUS)
    assert made is CONE
    assert reported == ()


def test_turned_facets() -> None:
    faces = CONE.faces.copy()
    turned = RNG.choice(len(faces), len(faces) // 3, replace=False)
    faces[turned] = faces[turned][:, ::-1]
    made, reported = repaired(Mesh(CONE.vertices, faces))
    assert f"{len(turned)} facets were turned" in reported
    assert volume(made) == pytest.approx(volume(CONE), rel=1e-12)


def test_duplicate_facets() -> None:
    extra = CONE.faces[[10, 200, 300]]
    extra[1] = extra[1][::-1]
    made, reported = repaired(Mesh(CONE.vertices, np.vstack([CONE.faces, extra])))
    assert "3 duplicate facets" in reported
    assert len(made.faces) == len(CONE.faces)


def test_hole_of_several_facets() -> None:
    middle = CONE.vertices[CONE.faces].mean(axis=1)
    gone = np.linalg.norm(middle - middle[400], axis=1) < 2.0e-3
    assert gone.sum() > 3
    made, reported = repaired(Mesh(CONE.vertices, CONE.faces[~gone]))
    assert "hole" in reported
    assert "closed by" in reported
    # plane facets over a hole of 4 mm in a cone of 20 mm: off by chord^2 / (8 radius) = 0.1 mm over 12 mm^2
    assert volume(made) == pytest.approx(volume(CONE), abs=0.1e-3 * 12e-6)


def test_a_hole_wider_than_the_tool_stays_and_is_refused() -> None:
    middle = CONE.vertices[CONE.faces].mean(axis=1)
    mesh = Mesh(CONE.vertices, CONE.faces[np.linalg.norm(middle - [0.022, 0, -8e-3], axis=1) > 5e-3])
    made, reported = repair(mesh, RADIUS)
    assert reported == ()
    with pytest.raises(IsfError) as caught:
        check_and_place(made, CLAMP, RADIUS)
    assert caught.value.code is ErrorCode.MESH_OPEN


def test_crack() -> None:
    split = Mesh(np.vstack([CONE.vertices, CONE.vertices[CONE.faces[50]] + [0, 0, 1e-5]]), CONE.faces.copy())
    split.faces[50] = len(CONE.vertices) + np.arange(3)
    made, reported = repaired(split)
    assert "3 vertices along cracks" in reported
    assert len(topology(made).free_loops()) == 1


def test_a_slit_that_runs_in_from_the_outline() -> None:
    """It is no free edge besides the outline, but a part of it: down the wall and back 5 um beside itself."""
    rings, sides = Cone().profile(20e-6)[:-3], 128
    mesh = revolve(Cone().profile(20e-6), sides)
    meridian = sides * np.arange(len(rings))
    twin = np.arange(len(mesh.vertices))
    twin[meridian] = len(mesh.vertices) + np.arange(len(rings))
    middle = mesh.corners().mean(axis=1)
    turn = np.mod(np.arctan2(middle[:, 1], middle[:, 0]), 2 * np.pi)
    before = (turn > 2 * np.pi * (1 - 1 / sides))[:, None]
    slit = Mesh(
        np.vstack([mesh.vertices, mesh.vertices[meridian] + [0, 0, 5e-6]]),
        np.where(before, twin[mesh.faces], mesh.faces),
    )
    assert len(topology(slit).free_loops()) == 1
    made, reported = repaired(slit)
    assert f"{len(rings)} vertices along cracks" in reported
    assert len(topology(made).free) == sides
    assert volume(made) == pytest.approx(volume(mesh), rel=1e-3)


def test_a_seam_of_two_faces_across_the_whole_part() -> None:
    """Two faces of a CAD file, meshed one by one: they meet in every second or third point, and so at the outline."""

    def half(x: np.ndarray, step: float) -> Mesh:
        y = np.arange(-60e-3, 60.5e-3, step)
        gx, gy = np.meshgrid(np.abs(x), np.abs(y))
        return grid_mesh(x, y, -np.clip(np.minimum(48e-3 - gx, 48e-3 - gy), 0.0, 12e-3))

    x = np.arange(0.0, 61e-3, 12e-3)
    left, right = half(-x[::-1], 6e-3), half(x, 4e-3)
    vertices = np.vstack([left.vertices, right.vertices])
    seam = {tuple(np.round(1e3 * place, 6)): k for k, place in reversed(list(enumerate(vertices)))}
    same = np.array([seam[tuple(np.round(1e3 * place, 6))] for place in vertices])
    mesh = Mesh(vertices, same[np.vstack([left.faces, right.faces + len(left.vertices)])])
    assert len(topology(mesh).free_loops()) == 1
    made, reported = repaired(mesh)
    assert "facets along open seams were cut" in reported
    assert np.abs(made.vertices[topology(made).vertices[topology(made).free]][..., 2]).max() < 1e-12
    assert volume(made) == pytest.approx(volume(mesh), rel=1e-9)


@pytest.mark.parametrize("sides", [90, 30000])
def test_an_outline_finer_than_a_crack_is_wide_is_none(sides: int) -> None:
    """30000 points around: 7.6 um apart."""
    mesh = revolve(np.array([[36e-3, 0.0], [30e-3, 0.0], [20e-3, -5e-3]]), sides)
    made, reported = repair(mesh, RADIUS)
    assert made is mesh
    assert reported == ()


def test_walls_that_branch_are_refused_with_a_place() -> None:
    fin = np.vstack([CONE.vertices, [[0.0, 0.02, 5e-3]]])
    edge = CONE.faces[100][:2]
    mesh = Mesh(fin, np.vstack([CONE.faces, [[edge[0], edge[1], len(CONE.vertices)]]]))
    made, _ = repair(mesh, RADIUS)
    with pytest.raises(IsfError) as caught:
        check_and_place(made, CLAMP, RADIUS)
    assert caught.value.code is ErrorCode.MESH_NOT_MANIFOLD
    named = [float(part.split("=")[1].split()[0]) for part in caught.value.where.removeprefix("mesh at ").split(",")]
    np.testing.assert_allclose(np.array(named) * 1e-3, CONE.vertices[edge].mean(axis=0), atol=0.06e-3)


def test_inside_out_is_not_guessed() -> None:
    """All facets down may be the lower face of the sheet: that is the user's to say."""
    made, reported = repair(Mesh(CONE.vertices, CONE.faces[:, ::-1]), RADIUS)
    assert reported == ()
    with pytest.raises(IsfError) as caught:
        check_and_place(made, CLAMP, RADIUS)
    assert caught.value.code is ErrorCode.MESH_INVERTED


def test_topology_of_a_fan_with_many_edges_at_one_vertex() -> None:
    mesh = revolve(np.array([[30e-3, 0.0], [10e-3, -5e-3]]), 400)
    centre = len(mesh.vertices) - 1
    renumbered = np.where(mesh.faces == centre, 0, np.where(mesh.faces == 0, centre, mesh.faces))
    edges = topology(Mesh(mesh.vertices[[centre, *range(1, centre), 0]], renumbered))
    # 400 facets in the fan and 800 in the ring: inner edges belong to two facets, 400 edges are the outline
    assert len(edges.free) == 400
    assert len(edges.count) == (3 * 1200 - 400) // 2 + 400
    assert len(edges.contradicting) == len(edges.crowded) == 0
    assert edges.components(1200)[0] == 1


@pytest.mark.parametrize("up", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_any_axis_can_be_up(up: str) -> None:
    axis = "xyz".index(up[1])
    towards = np.roll(np.eye(3), axis - 2, axis=1) * (1 if up[0] == "+" else np.array([[-1], [1], [-1]]))
    lying = Mesh(CONE.vertices @ towards, CONE.faces)
    assert np.linalg.det(towards) == pytest.approx(1.0)
    part = check_and_place(oriented(lying, up, (0.0, 0.0, 0.0), 1.0), CLAMP, RADIUS)
    assert part.depth == pytest.approx(12e-3, abs=1e-12)


def test_turn_scale_and_place() -> None:
    turned = oriented(CONE, "+z", (0.0, 0.0, np.pi / 2), 0.5)
    np.testing.assert_allclose(turned.vertices[:, 0], -0.5 * CONE.vertices[:, 1], atol=1e-15)
    part = check_and_place(turned, CLAMP, RADIUS, place=(0.02, -0.01))
    middle = (part.mesh.vertices.max(axis=0) + part.mesh.vertices.min(axis=0)) / 2
    np.testing.assert_allclose(middle[:2], [0.02, -0.01], atol=1e-12)
    assert part.depth == pytest.approx(6e-3)


def test_topology_is_found_once_for_the_same_facets() -> None:
    mesh = Cone().mesh(50e-6)
    moved = mesh.moved(np.array([0.01, 0.0, 0.0]))
    assert topology(moved) is topology(mesh)
    inside = int(np.flatnonzero(~np.isin(mesh.faces, topology(mesh).vertices[topology(mesh).free]).any(axis=1))[0])
    holed = Mesh(mesh.vertices, np.delete(mesh.faces, inside, axis=0))
    assert len(topology(holed).free) == len(topology(mesh).free) + 3


def test_flange_level_is_that_of_the_outline() -> None:
    """The outline of the cone is at z = 0; a part of it moved up counts by its length; a closed body has none."""
    mesh = Cone().mesh(50e-6)
    assert flange_level(mesh) == pytest.approx(0.0, abs=1e-12)
    assert flange_level(mesh.moved(np.array([0.0, 0.0, 3e-3]))) == pytest.approx(3e-3, abs=1e-12)
    box = trimesh.creation.box()
    assert flange_level(Mesh(np.asarray(box.vertices), np.asarray(box.faces))) is None
