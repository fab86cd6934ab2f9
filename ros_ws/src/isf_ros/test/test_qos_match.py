"""Deliveries that do not go together are told with a code; a stream published best effort is taken nevertheless."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import forked_process
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from isf_core.errors import ErrorCode
from isf_ros import qos
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

pytestmark = pytest.mark.graph

LIMIT = 120.0
"""s; only to end a test that hangs."""

CODE = f"{int(ErrorCode.QOS_INCOMPATIBLE)} QOS_INCOMPATIBLE"


class Picky:
    def __init__(self) -> None:
        self.node = rclpy.create_node("foreign_driver")
        self.reported: list[str] = []
        self.values: dict[str, str] = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/picky":
                self.reported.append(status.message)
                self.values = {item.key: item.value for item in status.values}

    def wait(self, condition: Callable[[], Any]) -> bool:
        deadline = time.monotonic() + LIMIT
        while not condition() and time.monotonic() < deadline:
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return bool(condition())

    def reports(self, topic: str, text: str) -> bool:
        return self.wait(
            lambda: any(CODE in reported and topic in reported and text in reported for reported in self.reported)
        )

    def receives(self, publisher: Any, topic: str, text: str) -> bool:
        """Publish until the node has it: best effort promises nothing."""

        def received() -> bool:
            publisher.publish(String(data=text))
            return self.values.get(topic) == text

        return self.wait(received)


@pytest.fixture(params=[False, True], ids=["waiting", "streaming"])
def picky(request: pytest.FixtureRequest) -> Iterator[Picky]:
    with forked_process.node(str(Path(__file__).with_name("picky_node.py")), streams=request.param):
        rclpy.init()
        found = Picky()
        try:
            assert found.wait(lambda: found.values.get("state") == "active")
            yield found
        finally:
            found.node.destroy_node()
            rclpy.try_shutdown()


def test_deliveries_that_do_not_go_together(picky: Picky) -> None:
    # A stream: reliable is asked for, best effort is taken, and said so; a reliable publisher goes on being heard.
    loose = picky.node.create_publisher(String, "stream", qos.SENSOR)
    assert picky.receives(loose, "stream", "best effort")
    assert picky.reports("topic stream", "node 'foreign_driver' publishes best effort")
    assert picky.values["qos_incompatible"] == "stream"
    firm = picky.node.create_publisher(String, "stream", qos.STREAM)
    assert picky.receives(firm, "stream", "reliable")

    # A latched topic: a publisher that keeps nothing for late subscribers is not taken, and said so.
    picky.node.create_publisher(String, "latched", QoSProfile(depth=1, durability=DurabilityPolicy.VOLATILE))
    assert picky.reports("topic latched", "received from node 'foreign_driver': durability volatile is offered, ")
    assert picky.reports("topic latched", "transient_local is required")
    assert picky.reports("topic latched", "(publish with reliability reliable, durability transient_local)")
    assert picky.wait(lambda: picky.values["qos_incompatible"] == "latched, stream")
    kept = picky.node.create_publisher(String, "latched", qos.LATCHED)
    assert picky.receives(kept, "latched", "transient local")

    # What the node publishes best effort is no use to who asks for reliable delivery.
    picky.node.create_subscription(String, "sensor", lambda _: None, qos.STREAM)
    assert picky.wait(lambda: picky.values["qos_incompatible"] == "latched, sensor, stream")
