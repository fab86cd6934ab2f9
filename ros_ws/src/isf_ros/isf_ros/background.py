"""Long work in an action or service callback without blocking the executor.

An ``async`` callback awaits :func:`in_thread`; feedback, cancel requests and services are served meanwhile
by the node's SingleThreadedExecutor. Work whose order matters goes through a :class:`Worker`.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.executors import Executor
from rclpy.task import Future

T = TypeVar("T")


async def in_thread(work: Callable[[], T], executor: Executor) -> T:
    """Result of ``work()`` run in a thread of its own; its exception is raised here."""
    future: Future = Future(executor=executor)

    def target() -> None:
        try:
            result: Any = work()
        except BaseException as error:  # handed over to the awaiting callback, whatever it is
            future.set_exception(error)
        else:
            future.set_result(result)

    threading.Thread(target=target, name="background", daemon=True).start()
    return await future  # type: ignore[no-any-return]


class Worker:
    """Does one piece of work after the other, in the order in which they are put, in a thread of its own.

    ``failed`` is called with what a piece raised; the next one is done nevertheless. The thread ends with the process.
    """

    def __init__(self, failed: Callable[[Exception], Any]) -> None:
        self._failed = failed
        self._waiting: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._busy = False
        threading.Thread(target=self._run, name="worker", daemon=True).start()

    def add(self, work: Callable[[], None]) -> None:
        """Have ``work`` done after all that was put before."""
        self._waiting.put(work)

    @property
    def idle(self) -> bool:
        """True when nothing waits and nothing is being done."""
        return self._waiting.empty() and not self._busy

    def _run(self) -> None:
        while True:
            work = self._waiting.get()
            self._busy = True
            try:
                work()
            except Exception as error:
                self._failed(error)
            self._busy = False
