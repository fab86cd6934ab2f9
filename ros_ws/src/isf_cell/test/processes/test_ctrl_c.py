"""Ctrl-C in the middle of what must not be interrupted: it comes later, and nothing crashes or is lost by it."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from isf_cell.options import RunOptions
from isf_cell.processes.ctrl_c import ctrl_c_handled_by, ctrl_c_held_back, interrupt
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.run.graph_run import CellClient
from isf_core.files.job import load_job

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "mini_cone.yaml"


@pytest.fixture(autouse=True)
def usual_handler() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    assert signal.signal(signal.SIGINT, before) is signal.default_int_handler


@pytest.fixture(autouse=True)
def lines_measured_anew() -> Iterator[None]:
    before = sys.gettrace()
    yield
    sys.settrace(before)


def interrupted(done: list[str], *, let_through: bool) -> None:
    """Ctrl-C in the middle of something; ``done`` tells how far it went."""
    with ctrl_c_held_back() as let_ctrl_c_through:
        let_ctrl_c_through()
        signal.raise_signal(signal.SIGINT)
        done.append("taken and handed on")
        if let_through:
            let_ctrl_c_through()
        done.append("the next one taken")


@pytest.mark.parametrize("let_through", [True, False])
def test_it_comes_where_it_is_let_through_and_at_the_end_at_the_latest(let_through: bool) -> None:
    done: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        interrupted(done, let_through=let_through)
    assert done == ["taken and handed on", "the next one taken"][: 1 if let_through else 2]


def test_where_it_is_ignored_it_stays_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with ctrl_c_held_back() as let_through:
        signal.raise_signal(signal.SIGINT)
        let_through()
    assert signal.signal(signal.SIGINT, signal.default_int_handler) is signal.SIG_IGN


@numba.njit
def _longer_than_a_while(values: Any) -> Any:
    """Takes some tenths of a second; the array that it returns is boxed by Python code which it calls back."""
    total = 0.0
    for step in range(100_000_000):
        total = 0.5 * total + step % 7
    return values + total


def test_it_does_not_come_while_a_compiled_function_calls_python_back() -> None:
    """Raised there, it ends the process: SystemError or a crash."""
    results = [_longer_than_a_while(np.zeros(3))]

    def interrupted_by_a_timer() -> None:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        for _ in range(3):
            results.append(_longer_than_a_while(results[-1]))

    before = signal.signal(signal.SIGALRM, interrupt)  # the timer's signal instead of one from a keyboard
    with pytest.raises(KeyboardInterrupt):
        interrupted_by_a_timer()
    signal.signal(signal.SIGALRM, before)
    assert len(results) == 2
    assert sys.gettrace() is None


def test_an_import_is_not_left_half_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "import signal\nsignal.raise_signal(signal.SIGINT)\nvalue = 1\n"
    (tmp_path / "interrupted_while_imported.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(KeyboardInterrupt), ctrl_c_handled_by(interrupt):
        import interrupted_while_imported  # noqa: F401
    assert sys.modules["interrupted_while_imported"].value == 1


def test_it_comes_at_once_elsewhere() -> None:
    done = []

    def interrupted() -> None:
        done.append("before")
        signal.raise_signal(signal.SIGINT)
        done.append("after")

    with pytest.raises(KeyboardInterrupt), ctrl_c_handled_by(interrupt):
        interrupted()
    assert done == ["before"]


@pytest.mark.graph
def test_a_part_interrupted_between_taking_and_handing_on_still_gives_its_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An executive alone, which misses its nodes: Ctrl-C while a message of the action is in the executor's hands."""
    lost: list[dict[str, Any]] = []
    client = CellClient()
    take = client._action.take_data

    def take_and_be_interrupted() -> dict[str, Any]:
        data: dict[str, Any] = take()
        if client._action._pending_result_requests and not lost:
            lost.append(data)
            signal.raise_signal(signal.SIGINT)
        return data

    monkeypatch.setattr(client._action, "take_data", take_and_be_interrupted)
    try:
        with ProcessGroup(tmp_path / "logs") as group:
            group.start("isf_cell", "executive", {"service_timeout": 1.0})
            client.wait_ready(group)
            with suppress(KeyboardInterrupt):
                result = client.form(load_job(JOB), RunOptions(), lambda _: None, group)
    finally:
        client.close()
    assert lost
    assert result.contours == 0
    assert result.code
