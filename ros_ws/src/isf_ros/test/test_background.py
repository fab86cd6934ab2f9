"""A goal whose work takes long: it costs nothing while it waits, and its result, refusal or exception arrives."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from isf_core.errors import ErrorCode, IsfError
from isf_msgs.action import MoveAside
from isf_ros.background import in_thread
from isf_ros.lifecycle import CellNode
from isf_ros.process import make_executor
from rclpy.action import ActionClient
from rclpy.executors import Executor
from rclpy.node import Node

pytestmark = pytest.mark.graph


@dataclass(frozen=True)
class NoParameters:
    """None."""


class Waiter(CellNode[NoParameters]):
    """Does ``work`` in a thread for each goal, between two steps in the executor."""

    def __init__(self, work: Callable[[], Any]) -> None:
        super().__init__("waiter", NoParameters)
        self.work = work
        self.threads: list[str] = []
        self.create_action_server(MoveAside, "wait", self._wait, lambda _: True)

    async def _wait(self, handle: Any) -> MoveAside.Result:
        self.threads.append(threading.current_thread().name)
        text = await in_thread(self.work, self.executor)
        self.threads.append(threading.current_thread().name)
        handle.succeed()
        return MoveAside.Result(message=text)


@pytest.fixture(params=[True, False], ids=["EventsExecutor", "SingleThreadedExecutor"])
def executor(request: pytest.FixtureRequest) -> Iterator[Executor]:
    rclpy.init()
    yield make_executor(streams=request.param)
    rclpy.try_shutdown()


def served(executor: Executor, work: Callable[[], Any]) -> tuple[Any, int, list[str]]:
    """Answer to a goal; how often the executor came back meanwhile; threads of the callback's two halves."""
    node, asker = Waiter(work), Node("asker")
    client = ActionClient(asker, MoveAside, "wait")
    for each in (node, asker):
        executor.add_node(each)
    turns = 0

    def until(done: Callable[[], Any]) -> None:
        nonlocal turns
        while not done():
            executor.spin_once(timeout_sec=0.1)
            turns += 1

    try:
        until(client.server_is_ready)
        sent = client.send_goal_async(MoveAside.Goal())
        until(sent.done)
        result = sent.result().get_result_async()
        turns = 0
        until(result.done)
        return result.result(), turns, node.threads
    finally:
        for each in (node, asker):
            executor.remove_node(each)
        client.destroy()
        node.destroy_node()
        asker.destroy_node()


def test_the_executor_rests_while_a_goal_waits_for_its_work(executor: Executor) -> None:
    def work() -> str:
        threading.Event().wait(0.5)  # the work itself; a task that is run over and over comes back 100,000 times in it
        return "done"

    answer, turns, threads = served(executor, work)
    assert answer.status == GoalStatus.STATUS_SUCCEEDED
    assert answer.result.message == "done"
    assert turns < 500
    assert threads == ["MainThread", "MainThread"]


def test_an_exception_of_the_work_is_the_result_of_its_goal(executor: Executor) -> None:
    def work() -> str:
        raise IsfError(ErrorCode.NOT_ARMED, "no plan is armed")

    answer, _, threads = served(executor, work)
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert answer.result.code == 1204
    assert "no plan is armed" in answer.result.message
    assert threads == ["MainThread"]
