"""A part that is formed is reported, whatever becomes of the uncorrected one that it was to be compared with."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from isf_cell.commands import form, report, simulate
from isf_cell.options import RunOptions
from isf_cell.processes.reference_run import ReferenceRun
from isf_cell.run import graph_run
from isf_core.errors import ErrorCode, IsfError
from synthetic_part import make_part

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "mini_cone.yaml"


@pytest.fixture
def finished(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Calls of finish(): folder and bag of the reference."""
    calls: list[tuple[Any, ...]] = []

    def finish(folder: Path, reference: Path | None, **_: Any) -> None:
        calls.append((folder.name, reference))

    monkeypatch.setattr(simulate, "finish", finish)
    monkeypatch.setattr(report, "finish", finish)
    return calls


@pytest.fixture(params=[KeyboardInterrupt(), IsfError(ErrorCode.BAG_INCOMPLETE, "the uncorrected reference failed: x")])
def lost(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The uncorrected part is started and never ends well."""

    def wait(_: ReferenceRun) -> None:
        raise request.param

    monkeypatch.setattr(ReferenceRun, "wait", wait)
    real = subprocess.Popen
    # the fault itself: a reference that does not end by itself; leaving ReferenceRun ends it
    sleep = [sys.executable, "-c", "import time; time.sleep(60)"]
    monkeypatch.setattr(
        "isf_cell.processes.reference_run.subprocess.Popen", lambda _, **options: real(sleep, **options)
    )


@pytest.mark.usefixtures("lost")
def test_a_simulated_part_is_reported_without_its_reference(
    tmp_path: Path, finished: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(simulate, "_form", lambda *_: make_part(contours=3, spacing=5e-3))
    simulate.simulate_part(JOB, RunOptions(correction="analytic"), tmp_path / "run", compare=True, as_json=False)
    assert finished == [("run", None)]
    assert (tmp_path / "run" / "bag" / "metadata.yaml").is_file()
    assert "the part is reported without the uncorrected one" in " ".join(capsys.readouterr().err.split())


@pytest.mark.usefixtures("lost")
def test_a_part_formed_by_nodes_is_reported_without_its_reference(
    tmp_path: Path, finished: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    result = SimpleNamespace(contours=3, ticks=9, late_ticks=0, lost_messages=0, sim_time=1.0, wall_time=2.0)
    monkeypatch.setattr(graph_run, "form", lambda *_, **__: (result, None))
    options = RunOptions(correction="analytic")
    form.form_part(JOB, options, tmp_path / "run", compare=True, lockstep=True, dashboard=False, as_json=False)
    assert finished == [("run", None)]
    assert "the part is reported without the uncorrected one" in " ".join(capsys.readouterr().err.split())
