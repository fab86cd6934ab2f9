"""A test's own node, served while the test waits for something."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

LIMIT = 120.0
"""s; only to end a test that hangs: a process may take long to start."""


class Waiting:
    """Serves ``node``. It stays in its executor: rclpy.spin_once() puts it into one and takes it out every time."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)

    def until(self, condition: Callable[[], Any], timeout: float = LIMIT) -> bool:
        """Whether ``condition`` holds within ``timeout`` s; looked at after every message and 20 times a second."""
        deadline = time.monotonic() + timeout
        while not (done := bool(condition())) and time.monotonic() < deadline:
            self.once()
        return done

    def once(self) -> None:
        """Wait for one message, for 50 ms at most."""
        self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        """Before the node is destroyed."""
        self._executor.shutdown()
