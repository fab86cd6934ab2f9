"""Jobs with a program for their path: contours, target, where the part waits, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner import Plan, plan
from isf_planner.gcode.program_check import check_program_text

JOB = """
name: rings
process: SPIF
rig: {rig}
sheet: {{material: AA5754-O, thickness: 1 mm}}
tool_1: {{radius: 5 mm}}
path: {{program: rings.nc{more}}}
"""


def ring(radius: float, z: float) -> str:
    return f"G1 X{radius} Y0 Z{z} F1200\nG3 X{radius} Y0 I{-radius} J0\n"


RINGS = "G21 G90\nG0 Z20\nX20 Y0\n" + ring(20, -1) + "M0\n" + ring(19, -2) + ring(18, -3) + "G0 Z20\nM30\n"
"""Contours begin in lines 4, 7 and 9."""


def job(folder: Path, program: str = RINGS, more: str = "", rig: str = "ren2018", text: str = JOB) -> JobFile:
    (folder / "rings.nc").write_text(program)
    return JobFile(text.format(rig=rig, more=more), folder)


def refused(job_file: JobFile) -> IsfError:
    with pytest.raises(IsfError) as caught:
        plan(job_file)
    return caught.value


@pytest.fixture(autouse=True)
def own_cells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No offsets of a cell of the user."""
    monkeypatch.setenv("ISF_CELLS", str(tmp_path / "cells"))
    return tmp_path / "cells"


@pytest.mark.parametrize("rig", ["ren2018", "torrao2013"])
def test_the_contours_are_those_of_the_program(tmp_path: Path, rig: str) -> None:
    assert job(tmp_path, rig=rig).tilts == (rig == "torrao2013")  # its load cells have to be ready for it
    made = plan(job(tmp_path, rig=rig))
    assert [contour.closed for contour in made.contours] == [True] * 3
    for contour, radius, z in zip(made.contours, (20e-3, 19e-3, 18e-3), (-1e-3, -2e-3, -3e-3), strict=True):
        np.testing.assert_allclose(np.hypot(*contour.forming_tip[:, :2].T), radius, atol=1e-12)
        np.testing.assert_allclose(contour.forming_tip[:, 2], z, atol=1e-12)
        assert contour.feed == pytest.approx(20e-3)
        assert np.linalg.norm(np.diff(contour.forming_tip, axis=0), axis=1).max() <= 1e-3
    assert plan(job(tmp_path, rig=rig)).plan_id == made.plan_id
    assert plan(job(tmp_path, RINGS.replace("X18", "X17"), rig=rig)).plan_id != made.plan_id


def test_set_up_and_spacing_of_the_job_hold(tmp_path: Path, own_cells: Path) -> None:
    (tmp_path / "cell.yaml").write_text("work_offsets: {G54: [10 mm, 0 mm, 0 mm]}\n")
    moved = plan(job(tmp_path, more=", set_up: cell.yaml, point_spacing: 0.5 mm"))
    assert middle(moved) == pytest.approx([10e-3, 0.0], abs=0.2e-3)
    assert np.linalg.norm(np.diff(moved.contours[0].forming_tip, axis=0), axis=1).max() <= 0.5e-3
    own_cells.mkdir()
    (own_cells / "ren2018.yaml").write_text("work_offsets: {G54: [0 mm, -7 mm, 0 mm]}\n")
    assert middle(plan(job(tmp_path))) == pytest.approx([0.0, -7e-3], abs=0.2e-3)


def middle(made: Plan) -> np.ndarray:
    tips = made.contours[0].forming_tip[:, :2]
    return 0.5 * (tips.min(axis=0) + tips.max(axis=0))


@pytest.mark.parametrize(
    ("program", "holds", "contours"),
    [
        (RINGS, (1,), 3),
        (RINGS.replace("M0\n", ""), (), 3),
        (RINGS.replace("G0 Z20\nX20", "M0\nG0 Z20\nX20"), (1,), 3),  # before the first contour there is nothing to hold
        (RINGS.replace("M0\n", "").replace("G0 Z20\nM30", "M0\nG0 Z20\nM30"), (), 3),  # and nothing after the last
        (RINGS.replace("M0\n", "").replace("G3 X19 Y0 I-19 J0", "G3 X-19 Y0 I-19 J0\nM00\nG3 X19 Y0 I19 J0"), (2,), 4),
        (RINGS.replace("G3 X18", "M1\nG3 X18"), (1,), 3),  # M1 stops where the operator chose it
    ],
)
def test_the_part_waits_where_the_program_stops(
    tmp_path: Path, program: str, holds: tuple[int, ...], contours: int
) -> None:
    made = plan(job(tmp_path, program))
    assert made.hold_after == holds
    assert len(made.contours) == contours
    assert plan(job(tmp_path, program, more=", hold_after: [2]")).hold_after == tuple(sorted({*holds, 2}))


LIFT = "G0 Z20\n"
DOWN = "X19 Y0\n"


@pytest.mark.parametrize(
    ("at_stop", "lifted"),
    [
        ("M0\n", []),
        (f"{LIFT}M0\n{DOWN}", [1]),
        ("G0 Z0.5\nM0\n", [1]),  # in the pocket, and just over the plane of the sheet
        (f"G0 Z{-0.4}\nM0\nZ20\n", [1]),  # below it, but off the floor at z = -1 mm
        ("G1 Z20\nM0\n", [1]),  # with feed
        (f"{LIFT}X0 Y90\nM0\n{DOWN}", [1]),  # and aside
        (f"M0\n{LIFT}{DOWN}", []),  # the lift comes after the stop
        (f"{LIFT}{DOWN}G1 Z{-1.5} F600\nM0\n", []),  # back in the sheet before it
        (f"M0\n{LIFT}M0\n{DOWN}", [1]),  # it waits once, as at the last
        (f"{LIFT}M1\n{DOWN}", []),
    ],
)
def test_the_tool_is_off_the_sheet_at_a_stop_where_the_program_lifts_it_before(
    tmp_path: Path, at_stop: str, lifted: list[int]
) -> None:
    made = plan(job(tmp_path, RINGS.replace("M0\n", at_stop)))
    assert len(made.contours) == 3
    assert [contour.index + 1 for contour in made.contours if contour.lift_after] == lifted
    assert set(lifted) <= set(made.hold_after)
    for number in lifted:
        assert made.contours[number].retract  # from there the next one is entered from the air
    stops = check_program_text(RINGS.replace("M0\n", at_stop), "rings", job(tmp_path), None).numbers()["stops"]
    assert [stop["after_contour"] for stop in stops if stop["lifted"]] == lifted
    waits = plan(job(tmp_path, RINGS.replace("M0\n", f"M0\n{LIFT}{DOWN}")))
    assert (made.plan_id == waits.plan_id) <= (not lifted)  # a part does not go on with the other one


def test_a_stop_in_the_middle_of_a_ring_cuts_it_there(tmp_path: Path) -> None:
    halves = "G3 X-19 Y0 I-19 J0\nM0\nG3 X19 Y0 I19 J0"
    made = plan(job(tmp_path, RINGS.replace("G3 X19 Y0 I-19 J0", halves)))
    assert made.hold_after == (1, 2)
    np.testing.assert_allclose(made.contours[1].forming_tip[-1], [-19e-3, 0.0, -2e-3], atol=1e-12)
    assert not made.contours[1].closed
    assert not made.contours[2].retract
    np.testing.assert_allclose(made.contours[2].forming_tip[-1], [19e-3, 0.0, -2e-3], atol=1e-12)


def test_the_target_is_the_part_of_the_job_and_a_wrong_offset_is_told(tmp_path: Path) -> None:
    alone = plan(job(tmp_path))
    mesh = trimesh.Trimesh(*alone.mesh, process=False)
    mesh.export(tmp_path / "part.stl")
    with_part = JOB.replace("process", "part: {{mesh: part.stl, unit: m{where}}}\nprocess")
    here = plan(job(tmp_path, text=with_part.replace("{where}", "")))
    np.testing.assert_allclose(here.target.z, alone.target.z, atol=1e-6)
    assert not [text for text in here.warnings if "touches the sheet" in text]
    there = plan(job(tmp_path, text=with_part.replace("{where}", ", place: [30 mm, 0 mm]")))
    assert there.target.z[:, there.target.x < 0.0].min() == 0.0
    (told,) = [text for text in there.warnings if "touches the sheet" in text]
    assert "above the part, at x = 20" in told


@pytest.mark.parametrize(
    ("program", "code", "words"),
    [
        (RINGS.replace("M0", "G81"), ErrorCode.PROGRAM_WORD_UNKNOWN, "rings.nc:6"),
        (RINGS.replace("X19 Y0 Z-2", "X500 Y0 Z-2"), ErrorCode.PROGRAM_OUT_OF_REACH, "rings.nc:7"),
        (RINGS.replace("X19 Y0 I-19", "X18 Y0 I-19"), ErrorCode.PROGRAM_ARC_OPEN, "rings.nc:8"),
        ("G0 X1 Y1 Z1\nM30", ErrorCode.PROGRAM_UNREADABLE, "rings.nc"),
        (RINGS.replace("Z20\nX20", "Z20 U0 V0 W-20\nX20"), ErrorCode.PROCESS_NOT_SUPPORTED, "job has none"),
    ],
)
def test_what_is_at_fault_is_told_with_its_line(tmp_path: Path, program: str, code: ErrorCode, words: str) -> None:
    error = refused(job(tmp_path, program))
    assert error.code == code
    assert words in error.message
    assert error.advice


def test_a_program_that_is_not_there_and_tools_that_are_not_those_of_the_job(tmp_path: Path) -> None:
    job_file = job(tmp_path)
    (tmp_path / "rings.nc").unlink()
    assert refused(job_file).code == ErrorCode.FILE_NOT_FOUND
    (tmp_path / "cell.yaml").write_text("tools: {1: {length: 40 mm, radius: 4 mm}}\nmounted: 1\n")
    error = refused(job(tmp_path, more=", set_up: cell.yaml"))
    assert error.code == ErrorCode.PROGRAM_OUT_OF_REACH
    assert "4 mm radius" in error.message
    assert "rings.nc:4" in error.message


def test_one_tool_of_a_job_for_two(tmp_path: Path) -> None:
    two = JOB.replace("SPIF", "DSIF").replace("path:", "tool_2: {{radius: 5 mm}}\npath:")
    error = refused(job(tmp_path, text=two))
    assert error.code == ErrorCode.PROCESS_NOT_SUPPORTED
    assert "process: SPIF" in error.message


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("program: rings.nc", "program: rings.nc, stagger: 1 mm", "stagger has no effect beside program"),
        ("program: rings.nc", "incremental_depth: 1 mm, point_spacing: 1 mm, feed: 1 mm/s", "part is missing"),
        (
            "program: rings.nc",
            "incremental_depth: 1 mm, point_spacing: 1 mm, feed: 1 mm/s, set_up: a",
            "no effect without program",
        ),
        ("process: SPIF", "process: TPIF", "die"),
        ("process: SPIF", "process: SPIF\ntool_axis: {{strategy: auto}}", "says itself how the tool is tilted"),
        ("process: SPIF", "process: DSIF\ntool_2: {{radius: 5 mm}}\ncontrol: {{support_force: 9 N}}", "support forces"),
    ],
)
def test_jobs_that_contradict_their_program_are_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    with pytest.raises(IsfError, match=words) as caught:
        job(tmp_path, text=JOB.replace("{more}", "").replace(old, new))
    assert caught.value.code == ErrorCode.FILE_FIELD
