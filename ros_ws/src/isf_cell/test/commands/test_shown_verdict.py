"""The verdict at the terminal: green for a good part alone, with a word on the sheet that flatters it."""

from __future__ import annotations

from typing import Any

import pytest
from isf_cell.commands import terminal

GOOD: dict[str, Any] = {"complete": True, "verdict": {"good": True, "short_of": [], "proviso": ""}}


def shown(summary: dict[str, Any]) -> list[str]:
    with terminal.console.capture() as out:
        terminal.show_summary(summary, None)
    return [line for line in out.get().splitlines() if line.startswith(("part", "  "))][-3:]


@pytest.mark.parametrize(
    ("verdict", "first", "second"),
    [
        ({}, "part complete and good", None),
        ({"proviso": "this sheet yields little"}, "part complete, in tolerance on the fast sheet", "yields little"),
        ({"good": False, "short_of": ["largest 2 mm"]}, "part complete, but not good", "largest 2 mm"),
    ],
)
def test_what_a_person_reads_last(verdict: dict[str, Any], first: str, second: str | None) -> None:
    lines = shown({**GOOD, "verdict": {**GOOD["verdict"], **verdict}})
    start = lines.index(first)
    assert (second in lines[start + 1]) if second else start == len(lines) - 1


EXPECTED: dict[str, Any] = {"largest_mm": 0.5, "mean_mm": 0.2, "reached_over_expected": 1.8, "overconfident": True}


@pytest.mark.parametrize(
    ("expected", "row", "warned"),
    [
        (EXPECTED, "0.50 / 0.20 (reached: 1.8 x)", True),
        ({**EXPECTED, "reached_over_expected": 1.2, "overconfident": False}, "0.50 / 0.20 (reached: 1.2 x)", False),
        ({**EXPECTED, "reached_over_expected": None, "overconfident": None}, "0.50 / 0.20", False),
        (dict.fromkeys(EXPECTED), "not known", False),
    ],
)
def test_what_was_expected_is_told_beside_what_was_reached(expected: dict[str, Any], row: str, warned: bool) -> None:
    with terminal.console.capture() as out:
        terminal.show_summary({**GOOD, "expected_error": expected}, None)
    (line,) = (line for line in out.get().splitlines() if "expected largest / mean error [mm]" in line)
    assert row in line
    assert ("1.8 times what the correction expected" in " ".join(out.get().split())) is warned
