"""What an outsider of a cell sees and can do: one node that watches it, stands between machine and force control, and
publishes and asks what it should not.

Messages of streams are taken as bytes: nothing here shares code with what a cell checks them by.
"""

from __future__ import annotations

import math
import os
import random
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from action_msgs.srv import CancelGoal
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_core.errors import told
from isf_msgs.msg import Contour, ContourResult, MachineState
from isf_ros import qos
from isf_ros.process import make_executor
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from isf_cell.faults.judge import Trace

RELAYED = "relayed"
"""Namespace in which force control of a campaign hears the machine."""

CANCEL = "form_part/_action/cancel_goal"
"""Service of the action."""

ANSWER = 5.0
"""s within which a node answers an outsider; who does not is left alone."""

Altered = Callable[[bytes], "bytes | None"]
"""What becomes of a message on its way; None: nothing."""


def values_at(data: bytes) -> int:
    """Where the numbers of a stamped message begin (CDR: header with its frame, then 8-byte numbers)."""
    (length,) = struct.unpack_from("<I", data, 12)
    return 4 + -(-(12 + length) // 8) * 8


def stamp_of(data: bytes) -> int:
    """ns, stamp of a message that begins with a header."""
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


class Outside:
    """Serves its node in a thread of its own, between :meth:`open` and :meth:`close`."""

    def __init__(self) -> None:
        self.node = Node(f"faults_{os.getpid()}")
        self._streams: dict[str, list[tuple[int, bytes]]] = {}
        self._relays: dict[str, Any] = {}
        self._alter: dict[str, Altered] = {}
        self._held_back: deque[tuple[float, str, bytes]] = deque()
        self._foreign: list[Callable[[], None]] = []
        self._clients: dict[str, Any] = {}
        self.results: list[ContourResult] = []
        self.codes: list[int] = []
        """Told in machine/state and /diagnostics since :meth:`forget`, each once."""
        self.scan: PointCloud2 | None = None
        """The last one."""
        self.states: dict[str, str] = {}
        """Lifecycle state that each node told last."""
        self.machine_time = 0
        """ns, newest stamp of the machine."""
        self.altered: tuple[int, int] | None = None
        """ns: stamp and time of receipt of the first message that was altered since :meth:`restore`."""
        for tool in (1, 2):
            self._follow(WrenchStamped, f"tool_{tool}/wrench", qos.STREAM_SOURCE, qos.STREAM)
            self._follow(PoseStamped, f"tool_{tool}/pose", qos.SENSOR, qos.SENSOR)
        self.node.create_subscription(ContourResult, "contour/result", self._on_result, qos.EVENT)
        self.node.create_subscription(MachineState, "machine/state", self._on_machine, qos.STREAM)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self.node.create_subscription(PointCloud2, "scan", self._on_scan, qos.LATCHED)
        for name in ("machine", "springback", "force_ctrl"):  # found before they are needed
            self._client(ChangeState, f"{name}/change_state")
        self._client(CancelGoal, CANCEL)
        self._executor = make_executor(streams=True)
        self._executor.add_node(self.node)
        self.node.create_timer(0.005, self._on_timer)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the graph."""
        self.restore()
        self._ends.set()
        self._thread.join()
        self._executor.remove_node(self.node)
        self.node.destroy_node()

    def forget(self) -> None:
        """What was seen before says nothing of the next part."""
        for stream in self._streams.values():
            stream.clear()
        self.results.clear()
        self.codes.clear()
        self.scan = None

    def restore(self) -> None:
        """Disturb nothing any more."""
        self._alter.clear()
        self.altered = None
        for stop in self._foreign:  # in the thread that serves them: they may be publishing at this moment
            stopped = threading.Event()
            self._executor.create_task(stop).add_done_callback(lambda _, stopped=stopped: stopped.set())
            stopped.wait(ANSWER)
        self._foreign.clear()

    # -- what it saw -----------------------------------------------------------------------------

    def trace(self, topic: str) -> Trace:
        """What came on ``tool_k/wrench`` (N) or ``tool_k/pose`` (m) since :meth:`forget`."""
        rows = list(self._streams[topic])
        value = np.array([struct.unpack_from("<3d", data, values_at(data)) for _, data in rows]).reshape(-1, 3)
        received = np.array([time_ns for time_ns, _ in rows], dtype=np.int64)
        return Trace(received, np.array([stamp_of(data) for _, data in rows], dtype=np.int64), value)

    def load(self, tool: int) -> float:
        """N, force on ``tool`` now."""
        return float(np.linalg.norm(self._last(f"tool_{tool}/wrench")))

    @property
    def formed(self) -> set[int]:
        """Contours whose results say that they were completed."""
        return {result.index for result in self.results if result.completed}

    def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Whether ``condition`` comes true within ``seconds``; looked at every 5 ms."""
        deadline, pause = time.monotonic() + seconds, threading.Event()
        while not condition():
            if time.monotonic() > deadline:
                return False
            pause.wait(0.005)
        return True

    @property
    def altering(self) -> bool:
        """True while messages of the machine are altered."""
        return bool(self._alter)

    # -- between machine and force control -------------------------------------------------------

    def alter(self, kind: str, tools: tuple[int, ...], change: Altered) -> None:
        """From now on messages ``kind`` (wrench, pose) of ``tools`` reach force control as ``change`` makes them."""
        for tool in tools:
            self._alter[f"tool_{tool}/{kind}"] = change

    def delay(self, tools: tuple[int, ...], seconds: float) -> None:
        """The wrenches of ``tools`` arrive ``seconds`` late."""
        for tool in tools:
            topic = f"tool_{tool}/wrench"

            def later(data: bytes, topic: str = topic) -> None:
                self._held_back.append((time.monotonic() + seconds, topic, data))

            self._alter[topic] = later

    def _follow(self, kind: Any, topic: str, asked: Any, offered: Any) -> None:
        self._streams[topic] = []
        self._relays[topic] = self.node.create_publisher(kind, f"{RELAYED}/{topic}", offered)
        self.node.create_subscription(kind, topic, lambda data: self._on_stream(topic, data), asked, raw=True)

    def _on_stream(self, topic: str, data: bytes) -> None:
        alter = self._alter.get(topic)
        passed = data if alter is None else alter(data)
        if passed is not data and self.altered is None:
            self.altered = stamp_of(data), time.time_ns()
        if passed is not None:
            self._relays[topic].publish(passed)
        self._streams[topic].append((time.time_ns(), data))
        self.machine_time = stamp_of(data)

    def _on_timer(self) -> None:
        while self._held_back and self._held_back[0][0] <= time.monotonic():
            _, topic, data = self._held_back.popleft()
            self._relays[topic].publish(data)

    # -- what it publishes and asks --------------------------------------------------------------

    def second_targets(self, away: float) -> None:
        """Publish targets of the forming tool ``away`` m beside where it is, 100 times a second."""
        publisher = self.node.create_publisher(PoseStamped, "tool_1/target", qos.STREAM)
        message = PoseStamped()
        message.header.frame_id = "sheet"
        message.pose.orientation.w = 1.0

        def publish() -> None:
            x, y, z = self._last("tool_1/pose")
            message.header.stamp = self.node.get_clock().now().to_msg()
            position = message.pose.position
            position.x, position.y, position.z = x + away, y, z
            publisher.publish(message)

        self._keep_publishing(publisher, publish, 0.01)

    def flood(self, rate: float) -> None:
        """Publish ``rate`` messages a second on /diagnostics, each of 40 names."""
        publisher = self.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        names = [DiagnosticStatus(name=f"/elsewhere/node_{k}", message="x" * 200) for k in range(40)]
        batch = max(1, round(rate * 0.01))

        def publish() -> None:
            for _ in range(batch):
                publisher.publish(DiagnosticArray(status=names))

        self._keep_publishing(publisher, publish, 0.01)

    def bad_contours(self, chance: random.Random) -> None:
        """Contours that nobody may form: of no plan, of the wrong lengths, without numbers, far out of order."""
        publisher = self.node.create_publisher(Contour, "contour/corrected", qos.LATCHED)
        plan, nan = self.results[-1].plan_id if self.results else "", math.nan
        bad = [
            Contour(plan_id="no_plan", index=1, count=3),
            Contour(plan_id=plan, index=7, count=3),
            Contour(plan_id=plan, index=2, count=3, forming_tip=[0.0] * 7, normal=[nan] * 5),
            Contour(plan_id=plan, index=2, count=3, forming_tip=[nan] * 30, support_tip=[nan] * 30),
        ]
        chance.shuffle(bad)

        def publish() -> None:
            if bad:
                publisher.publish(bad.pop())

        self._keep_publishing(publisher, publish, 0.1)

    def deactivate(self, node: str) -> None:
        """Ask a node to deactivate itself."""
        transition = Transition(id=Transition.TRANSITION_DEACTIVATE)
        self._ask(ChangeState, f"{node}/change_state", ChangeState.Request(transition=transition))

    def set_nonsense(self, nodes: tuple[str, ...], chance: random.Random) -> None:
        """Set parameters of ``nodes`` to what they cannot be."""
        for name in nodes:
            for key in ("lockstep", "loop_gain", "service_timeout", "result_timeout", "no_such_parameter", "method"):
                value = Parameter(name=key)
                value.value.type = chance.choice((2, 3, 4, 8))
                value.value.integer_value = -chance.randrange(1, 10**9)
                value.value.double_value = chance.choice((math.nan, math.inf, -1e300))
                value.value.string_value = "\u0000\u2028" + "x" * 1000
                self._ask(SetParameters, f"{name}/set_parameters", SetParameters.Request(parameters=[value]))

    def cancel(self) -> None:
        """Cancel the part, as an operator does."""
        self._ask(CancelGoal, CANCEL, CancelGoal.Request())

    def _ask(self, kind: Any, name: str, request: Any) -> None:
        client = self._client(kind, name)
        if client.wait_for_service(ANSWER):
            answered = threading.Event()
            client.call_async(request).add_done_callback(lambda _: answered.set())
            answered.wait(ANSWER)

    def _client(self, kind: Any, name: str) -> Any:
        return self._clients.get(name) or self._clients.setdefault(name, self.node.create_client(kind, name))

    def _keep_publishing(self, publisher: Any, publish: Callable[[], None], period: float) -> None:
        timer = self.node.create_timer(period, publish)

        def stop() -> None:
            timer.cancel()
            self.node.destroy_timer(timer)
            self.node.destroy_publisher(publisher)

        self._foreign.append(stop)

    def _last(self, topic: str) -> tuple[float, float, float]:
        stream = self._streams[topic]
        if not stream:
            return 0.0, 0.0, 0.0
        data = stream[-1][1]
        x, y, z = struct.unpack_from("<3d", data, values_at(data))
        return float(x), float(y), float(z)

    # -- news (thread of the executor) -----------------------------------------------------------

    def _serve(self) -> None:
        while not self._ends.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def _on_result(self, message: ContourResult) -> None:
        self.results.append(message)

    def _on_machine(self, message: MachineState) -> None:
        self._note(*message.fault_codes)

    def _on_scan(self, message: PointCloud2) -> None:
        self.scan = message

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.startswith("/elsewhere/"):
                continue
            for item in status.values:
                if item.key == "state":
                    self.states[status.name.rsplit("/", 1)[-1]] = item.value
            if (error := told(status.message)) is not None:
                self._note(int(error.code))

    def _note(self, *codes: int) -> None:
        self.codes.extend(code for code in codes if code not in self.codes)


def without_numbers(data: bytes) -> bytes:
    """The message with NaN for its first number."""
    return _with(data, math.nan)


def saturated(data: bytes) -> bytes:
    """The message with a force in x that no cell can mean."""
    return _with(data, 1e4)


def stamped_later(seconds: int) -> Altered:
    """Messages of a clock that was set ``seconds`` forwards."""

    def later(data: bytes) -> bytes:
        changed = bytearray(data)
        (now,) = struct.unpack_from("<i", data, 4)
        struct.pack_into("<i", changed, 4, now + seconds)
        return bytes(changed)

    return later


def lost(share: float, chance: random.Random) -> Altered:
    """Messages of which a ``share`` never arrives."""
    return lambda data: None if chance.random() < share else data


def frozen() -> Altered:
    """The first reading again and again, with new stamps."""
    first: list[bytes] = []

    def same(data: bytes) -> bytes:
        if not first:
            first.append(data)
        return data[:12] + first[0][12:]

    return same


def nothing(_: bytes) -> None:
    """No message any more."""


def _with(data: bytes, value: float) -> bytes:
    changed = bytearray(data)
    struct.pack_into("<d", changed, values_at(data), value)
    return bytes(changed)
