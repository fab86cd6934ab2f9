"""Processes that form parts side by side, a core each; none outlives its owner, and Ctrl-C is for the owner alone."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from isf_core.errors import ErrorCode, IsfError
from isf_sim.explicit_shell.library import THREADS

from isf_cell.processes.process_group import ends_with_owner

Task = TypeVar("Task")
Result = TypeVar("Result")


def formed_beside(
    form: Callable[[Task], Result], tasks: Sequence[Task], processes: int
) -> Iterator[tuple[Task, Result]]:
    """``form`` of every task, in the order in which they end; what ``form`` raises ends all others.

    So does leaving the loop: what runs is then killed.

    Raises
    ------
    IsfError : NODE_DIED, a process was killed from outside
    """
    context = multiprocessing.get_context("spawn")
    count = max(1, min(processes, len(tasks)))
    with ProcessPoolExecutor(count, mp_context=context, initializer=_alone, initargs=(os.getpid(),)) as pool:
        futures: dict[Future[Result], Task] = {pool.submit(form, task): task for task in tasks}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool as error:
            raise IsfError(
                ErrorCode.NODE_DIED,
                "a process that forms parts was killed from outside, often for want of memory",
                advice="fewer at a time (-j); the same command goes on",
            ) from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.kill()
            raise


def _alone(owner: int) -> None:
    """In a process of several: one thread each; Ctrl-C is for their ``owner``, with which they end."""
    ends_with_owner(signal.SIGKILL, owner)()
    os.environ[THREADS] = "1"
    signal.signal(signal.SIGINT, signal.SIG_IGN)
