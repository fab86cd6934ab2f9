"""Node ``machine``: stands in for the simulated machine; your hardware is in ``hardware.py``.

How much of the contract it offers is the parameter ``level``: 1 streams, 2 also tare, stop and state, 3 also scans, 4
also lifecycle, reset and diagnostics. A driver may stop at any of them.

    ros2 run isf_driver_example driver --ros-args -p level:=2
"""

from __future__ import annotations

import os
import signal
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_msgs.msg import MachineState
from isf_msgs.srv import Reset, Scan, Stop, Tare
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2, PointField

from isf_driver_example.hardware import FREE, Hardware
from isf_driver_example.target_check import FRAME, TargetCheck

STREAMS, SERVICES, SCANNER, MANAGED = 1, 2, 3, 4
"""Levels: each offers what those before it do."""

STREAM = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
SENSOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)

STAND_AFTER, RELEASE_AFTER = 0.25, 2.0
"""s without targets after which tools that were moving are told to stand still, and loaded ones leave the sheet."""
STATE_PERIOD, HEALTH_PERIOD, POSE_PERIOD = 0.1, 0.5, 0.02
"""s between two messages on machine/state, /diagnostics, tool_k/pose."""
STATE_PATIENCE = 0.5
"""s for those who listen to machine/state to take it, before a service that has changed it answers: who asked for a
tare arms force control next."""
RELEASE_WITHIN = 2.0
"""s, most that tools which leave the sheet hold up a driver that is to be inactive, or to end."""
LONGEST_CATCH_UP = 0.25
"""s of cycles that are made up for when this process was kept waiting: the machine and its converters went on."""
TARGET_LOST, TOOL_LOADED, STOP_REQUESTED, FAULTED, NOT_RELEASED = 1404, 1405, 1406, 1410, 1414
"""Codes of docs/reference/error_codes.md."""


class Driver:
    """Topics and services of a ``level`` on ``node``; the hardware moves from :meth:`start` to :meth:`stop`."""

    def __init__(self, node: Node, level: int) -> None:
        self._node, self._level = node, level
        self._rate = float(node.get_parameter("rate").value)
        self._hardware = Hardware(1.0 / self._rate)
        self._check = TargetCheck(1.0 / self._rate)
        self._tared = False  # as machine/state tells it: no more after a reset
        self._forces = np.zeros((2, 3))  # N, read last
        self._zeroed = False  # before the first tare forces have the tools' weight in them; its zero outlives a reset
        self._tick, self._code, self._following = 0, 0, False
        self._failed = ""  # what the hardware raised: no cycle and no target until somebody asks for something
        self._next_cycle = 0.0  # s of the monotonic clock
        self._heard: float | None = None  # s, when the last target came; None: nothing is to be done when none comes
        self._running: list[Any] = []
        self._wrenches = [node.create_publisher(WrenchStamped, f"tool_{k}/wrench", STREAM) for k in (1, 2)]
        self._poses = [node.create_publisher(PoseStamped, f"tool_{k}/pose", SENSOR) for k in (1, 2)]
        for k in (1, 2):
            work = self._guarded(partial(self._on_target, k))
            node.create_subscription(PoseStamped, f"tool_{k}/target", work, STREAM)
        if level >= SERVICES:
            self._state = node.create_publisher(MachineState, "machine/state", STREAM)
            node.create_service(Tare, "machine/tare", self._guarded(self._on_tare))
            node.create_service(Stop, "machine/stop", self._guarded(self._on_stop))
        elif refused := self._hardware.tare():  # nobody can ask for it: what it streams has to be tared
            raise SystemExit(f"the load cells cannot be tared: {refused}")
        else:
            self._zeroed = True
        if level >= SCANNER:
            self._scan = node.create_publisher(PointCloud2, "scan", LATCHED)
            node.create_service(Scan, "machine/scan", self._guarded(self._on_scan))
        if level >= MANAGED:
            node.create_service(Reset, "machine/reset", self._guarded(self._on_reset))

    def start(self) -> None:
        """Begin to move and to measure, where the tools are."""
        self.halt()
        self._try_again()
        self._stand()
        self._next_cycle = time.monotonic()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        periods = [(1.0 / self._rate, self._on_timer)]
        if self._level >= SERVICES:
            periods.append((STATE_PERIOD, self._publish_state))
        for period, work in periods:
            self._running.append(self._node.create_timer(period, self._guarded(work), clock=steady))

    def stop(self) -> None:
        """Stand still. Nobody moves the tools any more then: loaded ones leave the sheet before, and a stop comes to
        its end. Nothing runs afterwards, whatever the hardware raises."""
        try:
            if self._running:
                self._try_again()
            if self._running and self._zeroed and np.abs(self._forces).max() > FREE:
                self._protect(STOP_REQUESTED, "the driver is told to be inactive, or to end, with a loaded tool")
            deadline = time.monotonic() + RELEASE_WITHIN
            while self._releasing() and time.monotonic() < deadline:
                time.sleep(1.0 / self._rate)  # the period of a cycle: no timer is served while this callback runs
                self._on_timer()
        finally:
            self.halt()

    def halt(self) -> None:
        """No cycles and no targets from now on, wherever the tools are; the hardware is not asked."""
        while self._running:
            self._node.destroy_timer(self._running.pop())

    def _releasing(self) -> bool:
        return bool(self._running and self._hardware.stopped) and not self._hardware.released

    # -- what the hardware raises ------------------------------------------------------------------

    @property
    def _stopped(self) -> str:
        """Why the machine takes no targets; empty: it does."""
        return self._failed or self._hardware.stopped

    def _guarded(self, work: Callable[..., Any]) -> Callable[..., Any]:
        """``work`` for a callback: what it raises would end the process, and is a fault of the driver instead."""

        def call(*messages: Any) -> Any:
            try:
                return work(*messages)
            except Exception as error:
                text = self._fail(error)
                if len(messages) < 2:
                    return None
                response = messages[1]  # of a service
                response.code, response.message = FAULTED, text
                return response

        return call

    def _fail(self, error: Exception) -> str:
        """Latch what the hardware raised, told as text: the tools stand, as far as the hardware still does that."""
        self._code, self._failed = FAULTED, f"the hardware failed: {type(error).__name__}: {error}"
        self._heard, self._following = None, False
        with suppress(Exception):  # it may raise here, too
            if not self._hardware.stopped:  # a stop that has come to its end does not lift the tools once more
                self._hardware.stop(self._failed)
        self._check.restart()
        self._node.get_logger().error(f"{FAULTED}: {self._failed}\n{''.join(traceback.format_exception(error))}")
        if self._level >= SERVICES:
            self._publish_state()
        return self._failed

    def _try_again(self) -> None:
        """Somebody asks for something after a failure: the hardware is stopped, where it could not be, and its cycles
        go on, with which the tools leave the sheet. Raises what the hardware raises."""
        if not self._failed:
            return
        if not self._hardware.stopped:
            self._hardware.stop(self._failed)
        self._failed, self._next_cycle = "", time.monotonic()

    # -- streams ---------------------------------------------------------------------------------

    def _on_target(self, tool: int, message: PoseStamped) -> None:
        if not self._running or self._failed or not self._may_follow():
            return
        at, now = message.pose.position, time.monotonic()
        tip = np.array([at.x, at.y, at.z])
        header, here = message.header, self._hardware.tips[tool - 1]
        stamp = header.stamp.sec + 1e-9 * header.stamp.nanosec
        fault = self._check.check(tool, header.frame_id, tip, here, now, stamp)
        if self._hardware.stopped:
            if fault:
                return
            self._hardware.reset()
        if fault:
            self._protect(*fault)
            return
        self._hardware.move(tool, (at.x, at.y, at.z))
        self._heard, self._following = now, True

    def _may_follow(self) -> bool:
        """A stop holds until reset or tare. A driver without them takes targets again once the tools have left the
        sheet, from a sender that begins where they are."""
        return not self._hardware.stopped or (self._level < SERVICES and self._hardware.released)

    def _protect(self, code: int, text: str) -> None:
        """Protective stop, once: stand still, then release contact."""
        if self._stopped:
            return
        self._code, self._heard, self._following = code, None, False
        self._hardware.stop(text)
        self._check.restart()
        self._node.get_logger().error(f"{code}: {text}")
        if self._level >= SERVICES:
            self._publish_state()

    def _stand(self) -> None:
        """Where the tools are; what comes next begins there."""
        self._following, self._heard = False, None
        self._check.restart()
        self._hardware.stand()

    def _on_timer(self) -> None:
        """Do every cycle that is due by now; a timer alone leaves out those that it was late for."""
        if self._failed:
            return
        now, period = time.monotonic(), 1.0 / self._rate
        self._next_cycle = max(self._next_cycle, now - LONGEST_CATCH_UP)
        clock = self._node.get_clock().now().nanoseconds
        while self._next_cycle <= now:
            late = round(1e9 * (now - self._next_cycle))
            self._on_cycle(Time(nanoseconds=max(clock - late, 0)).to_msg())  # the time of a simulation begins at 0
            self._next_cycle += period

    def _on_cycle(self, stamp: Any) -> None:
        """One cycle; ``stamp`` is the time of its readings."""
        silent = 0.0 if self._heard is None else time.monotonic() - self._heard
        if self._following and silent > STAND_AFTER:
            self._following = False
            self._hardware.stand()
        forces = self._forces = self._hardware.cycle()
        if silent > RELEASE_AFTER:
            self._heard = None
            if np.abs(forces).max() > FREE:
                self._protect(TARGET_LOST, f"no targets for {RELEASE_AFTER:g} s while a tool is loaded")
        self._tick += 1
        with_poses = self._tick % max(1, round(POSE_PERIOD * self._rate)) == 0
        for k in (0, 1):
            wrench = WrenchStamped()
            wrench.header.frame_id, wrench.header.stamp = FRAME, stamp
            force = wrench.wrench.force
            force.x, force.y, force.z = map(float, forces[k])
            self._wrenches[k].publish(wrench)
            if with_poses:
                pose = PoseStamped()
                pose.header.frame_id, pose.header.stamp = FRAME, stamp
                at, pose.pose.orientation.w = pose.pose.position, 1.0
                at.x, at.y, at.z = map(float, self._hardware.tips[k])
                self._poses[k].publish(pose)

    # -- level 2 ---------------------------------------------------------------------------------

    def _publish_state(self) -> None:
        stopped = self._stopped
        mode = MachineState.FOLLOWING if self._following else MachineState.IDLE
        state = MachineState(mode=MachineState.PROTECTIVE_STOP if stopped else mode, tick=self._tick, tared=self._tared)
        if stopped:
            state.fault_codes, state.fault_messages = [self._code], [stopped]
        state.header.frame_id, state.header.stamp = FRAME, self._node.get_clock().now().to_msg()
        self._state.publish(state)

    def _on_tare(self, _: Tare.Request, response: Tare.Response) -> Tare.Response:
        if self._stopped and self._level >= MANAGED:
            response.code, response.message = FAULTED, f"reset first: {self._stopped}"
            return response
        self._try_again()
        refused = self._hardware.tare()
        self._tared = not refused
        self._zeroed = self._zeroed or self._tared
        response.code, response.message = (TOOL_LOADED, refused) if refused else (0, "")
        if not refused:
            self._hardware.reset()
        self._tell_state()
        return response

    def _on_stop(self, request: Stop.Request, response: Stop.Response) -> Stop.Response:
        self._try_again()
        self._protect(STOP_REQUESTED, request.reason or "stop was requested")
        return response

    def _tell_state(self) -> None:
        """Before an answer, while nothing moves: it is known to all when the answer comes."""
        self._publish_state()
        self._state.wait_for_all_acked(Duration(seconds=STATE_PATIENCE))

    # -- level 3 ---------------------------------------------------------------------------------

    def _on_scan(self, request: Scan.Request, response: Scan.Response) -> Scan.Response:
        if self._failed:
            response.code, response.message = FAULTED, self._failed
            return response
        if not request.clamped:
            response.code, response.message = NOT_RELEASED, "the scanner sees the sheet in the clamp alone"
            return response
        points = np.ascontiguousarray(self._hardware.scan(), dtype="<f4")
        cloud = PointCloud2(height=1, width=len(points), point_step=12, row_step=12 * len(points), is_dense=True)
        cloud.header.frame_id, cloud.header.stamp = FRAME, self._node.get_clock().now().to_msg()
        cloud.fields = [
            PointField(name=name, offset=4 * n, datatype=PointField.FLOAT32, count=1) for n, name in enumerate("xyz")
        ]
        cloud.data = points.tobytes()
        self._scan.publish(cloud)  # before the answer: who asked goes on when it comes
        response.points = len(points)
        return response

    # -- level 4 ---------------------------------------------------------------------------------

    def _on_reset(self, request: Reset.Request, response: Reset.Response) -> Reset.Response:
        self._try_again()
        self._hardware.reset()
        self._stand()
        if request.new_blank:
            self._hardware.clamp_fresh_blank()
        self._tared = False
        self._tell_state()
        return response


class ManagedDriver(LifecycleNode):
    """Level 4: the executive brings it up and down, and hears from ``/diagnostics`` that it lives."""

    def __init__(self) -> None:
        super().__init__("machine")
        for service in self.services:
            service.callback = partial(self._answer, service.callback)
        self._driver: Driver | None = None
        self._label = "unconfigured"
        self._health = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(HEALTH_PERIOD, self._publish_health, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _answer(self, serve: Callable[..., Any], request: Any, response: Any) -> Any:
        """rclpy raises an exception for a transition that the present state has not: it is refused, no more."""
        try:
            return serve(request, response)
        except Exception as error:
            self.get_logger().error(f"{type(request).__name__}: {error}")
            return response

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._done(self._connect, "inactive")

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        super().on_activate(state)
        return self._done(self._start, "active")

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        super().on_deactivate(state)
        return self._done(self.stop, "inactive")

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._now("unconfigured")

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._done(self.stop, "finalized")

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After a transition that raised: back to the beginning, from where it can be tried again."""
        if self._driver is not None:
            self._driver.halt()
        return self._now("unconfigured")

    def _connect(self) -> None:
        self._driver = self._driver or Driver(self, MANAGED)

    def _start(self) -> None:
        if self._driver is not None:
            self._driver.start()

    def stop(self) -> None:
        """:meth:`Driver.stop`; a node that was never configured has nothing to stop."""
        if self._driver is not None:
            self._driver.stop()

    def _done(self, work: Callable[[], None], label: str) -> TransitionCallbackReturn:
        """Do the work of a transition. What it raises (the hardware is not there) rclpy would keep to itself."""
        try:
            work()
        except Exception:
            self.get_logger().error(f"not {label}: {traceback.format_exc()}")
            return TransitionCallbackReturn.ERROR
        return self._now(label)

    def _now(self, label: str) -> TransitionCallbackReturn:
        self._label = label
        self._publish_health()
        return TransitionCallbackReturn.SUCCESS

    def _publish_health(self) -> None:
        status = DiagnosticStatus(level=DiagnosticStatus.OK, name=self.get_fully_qualified_name(), message="ok")
        status.values = [
            KeyValue(key="state", value=self._label),
            KeyValue(key="pid", value=str(os.getpid())),
        ]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._health.publish(message)


def _declare(node: Node) -> int:
    """Declare the parameters; returns the level."""
    levels = IntegerRange(from_value=STREAMS, to_value=MANAGED, step=1)
    level = node.declare_parameter(
        "level", MANAGED, ParameterDescriptor(description="1 to 4", read_only=True, integer_range=[levels])
    )
    rates = FloatingPointRange(from_value=10.0, to_value=2000.0)
    text = "Hz, that of the job's control.rate"
    node.declare_parameter(
        "rate", 500.0, ParameterDescriptor(description=text, read_only=True, floating_point_range=[rates])
    )
    return int(level.value)


def _asked_level() -> int:
    """A node is managed from its start on, or never; so its parameters are read before it is made."""
    node = Node("machine", enable_rosout=False, start_parameter_services=False)
    try:
        return _declare(node)
    finally:
        node.destroy_node()


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run isf_driver_example driver``."""
    # A KeyboardInterrupt may come out of rclpy as any exception: signals end the loop between two callbacks.
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: signals.append(received))
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    level = _asked_level()
    node: Node = ManagedDriver() if level == MANAGED else Node("machine")
    _declare(node)
    if isinstance(node, ManagedDriver):
        stop = node.stop
    else:
        driver = Driver(node, level)
        driver.start()
        stop = driver.stop
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not signals and rclpy.ok():
            executor.spin_once(timeout_sec=0.1)
        if signals:
            stop()
    except ExternalShutdownException:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
