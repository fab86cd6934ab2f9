"""Distances from a surface against shapes whose distance is a formula, and against every facet tried by sampling."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from isf_analysis.measures.surface_distance import Surface, apart, best_fit, statistics
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from scipy.spatial.transform import Rotation
from synthetic_part import Cone, target_map

RNG = np.random.default_rng(11)


def roof() -> Surface:
    """Two planes that meet in a ridge along y at z = 0, 100 mm long, sloping down by 45 deg to x = +-50 mm."""
    x, y = 0.05, 0.05
    vertices = np.array([[0, -y, 0], [0, y, 0], [x, -y, -x], [x, y, -x], [-x, -y, -x], [-x, y, -x]])
    return Surface(vertices, np.array([[0, 2, 3], [0, 3, 1], [0, 1, 5], [0, 5, 4]]))


def test_distance_from_two_planes_is_a_formula() -> None:
    """Above the ridge the ridge is nearest; else the nearer plane: |x| + z over root 2."""
    points = RNG.uniform([-0.03, -0.04, -0.02], [0.03, 0.04, 0.02], (2000, 3))
    found = roof().distances(points)
    x, z = np.abs(points[:, 0]), points[:, 2]
    expected = np.where(x < z, np.hypot(x, z), (x + z) / np.sqrt(2.0))
    np.testing.assert_allclose(found.signed, expected, atol=1e-12)
    assert not found.beside.any()


def test_points_beside_the_surface_are_known_as_such() -> None:
    points = np.array([[0.0, 0.08, 0.0], [0.06, 0.0, -0.05], [0.0, 0.0, 0.01], [0.02, 0.03, -0.03]])
    np.testing.assert_array_equal(roof().distances(points).beside, [True, True, False, False])


def test_a_fine_cone_with_coarse_flange_against_its_formula() -> None:
    """The wall of 50 deg of a height map: distance to the plane of the wall, 5 um for facets of 1 mm on a cone."""
    cone = Cone()
    surface = Surface.of_height_map(target_map(cone))
    phi = RNG.uniform(0.0, 2.0 * np.pi, 500)
    depth = RNG.uniform(0.3, 0.7, 500) * cone.depth
    radius = np.array([cone.radius_at(value) for value in depth])
    offset = RNG.uniform(-1e-3, 1e-3, 500)
    inward = np.column_stack([-np.cos(phi), -np.sin(phi)]) * np.sin(cone.wall_angle)
    wall = np.column_stack([radius * np.cos(phi), radius * np.sin(phi), -depth])
    points = wall + offset[:, None] * np.column_stack([inward, np.full(500, np.cos(cone.wall_angle))])
    found = surface.distances(points)
    assert np.abs(found.signed - offset).max() < 10e-6  # a chord of 1 mm on 20 mm radius is 6 um off
    assert np.median(np.abs(found.signed - offset)) < 5e-6


def test_far_points_are_measured_in_little_memory() -> None:
    """A flat sheet of 20 000 facets 5 m below 100 points: any facet may be the nearest of any point."""
    axis = np.linspace(-0.1, 0.1, 101)
    sheet = HeightMap(axis, axis, np.zeros((101, 101)))
    surface = Surface.of_height_map(sheet)
    points = np.column_stack([RNG.uniform(-0.1, 0.1, (100, 2)), np.full(100, 5.0)])
    surface.distances(points[:2])  # what is loaded at the first use does not count
    tracemalloc.start()
    found = surface.distances(points)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    np.testing.assert_allclose(found.signed, 5.0, atol=1e-9)
    assert most < 400e6  # all 2 million pairs at once take 650 MB


def test_shapes_that_cannot_be_meant_to_lie_on_each_other() -> None:
    surface = roof()
    ridge = surface.corners.reshape(-1, 3)
    assert not apart(ridge + [0.0, 0.0, 1e-3], surface, 0.1)
    assert "mm between" in apart(ridge + [0.0, 0.0, 0.2], surface, 0.1)
    assert not apart(ridge + [0.0, 0.0, 0.2], surface, 1.0)
    for factor in (1e3, 1e-3, 25.4):
        assert "large" in apart(factor * ridge, surface, 0.1)


def test_a_surface_without_facets_is_refused() -> None:
    with pytest.raises(IsfError) as caught:
        Surface.of_height_map(HeightMap(np.arange(3.0), np.arange(3.0), np.full((3, 3), np.nan)))
    assert caught.value.code == ErrorCode.MESH_EMPTY


def test_no_facet_is_nearer_whatever_the_sizes_of_facets() -> None:
    """Slivers as long as the part among small facets, as CAD has them; every facet is sampled at 300 places."""
    corners = RNG.normal(size=(60, 3, 3)) * np.where(np.arange(60) % 20 == 0, 0.1, 0.004)[:, None, None]
    corners += RNG.normal(size=(60, 1, 3)) * 0.02
    surface = Surface(corners.reshape(-1, 3), np.arange(180).reshape(-1, 3))
    points = RNG.normal(size=(200, 3)) * 0.03
    share = RNG.dirichlet(np.ones(3), 300)
    samples = np.einsum("sk,fkj->fsj", share, surface.corners).reshape(-1, 3)
    nearest = np.linalg.norm(points[:, None] - samples[None], axis=2).min(axis=1)
    found = surface.distances(points)
    size = np.abs(found.signed)
    assert (size <= nearest + 1e-12).all()
    np.testing.assert_allclose(np.linalg.norm(points - found.closest, axis=1), size, atol=1e-15)
    assert np.median(nearest - size) < 1e-3  # and the samples come near to it


def test_a_motion_is_found_again() -> None:
    shape = target_map(Cone(), 5e-3)
    bump = HeightMap(
        shape.x, shape.y, shape.z + 2e-3 * np.exp(-((shape.x - 0.02) ** 2 + (shape.y[:, None]) ** 2) / 1e-4)
    )
    surface = Surface.of_height_map(bump)
    turned = Rotation.from_rotvec([0.01, -0.008, 0.02]).as_matrix()
    inside = bump.points()[(np.abs(bump.points()[:, :2]) < 0.1).all(axis=1)]
    moved = inside @ turned.T + np.array([0.8e-3, -0.5e-3, 1.1e-3])
    motion = best_fit(moved, surface)
    assert np.abs(motion.of(moved) - inside).max() < 2e-6
    assert motion.angle == pytest.approx(np.linalg.norm([0.01, -0.008, 0.02]), rel=1e-3)


@pytest.mark.parametrize("shift", [(0.3e-3, 0.0, 0.0), (0.0, -2e-3, 0.0), (1e-3, -1e-3, 0.5e-3)])
def test_a_shift_to_the_side_is_found_on_a_part_that_is_mostly_flange(shift: tuple[float, float, float]) -> None:
    """No noise: on the flange, three quarters of the sheet, every distance is 0 before and after."""
    surface = Surface.of_height_map(target_map(Cone(), 2e-3))
    wall = target_map(Cone(), 2e-3).points()
    wall = wall[(np.abs(wall[:, :2]) < 0.11).all(axis=1)]
    moved = wall + np.array(shift)
    motion = best_fit(moved, surface)
    assert np.abs(motion.of(moved) - wall)[:, 2].max() < 5e-6
    np.testing.assert_allclose(motion.shift[:2], -np.array(shift)[:2], atol=5e-6)


def test_what_cannot_be_fitted_is_said() -> None:
    with pytest.raises(IsfError, match="cannot be fitted") as caught:
        best_fit(np.array([[1.0, 1.0, 0.0], [1.0, 2.0, 0.0]]), roof())
    assert caught.value.code == ErrorCode.SCAN_INCOMPLETE


def test_numbers_count_what_the_points_stand_for() -> None:
    points = np.array([[0.0, 0.0, 0.1e-3], [0.0, 0.01, 0.4e-3], [0.0, 0.08, 0.0]])
    found = roof().distances(points)
    numbers = statistics(points, found, np.array([3.0, 1.0, 1.0]))
    assert numbers is not None
    assert (numbers.points, numbers.beside) == (2, 0.2)
    assert numbers.signed.mean == pytest.approx((3 * 0.1e-3 + 0.4e-3) / 4)
    assert numbers.within == {0.1e-3: 0.75, 0.2e-3: 0.75, 0.3e-3: 0.75}
    assert numbers.worst == (0.0, 0.01, 0.4e-3)
    assert statistics(points[2:], roof().distances(points[2:]), np.ones(1)) is None
