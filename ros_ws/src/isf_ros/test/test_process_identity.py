"""A process is told from one that has ended, from a later one with its number, and from one that cannot be seen."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from isf_ros import process_identity
from isf_ros.process_identity import identity, running


def test_this_process_runs() -> None:
    mine = identity()
    assert running(mine) is True
    number, _, computer = mine.partition("@")
    pid, _, start = number.partition(":")
    assert running(f"{pid}:{int(start) + 1}@{computer}") is False  # a later process of the same number
    assert running(f"{number}@another") is None
    assert running("") is None
    assert running("4711@somewhere") is None


def test_a_process_that_ended_does_not_run_although_nobody_asked_for_its_code() -> None:
    script = "from isf_ros.process_identity import identity; print(identity(), flush=True); input()"
    command = [sys.executable, "-c", script]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        told = process.stdout.readline().strip()
        assert running(told) is True
        process.send_signal(signal.SIGSTOP)
        while running(told):  # stopped by the system a moment later
            pass
        assert running(told) is None  # it may never go on
        process.send_signal(signal.SIGCONT)
        while running(told) is None:
            pass
        assert running(told) is True
        process.kill()
        process.stdout.read()  # its end
        while running(told):  # ended by the system a moment later
            pass
        assert running(told) is False
        assert process.returncode is None  # a zombie until it is waited for


def test_a_process_that_the_system_does_not_show_has_not_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As with /proc mounted with hidepid, or of another user."""
    mine = identity()
    number, _, computer = mine.partition("@")
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        ended.wait()
    monkeypatch.setattr(process_identity, "_PROCESSES", tmp_path)
    assert running(mine) is None
    assert running(f"{ended.pid}:1@{computer}") is False
    hidden = tmp_path / number.partition(":")[0]
    hidden.mkdir()
    (hidden / "stat").mkdir()  # an error of another kind when it is read
    assert running(mine) is None
