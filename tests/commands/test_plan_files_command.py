"""``isf plan`` with exports and views, and ``isf part``, run as a user runs them (docs/methods/plan_outputs.md)."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import forked_process
import pytest
import trimesh
from isf_cell.commands.exit_codes import Exit
from packed_page import text_of

ROOT = Path(__file__).resolve().parents[2]
JOB = ROOT / "examples" / "jobs" / "mini_cone.yaml"


def isf(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "isf_cell.cli", *arguments]
    return forked_process.run(command, cwd=cwd)


def test_plan_is_written_shown_and_converted(tmp_path: Path) -> None:
    done = isf("plan", str(JOB), "--export", "part.npz", "--show", "part.png", "-o", "run", "--json", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    assert json.loads(done.stdout)["files"] == ["part.npz", "part.png"]
    done = isf("plan", "part.npz", "--export", "part.nc", "--export", "part.csv", "--json", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    files = json.loads(done.stdout)["files"]
    assert files[0] == "part.nc"
    assert len(files) == 4
    assert all((tmp_path / file).stat().st_size > 1000 for file in files)
    done = isf("plan", "part.npz", "--export", "part.nc", "--format", "none", cwd=tmp_path)
    assert done.returncode != Exit.OK
    assert "iso_two_channels" in done.stderr + done.stdout


@pytest.mark.parametrize(
    ("process", "options", "said"),
    [
        ("TPIF", ("--export", "c.npz", "--export", "a.nc", "--export", "b.csv"), "no place for the blank holder"),
        ("TPIF", ("--export", "a.stl", "--export", "b.csv"), "no place for the blank holder"),
        ("SPIF", ("--export", "c.npz", "--export", "a.nc", "--per-stage"), "formed in one stage"),
        ("SPIF", ("--export", "c.npz", "--export", "a.xyz"), "not the ending of a known format"),
        ("SPIF", ("--export", "c.npz", "--export", "nowhere/a.nc"), "no such folder"),
    ],
)
def test_an_export_that_cannot_be_is_refused_before_the_plan(
    process: str, options: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    """The part of the job is not even there: it is told after what is wrong with the exports."""
    job = (ROOT / "examples" / "jobs" / "tpif_cone.yaml").read_text(encoding="utf-8")
    if process == "SPIF":
        job = re.sub(r"^die:\n(  .*\n)+", "", job.replace("process: TPIF", "process: SPIF"), flags=re.MULTILINE)
    (tmp_path / "job.yaml").write_text(job, encoding="utf-8")
    done = isf("plan", "job.yaml", *options, "-o", "run", cwd=tmp_path)
    assert done.returncode == Exit.INPUT
    assert said in " ".join(done.stderr.split())
    assert [path.name for path in tmp_path.iterdir()] == ["job.yaml"]
    done = isf("plan", "job.yaml", "--export", "c.npz", "--export", "b.stl", "-o", "run", cwd=tmp_path)
    assert "MESH_UNREADABLE" in done.stderr


def test_nothing_is_written_of_a_plan_file_before_all_exports_can_be(tmp_path: Path) -> None:
    done = isf("plan", str(ROOT / "examples/jobs/tpif_cone.yaml"), "--export", "c.npz", "-o", "run", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    done = isf("plan", "c.npz", "--export", "again.npz", "--export", "b.csv", cwd=tmp_path)
    assert done.returncode == Exit.INPUT
    assert "no place for the blank holder" in done.stderr
    assert not (tmp_path / "again.npz").exists()


def test_features_and_stages_of_a_steep_part(tmp_path: Path) -> None:
    """As in docs/methods/steep_parts.md, with a smaller part."""
    done = isf("part", "cone", "--set", "angle=66 deg", "--set", "depth=12 mm", "-o", "c.stl", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    text = (
        JOB.read_text(encoding="utf-8")
        .replace("../parts/mini_cone.stl", "c.stl")
        .replace("process: DSIF", "process: SPIF")
    )
    lines = [line for line in text.splitlines() if not line.strip().startswith(("support_force", "engage_depth"))]
    text = "\n".join(lines).replace(
        "path:\n", "path:\n  partial_paths: true\n  morph: {failure_angle: 60 deg, shapes: 1}\n"
    )
    (tmp_path / "job.yaml").write_text(text + "\nwall_angle_limit: 70 deg\n", encoding="utf-8")
    shown = ("--show", "features.html", "--colour", "features")
    done = isf("plan", "job.yaml", *shown, "-o", "run", "--json", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    said = " ".join(done.stderr.split())  # two laws of thickness, and which is which
    assert f"thinnest {json.loads(done.stdout)['min_thickness_mm']:.2f} mm (sine law of the final walls" in said
    assert said.count("sheet carried from stage to stage 0.") == 2
    found = json.loads(done.stdout)
    assert found["features"] == {"top": 1, "floor": 1, "ruled_positive": 1, "rim": 1, "rib_bottom": 1}
    assert [set(stage) for stage in found["stages"]] == [
        {
            *("depth_mm", "wall_angle_deg", "gap_over_limit", "gap_at_least"),
            *("thickness_min_mm", "margin", "margin_at_mm"),
        }
    ] * 2
    assert 1.0 > found["stages"][0]["thickness_min_mm"] > found["stages"][1]["thickness_min_mm"] > 0.4
    assert 1.3 > found["stages"][0]["margin"] > found["stages"][1]["margin"] > 0.0
    assert -12.0 <= found["stages"][1]["margin_at_mm"][2] < 0.0
    assert found["stages"][0]["depth_mm"] < found["stages"][1]["depth_mm"] == pytest.approx(12.0, abs=0.01)
    assert found["stages"][1]["gap_over_limit"] > 1.0
    assert any("the sheet may fold over at" in warning for warning in found["warnings"])
    partial = found["partial_paths"]
    assert partial["closed"] == found["contours"]  # the walls are alike all around
    assert partial["open"] == 0
    assert partial["curves"] >= partial["closed"] > partial["paths"] >= 2
    marks = found["tool_marks"]
    assert 0.0 < marks["scallop_um"] <= marks["largest_scallop_um"] < 5000.0  # the radius
    assert {row["stage"] for row in found["by_contour"]} == {1, 2}
    table = (tmp_path / "run" / "by_contour.csv").read_text(encoding="ascii").splitlines()
    assert len(table) == 1 + found["contours"]
    page = text_of((tmp_path / "features.html").read_text(encoding="utf-8"))
    assert "1 ruled, positive" in page
    assert re.search(r"path of \d+ ruled, positive", page)


def test_a_file_for_every_stage_and_a_spindle_that_rolls(tmp_path: Path) -> None:
    """As in docs/methods/plan_outputs.md, on a small part with one shape before it."""
    done = isf("part", "cone", "--set", "angle=66 deg", "--set", "depth=12 mm", "-o", "c.stl", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    text = JOB.read_text(encoding="utf-8").replace("../parts/mini_cone.stl", "c.stl").replace("DSIF", "SPIF")
    lines = [line for line in text.splitlines() if not line.strip().startswith(("support_force", "engage_depth"))]
    options = "path:\n  spindle: rolling\n  morph: {failure_angle: 60 deg, shapes: 1}\n"
    text = "\n".join(lines).replace("path:\n", options) + "\nwall_angle_limit: 70 deg\n"
    (tmp_path / "job.yaml").write_text(text, encoding="utf-8")
    asked = ("--export", "c.nc", "--export", "c.stl", "--export", "c.npz")
    done = isf("plan", "job.yaml", *asked, "--per-stage", "--as-planned", "-o", "run", cwd=tmp_path)
    assert done.returncode == Exit.INPUT
    assert "a plan file holds all stages" in done.stderr
    done = isf("plan", "job.yaml", *asked[:4], "--per-stage", "--as-planned", "-o", "again", "--json", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    found = json.loads(done.stdout)
    assert found["files"] == [f"c_stage_{k}{ending}" for ending in (".nc", ".stl") for k in (1, 2)]
    assert len(found["spindle"]["rpm"]) == found["contours"]
    for file in found["files"][:2]:
        program = (tmp_path / file).read_text(encoding="ascii")
        assert re.search(r"^S\d+ M3$", program, re.MULTILINE)
        read = isf("gcode", file, "--rig", "ren2018", "--radius", "5 mm", "--json", cwd=tmp_path)
        assert json.loads(read.stdout)["unknown_words"] == []
    steepest = max(found["by_contour"], key=lambda row: row["wall_angle_min_deg"])
    assert steepest["spindle_slip"] < 0.05
    depths = [-trimesh.load_mesh(tmp_path / file).vertices[:, 2].min() for file in found["files"][2:]]
    assert depths[0] < depths[1] == pytest.approx(12.0, abs=0.01)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--scallop", "5"), "not a number with a unit"),
        (("--mark-spacing", "5 N"), "not a quantity in m"),
        (("--scallop", "0 um"), "not above 0"),
        (("--scallop", "8 mm"), "more than passes of a ball"),
        (("--per-stage",), "is of --export"),
        (("--per-stage", "--export", "part.nc", "--as-planned"), "formed in one stage"),
    ],
)
def test_wishes_that_cannot_be_had_are_refused(options: tuple[str, ...], said: str, tmp_path: Path) -> None:
    done = isf("plan", str(JOB), *options, "-o", "run", cwd=tmp_path)
    assert done.returncode == Exit.INPUT
    assert said in " ".join(done.stderr.split())


def test_the_step_for_a_wanted_surface(tmp_path: Path) -> None:
    done = isf("plan", str(JOB), "--scallop", "2 um", "-o", "run", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    assert re.search(r"for ridges of 2 um: incremental_depth: 0\.\d+ mm", done.stderr + done.stdout)


def test_parts_are_listed_and_made(tmp_path: Path) -> None:
    listed = json.loads(isf("part", "--json", cwd=tmp_path).stdout)
    assert listed["cone"]["angle"] == "50 deg"
    done = isf("part", "cone", "--set", "depth=12 mm", "-o", "c.stl", "--json", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    assert json.loads(done.stdout)["depth_mm"] == pytest.approx(12.0)
    assert (tmp_path / "c.stl").stat().st_size > 100_000
    assert "depth" in isf("part", "cone", "--set", "size=12 mm", cwd=tmp_path).stderr


def test_a_cad_file_reports_its_unit_itself(tmp_path: Path) -> None:
    assert isf("part", "cone", "--set", "depth=6 mm", "-o", "c.stl", cwd=tmp_path).returncode == Exit.OK
    mesh = trimesh.load_mesh(tmp_path / "c.stl")
    mesh.units = "millimeter"
    mesh.export(tmp_path / "c.3mf")
    done = isf("plan", "c.3mf", "--json", "-o", "run", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    assert json.loads(done.stdout)["depth_mm"] == pytest.approx(6.0, abs=0.02)
    (tmp_path / "bad.step").write_text("no CAD file", encoding="utf-8")
    done = isf("plan", "bad.step", cwd=tmp_path)
    assert done.returncode == Exit.INPUT
    assert "MESH_UNREADABLE" in done.stderr
