"""What the software of the machine raises does not end its node, is told with a code, and leaves no tool pressed."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile
from isf_msgs.msg import MachineState
from isf_msgs.srv import Reset, StateFile
from isf_ros import stamps
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.machine.state import save_machine
from machine_client import JOB, PARKED, RATE, Client, served

pytestmark = pytest.mark.graph

PROGRAM = [str(Path(__file__).resolve().parents[1] / "faulty_machine.py")]
DEPTH = 4e-3
PRESSED = (np.array([0.0, 0.0, -DEPTH]), PARKED[1])


@pytest.fixture(scope="module")
def pressed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Saved machine whose tool rests pressed into the sheet."""
    machine = SimulatedMachine(JobFile(JOB, Path(), "job"))
    machine.tare()
    for z in np.append(np.arange(0.1, -DEPTH, -0.0002), np.full(60, -DEPTH)):
        machine.tick((0.0, 0.0, z), PARKED[1])
    assert not machine.faulted
    return save_machine(machine, tmp_path_factory.mktemp("pressed") / "pressed.npz")


@pytest.fixture
def fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    file = tmp_path / "fault"
    monkeypatch.setenv("FAULT", str(file))
    return file


@pytest.fixture(params=[True, pytest.param(False, marks=pytest.mark.clock)], ids=["lockstep", "real time"])
def cell(request: pytest.FixtureRequest, fault: Path, tmp_path: Path, pressed: Path) -> Iterator[Client]:
    (tmp_path / "states").mkdir()
    shutil.copy(pressed, tmp_path / "states")
    with served(PROGRAM, tmp_path, [f"lockstep:={str(request.param).lower()}"]) as client:
        client.lockstep = request.param
        client.follow_health()
        yield client
        assert client.process.poll() is None


def load(cell: Client) -> None:
    """A pressed tool, no fault."""
    assert cell.call(StateFile, "machine/load", StateFile.Request(path="pressed.npz")).code == 0
    assert cell.wait(lambda: cell.force() > 20.0 and bool(cell.states) and cell.fault_codes() == [])


def stopped(cell: Client) -> bool:
    return cell.wait(lambda: cell.states[-1].mode == MachineState.PROTECTIVE_STOP)


def free(cell: Client) -> bool:
    return cell.wait(lambda: abs(cell.force()) < 10.0)


def reported(cell: Client, text: str) -> bool:
    """Wait for diagnostics of an internal error with ``text``."""

    def found() -> bool:
        errors = [s.message for s in cell.health if s.name == "/machine" and s.level == DiagnosticStatus.ERROR]
        return any(text in message and "1 INTERNAL" in message for message in errors)

    return cell.wait(found)


def next_tick(cell: Client) -> None:
    """Targets for one more tick in lockstep; in real time the machine ticks without."""
    if cell.lockstep:
        cell.send(cell.newest() + stamps.tick_nanoseconds(1, RATE), PRESSED)


def test_a_fault_of_the_machine_releases_contact(cell: Client, fault: Path) -> None:
    # in a tick; in that and in the release that answers it; in a timer's callback
    for word, text in (("once", "IndexError: in a tick"), ("twice", "in a tick"), ("watch", "in the look at the")):
        load(cell)
        cell.health.clear()
        fault.write_text(word)
        next_tick(cell)
        assert stopped(cell)
        assert cell.fault_codes() == [ErrorCode.INTERNAL]
        assert text in cell.states[-1].fault_messages[0]
        assert reported(cell, text)
        assert free(cell)
        fault.write_text("")


def test_a_machine_whose_ticks_fail_releases_contact_as_soon_as_they_do_not(cell: Client, fault: Path) -> None:
    load(cell)
    fault.write_text("always")
    next_tick(cell)
    assert stopped(cell)
    for _ in range(2):  # it goes on to try, and to say so
        cell.health.clear()
        assert reported(cell, "in a tick")
    assert cell.force() > 20.0
    fault.write_text("")
    assert free(cell)
    assert cell.call(Reset, "machine/reset", Reset.Request(new_blank=True)).code == 0
    assert cell.wait(lambda: cell.fault_codes() == [])


def test_a_blank_that_fails_leaves_the_machine_as_it_was(cell: Client, fault: Path) -> None:
    load(cell)
    fault.write_text("blank")
    answer = cell.call(Reset, "machine/reset", Reset.Request(new_blank=True))
    assert answer.code == ErrorCode.INTERNAL
    assert "ArithmeticError: in a new blank" in answer.message
    received = cell.received
    assert cell.wait(lambda: cell.received > received + 4)
    assert cell.force() > 20.0
