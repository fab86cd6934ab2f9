"""How every node's process runs: start, spin until SIGINT or SIGTERM, end with a meaningful exit code."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from isf_core.errors import ErrorCode, IsfError
from rclpy.duration import Duration
from rclpy.executors import Executor, ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from isf_ros.lifecycle import CellNode

EXIT_OK, EXIT_ERROR = 0, 2

HAND_OVER = 2.0
"""s, longest time for which a node that ends waits for its subscribers: launch ends it by force after 5 s."""

LARGEST_DOMAIN = 232
"""Of DDS: its ports would be above 65,535 else."""

MAX_FAILURES = 100
"""Failures of the executor one after the other after which its process cannot serve and ends."""


def join_graph(args: list[str] | None = None) -> None:
    """Take part in the graph, with signals left alone (see :func:`ended_by_signal`).

    Raises IsfError ROS_NOT_STARTED for arguments, a domain or a security set-up that ROS does not take.
    """
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    advice = "look at the ROS arguments, and at ROS_DOMAIN_ID, RMW_IMPLEMENTATION and ROS_SECURITY_* in the environment"
    if domain.isdecimal() and int(domain) > LARGEST_DOMAIN:  # Fast DDS ends the whole process without an exception
        what = f"ROS_DOMAIN_ID is {domain}, domains go up to {LARGEST_DOMAIN}"
        raise IsfError(ErrorCode.ROS_NOT_STARTED, what, where="environment", advice=advice)
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # RCLError, UnknownROSArgsError, ...
        why = str(error).partition(", at /")[0].replace("failed to initialize rcl: error not set", _security())
        what = f"ROS could not be started: {why}"
        raise IsfError(ErrorCode.ROS_NOT_STARTED, what, where="environment", advice=advice) from error


def _security() -> str:
    """What it is when rcl does not say it."""
    if os.environ.get("ROS_SECURITY_ENABLE") != "true":
        return "rcl does not say why"
    keystore = os.environ.get("ROS_SECURITY_KEYSTORE", "")
    return f"security is on, and the keystore ({keystore or 'ROS_SECURITY_KEYSTORE is not set'}) has no such enclave"


def spin(node: Node, ended: Callable[[], bool], *, streams: bool = False) -> None:
    """Serve ``node`` until ``ended()``.

    Not by the MultiThreadedExecutor of rclpy 7.1, which loses messages of nodes with subscriptions. ``streams``: see
    :func:`make_executor`.
    """
    executor = make_executor(streams=streams)
    executor.add_node(node)
    failures = 0
    try:
        while not ended() and rclpy.ok():
            try:
                # spin() without a time limit never returns from the EventsExecutor of rclpy 7.1.6
                executor.spin_once(timeout_sec=0.1)
            except (ExternalShutdownException, ShutdownException):
                raise
            except Exception as error:  # not of a callback, these are guarded: of rclpy itself, or of a bad message
                failures += 1
                if failures >= MAX_FAILURES or not isinstance(node, CellNode):
                    raise
                node.fault(error, "executor")
            else:
                failures = 0
    finally:
        executor.remove_node(node)


def make_executor(*, streams: bool) -> Executor:
    """For nodes with ``streams`` at the control rate the EventsExecutor where rclpy has it: it needs half the processor
    time for a message."""
    if streams:
        try:
            from rclpy.experimental.events_executor import EventsExecutor
        except ImportError:
            return SingleThreadedExecutor()
        return EventsExecutor()
    return SingleThreadedExecutor()


def ended_by_signal() -> Callable[[], bool]:
    """Whether SIGINT or SIGTERM has come since this call; they raise no exception any more.

    As KeyboardInterrupt they may come out of rclpy as any other exception (RuntimeError from a conversion of types).
    For :func:`join_graph`.
    """
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: signals.append(received))
    return lambda: bool(signals)


def run(make_node: Callable[[], CellNode[Any]], args: list[str] | None = None, *, streams: bool = False) -> int:
    """Run one node in this process; returns the exit code. ``streams``: see :func:`spin`.

    SIGINT and SIGTERM end the loop between two callbacks, so that a node closes while it can still communicate.
    """
    atexit.register(gc.freeze)  # else the interpreter looks through all that was imported before it ends: a second
    ended = ended_by_signal()
    node: CellNode[Any] | None = None
    try:
        join_graph(args)
        node = make_node()
        spin(node, ended, streams=streams)
    except ExternalShutdownException:
        pass
    except IsfError as error:
        print(error, file=sys.stderr)
        return EXIT_ERROR
    finally:
        if node is not None:
            node.tell_end()
            node.close()
            hand_over(node)
            node.destroy_node()
        rclpy.try_shutdown()
    return EXIT_OK


def hand_over(node: Node) -> None:
    """Wait until reliable subscribers have all that was published: with its writer a message on its way would be lost.

    At most :data:`HAND_OVER` s, since a subscriber may have died without a word; topics of few messages first, for each
    of these counts.
    """
    deadline = time.monotonic() + HAND_OVER
    for publisher in sorted(node.publishers, key=lambda publisher: publisher.qos_profile.depth):
        left = deadline - time.monotonic()
        if left <= 0.0:
            return
        if publisher.get_subscription_count():
            publisher.wait_for_all_acked(Duration(seconds=left))
