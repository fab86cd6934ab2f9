"""What has a part formed may die or be taken down in the middle of it: the tools leave the sheet, a code says why."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from action_msgs.srv import CancelGoal
from geometry_msgs.msg import WrenchStamped
from isf_cell.options import RunOptions
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.run import graph_run
from isf_core.errors import ErrorCode, IsfError
from isf_msgs.msg import ContourResult
from isf_ros import qos, stamps
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from quick_cone import LONGER, quick_cone
from rclpy.executors import SingleThreadedExecutor

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]

LIMIT = 120.0
"""s; only to end a test that hangs."""

UNLOADED = 10.0
"""N, above drift and noise of the load cells; tools that form or wait in contact read hundreds."""


class Cell:
    """All nodes of a cell, and an observer of its tools and contours."""

    def __init__(self, group: ProcessGroup, client: graph_run.CellClient) -> None:
        self.group, self.client = group, client
        self.node = rclpy.create_node("observer")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.results: list[ContourResult] = []
        self.forces: dict[int, float] = {}
        self.time = 0.0
        """s, of the machine."""
        self.node.create_subscription(ContourResult, "contour/result", self.results.append, qos.EVENT)
        for tool in (1, 2):
            topic = f"tool_{tool}/wrench"
            self.node.create_subscription(WrenchStamped, topic, lambda m, k=tool: self._on_wrench(k, m), qos.STREAM)

    def form(self, after_second_contour: Callable[[], None]) -> Any:
        """Result of a part while which something happens once."""
        happened: list[int] = []

        def feedback(message: Any) -> None:
            if message.phase == "forming" and message.index == 1 and not happened:
                happened.append(message.index)
                after_second_contour()

        return self.client.form(quick_cone(step=LONGER), RunOptions(), feedback, self.group)

    def wait(self, condition: Callable[[], Any]) -> bool:
        deadline = time.monotonic() + LIMIT
        while not condition() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.05)
        return bool(condition())

    def deactivate(self, name: str) -> None:
        service = self.node.create_client(ChangeState, f"{name}/change_state")
        assert service.wait_for_service(LIMIT)
        request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
        assert self.wait(service.call_async(request).done)

    def served(self) -> None:
        """What was asked is on its way."""
        self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self._executor.remove_node(self.node)
        self.node.destroy_node()

    def off_the_sheet(self) -> bool:
        """Neither tool reads a force."""
        return len(self.forces) == 2 and max(self.forces.values()) < UNLOADED

    def _on_wrench(self, tool: int, message: WrenchStamped) -> None:
        self.time = stamps.to_seconds(message.header.stamp)
        force = message.wrench.force
        self.forces[tool] = math.hypot(force.x, force.y, force.z)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    client = graph_run.CellClient()
    try:
        with ProcessGroup(tmp_path_factory.mktemp("cell")) as group:
            graph_run.start_cell(group, None, lockstep=True)
            client.wait_ready(group)
            found = Cell(group, client)
            yield found
            found.close()
    finally:
        client.close()


def test_a_node_deactivated_in_the_part_ends_it(cell: Cell) -> None:
    result = cell.form(lambda: cell.deactivate("springback"))
    assert result.code == ErrorCode.NODE_INACTIVE
    assert "'springback' is inactive" in result.message
    assert cell.wait(cell.off_the_sheet)


def test_a_cancelled_part_leaves_no_tool_on_the_sheet(cell: Cell) -> None:
    """The nodes are taken down when the tools are lifted, not before."""

    def cancel() -> None:
        client = cell.node.create_client(CancelGoal, "form_part/_action/cancel_goal")
        assert client.wait_for_service(LIMIT)
        client.call_async(CancelGoal.Request())
        cell.served()

    assert cell.form(cancel).code == ErrorCode.CANCELLED
    assert cell.wait(cell.off_the_sheet)


def test_a_dead_executive_leaves_no_tool_on_the_sheet(cell: Cell) -> None:
    """The part after those above, in the same cell; nobody is left who could stop the machine. The contour that is
    being formed is not formed to its end."""

    def kill() -> None:
        before = cell.time
        assert cell.wait(lambda: cell.time != before)  # what was heard before may be of long ago
        begun = cell.time
        assert cell.wait(lambda: cell.time > begun + 1.0)  # in the midst of the third contour
        os.killpg(cell.group["executive"].popen.pid, signal.SIGKILL)

    with pytest.raises(IsfError) as caught:
        cell.form(kill)
    assert caught.value.code == ErrorCode.NODE_DIED
    assert "was ended by SIGKILL" in caught.value.what
    assert cell.wait(lambda: any(result.code == ErrorCode.EXECUTIVE_LOST for result in cell.results))
    (lost,) = [result for result in cell.results if result.code == ErrorCode.EXECUTIVE_LOST]
    assert len(lost.tick_time)  # of the contour that was being formed
    assert not lost.completed
    assert cell.wait(cell.off_the_sheet)
