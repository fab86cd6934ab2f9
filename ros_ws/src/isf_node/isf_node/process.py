"""How every node's process runs: start, spin until SIGINT or SIGTERM, end with a meaningful exit code."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import rclpy
from isf_core.errors import IsfError
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from isf_node.lifecycle import CellNode

EXIT_OK, EXIT_ERROR = 0, 2


def spin(node: Node) -> None:
    """Serve ``node`` until the context is shut down.

    A SingleThreadedExecutor: the MultiThreadedExecutor of rclpy 7.1 loses messages of nodes with subscriptions.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    finally:
        executor.remove_node(node)


def run(make_node: Callable[[], CellNode[Any]], args: list[str] | None = None) -> int:
    """Run one node in this process; returns the exit code."""
    node: CellNode[Any] | None = None
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.ALL)
    try:
        node = make_node()
        spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except IsfError as error:
        print(error, file=sys.stderr)
        return EXIT_ERROR
    finally:
        if node is not None:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()
    return EXIT_OK
