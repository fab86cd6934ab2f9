"""What a control law raises does not end node force_ctrl, and leaves no stream of targets that presses on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from isf_core.errors import ErrorCode
from isf_msgs.msg import ForceCtrlState
from isf_ros import conversion
from node_cell import Cell, long_ring, small_ring, watched

pytestmark = pytest.mark.graph

PROGRAM = (str(Path(__file__).resolve().parents[1] / "faulty_force_ctrl.py"),)


@pytest.fixture
def fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    file = tmp_path / "fault"
    monkeypatch.setenv("FAULT", str(file))
    return file


@pytest.fixture
def cell(fault: Path) -> Iterator[Cell]:
    with watched(Cell) as found:
        yield found
        assert found.process.poll() is None


@pytest.mark.parametrize("lockstep", [True, pytest.param(False, marks=pytest.mark.clock)])
def test_a_fault_in_a_tick_ends_the_contour_with_a_code(cell: Cell, fault: Path, lockstep: bool) -> None:
    cell.start({"lockstep": lockstep}, program=PROGRAM, lockstep=lockstep)

    def spoil(word: str) -> None:
        begun = len(cell.states)
        cell._contours.publish(conversion.contour_to_message(long_ring()))
        assert cell.wait(lambda: any(state.mode == ForceCtrlState.CONTROL for state in cell.states[begun:]))
        fault.write_text(word)

    # Once: the contour ends, the tools are held, and can be lifted and go on.
    cell.armed()
    spoil("once")
    assert cell.wait(lambda: len(cell.results) > 0)
    result = cell.results[-1]
    assert (result.completed, result.code) == (False, ErrorCode.INTERNAL)
    assert "IndexError: in a control law" in result.message
    assert cell.rests_in(ForceCtrlState.HOLD)
    assert cell.arm(plan_id="").code == 0
    assert cell.rests_in(ForceCtrlState.IDLE)
    cell.armed()
    assert cell.form(small_ring()).code == 0

    # Always: no target follows, not even a repeated one, so that the machine releases contact by itself.
    cell.armed()
    spoil("always")
    assert cell.wait(lambda: len(cell.results) > 2)
    assert cell.results[-1].code == ErrorCode.INTERNAL
    seen = -1

    def silent() -> bool:
        nonlocal seen
        before, seen = seen, cell.targets
        return not cell.wait(lambda: cell.targets > before, timeout=1.0) if before == seen else False

    assert cell.wait(silent)
    fault.write_text("")
    cell.armed()  # the node lives, and serves a new plan
    assert cell.form(small_ring()).code == 0
