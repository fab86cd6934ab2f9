"""Features of parts whose walls, edges and floors are known, in meshes of every quality."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_planner.features.segmentation import find_features
from isf_planner.features.surface_features import FeatureMap, Kind
from isf_planner.part.meshes import Mesh
from isf_planner.part_library import PARTS, part_mesh
from isf_planner.surface import height_grid
from isf_planner.view import feature_view
from packed_page import text_of

RADIUS = 5e-3
WIDE = 8e-3
"""m, of a larger tool, which looks at a surface on a coarser grid."""

TWO_SLOPES = {
    "top": 1,
    "floor": 1,
    "plane": 8,
    "rim": 4,
    "rib_semi_vertical": 8,
    "rib_transition": 4,
    "rib_bottom": 4,
}
"""Published for the two-slope pyramid (Behera 2015): 8 walls, 8 + 4 + 4 ribs, floor and top; the rims are our own."""


def sharp_pyramid(half: float, upper: tuple[float, float], lower: tuple[float, float]) -> Mesh:
    """28 facets: two slopes (angle in deg, depth in mm) below a square of half side ``half`` mm, edges sharp."""
    run = [depth / np.tan(np.radians(angle)) for angle, depth in (upper, lower)]
    sides = [half + 8.0, half, half - run[0], half - run[0] - run[1]]
    levels = [0.0, 0.0, -upper[1], -upper[1] - lower[1]]
    signs = ((1, -1), (1, 1), (-1, 1), (-1, -1))
    vertices = np.array([(sx * s, sy * s, z) for s, z in zip(sides, levels, strict=True) for sx, sy in signs])
    faces = [[12, 13, 14], [12, 14, 15]]
    for ring in range(3):
        for i in range(4):
            a, b = 4 * ring + i, 4 * ring + (i + 1) % 4
            faces += [[a, b, b + 4], [a, b + 4, a + 4]]
    return Mesh(1e-3 * vertices, np.array(faces))


PYRAMID = sharp_pyramid(54.0, (70.0, 22.0), (28.0, 16.0))


def subdivided(mesh: Mesh, edge: float, noise: float = 0.0) -> Mesh:
    """Facets with edges up to ``edge`` m, and vertices below the flange moved by a normal ``noise`` m in all axes."""
    fine = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, edge))
    vertices = np.array(fine.vertices)
    formed = vertices[:, 2] < -1e-6
    vertices[formed] += np.random.default_rng(3).normal(0.0, noise, (np.count_nonzero(formed), 3))
    return Mesh(vertices, np.array(fine.faces))


@pytest.fixture(scope="module")
def pyramid() -> FeatureMap:
    return find_features(PYRAMID, RADIUS)


@pytest.mark.parametrize(
    "mesh",
    [
        sharp_pyramid(50.0, (80.0, 25.0), (25.0, 16.0)),
        part_mesh(PARTS["ribbed_pyramid"](rib=5e-3, floor=5e-3), 20e-6),
        sharp_pyramid(54.0, (70.0, 22.0), (17.0, 6.0)),
        subdivided(PYRAMID, 3e-3),
        subdivided(PYRAMID, 4e-3, 50e-6),
    ],
    ids=["80 and 25 deg, 28 facets", "with fillets", "floor edges of 17 deg", "remeshed", "noise of 0.05 mm"],
)
def test_two_slope_pyramid_has_eight_walls_sixteen_ribs_floor_and_top(mesh: Mesh) -> None:
    assert find_features(mesh, RADIUS).counts() == TWO_SLOPES


def test_every_wall_of_the_pyramid_is_where_its_plane_is(pyramid: FeatureMap) -> None:
    """Judge without the grid: the facets of the mesh itself, by their normals."""
    corners = PYRAMID.corners()
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    walls = np.flatnonzero((normal[:, 2] < 0.999) & (np.arange(len(normal)) >= 2))
    rng = np.random.default_rng(1)
    share = rng.dirichlet([1.0, 1.0, 1.0], 200)
    seen: dict[tuple[int, ...], Counter[int]] = {}
    for facet in walls:
        labels = pyramid.of_points(share @ corners[facet])
        planes = [int(k) for k in labels if pyramid.features[k].kind is Kind.PLANE]
        seen.setdefault(tuple(np.round(normal[facet], 6)), Counter()).update(planes)
        assert all(pyramid.features[k].kind is Kind.PLANE or pyramid.features[k].kind.rib for k in labels)
        assert len(planes) > 0.6 * len(labels)  # the ribs of this small one are 3 mm wide
    assert len(seen) == 8
    owners = {normal: labels.most_common(1)[0] for normal, labels in seen.items()}
    assert len({label for label, _ in owners.values()}) == 8
    for normal, (label, times) in owners.items():
        assert times > 0.97 * seen[normal].total()
        assert pyramid.features[label].wall_angle == pytest.approx(np.arccos(normal[2]), abs=np.radians(0.5))


def test_neighbours_of_the_pyramid(pyramid: FeatureMap) -> None:
    features = pyramid.features
    by_kind = {kind: [f for f in features if f.kind is kind] for kind in Kind}
    upper = [f for f in by_kind[Kind.PLANE] if f.wall_angle > np.radians(50)]
    lower = [f for f in by_kind[Kind.PLANE] if f.wall_angle < np.radians(50)]
    assert len(upper) == len(lower) == 4
    for wall in upper:
        assert {features[k].kind for k in wall.above} == {Kind.RIM}
        assert {features[k].kind for k in wall.below} == {Kind.RIB_TRANSITION}
        assert [features[k].kind for k in wall.beside] == [Kind.RIB_SEMI_VERTICAL] * 2
        ranks = sorted(pyramid.horizontal_rank(wall.number, other.number) for other in upper)
        assert ranks == [0, 2, 2, 4]  # itself, those beyond a rib each, the one opposite
        assert [pyramid.horizontal_rank(wall.number, other.number) for other in lower] == [None] * 4
    for rib in by_kind[Kind.RIB_TRANSITION]:
        assert next(features[k] for k in rib.above if features[k].kind is Kind.PLANE) in upper
        assert next(features[k] for k in rib.below if features[k].kind is Kind.PLANE) in lower
    (floor,) = by_kind[Kind.FLOOR]
    assert floor.below == floor.beside == ()
    assert {features[k].kind for k in floor.above} == {Kind.RIB_BOTTOM}
    assert floor.lowest == pytest.approx(-38e-3, abs=1e-6)


def test_library_parts_are_labelled_as_a_person_would() -> None:
    expected = {
        "cone": {"top": 1, "floor": 1, "ruled_positive": 1, "rim": 1, "rib_bottom": 1},
        "funnel": {"top": 1, "floor": 1, "freeform_positive": 1, "rim": 1, "rib_bottom": 1},
        "pyramid": {"top": 1, "floor": 1, "plane": 4, "ruled_positive": 4, "rim": 8, "rib_bottom": 8},
        "shamrock": {"top": 1, "floor": 1, "ruled_positive": 3, "ruled_negative": 3, "rim": 6, "rib_bottom": 6},
        "two_pockets": {"top": 1, "floor": 2, "ruled_positive": 2, "rim": 2, "rib_bottom": 2},
    }
    for name, counts in expected.items():
        assert find_features(part_mesh(PARTS[name](), 20e-6), RADIUS).counts() == counts, name


def surface(height: np.ndarray) -> Mesh:
    axis = np.linspace(-60e-3, 60e-3, height.shape[0])
    return height_grid.as_mesh(HeightMap(axis, axis, np.minimum(height, 0.0)))


def test_bowl_dome_and_trough() -> None:
    axis = np.linspace(-60e-3, 60e-3, 121)
    x, y = np.meshgrid(axis, axis)
    bowl = 50e-3 - np.sqrt(np.maximum((75e-3) ** 2 - x**2 - y**2, (50e-3) ** 2))
    assert find_features(surface(bowl), WIDE).counts() == {"top": 1, "freeform_positive": 1, "rim": 1}
    # a square pocket with a plane floor, from which a cap of a sphere of 60 mm rises to 9 mm below the flange
    cap = np.sqrt(np.maximum((60e-3) ** 2 - x**2 - y**2, 0.0)) - 69e-3
    pocket = np.maximum(np.where(np.maximum(np.abs(x), np.abs(y)) < 52e-3, -20e-3, 0.0), cap)
    found = find_features(surface(np.where(np.maximum(np.abs(x), np.abs(y)) < 52e-3, pocket, 0.0)), WIDE)
    assert found.counts()["freeform_negative"] == 1
    # a half pipe along x: its rulings are level, the wall angle changes with depth
    pipe = 40e-3 - np.sqrt(np.maximum((60e-3) ** 2 - y**2, (40e-3) ** 2))
    pipe = np.where(np.abs(x) < 50e-3, pipe, 0.0)
    (trough,) = [f for f in find_features(surface(pipe), WIDE).features if f.kind is Kind.RULED_POSITIVE]
    assert trough.horizontal_rulings
    assert 1.0 / trough.curvature == pytest.approx(60e-3, rel=0.08)


def test_picture_names_what_is_there(pyramid: FeatureMap, tmp_path: Path) -> None:
    html = feature_view.show_features(pyramid, "pyramid", tmp_path / "features.html").read_text(encoding="utf-8")
    page = text_of(html)
    for text in ("8 plane", "8 rib, semi-vertical", "4 rib, transition", "4 rib, bottom", "1 floor", "70 deg"):
        assert text in page
    assert feature_view.show_features(pyramid, "pyramid", tmp_path / "features.png").stat().st_size > 20_000
    with pytest.raises(IsfError) as caught:
        feature_view.show_features(pyramid, "pyramid", tmp_path / "features.txt")
    assert caught.value.code == ErrorCode.EXPORT_FORMAT_UNKNOWN
