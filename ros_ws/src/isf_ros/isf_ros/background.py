"""Long work in an action or service callback without blocking the executor.

An ``async`` callback awaits :func:`in_thread`; feedback, cancel requests and services are served meanwhile
by the node's SingleThreadedExecutor.
"""

from __future__ import annotations

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
