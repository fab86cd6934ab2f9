"""A cell that stays up for other commands (``isf cell``), as a process of its own, and commands beside it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import forked_process
from isf_cell.commands.exit_codes import Exit
from waiting import LIMIT


@contextmanager
def standing(
    folder: Path, *options: str, output: str = "cell"
) -> Iterator[tuple[forked_process.ForkedProcess, dict[str, Any]]]:
    """The command, and what it tells when its cell is up."""
    with (folder / "stderr.txt").open("w") as errors:
        process = forked_process.start(
            [sys.executable, "-m", "isf_cell.cli", "cell", *options, "-o", output, "--json"],
            stdout=subprocess.PIPE,
            stderr=errors,
            cwd=folder,
            env=dict(os.environ),
            text=True,
        )
    try:
        assert process.stdout is not None
        told = ""
        while not told.endswith("\n}\n"):
            line = process.stdout.readline()
            assert line, (folder / "stderr.txt").read_text()
            told += line
        yield process, json.loads(told)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait(LIMIT)


def isf(folder: Path, *arguments: str) -> Any:
    """The JSON object of a command that succeeds."""
    done = forked_process.run([sys.executable, "-m", "isf_cell.cli", *arguments, "--json"], cwd=folder)
    assert done.returncode == Exit.OK, done.stderr
    return json.loads(done.stdout)


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True
