"""Plans that differ have different names, whatever makes them differ; the same plan has the same one."""

from __future__ import annotations

from pathlib import Path

import pytest
from isf_core.files.job import JobFile
from isf_planner import plan
from isf_planner.processes import plan_id
from planner_parts import EXAMPLES, Cone, job_for, write

SHARE = Path(__file__).resolve().parents[2] / "isf_core"
SHEET = "sheet: {material: AA5754-O, thickness: 1.0 mm}"


def copied(folder: Path, source: Path, old: str = "", new: str = "") -> str:
    """Name of a copy of ``source`` in ``folder``, with one text changed."""
    text = source.read_text()
    assert old in text
    (folder / source.name).write_text(text.replace(old, new, 1))
    return source.name


@pytest.fixture
def job(tmp_path: Path) -> JobFile:
    """Rig and material are files beside the job."""
    write(Cone().mesh(50e-6), tmp_path / "cone.ply")
    copied(tmp_path, SHARE / "rigs" / "ren2018.yaml")
    copied(tmp_path, SHARE / "materials" / "AA5754-O.yaml")
    made = job_for(tmp_path / "cone.ply", rig="ren2018.yaml", depth="2 mm")
    return JobFile(made.text.replace("AA5754-O", "AA5754-O.yaml"), tmp_path)


def again(job_file: JobFile) -> str:
    return plan_id(JobFile(job_file.text, job_file.base))


def test_the_same_files_have_the_same_name(job: JobFile) -> None:
    assert plan_id(job) == again(job)
    assert plan_id(job).startswith("part-")
    made = plan(job)
    assert made.plan_id == made.contours[0].plan_id == plan_id(job)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("rigs/ren2018.yaml", "contact_stiffness: ", "contact_stiffness: 1"),
        ("materials/AA5754-O.yaml", "tensile_strength: ", "tensile_strength: 1"),
    ],
)
def test_another_rig_or_material_in_a_file_of_the_same_name(file: str, old: str, new: str, job: JobFile) -> None:
    before = plan_id(job)
    copied(job.base, SHARE / file, old, new)
    assert again(job) != before
    copied(job.base, SHARE / file)
    assert again(job) == before


def test_another_error_map(job: JobFile) -> None:
    text = job.text.replace("path: {", "path: {compensation: [machine], machine_error: map.csv, ")
    (job.base / "map.csv").write_text("x_mm,y_mm,z_mm,error_mm\n1,2,3,0.1\n")
    mapped = JobFile(text, job.base)
    before = plan_id(mapped)
    (job.base / "map.csv").write_text("x_mm,y_mm,z_mm,error_mm\n1,2,3,0.2\n")
    assert again(mapped) != before


@pytest.mark.parametrize(("name", "file"), [("tpif_cone", "die.stl"), ("adsif_cone", "surface.yaml")])
def test_another_die_or_response_surface(name: str, file: str, tmp_path: Path) -> None:
    text = (EXAMPLES / "jobs" / f"{name}.yaml").read_text()
    text = text.replace("../parts/tpif_cone_die.stl", file).replace("../parts", str(EXAMPLES / "parts"))
    text = text.replace("surface: AA5754-O_1mm_R5", f"surface: {file}")
    assert file in text
    content = {
        "die.stl": EXAMPLES / "parts" / "tpif_cone_die.stl",
        "surface.yaml": SHARE / "adsif" / "AA5754-O_1mm_R5.yaml",
    }[file].read_bytes()
    (tmp_path / file).write_bytes(content)
    job_file = JobFile(text, tmp_path)
    before = plan_id(job_file)
    assert again(job_file) == before
    (tmp_path / file).write_bytes(content + b"\n")
    assert again(job_file) != before


def test_force_raised_for_a_sheet_that_is_too_strong_is_the_same_plan(job: JobFile) -> None:
    assert plan_id(job.with_force_raised(1.8)) == plan_id(job)
