"""A wall that the planner was allowed to make and the sheet does not bear: torn, told with the place, not complete."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import forked_process
import isf_core
import numpy as np
import pytest
from isf_analysis.measures.record import PartRecord
from isf_cell.commands.exit_codes import Exit
from isf_cell.in_process import form
from isf_cell.options import RunOptions
from isf_core.errors import ErrorCode
from isf_core.events import Event, EventKind
from isf_core.files.job import JobFile, load_job
from isf_core.files.material import load_material
from planner_parts import Cone, write

JOB = """
name: steep
part: {{mesh: steep.stl, unit: mm}}
process: SPIF
rig: {rig}
sheet: {{material: {material}, thickness: 1 mm}}
tool_1: {{radius: 5 mm}}
backing_plate: {{shape: circle, size: [{plate} mm, {plate} mm]}}
wall_angle_limit: 85 deg
path: {{incremental_depth: {step} mm, point_spacing: 1 mm, feed: 60 mm/s}}
control: {{rate: 100 Hz}}
springback: {{method: none}}
"""


def steep_job(
    folder: Path, degrees: float = 72.0, material: str = "AA5754-O", depth: float = 14e-3, step: float = 1.0
) -> Path:
    """A cone of ``degrees``, 14 mm deep, over a backing plate in the small clamp; contours ``step`` mm apart."""
    cone = Cone(opening=22e-3, angle=math.radians(degrees), depth=depth, entry=3e-3, floor=6e-3)
    write(cone.mesh(20e-6), folder / "steep.stl")
    rig = Path(__file__).resolve().parents[2] / "examples" / "rigs" / "clamp_120.yaml"
    path = folder / "steep.yaml"
    plate = math.ceil(2e3 * cone.opening + 8.0)
    path.write_text(JOB.format(rig=rig, material=material, plate=plate, step=step), encoding="utf-8")
    return path


def brittle(folder: Path) -> str:
    """Material file of a soft sheet that bears a strain of 0.5."""
    text = (Path(isf_core.__file__).parents[1] / "materials" / "AA1050.yaml").read_text(encoding="utf-8")
    path = folder / "brittle.yaml"
    path.write_text(text.replace("fracture_strain: 1.545", "fracture_strain: 0.5"), encoding="utf-8")
    assert load_material(str(path)).fracture_strain == 0.5
    return str(path)


def torn_at(record: PartRecord) -> Event:
    """The event of a torn part, which is not complete and ended after a contour."""
    (torn,) = (event for event in record.events if event.kind is EventKind.FRACTURE)
    failure = record.failure()
    assert failure is not None
    assert failure[0] == ErrorCode.SHEET_TORN
    assert "the sheet tears at (" in failure[1]
    assert record.formed < record.planned
    assert all(result.completed for result in record.results)
    return torn


def test_permission_is_not_strength(tmp_path: Path) -> None:
    """Planned with a limit of 85 deg, a wall of 72 deg tears where 66 deg is what the material is known for."""
    record = form(load_job(steep_job(tmp_path)), RunOptions(correction="none"))
    torn = torn_at(record)
    assert torn.value > torn.limit == pytest.approx(1.342, abs=1e-3)
    assert 15e-3 < np.hypot(*torn.position[:2]) < 24e-3
    assert -14e-3 < torn.position[2] < -4e-3
    sheet = record.formed_sheet
    assert sheet is not None
    beyond = sheet.points[sheet.strain_margin < 0.0]
    assert np.linalg.norm(beyond - np.array(torn.position), axis=1).min() < 3e-3
    flatter = form(load_job(steep_job(tmp_path, 50.0)), RunOptions(correction="none"))
    assert flatter.failure() is None


@pytest.mark.parametrize(
    ("name", "tears"), [("torrao_cone_45", False), ("torrao_cone_70", True), ("torrao_cone_dps780", False)]
)
def test_published_cones_of_two_sheets(name: str, tears: bool, tmp_path: Path) -> None:
    """Torrao 2013, 7.1: 45 deg was formed in AA1050, 70 deg tore, and a cone was formed in dual-phase steel.

    On a gantry with the clamp of that machine, whose legs take most of the time.
    """
    examples = Path(__file__).resolve().parents[2] / "examples"
    rig = "name: gantry\nbased_on: ren2018\nclamp: {size: [190 mm, 190 mm], edge: fixed}\n"
    rig += "limits: {force: [6500 N, 6500 N, 13000 N]}\nload_cell: {force_range: [22 kN, 22 kN, 22 kN]}\n"
    origins = ("clamp.size", "clamp.edge", "limits.force", "load_cell.force_range")
    rig += "provenance: {" + ", ".join(f"{key}: 'assumed: test'" for key in origins) + "}\n"
    (tmp_path / "gantry.yaml").write_text(rig, encoding="utf-8")
    text = (examples / "jobs" / f"{name}.yaml").read_text(encoding="utf-8")
    text = text.replace("../parts", str(examples / "parts")).replace("rig: torrao2013", "rig: gantry.yaml")
    text = text.replace("feed: 40 mm/s", "feed: 80 mm/s") + "control: {rate: 100 Hz}\n"
    record = form(JobFile(text, tmp_path), RunOptions(correction="none"))
    if not tears:
        assert record.failure() is None
        return
    torn = torn_at(record)
    assert torn.value > torn.limit == pytest.approx(1.545)
    assert -30e-3 < torn.position[2] < -5e-3


def test_the_elasto_plastic_sheet_tears_by_its_own_strains(tmp_path: Path) -> None:
    job = load_job(steep_job(tmp_path, material=brittle(tmp_path), depth=18e-3, step=2.0))
    record = form(job, RunOptions(correction="none", sheet="shell_coarse"))
    torn = torn_at(record)
    assert torn.value > torn.limit == 0.5
    assert 10e-3 < np.hypot(*torn.position[:2]) < 24e-3
    assert -18e-3 < torn.position[2] < -6e-3


def test_the_command_ends_with_the_code_and_the_report_says_why(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "isf_cell.cli", "simulate", str(steep_job(tmp_path)), "--json", "-o", "run"]
    ended = forked_process.run(command, cwd=tmp_path)
    assert ended.returncode == Exit.PROCESS, ended.stderr
    data = json.loads(ended.stdout)
    assert data["complete"] is False
    assert data["torn"] is True
    assert data["error"]["name"] == "SHEET_TORN"
    assert data["failure"]["code"] == 1413
    assert data["verdict"]["good"] is False
    assert any("the sheet tears at (" in text for text in data["verdict"]["short_of"])
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "Part not complete" in page
    assert "1413 SHEET_TORN" in page
    assert "part or record not complete" in ended.stderr


@pytest.mark.graph
def test_the_graph_ends_the_part_too(tmp_path: Path) -> None:
    job = steep_job(tmp_path, material=brittle(tmp_path), step=2.0)
    command = [sys.executable, "-m", "isf_cell.cli", "form", str(job), "--json", "-o", "run"]
    ended = forked_process.run(command, cwd=tmp_path)
    assert ended.returncode == Exit.PROCESS, ended.stderr
    data = json.loads(ended.stdout)
    assert data["complete"] is False
    assert data["error"]["name"] == "SHEET_TORN"
    assert data["contours"] < data["contours_planned"]
