"""How many files a reader passes through to follow one action of the software, traced while it happens."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_core.contour import Contour
from isf_core.files.job import load_job
from isf_force_ctrl.control_state import Mode
from isf_force_ctrl.controller import ForceController
from isf_planner import plan
from isf_springback.corrector import Corrector
from quick_cone import LONGER, quick_cone

resolved = cache(lambda name: str(Path(name).resolve()))
SOURCES = str(Path(__file__).resolve().parents[2] / "ros_ws" / "src")


def changes_of_file(action: Callable[[], Any]) -> list[tuple[str, str]]:
    """Calls from a function of one file of the project to a function of another one, inside ``action``, in order.

    Compiled kernels and generated functions (of dataclasses) have no file and do not count.
    """
    changes: list[tuple[str, str]] = []
    inside: list[str] = []

    def watch(frame: FrameType, event: str, _: object) -> None:
        name = frame.f_code.co_filename
        if not name.startswith("<") and (found := resolved(name)).startswith(SOURCES):
            if event == "call":
                if inside and inside[-1] != found:
                    changes.append((Path(inside[-1]).name, Path(found).name))
                inside.append(found)
            elif event == "return" and inside:
                inside.pop()

    sys.setprofile(watch)
    try:
        action()
    finally:
        sys.setprofile(None)
    return changes


def files_entered(action: Callable[[], Any]) -> set[str]:
    """Files of the project of which a function is called inside ``action``; what has no file does not count."""
    entered: set[str] = set()

    def watch(frame: FrameType, event: str, _: object) -> None:
        name = frame.f_code.co_filename
        if event == "call" and not name.startswith("<") and (found := resolved(name)).startswith(SOURCES):
            entered.add(found.removeprefix(SOURCES))

    sys.setprofile(watch)
    try:
        action()
    finally:
        sys.setprofile(None)
    return entered


@pytest.mark.parametrize("method", ["analytic", "fused"])
def test_one_correction_changes_file_at_most_30_times(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last contour of a part, with all that was measured before it; the elastic shell is an engine of its own."""
    correct, seen = Corrector.correct, []

    def traced(self: Corrector, contour: Contour) -> Any:
        found: list[Any] = []
        seen.append(changes_of_file(lambda: found.append(correct(self, contour))))
        return found[0]

    monkeypatch.setattr(Corrector, "correct", traced)
    in_process.form(
        quick_cone(f"scan_every: 1\n  method: {method}\n  fused: {{model: analytic}}", step=LONGER), RunOptions()
    )
    assert len(seen) == 5
    assert len(seen[-1]) <= 30, seen[-1]


def test_one_force_tick_enters_at_most_5_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every tick in force control or position control, but those at which a contour begins or ends."""
    tick = ForceController.tick
    entered: dict[Mode, set[str]] = {}

    def traced(self: ForceController, *arguments: Any) -> Any:
        found: list[Any] = []
        mode = self.mode
        files = files_entered(lambda: found.append(tick(self, *arguments)))
        if self.mode is mode:
            entered.setdefault(mode, set()).update(files)
        return found[0]

    monkeypatch.setattr(ForceController, "tick", traced)
    in_process.form(quick_cone("method: none"), RunOptions())
    for mode in (Mode.ENGAGE, Mode.CONTROL, Mode.POSITION):
        assert len(entered[mode]) <= 5, (mode.name, sorted(entered[mode]))


def test_planning_enters_at_most_25_files() -> None:
    job_file = load_job(Path(SOURCES).parents[1] / "examples" / "jobs" / "ren_cone.yaml")
    entered = files_entered(lambda: plan(job_file))
    assert len(entered) <= 25, sorted(entered)
