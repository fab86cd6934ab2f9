"""Long work in an action or service callback without blocking the executor.

An ``async`` callback awaits :func:`in_thread`; feedback, cancel requests and services are served meanwhile
by the node's executor. Work whose order matters goes through a :class:`Worker`.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Coroutine, Generator
from typing import Any, TypeVar

from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle
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
    return await _Outcome(future)  # type: ignore[no-any-return]


class PatientActionServer(ActionServer):
    """Resumes the callback of a goal when the work that it awaits is done.

    rclpy hands the callback to the executor as a task, and the EventsExecutor runs a task that waits over and over: a
    core would be busy for as long as the goal is. The callback is a coroutine function that awaits nothing but
    :func:`in_thread`, and is given to ``execute`` of the goal.
    """

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Callable[..., Any]) -> None:
        """As rclpy's, which this calls when the result is there."""
        finish = super().notify_execute
        _advance(execute_callback(goal_handle), lambda result: finish(goal_handle, lambda _: result))


def _advance(coroutine: Coroutine[Future, None, T], finish: Callable[[T], None]) -> None:
    """Run ``coroutine`` to its next wait, go on when that is over, and call ``finish`` with what it returns."""
    try:
        waits_for = coroutine.send(None)
    except StopIteration as end:
        finish(end.value)
    else:
        waits_for.add_done_callback(lambda _: _advance(coroutine, finish))


class _Outcome:
    """Waits for ``future``, and tells who runs the coroutine for which."""

    def __init__(self, future: Future) -> None:
        self._future = future

    def __await__(self) -> Generator[Future, None, Any]:
        while not self._future.done():
            yield self._future
        return self._future.result()


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
