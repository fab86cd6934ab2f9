"""What lies in place of a file of points, readings, plans or states: each reader says so with a code, none hangs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from damaged import STRANGE, put_strange
from isf_analysis.measures.plan_mask import shapes_of
from isf_cell.campaign.rows_file import read_rows
from isf_cell.commands.calibrate_cell import calibrate_file
from isf_cell.commands.identify_dial import read_dial
from isf_cell.commands.play import _parameter
from isf_cell.replay import what_if
from isf_cell.shape_file import load_shape
from isf_core.errors import ErrorCode, IsfError
from isf_planner.accuracy import formed_parts
from isf_planner.exports.plan_file import load_plan
from isf_planner.gcode.reader import program_text
from isf_planner.part.meshes import load_mesh
from isf_planner.predict import machine_error
from isf_sim.machine.axes import read_error_map
from isf_sim.machine.state import load_machine
from isf_springback.contour_record import read_target
from isf_springback.database.database import Database
from isf_springback.estimators import learning
from isf_springback.shell.edge_calibration import read_push_curve

UNREADABLE = ("pipe", "folder", "device", "huge")
OF_POINTS = {ErrorCode.FILE_SYNTAX, ErrorCode.BAG_UNREADABLE}
"""A folder in place of a shape is a run, and this one holds no bag."""
OF_MESH = {ErrorCode.MESH_UNREADABLE, ErrorCode.MESH_EMPTY, ErrorCode.BAG_UNREADABLE}

READERS: dict[str, tuple[str, Callable[[Path], Any], set[ErrorCode]]] = {
    "points": ("x.csv", lambda path: load_shape(path, "mm"), OF_POINTS),
    "point arrays": ("x.npz", lambda path: load_shape(path, "mm"), OF_POINTS),
    "cloud": ("x.ply", lambda path: load_shape(path, "mm"), OF_MESH),
    "packed mesh": ("x.3mf", lambda path: load_mesh(path, None), OF_MESH),
    "polygon": ("x.csv", lambda path: shapes_of([f"polygon:{path}"], "--inside"), {ErrorCode.FILE_SYNTAX}),
    "calibration": (
        "x.csv",
        lambda path: calibrate_file(path, None, None, as_json=False),
        {ErrorCode.FILE_SYNTAX, ErrorCode.FILE_FIELD},
    ),
    "dial": ("x.csv", read_dial, {ErrorCode.FILE_SYNTAX, ErrorCode.FILE_FIELD}),
    "machine error": ("x.csv", machine_error.load, {ErrorCode.FILE_SYNTAX}),
    "error map": ("x.csv", read_error_map, {ErrorCode.FILE_SYNTAX}),
    "push curve": ("x.csv", read_push_curve, {ErrorCode.PUSH_CURVE_UNUSABLE, ErrorCode.FILE_UNIT}),
    "plan": ("x.npz", load_plan, {ErrorCode.PLAN_FILE_UNREADABLE}),
    "machine": ("x.npz", load_machine, {ErrorCode.FILE_SYNTAX}),
    "target": ("target.npz", lambda path: read_target(path.parent), {ErrorCode.CHECKPOINT_UNUSABLE}),
    "learned": ("x.npz", learning.load, {ErrorCode.LEARNING_UNUSABLE}),
    "accuracy surfaces": ("x.npz", formed_parts.load, {ErrorCode.LEARNING_UNUSABLE}),
    "database": ("x.json", Database.load, {ErrorCode.DATABASE_UNUSABLE}),
}


@pytest.mark.parametrize("strange", STRANGE)
@pytest.mark.parametrize("name", READERS)
def test_what_is_no_such_file_is_told_with_its_place(name: str, strange: str, tmp_path: Path) -> None:
    file, read, codes = READERS[name]
    path = put_strange(tmp_path / file, strange)
    with pytest.raises(IsfError) as refused:
        read(path)
    assert refused.value.code in codes
    assert str(path) in refused.value.where
    assert refused.value.advice
    assert "Errno" not in refused.value.what


@pytest.mark.parametrize("strange", UNREADABLE)
def test_programs_and_rows_that_cannot_be_read_are_told(strange: str, tmp_path: Path) -> None:
    path = put_strange(tmp_path / "x.nc", strange)
    for read, code in ((program_text, ErrorCode.PROGRAM_UNREADABLE), (read_rows, ErrorCode.FILE_SYNTAX)):
        with pytest.raises(IsfError) as refused:
            read(path)
        assert refused.value.code is code


@pytest.mark.parametrize(
    ("content", "code"),
    [
        ("x,y,z\n0,0,0\n1e9,0,0\n0,1,0\n1,1,0\n", ErrorCode.MESH_UNIT_SUSPECT),
        ("x,y,z\n" + "".join(f"{k},{k}.0000000001,0\n" for k in range(9)), ErrorCode.SCAN_INCOMPLETE),
        ("x,y,z\n1,2\n", ErrorCode.FILE_SYNTAX),
        ("x,y,z\n", ErrorCode.SCAN_INCOMPLETE),
        ("x,y,z\nnan,nan,nan\n", ErrorCode.SCAN_INCOMPLETE),
    ],
    ids=["far", "in a line", "short", "no rows", "no numbers"],
)
def test_points_that_make_no_shape_are_told(content: str, code: ErrorCode, tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text(content)
    with pytest.raises(IsfError) as refused:
        load_shape(path, "mm")
    assert refused.value.code is code
    assert refused.value.where == str(path)


def test_a_missing_table_of_loads_is_no_such_file(tmp_path: Path) -> None:
    for read in (lambda path: calibrate_file(path, None, None, as_json=False), read_dial, machine_error.load):
        with pytest.raises(IsfError) as refused:
            read(tmp_path / "none.csv")
        assert refused.value.code is ErrorCode.FILE_NOT_FOUND


@pytest.mark.parametrize(
    "text", ["{a: 1, a: 2}", "2024-13-45", "[" * 2000, "&a [*a]", "!!python/none x", "x" * 200_000]
)
def test_an_option_that_is_no_value_is_refused(text: str) -> None:
    with pytest.raises(IsfError) as refused:
        what_if.parse([f"force.loop_gain={text}"])
    assert refused.value.code is ErrorCode.FILE_FIELD
    assert len(refused.value.what) < 400
    assert _parameter(f"job:={text}") == ("job", text)  # to a node all else is text
