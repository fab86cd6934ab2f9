"""scripts/combine_coverage.py: what a killed process leaves does not hide what the others have measured."""

from __future__ import annotations

import importlib.util
import sqlite3
from pathlib import Path

import pytest
from coverage import CoverageData

SCRIPT = Path(__file__).parents[2] / "scripts" / "combine_coverage.py"


@pytest.mark.parametrize("damage", ["cut", "number"])
def test_a_torn_file_is_named_and_the_others_count(damage: str, tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("combine_coverage", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    for name, lines in (("a", [1, 2]), ("b", [2, 3]), ("c", [9])):
        data = CoverageData(str(tmp_path / f"coverage.with.{name}"))
        data.add_lines({"/source.py": lines})
    torn = tmp_path / "coverage.with.b"
    if damage == "cut":
        torn.write_bytes(torn.read_bytes()[:5000])
    else:  # a database that is whole, with a value of which coverage makes no lines
        with sqlite3.connect(torn) as connection:
            connection.execute("update line_bits set numbits = 7")
    assert script.combine(tmp_path / "coverage.all", "coverage.with") == [torn]
    united = CoverageData(str(tmp_path / "coverage.all"))
    united.read()
    assert sorted(united.lines("/source.py") or []) == [1, 2, 9]
    assert [file.name for file in tmp_path.iterdir()] == ["coverage.all"]
