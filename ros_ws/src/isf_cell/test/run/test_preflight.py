"""Each named check of the preflight fails with its code, and the list tells the others too."""

from __future__ import annotations

from collections import namedtuple
from pathlib import Path

import pytest
from isf_cell.run import preflight
from isf_core import __version__
from isf_core.errors import ErrorCode, IsfError

Usage = namedtuple("Usage", "total used free")


def refused(*checks: preflight.Check) -> IsfError:
    with pytest.raises(IsfError) as caught:
        preflight.passed(checks)
    return caught.value


def test_a_cell_without_fault_is_told_in_one_line(tmp_path: Path) -> None:
    line = preflight.passed(
        [
            preflight.publishers({"tool_1/target": ["/force_ctrl"], "tool_2/target": []}),
            preflight.versions({"machine": __version__}),
            preflight.messages({"tool_1/target": {"/force_ctrl": "a", "/machine": "a"}}),
            preflight.disk([]),
        ]
    )
    assert line.startswith("preflight: one publisher of each topic (1 topics); one version of all nodes (")
    assert line.endswith("disk space (nothing is kept here)")


def test_a_second_publisher_is_named(tmp_path: Path) -> None:
    found = {"contour/result": ["/force_ctrl"], "tool_1/target": ["/force_ctrl", "/old_tool"]}
    error = refused(preflight.publishers(found), preflight.versions({}))
    assert error.code is ErrorCode.SECOND_PUBLISHER
    assert error.where == "topic tool_1/target"
    assert "'/force_ctrl', '/old_tool'" in error.what
    assert "\n  FAILED  one publisher of each topic: 2 of tool_1/target\n  ok      one version" in error.advice


def test_a_name_that_two_processes_have_is_told_with_both() -> None:
    error = refused(preflight.twice({"machine": ["71:5@a", "88:6@a"]}))
    assert error.code == 1510
    assert "processes 71 and 88 are both node 'machine'" in str(error)
    assert preflight.twice({}).failed is None


def test_another_version_or_another_message_is_named() -> None:
    error = refused(preflight.versions({"machine": "0.0.7", "planner": __version__, "driver": ""}))
    assert (error.code, "'machine' 0.0.7" in error.what) == (ErrorCode.VERSION_MISMATCH, True)
    error = refused(preflight.messages({"machine/state": {"/machine": "RIHS01_a", "/executive": "RIHS01_b"}}))
    assert (error.code, error.where) == (ErrorCode.VERSION_MISMATCH, "topic machine/state")


def test_a_disk_without_space_is_told_with_its_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = {"value": 400_000_000}
    monkeypatch.setattr(preflight.shutil, "disk_usage", lambda _: Usage(0, 0, free["value"]))
    error = refused(preflight.disk([tmp_path / "not" / "there" / "yet"]))
    assert error.code is ErrorCode.BAG_NOT_WRITABLE
    assert error.what == "only 400 MB are free, 500 MB are wanted for bag and checkpoint"
    free["value"] = 600_000_000
    assert preflight.disk([tmp_path]).failed is None
