"""A GraphClient and the foreign server it asks, in a process of its own."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from isf_cell.run.graph_client import GraphClient
from rclpy.executors import SingleThreadedExecutor


@contextmanager
def client_of(server: str, *arguments: object, timeout: float = 60.0) -> Iterator[GraphClient]:
    """Client of a Python program ``server``; it waits ``timeout`` s for answers."""
    rclpy.init()
    node, executor = rclpy.create_node("asking"), SingleThreadedExecutor()
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    process = subprocess.Popen([sys.executable, "-c", server, *map(str, arguments)])
    made = GraphClient(node, timeout=timeout)
    try:
        yield made
    finally:
        process.kill()  # SIGTERM that comes between two waits of rclpy.spin() may not end it
        process.wait(60)
        executor.shutdown()
        spinning.join(60)
        made.close()
        node.destroy_node()
        rclpy.try_shutdown()


def no_watch() -> None:
    """Nothing else ends a wait."""
