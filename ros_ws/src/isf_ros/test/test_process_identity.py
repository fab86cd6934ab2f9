"""A process is told from one that has ended, from a later one with its number, and from one that cannot be seen."""

from __future__ import annotations

import subprocess
import sys

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
        process.kill()
        process.stdout.read()  # its end
        while running(told):  # ended by the system a moment later
            pass
        assert running(told) is False
        assert process.returncode is None  # a zombie until it is waited for
