"""What ``isf plan`` tells of every contour, and the depth step that it advises for a wanted surface."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from isf_cell.commands.plan_contours import (
    WantedMarks,
    contour_table,
    marks_numbers,
    ridge_warning,
    spindle_numbers,
    texts,
    wanted_marks,
    write_rows,
)
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner import Plan, plan
from isf_planner.part_library import PARTS, part_mesh
from trimesh import Trimesh

JOB = """
name: cone
part: {mesh: cone.stl, unit: mm}
process: SPIF
rig: lu2016
sheet: {material: AA7075-O, thickness: 1.6 mm}
tool_1: {radius: 15 mm}
path: {incremental_depth: STEP, point_spacing: 1 mm, feed: 4000 mm/min, floor_step: none, spindle: rolling}
springback: {method: none}
"""


def job_of(folder: Path, angle: float, step: str) -> JobFile:
    """Cone of Lu 2016, 4.1, with fillets that the tool of 30 mm fills."""
    made = PARTS["cone"](radius=70e-3, angle=angle, depth=25e-3, entry=2e-3, floor=16e-3)
    mesh = part_mesh(made, 3e-6)
    Trimesh(1e3 * mesh.vertices, mesh.faces, process=False).export(folder / "cone.stl")
    return JobFile(JOB.replace("STEP", step), folder)


@pytest.fixture(scope="module")
def job_file(tmp_path_factory: pytest.TempPathFactory) -> JobFile:
    return job_of(tmp_path_factory.mktemp("fifty"), 0.8726646, "1.1 mm")


@pytest.fixture(scope="module")
def made(job_file: JobFile) -> Plan:
    return plan(job_file)


def test_the_published_spacing_stands_in_the_table(made: Plan, job_file: JobFile, tmp_path: Path) -> None:
    """50 deg in steps of 1.1 mm: 1.436 mm (Lu 2016, 4.1.2); f / (2 pi R sin a) at 4000 mm/min and 15 mm: 55.4 rpm."""
    table = contour_table(made, job_file)
    path = write_rows(table.rows, tmp_path / "by_contour.csv")
    with path.open(encoding="ascii", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["contour"]) for row in rows] == list(range(1, len(made.contours) + 1))
    assert rows[0]["mark_spacing_mm"] == rows[0]["scallop_um"] == rows[0]["step_mm"] == ""
    on_wall = [row for row in rows[1:] if float(row["wall_angle_min_deg"]) > 49.8]
    assert len(on_wall) > 10
    for row in on_wall[1:]:
        step = float(row["step_mm"])  # 1.1 mm, shortened so that the last contour is at the full depth
        assert step == pytest.approx(1.1, rel=0.05)
        assert float(row["mark_spacing_mm"]) == pytest.approx(1.436 * step / 1.1, rel=0.01)
        assert float(row["scallop_um"]) == pytest.approx(17.2 * (step / 1.1) ** 2, rel=0.02)
        assert float(row["spindle_rpm"]) == pytest.approx(55.4, rel=0.005)
        assert float(row["spindle_slip"]) < 0.01
    found = spindle_numbers(made)
    assert found is not None
    assert found["rpm"] == pytest.approx([float(row["spindle_rpm"]) for row in rows], rel=1e-4)


def test_the_step_for_a_wanted_surface_and_what_it_costs(made: Plan, job_file: JobFile) -> None:
    """Half of the spacing: half of the step, twice the time, 0.5^0.18 of the force."""
    table = contour_table(made, job_file)
    plain = marks_numbers(table, made, job_file, WantedMarks())
    assert plain is not None
    assert plain["wanted"] is None
    asked = WantedMarks(spacing=0.5e-3 * plain["spacing_mm"])
    marks = marks_numbers(table, made, job_file, asked)
    assert marks is not None
    wanted = marks["wanted"]
    assert wanted["incremental_depth_mm"] == pytest.approx(0.5 * wanted["now_mm"], rel=0.02)
    assert wanted["time_s"] == pytest.approx(2.0 * wanted["time_now_s"], rel=0.02)
    assert wanted["force_N"] == pytest.approx(0.8827 * wanted["force_now_N"], rel=0.01)
    assert not wanted["near_limit"]  # 50 of 65 deg
    said = " ".join(texts(marks, spindle_numbers(made), job_file))
    assert "for marks" in said
    assert "incremental_depth" in said
    assert "more accurate and smoother, and takes longer" in said
    assert "spindle: 55" in said


def test_a_ridge_above_the_tolerance_is_warned_of(made: Plan, job_file: JobFile) -> None:
    """Ridges on this wall are 17 um high (1.436 mm apart, ball of 15 mm), and nowhere is one of 0.3 mm."""
    surface = contour_table(made, job_file).surface
    assert ridge_warning(surface, made, job_file) == ()
    strict = JobFile(job_file.text + "tolerance: {shape: 12 um}\n", job_file.base)
    (told,) = ridge_warning(surface, made, strict)
    assert surface is not None
    assert told.startswith(f"contour {surface.contour + 1} at x = ")
    assert f"a ridge of {1e3 * surface.ridge:.2f} mm" in told
    assert "path.spacing: scallop, or a smaller path.incremental_depth" in told
    options = "{spacing: scallop, scallop_height: 5 um, incremental_depth"
    scallop = JobFile(strict.text.replace("{incremental_depth", options), job_file.base)
    (told,) = ridge_warning(surface, made, scallop)
    assert "path.spacing" not in told
    assert "path.smallest_step" in told
    assert ridge_warning(None, made, strict) == ()


def test_near_the_limit_a_finer_step_is_warned_of(tmp_path: Path) -> None:
    """60 deg of AA7075-O: 0.5 mm and less tore, 0.7 mm did not (Lu 2016, 4.1.3)."""
    steep = job_of(tmp_path, 1.0471976, "1 mm")
    result = plan(steep)
    table = contour_table(result, steep)
    for asked, warned in ((WantedMarks(spacing=0.5e-3), True), (WantedMarks(spacing=3e-3), False)):
        marks = marks_numbers(table, result, steep, asked)
        assert marks is not None
        assert marks["wanted"]["near_limit"] is warned
        said = " ".join(texts(marks, None, steep))
        assert ("bore 0.7 mm and more" in said) is warned


def test_what_no_step_leaves_is_told(made: Plan, job_file: JobFile) -> None:
    table = contour_table(made, job_file)
    marks = marks_numbers(table, made, job_file, WantedMarks(ridge=1e-10))
    assert "that is not the tool for this surface" in " ".join(texts(marks, None, job_file))
    for wanted in (WantedMarks(ridge=15e-3), WantedMarks(spacing=31e-3)):
        with pytest.raises(IsfError, match="more than passes of a ball of 15 mm leave") as caught:
            marks_numbers(table, made, job_file, wanted)
        assert caught.value.code == ErrorCode.FILE_FIELD


@pytest.mark.parametrize("text", ["5", "5 N", "nan mm", "", "0 um", "-1 um", "1e400 mm"])
def test_a_wish_that_is_no_length_is_refused(text: str) -> None:
    with pytest.raises(IsfError) as caught:
        wanted_marks(text, None)
    assert caught.value.code in (ErrorCode.FILE_UNIT, ErrorCode.FILE_FIELD)
    assert caught.value.where == "--scallop"


def test_no_wish_is_none() -> None:
    assert not wanted_marks(None, None).any
    assert wanted_marks("5 um", "0.5 mm") == WantedMarks(pytest.approx(5e-6), pytest.approx(0.5e-3))
