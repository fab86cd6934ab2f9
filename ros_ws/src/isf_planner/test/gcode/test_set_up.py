"""Tools of a set-up: their fields, or files of the library that a job may name, too."""

from __future__ import annotations

from pathlib import Path

import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_planner.gcode.reader import read_program
from isf_planner.gcode.set_up import load_set_up

SET_UP = """\
tools:
  1: spif_a_ball_5
  2: {length: 60 mm, radius: 4 mm}
  3: spif_a_flat_15
  4: own.yaml
mounted: 3
"""
OWN = "name: own\nradius: 3 mm\nstick_out: 50 mm\nprovenance: {radius: 'assumed: x', stick_out: 'assumed: x'}\n"


def written(folder: Path, text: str = SET_UP, own: str = OWN) -> Path:
    (folder / "own.yaml").write_text(own, encoding="utf-8")
    (folder / "cell.yaml").write_text(text, encoding="utf-8")
    return folder / "cell.yaml"


def test_named_tools_have_the_lengths_and_tips_of_their_files(tmp_path: Path) -> None:
    """Torrao 2013, Table 3.8: the ball of 5 mm is 43 mm long, the flat tool of 15 mm 100 mm."""
    tools = load_set_up(written(tmp_path)).tools
    assert {number: tool.length for number, tool in tools.items()} == pytest.approx(
        {1: 0.043, 2: 0.06, 3: 0.1, 4: 0.05}
    )
    assert {number: tool.radius for number, tool in tools.items()} == pytest.approx(
        {1: 0.0025, 2: 0.004, 3: 0.0075, 4: 0.003}
    )
    tips = {number: tool.tip for number, tool in tools.items()}
    assert [number for number, tip in tips.items() if tip is not None and tip.flat_radius > 0.0] == [3]


def test_the_length_of_a_named_tool_counts_in_a_program(tmp_path: Path) -> None:
    """The program tells the spindle's nose after G49; the tip is 43 mm below it."""
    program = read_program("T1 M6\nG49\nG0 X0 Y0 Z53\nG1 Z43\nX5\nM30", load_set_up(written(tmp_path)))
    assert program.tips[-1, :3] == pytest.approx([0.005, 0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize(
    ("text", "own", "code", "where", "words"),
    [
        (SET_UP.replace("ball_5", "ball_6"), OWN, ErrorCode.FILE_NOT_FOUND, "cell.yaml:2", "spif_a_ball_6"),
        (
            SET_UP,
            "name: own\nradius: 3 mm\nprovenance: {radius: 'assumed: x'}\n",
            ErrorCode.FILE_FIELD,
            ":5",
            "stick_out",
        ),
        (SET_UP, OWN.replace("3 mm", "3"), ErrorCode.FILE_UNIT, "own.yaml:2", "radius"),
        (SET_UP.replace("60 mm", "6 m"), OWN, ErrorCode.FILE_FIELD, "cell.yaml:3", "length"),
        (SET_UP.replace("radius: 4 mm", "corner_radius: 4 mm"), OWN, ErrorCode.FILE_FIELD, ":3", "needs a radius"),
    ],
)
def test_a_fault_is_told_with_the_line_that_has_it(
    tmp_path: Path, text: str, own: str, code: ErrorCode, where: str, words: str
) -> None:
    with pytest.raises(IsfError) as caught:
        load_set_up(written(tmp_path, text, own))
    assert caught.value.code is code
    assert caught.value.where.endswith(where)
    assert words in caught.value.what
