"""Properties of plans of random smooth pockets: star-shaped, tilted, with or without a floor."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner import Plan, plan
from isf_planner.loops.tip_loops import levels
from planner_parts import grid_mesh, job_for, write
from scipy.spatial import KDTree

R = 5e-3


@settings(max_examples=12, deadline=None)
@given(
    radius=st.floats(25e-3, 35e-3),
    lobes=st.integers(2, 5),
    waviness=st.floats(0.0, 0.12),
    turn=st.floats(0.0, 6.28),
    depth=st.floats(4e-3, 12e-3),
    power=st.sampled_from([1.0, 2.0]),
    step=st.floats(0.7e-3, 1.5e-3),
)
def test_loops_are_closed_nested_evenly_spaced_and_complete(
    radius: float, lobes: int, waviness: float, turn: float, depth: float, power: float, step: float
) -> None:
    x = np.linspace(-0.05, 0.05, 101)
    gx, gy = np.meshgrid(x, x)
    border = radius * (1 + waviness * np.cos(lobes * np.arctan2(gy, gx) + turn))
    share = np.clip(np.hypot(gx, gy) / border, 0, 1)
    z = -depth * (0.5 + 0.5 * np.cos(np.pi * share**power))
    with tempfile.TemporaryDirectory() as folder:
        path = write(grid_mesh(x, x, z), Path(folder) / "part.stl")
        job_file = job_for(path, depth=f"{step * 1e3} mm", process="SPIF", spacing="1 mm")
        result = _plan_unless_too_narrow(job_file)
    if result is None:
        return
    expected = levels(-float(z.min()), step)
    tips = [contour.forming_tip for contour in result.contours]
    reported = any("no floor" in warning for warning in result.warnings)
    # nothing is lost: only where the bottom has no floor, and that is told, the last loop is higher or left out
    assert len(tips) == len(expected) or (reported and len(tips) == len(expected) - 1)
    for tip, level in zip(tips[: len(expected) - 1], expected, strict=False):
        np.testing.assert_allclose(tip[:, 2], level, atol=1e-9)
    if len(tips) == len(expected):
        assert tips[-1][0, 2] < expected[-2] - 1e-9
        # 1e-9: single precision of the file
        assert tips[-1][0, 2] == pytest.approx(expected[-1], abs=0.4 * step + 1e-9 if reported else 1e-9)
    vertices = KDTree(np.column_stack([gx.ravel(), gy.ravel(), z.ravel()]))
    previous = None
    for contour in result.contours:
        ring = shapely.Polygon(contour.forming_tip[:, :2])
        assert ring.is_valid  # closed and without self-intersection
        assert ring.exterior.is_ccw
        steps = np.linalg.norm(np.roll(contour.forming_tip, -1, axis=0) - contour.forming_tip, axis=1)
        assert np.abs(steps / steps.mean() - 1).max() < 0.02
        # between points the chord may bulge by spacing^2 / (8 R) = 25 um at a loop of the tool's radius
        assert previous is None or previous.buffer(25e-6).contains(ring)
        previous = ring
        centre = contour.forming_tip + [0, 0, R]
        # the vertices lie on the facets: their distance is a bound from above of the distance to the facets
        assert vertices.query(centre)[0].min() > R - 20e-6


def _plan_unless_too_narrow(job_file: JobFile) -> Plan | None:
    """The plan; None for the only reason to refuse such a part: a valley whose bottom the ball does not reach."""
    try:
        return plan(job_file)
    except IsfError as error:
        if error.code is ErrorCode.PART_TOO_SMALL_FOR_TOOL:
            return None
        raise
