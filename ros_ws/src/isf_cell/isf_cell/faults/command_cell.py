"""``isf form`` in a process of its own with the nodes that it starts, watched from outside."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from types import TracebackType

import rclpy
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile
from isf_ros.process import join_graph

from isf_cell.faults.outside import Outside
from isf_cell.processes.cell_nodes import operator_arguments
from isf_cell.processes.process_group import ends_with_owner
from isf_cell.run.checkpoint import CHECKPOINT

ENDS = 150.0
"""s within which a command has to end after a fault; then it is ended by force."""

NODES_END = 20.0
"""s within which its nodes have to end after it."""

_CODE = re.compile(r"^error (\d+) [A-Z_]+$", re.MULTILINE)


class CommandCell:
    """One run of the command for the part in ``folder``; use as a context."""

    def __init__(self, folder: Path, job_file: JobFile, job: Path) -> None:
        self.folder, self.job_file, self.checkpoint = folder, job_file, folder / CHECKPOINT
        self._job = job
        self._stopped = False
        self._popen: subprocess.Popen[bytes] | None = None
        self._nodes: list[int] = []
        self.left: list[int] = []
        """Nodes that did not end with the command, and were killed."""

    def __enter__(self) -> CommandCell:
        join_graph(operator_arguments())
        self.outside = Outside()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.restore()
        if self._popen is not None and self._popen.poll() is None:
            self._popen.send_signal(signal.SIGINT)
            try:
                self._popen.wait(NODES_END)
            except subprocess.TimeoutExpired:
                self._popen.kill()
                self._popen.wait()
        self._end_nodes()
        self.outside.close()
        rclpy.try_shutdown()

    def form(self, *, resume: bool = False) -> tuple[int, str, int]:
        """As that of a cell: the code that the command told (OK for exit code 0), its last line, contours completed."""
        begun = len(self.outside.formed)
        words = ["--resume", str(self.folder)] if resume else [str(self._job), "-o", str(self.folder)]
        log = self.folder.with_suffix(".log")
        end_with_owner = ends_with_owner(signal.SIGINT)

        def prepare() -> None:
            end_with_owner()
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # a campaign in a shell's background ignores it

        with log.open("ab") as stream:
            before = stream.tell()
            self._popen = subprocess.Popen(
                [sys.executable, "-m", "isf_cell.cli", "form", *words, "--no-compare"],
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=prepare,
            )
            try:
                code = self._popen.wait(ENDS)
            except subprocess.TimeoutExpired:
                self.restore()
                self._popen.kill()
                code = self._popen.wait()
        self._end_nodes()
        text = log.read_bytes()[before:].decode(errors="replace")
        told = _CODE.findall(text)
        last = (text.strip().splitlines() or [""])[-1].strip()
        if code == 0:
            return 0, last, len(self.outside.formed) - (0 if resume else begun)
        if code < 0 or not told:
            return int(ErrorCode.NODE_DIED), f"ended by signal {-code}" if code < 0 else last, 0
        return int(told[-1]), last, 0

    def send(self, _: str, number: signal.Signals) -> None:
        """A signal to the command alone."""
        popen = self._popen
        if popen is None:
            return
        self._nodes = _children(popen.pid)
        self._stopped = number == signal.SIGSTOP
        with suppress(ProcessLookupError):
            os.kill(popen.pid, number)

    def restore(self) -> None:
        """It runs again."""
        self.outside.restore()
        if self._stopped and self._popen is not None:
            self._stopped = False
            self._popen.send_signal(signal.SIGCONT)

    def _end_nodes(self) -> None:
        """Wait for the nodes of a command that has ended; those that stay are ended by force."""
        self.outside.until(lambda: not any(map(_runs, self._nodes)), NODES_END)
        for number in filter(_runs, self._nodes):
            self.left.append(number)
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        self._nodes = []


def _children(number: int) -> list[int]:
    """Processes that ``number`` started."""
    try:
        text = Path(f"/proc/{number}/task/{number}/children").read_text()
    except OSError:
        return []
    return [int(word) for word in text.split()]


def _runs(number: int) -> bool:
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False
