"""The G-code reader: the words of Torrao 2013, Table 6.1, faults with line and code, texts that are no programs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_planner.gcode import reader
from isf_planner.gcode.reader import Program, read_program
from isf_planner.gcode.set_up import MountedTool, SetUp

SET_UP = SetUp(
    work_offsets={"G54": (0.01, 0.0, 0.0), "G55": (0.0, 0.02, -0.001), "G57": (0.3, 0.0, 0.0)},
    tools={1: MountedTool(length=0.043), 3: MountedTool(length=0.1)},
    mounted=3,
)


def ends(text: str, set_up: SetUp | None = None, step: float = 1e-3) -> list[list[float]]:
    """mm, upper tips that the program names."""
    program = read_program(text, set_up, step=step)
    assert not program.findings
    assert not program.unknown
    return np.round(1e3 * program.tips[program.given][:, :3], 6).tolist()


def codes(text: str, set_up: SetUp | None = None) -> list[tuple[int, ErrorCode]]:
    return [(finding.line, finding.error.code) for finding in read_program(text, set_up).findings]


def test_lines_absolute_and_incremental() -> None:
    assert ends("G90 G01 X10 Y5 Z-1\nX12\nG91 X1 Y-1\nZ-.5\nG90 Z0\nM30") == [
        [10, 5, -1],
        [12, 5, -1],
        [13, 4, -1],
        [13, 4, -1.5],
        [13, 4, 0],
    ]


def test_points_between_lie_on_the_line_at_most_a_step_apart() -> None:
    program = read_program("G1 X0 Y0 Z0\nX30 Y40 Z-2\nM30", step=0.7e-3)
    steps = np.linalg.norm(np.diff(program.tips[:, :3], axis=0), axis=1)
    assert steps.max() <= 0.7e-3 + 1e-12
    assert len(program) == 1 + math.ceil(math.hypot(30, 40, 2) / 0.7)
    along = np.array([30.0, 40.0, -2.0]) / math.hypot(30, 40, 2)
    off = program.tips[:, :3] - np.outer(program.tips[:, :3] @ along, along)
    assert np.abs(off).max() < 1e-9  # 1e-6 mm


@pytest.mark.parametrize(
    ("text", "length"),
    [
        ("G1 X10 Y0 Z0\nG3 X-10 Y0 I-10 J0", 10 * math.pi),
        ("G1 X10 Y0 Z0\nG2 X0 Y10 I-10 J0", 15 * math.pi),
        ("G1 X10 Y0 Z0\nG3 X0 Y10 R10", 5 * math.pi),
        ("G1 X10 Y0 Z0\nG3 X0 Y10 R-10", 15 * math.pi),
        ("G1 X10 Y0 Z0\nG2 I-10", 20 * math.pi),
        ("G1 X10 Y0 Z0\nG3 X10 Y0 Z-4 I-10", math.hypot(20 * math.pi, 4)),
        ("G90.1 G1 X10 Y0 Z0\nG3 X0 Y10 I0 J0", 5 * math.pi),
        ("G18 G1 X10 Y0 Z0\nG3 X0 Z-10 I-10 K0", 5 * math.pi),
        ("G18 G1 X10 Y0 Z0\nG2 X0 Z-10 I-10 K0", 15 * math.pi),
        ("G19 G1 X0 Y10 Z0\nG2 Y0 Z-10 J-10 K0", 5 * math.pi),
    ],
)
def test_arcs_have_the_length_of_the_circle(text: str, length: float) -> None:
    """By the sum of chords of 0.01 mm; the sense decides between the short and the long way."""
    program = read_program(text + "\nM30", step=1e-5)
    assert not program.findings
    chords = np.linalg.norm(np.diff(program.tips[:, :3], axis=0), axis=1).sum()
    assert 1e3 * chords == pytest.approx(length, rel=1e-6)


def test_points_of_an_arc_lie_on_it() -> None:
    program = read_program("G1 X13 Y4 Z-1\nG3 X3 Y14 I-10 J0\nM30")
    radius = np.linalg.norm(program.tips[:, :2] - [0.003, 0.004], axis=1)
    assert np.abs(radius - 0.01).max() < 1e-9
    assert np.linalg.norm(np.diff(program.tips[:, :2], axis=0), axis=1).max() <= 1e-3
    assert program.tips[len(program) // 2, 1] > 0.01  # counter-clockwise


def test_work_offsets_and_machine_coordinates() -> None:
    text = "G54 G1 X1 Y1 Z-1\nG55 X1 Y1 Z-1\nG53 X1 Y1 Z-1\nX2\nG56 X2\nM30"
    assert ends(text, SET_UP) == [[11, 1, -1], [1, 21, -2], [1, 1, -1], [2, 1, -1], [2, 1, -1]]
    assert read_program(text, SET_UP).systems == {54: 1, 55: 2, 56: 5}


def test_length_compensation() -> None:
    """Tool 3 (100 mm) is mounted: after G49 the nose is told, with G43 H1 a tool of 43 mm is thought to be there."""
    text = "G1 X-10 Y0 Z0\nG49 Z100\nG43 H1 Z0\nG43 Z-1\nT1 M6 Z-2\nM30"
    assert [point[2] for point in ends(text, SET_UP)] == [0, 0, -57, -1, -2]


def test_units_feeds_and_dwell() -> None:
    program = read_program("G20 G1 X1 Y0 Z0 F60\nG21 X0 F600\nG4 P2.5\nG0 Z5\nM30")
    assert program.tips[program.given][0, 0] == pytest.approx(25.4e-3)
    assert program.speed[program.given].tolist() == pytest.approx([25.4e-3, 10e-3, math.inf])
    assert program.dwell == 2.5
    assert program.time(0.1) == pytest.approx(25.4 / 10 + 5 / 100 + 2.5)


def test_the_lower_tool_moves_by_u_v_w() -> None:
    program = read_program("G1 X1 Y2 Z3 U4 V5 W6\nW7\nM30")
    assert program.two_tools
    assert 1e3 * program.tips[program.given] == pytest.approx(np.array([[1, 2, 3, 4, 5, 6], [1, 2, 3, 4, 5, 7]]))


SAMPLE = """\
G90 G54
G43
G53 G01 X0 Y0 Z50
G01 X45 Y45 Z5 (first corner)
G01 Z-1
G01 X-45 Y45
G01 X-45 Y-45
G01 X45 Y-45
G01 X45 Y45
G91
G02 X-20 Y-20 I-20 J0 ; quarter, clockwise
G03 X-10 Y-10 I0 J-10
G90
G49
G01 Z150
M30
G01 X1000 Y1000
"""
"""All thirteen codes of Table 6.1 as the source's CAM writes them (no F, no S), and a line after the end."""


def test_the_subset_of_the_source() -> None:
    program = read_program(SAMPLE, SET_UP)
    assert not program.unknown
    assert not program.findings
    assert program.line[-1] == 15
    assert program.tips[-1, :3] == pytest.approx([0.025, 0.015, 0.05])
    assert "gives no feed" in " ".join(program.remarks)
    arcs = program.tips[np.isin(program.line, [11, 12]), :2]
    assert np.hypot(*(arcs[:32] - [0.035, 0.045]).T) == pytest.approx(np.full(32, 0.02), abs=1e-9)


def test_words_that_are_not_understood_are_listed_with_their_lines() -> None:
    program = read_program("G1 X1 Y1 Z0\nG81 X2 Q3\n(WAITM in a comment)\nWAITM(1,1,2)\n#1=5\nX1.2.3\nC5\nC0\nM98\nM30")
    found = [(unknown.line, unknown.word) for unknown in program.unknown]
    assert found == [(2, "G81"), (2, "Q3"), (4, "WAITM"), (5, "#1=5"), (6, ".3"), (7, "C5"), (9, "M98")]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("G1 X20 R5", ["R5"]),
        ("G0 X20 I3 J1", ["I3", "J1"]),
        ("G3 X20 I5 P3", ["P3"]),
        ("G1 X5 H1", ["H1"]),
        ("H1", ["H1"]),
        ("G4 P1 X5 Z-20", ["X5", "Z-20"]),
        ("G4 X1 Y5", ["Y5"]),
    ],
)
def test_words_that_mean_nothing_where_they_stand(line: str, words: list[str]) -> None:
    """Swallowed, each would change the path that the program's author meant."""
    program = read_program(f"G1 X10 Y0 Z0\n{line}\nM30", SET_UP)
    assert [(unknown.line, unknown.word) for unknown in program.unknown] == [(2, word) for word in words]


def test_g80_ends_the_modal_move() -> None:
    assert codes("G1 X1\nG80\nX2\nM30") == [(3, ErrorCode.PROGRAM_UNREADABLE)]
    assert ends("G0 G80 X1 Y0 Z1\nX2\nG80\nG1 X3\nM30") == [[1, 0, 1], [2, 0, 1], [3, 0, 1]]


def test_a_slash_skips_no_line() -> None:
    assert ends("G0 X1 Y0 Z1\n/X2\nM30") == [[1, 0, 1], [2, 0, 1]]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("G1 X10 Y0 Z0\nG2 X0 Y11 I-10 J0", (2, ErrorCode.PROGRAM_ARC_OPEN)),
        ("G1 X10 Y0 Z0\nG2 X0 Y10 R3", (2, ErrorCode.PROGRAM_ARC_OPEN)),
        ("G1 X10 Y0 Z0\nG2 X0 Y10", (2, ErrorCode.PROGRAM_ARC_OPEN)),
        ("G1 X10 Y0 Z0\nG2 I0 J0", (2, ErrorCode.PROGRAM_ARC_OPEN)),
        ("G1 X10 Y0 Z0\nG2 R5", (2, ErrorCode.PROGRAM_ARC_OPEN)),
        ("X10", (1, ErrorCode.PROGRAM_UNREADABLE)),
        ("G1 X10 X11", (1, ErrorCode.PROGRAM_UNREADABLE)),
        ("G0 G1 X10", (1, ErrorCode.PROGRAM_UNREADABLE)),
        ("G1 X10 F0", (1, ErrorCode.PROGRAM_UNREADABLE)),
        ("G1 X1\nG4", (2, ErrorCode.PROGRAM_UNREADABLE)),
        ("G1 X1\nX" + "9" * 400, (2, ErrorCode.PROGRAM_UNREADABLE)),
        ("G1 X1\nX500000", (2, ErrorCode.PROGRAM_OUT_OF_REACH)),
        ("G1 X1 T8", (1, ErrorCode.PROGRAM_TOOL_UNKNOWN)),
        ("G1 X1\nG43 H2 Z1", (2, ErrorCode.PROGRAM_TOOL_UNKNOWN)),
    ],
)
def test_faults_have_line_and_code(text: str, found: tuple[int, ErrorCode]) -> None:
    assert codes(text, SET_UP) == [found]


def test_arc_rounded_to_two_decimals_closes() -> None:
    assert not codes(f"G1 X14.14 Y14.14 Z0\nG3 X{-14.15} Y14.14 I{-14.14} J{-14.14}")


@pytest.mark.parametrize("text", ["", "%\n(nothing)\nM30\n", "G90 G21"])
def test_a_text_that_moves_nothing(text: str) -> None:
    with pytest.raises(IsfError, match="moves no tool") as caught:
        read_program(text)
    assert caught.value.code == ErrorCode.PROGRAM_UNREADABLE


def test_points_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the count, before room is taken."""
    monkeypatch.setattr(reader, "MOST_POINTS", 1000)
    for move in ("X900 Y0", "X0 Y0\nG2 I-90000", "Y0\n" + "X1\nX2\n" * 600):
        with pytest.raises(IsfError, match="more than 1000 points"):
            read_program(f"G1 X0 Y0 Z0\n{move}", step=0.1e-3)


def test_faults_without_end_are_counted_not_kept() -> None:
    """Also in one line: the time of a line grows with its length, not with its square."""
    for text in ("Q1\n" * 5000, "? " * 300_000, "((((" * 100_000, "G1" * 100_000):
        program = read_program("G1 X0\n" + text)
        assert program.unknown_count in (5000, 300_000, 1, 0)
        assert len(program.unknown) == min(program.unknown_count, 1000)


def readable(text: str) -> Program | None:
    """The program, or None for the one coded error that reading may raise; anything else fails the test."""
    try:
        return read_program(text, SET_UP)
    except IsfError as error:
        if error.code != ErrorCode.PROGRAM_UNREADABLE:
            raise
        return None


word = st.builds(
    lambda letter, number: f"{letter}{number}",
    st.sampled_from("GGGGMXYZUVWIJKRFSTHPNABCQ"),
    st.one_of(
        st.sampled_from(["0", "1", "02", "3", "4", "17", "18", "19", "20", "21", "30", "43", "49", "53", "54", "57"]),
        st.sampled_from(["90", "91", "90.1", "91.1", "", ".", "-", "--1", "1e5", "1.2.3", "-0", "nan", "inf"]),
        st.floats(-150, 150).map(lambda value: f"{value:.3f}"),
    ),
)
block = st.lists(word, max_size=7).map(" ".join)


@settings(max_examples=150, deadline=None)
@given(st.lists(block, max_size=12).map("\n".join))
def test_random_programs_give_points_or_coded_faults(text: str) -> None:
    program = readable(text)
    if program is not None:
        assert np.isfinite(program.tips).all()
        assert (program.speed > 0).all()
        assert len(program.line) == len(program.tips) == len(program.given)


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=300))
def test_any_text_gives_points_or_coded_faults(text: str) -> None:
    readable(text)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, len(SAMPLE)))
def test_truncated_programs_give_points_or_coded_faults(end: int) -> None:
    program = readable(SAMPLE[:end])
    assert program is None or "no end" in " ".join(program.remarks) or end > SAMPLE.index("M30")


def test_a_text_that_is_no_program_is_not_read_to_its_end() -> None:
    with pytest.raises(IsfError, match="100,001 words in 100,001 lines are unknown") as refused:
        read_program("1,2,3\n" * 110_000, name="table.csv")
    assert refused.value.code is ErrorCode.PROGRAM_UNREADABLE
    assert refused.value.where == "table.csv:100001"
