"""Answers of services and actions that reach a client whom the middleware has not discovered yet.

The server of a service may get a request before it has discovered where the client takes its answers: the middleware
waits for 0.1 s, then drops the answer with a warning and no error, and the client waits for ever (Fast DDS under ROS 2
Jazzy; likely on a loaded computer, where discovery takes longer). Such an answer of a service is sent again. rclpy has
no place to do so for an action: its server takes a goal when it has discovered where all that ask it take the answers.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.service import Service
from rclpy.task import Future

PERIOD = 0.5
"""s between two attempts; each may hold the node up for the 0.1 s of the middleware."""

ATTEMPTS = 20
"""After so many the client is taken to have gone before it was discovered."""

POLL = 0.02
"""s between two looks at what has been discovered."""

DISCOVERED_WITHIN = 10.0
"""s after which a goal is taken though nobody is known to take the answer."""

_STEADY = Clock(clock_type=ClockType.STEADY_TIME)

_DROPPED = "failed to send response (timeout)"


def keep_answers(node: Node, service: Service) -> Service:
    """``service`` of ``node``, whose answers are sent again where the middleware drops them."""
    service.send_response = sent_until_taken(service.send_response, lambda action: once(node, action, PERIOD))
    return service


async def client_discovered(node: Node, action: str) -> None:
    """Returns when :func:`answers_reach_all` for every service of ``action``, or after :data:`DISCOVERED_WITHIN` s."""
    services = [f"{action}/_action/{part}" for part in ("send_goal", "cancel_goal", "get_result")]
    discovered = Future()
    looks = iter(range(round(DISCOVERED_WITHIN / POLL)))

    def look() -> None:
        if all(answers_reach_all(node, name) for name in services) or next(looks, None) is None:
            discovered.set_result(None)
        else:
            once(node, look, POLL)

    look()
    await discovered


def answers_reach_all(node: Node, service: str) -> bool:
    """Whether ``node`` knows as many endpoints that take answers of ``service`` as endpoints that send it requests; by
    the names that ROS 2 gives them over DDS, so that with other middleware there are none of either."""
    name = node.resolve_service_name(service)
    asking = node.get_publishers_info_by_topic(f"rq{name}Request", no_mangle=True)
    taking = node.get_subscriptions_info_by_topic(f"rr{name}Reply", no_mangle=True)
    return len(taking) >= len(asking)


def once(node: Node, action: Callable[[], None], after: float = 0.0) -> None:
    """Have ``action`` done by ``node``, by itself, ``after`` s of wall time."""

    def act() -> None:
        node.destroy_timer(timer)
        action()

    timer = node.create_timer(after, act, clock=_STEADY)


def sent_until_taken(
    send: Callable[[Any, Any], None], later: Callable[[Callable[[], None]], None]
) -> Callable[[Any, Any], None]:
    """``send`` (response, header) of a service that sends again what was dropped; ``later`` calls a function once,
    :data:`PERIOD` later, in the thread that may send. The warning is given when the last attempt failed, too."""

    def attempt(response: Any, header: Any, left: int) -> None:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            send(response, header)
        dropped = [warning for warning in caught if _DROPPED in str(warning.message)]
        again = bool(dropped) and left > 0
        for warning in caught:
            if not (again and warning in dropped):
                warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
        if again:
            later(lambda: repeat(response, header, left - 1))

    def repeat(response: Any, header: Any, left: int) -> None:
        with suppress(InvalidHandle):  # the service was destroyed meanwhile
            attempt(response, header, left)

    return lambda response, header: attempt(response, header, ATTEMPTS - 1)
