"""The driver in a process of its own, and a sender of targets that ends, or sends what cannot be followed."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_msgs.msg import MachineState
from isf_msgs.srv import Reset, Scan, Stop, Tare
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Log
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time as Stamp
from rosgraph_msgs.msg import Clock

pytestmark = [pytest.mark.graph, pytest.mark.clock]

LIMIT = 60.0
"""s; only to end a test that hangs."""

ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)

RATE = 100.0
PARKED = 25e-3
"""m above the sheet, where the upper tool begins."""
ON_SHEET = -1e-3
"""m: with 1 N/um the upper tool reads the force at which the sheet yields, 300 N."""

STREAMS, SERVICES, SCANNER, MANAGED = 1, 2, 3, 4


class Sender:
    """Sends targets of the upper tool, and hears the driver."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.height = self.force = math.nan
        """m, N: where the upper tool is, and how hard the sheet pushes it up."""
        self.heights: list[float] = []
        self.stamps: list[int] = []
        """ns, of the wrenches."""
        self.ticks: list[int] = []
        """Cycles that the driver had done, at each of its states."""
        self.state: MachineState | None = None
        self._target = node.create_publisher(PoseStamped, "tool_1/target", 10)
        node.create_subscription(PoseStamped, "tool_1/pose", self._on_pose, rclpy.qos.qos_profile_sensor_data)
        node.create_subscription(WrenchStamped, "tool_1/wrench", self._on_wrench, 10)
        node.create_subscription(MachineState, "machine/state", self._on_state, 10)

    def _on_pose(self, message: PoseStamped) -> None:
        self.height = message.pose.position.z
        self.heights.append(self.height)

    def _on_wrench(self, message: WrenchStamped) -> None:
        self.force = message.wrench.force.z
        self.stamps.append(Stamp.from_msg(message.header.stamp).nanoseconds)

    def _on_state(self, message: MachineState) -> None:
        self.state = message
        self.ticks.append(message.tick)

    def wait(self, condition: Callable[[], Any]) -> bool:
        deadline = time.monotonic() + LIMIT
        while not condition() and time.monotonic() < deadline:
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return bool(condition())

    def send(self, tip: Sequence[float], frame: str = "sheet") -> None:
        message = PoseStamped()
        message.header.frame_id = frame
        message.pose.position.x, message.pose.position.y, message.pose.position.z = map(float, tip)
        self._target.publish(message)

    def send_for_sure(self, tip: Sequence[float]) -> None:
        """The driver has it when this returns, and takes it before a service that is asked for afterwards."""
        self.send(tip)
        assert self._target.wait_for_all_acked(Duration(seconds=LIMIT))

    def stream(self, begin: float, end: float) -> None:
        """Down or up to height ``end`` m in steps of 0.5 mm, each one sent when the tool has followed the one before.
        A driver that stood still meanwhile is sent the step again."""
        steps = max(1, round(abs(end - begin) / 0.5e-3))
        for step in range(1, steps + 1):
            height = begin + (end - begin) * step / steps
            deadline = time.monotonic() + LIMIT
            while abs(self.height - height) > 20e-6:
                assert time.monotonic() < deadline
                assert self.state is None or not self.state.fault_codes
                self.send((0.0, 0.0, height))
                rclpy.spin_once(self.node, timeout_sec=0.01)

    def begin(self, *, tared: bool) -> None:
        """Wait for the driver, and tare it where it can be asked."""
        assert self.wait(lambda: self._target.get_subscription_count() and not math.isnan(self.height))
        if not tared:
            assert self.ask(Tare, "machine/tare", Tare.Request()).code == 0
        assert self.wait(lambda: abs(self.force) < 10.0)

    def ask(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(LIMIT)
        future = client.call_async(request)
        assert self.wait(future.done)
        return future.result()

    def change(self, transition: int) -> bool:
        """Whether the driver has made a ``transition`` of its lifecycle."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.ask(ChangeState, "machine/change_state", request).success)

    def fault(self) -> int:
        """Code of the fault that the driver tells."""
        assert self.wait(lambda: self.state and self.state.fault_codes)
        assert self.state is not None
        assert self.state.mode == MachineState.PROTECTIVE_STOP
        return int(self.state.fault_codes[0])


@pytest.fixture
def sender() -> Iterator[Sender]:
    rclpy.init()
    node = rclpy.create_node("sender")
    try:
        yield Sender(node)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def driver(level: int, rate: float = RATE, **parameters: object) -> Any:
    return forked_process.node("-m", "isf_driver_example.driver_node", level=level, rate=rate, **parameters)


def program(name: str, level: int = MANAGED) -> Any:
    """A driver with the hardware of a file beside this one."""
    return forked_process.node(str(Path(__file__).with_name(name)), level=level, rate=RATE)


def hear_states(sender: Sender) -> list[str]:
    """States of its lifecycle, as the driver tells them on /diagnostics."""
    states: list[str] = []

    def on_health(message: DiagnosticArray) -> None:
        states.extend(item.value for status in message.status for item in status.values if item.key == "state")

    sender.node.create_subscription(DiagnosticArray, "/diagnostics", on_health, 10)
    return states


@pytest.mark.parametrize("level", [STREAMS, SERVICES])
def test_loaded_tools_leave_the_sheet_when_no_targets_come_any_more(sender: Sender, level: int) -> None:
    with driver(level):
        sender.begin(tared=level == STREAMS)
        sender.stream(PARKED, ON_SHEET)
        assert sender.wait(lambda: sender.force > 250.0)
        assert sender.wait(lambda: sender.height > 15e-3)
        assert sender.wait(lambda: abs(sender.force) < 10.0)
        if level == STREAMS:  # nobody can reset it: it follows whoever begins where the tools are
            sender.state = None
            assert sender.wait(lambda: sender.height > ON_SHEET + 19.5e-3)
            sender.stream(sender.height, PARKED)
            return
        assert sender.fault() == 1404
        sender.send((0.0, 0.0, ON_SHEET))  # a stop holds
        assert sender.ask(Tare, "machine/tare", Tare.Request()).code == 0  # which ends it, where there is no reset
        assert sender.wait(lambda: sender.state and not sender.state.fault_codes)


@pytest.mark.parametrize(
    ("tip", "frame", "code"),
    [
        ((0.0, math.nan, 0.02), "sheet", 1401),
        ((0.0, 0.0, PARKED), "tool0", 1401),
        ((0.1, 0.0, PARKED), "sheet", 1402),
        ((0.0, 0.0, 0.3), "sheet", 1403),
    ],
    ids=str,
)
def test_what_is_no_target_is_not_followed(sender: Sender, tip: tuple[float, ...], frame: str, code: int) -> None:
    with driver(SERVICES):
        sender.begin(tared=False)
        sender.stream(PARKED, PARKED - 2e-3)
        sender.send(tip, frame)
        assert sender.fault() == code
        assert sender.state is not None
        assert "tool_1/target" in sender.state.fault_messages[0]
        seen = len(sender.heights)
        assert sender.wait(lambda: len(sender.heights) > seen + 10)
        assert max(abs(height - PARKED) for height in sender.heights[seen:]) < 3e-3  # free tools stay where they are


def test_readings_of_cycles_that_came_late_are_not_left_out(sender: Sender) -> None:
    """A process that is kept waiting for 60 ms at 100 Hz sends what the converters have read meanwhile."""
    heard: list[tuple[float, float]] = []

    def on_wrench(message: WrenchStamped, info: Any) -> None:
        stamp = message.header.stamp
        heard.append((stamp.sec + 1e-9 * stamp.nanosec, 1e-9 * info["source_timestamp"]))

    sender.node.create_subscription(WrenchStamped, "tool_1/wrench", on_wrench, 100)
    with driver(SERVICES) as process:
        assert sender.wait(lambda: len(heard) > 20)
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.06)  # the fault itself: the timer misses cycles, which the driver makes up for
        process.send_signal(signal.SIGCONT)
        before = len(heard)
        assert sender.wait(lambda: len(heard) > before + 40)
    stamps, sent = np.array(heard).T
    made_up_for = np.diff(sent) < 0.2  # where the computer itself stood for longer, some are left out
    assert np.diff(sent)[made_up_for].max() > 0.04, "the process was not kept waiting"
    assert np.diff(stamps)[made_up_for] == pytest.approx(0.01, abs=0.5e-3)


def test_a_rate_as_that_of_the_state_keeps_its_own_cycle(sender: Sender) -> None:
    with driver(SERVICES, rate=10.0):
        sender.begin(tared=False)  # poses and wrenches come
        assert sender.wait(lambda: sender.state is not None)


def test_targets_begin_where_the_tools_are(sender: Sender) -> None:
    with driver(SERVICES):
        sender.begin(tared=False)
        sender.send((0.0, 0.0, PARKED - 5e-3))
        assert sender.fault() == 1402


def test_a_stop_on_request_keeps_its_code(sender: Sender) -> None:
    with driver(SERVICES):
        sender.begin(tared=False)
        sender.ask(Stop, "machine/stop", Stop.Request(reason="a trial"))
        assert sender.fault() == 1406
        sender.send((0.0, 0.0, PARKED), "tool0")  # nothing is taken, and nothing added
        assert sender.ask(Tare, "machine/tare", Tare.Request()).code == 0


@pytest.mark.parametrize("level", [STREAMS, SERVICES])
def test_a_driver_that_is_told_to_end_takes_loaded_tools_off_the_sheet(sender: Sender, level: int) -> None:
    with driver(level) as process:
        sender.begin(tared=level == STREAMS)
        sender.stream(PARKED, ON_SHEET)
        assert sender.wait(lambda: sender.force > 250.0)
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(LIMIT) == 0
        assert sender.wait(lambda: sender.height > 15e-3)
        assert sender.wait(lambda: abs(sender.force) < 10.0)
        if level == SERVICES:
            assert sender.fault() == 1406


@pytest.mark.parametrize("before", ["loaded", "while it is stopped", "after a reset"])
def test_a_driver_that_is_deactivated_takes_loaded_tools_off_the_sheet(sender: Sender, before: str) -> None:
    """As after a part that ended early: the executive asks for a stop, and deactivates the nodes at once. A reset asks
    for another tare, but the forces are true without."""
    with driver(MANAGED):
        assert sender.change(Transition.TRANSITION_CONFIGURE)
        assert sender.change(Transition.TRANSITION_ACTIVATE)
        sender.begin(tared=False)
        sender.stream(PARKED, ON_SHEET)
        assert sender.wait(lambda: sender.force > 250.0)
        if before == "while it is stopped":
            sender.ask(Stop, "machine/stop", Stop.Request(reason="a trial"))
        if before == "after a reset":
            assert sender.ask(Reset, "machine/reset", Reset.Request()).code == 0
        assert sender.change(Transition.TRANSITION_DEACTIVATE)
        assert sender.wait(lambda: sender.height > 15e-3)
        assert sender.wait(lambda: abs(sender.force) < 10.0)
        assert sender.fault() == 1406


def test_tools_with_a_weight_are_not_loaded_before_the_first_tare(sender: Sender) -> None:
    with program("heavy_tools.py"):
        assert sender.change(Transition.TRANSITION_CONFIGURE)
        assert sender.change(Transition.TRANSITION_ACTIVATE)
        assert sender.wait(lambda: sender.heights and sender.force < -40.0)
        assert sender.change(Transition.TRANSITION_DEACTIVATE)
        assert sender.ask(Tare, "machine/tare", Tare.Request()).code == 0  # refused while it is stopped
        assert sender.change(Transition.TRANSITION_ACTIVATE)
        sender.begin(tared=True)
        assert sender.heights == pytest.approx([PARKED] * len(sender.heights), abs=1e-6)
        sender.stream(PARKED, ON_SHEET)
        assert sender.wait(lambda: sender.force > 250.0)
        assert sender.change(Transition.TRANSITION_DEACTIVATE)
        assert sender.wait(lambda: sender.height > 15e-3)
        assert sender.fault() == 1406


def test_nothing_runs_on_when_the_hardware_fails_while_tools_leave_the_sheet(sender: Sender) -> None:
    """Nothing is published or followed then. It can be brought up again, once: states come at 10 Hz, every 10 cycles,
    where two timers would publish one every 5 cycles."""
    states = hear_states(sender)
    with program("failing_hardware.py"):
        assert sender.change(Transition.TRANSITION_CONFIGURE)
        assert sender.change(Transition.TRANSITION_ACTIVATE)
        sender.begin(tared=False)
        sender.stream(PARKED, ON_SHEET)
        assert sender.wait(lambda: sender.force > 250.0)
        assert sender.wait(lambda: states and states[-1] == "active")

        assert not sender.change(Transition.TRANSITION_DEACTIVATE)
        ended = sender.node.get_clock().now().nanoseconds
        assert sender.fault() == 1406
        assert sender.wait(lambda: states[-1] == "unconfigured")
        states.clear()
        assert sender.wait(lambda: len(states) > 2)  # its other timer goes on meanwhile
        assert set(states) == {"unconfigured"}
        assert max(sender.stamps) < ended

        assert sender.ask(Reset, "machine/reset", Reset.Request()).code == 0
        assert sender.wait(lambda: sender.state and not sender.state.fault_codes)
        height = sender.height
        sender.send_for_sure((0.0, 0.0, height + 1e-3))
        assert sender.change(Transition.TRANSITION_CONFIGURE)
        assert max(sender.stamps) < ended
        sender.ticks.clear()
        sender.heights.clear()
        assert sender.change(Transition.TRANSITION_ACTIVATE)
        assert sender.wait(lambda: len(sender.ticks) > 20 and sender.heights)
        assert (sender.ticks[20] - sender.ticks[0]) / 20 > 7.5
        assert sender.heights == pytest.approx([height] * len(sender.heights), abs=50e-6)

        assert sender.change(Transition.TRANSITION_DEACTIVATE)
        assert sender.wait(lambda: sender.height > 15e-3)
        assert sender.fault() == 1406


@pytest.mark.parametrize(
    ("level", "asked"), [(SERVICES, "tare"), (SERVICES, "stop"), (MANAGED, "reset"), (MANAGED, "deactivate")]
)
def test_hardware_that_fails_in_a_cycle_is_a_fault_of_the_driver(sender: Sender, level: int, asked: str) -> None:
    """Cycles end there, and nothing moves, until somebody asks for something: a reset has the tools where they were,
    all else takes them off the sheet."""
    with program("lost_hardware.py", level) as process:
        if level == MANAGED:
            assert sender.change(Transition.TRANSITION_CONFIGURE)
            assert sender.change(Transition.TRANSITION_ACTIVATE)
        sender.begin(tared=False)
        sender.stream(PARKED, ON_SHEET)
        assert sender.wait(lambda: sender.force > 250.0)
        sender.send((0.0, 0.0, ON_SHEET - 0.4e-3))
        assert sender.fault() == 1410
        assert sender.state is not None
        assert "ConnectionError: the field bus has lost a cycle" in sender.state.fault_messages[0]

        sender.send_for_sure((0.0, 0.0, ON_SHEET + 1e-3))
        sender.ticks.clear()
        assert sender.wait(lambda: len(sender.ticks) > 5)
        assert len(set(sender.ticks)) == 1
        assert process.poll() is None

        sender.heights.clear()
        if asked == "reset":
            assert sender.ask(Reset, "machine/reset", Reset.Request()).code == 0
            assert sender.wait(lambda: sender.state and not sender.state.fault_codes and len(sender.heights) > 20)
            assert sender.heights == pytest.approx([ON_SHEET] * len(sender.heights), abs=50e-6)
            return
        if asked == "tare":
            assert sender.ask(Tare, "machine/tare", Tare.Request()).code == 1405  # still on the sheet, which they leave
        elif asked == "stop":
            assert sender.ask(Stop, "machine/stop", Stop.Request(reason="a trial")).code == 0
        else:
            assert sender.change(Transition.TRANSITION_DEACTIVATE)
        assert sender.wait(lambda: sender.height > 15e-3)
        assert sender.fault() == 1410
        if level == SERVICES:
            assert sender.ask(Tare, "machine/tare", Tare.Request()).code == 0
            assert sender.wait(lambda: sender.state and not sender.state.fault_codes)


def test_hardware_that_fails_in_a_service_answers_with_the_fault(sender: Sender) -> None:
    with program("lost_hardware.py", SCANNER):
        sender.begin(tared=False)
        answer = sender.ask(Scan, "machine/scan", Scan.Request(clamped=True))
        assert (answer.code, answer.points) == (1410, 0)
        assert "TimeoutError: no answer from the scanner" in answer.message
        assert sender.fault() == 1410
        assert sender.ask(Tare, "machine/tare", Tare.Request()).code == 0
        assert sender.ask(Scan, "machine/scan", Scan.Request(clamped=True)).code == 0
        assert sender.ask(Scan, "machine/scan", Scan.Request(clamped=False)).code == 1414


def test_hardware_that_is_not_there_is_told_and_tried_again(sender: Sender) -> None:
    told: list[str] = []
    states = hear_states(sender)
    sender.node.create_subscription(Log, "/rosout", lambda message: told.append(message.msg), ROSOUT)
    with program("absent_hardware.py"):
        assert not sender.change(Transition.TRANSITION_CONFIGURE)
        assert sender.wait(lambda: any("ConnectionError: no answer from the field bus" in text for text in told))
        assert sender.change(Transition.TRANSITION_CONFIGURE)
        assert sender.wait(lambda: states and states[-1] == "inactive")


def test_a_driver_works_before_the_clock_of_a_simulation_is_there(sender: Sender) -> None:
    """Stamps are those of the clock, which is at 0: the time of arrival, to who receives them."""
    stamps: list[int] = []

    def on_wrench(message: WrenchStamped) -> None:
        stamps.append(message.header.stamp.sec)

    sender.node.create_subscription(WrenchStamped, "tool_1/wrench", on_wrench, 10)
    clock = sender.node.create_publisher(Clock, "/clock", 10)
    with driver(SERVICES, use_sim_time=True):
        assert sender.wait(lambda: len(stamps) > 20)
        assert set(stamps) == {0}
        assert sender.wait(clock.get_subscription_count)

        def ticked() -> bool:
            clock.publish(Clock(clock=Time(sec=1000)))
            return stamps[-1] >= 999

        assert sender.wait(ticked)
