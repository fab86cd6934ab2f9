"""Lint by the tools of ament, as ``colcon test`` runs it for packages of ROS 2; setup.cfg says what flake8 seeks."""

from __future__ import annotations

from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1]
OTHER_STYLE = ["D205", "D209", "D213", "D400", "D401", "D402", "D403", "D413", "D415", "D417"]
"""Of pep257: a summary here may begin with the thing that is returned or its symbol and go on in the next line, and has
no sections where arguments are told in the sentence."""

pytestmark = pytest.mark.linter


def test_flake8(monkeypatch: pytest.MonkeyPatch) -> None:
    from ament_flake8.main import main_with_errors

    monkeypatch.chdir(PACKAGE)
    code, errors = main_with_errors(["--config", "setup.cfg"])
    assert code == 0, "\n".join(errors)


def test_pep257(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    from ament_pep257.main import main

    monkeypatch.chdir(PACKAGE)
    assert main([".", "--add-ignore", *OTHER_STYLE]) == 0, capfd.readouterr().err


def test_xml(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of ROS from apt alone, and with a network: the schema of package.xml is at ros.org."""
    main = pytest.importorskip("ament_xmllint.main", reason="of ROS from apt; tests/repository does without").main
    monkeypatch.chdir(PACKAGE)
    assert main(["."]) == 0
