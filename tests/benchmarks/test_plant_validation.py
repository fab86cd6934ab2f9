"""The quick part of the plant's validation: rows that are met stay met."""

from __future__ import annotations

import sys
from pathlib import Path

import forked_process
import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "plant_validation.py"


@pytest.mark.slow
def test_quick_rows_of_the_validation() -> None:
    result = forked_process.run([sys.executable, str(SCRIPT), "--quick"])
    assert result.returncode == 0, result.stderr
    rows = result.stdout.splitlines()
    assert sum(" met " in row for row in rows) >= 10
    assert not [row for row in rows if " fails " in row]


def test_unknown_part_is_reported_with_the_known_ones() -> None:
    result = forked_process.run([sys.executable, str(SCRIPT), "nothing"])
    assert result.returncode == 2
    assert "known: flat" in result.stderr
