"""A client of the action ``identify`` of a running cell."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import rclpy
from isf_core.errors import ErrorCode, IsfError
from isf_identify.identification import Finding
from isf_identify.settings import IdentifySettings
from isf_msgs.action import Identify
from isf_ros.process import join_graph
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from isf_cell.processes.cell_nodes import operator_arguments
from isf_cell.processes.ctrl_c import ctrl_c_held_back
from isf_cell.run.served import Served

START, LIFTED = 10.0, 60.0
"""s: the action must be there; the tools are lifted after a cancel."""


def identify_in_cell(settings: IdentifySettings, progress: Callable[[str, float], None]) -> Finding:
    """Result of the action of the cell in this ROS domain; Ctrl-C cancels it and waits until the tools are lifted.

    Raises IsfError NODE_MISSING, BUSY, NODE_DIED.
    """
    join_graph(operator_arguments())
    node = Node(f"isf_identify_{os.getpid()}")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    client = ActionClient(node, Identify, "identify")

    def wait(condition: Callable[[], bool], timeout: float, served: Served | None = None) -> bool:
        deadline = time.monotonic() + timeout
        with ctrl_c_held_back() as let_ctrl_c_through:
            while not condition() and time.monotonic() < deadline:
                let_ctrl_c_through()
                if served is not None:
                    served.check()
                executor.spin_once(timeout_sec=0.1)
        return condition()

    try:
        if not wait(client.server_is_ready, START):
            raise IsfError(
                ErrorCode.NODE_MISSING,
                "no node serves the action 'identify'",
                advice="start the cell in this ROS domain and arm a plan; without --cell the machine is simulated",
            )
        goal = Identify.Goal(
            property=int(settings.property),
            tool=settings.tool,
            repeats=settings.repeats,
            places=settings.places.ravel().tolist(),
            max_force=settings.max_force,
        )
        sent: Future = client.send_goal_async(
            goal, feedback_callback=lambda message: progress(message.feedback.phase, message.feedback.progress)
        )
        if not wait(sent.done, START) or not sent.result().accepted:
            raise IsfError(ErrorCode.BUSY, "force_ctrl refused the goal", advice="is the node active?")
        result: Future = sent.result().get_result_async()
        try:
            wait(result.done, float("inf"), Served(client.server_is_ready, "force_ctrl"))
        except KeyboardInterrupt:
            sent.result().cancel_goal_async()
            with suppress(KeyboardInterrupt):
                wait(result.done, LIFTED)
            raise
        found = result.result().result
        value, uncertainty = np.array(found.value), np.array(found.uncertainty)
        return Finding(ErrorCode(found.code), found.message, value, uncertainty, found.file_text)
    finally:
        executor.remove_node(node)
        client.destroy()
        node.destroy_node()
        rclpy.try_shutdown()
