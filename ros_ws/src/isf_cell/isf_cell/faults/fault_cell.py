"""The cell that a campaign disturbs: real processes, of which those that a fault has ended are started again."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile

from isf_cell.faults.outside import RELAYED, Outside
from isf_cell.options import RunOptions
from isf_cell.processes.cell_nodes import CellChoice
from isf_cell.processes.domain_lock import alone_in_domain
from isf_cell.processes.process_group import NodeProcess, ProcessGroup
from isf_cell.run.checkpoint import CHECKPOINT
from isf_cell.run.graph_run import CellClient, incomplete_record, start_nodes

HANGS = 90.0
"""s after which a part that gives no result is ended by force: longer than the longest time limit within a cell."""


class FaultCell:
    """A cell in ``folder``, with force control behind an :class:`Outside`; use as a context."""

    def __init__(self, folder: Path, job_file: JobFile, *, lockstep: bool) -> None:
        self.folder, self.job_file, self.lockstep = folder, job_file, lockstep
        self.checkpoint = folder / CHECKPOINT
        self.bag = folder / "bag"
        self._group = ProcessGroup(folder / "logs")
        self._recorder: NodeProcess | None = None
        self._stopped: list[int] = []
        self._records = 0
        self._stack = ExitStack()

    def __enter__(self) -> FaultCell:
        self._stack.enter_context(alone_in_domain())
        try:
            self._client = CellClient()
            self._stack.callback(self._client.close)
            self.outside = Outside()
            remap = [f"tool_{k}/{kind}:={RELAYED}/tool_{k}/{kind}" for k in (1, 2) for kind in ("wrench", "pose")]
            choice = CellChoice(lockstep=self.lockstep, checkpoint=str(self.checkpoint), every_pose=True)
            start_nodes(self._group, choice, remap)
            self._client.wait_ready(self._group)
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.restore()
        self._group.stop()
        if hasattr(self, "outside"):
            self.outside.close()
        self._stack.close()

    # -- faults ----------------------------------------------------------------------------------

    def process(self, node: str) -> NodeProcess:
        """The running process of ``node``."""
        return self._group[node]

    def send(self, node: str, number: signal.Signals) -> None:
        """A signal to the process of ``node``."""
        process = self.process(node).popen
        if number == signal.SIGSTOP:
            self._stopped.append(process.pid)
        with suppress(ProcessLookupError):
            os.kill(process.pid, number)

    def restore(self) -> None:
        """Nothing disturbs the cell any more; what has ended stays so until :meth:`mend`."""
        for number in self._stopped:
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGCONT)
        self._stopped.clear()
        if hasattr(self, "outside"):
            self.outside.restore()

    def mend(self) -> None:
        """Start again what has ended, and wait until it is there; raises IsfError NODE_DIED, NODE_MISSING."""
        self.restore()
        ended = self._group.dead()
        if not ended:
            return
        self._client.forget()
        for node in ended:
            self._group.start_again(node)
        self._client.wait_ready(self._group)

    # -- the record ------------------------------------------------------------------------------

    def begin_record(self) -> None:
        """Start a recorder for the next part, in :attr:`bag`."""
        self._records += 1
        self.bag = self.folder / f"bag_{self._records}"
        self._recorder = self._group.start(
            "isf_analysis", "recorder", {"output": str(self.bag), "autostart": True}, outlives=True
        )
        self._client.forget()
        self._client.wait_ready(self._group)

    def end_record(self) -> IsfError | None:
        """End the recorder; what the command says of its record, None: it is whole."""
        recorder = self._recorder
        if recorder is None:
            return None
        early = not recorder.alive
        self._group.stop_one(recorder)
        self._recorder = None
        return incomplete_record(self.bag, recorder, ended_early=early)

    # -- parts -----------------------------------------------------------------------------------

    def form(self, feedback: Callable[[Any], None] = lambda _: None, *, resume: bool = False) -> tuple[int, str, int]:
        """Form a part, or the rest of the one in the checkpoint: its code, what was said, contours completed.

        A part without a result for HANGS s is ended by killing its executive: SERVICE_TIMEOUT.
        """
        hung = threading.Event()

        def end_it() -> None:
            hung.set()
            self.restore()
            self.send("executive", signal.SIGKILL)

        guard = threading.Timer(HANGS, end_it)
        guard.start()
        try:
            result = self._client.form(self.job_file, RunOptions(), feedback, self._group, resume=resume)
        except IsfError as error:
            code = ErrorCode.SERVICE_TIMEOUT if hung.is_set() else error.code
            return int(code), error.message, 0
        finally:
            guard.cancel()
        return int(result.code), str(result.message), int(result.contours)
