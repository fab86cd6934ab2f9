"""Properties of plans of random surfaces with several pockets and islands: closed, nested, and no loop lost."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from isf_planner import Plan, plan
from isf_planner.checks.mesh_slicing import slice_mesh
from planner_parts import grid_mesh, job_for, write

X = np.linspace(-0.08, 0.08, 107)
GX, GY = np.meshgrid(X, X)
STEP = 1.5e-3


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(0, 2))
@example(173082, 3, 0)  # two pockets whose loops meet in a turn of 67 degrees
def test_every_section_of_the_part_has_its_loop_of_the_tool(seed: int, pockets: int, islands: int) -> None:
    rng = np.random.default_rng(seed)
    z = np.zeros_like(GX)
    for sign, count in ((-1.0, pockets), (1.0, islands)):
        for _ in range(count):
            x, y = rng.uniform(-0.03, 0.03, 2)
            z += (
                sign
                * rng.uniform(3e-3, 7e-3)
                * np.exp(-((GX - x) ** 2 + (GY - y) ** 2) / rng.uniform(0.015, 0.025) ** 2)
            )
    edge = np.maximum(np.abs(GX), np.abs(GY))
    z = np.minimum(z, 0.0) * np.clip((0.078 - edge) / 0.02, 0, 1)
    mesh = grid_mesh(X, X, z)
    with tempfile.TemporaryDirectory() as folder:
        path = write(mesh, Path(folder) / "part.stl")
        made = _plan_unless_too_narrow(path)
    if made is None or made.tree is None:
        return
    tree = made.tree
    for loop in tree.loops:
        ring = shapely.Polygon(loop.points)
        assert ring.is_valid
        assert ring.exterior.is_ccw != loop.island
        _check_spacing(loop.points)
        if loop.parent >= 0:
            above = shapely.Polygon(tree.loops[loop.parent].points)
            inner, outer = (above, ring) if loop.island else (ring, above)
            assert outer.buffer(60e-6).contains(inner)
    assert sorted(k for feature in tree.features for k in feature.loops) == list(range(len(tree.loops)))
    depth = -float(z.min())
    levels = -STEP * np.arange(1, int(depth / STEP - 0.05) + 1)
    for level, sections in zip(levels, slice_mesh(mesh, levels), strict=True):
        tips = [loop for loop in tree.loops if not loop.island and abs(loop.level - level) < 1e-9]
        for section in sections:
            shape = shapely.Polygon(section.points)
            held = any(shape.contains(shapely.Point(tip.points[0])) for tip in tips)
            # a shallow rest below the level has its loop at its own bottom, or is told
            lowest = z[shapely.contains_xy(shape, GX, GY)].min(initial=0.0)
            assert section.area < 0 or held or level - lowest < 0.1e-3 or made.warnings


def _check_spacing(points: Array) -> None:
    """Points (N, 2) m at equal distances; two loops that meet turn sharply, and there points are settled sideways."""
    way = np.roll(points, -1, axis=0) - points
    chord = np.linalg.norm(way, axis=1)
    uneven = np.abs(chord / chord.mean() - 1)
    before = np.roll(way, 1, axis=0)
    turn = np.abs(np.arctan2(before[:, 0] * way[:, 1] - before[:, 1] * way[:, 0], np.sum(before * way, axis=1)))
    sharp = np.maximum(turn, np.roll(turn, -1)) > np.radians(30)
    assert uneven.max() < 0.15
    assert uneven[~sharp].max() < 0.03


def _plan_unless_too_narrow(path: Path) -> Plan | None:
    """The plan; None for the only reason to refuse such a part: a valley into which the ball does not get."""
    try:
        return plan(job_for(path, depth=f"{STEP * 1e3} mm", process="SPIF", spacing="1 mm", limit="85 deg"))
    except IsfError as error:
        if error.code is ErrorCode.PART_TOO_SMALL_FOR_TOOL:
            return None
        raise
