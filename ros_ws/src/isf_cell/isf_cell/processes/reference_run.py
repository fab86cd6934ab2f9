"""The uncorrected part on the same plant, simulated beside the run it is compared with.

A process of its own at low priority, so that it uses the time the run leaves. It ends with its owner, however that
ends, and what it left unfinished is removed.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from isf_core.errors import ErrorCode, IsfError
from isf_sim.explicit_shell.library import THREADS

from isf_cell.commands.exit_codes import Exit
from isf_cell.options import UNCORRECTED, RunOptions
from isf_cell.processes.process_group import ends_with_owner


class ReferenceRun:
    """``isf simulate JOB --correction none`` in the background; ended with its owner."""

    def __init__(self, job: Path, options: RunOptions, folder: Path) -> None:
        self.folder = folder
        self._log = folder.with_suffix(".log")
        command = [sys.executable, "-m", "isf_cell.cli", "simulate", str(job), "--correction", UNCORRECTED]
        command += ["--no-compare", "--variant", str(options.variant), "--seed", str(options.seed), "-o", str(folder)]
        if options.sheet is not None:
            command += ["--sheet", options.sheet]
        if options.support_force is not None:
            command += ["--support-force", repr(options.support_force)]
        end_with_owner = ends_with_owner(signal.SIGKILL)
        if len(os.sched_getaffinity(0)) < 4:  # two sheets at a time: a thread each
            os.environ.setdefault(THREADS, "1")

        def prepare() -> None:
            os.nice(10)
            end_with_owner()

        with self._log.open("wb") as log:
            self._popen = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=prepare,
            )

    @property
    def bag(self) -> Path:
        """Bag of the reference, complete after :meth:`wait`."""
        return self.folder / "bag"

    def wait(self) -> None:
        """Wait for the end; raises IsfError with the last line of its output when it failed.

        A reference that was stopped by its process, as by a torn sheet, is one: its report says so.
        """
        if self._popen.wait() not in (Exit.OK, Exit.PROCESS) or not self.bag.exists():
            lines = self._log.read_text(errors="replace").strip().splitlines() or ["no output"]
            raise IsfError(
                ErrorCode.BAG_INCOMPLETE,
                f"the uncorrected reference failed: {lines[-1]}",
                advice=f"see {self._log}, or run with --no-compare",
            )

    def bag_at_end(self, warn: Callable[[str], None]) -> Path | None:
        """Its bag when it has ended; None, and why is told to ``warn``, when it failed or Ctrl-C ends the waiting.

        The part that it is compared with is formed by then: it is reported without it.
        """
        try:
            self.wait()
        except IsfError as error:
            warn(f"the part is reported without the uncorrected one: {error}")
        except KeyboardInterrupt:
            warn("stopped by the operator: the part is reported without the uncorrected one")
        else:
            return self.bag
        return None

    def __enter__(self) -> ReferenceRun:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._popen.poll() is None:
            self._popen.kill()
            self._popen.wait()
            shutil.rmtree(self.folder, ignore_errors=True)
            self._log.unlink(missing_ok=True)
