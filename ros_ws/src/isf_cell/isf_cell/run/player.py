"""A bag played into the ROS graph: its messages as they were recorded, at their times, at any rate.

Messages are published as the bytes they were received as; nothing is taken apart. Publishers have the quality of
service that was recorded, so that latched topics are latched again. While it plays, ``player/pause``
(std_srvs/SetBool) holds it and ``player/step`` (std_srvs/Trigger) plays one more message.
"""

from __future__ import annotations

import gc
import importlib
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any

import rclpy
from isf_analysis.bag import playback
from isf_analysis.bag.open_bag import OpenBag
from isf_analysis.bag.playback import Recorded
from isf_core.errors import ErrorCode, IsfError
from isf_ros import stamps
from isf_ros.answers import keep_answers
from isf_ros.process import join_graph
from isf_ros.thread_priority import RealTimeSettings, acquire, release
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Connection, QosReliability
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from isf_cell.processes.cell_nodes import operator_arguments

CLOCK = "/clock"
DEPTH = 1000
"""Messages of a reliable topic that are kept until they are acknowledged."""

AHEAD = 64_000_000
"""Bytes that are read before they are due."""

BESIDES = 500
"""Bytes that a message takes beside its data."""

PRIORITY = 10
"""SCHED_FIFO priority while it plays, where the system permits it: below that of the nodes of a cell. With ordinary
scheduling whatever else runs makes messages late."""

SWITCH = 2e-4
"""s after which the reading thread lets the playing one go on."""


@dataclass
class Playing:
    """What is to be played.

    Attributes
    ----------
    rate : of time; 2: twice as fast
    begin : ns since 1970, messages before are left out but for the last one of latched topics
    remap : topic to the name that it is published by
    delay : s before the first message, for subscribers to find the publishers
    clock : Hz of ``/clock`` with the time of the recording; 0: none but a recorded one
    paused : at the first message
    """

    rate: float = 1.0
    begin: int = 0
    remap: Mapping[str, str] = field(default_factory=dict)
    delay: float = 1.0
    clock: float = 0.0
    paused: bool = False


@dataclass
class Played:
    """What was played: ``messages``, ``seconds`` of wall time, how late each was published, s, and the SCHED_FIFO
    ``priority`` that the system granted, 0: none."""

    messages: int = 0
    seconds: float = 0.0
    priority: int = 0
    late: list[float] = field(default_factory=list)


class Player:
    """A node that plays; :meth:`close` it."""

    def __init__(self, bag: OpenBag, connections: Sequence[Connection], playing: Playing) -> None:
        """Raises IsfError FILE_NOT_FOUND for message types that are not installed."""
        self._bag, self._connections, self._playing = bag, list(connections), playing
        kinds = {connection.msgtype: _message_class(connection.msgtype) for connection in connections}
        join_graph(operator_arguments())
        self._node = Node("player")
        self._outputs = {
            connection.id: self._node.create_publisher(
                kinds[connection.msgtype], playing.remap.get(connection.topic, connection.topic), _profile(connection)
            )
            for connection in connections
        }
        recorded = any(connection.topic == CLOCK for connection in connections)
        self._clock = self._node.create_publisher(Clock, CLOCK, 10) if playing.clock and not recorded else None
        self._operator = threading.Condition()
        self._steps = 0
        self._paused = playing.paused
        self._start = 0.0
        keep_answers(self._node, self._node.create_service(SetBool, "player/pause", self._on_pause))
        keep_answers(self._node, self._node.create_service(Trigger, "player/step", self._on_step))
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin, name="player services", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def play(self, progress: Callable[[int, float], None] = lambda *_: None) -> Played:
        """Play to the end; ``progress`` is told messages and s of the recording once a second."""
        playing, played = self._playing, Played()
        for message in playback.latched_before(self._bag, self._connections, playing.begin):
            self._outputs[message.connection.id].publish(message.data)
            played.messages += 1
        reading = ReadAhead(playback.in_order(self._bag, self._connections, playing.begin))
        with _no_collection(), _ahead_of_others() as played.priority, reading as messages:
            self._play(messages, played, progress)
        self._wait_for_acknowledgement()
        return played

    def _play(self, messages: Iterable[Recorded], played: Played, progress: Callable[[int, float], None]) -> None:
        playing = self._playing
        self._start = time.monotonic() + playing.delay  # subscribers find publishers in their own time
        self._wait_until(0.0, step=False)
        begun, first, told, ticked = time.monotonic(), None, 0.0, -1
        for message in messages:
            first = message.time if first is None else first
            since = (message.time - first) * 1e-9
            ticked = self._tick(first, since, ticked)
            due = self._wait_until(since)
            self._outputs[message.connection.id].publish(message.data)
            played.late.append(time.monotonic() - due)
            played.messages += 1
            if time.monotonic() - told > 1.0:
                told = time.monotonic()
                progress(played.messages, since)
        played.seconds = time.monotonic() - begun

    def _tick(self, first: int, since: float, ticked: int) -> int:
        """Publish the clock up to ``since`` s of the recording; the number of the last tick."""
        if self._clock is None:
            return ticked
        period = 1.0 / self._playing.clock
        while (ticked + 1) * period <= since * (1 + 1e-12):
            self._wait_until((ticked + 1) * period, step=False)
            ticked += 1
            self._clock.publish(Clock(clock=stamps.to_stamp(first + round(ticked * period * stamps.NANO))))
        return ticked

    def _wait_until(self, since: float, *, step: bool = True) -> float:
        """Wait for ``since`` s of the recording and return when that was, s of the monotonic clock.

        A pause, also one that begins meanwhile, moves all that is left by as long as it takes; a step of the operator
        ends the wait at once, and is used up by it if ``step``.
        """
        with self._operator:
            while True:
                if self._paused:
                    held = time.monotonic()
                    self._operator.wait_for(lambda: not self._paused or self._steps > 0)
                    now = time.monotonic()
                    if self._steps:
                        self._steps -= step
                        self._start = now - since / self._playing.rate
                        return now
                    self._start += now - held
                due = self._start + since / self._playing.rate
                left = due - time.monotonic()
                if left <= 0.0:
                    return due
                self._operator.wait(min(left, threading.TIMEOUT_MAX))

    def _wait_for_acknowledgement(self) -> None:
        for publisher in self._outputs.values():
            publisher.wait_for_all_acked(Duration(seconds=2.0))

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._operator:
            self._paused = bool(request.data)
            if not self._paused:
                self._steps = 0
            self._operator.notify()
        response.success = True
        response.message = "paused" if request.data else "playing"
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._operator:
            response.success = self._paused
            response.message = "" if self._paused else "not paused"
            self._steps += self._paused
            self._operator.notify()
        return response


class ReadAhead:
    """An iterator over the same ``messages``, read by a thread of its own up to :data:`AHEAD` before they are due:
    taking a chunk of a bag apart takes longer than two messages are apart. A context: the thread ends with it."""

    def __init__(self, messages: Iterator[Recorded]) -> None:
        self._messages = messages
        self._changed = threading.Condition()
        self._waiting: deque[Recorded] = deque()
        self._held = 0
        self._read = self._closed = False
        self._error: Exception | None = None
        self._reader = threading.Thread(target=self._run, name="bag reader", daemon=True)
        self._interval = sys.getswitchinterval()

    def __enter__(self) -> ReadAhead:
        sys.setswitchinterval(SWITCH)
        self._reader.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._reader.join()
        sys.setswitchinterval(self._interval)

    def __iter__(self) -> ReadAhead:
        return self

    def __next__(self) -> Recorded:
        """Raises what the ``messages`` raise."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._read)
            if not self._waiting:
                raise self._error or StopIteration
            message = self._waiting.popleft()
            self._held -= len(message.data) + BESIDES
            self._changed.notify_all()
            return message

    def _run(self) -> None:
        try:
            for message in self._messages:
                if not self._put(message):
                    break
        except Exception as error:  # raised where it is waited for
            self._error = error
        with self._changed:
            self._read = True
            self._changed.notify_all()

    def _put(self, message: Recorded) -> bool:
        """False when nobody wants it; one message is taken, however large it is."""
        size = len(message.data) + BESIDES
        with self._changed:
            self._changed.wait_for(lambda: self._closed or not self._waiting or self._held + size <= AHEAD)
            self._waiting.append(message)
            self._held += size
            self._changed.notify_all()
            return not self._closed


@contextmanager
def _no_collection() -> Iterator[None]:
    """One collection of cyclic garbage stops all threads for 0.1 s; what is played makes none."""
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()


@contextmanager
def _ahead_of_others() -> Iterator[int]:
    """All threads of the process with :data:`PRIORITY`; gives what was granted."""
    privileges = acquire(RealTimeSettings(priority=PRIORITY))
    try:
        yield privileges.priority
    finally:
        release(privileges)


def _message_class(name: str) -> Any:
    package, folder, kind = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{folder}"), kind)
    except (ImportError, AttributeError) as error:
        raise IsfError(
            ErrorCode.FILE_NOT_FOUND,
            f"the messages of {name} are not installed",
            where=name,
            advice="install the package, or choose other topics: --topic NAME",
        ) from error


def _profile(connection: Connection) -> QoSProfile:
    """As the topic was offered; depths of streams are raised, since a player may be ahead of its subscribers."""
    offered = getattr(connection.ext, "offered_qos_profiles", [])
    latched = playback.is_latched(connection)
    best_effort = bool(offered) and all(profile.reliability == QosReliability.BEST_EFFORT for profile in offered)
    depth = max((profile.depth for profile in offered), default=10)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(1, depth) if latched or best_effort else DEPTH,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
