"""Backing plate and die as one rigid surface: geometry, and jobs whose tooling does not fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.tooling import BackingPlateSpec
from isf_sim.sheet.support_surface import die_heights, support_of
from isf_sim.sheet.surface import flat_surface

JOB = """
name: support-test
part: {mesh: none.stl, unit: mm}
process: TPIF
rig: lu2016
sheet: {material: AA7075-O, thickness: 1.6 mm}
tool_1: {radius: 10 mm}
path: {incremental_depth: 1 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
"""
DIE = "die: {mesh: die.stl, unit: mm}\n"
GRID = np.linspace(-0.1, 0.1, 401)


def at(heights: np.ndarray, x: float, y: float) -> float:
    return float(heights[round((y + 0.1) / 0.5e-3), round((x + 0.1) / 0.5e-3)])


def test_round_opening_with_a_rounded_edge() -> None:
    plate = BackingPlateSpec(shape="circle", size=(0.1, 0.1), edge_radius=4e-3)
    heights = plate.height(*np.meshgrid(GRID, GRID))
    assert at(heights, 0.045, 0.0) == -np.inf
    assert at(heights, 0.0505, 0.0) == pytest.approx(np.sqrt(16 - 3.5**2) * 1e-3 - 4e-3)
    assert at(heights, 0.0, 0.052) == pytest.approx(np.sqrt(12.0) * 1e-3 - 4e-3)
    assert at(heights, -0.06, 0.02) == 0.0


def test_rectangular_opening_with_round_corners() -> None:
    """Area of the opening: a b - (4 - pi) r^2, to the grid's 0.5 mm."""
    plate = BackingPlateSpec(shape="rectangle", size=(0.12, 0.08), corner_radius=0.02, edge_radius=0.0)
    heights = plate.height(*np.meshgrid(GRID, GRID))
    area = np.isinf(heights).sum() * 0.5e-3**2
    assert area == pytest.approx(0.12 * 0.08 - (4 - np.pi) * 0.02**2, rel=0.02)
    assert at(heights, 0.058, 0.038) == 0.0
    assert at(heights, 0.058, 0.0) == -np.inf


def test_die_is_the_highest_face_over_every_node() -> None:
    """A frustum from 30 to 10 mm radius, 20 mm high: the slope of 45 deg and the flat top."""
    mesh = trimesh.creation.revolve(np.array([[0, -0.05], [0.03, -0.05], [0.03, -0.03], [0.01, -0.01], [0, -0.01]]))
    heights = die_heights(np.asarray(mesh.vertices), np.asarray(mesh.faces), GRID, GRID)
    assert at(heights, 0.0, 0.0) == pytest.approx(-0.01)
    assert at(heights, 0.02, 0.0) == pytest.approx(-0.02, abs=0.2e-3)  # 32 facets round the axis
    assert at(heights, 0.0, 0.04) == -np.inf


def job_with(folder: Path, top: float, more: str = "") -> JobFile:
    mesh = trimesh.creation.cylinder(radius=20.0, height=10.0)
    mesh.apply_translation([0.0, 0.0, top - 5.0])
    mesh.export(folder / "die.stl")
    return JobFile(JOB + DIE + more, folder)


def test_plate_and_die_stand_below_the_lower_face(tmp_path: Path) -> None:
    more = "backing_plate: {shape: circle, size: [160 mm, 160 mm]}\n"
    surface = flat_surface((0.26, 0.26), 1e-3)
    heights = support_of(job_with(tmp_path, -1.6, more), surface, 1.6e-3)
    assert heights is not None
    middle = heights.shape[0] // 2
    assert heights[middle, middle] == pytest.approx(-1.6e-3)
    assert heights[0, 0] == pytest.approx(-1.6e-3)
    assert heights[middle, middle + 50] == -np.inf
    spif = JOB.replace("TPIF", "SPIF")
    assert support_of(JobFile(spif, tmp_path), surface, 1.6e-3) is None


@pytest.mark.parametrize("top", [-0.3, 5.0])
def test_a_die_that_stands_through_the_blank_does_not_fit(top: float, tmp_path: Path) -> None:
    with pytest.raises(IsfError) as error:
        support_of(job_with(tmp_path, top), flat_surface((0.26, 0.26), 1e-3), 1.6e-3)
    assert error.value.code == ErrorCode.BLANK_DOES_NOT_FIT


def test_openings_and_dies_that_are_none_are_refused(tmp_path: Path) -> None:
    surface = flat_surface((0.26, 0.26), 1e-3)
    with pytest.raises(IsfError) as error:
        support_of(JobFile(JOB + DIE, tmp_path), surface, 1.6e-3)
    assert error.value.code == ErrorCode.FILE_NOT_FOUND
    (tmp_path / "die.stl").write_text("nothing")
    with pytest.raises(IsfError) as error:
        support_of(JobFile(JOB + DIE, tmp_path), surface, 1.6e-3)
    assert error.value.code in (ErrorCode.MESH_UNREADABLE, ErrorCode.MESH_EMPTY)
    wide = JOB.replace("TPIF", "SPIF") + "backing_plate: {shape: circle, size: [300 mm, 300 mm]}\n"
    with pytest.raises(IsfError) as error:
        support_of(JobFile(wide, tmp_path), surface, 1.6e-3)
    assert error.value.code == ErrorCode.BLANK_DOES_NOT_FIT
    aside = job_with(tmp_path, -1.6)
    trimesh.creation.box((10, 10, 1), transform=np.diag([1.0, 1, 1, 1])).apply_translation([500, 0, -5]).export(
        tmp_path / "die.stl"
    )
    with pytest.raises(IsfError) as error:
        support_of(aside, surface, 1.6e-3)
    assert error.value.code == ErrorCode.BLANK_DOES_NOT_FIT
