"""Plans that differ have different names, whatever makes them differ; the same plan has the same one."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from isf_core.files.job import JobFile, load_job
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


def changed(job_file: JobFile, file: str, old: str, new: str) -> JobFile:
    """The job with one text of ``file`` beside it changed, which stands in it once."""
    path = job_file.base / file
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    return JobFile(job_file.text, job_file.base)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("ren2018.yaml", "size: [250 mm, 250 mm]", "size: [250 mm, 240 mm]"),
        ("ren2018.yaml", "edge: free", "height: 30 mm"),
        ("ren2018.yaml", "travel: [125 mm,", "travel: [120 mm,"),
        ("AA5754-O.yaml", "tensile_strength: 215", "tensile_strength: 220"),
        ("AA5754-O.yaml", "young_modulus: 70 GPa", "young_modulus: 71 GPa"),
        ("AA5754-O.yaml", "max_wall_angle: 66 deg", "max_wall_angle: 65 deg"),
    ],
)
def test_what_planning_reads_of_rig_and_material_is_another_plan(file: str, old: str, new: str, job: JobFile) -> None:
    before = plan_id(job)
    assert plan_id(changed(job, file, old, new)) != before
    assert plan_id(changed(job, file, new, old)) == before


OF_THE_MACHINE = [
    ("ren2018.yaml", "resolution: 1 N", "resolution: 2 N\n  drift: 3 N\n  tip_distance: 90 mm"),
    ("ren2018.yaml", "noise_ratio: 0.01", "noise_ratio: 0.03"),
    ("ren2018.yaml", "crosstalk: 0.01", "crosstalk: 0.02"),
    ("ren2018.yaml", "bandwidth: 30 Hz", "bandwidth: 25 Hz"),
    ("ren2018.yaml", "tool_1:\n  compliance: [1.0", "tool_1:\n  weight: 22 N\n  compliance: [1.3"),
    ("ren2018.yaml", "contact_stiffness: 0.45", "contact_stiffness: 0.40"),
    ("ren2018.yaml", "force: [1500 N, 1500 N, 2000 N]\n  offset: 1.5", "force: [900 N, 900 N, 999 N]\n  offset: 1.2"),
    ("ren2018.yaml", "park_height: 100 mm", "park_height: 90 mm"),
    ("ren2018.yaml", "edge: free", "edge: fixed"),
    ("AA5754-O.yaml", "friction: 0.08", "friction: 0.1"),
    ("AA5754-O.yaml", "fracture_strain: 1.342", "fracture_strain: 1.2"),
]


@pytest.mark.parametrize(("file", "old", "new"), OF_THE_MACHINE)
def test_what_no_contour_follows_from_is_the_same_plan(file: str, old: str, new: str, job: JobFile) -> None:
    before = plan_id(job)
    assert plan_id(changed(job, file, old, new)) == before


def test_no_contour_follows_from_it(job: JobFile) -> None:
    before = plan(job)
    for file, old, new in OF_THE_MACHINE:
        job = changed(job, file, old, new)
    for one, other in zip(before.contours, plan(job).contours, strict=True):
        for name in vars(one):
            np.testing.assert_array_equal(getattr(other, name), getattr(one, name), err_msg=name)


@pytest.mark.parametrize(
    "change", [("contact_stiffness: 0.45", "contact_stiffness: 0.40"), ("offset: 1.5", "offset: 1.2")]
)
def test_support_forces_that_are_left_open_follow_from_the_rig(change: tuple[str, str], job: JobFile) -> None:
    job = JobFile(job.text.replace("support_force: 120 N", "support_force: auto"), job.base)
    before = plan_id(job)
    assert plan_id(changed(job, "ren2018.yaml", *change)) != before


def test_gaps_of_adsif_follow_from_the_compliance(tmp_path: Path) -> None:
    copied(tmp_path, SHARE / "rigs" / "ren2018.yaml")
    text = (EXAMPLES / "jobs" / "adsif_cone.yaml").read_text().replace("../parts", str(EXAMPLES / "parts"))
    job_file = JobFile(text.replace("rig: ren2018", "rig: ren2018.yaml"), tmp_path)
    before = plan_id(job_file)
    assert (
        plan_id(changed(job_file, "ren2018.yaml", "tool_2:\n  compliance: [1.0", "tool_2:\n  compliance: [1.2"))
        != before
    )


@pytest.mark.parametrize(
    ("name", "rig", "old", "new", "same"),
    [
        ("robot_cone", "kr210_arm", "base: [-1700 mm", "base: [-1800 mm", False),
        ("robot_cone", "kr210_arm", "speed: 123 deg/s", "speed: 100 deg/s", False),
        ("robot_cone", "kr210_arm", "stiffness: 1.5 MN", "stiffness: 2.5 MN", True),
        ("robot_cone", "kr210_arm", "base: [-1700 mm", "natural_frequency: 20 Hz\n    base: [-1700 mm", True),
        ("torrao_cone_45", "torrao2013", "flow: 12 l/min", "flow: 11 l/min", False),
        ("torrao_cone_45", "torrao2013", "controller: feedforward", "controller: fuzzy", True),
        ("torrao_cone_45", "torrao2013", "legs:", "legs:\n  faults: [{kind: pump_stop, after: 9 s}]", True),
    ],
)
def test_arms_and_legs(name: str, rig: str, old: str, new: str, same: bool, tmp_path: Path) -> None:
    """Where they stand and what the checks refuse by, not how they give way and are moved."""
    copied(tmp_path, SHARE / "rigs" / f"{rig}.yaml")
    text = (EXAMPLES / "jobs" / f"{name}.yaml").read_text().replace("../parts", str(EXAMPLES / "parts"))
    job_file = JobFile(text.replace(f"rig: {rig}", f"rig: {rig}.yaml"), tmp_path)
    before = plan_id(job_file)
    copied(tmp_path, SHARE / "rigs" / f"{rig}.yaml", old, new)
    assert (again(job_file) == before) is same


def test_a_copy_of_the_folder_has_the_same_name(tmp_path: Path) -> None:
    """With a map of the machine's error and a material that a blank names, whose paths become absolute."""
    cell = tmp_path / "cell"
    (cell / "own").mkdir(parents=True)
    write(Cone().mesh(50e-6), cell / "cone.ply")
    copied(cell, SHARE / "rigs" / "praveen2020.yaml")
    copied(cell, SHARE / "rigs" / "praveen2020_error.csv")
    copied(cell / "own", SHARE / "materials" / "AA5754-O.yaml")
    blank = "name: blank\nmaterial: AA5754-O.yaml\nthickness: 1 mm\nsize: [900 mm, 900 mm]\nprovenance: {%s}\n"
    constants = ("material", "thickness", "size")
    (cell / "own" / "blank.yaml").write_text(blank % ", ".join(f"{name}: assumed" for name in constants))
    made = job_for(cell / "cone.ply", rig="praveen2020.yaml")
    (cell / "job.yaml").write_text(made.text.replace(SHEET, "sheet: own/blank.yaml"))
    shutil.copytree(cell, tmp_path / "moved")
    first, other = (load_job(folder / "job.yaml") for folder in (cell, tmp_path / "moved"))
    assert first.rig.tool_1.error_map != other.rig.tool_1.error_map
    assert str(cell) in first.text
    assert plan_id(first) == plan_id(other)


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
