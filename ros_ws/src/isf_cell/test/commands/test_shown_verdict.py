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
