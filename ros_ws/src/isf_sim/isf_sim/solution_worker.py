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
    """

    constant_of_state = True

    def __init__(self) -> None:
        self.ahead = False
        self.late = 0
        self.longest = 0.0
        self._executor: ThreadPoolExecutor | None = None
        self._future: Future[Deflection] | None = None
        self._found: Deflection | None = None

    def begin(self, solve: Callable[[], Deflection]) -> None:
        """Start ``solve``; what it reads and writes belongs to it until :meth:`wait`."""
        self._found = None
        if not self.ahead:
            self._found = solve()
            return
        if self._executor is None:
            self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="coarse-shell")
        self._future = self._executor.submit(solve)

    def wait(self) -> Deflection | None:
        """The solution begun last, None when there is none or it was asked for before."""
        if self._future is not None:
            future, self._future = self._future, None
            self._found = future.result() if future.done() else self._wait_for(future)
        found, self._found = self._found, None
        return found

    def _wait_for(self, future: Future[Deflection]) -> Deflection:
        started = time.monotonic()
        found = future.result()
        self.late += 1
        self.longest = max(self.longest, time.monotonic() - started)
        return found

    def __deepcopy__(self, memo: dict[int, Any]) -> SolutionWorker:
        worker = SolutionWorker()
        worker.ahead = self.ahead
        return worker
