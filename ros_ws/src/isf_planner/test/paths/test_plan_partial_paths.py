"""Plans with a partial path for every feature, judged by the exact surface and by published numbers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from isf_core.contour import Contour
from isf_core.types import Array
from isf_planner import Plan, plan
from isf_planner.features.surface_features import Kind
from isf_planner.part.meshes import Mesh
from isf_planner.part_library.part import Feature, Part, RoundedSquare
from isf_planner.part_library.part_mesh import part_mesh
from isf_planner.part_library.wall_profile import straight_wall
from isf_planner.paths.sequencing import make_contours
from planner_parts import job_for, write
from scipy.spatial import KDTree

R = 5e-3
SCALLOP = 0.03e-3


def planned(mesh: Mesh, folder: Path, options: str, depth: str = "1 mm") -> Plan:
    job_file = job_for(write(mesh, folder / "part.ply"), process="SPIF", depth=depth, spacing="1 mm", limit="80 deg")
    return plan(type(job_file)(job_file.text.replace("feed:", f"partial_paths: true, {options}feed:"), folder))


def pyramid_with_ribs() -> Mesh:
    wall = straight_wall(np.radians(50), 20e-3, 3e-3, 6e-3)
    return part_mesh(Part("pyramid", (Feature(RoundedSquare(34e-3, 5.5e-3), wall),), 8e-3), 20e-6)


def oblique_pyramid(island: float = 0.0) -> Mesh:
    """16 mm deep; the wall at x > 0 has 25 deg, the others 45 deg; edges sharp, facets up to 2 mm.

    ``island`` : m, height of a square one of 45 deg in the middle of the floor, 4 mm wide at its top
    """
    half, depth = 44e-3, 16e-3
    px, py, nx, _ = half - depth / np.tan(np.radians([25.0, 45.0, 45.0, 45.0]))
    squares = [(0.0, s, s, s, 0.0) for s in (half + 8e-3, half)]  # middle, half widths at x > 0, at x < 0, in y, height
    squares.append((0.0, px, nx, py, -depth))
    if island:
        squares += [((px - nx) / 2, s, s, s, -depth + z) for s, z in ((2e-3 + island, 0.0), (2e-3, island))]
    vertices = [
        (x, y, z)
        for middle, right, left, side, z in squares
        for x, y in ((middle + right, -side), (middle + right, side), (middle - left, side), (middle - left, -side))
    ]
    last = len(vertices) - 4
    faces = [(last, last + 1, last + 2), (last, last + 2, last + 3)]
    for ring in range(len(squares) - 1):
        for i in range(4):
            a, b = 4 * ring + i, 4 * ring + (i + 1) % 4
            faces += [(a, b, b + 4), (a, b + 4, a + 4)]
    fine = trimesh.remesh.subdivide_to_size(np.array(vertices), np.array(faces), 2e-3, max_iter=20)
    return Mesh(np.array(fine[0]), np.array(fine[1]))


@pytest.fixture(scope="module")
def even(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return planned(pyramid_with_ribs(), tmp_path_factory.mktemp("even"), "")


@pytest.fixture(scope="module")
def oblique(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    options = f"spacing: scallop, scallop_height: {SCALLOP * 1e3} mm, "
    return planned(oblique_pyramid(), tmp_path_factory.mktemp("oblique"), options, depth="2 mm")


@pytest.fixture(scope="module")
def around_an_island(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    options = "spacing: scallop, scallop_height: 0.05 mm, "
    return planned(oblique_pyramid(island=6e-3), tmp_path_factory.mktemp("island"), options, depth="2 mm")


def directed(part: Plan, direction: str, folder: Path) -> tuple[Contour, ...]:
    """The contours of ``part`` in another direction, of the same loops."""
    job_file = job_for(folder / "part.ply", process="SPIF", depth="2 mm", spacing="1 mm")
    turned = type(job_file)(
        job_file.text.replace("feed:", f"partial_paths: true, direction: {direction}, feed:"), folder
    )
    return make_contours(part.base.sides, turned, "turned")


def test_eighty_curves_of_four_planes_and_four_ribs_make_ten_contours(even: Plan) -> None:
    """As a prototype of the published algorithms gave (specification of Behera 2015, App. A and B)."""
    partial = even.partial[0]
    kinds = {Kind.PLANE: 4, Kind.RIB_SEMI_VERTICAL: 4}
    tree = even.base.sides[0].tree
    full = []
    for number in range(len(tree.loops)):
        curves = [partial.found.features[c.feature].kind for c in partial.curves if c.loop == number]
        if {kind: curves.count(kind) for kind in set(curves)} == kinds:
            full.append(number)
    assert len(full) >= 10
    ten = full[:10]
    assert sum(curve.loop in ten for curve in partial.curves) == 80
    made = [c for c in even.contours if any(abs(c.forming_tip[0, 2] - tree.loops[k].level) < 1e-9 for k in ten)]
    assert len(made) == 10
    for contour in made:
        ring = shapely.LinearRing(contour.forming_tip[:, :2])
        assert contour.closed
        assert ring.is_simple
        assert ring.is_ccw
    assert (np.diff([contour.forming_tip[0, 2] for contour in made]) < 0).all()


def test_every_contour_of_the_plain_plan_is_there_and_starts_away_from_ribs(even: Plan) -> None:
    assert all(contour.closed for contour in even.contours)
    assert len(even.contours) == 20  # 20 mm deep, 1 mm a step
    for contour in even.contours:
        x, y = np.abs(contour.forming_tip[0, :2])
        assert abs(x - y) > 7e-3  # ribs run along the diagonals


def crossing(contour: Contour, sign: float) -> Array | None:
    """(3,) m, contact where a contour crosses the plane y = 0 at x of this sign; None where it does not."""
    line = np.vstack([contour.contact, contour.contact[:1]]) if contour.closed else contour.contact
    cut = np.flatnonzero((line[1:, 1] >= 0) != (line[:-1, 1] >= 0))
    cut = [k for k in cut if line[k, 0] * sign > 0]
    if not cut:
        return None
    a, b = line[cut[0]], line[cut[0] + 1]
    return np.asarray(a - a[1] / (b[1] - a[1]) * (b - a))


@pytest.mark.parametrize(("sign", "angle", "fewest"), [(1.0, 25.0, 22), (-1.0, 45.0, 12)])
def test_ridges_on_every_wall_are_as_high_as_asked_for(oblique: Plan, sign: float, angle: float, fewest: int) -> None:
    """Judged where the passes cross the middle of a wall: two balls side by side on a plane."""
    found = np.array([p for p in (crossing(c, sign) for c in oblique.contours) if p is not None])
    wall = found[(found[:, 2] < -2.5e-3) & (found[:, 2] > -13.5e-3)]
    step = np.linalg.norm(np.diff(wall, axis=0), axis=1)
    assert len(step) + 1 >= fewest
    assert np.diff(wall[:, 2]) == pytest.approx(-step * np.sin(np.radians(angle)), rel=1e-3)
    ridge = R - np.sqrt(R**2 - step**2 / 4)
    np.testing.assert_allclose(ridge, SCALLOP, rtol=0.10)


@pytest.mark.parametrize(("sign", "newton"), [(1.0, 651.0), (-1.0, 913.0)])
def test_force_is_even_along_a_wall_whose_passes_come_in_turn_with_others(
    oblique: Plan, sign: float, newton: float
) -> None:
    """By the regression with the steps on the wall itself: 0.45 mm on that of 25 deg, 0.75 mm on that of 45 deg."""
    forces = [
        contour.predicted_force[np.argmin(np.linalg.norm(contour.contact - place, axis=1))]
        for contour in oblique.contours
        if not contour.closed and (place := crossing(contour, sign)) is not None and -13.8e-3 < place[2] < -3.4e-3
    ]
    assert len(forces) > 8
    np.testing.assert_allclose(forces, newton, rtol=0.01)


def test_depth_never_falls_back_and_open_passes_come_to_rest(oblique: Plan) -> None:
    depth = [contour.forming_tip[:, 2].max() for contour in oblique.contours]
    assert depth == sorted(depth, reverse=True)
    passes = [contour for contour in oblique.contours if not contour.closed]
    assert len(passes) > 20
    for contour in passes:
        assert contour.speed[0] < 0.1 * contour.feed
        assert contour.speed[-1] < 0.1 * contour.feed


def cut_on_the_way(part: Plan, contours: Sequence[Contour]) -> float:
    """m, most that lifts, plunges and steps down between ``contours`` cut into the surface of ``part``.

    Judged by points on the mesh 0.6 mm apart, which see 12 um less.
    """
    vertices, faces = part.mesh
    surface = KDTree(trimesh.remesh.subdivide_to_size(vertices, faces, 0.6e-3, max_iter=20)[0])
    ways: list[Array] = []
    for before, after in pairwise(contours):
        end, start = before.forming_tip[0 if before.closed else -1], after.forming_tip[0]
        if after.retract:
            rise = np.outer([0.0, 0.05e-3, 0.5e-3, 2e-3, 5e-3, 10e-3, 20e-3], [0.0, 0.0, 1.0])
            ways += [end + rise, start + rise]
        else:
            assert np.linalg.norm(start[:2] - end[:2]) <= R  # no way through the sheet but from loop to loop
            ways.append(end + np.linspace(0, 1, 12)[:, None] * (start - end))
    return float((R - surface.query(np.vstack(ways) + [0.0, 0.0, R])[0]).max())


def test_ball_never_touches_the_finished_surface_on_the_way(oblique: Plan) -> None:
    deepest = cut_on_the_way(oblique, oblique.contours)
    assert deepest < 25e-6
    assert deepest > -1e-6  # the tools do begin on the surface


@pytest.mark.parametrize("direction", ["ccw", "alternating"])
def test_ball_never_cuts_into_an_island_on_the_way(around_an_island: Plan, direction: str, tmp_path: Path) -> None:
    """Passes of pocket and island follow each other by depth, so that the tool goes to and fro between them."""
    contours = directed(around_an_island, direction, tmp_path)
    assert sum(a.feature != b.feature for a, b in pairwise(contours)) > 10
    assert not all(contour.retract for contour in contours[1:])
    # contours around the sharp edges of the island cut up to 28 um into them where they begin
    assert -1e-6 < cut_on_the_way(around_an_island, contours) < 35e-6


def test_open_pass_after_an_open_one_begins_with_a_lift(around_an_island: Plan, tmp_path: Path) -> None:
    """Else the force controller takes both for pieces of one line, which has to begin where the first one ends."""
    contours = directed(around_an_island, "alternating", tmp_path)
    both = [after for before, after in pairwise(contours) if not (before.closed or after.closed)]
    assert len(both) > 10
    assert all(contour.retract for contour in both)
