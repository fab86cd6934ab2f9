"""Multi-stage plans: preforms with flatter walls before the part itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_planner import plan
from isf_planner.forming import stages
from isf_planner.part_library import PARTS, part_mesh
from isf_planner.surface import height_grid
from planner_parts import job_for, write

CONE = PARTS["cone"](radius=24e-3, angle=np.radians(60), depth=9e-3)
MESH = part_mesh(CONE, 20e-6)
HEIGHTS = height_grid.sample(MESH, 0.5e-3, 0.0)


def heights(angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Preform of the cone: distance from the axis and height of its nodes, m."""
    vertices = stages.preform(HEIGHTS, angle, 5e-3).points()
    return np.hypot(vertices[:, 0], vertices[:, 1]), vertices[:, 2]


@pytest.mark.parametrize("degrees", [30.0, 45.0])
def test_a_preform_is_nowhere_steeper_keeps_the_opening_and_never_undercuts_the_part(degrees: float) -> None:
    mesh = height_grid.as_mesh(stages.preform(HEIGHTS, np.radians(degrees), 5e-3))
    corners = mesh.corners()
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slope = np.degrees(np.arctan2(np.hypot(normal[:, 0], normal[:, 1]), normal[:, 2]))
    # the limit holds along the grid; a facet that spans both directions of it may be steeper by a little
    assert slope.max() < degrees + 3.0
    vertices = mesh.vertices
    assert (vertices[:, 2] >= CONE.height(vertices[:, :2]) - 40e-6).all()
    outside = np.hypot(vertices[:, 0], vertices[:, 1]) > 30e-3
    assert np.abs(vertices[outside, 2]).max() < 1e-9


def test_a_preform_is_the_cone_of_its_angle_where_it_does_not_touch_the_floor() -> None:
    radius, z = heights(np.radians(30))
    wall = (radius > 12e-3) & (radius < 18e-3)
    level = z + np.tan(np.radians(30)) * (24e-3 - radius)
    # straight lines of 30 deg from one tangent point at the rim
    assert np.ptp(level[wall]) < 60e-6


def test_stages_come_in_order_and_the_last_is_the_part(tmp_path: Path) -> None:
    path = write(MESH, tmp_path / "cone.ply")
    job_file = job_for(path, depth="1 mm", force="0 N", limit="80 deg")
    single = plan(job_file).contours
    text = job_file.text.replace("incremental_depth", "stages: [35 deg, 50 deg], incremental_depth", 1)
    staged = plan(type(job_file)(text, job_file.base)).contours
    assert [contour.index for contour in staged] == list(range(len(staged)))
    assert {contour.count for contour in staged} == {len(staged)}
    stage = np.array([contour.stage for contour in staged])
    assert (np.diff(stage) >= 0).all()
    assert set(stage) == {0, 1, 2}
    for number, limit in ((0, 35.0), (1, 50.0)):
        angles = np.degrees(np.concatenate([c.wall_angle for c in staged if c.stage == number]))
        assert np.percentile(angles, 95) == pytest.approx(limit, abs=1.0)
        # facets in the sharp foot of a preform span two directions of its steepest descent
        assert angles.max() < limit + 8.0
    last = [contour for contour in staged if contour.stage == 2]
    assert len(last) == len(single)
    for mine, other in zip(last, single, strict=True):
        np.testing.assert_allclose(mine.forming_tip, other.forming_tip, atol=1e-9)
    lifted = [contour.index for contour in staged if contour.retract]
    assert lifted == [int(np.argmax(stage == 1)), int(np.argmax(stage == 2))]


@pytest.mark.parametrize("angles", ["[50 deg, 40 deg]", "[95 deg]"])
def test_stages_that_do_not_ascend_are_refused(angles: str, tmp_path: Path) -> None:
    job_file = job_for(write(MESH, tmp_path / "cone.ply"))
    text = job_file.text.replace("incremental_depth", f"stages: {angles}, incremental_depth", 1)
    with pytest.raises(IsfError) as caught:
        type(job_file)(text, job_file.base)
    assert caught.value.code is ErrorCode.FILE_FIELD
    assert "ascending" in str(caught.value)


def test_a_stage_that_forms_nothing_is_refused() -> None:
    with pytest.raises(IsfError) as caught:
        stages.preform(HEIGHTS, np.radians(0.5), 5e-3)
    assert caught.value.code is ErrorCode.PART_TOO_SMALL_FOR_TOOL
