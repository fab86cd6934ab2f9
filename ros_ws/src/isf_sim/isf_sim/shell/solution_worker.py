"""Coarse solutions in a thread of their own, so that no tick waits for one.

A solution is begun from a copy of everything it needs and is taken over at a place on the path that does not depend on
when it is ready; a run is the same bit by bit with and without the thread. A solution is compiled code from end to end
(:mod:`isf_sim.shell.shell_equilibrium`), so the interpreter is free while the thread works. What little it needs of the
interpreter it would take from the tick that begins it; so it starts after that tick, when the one who ticks has time.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from isf_core.errors import ErrorCode, IsfError

from isf_sim.shell.shell import Deflection


class SolutionWorker:
    """At most one solution under way; no part of a machine's state.

    Attributes
    ----------
    ahead : True: solutions are computed in the thread; False: at once, by the caller
    late : solutions that were not ready where the path needed them ; longest : s, longest time the caller waited
    failed : solutions that the thread did not bring about and the caller found itself
    priority : SCHED_FIFO priority of the thread, 0: ordinary scheduling
    waiting : a solution was begun whose thread has not started yet, see :meth:`start`
    """

    constant_of_state = True

    def __init__(self) -> None:
        self.ahead = self.waiting = False
        self.priority = 0
        self.late = self.failed = 0
        self.longest = 0.0
        self._failure: IsfError | None = None
        self._executor: ThreadPoolExecutor | None = None
        self._future: Future[Deflection] | None = None
        self._solve: Callable[[], Deflection] | None = None
        self._found: Deflection | None = None

    def begin(self, solve: Callable[[], Deflection]) -> None:
        """Have ``solve`` done; what it reads and writes belongs to it until :meth:`wait`. It may be called twice."""
        self._found = None
        if self.ahead:
            self._solve, self.waiting = solve, True
        else:
            self._found = solve()

    def start(self) -> None:
        """Let the thread start what was begun: when nothing waits for the caller, at the next tick at the latest."""
        if not self.waiting or self._solve is None:
            return
        self.waiting = False
        try:
            if self._executor is None:
                self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="coarse-shell")
            self._future = self._executor.submit(self._in_thread, self._solve)
        except RuntimeError as error:  # no thread to be had
            self._note_failure(error)

    def wait(self) -> Deflection | None:
        """The solution begun last, None when there is none or it was asked for before."""
        self.start()
        if self._solve is not None:
            future, self._future = self._future, None
            ready, started = future is not None and future.done(), time.monotonic()
            try:
                self._found = future.result() if future is not None else self._solve()
            except Exception as error:  # whatever it was, a machine goes on
                self._note_failure(error)
                self._found = self._solve()
            if not ready:
                self.late += 1
                self.longest = max(self.longest, time.monotonic() - started)
        found, self._found, self._solve = self._found, None, None
        return found

    def values(self) -> dict[str, object]:
        """For ``/diagnostics``."""
        return {
            "late_solutions": self.late,
            "longest_wait_ms": round(1e3 * self.longest, 3),
            "failed_solutions": self.failed,
        }

    def new_failure(self) -> IsfError | None:
        """SOLUTION_FAILED, what failed since the last call; None: nothing."""
        failure, self._failure = self._failure, None
        return failure

    def _in_thread(self, solve: Callable[[], Deflection]) -> Deflection:
        # a thread begins with the scheduling of the one that starts it, and would then hold up the ticks
        policy = os.SCHED_FIFO if self.priority else os.SCHED_OTHER
        if (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) != (policy, self.priority):
            with contextlib.suppress(OSError):  # not permitted: as it is, then
                os.sched_setscheduler(0, policy, os.sched_param(self.priority))
        return solve()

    def _note_failure(self, error: Exception) -> None:
        self.failed += 1
        self._failure = IsfError(
            ErrorCode.SOLUTION_FAILED,
            f"the tick itself computed a coarse solution that failed in its thread ({type(error).__name__}: {error})",
            where="machine",
            advice="the part goes on",
        )

    def __deepcopy__(self, memo: dict[int, Any]) -> SolutionWorker:
        worker = SolutionWorker()
        worker.ahead = self.ahead
        return worker
