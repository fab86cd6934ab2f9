"""Coarse solutions in a thread of their own, so that no tick waits for one.

A solution is begun from a copy of everything it needs and is taken over at a place on the path that does not depend on
when it is ready; a run is the same bit by bit with and without the thread. A solution is compiled code from end to end
(:mod:`isf_sim.shell_equilibrium`), so the interpreter is free while the thread works.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from isf_sim.shell import Deflection


class SolutionWorker:
    """At most one solution under way; no part of a machine's state.

    Attributes
    ----------
    ahead : True: solutions are computed in the thread; False: at once, by the caller
    late : solutions that were not ready where the path needed them ; longest : s, longest time the caller waited
    failed : solutions that the thread did not bring about and the caller found itself
    """

    constant_of_state = True

    def __init__(self) -> None:
        self.ahead = False
        self.late = self.failed = 0
        self.longest = 0.0
        self._failure = ""
        self._executor: ThreadPoolExecutor | None = None
        self._future: Future[Deflection] | None = None
        self._solve: Callable[[], Deflection] | None = None
        self._found: Deflection | None = None

    def begin(self, solve: Callable[[], Deflection]) -> None:
        """Start ``solve``; what it reads and writes belongs to it until :meth:`wait`. It may be called twice."""
        self._found = None
        if not self.ahead:
            self._found = solve()
            return
        self._solve = solve
        try:
            if self._executor is None:
                self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="coarse-shell")
            self._future = self._executor.submit(solve)
        except RuntimeError as error:  # no thread to be had
            self._note_failure(error)
            self._found = solve()

    def wait(self) -> Deflection | None:
        """The solution begun last, None when there is none or it was asked for before."""
        if self._future is not None and self._solve is not None:
            future, self._future = self._future, None
            ready, started = future.done(), time.monotonic()
            try:
                self._found = future.result()
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

    def new_failure(self) -> str:
        """What failed since the last call, for people; empty: nothing."""
        failure, self._failure = self._failure, ""
        return failure

    def _note_failure(self, error: Exception) -> None:
        self.failed += 1
        self._failure = f"a tick found a coarse solution that its thread did not ({type(error).__name__}: {error})"

    def __deepcopy__(self, memo: dict[int, Any]) -> SolutionWorker:
        worker = SolutionWorker()
        worker.ahead = self.ahead
        return worker
