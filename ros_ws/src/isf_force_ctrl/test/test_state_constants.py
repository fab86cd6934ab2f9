"""Modes and flags of the controller are those of the message: same names, same values, none missing on either side."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from isf_force_ctrl.control_state import Flag, Mode

MESSAGE = Path(__file__).resolve().parents[2] / "isf_msgs" / "msg" / "ForceCtrlState.msg"


@pytest.mark.parametrize(("kind", "type_name"), [(Mode, "uint8"), (Flag, "uint32")], ids=["modes", "flags"])
def test_constants_of_the_message(kind: type[Mode] | type[Flag], type_name: str) -> None:
    reported = re.findall(rf"^{type_name} (\w+)=(\d+)", MESSAGE.read_text(encoding="utf-8"), re.MULTILINE)
    known = {name: item.value for name, item in kind.__members__.items() if name != "NONE"}
    assert {name: int(value) for name, value in reported} == known
