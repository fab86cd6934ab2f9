"""Constants of messages stand where viewers look for the names of a field's values."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

MESSAGES = sorted((Path(__file__).resolve().parents[2] / "isf_msgs" / "msg").glob("*.msg"))

NAMED = {
    "Contour": {"process": 4},
    "ForceCtrlState": {"mode": 9, "flags": 8},
    "ExecutiveState": {"mode": 4},
    "MachineEvent": {"kind": 8},
    "MachineState": {"mode": 4, "limits": 3},
}
"""Fields whose values have names, and how many."""


def named_values(text: str) -> dict[str, dict[int, str]]:
    """Fields to the names of their values, by the rule of Foxglove Studio 1.48, enumValuesByDatatypeAndField: constants
    belong to the field right after them, and are forgotten where another type comes in between."""
    found: dict[str, dict[int, str]] = {}
    waiting: dict[int, str] = {}
    kind = ""
    for line in text.splitlines():
        if (words := line.split("#")[0].split()) == []:
            continue
        if words[0] != kind:
            waiting, kind = {}, ""
        if constant := re.fullmatch(r"([A-Z_]+)=(\d+)", "".join(words[1:])):
            kind = words[0]
            waiting[int(constant[2])] = constant[1]
        else:
            if waiting:
                found[words[1]] = waiting
            waiting, kind = {}, ""
    return found


@pytest.mark.parametrize("path", MESSAGES, ids=lambda path: path.stem)
def test_every_constant_belongs_to_a_field(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    named = named_values(text)
    assert {field: len(names) for field, names in named.items()} == NAMED.get(path.stem, {})
    assert sum(map(len, named.values())) == len(re.findall(r"^\w+ [A-Z_]+=", text, re.MULTILINE))


def test_a_mode_has_its_name() -> None:
    text = next(path for path in MESSAGES if path.stem == "ForceCtrlState").read_text(encoding="utf-8")
    assert named_values(text)["mode"][4] == "CONTROL"
    assert named_values(text)["flags"][32] == "OSCILLATION"
