"""Partial tool paths on lines and feature maps made by hand: nothing is dropped, and what is cut joins again."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from isf_planner.features.surface_features import FeatureMap, Kind, SurfaceFeature
from isf_planner.forming.sides import Side
from isf_planner.loops.feature_levels import FeatureLevels
from isf_planner.loops.sections import Feature, LoopTree
from isf_planner.loops.tip_loops import TipLoop
from isf_planner.paths.partial_paths import PartialPaths, partial_paths, without_path
from isf_planner.paths.sequencing import Piece, safe_start, sequenced
from isf_planner.surface.target_surface import TargetSurface
from planner_parts import job_for

R = 5e-3
L_SHAPE = 1e-3 * np.array([[-40, -40], [40, -40], [40, 0], [0, 0], [0, 40], [-40, 40]])
"""(6, 2) m, not star-shaped around the middle of its box, 320 mm long."""


def line(corners: Array, level: float, size: float = 1.0, feature: int = 0) -> TipLoop:
    """Closed line through ``corners`` (K, 2) m, points 0.5 mm apart, on level ground."""
    ends = np.roll(corners, -1, axis=0)
    parts = [
        a + np.linspace(0, 1, round(np.linalg.norm(b - a) / 0.5e-3), endpoint=False)[:, None] * (b - a)
        for a, b in zip(corners, ends, strict=True)
    ]
    points = size * np.vstack(parts)
    return TipLoop(level, points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), feature=feature)


def patches(seed: int, kinds: list[Kind]) -> FeatureMap:
    """Features around random middles on a plane of 0.2 m."""
    x = np.linspace(-0.1, 0.1, 201)
    heights = HeightMap(x, x, np.zeros((201, 201)))
    middle = np.random.default_rng(seed).uniform(-0.05, 0.05, (len(kinds), 2))
    points = heights.points()[:, None, :2]
    label = np.argmin(np.linalg.norm(points - middle, axis=2), axis=1).reshape(201, 201)
    features = tuple(SurfaceFeature(k, kind, 0.8, 0.0, 1e-3, -1e-2, 0.0, np.zeros(3)) for k, kind in enumerate(kinds))
    return FeatureMap(heights, label, features)


def levels(formed: Array) -> FeatureLevels:
    """Levels 1 mm apart, and one more at the full depth."""
    k, n = formed.shape
    return FeatureLevels(-1e-3 * np.arange(1, k + 2), np.vstack([formed, np.ones((1, n), dtype=bool)]), np.full(n, 99))


def side_of(loops: list[TipLoop], partial: PartialPaths) -> Side:
    """One pocket over a surface far below, so that no move cuts into it."""
    tree = LoopTree(tuple(loops), (Feature(0, -1, False, 1, tuple(range(len(loops)))),))
    z = np.full((401, 401), -1.0)
    return Side(tree, TargetSurface(np.array([-0.1, -0.1]), 0.5e-3, z, np.zeros((401, 401, 2))), partial=partial)


def order(loops: list[TipLoop], partial: PartialPaths, folder: Path) -> list[Piece]:
    return sequenced(side_of(loops, partial), job_for(folder / "none.stl", process="SPIF").job)


def tree_of(loops: list[TipLoop]) -> LoopTree:
    return LoopTree(tuple(loops), (Feature(0, -1, False, 1, tuple(range(len(loops)))),))


def length(points: Array) -> float:
    return float(np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum())


@given(seed=st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_l_shaped_contours_keep_their_length_through_any_cuts(seed: int) -> None:
    """Sorted by polar angle they would be 1678 mm long (computed from the published algorithm)."""
    kinds = [Kind.PLANE, Kind.PLANE, Kind.RIB_SEMI_VERTICAL, Kind.RULED_NEGATIVE, Kind.FLOOR]
    loop = line(L_SHAPE, -1e-3)
    found = partial_paths(tree_of([loop]), patches(seed, kinds), levels(np.ones((1, 5), dtype=bool)), R)
    assert [one.closed for one in found.passes] == [True]
    assert length(loop.points[found.passes[0].points]) == pytest.approx(0.320, abs=1e-9)
    assert sum(curve.count for curve in found.curves) == len(loop.points)


@given(data=st.data(), seed=st.integers(0, 10_000))
@settings(max_examples=12, deadline=None)
def test_any_layout_drops_nothing_and_never_travels_in_the_sheet(
    data: st.DataObject, seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    kinds = data.draw(st.lists(st.sampled_from([Kind.PLANE, Kind.RIB_SEMI_VERTICAL]), min_size=2, max_size=9))
    kinds = [Kind.PLANE, *kinds]
    formed = np.random.default_rng(seed).random((3, len(kinds))) < 0.6
    formed[:, 0] = True
    loops = [line(L_SHAPE, -1e-3 * (k + 1), 1.0 - 0.02 * k) for k in range(4)]
    surface = patches(seed, kinds)
    found = partial_paths(tree_of(loops), surface, levels(formed), R)
    rib = np.array([kind is Kind.RIB_SEMI_VERTICAL for kind in kinds])
    for number, loop in enumerate(loops):
        passed = np.zeros(len(loop.points), dtype=int)
        for one in found.passes:
            if one.loop == number:
                passed[one.points] += 1
        assert passed.max() <= 1
        label = surface.of_points(loop.contact(R))
        wanted = np.ones(len(rib), dtype=bool) if number == 3 else formed[number] & ~rib
        for begin in np.flatnonzero(wanted[label] & (passed == 0)):
            # only a touch of less than a quarter of the radius may be left out
            same = label[np.mod(np.arange(begin - 5, begin + 6), len(label))] == label[begin]
            assert np.count_nonzero(same) < 6
    pieces = order(loops, found, tmp_path_factory.mktemp("job"))
    assert len(pieces) == len(found.passes)
    depth = [piece.path.points[:, 2].max() for piece in pieces]
    assert depth == sorted(depth, reverse=True)
    assert pieces[0].retract
    for before, after in pairwise(pieces):
        end = before.path.points[0 if before.path.closed else -1]
        way = np.linalg.norm(after.path.points[0, :2] - end[:2])
        assert after.retract or way <= R
    assert [piece.path.closed for piece in pieces].count(False) == sum(not one.closed for one in found.passes)


def test_open_pass_ends_a_tool_radius_beyond_its_feature_and_away_from_the_rib() -> None:
    """A square of 80 mm; the wall at x > 0 alone is formed, a rib of 4 mm lies along each of its ends."""
    x = np.linspace(-0.1, 0.1, 401)
    heights = HeightMap(x, x, np.zeros((401, 401)))
    label = np.where(x[None, :] > 2e-3, 0, np.where(x[None, :] > -2e-3, 1, 2)).repeat(401, axis=0)
    kinds = (Kind.PLANE, Kind.RIB_SEMI_VERTICAL, Kind.PLANE)
    features = tuple(SurfaceFeature(k, kind, 0.8, 0.0, 1e-3, -1e-2, 0.0, np.zeros(3)) for k, kind in enumerate(kinds))
    corners = 1e-3 * np.array([[-40, -40], [40, -40], [40, 40], [-40, 40]])
    loop = line(corners, -1e-3)
    formed = np.array([[True, True, False]])
    found = partial_paths(tree_of([loop]), FeatureMap(heights, label, features), levels(formed), R)
    assert [one.closed for one in found.passes] == [False]
    passed = loop.points[found.passes[0].points]
    assert passed[0] == pytest.approx([-7e-3, -40e-3], abs=0.6e-3)  # the rib ends at -2 mm, and 5 mm are safe
    assert passed[-1] == pytest.approx([-7e-3, 40e-3], abs=0.6e-3)


def test_start_is_next_to_the_last_one_but_never_near_a_rib() -> None:
    points = np.column_stack([np.linspace(0, 0.1, 101), np.zeros(101), np.zeros(101)])
    away = np.abs(points[:, 0] - 0.04)
    assert points[safe_start(points, away, None, R), 0] == pytest.approx(0.1, abs=2e-3)
    assert points[safe_start(points, away, np.array([0.02, 0, 0]), R), 0] == pytest.approx(0.02)
    assert points[safe_start(points, away, np.array([0.042, 0, 0]), R), 0] == pytest.approx(0.0455, abs=0.6e-3)
    near = np.minimum(away, 4e-3)
    assert near[safe_start(points, near, np.array([0.042, 0, 0]), R)] == pytest.approx(4e-3)  # none is safe


def test_wall_that_the_tool_cannot_touch_is_refused_with_its_place() -> None:
    surface = patches(3, [Kind.PLANE, Kind.PLANE])
    surface = replace(surface, label=np.zeros_like(surface.label))
    untouched = replace(levels(np.ones((1, 2), dtype=bool)), touched=np.array([99, 0]))
    loops = [line(L_SHAPE, -1e-3)]
    found = partial_paths(tree_of(loops), surface, untouched, R)
    level = side_of(loops, found).surface
    with pytest.raises(IsfError) as caught:
        without_path(found, untouched, level, R)
    assert caught.value.code == ErrorCode.PARTIAL_PATH_MISSING
    assert "feature 2 (plane" in caught.value.what
    assert "x = 0.0, y = 0.0" in caught.value.where
    assert "smaller tool_1.radius" in caught.value.advice
    touched = replace(untouched, touched=np.array([99, 50]))
    assert "no path of its own" in without_path(found, touched, level, R)[0]


@pytest.mark.parametrize(("angle", "reached"), [(30.0, True), (60.0, False)])
def test_wall_that_the_survey_missed_is_refused_only_where_no_ball_touches_it(angle: float, reached: bool) -> None:
    """A wall 1.5 mm high: standing on the floor below, the ball touches one of 30 deg 0.67 mm above the floor, and one
    of 60 deg, 2.5 mm above it, no more: it leans on the upper edge."""
    x = np.linspace(-20e-3, 20e-3, 401)
    slope = np.tan(np.radians(angle))
    width = 1.5e-3 / slope
    z = np.tile(-slope * np.clip(x, 0.0, width), (401, 1))
    normal_xy = np.zeros((401, 401, 2))
    normal_xy[:, (x > 0) & (x < width), 0] = np.sin(np.radians(angle))
    label = np.tile(((x > 0.15e-3) & (x < width)).astype(np.int64), (401, 1))
    features = tuple(SurfaceFeature(k, Kind.PLANE, 0.8, 0.0, 1e-3, -1e-2, 0.0, np.zeros(3)) for k in range(2))
    found = PartialPaths(FeatureMap(HeightMap(x, x, z), label, features), (), (), ())
    missed = replace(levels(np.ones((1, 2), dtype=bool)), touched=np.array([99, 0]))
    surface = TargetSurface(np.array([-20e-3, -20e-3]), 0.1e-3, z, normal_xy)
    if reached:
        assert "feature 2 (plane" in without_path(found, missed, surface, R)[1]
        return
    with pytest.raises(IsfError, match=r"feature 2 .* cannot touch it"):
        without_path(found, missed, surface, R)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("style: spiral", "needs style contours"),
        ("transition: ramp", "needs transition step"),
        ("stagger: 3 mm", "needs stagger 0.0"),
        ("thickness: overlap", "needs thickness sine_law"),
    ],
)
def test_options_that_exclude_partial_paths_are_refused(options: str, said: str, tmp_path: Path) -> None:
    job_file = job_for(tmp_path / "none.stl", process="SPIF")
    with pytest.raises(IsfError, match=said):
        JobFile(job_file.text.replace("feed:", f"partial_paths: true, {options}, feed:"), tmp_path)


def test_other_processes_have_no_partial_paths() -> None:
    from isf_core.files.job import PathSpec

    spec = PathSpec(incremental_depth="1 mm", point_spacing="1 mm", feed="10 mm/s", partial_paths=True)
    assert "SPIF or DSIF" in (spec.without_effect("TPIF") or "")
    assert spec.without_effect("SPIF") is None
