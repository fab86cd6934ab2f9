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


def spoil(cell: Cell, fault: Path, word: str) -> None:
    """Let the control law fail as ``word`` says, in a contour that is being formed."""
    begun = len(cell.states)
    cell._contours.publish(conversion.contour_to_message(long_ring()))
    assert cell.wait(lambda: any(state.mode == ForceCtrlState.CONTROL for state in cell.states[begun:]))
    fault.write_text(word)


def test_a_fault_in_one_tick_ends_the_contour_with_a_code(cell: Cell, fault: Path) -> None:
    """The tools are held, and can be lifted and go on."""
    cell.start(program=PROGRAM)
    cell.armed()
    spoil(cell, fault, "once")
    assert cell.wait(lambda: len(cell.results) > 0)
    result = cell.results[-1]
    assert (result.completed, result.code) == (False, ErrorCode.INTERNAL)
    assert "IndexError: in a control law" in result.message
    assert cell.rests_in(ForceCtrlState.HOLD)
    assert cell.arm(plan_id="").code == 0
    assert cell.rests_in(ForceCtrlState.IDLE)
    cell.armed()
    assert cell.form(small_ring()).code == 0


@pytest.mark.parametrize("lockstep", [True, pytest.param(False, marks=pytest.mark.clock)])
def test_after_faults_in_every_tick_no_target_follows(cell: Cell, fault: Path, lockstep: bool) -> None:
    """Not even a repeated one, so that the machine releases contact by itself; the node serves a new plan."""
    cell.start({"lockstep": lockstep}, program=PROGRAM, lockstep=lockstep)
    cell.armed()
    spoil(cell, fault, "always")
    assert cell.wait(lambda: len(cell.results) > 0)
    assert cell.results[-1].code == ErrorCode.INTERNAL
    seen = -1

    def silent() -> bool:
        nonlocal seen
        before, seen = seen, cell.targets
        return not cell.wait(lambda: cell.targets > before, timeout=1.0) if before == seen else False

    assert cell.wait(silent)
    fault.write_text("")
    cell.armed()
    assert cell.form(small_ring()).code == 0
