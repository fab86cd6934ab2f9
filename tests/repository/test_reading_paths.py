"""How many files a reader passes through to follow one action of the software, traced while it happens."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_core.contour import Contour
from isf_springback.corrector import Corrector
from quick_cone import quick_cone

SOURCES = str(Path(__file__).resolve().parents[2] / "ros_ws" / "src")


def changes_of_file(action: Callable[[], Any]) -> list[tuple[str, str]]:
    """Calls from a function of one file of the project to a function of another one, inside ``action``, in order.

    Compiled kernels and generated functions (of dataclasses) have no file and do not count.
    """
    changes: list[tuple[str, str]] = []
    inside: list[str] = []

    def watch(frame: FrameType, event: str, _: object) -> None:
        name = frame.f_code.co_filename
        if not name.startswith("<") and (found := str(Path(name).resolve())).startswith(SOURCES):
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


@pytest.mark.parametrize("method", ["analytic", "fused"])
def test_one_correction_changes_file_at_most_30_times(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last contour of a part, with all that was measured before it."""
    correct, seen = Corrector.correct, []

    def traced(self: Corrector, contour: Contour) -> Any:
        found: list[Any] = []
        seen.append(changes_of_file(lambda: found.append(correct(self, contour))))
        return found[0]

    monkeypatch.setattr(Corrector, "correct", traced)
    in_process.form(quick_cone(f"scan_every: 1\n  method: {method}"), RunOptions())
    assert len(seen) == 5
    assert len(seen[-1]) <= 30, seen[-1]
