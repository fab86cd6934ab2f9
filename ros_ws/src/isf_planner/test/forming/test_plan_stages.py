"""Multi-stage plans: preforms with flatter walls before the part itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_planner import plan
from isf_planner.forming import stages
from isf_planner.part.meshes import Mesh
from isf_planner.part_library import PARTS, part_mesh
from isf_planner.part_library.part import Feature, Part, RoundedSquare
from isf_planner.part_library.wall_profile import straight_wall
from isf_planner.surface import height_grid, surface_kernels
from planner_parts import grid_mesh, job_for, told, write
from scipy import ndimage

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


def staged(mesh: Mesh, folder: Path, options: str, **changes: str) -> JobFile:
    """Job of ``mesh`` in SPIF, one contour per mm of depth, with more ``options`` of its path."""
    job_file = job_for(write(mesh, folder / "part.ply"), **{"process": "SPIF", "depth": "1 mm", **changes})
    return JobFile(job_file.text.replace("incremental_depth", f"{options}, incremental_depth", 1), job_file.base)


def test_a_preform_whose_walls_meet_is_formed_as_deep_as_the_tool_goes(tmp_path: Path) -> None:
    """A cone of 70 deg before which one of 40 deg ends in a point at -21.5 mm: a ball of 5 mm stops at -20.2 mm."""
    mesh = part_mesh(PARTS["cone"](radius=24e-3, angle=np.radians(70), depth=25e-3), 20e-6)
    made = plan(staged(mesh, tmp_path, "stages: [40 deg]"))
    lowest = [min(c.forming_tip[:, 2].min() for c in made.contours if c.stage == stage) for stage in (0, 1)]
    assert -20.3e-3 < lowest[0] < -19.9e-3
    assert lowest[1] == pytest.approx(-25e-3, abs=1e-6)


def test_every_pocket_of_a_preform_ends_where_the_tool_does(tmp_path: Path) -> None:
    """Two grooves of unlike width, 8 mm deep; walls of 30 deg meet in the narrow one, and not in the wide one."""
    x, y = np.linspace(-60e-3, 60e-3, 241), np.linspace(-40e-3, 40e-3, 161)
    gx, gy = np.meshgrid(x, y)
    narrow, wide = (
        np.minimum(half - np.abs(gx - at), 30e-3 - np.abs(gy)) for at, half in ((-34e-3, 13e-3), (20e-3, 30e-3))
    )
    z = -np.clip(np.tan(np.radians(55)) * np.maximum(narrow, wide), 0.0, 8e-3)
    made = plan(staged(grid_mesh(x, y, z), tmp_path, "stages: [30 deg]"))
    first = [contour for contour in made.contours if contour.stage == 0]
    left = min(c.forming_tip[:, 2].min() for c in first if c.forming_tip[:, 0].mean() < 0.0)
    right = min(c.forming_tip[:, 2].min() for c in first if c.forming_tip[:, 0].mean() > 0.0)
    # the narrow one would be 7.5 mm deep with a sharp groove; R (1 / cos 30 - 1) of it are not reached
    assert -6.75e-3 < left < -6.0e-3
    assert right == pytest.approx(-8e-3, abs=1e-6)


def test_facets_in_the_corners_of_a_preform_are_no_walls_that_are_too_steep(tmp_path: Path) -> None:
    """A facet of the preform there spans both directions of the grid: it is 64 deg steep, the preform 55."""
    wall = straight_wall(np.radians(60), 20e-3, 3e-3, 6e-3)
    mesh = part_mesh(Part("pyramid", (Feature(RoundedSquare(30e-3, 4e-3), wall),), 8e-3), 20e-6)
    made = plan(staged(mesh, tmp_path, "stages: [55 deg]", limit="61 deg"))
    assert {contour.stage for contour in made.contours} == {0, 1}


def test_an_error_of_a_preform_names_its_stage(tmp_path: Path) -> None:
    """The first one is 2 mm deep, less than one step: in it contours of points 4.9 mm apart are too short."""
    mesh = part_mesh(PARTS["cone"](radius=20e-3, angle=np.radians(60), depth=9e-3), 20e-6)
    with pytest.raises(IsfError) as caught:
        plan(staged(mesh, tmp_path, "stages: [5 deg, 40 deg]", depth="3 mm", spacing="4.9 mm"))
    assert caught.value.what.startswith("stage 1 of 3, a shape before the part: no contour of")
    assert caught.value.advice.startswith("change path.stages, or reduce path.point_spacing")


@pytest.mark.parametrize(
    ("angles", "left", "count"), [("[50 deg, 60 deg]", "50, 60", 0), ("[35 deg, 50 deg]", "50", 1)]
)
def test_stages_no_flatter_than_the_part_are_left_out_and_told_of(
    angles: str, left: str, count: int, tmp_path: Path
) -> None:
    mesh = part_mesh(PARTS["cone"](radius=24e-3, angle=np.radians(45), depth=9e-3), 20e-6)
    made = plan(staged(mesh, tmp_path, f"stages: {angles}"))
    assert {contour.stage for contour in made.contours} == set(range(count + 1))
    assert len(made.stages) == (count + 1 if count else 0)
    (text,) = [text for text in told(made) if text.startswith("path.stages")]
    assert text.startswith("path.stages: the part is no steeper than 50 deg; ")
    assert f"walls of {left} deg would form the part itself and are left out" in text


def test_a_warning_counts_the_finishing_passes_among_the_stages(tmp_path: Path) -> None:
    made = plan(staged(MESH, tmp_path, "stages: [20 deg], finishing_passes: 1"))
    assert len(made.stages) == 3
    (text,) = [text for text in made.warnings if text.startswith("the sheet may fold over")]
    assert ": stage 2 of 3 leaves" in text


def test_planning_can_be_cancelled_before_every_preform(tmp_path: Path) -> None:
    told_of: list[float] = []
    plan(
        staged(MESH, tmp_path, "stages: [30 deg, 45 deg, 50 deg]", depth="3 mm"),
        progress=lambda phase, share: told_of.append(share) if phase == "shapes before the part" else None,
    )
    # of the tenth of the plan between the part and the loops of its preforms
    assert told_of == pytest.approx([0.4, 0.4 + 0.1 / 3, 0.4 + 0.2 / 3])


def hung_from_all(z: Array, fall: float) -> Array:
    """The cones of all nodes, one after the other."""
    rows, columns = np.indices(z.shape)
    out = z.copy()
    for row, column in np.ndindex(z.shape):
        out = np.maximum(out, z[row, column] - fall * np.hypot(rows - row, columns - column))
    return out


@pytest.mark.parametrize("seed", range(12))
def test_a_preform_is_the_highest_of_the_cones_of_all_nodes(seed: int) -> None:
    """Hills as rough as noise and as smooth as a dome, some cut off level, and cones that fall little or much."""
    random = np.random.default_rng(seed)
    z = ndimage.gaussian_filter(random.normal(size=(31, 40)), seed % 6)
    if seed % 3 == 0:
        z = np.minimum(z, np.quantile(z, 0.7))
    fall = float(np.quantile(np.hypot(*np.gradient(z)), (0.2, 0.5, 0.8, 0.95)[seed % 4]))
    np.testing.assert_allclose(surface_kernels.hung(z, fall), hung_from_all(z, fall), rtol=0.0, atol=1e-12)
