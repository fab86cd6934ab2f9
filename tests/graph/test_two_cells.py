"""Two cells in one ROS domain: a namespace each, a clock each, and diagnostics shared or not, as nodes.md says."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from isf_cell.processes.process_group import ProcessGroup
from isf_ros import qos
from quick_cone import quick_cone_file
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]

LIMIT = 120.0
"""s; only to end a test that hangs."""


@pytest.fixture
def node() -> Iterator[Node]:
    rclpy.init()
    made = rclpy.create_node("observer")
    try:
        yield made
    finally:
        made.destroy_node()
        rclpy.try_shutdown()


def test_each_cell_has_its_own_time_and_may_have_its_own_diagnostics(node: Node, tmp_path: Path) -> None:
    job = str(quick_cone_file(tmp_path))
    clocks: dict[str, int] = {"/clock": 0, "/cell_1/clock": 0, "/cell_2/clock": 0}
    told: dict[str, set[str]] = {"/diagnostics": set(), "/cell_2/diagnostics": set()}

    def count(topic: str) -> Callable[[Any], None]:
        def heard(_: Any) -> None:
            clocks[topic] += 1

        return heard

    def keep(topic: str) -> Callable[[DiagnosticArray], None]:
        return lambda message: told[topic].update(status.name for status in message.status)

    for topic in clocks:
        node.create_subscription(Clock, topic, count(topic), qos.SENSOR)
    for topic in told:
        node.create_subscription(DiagnosticArray, topic, keep(topic), 10)
    options = {"autostart": True, "job": job}
    with ProcessGroup(tmp_path) as group:
        own_clock = "/clock:=clock"
        group.start("isf_sim", "machine", options, remap=["__ns:=/cell_1", own_clock])
        group.start("isf_sim", "machine", options, remap=["__ns:=/cell_2", own_clock, "/diagnostics:=diagnostics"])
        done = lambda: min(clocks["/cell_1/clock"], clocks["/cell_2/clock"]) > 3 and all(told.values())  # noqa: E731
        deadline = time.monotonic() + LIMIT
        while not done() and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.1)
        assert done(), (clocks, told)
    assert clocks["/clock"] == 0
    assert told == {"/diagnostics": {"/cell_1/machine"}, "/cell_2/diagnostics": {"/cell_2/machine"}}
