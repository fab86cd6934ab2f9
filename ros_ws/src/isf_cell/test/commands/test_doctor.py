"""``isf doctor`` looks for everything that the packages install."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from isf_cell.commands import doctor

SOURCES = Path(__file__).resolve().parents[3]


def test_every_executable_of_every_package_is_looked_for() -> None:
    installed = set()
    for path in SOURCES.glob("*/setup.py"):
        names = re.findall(r'"(\w+) = (\w+)[\w.]*:main"', path.read_text(encoding="utf-8"))
        assert all(module == path.parent.name for _, module in names)
        installed |= {(path.parent.name, name) for name, _ in names}
    assert ("isf_load_cell", "load_cell") in installed
    assert set(doctor.EXECUTABLES) == installed


def test_all_nodes_are_reported_and_a_missing_one_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    (check,) = doctor._nodes()
    assert check.state == "ok"
    assert check.found.split(", ") == [name for _, name in doctor.EXECUTABLES if name != "isf"]
    assert "load_cell" in check.found
    monkeypatch.setattr(doctor, "EXECUTABLES", (*doctor.EXECUTABLES, ("isf_force_ctrl", "weather")))
    (check,) = doctor._nodes()
    assert check.state == "failed"
    assert "'weather'" in check.found
