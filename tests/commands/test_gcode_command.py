"""``isf gcode``, run as a user runs it (docs/own_cell/programs.md)."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import forked_process
import yaml
from isf_cell.commands.exit_codes import Exit

SET_UP = """
work_offsets: {G54: [5 mm, 0 mm, 0 mm], G55: [0 mm, 300 mm, 0 mm]}
tools: {1: {length: 43 mm, radius: 4 mm}}
"""


def isf(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return forked_process.run([sys.executable, "-m", "isf_cell.cli", *arguments], cwd=cwd)


def cone(folder: Path) -> Path:
    """Four rings, 45 deg, 4 mm deep, of tool 1."""
    lines = ["%", "G21 G90 G54 T1 M6", "G43 H1 G0 Z20", "X16 Y0", "F3000"]
    for k in range(1, 5):
        lines += [f"G1 X{16 - k} Y0 Z{-k}", f"G3 X{16 - k} Y0 I{k - 16} J0"]
    file = folder / "cone.nc"
    file.write_text("\n".join([*lines, "G0 Z20", "M30", "%"]))
    return file


def test_a_program_is_read_and_formed_in_simulation(tmp_path: Path) -> None:
    cone(tmp_path)
    (tmp_path / "cell.yaml").write_text(SET_UP)
    options = ("--rig", "torrao2013", "--set-up", "cell.yaml", "--simulate", "--json", "-o", "run")
    done = isf("gcode", "cone.nc", *options, cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    data = json.loads(done.stdout)
    assert (data["feasible"], data["unknown_words"], data["findings"]) == (True, [], [])
    assert (data["contours"], data["rig"], data["work_systems"]) == (4, "torrao2013", ["G54"])
    assert data["points"] > 4 * 75
    run = tmp_path / "run"
    assert data["machine"]["kinematics"] == "hexapod_spif_a"
    assert 140 < data["machine"]["stroke_left_mm"] < 151  # 150.9 mm in the middle: 1475 mm less 408 mm
    made = ("program.png", "reach.png", "report.html", "part.stl", "job.yaml")
    assert all((run / name).is_file() for name in made)
    assert "radius: " in (run / "job.yaml").read_text()
    planned = isf("plan", "run/job.yaml", "--json", "-o", "plan", cwd=tmp_path)
    assert planned.returncode == Exit.OK, planned.stderr


def test_a_program_that_cannot_be_formed_is_told_line_by_line(tmp_path: Path) -> None:
    file = tmp_path / "bad.txt"
    (tmp_path / "cell.yaml").write_text(SET_UP)
    file.write_text("G90 G1 X10 Y0 Z-1\nG81 Q2\nG2 X0 Y15 I-10 J0\nG55 X0 Y0\nM30\n")
    done = isf("gcode", "bad.txt", "--set-up", "cell.yaml", "--simulate", "--json", "-o", "run", cwd=tmp_path)
    assert done.returncode == Exit.INPUT
    data = json.loads(done.stdout)
    assert not data["feasible"]
    assert [(word["line"], word["word"]) for word in data["unknown_words"]] == [(2, "G81"), (2, "Q2")]
    found = [(finding["line"], finding["name"]) for finding in data["findings"]]
    assert found[:3] == [(3, "PROGRAM_ARC_OPEN"), (4, "PROGRAM_ARC_OPEN"), (4, "PROGRAM_OUT_OF_REACH")]
    assert not (tmp_path / "run" / "bag").exists()
    assert "1161 PROGRAM_WORD_UNKNOWN" in done.stderr


def test_tools_of_another_radius_and_where_a_radius_is_needed(tmp_path: Path) -> None:
    """The job made for a program has the radius of the tool that forms, not of the last one called."""
    (tmp_path / "cell.yaml").write_text(SET_UP.replace("4 mm}}", "4 mm}, 2: {length: 43 mm, radius: 7.5 mm}}"))
    text = cone(tmp_path).read_text()
    (tmp_path / "after.nc").write_text(text.replace("M30", "T2 M6\nM30"))
    done = isf("gcode", "after.nc", "--set-up", "cell.yaml", "--json", "-o", "after", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    assert "tool_1: {radius: 4 mm}" in (tmp_path / "after" / "job.yaml").read_text().replace('"', "")
    (tmp_path / "mixed.nc").write_text(text.replace("G1 X14", "G0 Z20\nT2 M6\nX14\nG1 X14"))
    done = isf("gcode", "mixed.nc", "--set-up", "cell.yaml", "--json", "-o", "mixed", cwd=tmp_path)
    assert done.returncode == Exit.INPUT
    (finding,) = json.loads(done.stdout)["findings"]
    assert "tool 2 (7.5 mm radius) forms after one of 4 mm" in finding["message"]
    done = isf("gcode", "cone.nc", "--set-up", "cell.yaml", "--radius", "5", cwd=tmp_path)
    assert done.returncode == Exit.INPUT
    assert "FILE_UNIT" in done.stderr


def test_the_limits_of_step_and_feed_are_those_of_a_job(tmp_path: Path) -> None:
    """What the command line takes the job that is made takes, too."""
    file = cone(tmp_path)
    file.write_text(file.read_text().replace("F3000\n", ""))
    for step, feed in (("0.051", "0.101"), ("4.999", "999.9")):
        done = isf("gcode", "cone.nc", "--step", step, "--feed", feed, "-o", f"run_{step}", cwd=tmp_path)
        assert done.returncode == Exit.OK, done.stderr
    for option, value in (("--step", "5"), ("--feed", "0.1")):
        done = isf("gcode", "cone.nc", option, value, cwd=tmp_path)
        assert f"Invalid value for '{option}'" in done.stderr.replace('"', "'")


def test_what_the_command_line_leaves_out_is_that_of_the_job(tmp_path: Path) -> None:
    """Set-up, distance of points and feed of a job with a program, whatever program is read with it."""
    file = cone(tmp_path)
    file.write_text(file.read_text().replace("F3000\n", ""))
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs" / "cell.yaml").write_text(SET_UP)
    (tmp_path / "jobs" / "job.yaml").write_text(
        "name: other\nprocess: SPIF\nrig: torrao2013\nsheet: {material: AA1050, thickness: 1 mm}\n"
        "tool_1: {radius: 4 mm}\n"
        "path: {program: other.nc, set_up: cell.yaml, point_spacing: 3 mm, feed: 12 mm/s}\n"
        "control: {support_force: 0 N}\nspringback: {method: none}\n"
    )
    (tmp_path / "mine.yaml").write_text(SET_UP.replace("5 mm", "6 mm"))
    told = ("--step", "2", "--feed", "20", "--set-up", "mine.yaml")
    for name, options, wanted in (
        ("own", (), ["3 mm", "12 mm/s", "jobs/cell.yaml"]),
        ("told", told, ["2 mm", "20 mm/s", "mine.yaml"]),
    ):
        done = isf("gcode", "cone.nc", "--job", "jobs/job.yaml", *options, "--json", "-o", name, cwd=tmp_path)
        assert done.returncode == Exit.OK, done.stderr
        path = yaml.safe_load((tmp_path / name / "program.yaml").read_text(encoding="utf-8"))["path"]
        assert [path["point_spacing"], path["feed"]] == wanted[:2]
        assert Path(path["set_up"]) == tmp_path / wanted[2] == tmp_path / json.loads(done.stdout)["set_up"]


def test_files_that_are_no_programs(tmp_path: Path) -> None:
    (tmp_path / "empty.nc").write_bytes(b"\xff\x00\x80 nothing")
    (tmp_path / "wrong.yaml").write_text("work_offsets: {G58: [0 mm, 0 mm, 0 mm]}\n")
    cone(tmp_path)
    for arguments, code in (
        (("missing.nc",), "FILE_NOT_FOUND"),
        (("empty.nc",), "PROGRAM_WORD_UNKNOWN"),
        (("cone.nc", "--set-up", "wrong.yaml"), "FILE_FIELD"),
        (("cone.nc", "--thickness", "1"), "FILE_UNIT"),
    ):
        done = isf("gcode", *arguments, cwd=tmp_path)
        assert done.returncode == Exit.INPUT, done.stderr
        assert code in done.stderr


def test_the_job_that_is_made_plans_the_program_again(tmp_path: Path) -> None:
    cone(tmp_path)
    (tmp_path / "cell.yaml").write_text(SET_UP)
    done = isf("gcode", "cone.nc", "--set-up", "cell.yaml", "--json", "-o", "run", cwd=tmp_path)
    assert done.returncode == Exit.OK, done.stderr
    job = json.loads(done.stdout)["job"]
    (tmp_path / "elsewhere").mkdir()
    planned = isf("plan", job, "--json", "-o", "plan", cwd=tmp_path / "elsewhere")
    assert planned.returncode == Exit.OK, planned.stderr
    assert json.loads(planned.stdout)["contours"] == 4
    both = isf("gcode", "cone.nc", "--simulate", "--form", cwd=tmp_path)
    assert both.returncode == Exit.INPUT
    assert "--simulate, --form" in both.stderr
