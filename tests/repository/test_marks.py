"""What conftest.py takes for granted when it leaves files out: a mark stands in the file of its test."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_no_conftest_marks_tests_of_other_files() -> None:
    files = [ROOT / "conftest.py", *ROOT.glob("tests/**/conftest.py"), *ROOT.glob("ros_ws/src/**/conftest.py")]
    for path in files:
        assert "add_marker" not in path.read_text(encoding="utf-8"), path
