"""Parts with several pockets and islands: every loop is found, linked to its feature and formed in order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from isf_planner import Plan, plan
from isf_planner.loops.sections import LoopTree
from planner_parts import grid_mesh, job_for, write

X = np.linspace(-0.08, 0.08, 161)
GX, GY = np.meshgrid(X, X)


def bowl(x: float, y: float, radius: float, depth: float) -> np.ndarray:
    """A round pocket with a cosine wall, floor of half the radius."""
    share = np.clip((np.hypot(GX - x, GY - y) / radius - 0.4) / 0.6, 0, 1)
    return -depth * (0.5 + 0.5 * np.cos(np.pi * share))


def planned(z: np.ndarray, folder: Path, **changes: str) -> Plan:
    path = write(grid_mesh(X, X, z), folder / "part.stl")
    return plan(job_for(path, **({"depth": "1 mm", "spacing": "1 mm", "process": "SPIF"} | changes)))


def tree_of(made: Plan) -> LoopTree:
    assert made.tree is not None
    return made.tree


def check_nesting(tree: LoopTree) -> None:
    """A pocket lies inside its parent; an island covers its parent; features know their loops."""
    for index, loop in enumerate(tree.loops):
        assert index in tree.features[loop.feature].loops
        ring = shapely.Polygon(loop.points)
        assert ring.is_valid
        assert ring.exterior.is_ccw != loop.island
        if loop.parent >= 0:
            above = shapely.Polygon(tree.loops[loop.parent].points)
            inner, outer = (above, ring) if loop.island else (ring, above)
            assert outer.buffer(60e-6).contains(inner)
    for feature in tree.features:
        assert feature.parent < feature.number
        depths = [abs(tree.loops[k].level) for k in feature.loops]
        assert depths == sorted(depths)


def test_two_pockets_of_different_depth_end_at_their_own_floor(tmp_path: Path) -> None:
    made = planned(bowl(-0.035, 0, 0.03, 8e-3) + bowl(0.035, 0, 0.025, 5.3e-3), tmp_path)
    tree = tree_of(made)
    check_nesting(tree)
    assert [feature.parent for feature in tree.features] == [-1, -1]
    levels = [[round(tree.loops[k].level * 1e3, 3) for k in feature.loops] for feature in tree.features]
    expected = [[-1, -2, -3, -4, -5, -6, -7, -8], [-1, -2, -3, -4, -5, -5.3]]
    assert sorted(levels) == sorted(expected)
    # one feature after the other, lifted in between and nowhere else
    features = [contour.feature for contour in made.contours]
    assert features == sorted(features)
    assert [k for k, contour in enumerate(made.contours) if contour.retract] == [len(tree.features[0].loops)]


def test_a_pocket_that_splits_has_two_children(tmp_path: Path) -> None:
    x = np.minimum(np.hypot(GX - 0.02, GY), np.hypot(GX + 0.02, GY))
    z = -10e-3 * (0.5 + 0.5 * np.cos(np.pi * np.clip((x - 6e-3) / 30e-3, 0, 1)))
    tree = tree_of(planned(z, tmp_path, limit="85 deg"))
    check_nesting(tree)
    assert [feature.parent for feature in tree.features] == [-1, 0, 0]
    saddle = z[80, 80]
    assert tree.loops[tree.features[0].loops[-1]].level > saddle
    assert all(tree.loops[tree.features[k].loops[0]].level <= saddle + 0.5e-3 for k in (1, 2))


def test_an_island_belongs_to_its_pocket(tmp_path: Path) -> None:
    hill = 5e-3 * (0.5 + 0.5 * np.cos(np.pi * np.clip(np.hypot(GX, GY) / 0.015, 0, 1)))
    made = planned(bowl(0, 0, 0.07, 8e-3) + hill, tmp_path)
    tree = tree_of(made)
    check_nesting(tree)
    assert [(feature.island, feature.parent) for feature in tree.features] == [(False, -1), (True, 0)]
    assert [round(tree.loops[k].level * 1e3, 3) for k in tree.features[1].loops] == pytest.approx([-4, -5, -6, -7, -8])
    island = made.contours[-1]
    centre = island.forming_tip + [0, 0, 5e-3]
    np.testing.assert_allclose(np.linalg.norm(centre - island.contact, axis=1), 5e-3, atol=1e-9)
    # the contact is between the tip and the hill
    assert (np.hypot(*island.contact[:-1, :2].T) < np.hypot(*island.forming_tip[:-1, :2].T) + 1e-6).all()


def test_a_pocket_shallower_than_the_first_level_is_not_forgotten(tmp_path: Path) -> None:
    tree = tree_of(planned(bowl(-0.035, 0, 0.03, 6e-3) + bowl(0.035, 0, 0.03, 0.6e-3), tmp_path))
    check_nesting(tree)
    assert sorted(len(feature.loops) for feature in tree.features) == [1, 6]
    (single,) = (feature for feature in tree.features if len(feature.loops) == 1)
    assert tree.loops[single.loops[0]].level == pytest.approx(-0.6e-3, abs=5e-6)


def tub(noise: float = 0.0) -> np.ndarray:
    """A round pocket 6 mm deep, its floor 32 mm wide, with ``noise`` m (standard deviation) on all that is formed."""
    z = bowl(0.0, 0.0, 40e-3, 6e-3)
    return np.where(z < 0.0, z + np.random.default_rng(3).normal(0.0, noise, z.shape), 0.0)


def about_noise(made: Plan) -> list[str]:
    return [warning for warning in made.warnings if "noise of the surface" in warning]


@pytest.mark.parametrize("depth", ["0.5 mm", "0.7 mm"])  # a level on the floor, and none near it
def test_noise_of_a_floor_makes_no_loops(depth: str, tmp_path: Path) -> None:
    """With 14 um of noise a level on the floor cuts it into dozens of islands and pockets, none of them the part's."""
    made = planned(tub(14e-6), tmp_path, depth=depth)
    clean = planned(tub(), tmp_path, depth=depth)
    assert not about_noise(clean)
    assert len(made.contours) in {len(clean.contours) - 1, len(clean.contours)}
    assert len(tree_of(made).features) == 1
    lowest = made.contours[-1].forming_tip[:, 2].max()
    assert -6.0e-3 < lowest < -5.8e-3  # just above the noise
    assert made.contours[-1].length > 0.07  # around all of the floor
    (told,) = about_noise(made)
    assert "smooth or remesh the part" in told
    assert "x = " in told


@pytest.mark.parametrize("rise", [0.1e-3, -0.12e-3])
@pytest.mark.parametrize("below", [0.0, 0.03e-3])  # how far the floor is below the level before the last
def test_marks_of_a_tenth_of_a_millimetre_stay(rise: float, below: float, tmp_path: Path) -> None:
    """Six narrow marks on a floor, raised or sunk; noise is less deep, or in one pocket together."""
    z = tub() * (1.0 + below / 6e-3)
    for k in range(6):
        x, y = 11e-3 * np.cos(k * np.pi / 3), 11e-3 * np.sin(k * np.pi / 3)
        z = z - np.sign(rise) * bowl(x, y, 4.5e-3, abs(rise))
    made = planned(z, tmp_path, depth="1 mm", spacing="0.8 mm")
    assert not about_noise(made)
    marks = [loop for loop in tree_of(made).loops if np.ptp(loop.points, axis=0).max() < 15e-3]
    assert len(marks) >= 6
    check_nesting(tree_of(made))
