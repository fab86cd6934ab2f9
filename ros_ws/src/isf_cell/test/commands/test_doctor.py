"""``isf doctor`` looks for everything that the packages install."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest
from isf_cell.cli import app
from isf_cell.commands import doctor
from isf_cell.commands.exit_codes import Exit
from typer.testing import CliRunner

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


def _examined(monkeypatch: pytest.MonkeyPatch) -> tuple[int, dict[str, doctor.Check]]:
    """Exit code and checks of a Python that has no rclpy."""
    monkeypatch.setitem(sys.modules, "rclpy", None)
    done = CliRunner().invoke(app, ["doctor", "--json"])
    checks = [doctor.Check(**check) for check in json.loads(done.stdout)["checks"]]
    return done.exit_code, {check.name: check for check in checks}


def test_without_ros_and_workspace_nothing_has_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As with the wheels: what is there works, and what ROS is needed for is told."""
    for name in ("ROS_DISTRO", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name)
    code, checks = _examined(monkeypatch)
    assert code == Exit.OK
    assert checks["ROS 2"].state == "warning"
    assert "form, play and nodes" in checks["ROS 2"].advice
    assert checks["libraries"].state == "ok"
    assert not {"nodes", "DDS", "discovery"} & set(checks)


def test_a_workspace_that_is_not_whole_is_set_up_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """By what does that and no more."""
    monkeypatch.setattr(doctor, "EXECUTABLES", (("isf_force_ctrl", "weather"),))
    monkeypatch.setattr(doctor, "LIBRARIES", ("numpy", "no_such_library"))
    code, checks = _examined(monkeypatch)
    assert code == Exit.CHECK_FAILED
    for name in ("rclpy", "nodes"):
        assert checks[name].state == "failed"
        assert "./scripts/setup.sh --force" in checks[name].advice
    assert (SOURCES.parents[1] / "scripts" / "setup.sh").is_file()
