"""Programs that tilt the tool: what A, B and vectors mean, and what no tool can do, with its line."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.errors import ErrorCode
from isf_core.files.rig import load_rig
from isf_planner.gcode.program_plan import check_program
from isf_planner.gcode.reader import read_program


def test_angles_change_evenly_along_lines_and_arcs_and_count_from_before_with_g91() -> None:
    text = """G90 G1 F600
        X0 Y0 Z5 A0 B0
        X10 A10 B-20
        G2 X20 Y0 I5 J0 A-10 B20
        G1 G91 X1 A5
        G90 A3=0 B3=-0.6 C3=0.8
        X30 M30"""
    program = read_program(text, step=1e-3)
    assert not program.unknown
    assert not program.findings
    angles = np.degrees(
        np.column_stack([np.arcsin(-program.axis[:, 1]), np.arctan2(program.axis[:, 0], program.axis[:, 2])])
    )
    given = np.flatnonzero(program.given)
    named = [[0.0, 0.0], [10.0, -20.0], [-10.0, 20.0], [-5.0, 20.0], [36.8699, 0.0], [36.8699, 0.0]]
    assert angles[given] == pytest.approx(np.array(named), abs=1e-3)
    assert angles[given[0] : given[1] + 1, 1] == pytest.approx(np.linspace(0.0, -20.0, 11), abs=1e-9)
    assert np.diff(angles[given[1] : given[2] + 1, 0]) == pytest.approx(np.full(16, -20.0 / 16), abs=1e-9)


@pytest.mark.parametrize(
    ("word", "code"),
    [
        ("A95", ErrorCode.PROGRAM_OUT_OF_REACH),
        ("B-1000", ErrorCode.PROGRAM_OUT_OF_REACH),
        ("A3=0 B3=0 C3=-1", ErrorCode.PROGRAM_OUT_OF_REACH),
        ("A3=0 B3=0 C3=0", ErrorCode.PROGRAM_OUT_OF_REACH),
        ("A1 A2", ErrorCode.PROGRAM_UNREADABLE),
    ],
)
def test_an_axis_through_the_sheet_is_found_with_its_line(word: str, code: ErrorCode) -> None:
    program = read_program(f"G1 X0 Y0 Z5 F600\nX1 {word}\nM30")
    assert [(one.line, one.error.code) for one in program.findings] == [(2, code)]


def test_roll_and_half_a_word_are_not_understood() -> None:
    program = read_program("G1 X0 Y0 Z5 F600\nX1 C5\nX2 A3= M30")
    assert [(one.line, one.word) for one in program.unknown][:2] == [(2, "C5"), (3, "=")]


@pytest.mark.parametrize(
    ("rig", "tilt", "words"),
    [
        ("ren2018", 10, "a gantry cannot tilt its tool"),
        ("torrao2013", 35, "leave its reach or tilt"),
        ("torrao2013", 10, ""),
    ],
)
def test_a_tilt_beyond_the_rig_is_found_with_its_line(rig: str, tilt: float, words: str) -> None:
    program = read_program(f"G1 X0 Y0 Z5 F600\nX10 B{tilt}\nX0 B0\nM30", step=5e-3).with_ball(5e-3)
    found = check_program(program, load_rig(rig))
    assert [finding.line for finding in found][:1] == ([2] if words else [])
    assert all(words in finding.error.what for finding in found)
